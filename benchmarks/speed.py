"""Every figure of the page "Speed": what an error, a step and a trajectory cost, beside other engines.

    python -m benchmarks.speed [--only errors ...] [--turns 7]

What is timed: the stepping alone (no model building, no sampling, no monitor), one thread unless said. How: all
contenders of a table take turns in one process, so that a slow spell of the machine hits each of them; a turn is the
fastest of a few in which the process did not wait for its processor. Tables have medians over the turns, the median
absolute deviation in percent, and how many times as long each takes as lieeuler's fastest. They are written to
docs/static/speed.json, and the page is made of that.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import crosscheck
import lieeuler
from benchmarks import cells, driver, ensembles
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.compare.timing import undisturbed
from crosscheck.errors import CrosscheckError
from crosscheck.running import provenance
from crosscheck.verification.plan import duration_within

TARGET = Path(__file__).parents[1] / "docs" / "static" / "speed.json"
ENGINES = ("lieeuler", "mujoco", "pinocchio", "exudyn")
SCENES = ("single_pendulum", "double_pendulum", "chain_8", "chain_64", "four_bar")
STEPS = {"single_pendulum": 1e-3, "double_pendulum": 1e-3, "squeezer": 1e-5}
"""Steps (s) that a user of a first-order method would take."""
STEPPERS = (*(("mujoco", method) for method in ("Euler", "RK4", "implicitfast")),
            *(("lieeuler", method) for method in lieeuler.EULER_METHODS))
SIZES, CHAINED, STEP, RTOL = (16, 64, 256, 1024), ("DAE1L_LSE", "rattle2", "taylor"), 1e-3, 1e-8
MEMBERS, THREADS = 2000, 2

Row = list[Any]
Table = dict[str, Any]


def table(title: str, columns: Sequence[str], rows: Sequence[Row], said: str) -> Table:
    """A table of the page; `said`: what its numbers are."""
    return {"title": title, "said": said, "columns": list(columns), "rows": list(rows)}


def rows_of(times: Mapping[tuple[str, ...], Sequence[float]], unit: float = 1.0) -> list[Row]:
    """Rows of a name, a median (in `unit`), its deviation in percent, and the ratio to lieeuler's fastest."""
    middle = {name: statistics.median(own) for name, own in times.items()}
    first = min((name for name in times if name[0] == "lieeuler"), key=middle.__getitem__)
    made = []
    for name, own in times.items():
        off = statistics.median(abs(each - middle[name]) for each in own) / middle[name]
        ratio = statistics.median(each / least for each, least in zip(own, times[first], strict=True))
        made.append([*name, f"{middle[name] / unit:.3g}", f"{100 * off:.1f}", f"{ratio:.2f}"])
    return made


def errors(turns: int) -> list[Table]:
    """Time to an error, of each engine's cheapest method."""
    made = []
    for name in SCENES:
        scene = crosscheck.load_scene(name)
        scene = scene.lasting(duration_within(scene) or scene.duration)
        rows = []
        for level, cell in cells.measured(scene, turns, scene.n < max(SIZES[:2]), ENGINES).items():
            if "lieeuler" in cell:
                rows += [[level, *row] for row in rows_of({
                    (engine, each["method"]): each["us"] for engine, each in cell.items()})]
        columns = ("error", "engine", "method", "us", "deviation %", "ratio")
        made.append(table(f"Time to an error: {name}", columns, rows,
                          f"{scene.duration:g} s of motion; error at its end, m. heyoka integrates minimal coordinates "
                          "with code compiled for the scene: a bound."))
    return made


