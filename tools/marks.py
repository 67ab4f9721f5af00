"""Measure what tests cost, and write the marks by which `make test` leaves the slow ones out: `tests/marks.toml`.

    python -m tools.marks tests/judge tests/test_docs.py   measure these and write what they are now
    python -m tools.marks                                  drop the marks of tests that are gone
    python -m pytest -p tools.marks ...                    report quick tests that have become slow; write nothing

A test costs its processor time (s), with that of the processes it starts; what a fixture of a module or of the session
takes is shared equally by its tests. More than `SLOW` makes a test slow, less than `QUICK` makes it quick again;
between them it stays what it was. A test that was never measured is quick, unless all cases of its function are slow.
All are measured once, those not far below the limits a second time, with truths and memories warm, and those near
them a third time: the median counts. Two marks are chosen by hand and kept: `core`, slow tests that `make test` runs
all the same, each with what it alone notices; and `study`, corpora of minutes, which run on demand.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import sys
import time
import tomllib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).parents[1] / "tests" / "marks.toml"
SLOW, QUICK = 0.7, 0.4
"""Processor time (s) above which a test becomes slow, and below which it becomes quick."""
NEAR = 2.5
"""A cost within this factor of the limits is measured three times."""
HEAD = """# Written by `python -m tools.marks`, which tells what the marks mean; `core` and `study` are chosen by hand.
# true: all cases of a function; a list: these cases; but: all except these.
"""

KINDS = ("slow", "study")
Cases = bool | list[str] | dict[str, list[str]]


class Marks:
    """The marks of all tests."""

    def __init__(self, path: Path = FILE) -> None:
        content = tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        self.core: dict[str, str] = content.get("core", {})  # test: what it alone notices
        self._given: dict[str, dict[str, dict[str, Cases]]] = {name: content.get(name, {}) for name in KINDS}

    def has(self, name: str, test: str) -> bool:
        """Whether a test, named as pytest does, is listed as slow or as a study."""
        file, function, case = parts(test)
        return _holds(self._given[name].get(file, {}).get(function, False), case)

    def of(self, test: str) -> list[str]:
        """The marks of a test. Studies are slow, too."""
        found = [name for name in KINDS if self.has(name, test)]
        return [*(["slow"] if found == ["study"] else []), *found, *(["core"] if test in self.core else [])]


def parts(test: str) -> tuple[str, str, str]:
    """File, function and case of a test."""
    file, _, name = test.partition("::")
    function, _, case = name.partition("[")
    return file, function, case[:-1]


def _holds(cases: Cases, case: str) -> bool:
    if isinstance(cases, dict):
        return case not in cases["but"]
    return cases if isinstance(cases, bool) else case in cases


def text(core: Mapping[str, str], marked: Mapping[str, Collection[str]], every: Collection[str]) -> str:
    """The file of marks: `marked` has the tests of each mark, `every` all that there are."""
    lines = [HEAD, "[core]", *(f"{json.dumps(test)} = {json.dumps(why, ensure_ascii=False)}"
                               for test, why in sorted(core.items()) if test in every)]
    cases: dict[tuple[str, str], list[str]] = defaultdict(list)
    for test in every:
        file, function, case = parts(test)
        cases[file, function].append(case)
    for name, tests in marked.items():
        chosen: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        for file, function, case in map(parts, set(tests) & set(every)):
            chosen[file][function].add(case)
        for file, functions in sorted(chosen.items()):
            lines += ["", f'[{name}."{file}"]', *(f"{function} = {_written(these, cases[file, function])}"
                                                  for function, these in sorted(functions.items()))]
    return "\n".join(lines) + "\n"


def _written(these: set[str], every: list[str]) -> str:
    others = [case for case in every if case not in these]
    if not others:
        return "true"
    listed = json.dumps([case for case in every if case in these] if len(these) <= len(others) else others,
                        ensure_ascii=False)
    return listed if len(these) <= len(others) else f"{{but = {listed}}}"


def ended() -> float:
    """Processor time (s) of this process and of those it has started that have ended."""
    own, gone = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + gone.ru_utime + gone.ru_stime


def used() -> float:
    """Processor time (s) of this process and of all that it has started."""
    import psutil

    total = ended()
    for child in psutil.Process().children(recursive=True):
        try:
            times = child.cpu_times()
        except psutil.Error:  # it has ended
            continue
        total += times.user + times.system + times.children_user + times.children_system
    return total


def slow(cost: float, before: bool) -> bool:
    """Whether a test of this cost (s) is slow that was or was not."""
    return cost > (QUICK if before else SLOW)


class Meter:
    """A plugin that measures tests, and the fixtures of modules and of the session apart from them."""

    def __init__(self, wanted: Collection[str] | None = None) -> None:
        self._wanted, self._meanwhile = wanted, 0.0
        self._own: dict[str, float] = {}
        self._shared: dict[object, float] = {}
        self._users: dict[str, list[object]] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep the tests that are wanted."""
        if self._wanted is not None:
            items[:] = [item for item in items if item.nodeid in self._wanted]

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Iterator[None]:
        """What a fixture takes that several tests use."""
        began, before = used(), self._meanwhile
        yield
        if fixturedef.scope != "function":
            took = used() - began - (self._meanwhile - before)  # without the fixtures that it asked for meanwhile
            self._shared[fixturedef] = self._shared.get(fixturedef, 0.0) + took
            self._meanwhile += took

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Function) -> Iterator[None]:
        """What a test takes itself."""
        began, self._meanwhile = used(), 0.0
        yield
        self._own[item.nodeid] = used() - began - self._meanwhile
        known = item._fixtureinfo.name2fixturedefs
        self._users[item.nodeid] = [known[name][-1] for name in item.fixturenames if known.get(name)]

    def costs(self) -> dict[str, float]:
        """Processor time (s) of each test, with its share of fixtures."""
        sharers = Counter(each for fixtures in self._users.values() for each in fixtures)
        return {test: own + sum(self._shared.get(each, 0.0) / sharers[each] for each in self._users[test])
                for test, own in self._own.items()}


