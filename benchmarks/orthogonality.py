"""How far attitudes leave SO(3): the papers' methods with and without the polish, beside an additive Euler update.

    python -m benchmarks.orthogonality [--steps 1000000] [--step 1e-3] [--scene double_pendulum]

Prints the largest entry of R^T R - I after powers of ten of steps, on the two pendulums of the tests.
"""

from __future__ import annotations

import argparse
import contextlib

import numpy as np

import lieeuler
from tests import oracle
from tests.lieeuler.systems import SYSTEMS

SCENES = ("single_pendulum", "double_pendulum")
METHODS = ("DAE1L_LSE", "DAE1H_LSE")


def defect(R):
    """Largest entry of R^T R - I."""
    return np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max()


def of_method(problem, method, step, marks, polish):
    """Defects after `marks` steps of a method."""
    solution = lieeuler.integrate(problem, method, step, step * np.array([0, *marks]), polish=polish, monitor=False)
    return [defect(R) for R in solution.R[1:]]


def of_additive(problem, step, marks):
    """Defects after `marks` steps of the additive comparator; infinite once it has overflowed."""
    system = oracle.Chain([body.mass for body in problem.bodies], [body.inertia for body in problem.bodies],
                          [(j.parent, j.child, j.parent_anchor, j.child_anchor) for j in problem.joints],
                          problem.gravity)
    steps = oracle.additive_steps(system, (problem.x, problem.R), np.hstack([problem.v, problem.w]).ravel(), step)
    defects = []
    with np.errstate(all="ignore"), contextlib.suppress(np.linalg.LinAlgError):  # what has overflowed has no inverse
        for n, (q, u) in enumerate(steps, 1):
            if n in marks:
                defects.append(defect(q[1]))
            if n == marks[-1] or not np.isfinite(u).all():
                break
    return defects + [np.inf] * (len(marks) - len(defects))


def rows(scenes, steps, step):
    """(scene, run, defects) of every run."""
    marks = [10**k for k in range(2, 12) if 10**k < steps] + [steps]
    for scene in scenes:
        problem = SYSTEMS[scene]()
        for method in METHODS:
            for polish in (True, False):
                label = f"{method}{'' if polish else ', no polish'}"
                yield scene, label, dict(zip(marks, of_method(problem, method, step, marks, polish), strict=True))
        yield scene, "additive Euler", dict(zip(marks, of_additive(problem, step, marks), strict=True))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--step", type=float, default=1e-3, help="s")
    parser.add_argument("--scene", choices=SCENES, action="append", help="may be repeated; default: both")
    arguments = parser.parse_args()
    for number, (scene, run, defects) in enumerate(rows(arguments.scene or SCENES, arguments.steps, arguments.step)):
        if number == 0:
            print(f"{'scene':16} {'run':22}", *(f"{f'{n:,} steps':>16}" for n in defects))
        print(f"{scene:16} {run:22}", *(f"{value:16.1e}" for value in defects.values()), flush=True)


if __name__ == "__main__":
    main()
