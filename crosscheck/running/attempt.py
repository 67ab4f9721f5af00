"""One run of one engine, and its outcome. Nothing else calls the `run` of an adapter.

Whatever an engine raises or returns becomes one of the outcomes here, so that callers need no handler of their own. A
process that an engine takes down with it is the matter of `crosscheck.jobs`, whose outcome for it is `Crash`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
from collections.abc import Mapping
from typing import cast

import msgspec
import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import Engine, RawRun, Stats, plain_events
from crosscheck.document import Way as Way
from crosscheck.errors import (
    CrosscheckError,
    EngineDied,
    EngineError,
    Unsupported,
    brief,
    check_time,
    errors_as,
    install,
    named,
    said,
)
from crosscheck.files import plain
from crosscheck.running import arguments
from crosscheck.running.trajectory import Trajectory, derive
from crosscheck.scene import sensors
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from crosscheck.scene.monitor import MAXIMA

MOST_SECONDS = 1e9
"""Longest stepping time (s) that is believed, thirty years. Larger numbers would overflow in figures made of it."""

MOST_STEPS = 2**53
"""Largest number of steps that is believed; every table and JSON reader holds whole numbers up to it."""

LONGEST = 500
"""Characters of the reason of an outcome. Some engines repeat a page with every failure."""

WORD, MOST_STATS = 100, 10**6
"""Characters of a status, a form or a word of an event, and of all of an engine's stats."""


@dataclasses.dataclass(frozen=True)
class Ran:
    """The run reached its end, and the answer has the right shapes and finite states."""

    scene: Scene
    way: Way
    raw: RawRun  # as the engine returned it, with plain numbers

    @functools.cached_property
    def trajectory(self) -> Trajectory:
        """The states with what follows from them."""
        return derive(self.scene, self.way.engine, self.way.method, self.raw)

    @property
    def status(self) -> str:
        """What the run says of its end: "success", or a word of the engine."""
        return self.raw.status


@dataclasses.dataclass(frozen=True)
class Refused:
    """The engine cannot model the scene, or not in this way. Nothing is wrong with it."""

    error: Unsupported
    status = "unsupported"

    @property
    def why(self) -> str:
        """The reason in one line."""
        return said(self.error)[:LONGEST]


@dataclasses.dataclass(frozen=True)
class Failed:
    """The run ended early or its answer cannot be used. `error` is what `crosscheck.run` raises for it."""

    error: CrosscheckError

    @property
    def why(self) -> str:
        """The reason in one line; it begins with the kind of the error unless that is `EngineError`."""
        kind = "" if isinstance(self.error, EngineError) else f"{type(self.error).__name__}: "
        return f"{kind}{said(self.error)}"[:LONGEST]

    @property
    def status(self) -> str:
        """The failure in one word: the status that the error holds, else "failed"."""
        status = getattr(self.error, "status", "failed")
        return str(getattr(status, "value", status))


Outcome = Ran | Refused | Failed


def attempt(scene: Scene, way: Way, engine: Engine | None = None, derived: bool = True, **more: object) -> Outcome:
    """The outcome of a way on a scene. Raises no `Exception`; `OutOfTime` before it runs.

    Parameters
    ----------
    engine : an object that runs instead of the engine that the way names
    derived : whether more than the states of the run is wanted; what cannot be derived from them is an error of the run
    more : arguments of `crosscheck.run` beside those of the way, or instead of them
    """
    check_time()
    asked, method = way.arguments | more, way.method
    name = label = way.engine

    def as_engine_error(error: Exception) -> EngineError:
        lacks = isinstance(error, ImportError)
        return EngineError(f"{name} cannot be imported: {error}; {install(name)}" if lacks else
                           f"{name} {method}: {named(error)}")

    try:
        with errors_as(as_engine_error):
            adapter = adapters.get(label if engine is None else engine)
            name = adapter.name
            spec = arguments.request(label, adapter, method, asked)
            scene = arguments.overridden(scene, asked)
            arguments.check_length(scene, spec)
            reason = adapter.unsupported(scene, spec)
            if reason is not None:
                raise Unsupported(f"{label} {method} on scene {scene.name!r}: {reason}")
            raw = _checked(f"{label} {method}", scene, adapter.run(scene, spec))
            ran = Ran(scene, way, raw)
            _ = ran.trajectory if derived else None
            return ran
    except Unsupported as error:
        return Refused(error)
    except CrosscheckError as error:
        return Failed(error)


def lasting(outcome: Outcome) -> Outcome:
    """The outcome, if it is worth keeping; raises the error of an engine whose process has died, which may have been
    killed from outside.
    """
    if isinstance(outcome, Failed) and isinstance(outcome.error, EngineDied):
        raise outcome.error
    return outcome


