"""Two problems of the IFToMM library of computational benchmarks, end points to the digits the library states.

Symplectic Euler steps, extrapolated to step zero by Richardson: the error of a one-step method with a fixed step is a
power series in the step, as long as the motion is smooth.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import crosscheck

WANTED = 1e-6  # m, the accuracy the project asks of these end points
A01_END = (-0.27508746258, -0.96141920510)
A02_END = (0.32845811154, 0.94451853818)


def extrapolated(end_points: list[np.ndarray]) -> list[np.ndarray]:
    """The best value of every column of Richardson's table; each end point took half the step of the one before."""
    column, best = end_points, [end_points[-1]]
    for power in range(1, len(end_points)):
        column = [(2**power * fine - coarse) / (2**power - 1) for coarse, fine in pairwise(column)]
        best.append(column[-1])
    return best


def end_points(name: str, body: str, point: tuple[float, float, float], doublings: int) -> list[np.ndarray]:
    """x and y of a body's point after 10 s, with 2000 steps and more, doubling."""
    scene = crosscheck.load_scene(name).replace(duration=10.0, samples=2)
    index = [each.name for each in scene.bodies].index(body)
    runs = (crosscheck.run(scene, "lieeuler", "DAE1H_LSE", step=10.0 / (2000 * 2**k), monitor=False)
            for k in range(doublings))
    return [(run.x[-1, index] + run.R[-1, index] @ np.array(point))[:2] for run in runs]


@pytest.mark.parametrize(("name", "body", "point", "end"), [
    ("iftomm_simple_pendulum", "mass", (0.0, 0.0, 0.0), A01_END),
    ("double_four_bar", "rod A0B0", (0.0, 0.5, 0.0), A02_END),
])
def test_end_point_by_extrapolation(name, body, point, end):
    found = extrapolated(end_points(name, body, point, doublings=4))
    assert np.abs(found[-1] - end).max() < WANTED
    # a limit, not a lucky hit: the last two columns agree with each other as well
    assert np.abs(found[-1] - found[-2]).max() < 10 * WANTED


def test_the_double_four_bar_passes_its_singular_position_and_turns_on():
    """The cranks fall from the top, lie level with all five rods in line, and go round; the couplers stay level."""
    scene = crosscheck.load_scene("double_four_bar").replace(samples=1001)
    traj = crosscheck.run(scene, "lieeuler", "DAE1H_LSE", step=1e-3, monitor=False)
    cranks, couplers = traj.R[:, [0, 2, 4]], traj.R[:, [1, 3]]
    angle = np.unwrap(np.arctan2(cranks[:, 0, 0, 1], cranks[:, 0, 1, 1]))
    assert np.abs(angle[-1]) > 2 * np.pi
    # Off the singular position G holds the bars parallel; near it a rounding error of Phi, 50 eps of 2 m, may turn
    # them by its root, since a turn enters there squared.
    off_branch = np.sqrt(50 * np.finfo(float).eps * 2)
    assert np.abs(couplers - np.eye(3)).max() < off_branch
    assert np.abs(cranks - cranks[:, :1]).max() < off_branch


def test_the_double_four_bar_starts_as_the_library_says():
    scene = crosscheck.load_scene("double_four_bar")
    tip = scene.v0[0] + np.cross(scene.R0[0] @ scene.w0[0], scene.R0[0] @ [0.0, 0.5, 0.0])
    np.testing.assert_array_equal(tip, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(scene.x0, [[0, 0.5, 0], [0.5, 1, 0], [1, 0.5, 0], [1.5, 1, 0], [2, 0.5, 0]])
    np.testing.assert_array_equal(scene.masses, np.ones(5))
