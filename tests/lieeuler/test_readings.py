"""Readings of the papers: what DAE1L_LSE becomes with another correction, and why DAE2H_LE ends early."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import lieeuler
from lieeuler import reference
from tests import batch_oracle
from tests.lieeuler.systems import SYSTEMS


def dense(problem):
    """The problem as the reference has it, with its initial velocities."""
    system = reference.System(problem)
    return system, system.u


def start_gradient_step(system, q0, u0, h, coordinate_map, guess):
    """DAE1L_LSE in another reading: the velocity correction acts along G of the start of the step, as that of q does.

    M (u - u_n) = h (f - G^T lam) - h G_n^T nu with (a, lam) of the index-1 system at the new state, Phi = 0, G u = 0,
    q = q_n * (h (u - M^-1 G_n^T mu)). With G^T nu in place of G_n^T nu this is (4.2), which is DAE2L_LSE in (q, u).
    Returns q, u, lam and the solution as the next guess.
    """
    nu, m, G0 = 6 * system.n, system.m, system.G(q0)

    def unpack(z):
        u, correction, mu = z[:nu], z[nu:nu + m], z[nu + m:]
        q = system.move(q0, h, u - np.linalg.solve(system.M, G0.T @ mu), coordinate_map)
        return q, u, correction

    def residual(z):
        q, u, correction = unpack(z)
        a, _ = system.index1(q, u)
        return np.concatenate([system.M @ (u - u0 - h * a) + h * G0.T @ correction, system.G(q) @ u, system.phi(q) / h])

    z = reference.newton(residual, guess)
    q, u, _ = unpack(z)
    return q, u, system.index1(q, u)[1], z


def start_gradient(problem, h, duration):
    """Positions at the end, and the largest constraint levels, of the reading with G of the start of the step."""
    system, u = dense(problem)
    q, guess, levels = (problem.x, problem.R), np.r_[u, np.zeros(2 * system.m)], np.zeros(3)
    for _ in range(round(duration / h)):
        q, u, _, guess = start_gradient_step(system, q, u, h, reference.MAPS["exp"], guess)
        G, a = system.G(q), system.index1(q, u)[0]
        levels = np.maximum(levels, [np.abs(rows).max() for rows in (
            system.phi(q), G @ u, G @ a + system.gamma(q, u))])
    return q[0], levels


@pytest.mark.parametrize("name", ["single_pendulum", "double_pendulum"])
def test_correction_along_the_start_of_the_step(name):
    """It holds the same levels at the same order, and differs from DAE1L_LSE by second order, which no table shows."""
    problem, duration = SYSTEMS[name](), 0.25
    exact = lieeuler.integrate(problem, "taylor", rtol=1e-13, t_eval=[0, duration]).x[-1]
    differences, errors = [], []
    for h in (1e-2, 5e-3):
        x, levels = start_gradient(problem, h, duration)
        ours = lieeuler.integrate(problem, "DAE1L_LSE", h, [0, duration])
        differences.append(np.abs(x - ours.x[-1]).max())
        errors.append((np.abs(x - exact).max(), np.abs(ours.x[-1] - exact).max()))
        assert levels[:2].max() < 1e-14  # some roundings of lengths of 4 m and speeds of 5 m/s
        assert levels[2] < 1e-12  # of accelerations of 100 m/s^2, with the condition of the index-1 system
    # Its correction turns by h w: a relative change of order h in a correction of order h a step.
    assert 3 < differences[0] / differences[1] < 5
    for variant, ours in errors:
        assert variant == pytest.approx(ours, rel=0.05)
    assert errors[0][0] / errors[1][0] == pytest.approx(2, abs=0.2)  # first order


@pytest.mark.parametrize("name", ["single_pendulum", "double_pendulum"])
def test_dae2h_le_opens_the_joint_until_it_ends(name):
    """Its position level drifts by h t times a constant of the scene: at half the step it lasts about twice as long."""
    ends = []
    for h in (2e-2, 1e-2, 5e-3):
        with pytest.raises(lieeuler.IntegrationError) as failure:
            lieeuler.integrate(SYSTEMS[name](), "DAE2H_LE", h, np.arange(0.0, 200.0))
        ends.append(failure.value.solution.t_end)
        opened = failure.value.solution.stats.maxima["constraint_position"]
        assert opened > 0.7  # m: nearly the whole distance of joint and mass centre, 1 m
    assert all(1.5 < later / sooner < 2.5 for sooner, later in itertools.pairwise(ends))


@pytest.mark.parametrize("name", ["single_pendulum", "double_pendulum"])
def test_the_oracle_of_dae2h_le_ends_there_too(name):
    """A dense step with Newton's matrix by differences, without the kernel, fails too: it is the method."""
    problem, h = SYSTEMS[name](), 1e-2
    with pytest.raises(lieeuler.IntegrationError) as failure:
        lieeuler.integrate(problem, "DAE2H_LE", h, np.arange(0.0, 60.0))
    system, u = dense(problem)
    q, guess, steps, solved = (problem.x, problem.R), np.r_[u, system.index1((problem.x, problem.R), u)[1]], 0, True
    with np.errstate(all="ignore"):
        while solved and steps * h < 60:
            q, u, _, guess = reference.hamilton_step(system, lieeuler.DAE2H_LE(h), q, u, guess)
            steps += 1
            solved = np.isfinite(u).all() and np.abs(system.G(q) @ u).max() < 1e-8
    # Rounding grows on the way: the last steps, at 50 rad/s and more, are not the same bit for bit.
    assert steps * h == pytest.approx(failure.value.solution.t_end, abs=0.2)
    print(f"{name}: the kernel ends after {failure.value.solution.t_end:.6g} s, the oracle after {steps * h:.6g} s")


