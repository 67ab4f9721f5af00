"""Mutants of the modules that judge, one wrong thing each, and which of them the quick tests of the judge let live.

    python -m tests.judge_mutations                         a sample of 100, seeded
    python -m tests.judge_mutations --count 40 --seed 7     another one
    python -m tests.judge_mutations --only 17 230           these; numbers as they are printed

A mutant changes one comparison, operator, number, word of logic, or drops one `not`. Texts that only explain are left
alone. Each mutant runs in a process of its own, for which the mutated source takes the place of the module's.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import random
import subprocess
import sys
from collections.abc import Iterator
from types import ModuleType

from tests import ROOT

MODULES = ("metrics", "tolerances", "verdict")
TESTS = ("test_metrics.py", "test_formulas.py", "test_tolerances.py", "test_known.py", "test_richardson.py",
         "test_verdict.py", "test_overrides.py")
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
             ast.MatMult: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
             ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
             ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or,
             ast.Or: ast.And}
NAMES = {"max": "min", "min": "max", "any": "all", "all": "any", "argmax": "argmin"}
CHOSEN = "CROSSCHECK_MUTANT"
SECONDS = 300.0
"""After which a mutant counts as killed: its tests run for ever."""


def mutations(tree: ast.Module) -> Iterator[tuple[int, str, ast.Module]]:
    """Line, what was changed, and the changed tree."""
    for index, node in enumerate(ast.walk(tree)):
        for change in changes(node):
            wrong = copy.deepcopy(tree)
            twin = next(each for k, each in enumerate(ast.walk(wrong)) if k == index)
            said = change(twin)
            yield node.lineno, said, wrong


def changes(node: ast.AST) -> Iterator:
    """What can be made wrong in a node: functions that change its twin and say how."""
    def replaced(field, before, after):
        def change(twin):
            setattr(twin, field, after)
            return f"{before} -> {after if isinstance(after, str | float | int) else type(after).__name__}"
        return change

    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in OPERATORS and not joins_types(node):
        yield replaced("op", type(node.op).__name__, OPERATORS[type(node.op)]())
    elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        yield replaced("ops", type(node.ops[0]).__name__, [OPERATORS[type(node.ops[0])]()])
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield replaced("op", "not", ast.UAdd())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield replaced("value", node.value, node.value + 1)
        if node.value:
            yield replaced("value", node.value, node.value / 2 if isinstance(node.value, float) else 0)
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield replaced("value", node.value, not node.value)
    elif isinstance(node, ast.Name) and node.id in NAMES:
        yield replaced("id", node.id, NAMES[node.id])
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield replaced("attr", node.attr, NAMES[node.attr])


def joins_types(node: ast.BinOp | ast.BoolOp) -> bool:
    """Whether this is the `|` of a type, as in `float | None`."""
    return isinstance(node.op, ast.BitOr) and any(isinstance(side, ast.Constant) and side.value is None
                                                  for side in (node.left, node.right))


def mutants() -> list[tuple[str, int, str, ast.Module]]:
    """All of them: module, line, change, tree."""
    found = []
    for module in MODULES:
        tree = ast.parse(path_of(f"crosscheck.judge.{module}").read_text(encoding="utf-8"))
        found += [(module, *each) for each in mutations(tree)]
    return found


class Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from its mutated tree."""

    def __init__(self, name: str, tree: ast.Module) -> None:
        self.name, self.tree = name, tree

    def find_spec(self, fullname, path=None, target=None):
        if fullname == self.name:
            return importlib.util.spec_from_loader(fullname, self, origin=str(path_of(fullname)))
        return None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(path_of(self.name))
        exec(compile(ast.fix_missing_locations(self.tree), module.__file__, "exec"), module.__dict__)


def path_of(name: str):
    return ROOT / (name.replace(".", "/") + ".py")


def run_tests(number: int) -> int:
    """In a process of its own: the quick tests of the judge, with this mutant in place."""
    import pytest

    module, _, _, tree = mutants()[number]
    sys.meta_path.insert(0, Mutated(f"crosscheck.judge.{module}", tree))
    tests = [str(ROOT / "tests" / "judge" / name) for name in TESTS]
    return pytest.main(["-x", "-q", "-m", "not slow", "-k", "not one_percent", "-p", "no:cacheprovider", *tests])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--run", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run is not None:
        sys.exit(run_tests(given.run))
    every = mutants()
    chosen = given.only or sorted(random.Random(given.seed).sample(range(len(every)), given.count))
    alive = 0
    for number in chosen:
        module, line, change, _ = every[number]
        try:
            code = subprocess.run([sys.executable, "-m", "tests.judge_mutations", "--run", str(number)], cwd=ROOT,
                                  capture_output=True, timeout=SECONDS, check=False).returncode
        except subprocess.TimeoutExpired:
            code = 1
        alive += code == 0
        print(f"{number} {'killed' if code else 'ALIVE'} {module}.py:{line} {change}", flush=True)
    print(f"{alive} of {len(chosen)} live; {len(every)} mutants in all")


if __name__ == "__main__":
    main()
