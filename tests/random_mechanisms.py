"""Random trees and loops of all joints, graded by up to sixteen decades, and absurd steps.

Bodies are placed first and joints drawn so that they close where the bodies stand; everything starts at rest, or turns
as one rigid body.
"""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import lieeuler
from tests.kernel_mutations import FIELDS, judged

JOINTS = ("spherical", "universal", "revolute", "cylindrical", "prismatic", "planar", "fixed", "distance",
          "point_on_line", "point_on_plane")
FLAT = ("revolute", "prismatic", "planar", "fixed")
METHODS = tuple(sorted(lieeuler.METHODS))
LOOSE = 1e-5
"""Bound on the last state of a success, over the sizes of the system: a thousand times what a run may open, for a run
is held against its largest speed and length."""


def decades(random: Random, most: float) -> float:
    """A factor: one half the time, else any within so many decades."""
    return 10.0 ** random.uniform(-most, most) if random.random() < 0.5 else 1.0


def vector(random: Random, size: float = 1.0) -> np.ndarray:
    return np.array([random.gauss(0, size) for _ in range(3)])


def axes(random: Random) -> np.ndarray:
    """A rotation matrix."""
    return np.asarray(Rotation.from_quat([random.gauss(0, 1) for _ in range(4)]).as_matrix())


def body(random: Random, size: float) -> lieeuler.Body:
    """A body of any mass and of possible moments: round, thin or small."""
    mass = decades(random, 8)
    least = 10.0 ** -random.choice((0, 0, 0, 2, 6, 10))
    moments = np.array([least, 1.0, 1.0 + least * random.random()])
    turn = axes(random)
    inertia = turn @ np.diag(moments * mass * size**2 * decades(random, 4)) @ turn.T
    return lieeuler.Body(mass, (inertia + inertia.T) / 2)


def joint(random: Random, kind: str, parent: int, child: int, x: np.ndarray, R: np.ndarray, size: float,
          normal: np.ndarray | None = None) -> Any:
    """A joint that is closed where its bodies stand; normal: of the plane that it keeps, for the kinds of `FLAT`."""
    at_parent, origin = (R[parent], x[parent]) if parent >= 0 else (np.eye(3), np.zeros(3))
    point = x[child] + R[child] @ vector(random, 0.5 * size)
    frame, offset = axes(random), vector(random, size)
    known = {"parent": parent, "child": child, "parent_anchor": at_parent.T @ (point - origin),
             "child_anchor": R[child].T @ (point - x[child])}
    if normal is not None:
        across = np.cross(normal, frame[0])
        frame[0] = across / np.linalg.norm(across) if kind == "prismatic" else normal
    axis = frame[0]
    if kind in ("revolute", "cylindrical", "prismatic", "planar", "universal", "point_on_line", "point_on_plane"):
        known["parent_axis"] = at_parent.T @ axis
    if kind in ("revolute", "cylindrical", "prismatic", "planar"):
        known["child_axis"] = R[child].T @ axis
    if kind == "universal":
        known["child_axis"] = R[child].T @ frame[1]
    if kind in ("fixed", "prismatic"):
        known["relative"] = R[child].T @ at_parent
    if kind == "distance":
        known["parent_anchor"] = known["parent_anchor"] + at_parent.T @ offset
        known["length"] = float(np.linalg.norm(offset))
    return getattr(lieeuler, f"{kind}_joint")(**known)


def mechanism(random: Random, flat: bool = False) -> lieeuler.Problem:
    """One to six bodies on a tree, with up to two more joints between any of them; flat: all move in planes."""
    n, size = random.randint(1, 6), decades(random, 3)
    x, R = np.array([vector(random, size) for _ in range(n)]), np.array([axes(random) for _ in range(n)])
    normal = axes(random)[0] if flat else None
    floating = random.random() < 0.2 and not flat
    pairs = [(random.randint(-1, k - 1), k) for k in range(int(floating), n)]
    if floating:
        pairs = [(max(parent, 0), child) for parent, child in pairs]
    for _ in range(random.choice((0, 0, 1, 2)) if n > 1 else 0):
        child = random.randrange(1, n)
        pairs.append((random.randint(0 if floating else -1, child - 1), child))
    joints = [joint(random, random.choice(FLAT if flat else JOINTS), parent, child, x, R, size, normal)
              for parent, child in pairs]
    loads: list[Any] = []
    for k in range(n):
        if random.random() < 0.3:
            loads.append(lieeuler.ConstantLoad(k, force=vector(random, decades(random, 6)),
                                               torque=vector(random, decades(random, 6)), frame="body"))
        if random.random() < (0.05 if flat else 0.2):  # springs pull out of planes
            loads.append(lieeuler.LinearSpring(-1, k, vector(random, size), vector(random, size), decades(random, 9),
                                               size * random.random(), random.choice((0.0, decades(random, 4)))))
    turning = vector(random, decades(random, 2)) if floating else np.zeros(3)
    gravity = vector(random, 10 * decades(random, 3))
    return lieeuler.Problem([body(random, size) for _ in range(n)], joints, gravity, x, R, np.cross(turning, x),
                            np.swapaxes(R, 1, 2) @ turning, loads)


def case(random: Random, flat: bool = False) -> tuple[Callable[[], lieeuler.Problem], dict[str, Any]]:
    """A function that makes a problem, and the arguments of `integrate`."""
    draw = random.getrandbits(64)
    method = random.choice(METHODS)
    controls = lieeuler.METHODS[method].controls
    options: dict[str, Any] = {"method": method, "spin_free": random.choice((None, True, False)),
                               "monitor": random.random() < 0.8}
    end = 10.0 ** random.uniform(-6, 2)
    if "step" in controls:
        options["step"] = end / 10.0 ** random.uniform(0, 3)
    elif "rtol" in controls:
        options["rtol"] = 10.0 ** random.uniform(-14, -1)
    options["t_eval"] = [0.0, end / 3, end]
    return lambda: mechanism(Random(draw), flat), options


def answer(random: Random) -> str:
    """"refused", or the status; what is finite and closed by its own account must be so by that of a new problem."""
    make, options = case(random, flat=random.random() < 0.2)
    solution = judged(make, **options)
    if solution is None:
        return "refused"
    if solution.success and {"position", "velocity"} <= set(lieeuler.METHODS[options["method"]].held):
        problem = make()
        levels = lieeuler._kernel.constraint_levels(problem.kernel, *(
            np.ascontiguousarray(getattr(solution, name)[-1:]) for name in ("x", "R", "v", "w")), 0.0,
            float(solution.t[-1] - solution.t[0]))
        reach = max(1.0, np.abs(solution.v).max(initial=0.0) / max(np.abs(solution.v[-1]).max(initial=0.0), 1e-300))
        far = max(1.0, np.abs(solution.x).max() / problem.kernel.length)  # thrown along a slide by an absurd step
        assert levels[0, 0] <= LOOSE * far, f"positions open by {levels[0, 0]:.3g}"
        assert levels[0, 1] <= LOOSE * reach * far, f"velocities open by {levels[0, 1]:.3g}"
        turns = np.swapaxes(solution.R, -1, -2) @ solution.R - np.eye(3)
        assert np.abs(turns).max() < 1e-12
    return solution.status.value


def again(random: Random) -> tuple[np.ndarray, ...]:
    """The samples of a run, to be compared bit by bit with those of the same draw."""
    make, options = case(random, flat=random.random() < 0.2)
    solution = judged(make, **options)
    return () if solution is None else tuple(getattr(solution, name) for name in FIELDS)
