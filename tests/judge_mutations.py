"""Mutants of the modules that judge, one wrong thing each, and which of them the quick tests of the judge let live.

    python -m tests.judge_mutations                         a sample of 100, seeded
    python -m tests.judge_mutations --count 40 --seed 7     another one
    python -m tests.judge_mutations --only 17 230           these; numbers as they are printed

A mutant changes one comparison, operator, number, word of logic, or drops one `not`. Texts that only explain are left
alone.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.util
import itertools
import os
import pathlib
import random
import signal
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import NamedTuple

from tests import ROOT

MODULES = ("metrics", "tolerances", "verdict")
TESTS = ("test_metrics.py", "test_formulas.py", "test_outcomes.py", "test_known.py", "test_verdict.py")
"""The slowest stand last: most mutants are killed before them."""
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
             ast.MatMult: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
             ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
             ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or,
             ast.Or: ast.And}
NAMES = {"max": "min", "min": "max", "any": "all", "all": "any", "argmax": "argmin"}
SECONDS = 300
"""Computing (s) after which a mutant counts as killed: its tests run for ever. On a busy machine a clock would lie."""


class Mutant(NamedTuple):
    """One wrong thing: in the node of this place in `ast.walk`, a field gets another content."""

    module: str
    place: int
    line: int
    field: str
    before: object
    after: object

    @property
    def tree(self) -> ast.Module:
        tree = ast.parse(path_of(self.module).read_text(encoding="utf-8"))
        setattr(next(itertools.islice(ast.walk(tree), self.place, None)), self.field, self.after)
        return tree

    def __str__(self) -> str:
        before, after = (type(each).__name__ if isinstance(each, ast.AST) else each
                         for each in (self.before, self.after[0] if isinstance(self.after, list) else self.after))
        return f"{self.module}.py:{self.line} {before} -> {after}"


def mutants() -> list[Mutant]:
    """All of them."""
    return [Mutant(module, place, node.lineno, *change) for module in MODULES
            for place, node in enumerate(ast.walk(ast.parse(path_of(module).read_text(encoding="utf-8"))))
            for change in changes(node)]


def changes(node: ast.AST) -> Iterator[tuple[str, object, object]]:
    """The possible changes of a node: field, content, and another content."""
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in OPERATORS and not joins_types(node):
        yield "op", node.op, OPERATORS[type(node.op)]()
    elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        yield "ops", node.ops[0], [OPERATORS[type(node.ops[0])]()]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "op", node.op, ast.UAdd()
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield "value", node.value, not node.value
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield "value", node.value, node.value + 1
        if node.value:
            yield "value", node.value, node.value / 2 if isinstance(node.value, float) else 0
    elif isinstance(node, ast.Name) and node.id in NAMES:
        yield "id", node.id, NAMES[node.id]
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield "attr", node.attr, NAMES[node.attr]


def joins_types(node: ast.BinOp | ast.BoolOp) -> bool:
    """Whether this is the `|` of a type, as in `float | None`."""
    return isinstance(node.op, ast.BitOr) and any(isinstance(side, ast.Constant) and side.value is None
                                                  for side in (node.left, node.right))


def path_of(module: str) -> pathlib.Path:
    """The source of a module that judges."""
    return ROOT / "crosscheck" / "judge" / f"{module}.py"


class Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the module of a mutant with it."""

    def __init__(self, mutant: Mutant) -> None:
        self.name, self.tree = f"crosscheck.judge.{mutant.module}", mutant.tree
        self.file = str(path_of(mutant.module))

    def find_spec(self, fullname, path=None, target=None):
        return importlib.util.spec_from_loader(fullname, self, origin=self.file) if fullname == self.name else None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self.file
        exec(compile(ast.fix_missing_locations(self.tree), self.file, "exec"), module.__dict__)


def tested() -> int:
    """The exit code of pytest over the quick tests; at the first that fails it ends."""
    import pytest

    return pytest.main(["-x", "-q", "-m", "not slow", "-k", "not one_percent", "-p", "no:cacheprovider",
                        *(str(ROOT / "tests" / "judge" / name) for name in TESTS)])


def survives(mutant: Mutant) -> bool:
    """Whether the tests pass with this mutant in place, in a copy of this process that imports both packages anew."""
    process = os.fork()
    if process == 0:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1), os.dup2(nowhere, 2)
        for name in [name for name in sys.modules if name.partition(".")[0] in ("crosscheck", "tests")]:
            del sys.modules[name]
        sys.meta_path.insert(0, Mutated(mutant))
        os._exit(tested())
    return os.waitpid(process, 0)[1] == 0


def main() -> None:
    """Print every mutant of the sample, and how many live."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*")
    given = parser.parse_args()
    every = mutants()
    chosen = given.only or sorted(random.Random(given.seed).sample(range(len(every)), given.count))
    if tested() or not survives(every[0]._replace(after=every[0].before)):
        sys.exit("the tests fail without any mutant")
    alive = 0
    for number in chosen:
        lives = survives(every[number])
        alive += lives
        print(f"{number} {'ALIVE' if lives else 'killed'} {every[number]}", flush=True)
    print(f"{alive} of {len(chosen)} live; {len(every)} mutants in all")


if __name__ == "__main__":
    main()
