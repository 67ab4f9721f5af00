"""Running one scene on one engine: argument checks, the run, and one kind of error whatever the engine did.

Scenes are given as such, by name or by path; numbers as Python's or NumPy's.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import os
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.errors import ArgumentError, EngineError, SceneError, Unsupported, unknown
from crosscheck.scene import file as scene_file
from crosscheck.scene.checks import MOST_SAMPLES
from crosscheck.scene.model import Scene

if TYPE_CHECKING:
    from crosscheck.references.base import Reference
    from crosscheck.running.trajectory import Trajectory

SCENE_OPTIONS = ("samples", "duration")
ENGINE_OPTIONS = ("form", "coordinate_map", "spin_free", "alpha", "beta", "softness", "node")
OPTIONS = (*SCENE_OPTIONS, "monitor", *ENGINE_OPTIONS)
CHOICES = {"form": ("tree", "maximal", "pivot"), "coordinate_map": ("exp", "cayley", "ccsk"),
           "softness": ("tight", "default"), "node": ("lie", "euler_parameters")}

MOST_STEPS = 1e10
"""Of one run; the fastest engine here needs an hour for them, and a longer run is a misprint of the step."""


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
        coordinate_map, spin_free, alpha, beta, softness, node go to the engines that know them. spin_free=False is what
        every engine does by itself.

    Raises
    ------
    ArgumentError
        A wrong argument, with its name and what is allowed.
    SceneError
        The scene is unknown, unreadable or wrong.
    Unsupported
        The engine cannot model this scene, or not in this form, with this method or with spin_free=True.
    EngineError
        The engine failed or the run diverged; what it said. `lieeuler.IntegrationError` passes through unchanged.
    """
    scene = scene_file.as_scene(scene)
    adapter = adapters.get(engine)
    spec = _spec(engine, adapter, method, step, rtol, options)
    scene = _overridden(scene, options)
    _check_length(scene, spec)
    reason = adapter.unsupported(scene, spec)
    if reason is not None:
        raise Unsupported(f"{engine} {method} on scene {scene.name!r}: {reason}")
    raw = _guarded(adapter, scene, spec)
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


def _spec(engine: str, adapter: Engine, method: str, step: float | None, rtol: float | None,
          options: dict[str, Any]) -> RunSpec:
    if not isinstance(method, str):
        raise ArgumentError(f"method: a name is wanted, not {type(method).__name__}; allowed: "
                            f"{', '.join(adapter.methods)}")
    if method not in adapter.methods:
        raise ArgumentError(unknown(f"method of {engine}", method, adapter.methods))
    for name in options:
        if name not in OPTIONS:
            raise ArgumentError(unknown("option", name, OPTIONS))
    if step is not None and rtol is not None:
        raise ArgumentError("step and rtol: only one of them can be given")
    given = {name: options[name] for name in ENGINE_OPTIONS if options.get(name) is not None}
    known = getattr(adapter, "options", ENGINE_OPTIONS)
    for name in ("spin_free", "monitor"):
        if not isinstance(options.get(name), bool | np.bool_ | None):
            raise ArgumentError(f"{name}: True or False is wanted, not {options[name]!r}")
    if "spin_free" in given:
        given["spin_free"] = bool(given["spin_free"])
        if "spin_free" not in known and given.pop("spin_free"):
            raise Unsupported(f"{engine} {method}: spin_free=True is not available; leave it out")
    for name in given:
        if name not in known:
            has = ", ".join(sorted(known)) or "none"
            raise ArgumentError(f"{name}: {engine} does not have this option; it has {has}")
    for name, choices in CHOICES.items():
        if name in given and not (isinstance(given[name], str) and given[name] in choices):
            raise ArgumentError(unknown(name, given[name], choices))
    for name in ("alpha", "beta"):
        if name in given:
            given[name] = _number(name, given[name], lowest=0.0)
    flag = options.get("monitor")
    monitor = flag is None or bool(flag)
    spec = RunSpec(method, _positive("step", step), _positive("rtol", rtol), monitor=monitor, **given)
    _check_step_control(engine, adapter, spec)
    return spec


