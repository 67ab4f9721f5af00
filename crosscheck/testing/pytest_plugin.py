"""pytest plugin: runs and truths as fixtures, computed once a session; engines and profile as options.

A test says what it runs by arguments of `crosscheck_run`, or by the marker `crosscheck`, whose keywords stand for those
it leaves out; a marked test that names no engine runs once per engine. Nothing is imported before a test asks for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

MARKER = ("crosscheck(scene=, engine=, method=, step=, rtol=, **options): what crosscheck_run and crosscheck_truth "
          "take where a test leaves their arguments out; without an engine the test runs once per engine")

GIVEN: pytest.StashKey[dict[str, Any] | None] = pytest.StashKey()
"""What the marker and the parameters of the running test say; None where it has no marker."""

OPEN: pytest.StashKey[str | None] = pytest.StashKey()
"""The engine that was chosen for the running test because it leaves it open."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options of the command line."""
    group = parser.getgroup("crosscheck")
    group.addoption("--crosscheck-engine", action="append", metavar="NAME",
                    help="engine of the tests that leave it open: a name, name==version, module:Class or "
                         "path/file.py:Class; may be repeated; default: all")
    group.addoption("--crosscheck-profile", default="default", metavar="PROFILE",
                    help="default, or smoke: only the first seconds of scenes whose duration a test leaves open")


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker."""
    config.addinivalue_line("markers", MARKER)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test per engine where the marker leaves the engine open, or the test asks for `crosscheck_engine`."""
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
    """Let the fixtures of the session know which test asks."""
    marker = item.get_closest_marker("crosscheck")
    call = getattr(item, "callspec", None)
    engine = call.params.get("crosscheck_engine") if call is not None else None
    item.config.stash[OPEN] = engine if marker is None or "engine" not in marker.kwargs else None
    item.config.stash[GIVEN] = None if marker is None else {"engine": engine, **marker.kwargs}


@pytest.fixture
def crosscheck_engine(request: pytest.FixtureRequest) -> str:
    """Name of an engine: that of the marker, else each one of --crosscheck-engine, else each one there is."""
    return str(request.param)


@pytest.fixture(scope="session")
def _crosscheck_session(request: pytest.FixtureRequest) -> Any:
    from crosscheck.testing.session import Session

    config = request.config
    return Session(config.getoption("--crosscheck-profile"), lambda: config.stash.get(GIVEN, None))


@pytest.fixture(scope="session")
def crosscheck_run(_crosscheck_session: Any, request: pytest.FixtureRequest) -> Callable[..., Any]:
    """`crosscheck.run` that remembers: the same arguments a second time return the same trajectory at once.

    Called with a Scene, a built-in name or a path, then as `crosscheck.run`. What is left out comes from the marker;
    left out there too, the method is the engine's last of the highest documented order, and in a marked test the step
    or rtol such that documented bounds judge. Where a test leaves the engine open, one that cannot run it, or that is
    not installed and that no option asked for, skips the test with its reason. Failed runs are not remembered. The
    arrays of a trajectory are shared between tests: they are read-only.
    """
    stash = request.config.stash

    def run(*arguments: Any, **options: Any) -> Any:
        from crosscheck.errors import EngineError, Unsupported

        try:
            return _crosscheck_session.run(*arguments, **options)
        except (EngineError, Unsupported) as error:
            named = arguments[1] if len(arguments) > 1 else options.get("engine")
            chosen = stash.get(OPEN, None)
            absent = (isinstance(error.__cause__, ModuleNotFoundError)
                      and not request.config.getoption("--crosscheck-engine"))
            if chosen is not None and named in (None, chosen) and (absent or isinstance(error, Unsupported)):
                pytest.skip(str(error))
            raise

    return run


@pytest.fixture(scope="session")
def crosscheck_truth(_crosscheck_session: Any) -> Callable[..., Any]:
    """`crosscheck.truth` that remembers within the session, on top of its cache on disk; the arrays are read-only.

    Takes a trajectory too, which stands for its scene; without an argument: the scene of the marker.
    """
    def truth(*arguments: Any, **options: Any) -> Any:
        return _crosscheck_session.truth(*arguments, **options)

    return truth


@pytest.fixture(scope="session")
def crosscheck_check(_crosscheck_session: Any) -> Callable[..., None]:
    """Assert that a trajectory of `crosscheck_run` agrees with truth: `crosscheck_check(traj, tol=None)`.

    The bounds and `tol` are those of `crosscheck.assert_agree`; its message names quantity, bound, reason, the first
    time of violation and the worst body.
    """
    def check(*arguments: Any, **options: Any) -> None:
        __tracebackhide__ = True
        _crosscheck_session.check(*arguments, **options)

    return check
