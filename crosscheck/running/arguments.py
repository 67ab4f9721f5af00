"""Check the arguments of a run and make one request of them. Numbers may be Python's or NumPy's."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np

from crosscheck.adapters.base import CHOICES, ENGINE_OPTIONS, Engine, RunSpec
from crosscheck.errors import ArgumentError, Unsupported, unknown
from crosscheck.scene.checks import MOST_SAMPLES
from crosscheck.scene.model import Scene

SCENE_OPTIONS = ("samples", "duration")
OF_RUNS = ("step", "rtol", *SCENE_OPTIONS, "monitor")
OPTIONS = (*OF_RUNS, *ENGINE_OPTIONS)

MOST_STEPS = 1e10
"""Most steps of one run. The fastest engine needs an hour for as many, so that more are taken for a mistyped step."""


def request(engine: str, adapter: Engine, method: str, options: Mapping[str, Any]) -> RunSpec:
    """The request of one run from the arguments of `crosscheck.run`; raises `ArgumentError` or `Unsupported`."""
    if not isinstance(method, str):
        raise ArgumentError(f"method: a name is wanted, not {type(method).__name__}; allowed: "
                            f"{', '.join(adapter.methods)}")
    if method not in adapter.methods:
        raise ArgumentError(unknown(f"method of {engine}", method, adapter.methods))
    for name in options:
        if name not in OPTIONS:
            raise ArgumentError(unknown(f"option of {engine}", name, (*OF_RUNS, *sorted(adapter.options))))
    step, rtol = options.get("step"), options.get("rtol")
    if step is not None and rtol is not None:
        raise ArgumentError("step and rtol: only one of them can be given")
    given = engine_options(engine, adapter, method, {name: options.get(name) for name in ENGINE_OPTIONS})
    flag = options.get("monitor")
    if not isinstance(flag, bool | np.bool_ | None):
        raise ArgumentError(f"monitor: True or False is wanted, not {flag!r}")
    monitor = flag is None or bool(flag)
    spec = RunSpec(method, positive("step", step), positive("rtol", rtol), monitor=monitor, **given)
    if not adapter.checks_sizes and method not in adapter.adaptive_methods:
        if spec.rtol is not None:
            raise ArgumentError(f"rtol: {engine} {method} runs with a fixed step here; give one in s, such as 1e-3")
        if spec.step is None:
            raise ArgumentError(f"step: {engine} {method} needs a fixed step; give one in s, such as 1e-3")
    if refused := adapter.refused_map(spec):
        raise ArgumentError(refused)
    return spec


def engine_options(engine: str, adapter: Engine, method: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of an engine that are not None, checked; raises `ArgumentError` or `Unsupported`."""
    given = {name: value for name, value in options.items() if value is not None}
    known = adapter.options
    for name in ("spin_free", "polish", "conserve", "events"):
        if not isinstance(given.get(name), bool | np.bool_ | None):
            raise ArgumentError(f"{name}: True or False is wanted, not {given[name]!r}")
        if name in given:
            given[name] = bool(given[name])
    if "spin_free" not in known and given.pop("spin_free", False):
        raise Unsupported(f"{engine} {method}: spin_free=True is not available; leave it out")
    for name in given:
        if name not in known:
            has = ", ".join(sorted(known)) or "none"
            raise ArgumentError(f"{name}: {engine} does not have this option; it has {has}")
    for name, choices in CHOICES.items():
        if name in given and not (isinstance(given[name], str) and given[name] in choices):
            raise ArgumentError(unknown(name, given[name], choices))
    for name in ("alpha", "beta", "spectral_radius"):
        if name in given:
            given[name] = _number(name, given[name], lowest=0.0)
    return given


def overridden(scene: Scene, options: Mapping[str, Any]) -> Scene:
    """The scene with the samples and the duration that the options ask for."""
    samples, duration = scene.samples, scene.duration
    if options.get("samples") is not None:
        given = _scalar(options["samples"])
        whole = isinstance(given, numbers.Integral) and not isinstance(given, bool)
        if not whole or not 2 <= given <= MOST_SAMPLES:
            raise ArgumentError(f"samples: a whole number of at least 2 and at most {MOST_SAMPLES} is wanted, not "
                                f"{_brief(given)}")
        samples = int(given)
    duration = positive("duration", options.get("duration")) or duration
    unchanged = (samples, duration) == (scene.samples, scene.duration)
    return scene if unchanged else scene.lasting(duration).replace(samples=samples)


def positive(name: str, value: object) -> float | None:
    """The value of an argument as a number, if it is one above 0, or None; raises `ArgumentError`."""
    if value is None:
        return None
    number = real(_scalar(value))
    if not 0.0 < number < math.inf:
        raise ArgumentError(f"{name}: a positive, finite number is wanted, not {_brief(value)}")
    return number


def _number(name: str, value: object, lowest: float) -> float:
    number = real(_scalar(value))
    if not math.isfinite(number) or number < lowest:
        raise ArgumentError(f"{name}: a finite number not below {lowest:g} is wanted, not {_brief(value)}")
    return number


def real(value: object) -> float:
    """`value` as a double: NaN if it is no number, infinite if it is too large.

    A NumPy number with fewer bits is read by its printed decimals. `np.float32(0.01)` is meant as 0.01: its exact value
    is smaller, so that an interval would take one step more.
    """
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return math.nan
    try:
        return float(str(value)) if isinstance(value, np.floating) else float(value)
    except OverflowError:
        return math.inf


def _scalar(value: object) -> Any:
    """The scalar inside an array without axes. Any other value is returned unchanged."""
    return value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _brief(value: object) -> str:
    """A wrong value as one short line for an error message."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return f"this {type(value).__name__}"
    return text if len(text) <= 60 and "\n" not in text else f"this {type(value).__name__}"


def check_length(scene: Scene, spec: RunSpec) -> None:
    """Raise `ArgumentError` where the run needs more than `MOST_STEPS` steps: it would overflow or never end."""
    if spec.step is not None and not max(scene.duration / spec.step, scene.samples) <= MOST_STEPS:
        raise ArgumentError(f"step: {spec.step:g} s cuts {scene.duration:g} s with {scene.samples} samples into more "
                            f"than {MOST_STEPS:g} steps; give a larger step or a shorter duration")


def best_method(adapter: Engine, scene: Scene) -> str:
    """The method with the highest documented order among those that can run this scene; the last of equal ones.

    Raises `Unsupported` where the engine cannot run the scene with any method.
    """
    specs = [RunSpec(method, step=1e-3) for method in adapter.methods]
    usable = [(adapter.documented_order(scene, spec) or 0, index) for index, spec in enumerate(specs)
              if adapter.unsupported(scene, spec) is None]
    if not usable:
        raise Unsupported(f"{adapter.name}: {adapter.unsupported(scene, specs[0])}")
    return str(adapter.methods[max(usable)[1]])
