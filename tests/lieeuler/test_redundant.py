"""Closed loops: redundant rows are found once and solved in the least-norm sense; singular positions have a name."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler import _kernel
from tests.lieeuler.accuracy import EPS, dense_index1, mass_matrix
from tests.lieeuler.systems import SYSTEMS

Y = np.array([0.0, 1.0, 0.0])


def linkage(points, gravity=(0, 0, -9.81)):
    """Rods of 1 kg in the x-z plane along a polygon, hinged about y; first and last point are on the ground."""
    points = np.array(points, float)
    ends = list(itertools.pairwise(points))
    lengths = [np.linalg.norm(b - a) for a, b in ends]
    R = np.array([Rotation.from_rotvec(-np.arctan2(*(b - a)[[2, 0]]) * Y).as_matrix() for a, b in ends])
    bodies = [lieeuler.Body(1.0, np.diag([0.01, L**2 / 12 + 0.01, L**2 / 12 + 0.01])) for L in lengths]
    half = [np.array([L / 2, 0, 0]) for L in lengths]
    joints = [lieeuler.revolute_joint(-1, 0, points[0], -half[0], Y, Y)]
    joints += [lieeuler.revolute_joint(k, k + 1, half[k], -half[k + 1], Y, Y) for k in range(len(ends) - 1)]
    joints += [lieeuler.revolute_joint(-1, len(ends) - 1, points[-1], half[-1], Y, Y)]
    rest = np.zeros((len(ends), 3))
    return lieeuler.Problem(bodies, joints, gravity, [(a + b) / 2 for a, b in ends], R, rest, rest)


FOUR_BAR = [[0, 0, 0], [0.3, 0, 0.9], [1.9, 0, 1.2], [1.6, 0, 0]]


@pytest.mark.parametrize("method", lieeuler.EULER_METHODS)
def test_planar_four_bar_in_space(method):
    """Four hinges have 20 rows for 18 velocities and one freedom: three rows are redundant."""
    runs = [lieeuler.integrate(linkage(FOUR_BAR), method, h, [0, 1.0]) for h in (2e-3, 1e-3, 5e-4)]
    for run in runs:
        assert run.stats.redundant_rows == 3
        for level in lieeuler.METHODS[method].held:
            size = {"position": 1, "velocity": 10, "acceleration": 1000}[level]  # m, m/s, m/s^2: sizes of the terms
            assert run.stats.maxima[f"constraint_{level}"] < 50 * EPS * size
    differences = [np.abs(a.x[-1] - b.x[-1]).max() for a, b in itertools.pairwise(runs)]
    assert differences[0] / differences[1] == pytest.approx(2, rel=0.1)  # first order


def test_multipliers_are_those_of_least_norm():
    problem = linkage(FOUR_BAR)
    run = lieeuler.integrate(problem, "DAE1L_LSE", 1e-3, [0, 0.5])
    state = [getattr(run, name)[-1] for name in "xRvw"]
    G = _kernel.constraints(problem.kernel, *state, np.zeros(problem.rows))["G"]
    S = G @ np.linalg.solve(mass_matrix(problem), G.T)
    assert np.linalg.matrix_rank(S, tol=1e-11 * np.abs(S).max()) == 17
    lam = dense_index1(problem, *state)[1]
    assert np.abs(run.lam[-1] - lam).max() < 1e-10 * np.abs(lam).max()  # condition of S without its null space: 1e4


def test_the_same_joint_twice_shares_its_load():
    body = lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]))
    pivot = lieeuler.spherical_joint(-1, 0, np.zeros(3), [0, 0, 1.0])
    state = ([0, 0, -9.81], [[0, 0, -1.0]], [np.eye(3)], [[1.0, 0, 0]], [[0, -1.0, 0]])
    once, twice = (lieeuler.integrate(lieeuler.Problem([body], [pivot] * k, *state), "DAE1H_LSE", 1e-3, [0, 1.0])
                   for k in (1, 2))
    assert (once.stats.redundant_rows, twice.stats.redundant_rows) == (0, 3)
    assert np.abs(once.x - twice.x).max() < 1e-12
    assert np.abs(np.hstack([once.lam, once.lam]) / 2 - twice.lam).max() < 1e-10


SPRING = {"parent_point": np.array([0.5, 0.0, 0.0]), "child_point": np.array([0.1, 0.0, 0.0]), "free_length": 0.8}


@pytest.mark.parametrize(("stiffness", "step"), [(1e4, 1e-3), (1e4, 5e-3), (1e2, 5e-2)])
@pytest.mark.parametrize("method", ["DAE3L_LE", "DAE2L_LE", "DAE2L_LSE", "DAE1L_LSE"])
def test_stiff_spring_in_a_redundant_loop(method, stiffness, step):
    """In space three rows depend on the others; in the plane none does, and the motion is the same."""
    bar = linkage(FOUR_BAR)
    spring = lieeuler.LinearSpring(-1, 1, **SPRING, stiffness=stiffness)
    problem = lieeuler.Problem(bar.bodies, bar.joints, bar.gravity, bar.x, bar.R, bar.v, bar.w, [spring])
    whole, plane = (lieeuler.integrate(problem, method, step, [0, 10 * step], reduce=word)
                    for word in ("off", "planar"))
    assert whole.stats.redundant_rows == 3
    assert np.abs(whole.x[-1] - plane.x[-1]).max() < 1e-10


def test_loop_without_redundancy():
    """The four-bar with a rod in place of one hinge: still a loop, but without redundant rows."""
    bar = linkage(FOUR_BAR)
    last = bar.joints[-1]
    rod = lieeuler.distance_joint(-1, 2, last.parent_anchor - [0.0, 0.0, 0.5], last.child_anchor, 0.5)
    problem = lieeuler.Problem(bar.bodies, [*bar.joints[:-1], rod], bar.gravity, bar.x, bar.R, bar.v, bar.w)
    run = lieeuler.integrate(problem, "DAE1L_LSE", 1e-3, [0, 0.5])
    assert run.stats.redundant_rows == 0
    assert run.stats.maxima["constraint_position"] < 50 * EPS
    assert run.stats.maxima["constraint_acceleration"] < 50 * EPS * 1000


@pytest.mark.parametrize("method", [*lieeuler.EULER_METHODS, "INDEX1_LE", "BAUMGARTE_LE", "generalized_alpha",
                                    "taylor"])
def test_start_in_a_singular_position_is_named(method):
    """A parallelogram folded flat can open in two ways: its rank is lower there than on either path."""
    problem = linkage([[0, 0, 0], [1, 0, 0], [3, 0, 0], [2, 0, 0]])
    with pytest.raises(lieeuler.IntegrationError) as caught:
        lieeuler.integrate(problem, method, None if method == "taylor" else 1e-3, [0, 0.1])
    assert caught.value.status is lieeuler.Status.SINGULAR_MATRIX
    assert "singular position" in caught.value.advice


def test_a_run_writes_a_line_to_the_log(caplog):
    with caplog.at_level("INFO", logger="lieeuler"):
        lieeuler.integrate(linkage(FOUR_BAR), "DAE1L_LSE", 1e-3, [0, 0.01])
        lieeuler.integrate(SYSTEMS["single_pendulum"](), "taylor", t_eval=[0, 0.01])
    loop, series = caplog.messages
    assert re.match(r"DAE1L_LSE: success at 0\.01 s, 10 steps of 0\.001 s, \d\.\d\d Newton iterations a step, "
                    r"3 of 20 constraint rows redundant, ", loop)
    assert re.match(r"taylor: success at 0\.01 s, \d+ steps, 0 rejected, [^,]+ s of computing$", series)
