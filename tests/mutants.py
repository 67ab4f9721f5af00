"""Mutants of the sources, one wrong thing each, and which of them the tests of their folder let live.

    python -m tests.mutants judge                        a sample of 100, seeded
    python -m tests.mutants scene --count 40 --seed 7    another one
    python -m tests.mutants judge --only 17 230          these; numbers as they are printed
    python -m tests.mutants judge --file verdict.py      of this module

A mutant changes one comparison, operator, number, word of logic, or drops one `not`. Texts that only explain are left
alone. One process imports and collects; a first copy of it notes which test enters which function. Every mutant is a
further copy, in which the code of one function is exchanged before the tests that enter it run, the cheapest first, to
the first failure. What runs at import (constants, defaults) is mutated by importing all anew.
"""

from __future__ import annotations

import argparse
import ast
import functools
import gc
import importlib.abc
import importlib.util
import itertools
import os
import pathlib
import pickle
import random
import signal
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import NamedTuple

import pytest
from _pytest.runner import runtestprotocol

from tests import ROOT

KINDS = {
    "judge": ("crosscheck/judge/*.py", ["tests/judge", "--ignore-glob=*_engines.py"]),
    "scene": ("crosscheck/scene/*.py", ["tests/scene", "tests/references/test_joints_and_forces.py"]),
    "diagnosis": ("crosscheck/diagnosis/*.py", ["tests/diagnosis"]),
    "kernel": ("lieeuler/*.py", ["tests/lieeuler", "tests/adapters/lieeuler"]),
}
"""Kind: the modules that get mutants, and the tests that must notice."""
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
             ast.MatMult: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
             ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
             ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or,
             ast.Or: ast.And}
NAMES = {"max": "min", "min": "max", "any": "all", "all": "any", "argmax": "argmin"}
SECONDS = 10
"""Computing (s) of the tests that a mutant is shown to; after twenty times as much it counts as killed: they run on.
On a busy machine a clock would lie."""


@functools.cache
def source(path: pathlib.Path) -> str:
    """The text of a module as it was at the start: it may be edited meanwhile."""
    return path.read_text(encoding="utf-8")


class Mutant(NamedTuple):
    """One wrong thing: in the node of this place in `ast.walk`, a field gets another content."""

    path: pathlib.Path
    place: int
    line: int
    field: str
    before: object
    after: object

    @property
    def tree(self) -> ast.Module:
        tree = ast.parse(source(self.path))
        setattr(next(itertools.islice(ast.walk(tree), self.place, None)), self.field, self.after)
        return ast.fix_missing_locations(tree)

    @property
    def function(self) -> CodeType | None:
        """The code of the outermost function around it, mutated; None for what runs at import."""
        return next((code for code in functions(compile(self.tree, str(self.path), "exec"))
                     if self.line in {line for _, _, line in inner_lines(code)}), None)

    def __str__(self) -> str:
        before, after = (type(each).__name__ if isinstance(each, ast.AST) else each
                         for each in (self.before, self.after[0] if isinstance(self.after, list) else self.after))
        return f"{self.path.relative_to(ROOT)}:{self.line} {before} -> {after}"


def functions(code: CodeType) -> Iterator[CodeType]:
    """Functions of a module or of its classes, without those inside of functions."""
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            if inner.co_flags & 2:  # of a function: it has fast locals
                yield inner
            else:
                yield from functions(inner)


def inner_lines(code: CodeType) -> Iterator[tuple[int, int, int]]:
    """`co_lines` of a function's code and of all functions in it."""
    yield from (each for each in code.co_lines() if each[2] is not None and each[2] > code.co_firstlineno)
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from inner.co_lines()


def mutants(pattern: str) -> list[Mutant]:
    """All of these files."""
    found = []
    for path in sorted(ROOT.glob(pattern)):
        nodes = list(ast.walk(ast.parse(source(path))))
        told = {id(each) for node in nodes if isinstance(node, ast.JoinedStr) or getattr(node, "arg", "") == "strict"
                for each in ast.walk(node)}
        found += [Mutant(path, place, node.lineno, *change) for place, node in enumerate(nodes) if id(node) not in told
                  for change in changes(node)]
    return found


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


class Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the module of a mutant with it."""

    def __init__(self, mutant: Mutant) -> None:
        self.name = mutant.path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
        self.tree, self.file = mutant.tree, str(mutant.path)

    def find_spec(self, fullname, path=None, target=None):
        return importlib.util.spec_from_loader(fullname, self, origin=self.file) if fullname == self.name else None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self.file
        exec(compile(self.tree, self.file, "exec"), module.__dict__)


def forget() -> None:
    """Empty what functions of the packages have remembered."""
    for each in gc.get_objects():
        if isinstance(each, functools._lru_cache_wrapper) and each.__module__.startswith(("crosscheck", "tests")):
            each.cache_clear()


def in_a_copy(act: Callable[[], int]) -> int:
    """The answer of a function that runs in a silent copy of this process."""
    process = os.fork()
    if process == 0:
        try:
            signal.setitimer(signal.ITIMER_PROF, 100 * SECONDS)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1), os.dup2(nowhere, 2)
            os._exit(act())
        except BaseException:
            os._exit(9)
    return os.waitpid(process, 0)[1]


def fails(item: pytest.Item, following: pytest.Item | None) -> bool:
    """Whether a test fails."""
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    return any(report.failed for report in runtestprotocol(item, nextitem=following, log=False))


class Hunt:
    """Instead of running the collected tests: the mutants, each before the tests that may notice it."""

    def __init__(self, every: list[Mutant], chosen: list[int]) -> None:
        self.every, self.chosen, self.alive = every, chosen, 0
        self.entered: dict[tuple[str, int], set[str]] = {}  # (file, first line) of a function: tests
        self.cost: dict[str, float] = {}  # CPU (s) of a test
        self.table = pathlib.Path(tempfile.mkdtemp()) / "entered"

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if in_a_copy(lambda: self.note(session.items)):
            sys.exit("the tests fail without any mutant")
        self.entered, self.cost = pickle.loads(self.table.read_bytes())
        for number in self.chosen:
            mutant = self.every[number]
            code = mutant.function
            if code is None:
                lives = in_a_copy(lambda mutant=mutant: anew(mutant, session.config.args)) == 0
            else:
                every = self.order(session.items, code)
                sums = itertools.accumulate(self.cost[item.nodeid] for item in every)
                suspects = [item for item, used in zip(every, sums, strict=True) if used < SECONDS]
                lives = in_a_copy(lambda code=code, suspects=suspects: judge(code, suspects)) == 0
            self.alive += lives
            shown = "" if code is None else f" in {len(suspects)} of {len(every)} tests"
            fate = f"ALIVE{shown}" if lives else "killed"
            print(f"{number} {fate} {mutant}", flush=True)
        return True

    def note(self, items: list[pytest.Item]) -> int:
        """Which test enters which function."""
        sources, entered = {str(each.path) for each in self.every}, defaultdict(set)
        for item, following in itertools.zip_longest(items, items[1:]):
            if following is None or following.path != item.path:
                forget()
            seen: set[CodeType] = set()
            sys.setprofile(lambda frame, event, _, seen=seen: seen.add(frame.f_code) if event == "call" else None)
            begin = time.process_time()
            failed = fails(item, following)
            sys.setprofile(None)
            if failed:
                return 1
            self.cost[item.nodeid] = time.process_time() - begin
            for code in seen:
                if code.co_filename in sources:
                    entered[code.co_filename, code.co_firstlineno].add(item.nodeid)
        self.table.write_bytes(pickle.dumps((dict(entered), self.cost)))
        return 0

    def order(self, items: list[pytest.Item], code: CodeType) -> list[pytest.Item]:
        """Tests that enter a function, the cheapest first; then others of their files, for what fixtures enter."""
        lines = {code.co_firstlineno, *(line for _, _, line in inner_lines(code))}
        direct = {test for (file, line), tests in self.entered.items()
                  if file == code.co_filename and line in lines for test in tests}
        files = {test.partition("::")[0] for test in direct}
        return sorted((item for item in items if item.nodeid.partition("::")[0] in files),
                      key=lambda item: (item.nodeid not in direct, self.cost[item.nodeid]))


def judge(code: CodeType, suspects: list[pytest.Item]) -> int:
    """1 if one of the tests fails with this code in place of that of the same function."""
    forget()
    signal.setitimer(signal.ITIMER_PROF, 20 * SECONDS)
    for each in gc.get_objects():
        if isinstance(each, FunctionType) and (each.__code__.co_filename, each.__code__.co_firstlineno) == (
                code.co_filename, code.co_firstlineno) and each.__code__.co_qualname == code.co_qualname:
            each.__code__ = code
    return int(any(itertools.starmap(fails, itertools.zip_longest(suspects, suspects[1:]))))


def anew(mutant: Mutant, args: list[str]) -> int:
    """The exit code of the tests where all is imported once more, this module mutated."""
    signal.setitimer(signal.ITIMER_PROF, 20 * SECONDS)
    for name in [name for name in sys.modules if name.partition(".")[0] in ("crosscheck", "lieeuler", "tests")]:
        if name != "lieeuler._core":
            del sys.modules[name]
    sys.meta_path.insert(0, Mutated(mutant))
    return pytest.main(["-x", *OPTIONS, *args])


OPTIONS = ("-q", "-m", "not study", "-p", "no:cacheprovider", "-p", "no:xdist")


def main() -> None:
    """Print every mutant of the sample, and how many live."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--file", nargs="*", help="modules, in place of all")
    parser.add_argument("--tests", nargs="*", help="in place of those of the kind")
    given = parser.parse_args()
    pattern, tests = KINDS[given.kind]
    every = mutants(pattern)
    offered = [number for number, each in enumerate(every) if not given.file or each.path.name in given.file]
    chosen = given.only or sorted(random.Random(given.seed).sample(offered, min(given.count, len(offered))))
    hunt = Hunt(every, chosen)
    pytest.main([*OPTIONS, *(given.tests or tests)], plugins=[hunt])
    print(f"{hunt.alive} of {len(chosen)} live; {len(every)} mutants in all")


if __name__ == "__main__":
    main()
