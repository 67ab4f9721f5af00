"""The smallest error of gravity, mass and inertia that a verdict catches, by scene and order, from the start and late.

    python -m benchmarks.smallest_errors [SCENE ...]

An error is caught if the main run fails and the right run does not; the order study could only catch more. If an error
of `AIM` is not caught, the reason follows: the finding that comes nearest to its bound, and the bound.
"""

from __future__ import annotations

import itertools
import sys
from typing import Any

from benchmarks.altered import BEGINS, NUMBERS, ORDERS, SHARES, Altered
from crosscheck import adapters
from crosscheck.adapters.foreign.own import completed
from crosscheck.document import Finding, Way
from crosscheck.judge.plan import PLANS
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell

AIM = 1e-3


def findings(engine: str, scene: str, method: str, number: str, share: float, begin: float) -> list[Finding]:
    """Those of the main run; a step that is too coarse for bounds of the motion catches nothing."""
    found = run_cell(Cell(scene, Way(engine, f"{method} {number} {share} {begin}"), PLANS[scene], study=False))
    return [finding for finding in found.findings if finding.kind != "step"]


def caught(*run: Any) -> bool:
    """Whether the run of `findings` fails."""
    return any(finding.status == "fail" for finding in findings(*run))


def nearest(*run: Any) -> str:
    """The finding of a run that passes, of its motion, that comes nearest to its bound."""
    seen = [finding for finding in findings(*run) if finding.value and finding.bound and not finding.kind.startswith(
        ("order", "continuity", "orthogonality"))]
    found = max(seen, key=lambda finding: finding.severity)
    return f"{found.kind} is {found.value:.2g} {found.unit} of {found.bound:.2g}: {found.why}"


def smallest(engine: str, scene: str, method: str, number: str, begin: float) -> float | None:
    """By bisection over `SHARES`; None where none of them is caught."""
    low, high = -1, len(SHARES)
    while high - low > 1:
        middle = (low + high) // 2
        if caught(engine, scene, method, number, SHARES[middle], begin):
            high = middle
        else:
            low = middle
    return SHARES[high] if high < len(SHARES) else None


def main(scenes: list[str]) -> None:
    """Print the table."""
    print("scene            order " + " ".join(f"{number + (' late' if begin else ''):>13}"
                                               for number in NUMBERS for begin in BEGINS))
    with adapters.lent(completed(Altered(), "altered", "1")) as engine:
        for scene in scenes:
            for method, order in ORDERS.items():
                found = [smallest(engine, scene, method, number, begin) for number in NUMBERS for begin in BEGINS]
                wrong = caught(engine, scene, method, "gravity", 0.0, 0.0)
                print(f"{scene:16} {order:5} " + " ".join(f"{'none' if share is None else f'{share:g}':>13}"
                                                         for share in found)
                      + (" the right run fails" if wrong else ""), flush=True)
                for share, (number, begin) in zip(found, itertools.product(NUMBERS, BEGINS), strict=True):
                    if share is None or share > AIM:
                        print(f"    {number}{' late' if begin else ''} x {1 + AIM:g}: "
                              f"{nearest(engine, scene, method, number, AIM, begin)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or list(PLANS))
