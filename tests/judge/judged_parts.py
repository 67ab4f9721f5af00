"""`python -m tests.judge.judged_parts [SCENE...]`: how much of a run is judged, and why not all.

Every method of every engine that is installed and the own ones of `tests.right_engines`, at the steps of the plan.
"""

import sys
from collections import Counter

from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.adapters.foreign.own import completed
from crosscheck.document import Way
from crosscheck.judge.plan import PLANS, PROFILES
from crosscheck.judge.verdict import word, worst
from crosscheck.verification.cell import run_cell
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell, cells_of
from tests.right_engines import TABLEAUX, Adaptive, Floats, Matrices, Projected, Rotations

SIX = (*PLANS, "hinge_pendulum", "four_bar")
OWN = (*((Rotations, f"RK{order}") for order in TABLEAUX), (Matrices, "RK4"), (Projected, "RK4"), (Floats, "RK4"),
       (Adaptive, "DP5"))
STEPS, SECONDS = 4000, 2.0
"""Most steps of an own engine, which makes them in Python, and the length of its runs (s)."""


def records(name):
    """The records of a scene."""
    plan = prepare_truth((name, True, PROFILES["default"].most_steps)).plan
    for engine in adapters.names():
        for cell in cells_of(name, engine, PROFILES["smoke"]):
            yield run_cell(Cell(name, cell.way, plan, study=False))
    duration = min(SECONDS, plan.window if name == "heavy_top" else SECONDS)
    brief = replace(plan, duration=duration, samples=101, steps={
        order: max(step, duration / STEPS) for order, step in plan.steps.items()}, budgeted=True)
    for engine, method in OWN:
        with adapters.lent(completed(engine(), engine.__name__, "1")) as lent:
            yield replace(run_cell(Cell(name, Way(lent, method), brief, study=False)), engine=f"own {engine.__name__}")


def main(names):
    """Print one line a run, and how many are judged whole."""
    counts = Counter()
    for name in names or SIX:
        for record in records(name):
            if record.outcome == "unsupported":
                counts["unsupported"] += 1
                continue
            share = (record.judged_until or 0.0) / record.duration if record.duration else 0.0
            whole = share >= 1 - 1e-9
            why = record.message if record.outcome in ("fail", "error", "unresolved") else record.not_judged
            first = worst(record.findings)
            seen = f"{first.kind} {first.value} of {first.bound}" if record.outcome == "fail" and first else ""
            counts[f"{record.outcome}: {'whole' if whole else why}"] += 1
            print(name, f"{record.engine} {record.method}", word(record), f"{100 * share:.4g} %", why, seen, sep=" | ",
                  flush=True)
    for what, count in counts.most_common():
        print(count, what)


if __name__ == "__main__":
    main(sys.argv[1:])
