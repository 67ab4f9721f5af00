"""Microseconds per step of the eight Lie group Euler methods beside MuJoCo's Euler, RK4 and implicitfast in its C loop.

Run with `python -m benchmarks.step_cost` or `make benchmark`; `--json` prints the figures for a program to read.

What is timed: the stepping alone (`wall_time` of a run: no model building, no sampling, no monitor), exponential map,
two samples, one thread. How: all contenders take turns in one process, so that a slow spell of the machine hits
each of them; medians over the rounds, spread as the median absolute deviation, and the ratio to the yardstick of the
scene as the median of the ratios within a round, in which such spells cancel. A turn is the fastest of a few in which
the process did not wait for its processor. It does not tell how accurate a step is. MuJoCo steps joint coordinates,
the methods here step bodies with multipliers and solve each step to rounding level.
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
from crosscheck.compare.timing import undisturbed
from crosscheck.running import provenance

EULER, FAST = ("mujoco", "Euler"), ("mujoco", "implicitfast")
SCENES = {"single_pendulum": (1e-3, EULER), "double_pendulum": (1e-3, EULER), "squeezer": (1e-5, FAST)}
"""Steps (s) that a user of a first-order method would take, and yardsticks."""
CONTENDERS = (EULER, ("mujoco", "RK4"), FAST, *(("lieeuler", method) for method in lieeuler.EULER_METHODS))


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
    scene, (step, yardstick) = crosscheck.load_scene(scene_name), SCENES[scene_name]
    steps = min(steps, round(scene.duration / step))
    iterations: dict[tuple[str, str], float | None] = {}

    def run(contender: tuple[str, str]) -> float:
        traj = crosscheck.run(scene, *contender, step=step, duration=steps * step, samples=2, monitor=False)
        count = traj.stats.get("newton_iterations")
        iterations[contender] = None if count is None else count / traj.steps
        return float(traj.wall_time)

    times: dict[tuple[str, str], list[float]] = {}
    for contender in CONTENDERS:  # first calls pay for imports, page faults and cold caches
        try:
            run(contender)
            times[contender] = []
        except crosscheck.CrosscheckError as error:
            print(f"{scene_name}, {' '.join(contender)}: {error}", file=sys.stderr)
    gc.disable()
    try:
        for _ in range(rounds):
            for contender, own in times.items():
                own.append(1e6 * undisturbed(lambda contender=contender: run(contender), 4)[0] / steps)
    finally:
        gc.enable()
    return [_cost(scene_name, contender, own, times[yardstick], iterations[contender])
            for contender, own in times.items()]


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
        table = Table("method", "us / step", "spread", f"x {' '.join(SCENES[scene][1])}", "Newton / step", title=scene,
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
    console.print(f"up to {steps} steps a run, medians of {rounds} interleaved runs")
    console.print(f"{machine['processor']}, {machine['cores']} cores, {machine['system']}; commit {origin['commit']}")
    console.print(", ".join(f"{name} {version}" for name, version in versions.items()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.step_cost", description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15, help="runs of each contender (default: 15)")
    parser.add_argument("--steps", type=int, default=5000, help="most steps of a run (default: 5000)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    options = parser.parse_args(arguments)
    if options.rounds < 1 or options.steps < 1:
        parser.error("--rounds and --steps must be positive")
    costs = [cost for scene in SCENES for cost in measure(scene, options.rounds, options.steps)]
    origin = provenance.describe(dict.fromkeys(engine for engine, _ in CONTENDERS))
    if options.json:
        print(json.dumps({"steps": options.steps, "rounds": options.rounds, **origin,
                          "costs": [dataclasses.asdict(cost) for cost in costs]}, indent=1))
    else:
        _print(costs, origin, options.rounds, options.steps)


if __name__ == "__main__":
    main()
