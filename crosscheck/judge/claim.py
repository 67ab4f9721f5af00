"""The accuracy that a run claims to have. Bounds depend on the engine through this claim alone."""

from __future__ import annotations

import dataclasses
from typing import Any

from crosscheck.errors import ArgumentError

Trace = Any  # a Trajectory of crosscheck.running, or the States of one: the judge imports no runs


@dataclasses.dataclass(frozen=True)
class Claim:
    """A documented order and the step used, or the tolerance of an adaptive method."""

    order: int | None  # None for adaptive methods
    step: float | None  # s
    rtol: float | None
    eps: float = 2.0**-52  # spacing of the engine's numbers
    steps: float = 0.0  # in a sample interval

    def __post_init__(self) -> None:
        if self.rtol is None and (self.order is None or self.step is None):
            raise ArgumentError("a run is judged by its step and documented order, or by its rtol: give one of them")

    @property
    def fixed(self) -> tuple[int, float] | None:
        """Order and step (s); None for an adaptive method."""
        return None if self.order is None or self.step is None else (self.order, self.step)

    @property
    def said(self) -> str:
        """The claim in words."""
        return f"order {self.order}, h = {self.step:.3g} s" if self.fixed else f"rtol = {self.rtol:.1e}"
