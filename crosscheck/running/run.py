"""Run one scene on one engine. Whatever an engine raises becomes an `EngineError`."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.errors import CrosscheckError, EngineError, Unsupported, install
from crosscheck.files import readable
from crosscheck.running import arguments
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene

if TYPE_CHECKING:
    from crosscheck.references.base import Reference
    from crosscheck.running.trajectory import Trajectory


def run(scene: Scene | str | os.PathLike[str], engine: str, method: str, step: float | None = None,
        rtol: float | None = None, **options: Any) -> Trajectory:
    """Integrate `scene` with one method of one engine and return its `Trajectory`.

    Parameters
    ----------
    scene : Scene, str or path
        A scene from `crosscheck.load_scene`, the name of a bundled scene, or the path of a scene file.
    engine, method : str
        Names from `crosscheck.engines()` and `crosscheck.methods(engine)`. To run your own engine, write
        "module:Class" or "path/file.py:Class". To run another version of an engine, write "mujoco==3.3.7": it gets
        its own Python environment.
    step : float, optional
        Fixed step, s. It is shortened to the nearest step that divides the sample interval.
    rtol : float, optional
        Relative tolerance of an adaptive method; not together with `step`.
    **options
        `samples` and `duration` (s) replace those of the scene. `monitor` (default True) evaluates the maxima over
        every step. `form`, `coordinate_map`, `spin_free`, `reduce`, `polish`, `alpha`, `beta`, `spectral_radius`,
        `softness` and `node` are options of some engines; an engine that lacks the option refuses it. Only
        spin_free=False is allowed for every engine: it is the default.

    Raises
    ------
    ArgumentError
        An argument is wrong. The message names it and says what is allowed.
    SceneError
        The scene is unknown, unreadable or wrong.
    Unsupported
        The engine cannot model this scene at all, or not with this form, method or spin_free=True.
    EngineError
        The engine failed or the run diverged. The message repeats what the engine said.
    lieeuler.IntegrationError
        A run of lieeuler ended early. The error holds the status, some advice and the trajectory so far.
    """
    scene = scene_file.as_scene(scene)
    adapter = adapters.get(engine)
    spec = arguments.request(engine, adapter, method, step, rtol, options)
    scene = arguments.overridden(scene, options)
    arguments.check_length(scene, spec)
    reason = adapter.unsupported(scene, spec)
    if reason is not None:
        raise Unsupported(f"{engine} {method} on scene {scene.name!r}: {reason}")
    try:
        raw = adapter.run(scene, spec)
    except CrosscheckError:
        raise
    except ImportError as error:
        raise EngineError(readable(f"{adapter.name} cannot be imported: {error}; {install(adapter.name)}")) from error
    except Exception as error:
        raise EngineError(readable(f"{adapter.name} {method}: {type(error).__name__}: {error}")) from error
    _check_states(engine, spec, scene, raw)
    from crosscheck.running.trajectory import derive

    return derive(scene, engine, method, raw)


def truth(scene: Scene | str | os.PathLike[str]) -> Reference:
    """The independent truth of a scene (a Scene, a name or a path), read from the cache if it is in it.

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
    from crosscheck import references

    return references.truth(loaded)


def _check_states(engine: str, spec: RunSpec, scene: Scene, raw: RawRun) -> None:
    states = raw.states
    if len(states.t) != scene.samples:
        raise EngineError(f"{engine} {spec.method} returned {len(states.t)} samples, not {scene.samples}")
    vectors = (scene.samples, scene.n, 3)
    for name, shape in {"x": vectors, "R": (*vectors, 3), "v": vectors, "w": vectors, "a": vectors,
                        "alpha": vectors}.items():
        values = getattr(states, name)
        if values is not None and values.shape != shape:
            raise EngineError(f"{engine} {spec.method} returned {name} of shape {values.shape}, not {shape}")
        if values is not None and values.dtype.kind not in "iuf":
            raise EngineError(f"{engine} {spec.method} returned {name} of type {values.dtype}, not of real numbers")
    if not np.allclose(states.t, scene.t, rtol=0, atol=1e-9 * scene.duration):  # a NaN is not close either
        raise EngineError(f"{engine} {spec.method} returned states at other times than the output times scene.t")
    finite = np.ones(scene.samples, dtype=bool)
    for values in (states.x, states.R, states.v, states.w):
        finite &= np.isfinite(values.reshape(scene.samples, -1)).all(axis=1)
    if not finite.all():
        raise EngineError(f"{engine} {spec.method} diverged: the state is not finite at "
                          f"t = {states.t[np.argmin(finite)]:.6g} s; try a smaller step")