class Collected:
    """A plugin that notes the names of all tests."""

    names: tuple[str, ...] = ()

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """All, before others leave some out."""
        self.names = tuple(item.nodeid for item in items)


class Report:
    """A plugin that tells which quick tests took far more than a quick test may."""

    def __init__(self) -> None:
        self._began = self._time = 0.0
        self._costs: dict[str, float] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        """A test begins."""
        self._began, self._time = ended(), time.monotonic()

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
        """The report of the end of a test carries its cost, also to another process."""
        made: Any = yield
        if call.when == "teardown" and item.get_closest_marker("slow") is None:
            # A process that began long before and ends now has all of its time counted here.
            most = (time.monotonic() - self._time) * (os.cpu_count() or 1)
            made.get_result().user_properties.append(("cost", min(ended() - self._began, most)))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the cost."""
        self._costs.update((report.nodeid, float(str(value))) for name, value in report.user_properties
                           if name == "cost" and report.when == "teardown")

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """The dearest. Of tests that share something the first carries it."""
        far = sorted(((cost, test) for test, cost in self._costs.items() if cost > SLOW * NEAR), reverse=True)
        if far:
            terminalreporter.write_line(f"{len(far)} tests that are not marked slow took over {SLOW * NEAR:g} s of "
                                        "processor time, making truths included: `python -m tools.marks FILES`")
            for cost, test in far[:20]:
                terminalreporter.write_line(f"{cost:7.2f} s {test}")


def pytest_configure(config: pytest.Config) -> None:
    """As a plugin, report."""
    config.pluginmanager.register(Report())


OPTIONS = ("-p", "no:cacheprovider", "-p", "no:xdist")


def measured(paths: list[str], expression: str) -> dict[str, float]:
    """Cost (s) of the tests in `paths` with these marks."""
    tries: dict[str, list[float]] = {}
    wanted = None
    for _ in range(3):
        meter = Meter(wanted)
        pytest.main([*OPTIONS, "-m", expression, *paths], plugins=[meter])
        for test, cost in meter.costs().items():
            tries.setdefault(test, []).append(cost)
        # The first time computes truths and fills memories; only what is far below the limits is right at once.
        wanted = {test for test, costs in tries.items()
                  if costs[-1] > QUICK / NEAR and (len(costs) == 1 or costs[-1] < SLOW * NEAR)}
        if not wanted:
            break
    return {test: statistics.median(costs) if len(costs) == 3 else costs[-1] for test, costs in tries.items()}


def main() -> None:
    """Measure, write, and print what has changed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", help="tests to measure")
    parser.add_argument("-m", dest="expression", default="not study", help="which marks; default: not study")
    given = parser.parse_args()
    collected = Collected()
    if pytest.main([*OPTIONS, "--collect-only", "-qq"], plugins=[collected]):
        sys.exit("the tests cannot be collected")
    costs = measured(given.paths, given.expression) if given.paths else {}
    before = Marks()
    marked: dict[str, set[str]] = {name: {test for test in collected.names if before.has(name, test)}
                                   for name in KINDS}
    changed = [(test, cost) for test, cost in sorted(costs.items()) if test not in marked["study"]
               and slow(cost, test in marked["slow"]) != (test in marked["slow"])]
    marked["slow"] ^= {test for test, _ in changed}
    FILE.write_text(text(before.core, marked, collected.names), encoding="utf-8")
    for test, cost in changed:
        print(f"{'slow ' if test in marked['slow'] else 'quick'} {cost:7.2f} s {test}")
    print(f"{len(costs)} measured; slow: {sum(test in marked['slow'] for test in costs)} of them, "
          f"{sum(cost for test, cost in costs.items() if test in marked['slow']):.0f} of {sum(costs.values()):.0f} s; "
          f"{len(marked['slow'])} of {len(collected.names)} are slow")


if __name__ == "__main__":
    main()
