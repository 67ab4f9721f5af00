"""The words for how a check ended, and the exit code of each: the same in every command, page, file and test.

Source: ASME V&V 20 for what is resolved; a difference within its uncertainty is neither passed nor accused.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple, get_args

Outcome = Literal["error", "fail", "unresolved", "known", "pass", "unsupported"]
"""error: it did not run. fail: it is wrong. unresolved: less was judged than was asked for. known: wrong, as its
known defects say. pass: it is right. unsupported: the engine cannot model the scene."""

EXIT_CODES: dict[Outcome, int] = {"pass": 0, "known": 0, "fail": 1, "error": 1, "unresolved": 3, "unsupported": 3}
"""2 is a wrong command, 70 an internal error."""

INTERNAL = 70


class Kind(NamedTuple):
    """What a verdict that is not a pass is about."""

    code: str  # stable, for searching and for rules of other tools
    title: str
    mend: str  # what to look at


KINDS = {
    "gap": Kind("CC101", "from its own states the engine goes on otherwise", "state that is kept between steps"),
    "limit": Kind("CC102", "as steps vanish it does not come to the truth",
                  "the model; crosscheck explain names causes"),
    "order": Kind("CC103", "the error falls more slowly than documented", "how stages or rotations are combined"),
    "promise": Kind("CC104", "it does not keep what it promises at each step", "constraints, sensors, accelerations, "
                    "rotation matrices, relative tolerance"),
    "asked": Kind("CC105", "it did not do what was asked",
                  "start, end, status, number of steps, known defects that are mended"),
    "tolerance": Kind("CC106", "the error is beyond the tolerance that was asked", "step, tolerance, model"),
    "noise": Kind("CC107", "repeats scatter", "random numbers, threads, time limits of iterations"),
    "unresolved": Kind("CC108", "less was judged than was asked for", "what its sentence names")}
"""What a verdict can be about that is no pass. The first word of a finding's kind is one of these."""

def code(outcome: Outcome, about: str = "asked") -> str:
    """The code of a verdict whose worst finding is about one of `KINDS`; "" for a pass."""
    if outcome in ("pass", "unsupported"):
        return ""
    return KINDS["unresolved" if outcome == "unresolved" else about].code


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
