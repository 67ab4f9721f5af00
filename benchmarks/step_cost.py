"""Microseconds per step of the eight Lie group Euler methods beside MuJoCo's Euler and RK4 in its C loop.

Run with `python -m benchmarks.step_cost` or `make benchmark`; `--json` prints the figures for a program to read.

What is timed: the stepping alone (`wall_time` of a run: no model building, no sampling, no monitor), exponential map,
two samples, one thread. How: all contenders take turns in one process, so that a slow spell of the machine hits
each of them; medians over the rounds, spread as the median absolute deviation, and the ratio to MuJoCo's Euler as the
median of the ratios within a round, in which such spells cancel. It does not tell how accurate a step is. MuJoCo
steps joint coordinates, the methods here step bodies with multipliers and solve each step to rounding level.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import json
import statistics
import sys
from collections.abc import Sequence
from typing import Any

import crosscheck
import lieeuler
from crosscheck.running import provenance

SCENES = ("single_pendulum", "double_pendulum")
YARDSTICK = ("mujoco", "Euler")
CONTENDERS = (YARDSTICK, ("mujoco", "RK4"), *(("lieeuler", method) for method in lieeuler.EULER_METHODS))
STEP = 1e-3  # s; what a user of a first-order method would take


@dataclasses.dataclass(frozen=True)
class Cost:
    """What a step of one contender costs on one scene."""

    scene: str
    engine: str
    method: str
    us_per_step: float  # median over the rounds
    spread: float  # us, median absolute deviation
    ratio: float  # to the yardstick, median over the rounds
    newton_per_step: float | None  # mean number of Newton iterations; None where there is no iteration to count


def measure(scene_name: str, rounds: int, steps: int) -> list[Cost]:
    """Costs of all contenders on one scene, `rounds` interleaved runs of `steps` steps each."""
    scene = crosscheck.load_scene(scene_name)

    def run(contender: tuple[str, str], count: int) -> Any:
        return crosscheck.run(scene, *contender, step=STEP, duration=count * STEP, samples=2, monitor=False)

    for contender in CONTENDERS:
        run(contender, max(2, steps // 10))  # first calls pay for imports, page faults and cold caches
    times: dict[tuple[str, str], list[float]] = {contender: [] for contender in CONTENDERS}
    iterations: dict[tuple[str, str], float | None] = {}
    gc.disable()
    try:
        for _ in range(rounds):
            for contender in CONTENDERS:
                traj = run(contender, steps)
                times[contender].append(1e6 * traj.wall_time / traj.steps)
                count = traj.stats.get("newton_iterations")
                iterations[contender] = None if count is None else count / traj.steps
    finally:
        gc.enable()
    return [_cost(scene_name, contender, times[contender], times[YARDSTICK], iterations[contender])
            for contender in CONTENDERS]


def _cost(scene: str, contender: tuple[str, str], times: list[float], yardstick: list[float],
          newton: float | None) -> Cost:
    median = statistics.median(times)
    spread = statistics.median(abs(time - median) for time in times)
    ratio = statistics.median(own / other for own, other in zip(times, yardstick, strict=True))
    return Cost(scene, *contender, median, spread, ratio, newton)


def _print(costs: Sequence[Cost], origin: dict[str, Any], rounds: int, steps: int) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    for scene in SCENES:
        table = Table("method", "us / step", "spread", "x MuJoCo Euler", "Newton / step", title=scene,
                      title_justify="left", box=None)
        for column in table.columns[1:]:
            column.justify = "right"
        for cost in costs:
            if cost.scene == scene:
                newton = "" if cost.newton_per_step is None else f"{cost.newton_per_step:.2f}"
                table.add_row(f"{cost.engine} {cost.method}", f"{cost.us_per_step:.3f}", f"{cost.spread:.3f}",
                              f"{cost.ratio:.2f}", newton)
        console.print(table)
        console.print()
    machine = origin["machine"]
    versions = {"python": origin["python"], **origin["engines"], **origin["packages"]}
    console.print(f"step {STEP:g} s, {steps} steps a run, medians of {rounds} interleaved runs")
    console.print(f"{machine['processor']}, {machine['cores']} cores, {machine['system']}; commit {origin['commit']}")
    console.print(", ".join(f"{name} {version}" for name, version in versions.items()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.step_cost", description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15, help="runs of each contender (default: 15)")
    parser.add_argument("--steps", type=int, default=20000, help="steps of a run (default: 20000)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    options = parser.parse_args(arguments)
    if options.rounds < 1 or options.steps < 1:
        parser.error("--rounds and --steps must be positive")
    costs = [cost for scene in SCENES for cost in measure(scene, options.rounds, options.steps)]
    origin = provenance.describe(dict.fromkeys(engine for engine, _ in CONTENDERS))
    if options.json:
        print(json.dumps({"step": STEP, "steps": options.steps, "rounds": options.rounds, **origin,
                          "costs": [dataclasses.asdict(cost) for cost in costs]}, indent=1))
    else:
        _print(costs, origin, options.rounds, options.steps)


if __name__ == "__main__":
    main()
