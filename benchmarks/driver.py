"""Counts of the kernel without Python (tests/core/chain_driver.cpp) by callgrind: they do not depend on the load."""

from __future__ import annotations

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import lieeuler

__all__ = ["Run", "arguments", "build", "count", "missing_tool"]

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "tests" / "core" / "chain_driver.cpp"
HEADERS = ROOT / "lieeuler" / "_core"


@dataclasses.dataclass(frozen=True)
class Run:
    """A counted run: instructions, Newton iterations, and callgrind's file."""

    instructions: int
    iterations: int
    profile: Path


def missing_tool(*tools: str) -> str | None:
    """Why nothing can be counted here, or None."""
    absent = [tool for tool in tools if shutil.which(tool) is None]
    return f"{' and '.join(absent)} not installed" if absent else None


def build(folder: Path, *flags: str) -> Path:
    """The driver, compiled as the kernel is."""
    import cmeel  # its prefix holds the Eigen headers the kernel is built with

    program = folder / "driver"
    include = Path(cmeel.__file__).parents[1] / "cmeel.prefix" / "include" / "eigen3"
    subprocess.run(["c++", "-std=c++20", "-O3", "-fno-math-errno", "-w", *flags, "-I", str(include), "-I",
                    str(HEADERS), str(SOURCE), "-o",
                    str(program)], check=True)
    return program


def arguments(folder: Path, method: str, bodies: int | str, steps: int, step: float) -> list[str]:
    """The driver's arguments; a method's coefficients are written to `folder`."""
    record = lieeuler.METHODS[method]
    rule, file = record.tableau, folder / f"{method}.txt"
    words: list[float] = [len(record.composition), *record.composition]
    if rule is not None:
        words = [rule.order]
        for rows in (rule.stages, (rule.weights,), rule.errors, rule.extra, rule.dense):
            words.append(len(rows))
            for row in rows:
                words += [len(row), *row]
    file.write_text(" ".join(map(repr, words)))
    return [method, str(bodies), str(steps), str(step), str(file)]


def count(program: Path, method: str, bodies: int | str, steps: int, step: float, *options: str) -> Run:
    """Runs the driver under callgrind; `options` are callgrind's own."""
    profile = program.with_name("callgrind.out")
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={profile}", *options,
               str(program), *arguments(program.parent, method, bodies, steps, step)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)  # 1: it allocated
    total, iterations = re.search(r"Collected : (\d+)", run.stderr), re.search(r"iterations (\d+)", run.stdout)
    if total is None or iterations is None:
        raise RuntimeError(f"callgrind did not say what it counted: {run.stderr or run.stdout}")
    return Run(int(total[1]), int(iterations[1]), profile)
