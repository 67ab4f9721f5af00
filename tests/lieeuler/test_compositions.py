"""RATTLE and its symmetric compositions: tables, constraints, symmetry, energy without trend."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler import methods
from tests.lieeuler.systems import SYSTEMS
from tests.lieeuler.test_oracle import assert_agrees, referred

COMPOSITIONS = [name for name, method in lieeuler.METHODS.items() if method.composition]
TABLES = {"SUZUKI_4": 4, "MCLACHLAN_4": 4, "KAHAN_LI_6": 6, "SUZUKI_UMENO_8": 8}
EPS = np.finfo(float).eps


@pytest.mark.parametrize("table", TABLES)
def test_order_conditions_of_the_tables(table):
    """Symmetric, consistent, and the odd power sums up to the order vanish (Hairer, Lubich, Wanner, V.3.2)."""
    weights = np.array(getattr(methods, table))
    assert np.array_equal(weights, weights[::-1])
    assert abs(weights.sum() - 1) < 4 * EPS
    for power in range(3, TABLES[table], 2):
        # every condition on single products: sum g^3 = 0, sum g^5 = 0, ...; printed digits leave 1e-13
        assert abs((weights**power).sum()) < 1e-12 * (np.abs(weights) ** power).sum() * 10


def test_rattle_agrees_with_a_dense_step():
    problem, h = SYSTEMS["double_pendulum"](), 1e-2
    for method in (lieeuler.Rattle2(h), lieeuler.Rattle4(h, map="cayley")):
        q, u, *_ = referred(problem, method, 2)
        assert_agrees(lieeuler.integrate(problem, method, [0, 2 * h]), q, u)


@pytest.mark.parametrize("method", COMPOSITIONS)
@pytest.mark.parametrize("coordinate_map", ["exp", "cayley"])
def test_time_reversal(method, coordinate_map):
    """Symmetric methods run backwards along their own path: reverse the velocities and return to the start."""
    problem = SYSTEMS["double_pendulum"]()
    there = lieeuler.integrate(problem, method, 1e-2, [0, 1.0], map=coordinate_map)
    R = Rotation.from_matrix(there.R[-1]).as_matrix()
    turned = lieeuler.Problem(problem.bodies, problem.joints, problem.gravity, there.x[-1], R, -there.v[-1],
                              -there.w[-1])
    back = lieeuler.integrate(turned, method, 1e-2, [0, 1.0], map=coordinate_map)
    # rounding of 200 steps, magnified by the motion (at most tenfold a second here)
    assert np.abs(back.x[-1] - problem.x).max() < 1e-11
    assert np.abs(back.R[-1] - problem.R).max() < 1e-11


@pytest.mark.parametrize("method", ["rattle2", "rattle4"])
@pytest.mark.parametrize("system", ["single_pendulum", "double_pendulum"])
def test_energy_has_no_trend(system, method):
    """Energy error over 20 000 steps: the slope times the duration stays below 5 % of the band."""
    problem = SYSTEMS[system]()
    run = lieeuler.integrate(problem, method, 5e-3, np.linspace(0, 100, 4001))
    inertia = np.array([body.inertia for body in problem.bodies])
    kinetic = 0.5 * np.einsum("tbi,tbi->t", run.v, run.v) + 0.5 * np.einsum("tbi,bij,tbj->t", run.w, inertia, run.w)
    energy = kinetic + 9.81 * run.x[:, :, 2].sum(axis=1)
    slope = np.polyfit(run.t, energy, 1)[0]
    assert abs(slope * 100) < 0.05 * np.ptp(energy)


def test_damping_keeps_the_order():
    """A damped spring: rattle2 stays second order with the dampers taken at the discrete velocity."""
    base = SYSTEMS["single_pendulum"]()
    spring = lieeuler.LinearSpring(-1, 0, [0.6, 0.3, -1.2], [0, 0, -0.3], 40.0, 0.5, 2.0)
    problem = lieeuler.Problem(base.bodies, base.joints, base.gravity, base.x, base.R, base.v, base.w, [spring])
    x = [lieeuler.integrate(problem, "rattle2", h, [0, 1.0]).x[-1] for h in (1e-2, 5e-3, 2.5e-3, 1.25e-3)]
    differences = [np.abs(a - b).max() for a, b in itertools.pairwise(x)]
    assert np.log2(differences[0] / differences[1]) == pytest.approx(2, abs=0.15)
    assert np.log2(differences[1] / differences[2]) == pytest.approx(2, abs=0.15)


def test_ccsk_is_refused():
    with pytest.raises(lieeuler.ArgumentError, match="not symmetric"):
        lieeuler.integrate(SYSTEMS["single_pendulum"](), "rattle4", 1e-2, [0, 1.0], map="ccsk")


@pytest.mark.parametrize("steps", [20_000, 1_000_000])
def test_many_steps_lose_no_digits(steps):
    """The momentum about the vertical and, at a step whose own error is below rounding, the energy: at rounding level
    throughout."""
    problem = SYSTEMS["single_pendulum"]()
    run = lieeuler.integrate(problem, "rattle8", 2.0**-9, np.arange(0, steps + 1, 500) * 2.0**-9, monitor=False)
    body = problem.bodies[0]
    x, R, v, w = run.x[:, 0], run.R[:, 0], run.v[:, 0], run.w[:, 0]
    turning = w @ body.inertia
    momentum = body.mass * np.cross(x, v)[:, 2] + (R[:, 2] * turning).sum(axis=1)
    size = (body.mass * np.linalg.norm(x, axis=1) * np.linalg.norm(v, axis=1) + np.linalg.norm(turning, axis=1)).max()
    assert np.abs(momentum - momentum[0]).max() < 50 * EPS * size
    kinetic = 0.5 * body.mass * (v**2).sum(axis=1) + 0.5 * (w * turning).sum(axis=1)
    energy = kinetic + 9.81 * body.mass * x[:, 2]
    assert np.abs(energy - energy[0]).max() < 50 * EPS * kinetic.max()
