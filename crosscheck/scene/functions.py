"""Functions of time for loads, joint torques, rest angles and prescribed joint coordinates."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class TimeFunction:
    """A piecewise polynomial plus a sum of sines.

    Attributes
    ----------
    breaks : where the pieces begin, s, increasing; the first piece also holds before its break, the last one never ends
    pieces : for each break its coefficients in powers of t - break, constant first
    terms : (amplitude, angular frequency in rad/s, phase in rad) of amplitude sin(angular frequency t + phase)
    end : s, until which it is known: a spline is no longer known after its table
    """

    breaks: tuple[float, ...] = (0.0,)
    pieces: tuple[tuple[float, ...], ...] = ((0.0,),)
    terms: tuple[tuple[float, float, float], ...] = ()
    end: float = math.inf

    def __call__(self, t: object, derivative: int = 0) -> Any:
        """The value, or that of a derivative, at times of any shape."""
        t = np.asarray(t, dtype=float)
        total = np.zeros(t.shape)
        at = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, None)
        for k in np.unique(at):
            slopes = np.polynomial.polynomial.polyder(np.array(self.pieces[k]), derivative)
            here = at == k
            total[here] = np.polynomial.polynomial.polyval(t[here] - self.breaks[k], slopes)
        for amplitude, frequency, phase in self.terms:
            total += amplitude * frequency**derivative * np.sin(frequency * t + phase + derivative * math.pi / 2)
        return total if total.ndim else float(total)

    def times(self, factor: float) -> TimeFunction:
        """The function times a number."""
        return TimeFunction(self.breaks, tuple(tuple(factor * c for c in piece) for piece in self.pieces),
                            tuple((factor * a, w, phase) for a, w, phase in self.terms), self.end)

    def plus(self, value: float) -> TimeFunction:
        """The function plus a number."""
        return dataclasses.replace(self, pieces=tuple((piece[0] + value, *piece[1:]) for piece in self.pieces))

    def delayed(self, by: float) -> TimeFunction:
        """The function of t - by."""
        return TimeFunction(tuple(t + by for t in self.breaks), self.pieces,
                            tuple((a, w, phase - w * by) for a, w, phase in self.terms), self.end + by)

    def derivative(self, order: int) -> TimeFunction:
        """A derivative as a function."""
        pieces = (np.polynomial.polynomial.polyder(np.array(piece), order).tolist() for piece in self.pieces)
        return TimeFunction(self.breaks, tuple(tuple(piece) for piece in pieces),
                            tuple((a * w**order, w, phase + order * math.pi / 2) for a, w, phase in self.terms),
                            self.end)

    @property
    def jumps(self) -> bool:
        """Whether the value itself jumps, as that of `hold` does."""
        ends = zip(self.breaks[1:], self.pieces, self.breaks, self.pieces[1:], strict=False)
        return any(abs(np.polynomial.polynomial.polyval(end - start, np.array(piece)) - following[0])
                   > 1e-9 * max(1.0, abs(following[0])) for end, piece, start, following in ends)

    @property
    def inner_breaks(self) -> tuple[float, ...]:
        """Times at which a derivative jumps."""
        return self.breaks[1:]


Value = float | TimeFunction
"""A number, or a function of time."""


def at(value: Value, t: object, derivative: int = 0) -> Any:
    """A number or a function of time at times t; derivatives of a number are zero."""
    if isinstance(value, TimeFunction):
        return value(t, derivative)
    return value if derivative == 0 else 0.0


def polynomial(coefficients: Sequence[float]) -> TimeFunction:
    """The function sum of coefficients[k] t^k."""
    return TimeFunction(pieces=(tuple(coefficients),))


def sine(terms: Sequence[Sequence[float]], offset: float = 0.0) -> TimeFunction:
    """The function offset + sum of amplitude sin(angular frequency t + phase)."""
    return TimeFunction(pieces=((offset,),), terms=tuple((a, w, phase) for a, w, phase in terms))


def spline(times: Sequence[float], values: Sequence[float]) -> TimeFunction:
    """The cubic spline through a table, with its third derivative continuous at the second and last but one time."""
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(np.array(times), np.array(values))
    return TimeFunction(tuple(times[:-1]), tuple(tuple(piece[::-1]) for piece in curve.c.T.tolist()), end=times[-1])


def hold(times: Sequence[float], values: Sequence[float]) -> TimeFunction:
    """Each value from its time on until the next, the first one also before."""
    return TimeFunction(tuple(times), tuple((value,) for value in values))


def linear(times: Sequence[float], values: Sequence[float]) -> TimeFunction:
    """Straight between the values of a table, constant before and after; slopes are those to the right."""
    slopes = np.diff(values) / np.diff(times)
    pieces = [*zip(values[:-1], slopes.tolist(), strict=True), (values[-1],)]
    return TimeFunction((times[0] - 1.0, *times), ((values[0],), *pieces))
