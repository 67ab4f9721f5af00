"""The smallest mistake of each kind of `benchmarks.altered` that a verdict catches, by scene and order.

    python -m benchmarks.smallest_errors [SCENE ...]

An error is caught if the run fails and the right run does not. If one of the size in `AIM` is not caught, the reason
follows: the finding that comes nearest to its bound, and the bound.
"""

from __future__ import annotations

import functools
import sys
from typing import Any

from benchmarks.altered import MISTAKES, ORDERS, SHARES, Altered
from crosscheck import adapters
from crosscheck.adapters.external.own import completed
from crosscheck.document import Plan, Record, Way
from crosscheck.verification.cell import run_cell
from crosscheck.verification.plan import PROFILES
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell

AIM = {1: 1e-4, 2: 1e-7, 4: 1e-8}
"""Errors that have to be caught, by order."""

SCENES = ("single_pendulum", "double_pendulum", "triple_pendulum", "heavy_top", "four_bar")


@functools.cache
def plan(scene: str) -> Plan:
    """The plan of the default profile."""
    profile = PROFILES["default"]
    found = prepare_truth((scene, profile.most_seconds, profile.most_steps)).plan
    assert found is not None
    return found


def judged(engine: str, scene: str, method: str, number: str, share: float, begin: float) -> Record:
    """The verdict on one run."""
    return run_cell(Cell(scene, Way(engine, f"{method} {number} {share} {begin}"), plan(scene)))


def caught(*run: Any) -> bool:
    """Whether the run of `judged` fails."""
    return judged(*run).outcome == "fail"


def nearest(*run: Any) -> str:
    """The finding of a run that passes that comes nearest to its bound."""
    seen = [finding for finding in judged(*run).findings if finding.value and finding.bound]
    if not seen:
        return judged(*run).message
    found = max(seen, key=lambda finding: finding.severity)
    return f"{found.kind} is {found.value:.2g} {found.unit} of {found.bound:.2g}: {found.detail}"


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
    heads = (f"{number + (' late' if begin else ''):>13}" for number, begin in MISTAKES)
    print("scene            order " + " ".join(heads))
    with adapters.lent(completed(Altered(), "altered", "1")) as engine:
        for scene in scenes:
            for method, order in ORDERS.items():
                found = [smallest(engine, scene, method, number, begin) for number, begin in MISTAKES]
                wrong = caught(engine, scene, method, "gravity", 0.0, 0.0)
                print(f"{scene:16} {order:5} " + " ".join(f"{'none' if share is None else f'{share:g}':>13}"
                                                         for share in found)
                      + (" the right run fails" if wrong else ""), flush=True)
                for share, (number, begin) in zip(found, MISTAKES, strict=True):
                    if share is None or share > AIM[order]:
                        print(f"    {number}{' late' if begin else ''} x (1 + {AIM[order]:g}): "
                              f"{nearest(engine, scene, method, number, AIM[order], begin)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or list(SCENES))
