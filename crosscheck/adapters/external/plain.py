"""The result of an engine in another process as plain data: what an engine returns may hold any object, and an object
of the engine must not run code in the process that reads it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np

from crosscheck.adapters.base import RawRun, Stats, plain_events
from crosscheck.errors import EngineError
from crosscheck.scene.states import States

Value = str | bool | int | float | tuple[str, ...] | None
"""What `stats` may hold."""


@dataclasses.dataclass
class PlainRun:
    """A `RawRun` of plain data, whose `stats` may have keys of the engine."""

    states: States
    wall_time: float
    steps: int
    step: float | None
    status: str
    stats: dict[str, Value]
    maxima: dict[str, float] | None
    form: str | None
    events: tuple[tuple[float, str, str], ...] = ()

    def raw(self) -> RawRun:
        """The same as a `RawRun`."""
        return RawRun(self.states, self.wall_time, self.steps, self.step, self.status, cast(Stats, self.stats),
                      self.maxima, self.form, events=self.events)


def plain(raw: RawRun) -> PlainRun:
    """The result as plain data, every array C-contiguous and of doubles. Raises `EngineError` naming what is not."""
    fields: dict[str, Any] = {field.name: getattr(raw.states, field.name) for field in dataclasses.fields(States)
                              if field.name != "sensors"}
    fields |= {name: doubles(name, values) for name, values in fields.items() if values is not None}
    sensors = None if raw.states.sensors is None else {
        _text("keys of sensors", name): doubles(f"sensor {name!r}", values)
        for name, values in _items("sensors", raw.states.sensors)}
    states = States(**fields, sensors=sensors)
    return PlainRun(states, _number("wall_time", float, raw.wall_time), _number("steps", int, raw.steps),
                    None if raw.step is None else _number("step", float, raw.step), _text("status", raw.status),
                    {_text("keys of stats", name): _value(name, value) for name, value in _items("stats", raw.stats)},
                    None if raw.maxima is None else {
                        _text("keys of maxima", name): _number(f"maxima {name}", float, value)
                        for name, value in _items("maxima", raw.maxima)},
                    None if raw.form is None else _text("form", raw.form), plain_events(raw.events))


def doubles(name: str, values: object) -> np.ndarray:
    """Values of the states as an array of doubles; raises `EngineError` if they are no real numbers."""
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "iufO":  # complex numbers and texts would be converted silently
            raise TypeError
        return np.array(array, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):
        raise EngineError(f"the states hold something else than real numbers in {name}") from None


def _number(name: str, kind: Callable[[Any], Any], value: object) -> Any:
    try:
        return kind(value)
    except (TypeError, ValueError, OverflowError):
        raise EngineError(f"{name} of a run is a number, not {type(value).__name__}") from None


def _text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise EngineError(f"{name} of a run: a text is wanted, not {type(value).__name__}")
    return str(value)


def _items(name: str, table: object) -> list[tuple[Any, Any]]:
    if not isinstance(table, Mapping):
        raise EngineError(f"{name} of a run is a dict, not {type(table).__name__}")
    return list(table.items())


def _value(name: str, value: object) -> Value:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or type(value) in (str, bool, int, float):
        return cast(Value, value)
    if isinstance(value, tuple | list) and all(type(each) is str for each in value):
        return tuple(value)
    raise EngineError(f"stats[{name!r}] of a run is a number, a text or a tuple of texts, not {type(value).__name__}")