def test_the_batch_oracle_is_the_oracle():
    problem, h = SYSTEMS["double_pendulum"](), 1e-2
    system, u = dense(problem)
    q = (problem.x, problem.R)
    *_, z = reference.hamilton_step(system, lieeuler.DAE2H_LE(h), q, u, np.r_[u, np.zeros(system.m)])
    assert np.abs(batch_oracle.residual(system, q, u, h)(z[None])).max() < 1e-13  # roundings of momenta of some kg m/s
    assert batch_oracle.turning_point(system, q, u, h) == 1


def free_move(body, u, h, coordinate_map):
    """Velocities after a step of RATTLE without forces or joints: one whole turn by a discrete velocity."""
    xi = reference.newton(lambda z: body.momenta(h, z, coordinate_map)[0] - body.M @ u, u)
    return np.linalg.solve(body.M, body.momenta(h, xi, coordinate_map)[1])


@pytest.mark.parametrize("name", ["exp", "cayley"])
def test_rattle_moves_once_and_not_in_two_halves(name):
    """Half a step of the Euler map and half a step of its adjoint are two turns: other velocities, at third order."""
    problem = lieeuler.Problem([lieeuler.Body(1.0, np.diag([0.1, 0.2, 0.15]))], [], [0, 0, 0],
                               x=[[0, 0, 0]], R=[np.eye(3)], v=[[0, 0, 0]], w=[[0.5, 0.3, 1]])
    body, u = dense(problem)
    differences = []
    for h in (0.1, 0.05):
        once = free_move(body, u, h, reference.MAPS[name])
        halves = free_move(body, free_move(body, u, h / 2, reference.MAPS[name]), h / 2, reference.MAPS[name])
        kernel = lieeuler.integrate(problem, "rattle2", h, [0, h], map=name).w[-1, 0]
        assert np.abs(kernel - once[3:]).max() < 1e-14  # some roundings of velocities of 1 rad/s
        differences.append(np.abs(once - halves).max())
    assert differences[0] / differences[1] == pytest.approx(8, abs=0.5)
    assert differences[1] > 1e-7
