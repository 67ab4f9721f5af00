"""What a constant mass matrix buys: one Runge-Kutta rule on the Lie group form and on Euler parameters.

    python -m benchmarks.euler_parameters [--steps 1000]

The forms are in `benchmarks/euler_parameters.cpp`, compiled alike. Prints instructions per step (callgrind, where
valgrind is installed), the error of the position after one second at equal steps, against the Taylor method at rounding
level, and what is left of the group.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import lieeuler
from tests.lieeuler.systems import SYSTEMS

SOURCE = Path(__file__).with_suffix(".cpp")
FORMS = ("lie", "factored", "inverse")
"""The Lie group; Euler parameters, their mass matrix factored in every stage, or its inverse in closed form."""


def build(folder):
    """Path of the compiled program."""
    import cmeel

    headers = Path(cmeel.__file__).parents[1] / "cmeel.prefix" / "include" / "eigen3"
    program = Path(folder) / "euler_parameters"
    subprocess.run([os.environ.get("CXX", "c++"), "-std=c++20", "-O3", "-DNDEBUG", f"-I{headers}", str(SOURCE), "-o",
                    str(program)], check=True)
    return program


def end(program, form, steps):
    """Position after one second, and the defect of the rotation (of |p| with Euler parameters)."""
    done = subprocess.run([str(program), form, str(steps), "1"], check=True, capture_output=True, text=True)
    *x, drift = map(float, done.stdout.split())
    return np.array(x), drift


def instructions(program, form, steps):
    """Of one step: those of 2n steps less those of n, by n; None without valgrind."""
    if shutil.which("valgrind") is None:
        return None
    counts = []
    for n in (steps, 2 * steps):
        done = subprocess.run(["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", str(program), form,
                               str(n), "1"], check=True, capture_output=True, text=True)
        counts.append(int(re.search(r"Collected : (\d+)", done.stderr)[1]))
    return (counts[1] - counts[0]) / steps


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=1000)
    steps = parser.parse_args().steps
    exact = lieeuler.integrate(SYSTEMS["single_pendulum"](), "taylor", rtol=1e-14, t_eval=[0, 1]).x[-1, 0]
    with tempfile.TemporaryDirectory() as folder:
        program = build(folder)
        errors_of = (f"{f'error, {n} steps':>20}" for n in (50, 100, 200, steps))
        print(f"{'form':12} {'instructions a step':>20}", *errors_of, f"{'defect':>10}")
        for form in FORMS:
            count = instructions(program, form, steps)
            errors = [np.linalg.norm(end(program, form, n)[0] - exact) for n in (50, 100, 200, steps)]
            print(f"{form:12} {'no valgrind' if count is None else f'{count:.0f}':>20}",
                  *(f"{error:20.2e}" for error in errors), f"{end(program, form, steps)[1]:10.1e}")


if __name__ == "__main__":
    main()
