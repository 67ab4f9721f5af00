"""Cells: how many times faster than the best stock engine lieeuler reaches an error, scene by scene.

    python -m benchmarks.cells [SCENE ...] [--json FILE] [--heyoka]

A cell is a scene and an error at its end, m (rad of free bodies): the time of the cheapest mode of any other engine in
its own compiled loop over that of lieeuler's cheapest method, from the fastest of a few runs in turns. In brackets the
same with all that a prepared run spends around the kernel. Modes are found by walking every method's steps or
tolerances once; then the cheapest of each engine around each error take turns. Costs between rungs are interpolated.
A side that no run within LIMIT takes to an error counts with LIMIT. `--json` keeps the cells measured so far, so that
the table can be made in pieces. `--heyoka` adds its Taylor integrator on minimal coordinates, which is a bound and no
engine: lieeuler's time over its time.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import crosscheck
import lieeuler
from crosscheck import adapters
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.compare.timing import undisturbed
from crosscheck.errors import CrosscheckError
from crosscheck.references.taylor import Taylor
from crosscheck.running.attempt import Ran, attempt
from crosscheck.scene.model import Scene
from crosscheck.studies import work_precision as study
from crosscheck.verification.ladder import GradedWay, ladder, reference, ways

GOALS = {1e-2: 1.0, 1e-3: 2.0, 1e-6: 5.0, 1e-9: 5.0}
"""Wanted values by error."""
LIMIT = 0.1  # s of one run, after which a walk ends
MOST_FAILING, MOST_STEPS = 8, 1 << 20
RIVALS = 2  # ways of each side that take turns for a cell
NONE = "none in time"
"""In place of a mode if no run of a side within LIMIT reaches an error: its time is LIMIT or more."""
FINEST = 1e-10  # error below which a ladder ends
CALLS = 30

Rung = tuple[GradedWay, float]
"""A way, and its step (s) or tolerance."""


def stepping(scene: Scene, rung: Rung) -> tuple[float, Any]:
    """Seconds of stepping with two samples, and the trajectory; infinity if the run fails."""
    way, value = rung
    control = {"rtol" if way.adaptive else "step": value}
    outcome = attempt(scene, way, samples=2, monitor=False, derived=False, **control)
    return (outcome.raw.wall_time, outcome.raw.states) if isinstance(outcome, Ran) else (math.inf, None)


def walked(scene: Scene, way: GradedWay, error: Callable[[Any], float]) -> list[tuple[Rung, float, float]]:
    """The rungs of a way that run, coarse to fine, with errors and stepping times, s."""
    found: list[tuple[Rung, float, float]] = []
    failed = 0
    for count, value in ladder(scene, way):
        seconds, states = stepping(scene, (way, value))
        if states is None:
            failed += 1
        else:
            if seconds > LIMIT:  # the machine may have been busy
                seconds = min(seconds, stepping(scene, (way, value))[0])
            found.append(((way, value), error(states), seconds))
        hopeless = failed > MOST_FAILING or (count or 0) > MOST_STEPS
        if hopeless or (found and (found[-1][1] < FINEST or found[-1][2] > LIMIT)):
            break
    return found


def candidates(rungs: list[list[tuple[Rung, float, float]]]) -> list[int]:
    """Places of the ways that are cheapest at one of the errors."""
    chosen: set[int] = set()
    for level in GOALS:
        costs = [(study.cost_at([e for _, e, _ in own], [s for *_, s in own], level), place)
                 for place, own in enumerate(rungs) if own]
        chosen |= {place for _, place in sorted((cost, place) for cost, place in costs if cost)[:RIVALS]}
    return sorted(chosen)


def near(own: list[tuple[Rung, float, float]]) -> list[tuple[Rung, float, float]]:
    """The rungs on both sides of each error."""
    errors = study.confirmed([error for _, error, _ in own])
    kept: set[int] = set()
    for level in GOALS:
        first = next((k for k, error in enumerate(errors) if error <= level), None)
        kept |= {k for k in (() if first is None else (first - 1, first, first + 1)) if 0 <= k < len(own)}
    return [own[k] for k in sorted(kept)]


def around(scene: Scene, method: str) -> float:
    """Seconds of a prepared run outside the kernel."""
    control = {"rtol": 1e-6} if "rtol" in lieeuler.METHODS[method].controls else {"step": scene.duration / 64}
    times = np.array([0.0, scene.duration])
    run = lieeuler.prepare(build_problem(scene), method, t_eval=times, monitor=False, **control)

    def once() -> float:
        begin = time.perf_counter()
        solution = run()
        return time.perf_counter() - begin - solution.stats.wall_time

    try:
        return min(once() for _ in range(CALLS))
    except lieeuler.IntegrationError:
        return 0.0


def measured(scene: Scene, turns: int, heyoka: bool, only: Sequence[str] | None = None
             ) -> dict[str, dict[str, Any]]:
    """The cells of a scene by their errors: of each engine its cheapest method and the times of all turns, us.

    `heyoka` is among the engines where it is asked for; `only` these others take part.
    """
    sampled, truth = reference(scene)
    angles = study.compared(scene) == "end attitude"
    x, R = truth.states.x[-1], truth.states.R[-1]

    def error(states: Any) -> float:
        if not angles:
            return float(np.linalg.norm(states.x[-1] - x, axis=-1).max())
        return float(np.linalg.norm(states.R[-1] - R, axis=(-2, -1)).max() / math.sqrt(2))

    engines = only or [name for name in adapters.names() if not adapters.has_own_environment(name)]
    sides: dict[str, list[list[tuple[Rung, float, float]]]] = {}
    for way in ways(sampled, engines, default_form=True)[0]:
        sides.setdefault(way.engine, []).append(walked(sampled, way, error))
    rivals = {name: [near(rungs[place]) for place in candidates(rungs)] for name, rungs in sides.items()}
    times: dict[Rung, list[float]] = {rung: [] for group in rivals.values() for rungs in group for rung, *_ in rungs}
    runs = {rung: functools.partial(lambda rung: stepping(sampled, rung)[0], rung) for rung in times}
    if heyoka:
        series, own = Taylor(sampled), []
        for rtol in study.TOLERANCES:
            made, timer = study.bounds(sampled, truth, rtol, series)
            if timer is not None:
                rung = GradedWay(study.BOUND, "taylor"), rtol
                times[rung], runs[rung] = [], timer
                own.append((rung, made.end_attitude if angles else made.end_position, 0.0))
        rivals[study.BOUND] = [own]
    for _ in range(turns):
        for rung, own in times.items():
            own.append(undisturbed(runs[rung], 4, 0.02)[0])
    beside = {way.method: around(sampled, way.method) for way, _ in times if way.engine == study.IN_HOUSE}
    cells: dict[str, dict[str, Any]] = {}
    for level, (name, group) in itertools.product(GOALS, rivals.items()):
        best: tuple[float, str, list[float]] | None = None
        for rungs in group:
            costs = [study.cost_at([e for _, e, _ in rungs], [times[rung][turn] for rung, *_ in rungs], level)
                     for turn in range(turns)]
            if all(costs) and (best is None or min(costs) < best[0]):
                best = min(costs), rungs[0][0][0].method, [1e6 * cost for cost in costs]
        if best is not None:
            cells.setdefault(f"{level:g}", {})[name] = {"method": best[1], "us": best[2], "around": 1e6 * beside.get(
                best[1], 0.0) if name == study.IN_HOUSE else 0.0}
    return cells


def sides(cell: dict[str, Any]) -> tuple[str, float, float, str, float]:
    """lieeuler's method, its time and that around it, the cheapest other engine with its method, and its time; us."""
    none = {"method": NONE, "us": [1e6 * LIMIT], "around": 0.0}
    own = cell.get(study.IN_HOUSE, none)
    name, stock = min(((name, each) for name, each in cell.items() if name not in (study.IN_HOUSE, study.BOUND)),
                      key=lambda each: min(each[1]["us"]), default=("", none))
    return own["method"], min(own["us"]), own["around"], f"{name} {stock['method']}".strip(), min(stock["us"])


