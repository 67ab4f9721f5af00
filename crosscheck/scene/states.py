"""States of all bodies over time in the one convention that engines, references and metrics share."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

COLUMNS = {"x": (tuple(f"x_{axis}" for axis in "xyz"), "m"),
           "R": (tuple(f"R_{row}{column}" for row in "123" for column in "123"), ""),
           "v": (tuple(f"v_{axis}" for axis in "xyz"), "m/s"), "w": (tuple(f"w_{axis}" for axis in "xyz"), "rad/s")}
"""What a table calls the numbers of a body after its name, and their unit, by the fields of `States`."""


@dataclasses.dataclass
class States:
    """States in the common convention: x, v, a world; R body to world; w, alpha body axes. T times, n bodies.

    Adapters and references make it; `crosscheck.running.trajectory` derives everything else, the same way for all.
    """

    t: np.ndarray  # (T,)
    x: np.ndarray  # (T, n, 3)
    R: np.ndarray  # (T, n, 3, 3)
    v: np.ndarray  # (T, n, 3)
    w: np.ndarray  # (T, n, 3)
    a: np.ndarray | None = None  # (T, n, 3)
    alpha: np.ndarray | None = None  # (T, n, 3)
    lam: np.ndarray | None = None  # (T, m)
    sensors: Mapping[str, np.ndarray] | None = dataclasses.field(default=None, kw_only=True)  # by name, (T, ...)
    hinges: np.ndarray | None = dataclasses.field(default=None, kw_only=True)
    """(T, h) rad: the angles of `Scene.hinges` with the turns that the source has followed; NaN: it does not know them.

    The turns alone count, the rest is in R. None: the source has not followed them, and says so.
    """

    def at(self, rows: Any) -> States:
        """The states at some of the times, without readings of sensors."""
        more = (None if values is None else values[rows] for values in (self.a, self.alpha, self.lam))
        return States(self.t[rows], self.x[rows], self.R[rows], self.v[rows], self.w[rows], *more,
                      hinges=None if self.hinges is None else self.hinges[rows])

    def until(self, end: float) -> States:
        """These states, with NaN at times after `end` (s)."""
        later = self.t > end * (1 + 1e-12)
        if not later.any():
            return self

        def known(values: np.ndarray) -> np.ndarray:
            return np.where(later.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)

        given = {name: known(value) for name in ("x", "R", "v", "w", "a", "alpha", "lam")
                 if (value := getattr(self, name)) is not None}
        sensors = None if self.sensors is None else {name: known(values) for name, values in self.sensors.items()}
        return dataclasses.replace(self, sensors=sensors, **given)


def joined(parts: Sequence[States]) -> States:
    """States one after the other, with what all of them know, without readings of sensors."""
    def all_of(name: str) -> np.ndarray | None:
        values = [getattr(part, name) for part in parts]
        return None if any(each is None for each in values) else np.concatenate(values)

    given = {field.name: all_of(field.name) for field in dataclasses.fields(States) if field.name != "sensors"}
    return States(**given)  # type: ignore[arg-type]


class Motion(Protocol):
    """Anything with the states of all bodies at its times: `States`, and the trajectory of a run."""

    @property
    def t(self) -> np.ndarray: ...
    @property
    def x(self) -> np.ndarray: ...
    @property
    def R(self) -> np.ndarray: ...
    @property
    def v(self) -> np.ndarray: ...
    @property
    def w(self) -> np.ndarray: ...
    @property
    def hinges(self) -> np.ndarray | None: ...
