"""pytest plugin: runs and truths as fixtures, computed once per session; engines and profile as options.

A test gives the arguments of a run to `crosscheck_run`, or as keywords of the marker `crosscheck`, which are used for
arguments that the call leaves out. A marked test without an engine runs once per engine. Imports happen on first use.

Tests end by the outcomes of `crosscheck.document.outcomes`: "fail" and "unresolved" fail with the word, "known" passes
with it, an engine that does not run is an error, and one that cannot model the scene skips a test that leaves it open.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any

import pytest

from crosscheck.errors import EngineError, Unsupported

if TYPE_CHECKING:
    from crosscheck.testing.session import Session

MARKER = ("crosscheck(scene=, engine=, method=, step=, rtol=, **options): default arguments of crosscheck_run and "
          "crosscheck_truth in this test; without an engine the test runs once per engine")

GIVEN: pytest.StashKey[dict[str, object] | None] = pytest.StashKey()
"""The keywords of the running test's marker, with its engine; None without a marker."""

KNOWN: pytest.StashKey[str] = pytest.StashKey()
"""Why the running test passes although what it checked is wrong."""

OPEN: pytest.StashKey[str | None] = pytest.StashKey()
"""The engine chosen for the running test because the test does not name one."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options of the command line."""
    group = parser.getgroup("crosscheck")
    group.addoption("--crosscheck-engine", action="append", metavar="NAME",
                    help="engine for tests that do not name one: a name, name==version, module:Class or "
                         "path/file.py:Class; may be repeated; default: all")
    group.addoption("--crosscheck-profile", default="default", metavar="PROFILE",
                    help="default, or smoke: only the first seconds of scenes whose duration a test does not give")
    group.addoption("--crosscheck-need", type=float, default=1.0, metavar="SHARE",
                    help="share of a run's time that crosscheck_check has to compare with truth; default: 1")


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker."""
    config.addinivalue_line("markers", MARKER)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make one test per engine if the marker names no engine, or if the test uses `crosscheck_engine`."""
    marker = metafunc.definition.get_closest_marker("crosscheck")
    asked = "crosscheck_engine" in metafunc.fixturenames
    if not asked and (marker is None or "engine" in marker.kwargs):
        return
    if not asked:
        metafunc.fixturenames.append("crosscheck_engine")
    if marker is not None and "engine" in marker.kwargs:
        engines = [marker.kwargs["engine"]]
    else:
        from crosscheck import adapters

        engines = list(dict.fromkeys(metafunc.config.getoption("--crosscheck-engine") or adapters.names()))
    metafunc.parametrize("crosscheck_engine", engines, indirect=True)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tell the session's fixtures the marker and the engine of the running test."""
    marker = item.get_closest_marker("crosscheck")
    call = getattr(item, "callspec", None)
    engine = call.params.get("crosscheck_engine") if call is not None else None
    item.config.stash[OPEN] = engine if marker is None or "engine" not in marker.kwargs else None
    item.config.stash[GIVEN] = None if marker is None else {"engine": engine, **marker.kwargs}
    item.config.stash[KNOWN] = ""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]
                              ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note the outcome where pytest has no word for it: an engine that did not run, a known defect."""
    report = yield
    outcome = ""
    if call.when == "call" and report.failed and call.excinfo is not None and call.excinfo.errisinstance(EngineError):
        outcome = "error"
    elif call.when == "call" and report.passed and (why := item.config.stash.get(KNOWN, "")):
        outcome = f"known: {why}"
    for each in (report, item) if outcome else ():  # JUnit's file has those of the item
        each.user_properties.append(("crosscheck", outcome))
    return report


def pytest_report_teststatus(report: pytest.CollectReport | pytest.TestReport
                             ) -> tuple[str, str, str | tuple[str, dict[str, bool]]] | None:
    """Category, letter and word of a test with such an outcome."""
    outcome = str(dict(getattr(report, "user_properties", ())).get("crosscheck", ""))
    if report.when != "call" or not outcome:
        return None
    return ("error", "E", "ERROR") if outcome == "error" else ("passed", "k", (outcome, {"yellow": True}))


@pytest.fixture
def crosscheck_engine(request: pytest.FixtureRequest) -> str:
    """Name of an engine: that of the marker, else each one of --crosscheck-engine, else each known one."""
    return str(request.param)


@pytest.fixture(scope="session")
def _crosscheck_session(request: pytest.FixtureRequest) -> Session:
    from crosscheck.testing.session import Session

    config = request.config
    return Session(config.getoption("--crosscheck-profile"), lambda: config.stash.get(GIVEN, None))


@pytest.fixture(scope="session")
def crosscheck_run(_crosscheck_session: Session, request: pytest.FixtureRequest) -> Callable[..., Any]:
    """`crosscheck.run` with a memory: the same arguments return the same trajectory without running again.

    The scene is a Scene, a built-in name or a path; the other arguments are those of `crosscheck.run`. Arguments that
    are left out come from the marker. Without a method in either, the engine's last one of the highest documented order
    is used, and in a marked test a step or rtol with which the documented bounds can judge. If the test names no
    engine, it is skipped, with the reason, for engines that cannot run it, and for engines that are neither installed
    nor requested by an option. Failed runs are not remembered. The arrays of a trajectory are read-only, because tests
    share them.
    """
    stash = request.config.stash

    def run(*arguments: Any, **options: Any) -> Any:
        try:
            return _crosscheck_session.run(*arguments, **options)
        except (EngineError, Unsupported) as error:
            named = arguments[1] if len(arguments) > 1 else options.get("engine")
            chosen = stash.get(OPEN, None)
            absent = (isinstance(error.__cause__, ModuleNotFoundError)
                      and not request.config.getoption("--crosscheck-engine"))
            if chosen is not None and named in (None, chosen) and (absent or isinstance(error, Unsupported)):
                pytest.skip(f"unsupported: {error}")
            raise

    return run


@pytest.fixture(scope="session")
def crosscheck_truth(_crosscheck_session: Session) -> Callable[..., Any]:
    """`crosscheck.truth` with a memory for the session, besides its cache on disk; the arrays are read-only.

    It also takes a trajectory, for its scene; without an argument it takes the scene of the marker.
    """
    def truth(*arguments: Any, **options: Any) -> Any:
        return _crosscheck_session.truth(*arguments, **options)

    return truth


@pytest.fixture(scope="session")
def crosscheck_check(_crosscheck_session: Session, request: pytest.FixtureRequest) -> Callable[..., None]:
    """Assert that a trajectory of `crosscheck_run` agrees with truth: `crosscheck_check(traj, tol=None, need=None)`.

    The bounds, `tol` and `need` are those of `crosscheck.assert_agree`, and so is the message; `need` is that of the
    option --crosscheck-need by default. Without `tol`, an engine that is wrong only by its known defects passes.
    """
    config = request.config

    def check(traj: Any, tol: object = None, need: float | None = None) -> None:
        __tracebackhide__ = True
        share = config.getoption("--crosscheck-need") if need is None else need
        if why := _crosscheck_session.check(traj, tol, share):
            config.stash[KNOWN] = why

    return check
