"""Mechanisms of many loops: independent rows, all rows held, least-norm multipliers (solve/independent_rows.hpp)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler.types import GROUND
from tests.lieeuler import accuracy
from tests.lieeuler.test_methods import ROUNDING
from tests.lieeuler.test_planar import turned

SPARSE = {"DAE1L_LSE": {"step": 2e-3}, "DAE1H_LSE": {"step": 2e-3}, "rattle2": {"step": 2e-3}, "rkmk4": {"step": 5e-3},
          "rkmk853": {"rtol": 1e-10}, "taylor": {"rtol": 1e-10}}
T = np.linspace(0, 0.2, 5)
ROTATION = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
LINK, RUNG = 0.5, 0.6  # m
Y = (0.0, 1.0, 0.0)


def ladder(loops):
    """A planar ladder at rest: two hanging rails of n links, a rung at every level, levels leaning to alternate sides.

    n loops of four bars: three bodies, one degree of freedom and three rows too many each.
    """
    angles = 0.4 * np.sin(np.arange(1, loops + 1))
    R_rail = [np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) for a in angles]
    bodies, joints, x, R = [], [], [], []

    def add(position, attitude, length, upright):
        across, along = length**2 / 12, 1e-3
        moments = (across, across, along) if upright else (along, across, across)
        bodies.append(lieeuler.Body(1.0, np.diag(moments)))
        x.append(position), R.append(attitude)
        return len(bodies) - 1

    up, down, half = np.array([0, 0, LINK / 2]), np.array([0, 0, -LINK / 2]), np.array([RUNG / 2, 0, 0])
    nodes = [np.zeros(3), np.array([RUNG, 0, 0])]
    above = [(GROUND, nodes[0]), (GROUND, nodes[1])]
    for level in range(loops):
        rails = []
        for side in range(2):
            rail = add(nodes[side] - R_rail[level] @ up, R_rail[level], LINK, upright=True)
            parent, anchor = above[side]
            joints.append(lieeuler.revolute_joint(parent, rail, anchor, up, Y, Y))
            nodes[side] = nodes[side] + R_rail[level] @ (down - up)
            above[side] = rail, down
            rails.append(rail)
        rung = add((nodes[0] + nodes[1]) / 2, np.eye(3), RUNG, upright=False)
        joints.append(lieeuler.revolute_joint(rails[0], rung, down, -half, Y, Y))
        joints.append(lieeuler.revolute_joint(rails[1], rung, down, half, Y, Y))
    still = np.zeros((len(bodies), 3))
    return lieeuler.Problem(bodies, joints, [0, 0, -9.81], np.array(x), np.array(R), still, still)


@pytest.mark.parametrize("rotated", [False, True])
@pytest.mark.parametrize("method", SPARSE)
def test_all_rows_hold_and_multipliers_are_those_of_least_norm(method, rotated):
    """Six loops of which 18 rows are dropped; in turned axes no row belongs to the normal of the plane alone."""
    problem = turned(ladder(6), ROTATION) if rotated else ladder(6)
    solution = lieeuler.integrate(problem, method, t_eval=T, **SPARSE[method])
    assert solution.stats.redundant_rows == 18
    accuracy.assert_on_the_constraints(solution, problem)
    for k in range(len(T)):
        a, lam = accuracy.dense_index1(problem, solution.x[k], solution.R[k], solution.v[k], solution.w[k])
        # eps times the condition of G M^-1 G^T, some 1e4 here, for the dense check
        assert np.abs(np.hstack([solution.a[k], solution.alpha[k]]) - a).max() < 1e-10 * np.abs(a).max()
        assert np.abs(solution.lam[k] - lam).max() < 1e-10 * np.abs(lam).max()


def test_methods_that_keep_all_rows_move_alike():
    """DAE2L_LSE drops rows, generalized_alpha keeps them: one motion, by two factorizations."""
    problem, fine = ladder(6), lieeuler.integrate(ladder(6), "rkmk853", rtol=1e-11, t_eval=T)
    kept = [np.abs(lieeuler.integrate(problem, "generalized_alpha", h, T).x - fine.x).max() for h in (4e-3, 2e-3)]
    dropped = [np.abs(lieeuler.integrate(problem, "DAE2L_LSE", h, T).x - fine.x).max() for h in (4e-3, 2e-3)]
    assert 3.5 < kept[0] / kept[1] < 4.5
    assert 1.8 < dropped[0] / dropped[1] < 2.2


def test_rows_that_depend_on_several_loops_are_found():
    """A body on ten parallel cranks, each in a loop of its own; turned pairs of them depend on the rest together."""
    links = 10
    x = np.array([[k, 0, -0.5] for k in range(links)] + [[links / 2, 0, -1.0]], float)
    joints = []
    for k in range(links):
        joints.append(lieeuler.revolute_joint(-1, k, [k, 0, 0], [0, 0, 0.5], [0, 1, 0], [0, 1, 0]))
        joints.append(lieeuler.revolute_joint(k, links, [0, 0, -0.5], [k - links / 2, 0, 0], [0, 1, 0], [0, 1, 0]))
    body = lieeuler.Body(1.0, np.diag([0.1, 0.1, 0.02]))
    rate = np.tile([0, 0.5, 0], (links + 1, 1))
    rate[-1] = 0
    v = np.cross(rate, x - [[k, 0, 0] for k in [*range(links), 0]])
    v[-1] = np.cross([0, 0.5, 0], [0, 0, -1.0])
    problem = lieeuler.Problem([body] * (links + 1), joints, [0, 0, -9.81], x, np.tile(np.eye(3), (links + 1, 1, 1)), v,
                               rate)
    runs = {method: lieeuler.integrate(problem, method, t_eval=T, **control) for method, control in SPARSE.items()}
    for method, run in runs.items():
        assert run.stats.redundant_rows == problem.rows - 6 * (links + 1) + 1, method
        assert np.abs(run.x - runs["taylor"].x).max() < 1e-2
        accuracy.assert_on_the_constraints(run, problem)


def swinging_ladder(loops, rate):
    """A ladder on a bar that hangs from a ball joint, all of it turning about the vertical."""
    fixed = ladder(loops)
    middle, bar = np.array([0.3, 0, 0]), fixed.n
    joints = [lieeuler.revolute_joint(bar, j.child, j.parent_anchor - middle, j.child_anchor, [0, 1, 0], [0, 1, 0])
              if j.parent < 0 else j for j in fixed.joints]
    joints.append(lieeuler.spherical_joint(-1, bar, middle, np.zeros(3)))
    bodies = [*fixed.bodies, lieeuler.Body(1.0, np.diag([0.01, 0.1, 0.1]))]
    x, R = np.vstack([fixed.x, middle]), np.concatenate([fixed.R, np.eye(3)[None]])
    turning = np.array([0, 0, rate])
    return lieeuler.Problem(bodies, joints, fixed.gravity, x, R, np.cross(turning, x - middle),
                            np.einsum("nji,j->ni", R, turning))


@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle2", "rkmk4", "taylor"])
def test_rows_are_chosen_afresh_where_the_plane_of_the_loops_turns(method):
    """A quarter turn brings each dropped direction into the plane, and one in the plane becomes the dependent one."""
    problem, t = swinging_ladder(3, 8.0), np.linspace(0, 0.5, 6)
    control = {"step": 1e-3} if "rtol" not in SPARSE[method] else {"rtol": 1e-10}
    solution = lieeuler.integrate(problem, method, t_eval=t, **control)
    assert solution.stats.redundant_rows == 9
    for level, bound in ROUNDING.items():  # rows are chosen afresh only now and then: dropped rows lose digits
        name = level if level == "orthogonality" else f"constraint_{level}"
        assert solution.stats.maxima[name] < bound, level
    a, lam = accuracy.dense_index1(problem, solution.x[-1], solution.R[-1], solution.v[-1], solution.w[-1])
    assert np.abs(solution.lam[-1] - lam).max() < 1e-9 * np.abs(lam).max()  # condition 1e5 of the dense check's matrix
    assert np.abs(np.hstack([solution.a[-1], solution.alpha[-1]]) - a).max() < 1e-9 * np.abs(a).max()


@pytest.mark.parametrize("rotated", [False, True])
@pytest.mark.parametrize("spring", [False, True])
def test_one_newton_iteration_a_step(rotated, spring):
    """Eliminated bodies leave the coupling by joints and springs out of the matrix; the linear solve has it again, also
    where loads across the plane make the hinges carry torques."""
    problem = ladder(3)
    problem = dataclasses.replace(problem, gravity=np.array([0, 5.0, -9.81]))
    if spring:
        ends = np.array([0, 0, 0.1]), np.array([0, 0.1, 0])
        forces = (lieeuler.LinearSpring(1, 7, *ends, stiffness=300.0, free_length=0.4),)
        problem = dataclasses.replace(problem, forces=forces)
    problem = turned(problem, ROTATION) if rotated else problem
    stats = lieeuler.integrate(problem, "DAE1L_LSE", t_eval=T, step=1e-3).stats
    assert stats.redundant_rows > 0
    assert stats.newton_iterations < 1.2 * stats.steps
