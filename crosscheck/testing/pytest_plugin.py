"""pytest plugin: runs and truths as fixtures, computed once per session; engines and profile as options.

A test gives the arguments of a run to `crosscheck_run`, or as keywords of the marker `crosscheck`, which are used for
arguments that the call leaves out. A marked test without an engine runs once per engine. Imports happen on first use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from crosscheck.references.base import Reference
    from crosscheck.scene.model import Scene

MARKER = ("crosscheck(scene=, engine=, method=, step=, rtol=, **options): default arguments of crosscheck_run and "
          "crosscheck_truth in this test; without an engine the test runs once per engine")

GIVEN: pytest.StashKey[dict[str, Any] | None] = pytest.StashKey()
"""The keywords of the running test's marker, with its engine; None without a marker."""

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


@pytest.fixture
def crosscheck_engine(request: pytest.FixtureRequest) -> str:
    """Name of an engine: that of the marker, else each one of --crosscheck-engine, else each known one."""
    return str(request.param)


@pytest.fixture(scope="session")
def _crosscheck_session(request: pytest.FixtureRequest) -> Any:
    config = request.config
    return Session(config.getoption("--crosscheck-profile"), lambda: config.stash.get(GIVEN, None))


@pytest.fixture(scope="session")
def crosscheck_run(_crosscheck_session: Any, request: pytest.FixtureRequest) -> Callable[..., Any]:
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
    """`crosscheck.truth` with a memory for the session, besides its cache on disk; the arrays are read-only.

    It also takes a trajectory, for its scene; without an argument it takes the scene of the marker.
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


class Session:
    """Remembers runs and truths.

    Parameters
    ----------
    profile : name of a profile of `crosscheck verify`; a profile that does not run whole scenes shortens scenes whose
        duration a test does not give to the first seconds, those of the order studies
    given : returns the keywords of the running test's marker, None without a marker
    """

    def __init__(self, profile: str, given: Callable[[], Mapping[str, Any] | None]) -> None:
        from crosscheck.judge.plan import profile as profile_called

        self._whole, self._given = profile_called(profile).whole, given
        self._runs: dict[tuple[Any, ...], Any] = {}
        self._truths: dict[str, Reference] = {}
        self._asked: dict[int, tuple[Any, dict[str, Any]]] = {}  # trajectory and options by its identity

    def run(self, scene: Any = None, engine: Any = None, method: Any = None, **options: Any) -> Any:
        """A trajectory; see the fixture `crosscheck_run`."""
        from crosscheck.running.run import run

        marked = self._given()
        scene, engine, method, options = _merged(scene, engine, method, options, marked or {})
        loaded = self._loaded(scene, options)
        if engine is not None and (method is None or (marked is not None and not {"step", "rtol"} & set(options))):
            from crosscheck.testing.agreement import contender

            chosen = contender((engine, method, options), _with(loaded, options), self.truth(_with(loaded, options)))
            method, options = chosen.method, chosen.arguments
        # The name is not part of the hash, but of a trajectory.
        key = (loaded.hash, loaded.name, engine, method, tuple(sorted(options.items())))
        try:
            hash(key)
        except TypeError:  # a list or an array among the arguments, which `crosscheck.run` will refuse
            return self._kept(run(loaded, engine, method, **options), options)
        if key not in self._runs:
            self._runs[key] = self._kept(run(loaded, engine, method, **options), options)
        return self._runs[key]

    def truth(self, scene: object = None) -> Any:
        """A reference; see the fixture `crosscheck_truth`."""
        from crosscheck.references import truth as truth_of

        if hasattr(scene, "scene"):  # a trajectory
            scene = scene.scene
        if scene is None:
            scene, _, _, options = _merged(None, None, None, {}, self._given() or {})
            loaded = _with(self._loaded(scene, options), options)
        else:
            loaded = self._loaded(scene, {})
        if loaded.hash not in self._truths:
            reference = truth_of(loaded)
            _frozen(reference.states)
            self._truths[loaded.hash] = reference
        return self._truths[loaded.hash]

    def check(self, traj: Any, tol: Any = None) -> None:
        """Assert that a run agrees with truth; see the fixture `crosscheck_check`."""
        __tracebackhide__ = True
        from crosscheck.errors import ArgumentError
        from crosscheck.testing.agreement import assert_agree

        if id(traj) not in self._asked:
            raise ArgumentError("crosscheck_check: a trajectory of crosscheck_run is wanted; for another one there is "
                                "crosscheck.assert_agree")
        _, options = self._asked[id(traj)]
        assert_agree(traj.scene, [(traj.engine, traj.method, options)], tol, run=lambda *_, **__: traj,
                     truth=self.truth)

    def _kept(self, traj: object, options: dict[str, Any]) -> Any:
        self._asked[id(traj)] = traj, options
        return _frozen(traj)

    def _loaded(self, scene: Any, options: Mapping[str, Any]) -> Scene:
        from crosscheck.errors import ArgumentError
        from crosscheck.judge.plan import PLANS
        from crosscheck.scene.file import as_scene
        from crosscheck.scene.model import Scene

        if scene is None:
            raise ArgumentError("scene: name it as an argument, or with the marker crosscheck(scene=...)")
        loaded = as_scene(scene)
        if self._whole or isinstance(scene, Scene) or options.get("duration") is not None:
            return loaded
        window = PLANS[scene].window if isinstance(scene, str) and scene in PLANS else 1.0
        return loaded.replace(duration=min(window, loaded.duration))


def _merged(scene: object, engine: object, method: object, options: dict[str, Any],
            marked: Mapping[str, Any]) -> tuple[Any, ...]:
    """The arguments of a call, completed from the marker; a step or rtol in the call replaces both in the marker."""
    kept = {key: value for key, value in marked.items() if key not in ("scene", "engine", "method")}
    if {"step", "rtol"} & set(options):
        kept = {key: value for key, value in kept.items() if key not in ("step", "rtol")}
    first = (value if value is not None else marked.get(name)
             for name, value in (("scene", scene), ("engine", engine), ("method", method)))
    return *first, {**kept, **options}


def _with(scene: Scene, options: Mapping[str, Any]) -> Scene:
    """The scene with the duration and the samples from the options of a run."""
    changes = {key: options[key] for key in ("duration", "samples") if options.get(key) is not None}
    return scene.replace(**changes) if changes else scene


def _frozen(record: Any) -> Any:
    """Make every array of a record read-only, so that a test cannot change it for the next one."""
    import dataclasses

    import numpy as np

    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return record
