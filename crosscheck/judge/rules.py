"""What a verdict is made of: a value, its uncertainty with all its parts, and the size of the quantity.

A value beyond its uncertainty fails, however large that is. One within it is resolved if the uncertainty is a small
share of the size, and unresolved otherwise. Source: ASME V&V 20; METHODS of P. J. Roache.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np

from crosscheck.compare.apart import STATE
from crosscheck.compare.order import Limit
from crosscheck.document import QUANTITIES, Finding, Status
from crosscheck.scene.model import Scene

RESOLVED = 0.01
"""Share of a quantity's size beyond which an uncertainty says nothing of it: the digits that engineers compare."""

UNITS = {**QUANTITIES, "orthogonality": "1", "energy": "J", "acceleration": "m/s^2", "angular acceleration": "rad/s^2",
         "reaction force": "N", "reaction torque": "N m"}
Rule = Literal["limit", "gap", "gap limit", "order", "promise", "noise", "asked start"]
"""What a check is about: the first word is a key of `crosscheck.document.outcomes.KINDS`."""

WHY: dict[Rule, str] = {
    "limit": "answers from the run's own states, extrapolated to vanishing steps, less truth; U is 3 |T3 - T2| and "
             "what rounding, noise, iteration and truth leave",
    "gap": "the run less what the engine answers from the run's own states in another world; three times the error and "
           "the uncertainty of such an answer are allowed",
    "gap limit": "the run less what the engine answers from its own states, extrapolated to vanishing steps",
    "order": "the order at which answers at three steps approach each other, against the documented one less 1/2",
    "promise": "the error at the run's own tolerance, against steps times tolerance times size times growth; sensors "
               "and accelerations less those of the engine's own states, extrapolated to vanishing steps",
    "noise": "the same question asked again; answers may differ by their error, or by what is declared of rounding",
    "asked start": "the first output less the state that was asked for"}


@dataclasses.dataclass(frozen=True)
class Check:
    """One comparison in one segment."""

    rule: Rule
    name: str
    segment: int
    value: float
    parts: Mapping[str, float]  # of the uncertainty
    size: float
    detail: str = ""  # all from which value and uncertainty follow by hand

    @property
    def kind(self) -> str:
        """The rule and the row, as findings say them."""
        return f"{self.rule} {self.name}".strip()

    @property
    def uncertainty(self) -> float:
        """U."""
        return float(sum(self.parts.values()))

    @property
    def status(self) -> Status:
        """ "fail", "unresolved" or "ok"."""
        if self.value > self.uncertainty or math.isnan(self.value):
            return "fail"
        return "ok" if self.uncertainty <= RESOLVED * self.size else "unresolved"

    @property
    def severity(self) -> tuple[int, float]:
        """What sorts the worst last."""
        rank = ("ok", "unresolved", "fail").index(self.status)
        least = float(np.finfo(float).tiny)
        return rank, self.uncertainty / self.size if rank == 1 else self.value / max(self.uncertainty, least)


def limit_check(rule: Rule, name: str, segment: int, found: Limit, more: Mapping[str, float], size: float,
                where: str) -> Check:
    """The check of a limit; `more` are parts of the uncertainty beside its own, or instead of them."""
    return Check(rule, name, segment, found.size, {**found.parts, **more}, size, where)


def detail_of(scene: Scene, times: np.ndarray, answers: Sequence[tuple[float, np.ndarray]], found: Limit,
              what: str) -> str:
    """The place of the largest value, and the differences there from which it follows by hand, by step or tolerance."""
    norms = np.nan_to_num(np.linalg.norm(found.value, axis=-1), nan=np.inf)
    k, body = np.unravel_index(int(np.argmax(norms)), norms.shape) if norms.size else (0, 0)
    at = f"body {scene.bodies[body].name!r}, " if norms.shape[1] == scene.n else ""
    listed = "; ".join(f"{what} = {step:.8g}: ({', '.join(f'{part:.6g}' for part in each[k, body])})"
                       for step, each in answers) if norms.size else ""
    return f"{at}{times[k]:.6g} s after the segment begins, by {found.by}; D at {listed}"


def findings(checks: Iterable[Check], spans: Sequence[tuple[float, float]]) -> list[Finding]:
    """One finding a rule and row: the worst segment, with how many there are of each status."""
    grouped: dict[str, list[Check]] = {}
    for check in checks:
        grouped.setdefault(check.kind, []).append(check)
    made = []
    for kind, group in grouped.items():
        worst = max(group, key=lambda check: check.severity)
        begin, end = spans[worst.segment]
        parts = ", ".join(f"{part} {value:.3g}" for part, value in worst.parts.items() if value)
        counted = ", ".join(f"{sum(each.status == status for each in group)} {status}" for status in
                            ("fail", "unresolved", "ok") if any(each.status == status for each in group))
        made.append(Finding(kind, worst.status, worst.value, worst.uncertainty, UNITS.get(worst.name, "1"),
                            WHY[worst.rule],
                            f"segment {begin:.6g} to {end:.6g} s; U = {parts or '0'}; "
                            f"{worst.detail}; segments: {counted}", worst.size if math.isfinite(worst.size) else None))
    return made


def shares(checks: Sequence[Check], spans: Sequence[tuple[float, float]], blind: Iterable[int]) -> dict[str, float]:
    """By row the part of the run's time over which it is resolved, and by "" that of x, R, v, w together.

    `blind` are segments without a truth.
    """
    whole, blind = spans[-1][1] - spans[0][0] if spans else 0.0, set(blind)
    counted = [check for check in checks if check.rule in ("limit", "gap limit", "promise")]
    dark = {name: set(blind) for name in ("", *STATE, *(check.name for check in counted))}
    for check in counted:
        if check.status == "unresolved":
            dark[check.name].add(check.segment)
    dark[""] = set[int]().union(*(dark[name] for name in STATE))
    return {name: 1.0 - sum(spans[k][1] - spans[k][0] for k in each) / whole if whole else 0.0
            for name, each in dark.items()}


def visible(checks: Sequence[Check]) -> dict[str, float]:
    """By row the share of its size above which an error of the model would have been seen, from resolved checks."""
    least: dict[str, float] = {}
    for check in checks:
        if check.rule == "limit" and check.status == "ok" and check.size:
            least[check.name] = max(least.get(check.name, 0.0), (check.value + check.uncertainty) / check.size)
    return least
