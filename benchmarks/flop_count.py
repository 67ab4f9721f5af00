"""Floating-point operations and instructions of one step of the eight Euler methods, by callgrind.

The scalar and packed additions, subtractions, multiplications, divisions, square roots, maxima and minima that were
executed, out of callgrind's counts per instruction and objdump's listing of the program: a packed one of two doubles is
two operations. Totals of a long run less those of a short one.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import lieeuler
from benchmarks import driver

SIZES = (1, 2, 8)
STEP = 1e-3  # s
SHORT, LONG = 6, 106  # steps
ARITHMETIC = re.compile(r"(?:add|sub|mul|div|sqrt|max|min)(s|p)d$")


def operations(program: Path) -> dict[int, int]:
    """Floating-point operations of the instruction at each address."""
    listing = subprocess.run(["objdump", "-d", "--no-show-raw-insn", str(program)], capture_output=True, text=True,
                             check=True)
    found = {}
    for line in listing.stdout.splitlines():
        address, _, text = line.partition(":\t")
        words = text.split()
        kind = ARITHMETIC.match(words[0]) if words else None
        if kind:
            found[int(address, 16)] = 1 if kind[1] == "s" else 2
    return found


def executions(profile: Path, program: Path) -> dict[int, int]:
    """How often each instruction of the program itself ran: callgrind's file, with positions `instr line`."""
    counts: dict[int, int] = {}
    here, inside, inclusive = 0, False, False
    names: dict[str, str] = {}
    for line in profile.read_text().splitlines():
        if line.startswith(("ob=", "cob=")):  # of what follows, of what is called; named at the first mention
            number, _, name = line.partition("=")[2].partition(" ")
            names.setdefault(number, name)
            if line.startswith("ob="):
                inside = names[number] == str(program)
        elif line.startswith("calls="):
            inclusive = True  # the next line's cost is that of the called
        elif line[:1] in "0123456789+-*" and line:
            position, _, cost = line.split()
            here = int(position, 16) if position.startswith("0x") else here + (0 if position == "*" else int(position))
            if inside and not inclusive:
                counts[here] = counts.get(here, 0) + int(cost)
            inclusive = False
    return counts


def per_step(program: Path, method: str, bodies: int) -> tuple[float, float]:
    """(floating-point operations, instructions) of one step."""
    arithmetic = operations(program)
    totals = []
    for steps in (SHORT, LONG):
        run = driver.count(program, method, bodies, steps, STEP, "--dump-instr=yes")
        ran = executions(run.profile, program)
        totals.append((sum(ran.get(address, 0) * flops for address, flops in arithmetic.items()), run.instructions))
    (few_flops, few), (many_flops, many) = totals
    return (many_flops - few_flops) / (LONG - SHORT), (many - few) / (LONG - SHORT)


def main(arguments: Sequence[str] | None = None) -> None:
    """Count and print."""
    from rich.console import Console
    from rich.table import Table

    parser = argparse.ArgumentParser(prog="python -m benchmarks.flop_count", description=__doc__.splitlines()[0])
    parser.parse_args(arguments)
    if why := driver.missing_tool("valgrind", "objdump", "c++"):
        parser.error(why)
    sizes = (f"n = {n}" for n in SIZES)
    table = Table("operations / instructions a step", *sizes, "instructions / operation", box=None)
    with tempfile.TemporaryDirectory() as folder:
        program = driver.build(Path(folder), "-no-pie", "-g")
        for method in lieeuler.EULER_METHODS:
            counts = [per_step(program, method, n) for n in SIZES]
            table.add_row(method, *(f"{flops:.0f} / {total:.0f}" for flops, total in counts),
                          f"{counts[-1][1] / counts[-1][0]:.2f}")
    Console(highlight=False).print(table)


if __name__ == "__main__":
    main()