def values(cell: dict[str, Any]) -> tuple[float, float]:
    """Times stock, of stepping and of whole prepared calls."""
    _, own, beside, _, stock = sides(cell)
    return stock / own, stock / (own + beside)


def line(name: str, cells: dict[str, dict[str, Any]]) -> str:
    """A row of the table; cells short of the goal are marked."""
    words = [f"{name:24}"]
    for error, goal in GOALS.items():
        cell = cells.get(f"{error:g}")
        if cell is None:
            words.append(" " * 17)
            continue
        steps, calls = values(cell)
        bound = f" h{sides(cell)[1] / min(cell[study.BOUND]['us']):.2f}" if study.BOUND in cell else ""
        least = ">" if sides(cell)[3] == NONE else ""
        words.append(f"{f'{least}{steps:.2f}' + '*' * (steps < goal) + f' ({calls:.2f})' + bound:17}")
    return " ".join(words)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, keep and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cells", description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="default: all of the library without friction, stops and servos")
    parser.add_argument("--json", type=Path, help="where cells are kept; scenes in it are not measured again")
    parser.add_argument("--turns", type=int, default=3, help="of every rung near an error (default: 3)")
    parser.add_argument("--heyoka", action="store_true", help="also lieeuler's time over heyoka's, after an h")
    options = parser.parse_args(arguments)
    known = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    print(f"{'times stock':24} " + " ".join(f"{f'{error:g} (goal {goal:g})':17}" for error, goal in GOALS.items()))
    names = options.scenes or [name for name in crosscheck.scenes() if not crosscheck.load_scene(name).has_laws]
    for name in names:
        if name not in known:
            try:
                known[name] = measured(crosscheck.load_scene(name), options.turns, options.heyoka)
            except CrosscheckError as error:
                print(f"{name:24} {error}", flush=True)
                continue
            if options.json:
                options.json.write_text(json.dumps(known, indent=1))
        print(line(name, known[name]), flush=True)
    short = [(name, error, cell, goal) for name in names for error, goal in GOALS.items()
             if (cell := known.get(name, {}).get(f"{error:g}")) and values(cell)[0] < goal]
    print(f"\n{sum(len(known.get(name, {})) for name in names)} cells, {len(short)} short:")
    for name, error, cell, goal in short:
        own, us, beside, stock, stock_us = sides(cell)
        print(f"{name:24} {error:g}: {values(cell)[0]:.2f} of {goal:g}, {own} {us:.0f} us and {beside:.0f} around, "
              f"{stock} {stock_us:.0f} us")


if __name__ == "__main__":
    main()
