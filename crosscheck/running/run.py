"""Running one scene on one engine, with one kind of error whatever the engine did.

Scenes are given as such, by name or by path.
"""

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
        From `crosscheck.load_scene`, or what it takes.
    engine, method : str
        Names from `crosscheck.engines()` and `crosscheck.methods(engine)`. An engine is also "module:Class" or
        "path/file.py:Class", one of your own, or "mujoco==3.3.7", another version, in an environment of its own.
    step : float, optional
        Fixed step, s; shortened to the nearest one that divides the sample interval.
    rtol : float, optional
        Relative tolerance of an adaptive method; not together with `step`.
    **options
        samples, duration (s) override the scene's; monitor (default True) evaluates the maxima over every step; form,
        coordinate_map, spin_free, reduce, polish, alpha, beta, spectral_radius, softness, node go to the engines
        that know them. spin_free=False is what every engine does by itself.

    Raises
    ------
    ArgumentError
        A wrong argument, with its name and what is allowed.
    SceneError
        The scene is unknown, unreadable or wrong.
    Unsupported
        The engine cannot model this scene, or not in this form, with this method or with spin_free=True.
    EngineError
        The engine failed or the run diverged; what it said.
    lieeuler.IntegrationError
        A run of lieeuler ended early; it carries status, advice and the trajectory so far.
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
    """Independent truth of a scene (a Scene, a name or a path), from the cache where it is there.

    Raises
    ------
    ArgumentError, SceneError
        As `crosscheck.run`.
    Unsupported
        The scene is outside the reference equations; the message says why.
    TruthError
        The two formulations disagree beyond what the scene's conditioning explains.
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
