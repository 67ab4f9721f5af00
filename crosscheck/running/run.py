"""The public `run` and `truth` of one scene."""

from __future__ import annotations

import dataclasses
import os
from typing import Any, cast

from crosscheck import references
from crosscheck.adapters.base import Engine
from crosscheck.document import Way
from crosscheck.references.base import Reference
from crosscheck.running.attempt import Ran, attempt
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene
from crosscheck.scene.sensors import readings


def run(scene: Scene | str | os.PathLike[str], engine: str | Engine, method: str, step: float | None = None,
        rtol: float | None = None, **options: Any) -> Trajectory:
    """Integrate `scene` with one method of one engine and return its `Trajectory`.

    Parameters
    ----------
    scene : Scene, str or path
        A scene from `crosscheck.load_scene`, the name of a bundled scene, or the path of a scene file.
    engine : str or object
        A name from `crosscheck.engines()`. To run your own engine, write "module:Class" or "path/file.py:Class", or
        give an object of the class. To run another version of an engine, write "mujoco==3.3.7": it gets its own
        Python environment.
    method : str
        A name from `crosscheck.methods(engine)`.
    step : float, optional
        Fixed step, s. It is shortened to the nearest step that divides the sample interval.
    rtol : float, optional
        Relative tolerance of an adaptive method; not together with `step`.
    **options
        `samples` and `duration` (s) replace those of the scene. `monitor` (default True) evaluates the maxima over
        every step. `form`, `coordinate_map`, `spin_free`, `reduce`, `polish`, `alpha`, `beta`, `spectral_radius`,
        `correction`, `conserve`,
        `softness` and `node` are options of some engines; an engine that lacks the option refuses it. Only
        spin_free=False is allowed for every engine: it is the default.

    Raises
    ------
    ArgumentError
        An argument is wrong. The message names it and says what is allowed.
    SceneError
        The scene is unknown, unreadable or wrong.
    Unsupported
        The engine cannot model this scene at all, or not with this form, method or spin_free=True; or the motion ends
        where nothing says how it goes on.
    EngineError
        The engine failed or the run diverged. The message repeats what the engine said.
    lieeuler.IntegrationError
        A run of lieeuler ended early. The error holds the status, some advice and the trajectory so far.
    """
    name: Any = engine  # None is told as wrong there
    if not isinstance(engine, str | None):
        name = str(getattr(engine, "name", type(engine).__name__))
    outcome = attempt(scene_file.as_scene(scene), Way(name, method, step, rtol),
                      None if name is engine else cast(Engine, engine), **options)
    if isinstance(outcome, Ran):
        return outcome.trajectory
    raise outcome.error


def truth(scene: Scene | str | os.PathLike[str]) -> Reference:
    """The independent truth of a scene (a Scene, a name or a path), read from the cache if it is in it.

    After its horizon its states and sensors are NaN: there is no truth.

    Raises
    ------
    ArgumentError, SceneError
        As in `crosscheck.run`.
    Unsupported
        The reference equations do not cover the scene. The message says why.
    TruthError
        The two formulations of the truth disagree by more than the conditioning of the scene explains.
    """
    loaded = scene_file.as_scene(scene)
    reference = references.truth(loaded)
    if loaded.sensors:
        reference.states.sensors = readings(loaded, reference.states)
    return dataclasses.replace(reference, states=reference.states.until(reference.horizon))
