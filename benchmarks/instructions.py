"""Instructions of one step of every method, by callgrind, whose counts do not depend on the load of the machine.

Totals of a long run less those of a short one, on chains and three mechanisms (tests/core/chain_driver.cpp).
`--json FILE` keeps the counts, `--against FILE` prints how they have changed since.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

import lieeuler
from benchmarks import driver

SYSTEMS = ("1", "2", "8", "64", "four_bar", "bricard", "squeezer")
STEP, RTOL = 1e-3, 1e-8  # s; of methods that choose their steps
SHORT, LONG = 5, 25  # steps


def per_step(program: Path, method: str, system: str) -> float | None:
    """Instructions of one step; None where a run fails, as of a squeezer whose closure drifts."""
    accuracy = RTOL if "rtol" in lieeuler.METHODS[method].controls else STEP
    try:
        few, many = (driver.count(program, method, system, steps, accuracy).instructions for steps in (SHORT, LONG))
    except RuntimeError:
        return None
    return (many - few) / (LONG - SHORT)


def main(arguments: Sequence[str] | None = None) -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.instructions", description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the counts to this file")
    parser.add_argument("--against", type=Path, help="counts of earlier to compare with")
    parser.add_argument("--methods", nargs="+", default=list(lieeuler.METHODS), choices=lieeuler.METHODS)
    options = parser.parse_args(arguments)
    if why := driver.missing_tool("valgrind", "c++"):
        parser.error(why)
    before = json.loads(options.against.read_text()) if options.against else {}
    counts: dict[str, dict[str, float | None]] = {}
    print(f"{'instructions a step':20}" + "".join(f"{system:>20}" for system in SYSTEMS))
    with tempfile.TemporaryDirectory() as folder:
        program = driver.build(Path(folder))
        for method in options.methods:
            counts[method] = {system: per_step(program, method, system) for system in SYSTEMS}
            cells = []
            for system, count in counts[method].items():
                earlier = before.get(method, {}).get(system)
                change = f" {100 * (count / earlier - 1):+6.2f} %" if count and earlier else ""
                cells.append(f"{count:.0f}{change}" if count else "fails")
            print(f"{method:20}" + "".join(f"{cell:>20}" for cell in cells), flush=True)
    if options.json:
        options.json.write_text(json.dumps(counts, indent=1))


if __name__ == "__main__":
    main()
