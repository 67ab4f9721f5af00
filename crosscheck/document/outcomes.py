"""The words for how a check ended, and the exit code of each: the same in every command, page, file and test.

Source: ASME V&V 20 for what is resolved; a difference within its uncertainty is neither passed nor accused.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, get_args

Outcome = Literal["error", "fail", "unresolved", "known", "pass", "unsupported"]
"""error: it did not run. fail: it is wrong. unresolved: less was judged than was asked for. known: wrong, as its
known defects say. pass: it is right. unsupported: the engine cannot model the scene."""

EXIT_CODES: dict[Outcome, int] = {"pass": 0, "known": 0, "fail": 1, "error": 1, "unresolved": 3, "unsupported": 3}
"""2 is a wrong command, 70 an internal error."""

INTERNAL = 70


def worst(outcomes: Iterable[Outcome]) -> Outcome:
    """The outcome of a set; what is unsupported counts for nothing beside others, and nothing at all is unresolved."""
    found = set(outcomes)
    return next((word for word in get_args(Outcome) if word in found), "unresolved")


def exit_code(outcomes: Iterable[Outcome]) -> int:
    """The exit code of a set of outcomes: that of the worst."""
    return EXIT_CODES[worst(outcomes)]


def percent(share: float) -> str:
    """A share in percent, which is 100 % only where it is all."""
    return "100 %" if share >= 1 else f"{100 * share:.2g} %" if share < 0.99 else f"{min(100 * share, 99.9999):.6g} %"