def _checked(who: str, scene: Scene, raw: RawRun) -> RawRun:
    """The answer of an engine with plain numbers and texts; raises `EngineError` that names what is wrong with it."""
    if not isinstance(raw, RawRun):
        raise EngineError(f"{who} returned {type(raw).__name__}, not crosscheck.adapters.base.RawRun")
    _check_states(who, scene, raw)
    if raw.states.sensors:
        raw.states.sensors = _checked_sensors(who, scene, raw.states.sensors)
    whole = isinstance(raw.steps, numbers.Integral) and not isinstance(raw.steps, bool)
    if not whole or not 1 <= raw.steps <= MOST_STEPS:
        raise EngineError(f"{who} returned steps of {_brief(raw.steps)}, not a whole number from 1")
    if not isinstance(raw.status, str) or not isinstance(raw.form, str | None):
        raise EngineError(f"{who} returned a status or form that is no text: {_brief(raw.status)}, {_brief(raw.form)}")
    wall_time = _number(who, "wall_time", raw.wall_time, 0.0, MOST_SECONDS)
    step = None if raw.step is None else _number(who, "step", raw.step, math.ulp(0.0), math.inf)
    if not isinstance(raw.maxima, dict | None) or not set(raw.maxima or ()) <= set(MAXIMA):
        raise EngineError(f"{who} returned maxima that are not numbers under the keys {', '.join(MAXIMA)}")
    maxima = {key: _number(who, f"maximum of {key}", value, 0.0, math.inf) for key, value in (raw.maxima or {}).items()}
    try:
        own = plain(raw.stats)
        known = msgspec.convert(own, Stats)
        stats = cast(Stats, {**own, **known})
    except (TypeError, ValueError, RecursionError) as error:
        raise EngineError(f"{who} returned stats that are no dict of plain values: {said(error)}") from error
    if len(msgspec.json.encode(own)) > MOST_STATS:
        raise EngineError(f"{who} returned stats of more than {MOST_STATS} characters; return numbers and short texts")
    events = tuple((t, brief(joint, WORD), brief(what, WORD)) for t, joint, what in plain_events(raw.events))
    return RawRun(raw.states, wall_time, int(raw.steps), step, brief(raw.status, WORD), stats, maxima or None,
                  None if raw.form is None else brief(raw.form, WORD), events=events)


def _number(who: str, what: str, value: object, least: float, most: float) -> float:
    """`value` as a double within the limits."""
    number = arguments.real(value)
    if not least <= number <= most or (what == "step" and math.isinf(number)):
        wanted = "a number above 0" if least else f"a number from 0 to {most:g}"
        raise EngineError(f"{who} returned a {what} of {_brief(value)}, not {wanted}")
    return number


def _brief(value: object) -> str:
    """A wrong value in an error message; the name of its type if it is no number or text."""
    if isinstance(value, str):
        return repr(value[:60])
    short = isinstance(value, float | np.number | None) or (isinstance(value, int) and abs(value) < MOST_STEPS**2)
    return str(value) if short else type(value).__name__


def _checked_sensors(who: str, scene: Scene, given: object) -> dict[str, np.ndarray]:
    """The readings that an engine made itself, as doubles of the shape that each sensor has."""
    known = {sensor.name: sensor for sensor in scene.sensors}
    checked = {}
    for name, values in given.items() if isinstance(given, Mapping) else [(_brief(given), None)]:
        if name not in known:
            raise EngineError(f"{who} returned sensors of the name {_brief(name)}, which the scene has not; it has "
                              f"{', '.join(known) or 'none'}")
        wanted = sensors.shape(scene, known[name], scene.samples)
        try:
            array = np.asarray(values)
            if array.dtype.kind not in "iuf":
                raise TypeError
            array = array.astype(float).reshape(wanted) if array.size == math.prod(wanted) else array
        except (TypeError, ValueError):
            raise EngineError(f"{who} returned sensor {name!r} as something else than real numbers") from None
        if array.shape != wanted:
            raise EngineError(f"{who} returned sensor {name!r} of shape {array.shape}, not {wanted}")
        if not np.isfinite(array).all():
            raise EngineError(f"{who} returned sensor {name!r} with values that are not finite")
        checked[name] = array
    return checked


def _check_states(who: str, scene: Scene, raw: RawRun) -> None:
    """Raise `EngineError` where states have wrong types, shapes or times, or are not finite."""
    states = raw.states
    vectors = (scene.samples, scene.n, 3)
    shapes = {"t": (scene.samples,), "x": vectors, "R": (*vectors, 3), "v": vectors, "w": vectors, "a": vectors,
              "alpha": vectors, "lam": (scene.samples, Constraints(scene).m),
              "hinges": (scene.samples, len(scene.hinges))}
    for name, shape in shapes.items():
        values = getattr(states, name, None)
        if values is None and name in ("a", "alpha", "lam", "hinges"):
            continue
        if not isinstance(values, np.ndarray):
            raise EngineError(f"{who} returned {name} as {type(values).__name__}, not as a NumPy array")
        if name == "t" and len(values.ravel()) != scene.samples:
            raise EngineError(f"{who} returned {len(values.ravel())} samples, not {scene.samples}")
        if values.shape != shape:
            raise EngineError(f"{who} returned {name} of shape {values.shape}, not {shape}")
        if values.dtype.kind not in "iuf":
            raise EngineError(f"{who} returned {name} of type {values.dtype}, not of real numbers")
    if (states.a is None) != (states.alpha is None):
        raise EngineError(f"{who} returned one of a and alpha without the other")
    if not np.allclose(states.t, scene.t, rtol=0, atol=1e-9 * scene.duration):  # a NaN is not close either
        raise EngineError(f"{who} returned states at other times than the output times scene.t")
    finite = np.ones(scene.samples, dtype=bool)
    for values in (states.x, states.R, states.v, states.w):
        finite &= np.isfinite(values.reshape(scene.samples, -1)).all(axis=1)
    if not finite.all():
        raise EngineError(f"{who} diverged: the state is not finite at t = {states.t[np.argmin(finite)]:.6g} s; "
                          "try a smaller step")
