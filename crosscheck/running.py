"""Running one scene on one engine: argument checks, the run, and one kind of error whatever the engine did."""

from __future__ import annotations

import dataclasses
import math
import numbers
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck import engines
from crosscheck.engines.base import Engine, RawRun, RunSpec
from crosscheck.errors import ArgumentError, EngineError, SceneError, Unsupported
from crosscheck.scene import Scene
from crosscheck.spelling import unknown

if TYPE_CHECKING:
    from crosscheck.trajectory import Trajectory

SCENE_OPTIONS = ("samples", "duration")
ENGINE_OPTIONS = ("form", "coordinate_map", "spin_free", "alpha", "beta")
OPTIONS = (*SCENE_OPTIONS, "monitor", *ENGINE_OPTIONS)
CHOICES = {"form": ("tree", "maximal", "pivot"), "coordinate_map": ("exp", "cayley", "ccsk")}


def run(scene: Scene, engine: str, method: str, step: float | None = None, rtol: float | None = None,
        **options: Any) -> Trajectory:
    """Integrate `scene` with one method of one engine and return its `Trajectory`.

    Parameters
    ----------
    scene : Scene
        From `crosscheck.load_scene`.
    engine, method : str
        Names from `crosscheck.engines()` and `crosscheck.methods(engine)`.
    step : float, optional
        Fixed step, s; shortened to the nearest one that divides the sample interval.
    rtol : float, optional
        Relative tolerance of an adaptive method; not together with `step`.
    **options
        samples, duration (s) override the scene's; monitor (default True) evaluates the maxima over every step; form,
        coordinate_map, spin_free, alpha, beta go to the engines that know them.

    Raises
    ------
    ArgumentError
        A wrong argument, with its name and what is allowed.
    Unsupported
        The engine cannot model this scene, or not in this form or with this method.
    EngineError
        The engine failed or the run diverged; what it said. `lieeuler.IntegrationError` passes through unchanged.
    """
    if not isinstance(scene, Scene):
        raise ArgumentError(f"scene: a Scene is wanted, not {type(scene).__name__}; read one with "
                            "crosscheck.load_scene(name or path)")
    adapter = engines.get(engine)
    spec = _spec(engine, adapter, method, step, rtol, options)
    scene = _overridden(scene, options)
    reason = adapter.unsupported(scene, spec)
    if reason is not None:
        raise Unsupported(f"{engine} {method} on scene {scene.name!r}: {reason}")
    raw = _guarded(adapter, scene, spec)
    _check_states(engine, spec, scene, raw)
    from crosscheck.trajectory import derive

    return derive(scene, engine, method, raw)


def _spec(engine: str, adapter: Engine, method: str, step: float | None, rtol: float | None,
          options: dict[str, Any]) -> RunSpec:
    if method not in adapter.methods:
        raise ArgumentError(unknown(f"method of {engine}", method, adapter.methods))
    for name in options:
        if name not in OPTIONS:
            raise ArgumentError(unknown("option", name, OPTIONS))
    if step is not None and rtol is not None:
        raise ArgumentError("step and rtol: only one of them can be given")
    given = {name: options[name] for name in ENGINE_OPTIONS if options.get(name) is not None}
    known = getattr(adapter, "options", ENGINE_OPTIONS)
    for name in given:
        if name not in known:
            has = ", ".join(sorted(known)) or "none"
            raise ArgumentError(f"{name}: {engine} does not have this option; it has {has}")
    for name, choices in CHOICES.items():
        if name in given and given[name] not in choices:
            raise ArgumentError(unknown(name, given[name], choices))
    for name in ("alpha", "beta"):
        if name in given:
            given[name] = _number(name, given[name], lowest=0.0)
    for name in ("spin_free", "monitor"):
        if not isinstance(options.get(name, True), bool | None):
            raise ArgumentError(f"{name}: True or False is wanted, not {options[name]!r}")
    monitor = options.get("monitor") is not False
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
        samples = options["samples"]
        if isinstance(samples, bool) or not isinstance(samples, numbers.Integral) or samples < 2:
            raise ArgumentError(f"samples: a whole number of at least 2 is wanted, not {samples!r}")
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
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value) or value < lowest:
        raise ArgumentError(f"{name}: a finite number not below {lowest:g} is wanted, not {value!r}")
    return float(value)


def _guarded(adapter: Engine, scene: Scene, spec: RunSpec) -> RawRun:
    """`adapter.run`, with every failure that is not one of our own errors told as an `EngineError`."""
    try:
        return adapter.run(scene, spec)
    except (ArgumentError, EngineError, SceneError, Unsupported):
        raise
    except ImportError as error:
        raise EngineError(f"{adapter.name} cannot be imported: {error}; install it") from error
    except Exception as error:
        if _is_own(error):
            raise
        raise EngineError(f"{adapter.name} {spec.method}: {type(error).__name__}: {error}") from error


def _is_own(error: Exception) -> bool:
    """Whether `error` is `lieeuler.IntegrationError`, which carries more than a message; lieeuler is not imported."""
    kind = getattr(sys.modules.get("lieeuler"), "IntegrationError", None)
    return kind is not None and isinstance(error, kind)


def _check_states(engine: str, spec: RunSpec, scene: Scene, raw: RawRun) -> None:
    states = raw.states
    if len(states.t) != scene.samples:
        raise EngineError(f"{engine} {spec.method} returned {len(states.t)} samples, not {scene.samples}")
    finite = np.ones(scene.samples, dtype=bool)
    for values in (states.x, states.R, states.v, states.w):
        finite &= np.isfinite(values.reshape(scene.samples, -1)).all(axis=1)
    if not finite.all():
        raise EngineError(f"{engine} {spec.method} diverged: the state is not finite at "
                          f"t = {states.t[np.argmin(finite)]:.6g} s; try a smaller step")
