"""What each method must show: order."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import lieeuler
from tests.adapters.lieeuler import against_truth
from tests.lieeuler import accuracy
from tests.lieeuler.systems import SYSTEMS
from tests.lieeuler.test_methods import PENDULUMS


@functools.cache
def truth(system):
    """x, R, u and lam of the library's scene of this name at eleven times in one second."""
    exact, problem = against_truth.truth(system, 1.0, 11), SYSTEMS[system]()
    u = np.concatenate([exact.v, exact.w], axis=2).reshape(11, -1)
    lam = [accuracy.dense_index1(problem, *state)[1] for state in zip(exact.x, exact.R, exact.v, exact.w, strict=True)]
    return np.linspace(0, 1, 11), exact.x, exact.R, u, np.array(lam)


FIRST_ORDER = [name for name, method in lieeuler.METHODS.items() if method.order == 1]
ORDER_CASES = [(system, method, "exp") for system in PENDULUMS for method in FIRST_ORDER]
ORDER_CASES += [("single_pendulum", method, name) for method in lieeuler.EULER_METHODS for name in ("cayley", "ccsk")]


@pytest.mark.parametrize(("system", "method", "coordinate_map"), ORDER_CASES)
def test_order_one_in_every_quantity(system, method, coordinate_map):
    problem, steps = SYSTEMS[system](), (4e-3, 2e-3, 1e-3, 5e-4)
    t, x, R, u, lam = truth(system)
    errors = {"position": [], "attitude": [], "velocity": [], "multiplier": []}
    for h in steps:
        s = lieeuler.integrate(problem, method, h, t, map=coordinate_map)
        errors["position"].append(np.abs(s.x - x).max())
        errors["attitude"].append(np.abs(s.R - R).max())
        errors["velocity"].append(np.abs(np.concatenate([s.v, s.w], axis=2).reshape(u.shape) - u).max())
        errors["multiplier"].append(np.abs(s.lam - lam)[1:].max())  # from t = 0.1 s
    for quantity, values in errors.items():
        order = np.polyfit(np.log(steps), np.log(values), 1)[0]
        assert order == pytest.approx(1, abs=0.1), f"{quantity}: {order:.3f}"
