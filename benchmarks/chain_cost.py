"""Cost of a step against the number of bodies: chains of pendulums, beside MuJoCo's Euler and Exudyn's sparse solver.

Run with `python -m benchmarks.chain_cost`; `--json` prints the figures for a program to read, `--sizes 64 256 1024 4096
--methods DAE1L_LSE taylor` takes other chains and methods.

Wall time: stepping alone (`wall_time`), samples = 2, no monitor, all contenders of a size in turn in one process,
least of the rounds. With valgrind also the instructions of one Newton iteration, counted by callgrind on
tests/core/chain_driver.cpp (totals of a long run less those of a short one): these do not depend on the load of the
machine. Exponents are fitted over sizes from 16 up.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import lieeuler
from benchmarks import driver
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.running import provenance

SIZES = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 4096)
COUNTED = (16, 64, 256, 1024, 4096)
BESIDE = (8, 32, 128)
ENGINES = (("mujoco", "Euler"), ("exudyn", "TrapezoidalIndex2"))
STEP, RTOL = 1e-3, 1e-8  # s, of adaptive methods
FEWEST = 200  # steps of a run, over which the cost of its start, planning included, is spread


def wall_times(n: int, rounds: int, methods: Sequence[str]) -> dict[str, float]:
    """Microseconds per step by contender, least of interleaved rounds; adaptive methods at RTOL."""
    scene = driver.chain(n)
    steps = max(FEWEST, 20000 // n)
    problem, few = build_problem(scene), max(FEWEST // 10, steps // 10)
    times: dict[str, list[float]] = {}
    for _ in range(rounds):
        for method in methods:
            control = {"rtol": RTOL} if "rtol" in lieeuler.METHODS[method].controls else {"step": STEP}
            stats = lieeuler.integrate(problem, method, t_eval=[0, steps * STEP], monitor=False, **control).stats
            times.setdefault(f"lieeuler {method}", []).append(1e6 * stats.wall_time / stats.steps)
        for engine, method in ENGINES if n in BESIDE else ():
            # The adapter alone: what crosscheck.run derives from a trajectory costs n^3 and belongs to no step.
            brief = scene.replace(duration=few * STEP, samples=2)
            raw = adapters.get(engine).run(brief, RunSpec(method, step=STEP, monitor=False))
            times.setdefault(f"{engine} {method}", []).append(1e6 * raw.wall_time / raw.steps)
    return {name: min(values) for name, values in times.items()}  # whatever else runs on the machine only adds to it


def instructions(sizes: Sequence[int], methods: Sequence[str]) -> dict[str, list[float]]:
    """Instructions of one Newton iteration, or else of one step, by method and size."""
    counts: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        program = driver.build(Path(folder))
        for method in methods:
            accuracy = RTOL if "rtol" in lieeuler.METHODS[method].controls else STEP
            for n in sizes:
                short, long = (driver.count(program, method, n, steps, accuracy) for steps in (6, 16))
                counts.setdefault(method, []).append((long.instructions - short.instructions)
                                                     / (long.iterations - short.iterations or 10))
    return counts


def exponent(sizes: Sequence[int], costs: Sequence[float]) -> float:
    """Slope of log cost against log size, sizes from 16 up."""
    large = [k for k, n in enumerate(sizes) if n >= 16]
    return float(np.polyfit(np.log([sizes[k] for k in large]), np.log([costs[k] for k in large]), 1)[0])


def _print(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False)
    wall, sizes = result["us_per_step"], result["sizes"]
    table = Table("us / step", *(f"n = {n}" for n in sizes), "exponent", title_justify="left", box=None)
    for name in wall[str(sizes[0])]:
        costs = [wall[str(n)][name] for n in sizes]
        table.add_row(name, *(f"{cost:.1f}" for cost in costs), f"{exponent(sizes, costs):.2f}")
    console.print(table)
    if beside := [n for n in BESIDE if n in sizes]:
        table = Table("us / step", *(f"n = {n}" for n in beside), box=None)
        for name in wall[str(beside[-1])]:
            table.add_row(name, *(f"{wall[str(n)][name]:.1f}" for n in beside))
        console.print(table)
    if result["instructions"]:
        counted = result["counted"]
        table = Table("instructions / iteration / body", *(f"n = {n}" for n in counted), "exponent", box=None)
        for name, costs in result["instructions"].items():
            table.add_row(name, *(f"{cost / n:.0f}" for n, cost in zip(counted, costs, strict=True)),
                          f"{exponent(counted, costs):.3f}")
        console.print(table)
    else:
        console.print(f"instructions: not counted, {result['not_counted']}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.chain_cost", description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="runs of each contender (default: 5)")
    parser.add_argument("--no-instructions", action="store_true", help="wall times only")
    parser.add_argument("--methods", nargs="+", default=lieeuler.EULER_METHODS, choices=lieeuler.METHODS)
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES, help="numbers of bodies")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    options = parser.parse_args(arguments)
    if options.rounds < 1:
        parser.error("--rounds must be positive")
    not_counted = "as asked" if options.no_instructions else driver.missing_tool("valgrind", "c++")
    counted = [n for n in options.sizes if n in COUNTED] or options.sizes
    result = {"step": STEP, "sizes": options.sizes, "counted": counted, "not_counted": not_counted,
              "us_per_step": {str(n): wall_times(n, options.rounds, options.methods) for n in options.sizes},
              "instructions": {} if not_counted else instructions(counted, options.methods),
              **provenance.describe(dict.fromkeys(engine for engine, _ in ENGINES))}
    if options.json:
        print(json.dumps(result, indent=1))
    else:
        _print(result)


if __name__ == "__main__":
    main()
