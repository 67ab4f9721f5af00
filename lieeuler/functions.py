"""Functions of time for loads, torques, rest angles and drives."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import Frozen, number
from lieeuler.errors import ArgumentError


@dataclasses.dataclass(frozen=True)
class TimeFunction(Frozen):
    """A piecewise polynomial plus a sum of sines.

    A method keeps its order only if the function is smooth within each step. With fixed steps, put every break at the
    end of a step; adaptive methods end a step at each break by themselves. A step that ends at a break takes the piece
    before it; accelerations and multipliers there are those of the piece that begins.

    Parameters
    ----------
    pieces : sequence of sequences of float
        Coefficients of each piece in powers of t - break, constant first.
    terms : sequence of (amplitude, angular frequency in rad/s, phase in rad)
        Each is amplitude sin(angular frequency t + phase).
    breaks : sequence of float
        Where the pieces begin, s, increasing. The first piece also holds before its break; the last one never ends.
    """

    pieces: Sequence[Sequence[float]] = ((0.0,),)
    terms: Sequence[Sequence[float]] = ()
    breaks: Sequence[float] = (0.0,)

    def __post_init__(self) -> None:
        for name in ("pieces", "terms"):
            rows = getattr(self, name)
            try:
                object.__setattr__(self, name, tuple(_numbers(name, row) for row in rows))
            except TypeError:
                raise ArgumentError(f"{name} must be a sequence of rows of numbers, not {rows!r}") from None
        object.__setattr__(self, "breaks", _numbers("breaks", self.breaks))
        if not self.breaks or len(self.breaks) != len(self.pieces) or not all(self.pieces):
            raise ArgumentError("every piece needs a break and at least one coefficient")
        if (np.diff(self.breaks) <= 0).any():
            raise ArgumentError("breaks must increase")
        if any(len(term) != 3 for term in self.terms):
            raise ArgumentError("a term is an amplitude, an angular frequency and a phase")

    @property
    def kernel(self) -> _kernel.TimeFunction:
        """The function as the compiled core holds it."""
        return _kernel.TimeFunction(self.breaks, self.pieces, self.terms)

    def __call__(self, t: Any) -> Any:
        """The values at times t, s; at a break that of the piece which begins there."""
        times = np.asarray(t, dtype=float)
        which = np.clip(np.searchsorted(self.breaks, times, side="right") - 1, 0, None)
        after, total = times - np.asarray(self.breaks)[which], np.zeros_like(times)
        coefficients = np.zeros((len(self.pieces), max(map(len, self.pieces))))
        for row, piece in zip(coefficients, self.pieces, strict=True):
            row[:len(piece)] = piece
        for column in coefficients.T[::-1]:
            total = total * after + column[which]
        return total + sum(a * np.sin(w * times + phase) for a, w, phase in self.terms)

    def scaled(self, factor: float, offset: float = 0.0) -> TimeFunction:
        """offset + factor times the function."""
        pieces = [[factor * c for c in piece] for piece in self.pieces]
        return TimeFunction([[piece[0] + offset, *piece[1:]] for piece in pieces],
                            [(factor * a, w, phase) for a, w, phase in self.terms], self.breaks)


def value(name: str, given: float | TimeFunction) -> float | TimeFunction:
    """A function of time unchanged, or a number after its check."""
    return given if isinstance(given, TimeFunction) else number(name, given)


def _numbers(name: str, values: Any) -> tuple[float, ...]:
    try:
        return tuple(number(name, each) for each in values)
    except TypeError:
        raise ArgumentError(f"{name} must be a sequence of numbers, not {values!r}") from None


Value = Annotated[float | TimeFunction, value]
