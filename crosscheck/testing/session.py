"""The memory of the pytest plugin: runs and truths, computed once a session."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError
from crosscheck.references import truth as truth_of
from crosscheck.references.base import Reference
from crosscheck.running.run import run
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.file import as_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.testing.agreement import assert_agree, contender
from crosscheck.verification.plan import profile as profile_called


class Session:
    """Remembers runs and truths.

    Parameters
    ----------
    profile : name of a profile of `crosscheck verify`; one that does not run whole scenes shortens those whose
        duration a test does not give
    given : returns the keywords of the running test's marker, None without a marker
    """

    def __init__(self, profile: str, given: Callable[[], Mapping[str, object] | None]) -> None:
        self._most, self._given = profile_called(profile).most_seconds, given
        self._runs: dict[tuple[object, ...], Trajectory] = {}
        self._truths: dict[str, Reference] = {}
        self._asked: dict[int, tuple[Trajectory, dict[str, Any]]] = {}  # trajectory and options by its identity

    def run(self, scene: Any = None, engine: Any = None, method: Any = None, **options: Any) -> Trajectory:
        """A trajectory; see the fixture `crosscheck_run`."""
        marked = self._given()
        scene, engine, method, options = _merged(scene, engine, method, options, marked or {})
        loaded = self._loaded(scene, options)
        if engine is not None and (method is None or (marked is not None and not {"step", "rtol"} & set(options))):
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

    def truth(self, scene: Trajectory | Scene | str | None = None) -> Reference:
        """A reference; see the fixture `crosscheck_truth`."""
        if isinstance(scene, Trajectory):
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

    def check(self, traj: Trajectory, tol: object = None, need: float = 1.0) -> str:
        """Assert that a run agrees with truth; see the fixture `crosscheck_check`. Returns why it is known, if it is.
        """
        __tracebackhide__ = True
        if id(traj) not in self._asked:
            raise ArgumentError("crosscheck_check: a trajectory of crosscheck_run is wanted; for another one there is "
                                "crosscheck.assert_agree")
        _, options = self._asked[id(traj)]
        records = assert_agree(traj.scene, [(traj.engine, traj.method, options)], tol, need=need,
                               run=lambda *_, **__: traj, truth=self.truth)
        return next((each.why for record in records for each in record.findings if each.status == "known"), "")

    def _kept(self, traj: Trajectory, options: dict[str, Any]) -> Trajectory:
        self._asked[id(traj)] = traj, options
        _frozen(traj)
        return traj

    def _loaded(self, scene: Any, options: Mapping[str, Any]) -> Scene:
        if scene is None:
            raise ArgumentError("scene: name it as an argument, or with the marker crosscheck(scene=...)")
        loaded = as_scene(scene)
        if self._most is None or isinstance(scene, Scene) or options.get("duration") is not None:
            return loaded
        return loaded.replace(duration=min(self._most, loaded.duration))


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


def _frozen(record: Trajectory | States) -> None:
    """Make every array of a record read-only, so that a test cannot change it for the next one."""
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
