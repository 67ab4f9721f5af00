"""The group update alone, without the polish after every step, keeps attitudes orthogonal."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import lieeuler
from lieeuler import reference
from tests.lieeuler.systems import SYSTEMS

STEPS, STEP = 2000, 1e-3
EPS = np.finfo(float).eps


def defect(R):
    """Largest entry of R^T R - I."""
    return np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max()


def of_method(problem, method, polish):
    return defect(lieeuler.integrate(problem, method, STEP, [0.0, STEPS * STEP], polish=polish, monitor=False).R[-1])


def additive_steps(system, q, u, h):
    """Comparator: adds to the rotation matrix, R + h R reference.hat(w), as if it were a vector; no group, no polish.

    Explicit in the accelerations of the index-1 system, so that a step is cheap. The centres of mass follow from the
    attitudes and the velocities are projected, so that both constraint levels hold and only the update differs. Joints
    are listed from the ground outwards. Yields q and u after every step.
    """
    inverse, G = np.linalg.inv(system.M), system.G(q)
    while True:
        free = inverse @ system.force(u)
        MG = inverse @ G.T
        u = u + h * (free - MG @ np.linalg.solve(G @ MG, G @ free + system.gamma(q, u)))
        R = np.array([q[1][b] @ (np.eye(3) + h * reference.hat(u[6 * b + 3:6 * b + 6])) for b in range(system.n)])
        x = np.zeros((system.n, 3))
        for joint in system.joints:
            parent, above = joint.parent, joint.parent_anchor
            x[joint.child] = ((above if parent < 0 else x[parent] + R[parent] @ above)
                              - R[joint.child] @ joint.child_anchor)
        q = x, R
        G = system.G(q)
        MG = inverse @ G.T
        u = u - MG @ np.linalg.solve(G @ MG, G @ u)
        yield q, u


def of_additive(problem, step, steps):
    """Of the additive comparator."""
    system = reference.System(problem)
    every = additive_steps(system, system.q, system.u, step)
    (_, R, *_), _ = next(itertools.islice(every, steps - 1, None))
    return defect(R)


@pytest.mark.parametrize("scene", ["single_pendulum", "double_pendulum"])
@pytest.mark.parametrize("method", [*lieeuler.EULER_METHODS, "INDEX1_LE", "BAUMGARTE_LE"])
def test_group_update_alone_stays_on_the_group(scene, method):
    problem = SYSTEMS[scene]()
    polished, plain = (of_method(problem, method, polish) for polish in (True, False))
    assert polished <= 4 * EPS  # one product of two rotations, and the rounding of measuring it
    # Each step multiplies by a rotation known to rounding: three products and three sums an entry, all to one side.
    assert polished < plain <= 6 * EPS * STEPS


def test_the_polish_changes_nothing_else():
    problem, t = SYSTEMS["double_pendulum"](), [0.0, 1.0]
    one, other = (lieeuler.integrate(problem, "DAE1L_LSE", STEP, t, polish=polish) for polish in (True, False))
    # Rounding of 1000 steps, grown by what the scene does to perturbations in a second, which is below 100.
    assert np.abs(one.x - other.x).max() < 100 * 1000 * EPS
    assert one.stats.newton_iterations == pytest.approx(other.stats.newton_iterations, rel=0.01)


@pytest.mark.parametrize("scene", ["single_pendulum", "double_pendulum"])
def test_an_additive_update_leaves_the_group(scene):
    """Each step stretches two axes by 1 + (h w)^2 / 2: after a time t by h times the integral of w^2 / 2 and more."""
    problem = SYSTEMS[scene]()
    coarse, fine = (of_additive(problem, step, round(0.5 / step)) for step in (4e-3, 2e-3))
    assert fine > 1e-3
    assert coarse / fine == pytest.approx(2, rel=0.1)  # first order in the step


@pytest.mark.parametrize("method", ["rattle2", "rkmk4", "seulex", "taylor"])
def test_other_methods_refuse_to_leave_it_out(method):
    with pytest.raises(lieeuler.ArgumentError, match=r"polish=False is for DAE3L_LE, .*DAE1H_LSE.*; leave it out"):
        lieeuler.integrate(SYSTEMS["single_pendulum"](), method, t_eval=[0, 1], polish=False,
                           **({"step": 1e-2} if method in ("rattle2", "rkmk4") else {}))


def test_polish_is_a_switch():
    with pytest.raises(lieeuler.ArgumentError, match=r"polish must be True or False"):
        lieeuler.integrate(SYSTEMS["single_pendulum"](), "DAE1L_LSE", 1e-2, [0, 1], polish=1)
