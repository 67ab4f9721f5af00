"""The kernel against the dense reference, and against the figures of a prototype."""

from __future__ import annotations

import dataclasses
import fractions
import itertools

import numpy as np
import pytest

import lieeuler
from lieeuler import reference
from tests.lieeuler.systems import SYSTEMS

AGREEMENT = 1e-12  # both solve the same equations to rounding, 20 steps accumulate little of it


def referred(problem, method, steps):
    """(q, u, a, lam) after so many steps of the reference."""
    system = reference.System(problem)
    return next(itertools.islice(reference.steps(system, method, system.q, system.u), steps - 1, None))


def assert_agrees(solution, q, u, lam=None, noise=0.0):
    """The end of a run with that of the oracle; `noise` of the multipliers over their size."""
    u = u.reshape(-1, 6)
    assert np.abs(solution.x[-1] - q[0]).max() < AGREEMENT
    assert np.abs(solution.R[-1] - q[1]).max() < AGREEMENT
    assert np.abs(np.hstack([solution.v[-1], solution.w[-1]]) - u).max() < AGREEMENT * max(1.0, np.abs(u).max())
    if lam is not None:
        assert np.abs(solution.lam[-1] - lam).max() < noise * max(1.0, np.abs(lam).max())


PENDULUMS = ("single_pendulum", "double_pendulum")
EULER = [name for name, method in lieeuler.METHODS.items() if method.formulation != "index1" and method.order == 1]
CASES = [(system, method, "exp", 1e-2) for system in PENDULUMS for method in EULER]
CASES += [("single_pendulum", method, name, 1e-2) for method in EULER for name in ("cayley", "ccsk")]
CASES += [("heavy_top", method, "exp", 1e-3) for method in lieeuler.EULER_METHODS]


@pytest.mark.parametrize(("system", "method", "coordinate_map", "h"), CASES)
def test_kernel_agrees_with_dense_oracle(system, method, coordinate_map, h):
    problem, steps = SYSTEMS[system](), 20
    method = lieeuler.METHODS[method](step=h, map=coordinate_map)
    solution = lieeuler.integrate(problem, method, [0, steps * h])
    q, u, a, lam = referred(problem, method, steps)
    # Multipliers and accelerations carry the noise of u over h, and lam of index 3 that of Phi over h^2.
    noise = 1e3 * np.finfo(float).eps * max(1.0, np.abs(u).max()) / h**2
    assert_agrees(solution, q, u, lam, noise)
    accelerations = np.hstack([solution.a[-1], solution.alpha[-1]])
    assert np.abs(accelerations - a.reshape(-1, 6)).max() < noise * max(1.0, np.abs(a).max())


def test_thin_bodies_of_the_reference_and_the_kernel_are_not_spun_up_by_rounding():
    """alpha_i = (J_j - J_k) w_j w_k / J_i in exact fractions; one moment of a needle is a millionth of the others."""
    rng = np.random.default_rng(5)
    for trial in range(60):
        moments, w = np.where(np.arange(3) == trial % 3, 1e-7, rng.uniform(0.1, 1.0)), rng.normal(size=3)
        problem = lieeuler.Problem([lieeuler.Body(1.0, np.diag(moments))], [], np.zeros(3), np.zeros((1, 3)),
                                   np.eye(3)[None], np.zeros((1, 3)), w[None])
        system = reference.System(problem)
        J, spin = (list(map(fractions.Fraction, values.tolist())) for values in (moments, w))
        exact = [float((J[j] - J[k]) * spin[j] * spin[k] / J[i]) for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))]
        for alpha in (system.index1(system.q, system.u)[0][3:], lieeuler.accelerations(problem).alpha[0]):
            assert np.abs(alpha - exact).max() < 1e-15 * max(1.0, w @ w)


def test_what_the_reference_lacks_is_named():
    problem = SYSTEMS["single_pendulum"]()
    system = reference.System(problem)
    for method in (lieeuler.Taylor(), "DAE1L_LSE"):
        with pytest.raises(lieeuler.ArgumentError, match="implicit methods with a step"):
            next(reference.steps(system, method, system.q, system.u))
    loaded = dataclasses.replace(problem, forces=[lieeuler.ConstantLoad(0, force=[1.0, 0, 0])])
    rotor = dataclasses.replace(problem, joints=[problem.joints[0].geared(lieeuler.Rotor(0.1, [0, 0, 1], [0, 0, 1]))])
    for wrong, words in ((loaded, "no forces"), (rotor, r"joints\[0\]"), ("pendulum", "must be a lieeuler.Problem")):
        with pytest.raises(lieeuler.ArgumentError, match=words):
            reference.System(wrong)


FIGURES = {
    "DAE3L_LE": ("5.642e-02", "1.33e-01"),
    "DAE2L_LE": ("3.252e-02", "6.35e-02"),
    "DAE2L_LSE": ("4.420e-02", "1.06e-01"),
    "DAE1L_LSE": ("4.420e-02", "1.06e-01"),
    "DAE3H_LE": ("6.557e-03", "1.66e-02"),
    "DAE2H_LE": ("3.998e-02", "8.93e-02"),
    "DAE2H_LSE": ("6.557e-03", "1.66e-02"),
    "DAE1H_LSE": ("6.557e-03", "1.66e-02"),
}


@pytest.mark.parametrize("method", lieeuler.EULER_METHODS)
def test_prototype_figures_to_all_printed_digits(method):
    problem = SYSTEMS["single_pendulum"]()
    truth = lieeuler.integrate(problem, "taylor", t_eval=[0, 1.0], rtol=1e-14)
    solution = lieeuler.integrate(problem, method, 1e-2, [0, 1.0])
    maxima = solution.stats.maxima
    kinetic = 0.5 * problem.v[0] @ problem.v[0] + 0.5 * problem.w[0] @ problem.bodies[0].inertia @ problem.w[0]
    start_energy = kinetic - problem.gravity @ problem.x[0]
    end_error = np.linalg.norm(solution.x[-1, 0] - truth.x[-1, 0])
    energy_error = maxima["energy_error"] * maxima["kinetic"] / abs(start_energy)
    assert (f"{end_error:.3e}", f"{energy_error:.2e}") == FIGURES[method]