def _check_step_control(engine: str, adapter: Engine, spec: RunSpec) -> None:
    """Adapters that name their `adaptive_methods` get step and rtol checked here; others answer for themselves."""
    adaptive = getattr(adapter, "adaptive_methods", None)
    if adaptive is None or spec.method in adaptive:
        return
    if spec.rtol is not None:
        raise ArgumentError(f"rtol: {engine} {spec.method} runs with a fixed step here; give step= (s) instead")
    if spec.step is None:
        raise ArgumentError(f"step: {engine} {spec.method} needs a fixed step; give step= (s)")


def _overridden(scene: Scene, options: dict[str, Any]) -> Scene:
    changes: dict[str, Any] = {}
    if options.get("samples") is not None:
        samples = _scalar(options["samples"])
        whole = isinstance(samples, numbers.Integral) and not isinstance(samples, bool)
        if not whole or not 2 <= samples <= MOST_SAMPLES:
            raise ArgumentError(f"samples: a whole number of at least 2 and at most {MOST_SAMPLES} is wanted, not "
                                f"{_brief(samples)}")
        changes["samples"] = int(samples)
    if options.get("duration") is not None:
        changes["duration"] = _positive("duration", options["duration"])
    return dataclasses.replace(scene, **changes) if changes else scene


def _positive(name: str, value: Any) -> float | None:
    if value is None:
        return None
    number = _number(name, value, lowest=0.0)
    if number == 0.0:
        raise ArgumentError(f"{name}: a positive number is wanted, not {value!r}")
    return number


def _number(name: str, value: Any, lowest: float) -> float:
    """`value` as a double: the one nearest to the decimals it is written with, where it has fewer bits.

    `np.float32(0.01)` is meant as 0.01; taken bit by bit it is smaller, and one step more would fit into an interval.
    """
    given = _scalar(value)
    try:
        number = math.nan
        if isinstance(given, numbers.Real) and not isinstance(given, bool):
            number = float(str(given)) if isinstance(given, np.floating) else float(given)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or number < lowest:
        raise ArgumentError(f"{name}: a finite number not below {lowest:g} is wanted, not {_brief(value)}")
    return number


def _scalar(value: Any) -> Any:
    """The scalar in an array without axes; anything else as it is."""
    return value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _brief(value: Any) -> str:
    """A wrong value for a message, in one line that stays readable whatever was given."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return f"this {type(value).__name__}"
    return text if len(text) <= 60 and "\n" not in text else f"this {type(value).__name__}"


def _check_length(scene: Scene, spec: RunSpec) -> None:
    """Steps beyond counting would end in an overflow or never."""
    if spec.step is not None and not max(scene.duration / spec.step, scene.samples) <= MOST_STEPS:
        raise ArgumentError(f"step: {spec.step:g} s cuts {scene.duration:g} s with {scene.samples} samples into more "
                            f"than {MOST_STEPS:g} steps; give a larger step or a shorter duration")


def _guarded(adapter: Engine, scene: Scene, spec: RunSpec) -> RawRun:
    """`adapter.run`, with every failure that is not one of our own errors told as an `EngineError`."""
    try:
        return adapter.run(scene, spec)
    except (ArgumentError, EngineError, SceneError, Unsupported):
        raise
    except ImportError as error:
        raise EngineError(f"{adapter.name} cannot be imported: {error}; install it") from error
    except Exception as error:
        if _is_lieeulers("IntegrationError", error):
            raise
        if _is_lieeulers("ArgumentError", error):
            raise ArgumentError(str(error)) from error
        raise EngineError(f"{adapter.name} {spec.method}: {type(error).__name__}: {error}") from error


def _is_lieeulers(kind: str, error: Exception) -> bool:
    """Whether `error` is lieeuler's error of this name; lieeuler is not imported for it.

    Its `IntegrationError` carries more than a message and passes; its `ArgumentError` becomes ours.
    """
    found = getattr(sys.modules.get("lieeuler"), kind, None)
    return found is not None and isinstance(error, found)


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
    if not np.allclose(states.t, scene.t, rtol=0, atol=1e-9 * scene.duration):  # a NaN is not close either
        raise EngineError(f"{engine} {spec.method} returned states at other times than the output times scene.t")
    finite = np.ones(scene.samples, dtype=bool)
    for values in (states.x, states.R, states.v, states.w):
        finite &= np.isfinite(values.reshape(scene.samples, -1)).all(axis=1)
    if not finite.all():
        raise EngineError(f"{engine} {spec.method} diverged: the state is not finite at "
                          f"t = {states.t[np.argmin(finite)]:.6g} s; try a smaller step")
