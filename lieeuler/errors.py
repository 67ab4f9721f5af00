"""Errors of lieeuler."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lieeuler.solution import Solution, Status


class LieEulerError(Exception):
    """Base of all errors of lieeuler. The message is written for the user."""


class ArgumentError(LieEulerError, ValueError):
    """An argument is wrong. The message names it and says what is allowed."""


class IntegrationError(LieEulerError, RuntimeError):
    """An integration ended early. Carries `status`, `advice` and the trajectory so far in `solution`."""

    def __init__(self, status: Status, advice: str, solution: Solution) -> None:
        super().__init__(f"{status.value} at t = {solution.t_end:.6g} s: {advice}")
        self.status, self.advice, self.solution = status, advice, solution

    def __reduce__(self) -> tuple[type, tuple[Status, str, Solution]]:
        """Copies and pickles are made from the arguments of `__init__`; `args` holds only the message."""
        return type(self), (self.status, self.advice, self.solution)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during an integration; `solution` holds the trajectory so far."""

    def __init__(self, solution: Solution) -> None:
        super().__init__(f"interrupted at t = {solution.t_end:.6g} s")
        self.solution = solution

    def __reduce__(self) -> tuple[type, tuple[Solution]]:
        """As for `IntegrationError`."""
        return type(self), (self.solution,)