def steps(turns: int) -> list[Table]:
    """Time of a step at a user's step, whatever its error."""
    made = []
    for name, step in STEPS.items():
        scene = crosscheck.load_scene(name)
        brief = scene.replace(duration=min(5000 * step, scene.duration), samples=2)
        times: dict[tuple[str, ...], list[float]] = {}

        def once(contender: tuple[str, ...], brief: Any = brief, step: float = step) -> float:
            raw = adapters.get(contender[0]).run(brief, RunSpec(contender[1], step=step, monitor=False))
            return 1e6 * raw.wall_time / raw.steps

        for contender in STEPPERS:  # first calls pay for imports, page faults and cold caches
            try:
                once(contender)
                times[contender] = []
            except CrosscheckError:
                continue
        for _ in range(turns):
            for contender, own in times.items():
                own.append(undisturbed(lambda contender=contender: once(contender), 4)[0])
        made.append(table(f"Time of a step: {name}", ("engine", "method", "us", "deviation %", "ratio"), rows_of(times),
                          f"step {step:g} s. MuJoCo steps joint coordinates; lieeuler's methods step bodies with "
                          "multipliers and solve each step to rounding."))
    return made


def chains(turns: int) -> list[Table]:
    """Time of a step against the number of bodies."""
    times: dict[str, list[list[float]]] = {method: [] for method in CHAINED}
    for n in SIZES:
        problem, count = build_problem(driver.chain(n)), max(200, 20000 // n)
        for method in CHAINED:
            times[method].append([])
        for _ in range(turns):
            for method in CHAINED:
                control = {"rtol": RTOL} if "rtol" in lieeuler.METHODS[method].controls else {"step": STEP}
                stats = lieeuler.integrate(problem, method, t_eval=[0, count * STEP], monitor=False, **control).stats
                times[method][-1].append(1e6 * stats.wall_time / stats.steps)
    rows = []
    for method, own in times.items():
        middle = [statistics.median(each) for each in own]
        slope = np.polyfit(np.log(SIZES), np.log(middle), 1)[0]
        rows.append([method, *(f"{each:.3g}" for each in middle), f"{slope:.2f}"])
    columns = ("method", *(f"{n} bodies, us" for n in SIZES), "exponent")
    return [table("Time of a step of chains of balls", columns, rows,
                  f"step {STEP:g} s, taylor at rtol {RTOL:g}; the exponent is fitted to all sizes.")]


def many(turns: int) -> list[Table]:
    """Trajectories of an ensemble at an error."""
    rows = []
    for name in ("single_pendulum", "double_pendulum"):
        for wanted in (1e-3, 1e-6):
            found = ensembles.compared(name, wanted, MEMBERS, THREADS, turns)
            times = {("lieeuler" if "ensemble" in each else "", each): seconds
                     for each, (_, _, seconds) in found.items()}
            rows += [[name, f"{wanted:g}", *row[1:]] for row in rows_of(times, 1e-6)]
    return [table("Ensembles", ("scene", "median error, m", "contender", "us a member", "deviation %", "ratio"), rows,
                  f"{MEMBERS} members with scattered rates, {ensembles.DURATION:g} s, {THREADS} threads.")]


PARTS = {"errors": errors, "steps": steps, "chains": chains, "ensembles": many}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="tables (default: all)")
    parser.add_argument("--turns", type=int, default=7, help="of each contender (default: 7)")
    parser.add_argument("--out", type=Path, default=TARGET)
    options = parser.parse_args(arguments)
    made, load = dict[str, list[Table]](), os.getloadavg()[0]
    gc.disable()
    for name in options.only:
        made[name] = PARTS[name](options.turns)
        print(*(f"{each['title']}\n" + "\n".join("  ".join(map(str, row)) for row in each["rows"])
                for each in made[name]), sep="\n", flush=True)
        gc.collect()
    command = " ".join(["python -m benchmarks.speed", f"--turns {options.turns}", *(
        ["--only", *options.only] if options.only != list(PARTS) else [])])
    options.out.write_text(json.dumps({
        "command": command, "load": f"{load:.1f} to {os.getloadavg()[0]:.1f} at niceness {os.nice(0)}",
        **provenance.describe(ENGINES), "tables": [each for own in made.values() for each in own]}, indent=1) + "\n")


if __name__ == "__main__":
    main()
