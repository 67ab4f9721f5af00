"""RATTLE and its symmetric compositions: order against truth."""

from __future__ import annotations

import numpy as np
import pytest

import lieeuler
from lieeuler import methods
from tests.adapters.lieeuler.test_methods import truth
from tests.lieeuler.systems import SYSTEMS
from tests.lieeuler.test_compositions import COMPOSITIONS, EPS

# Steps in the asymptotic range and above the plateau of the truth (1e-12), four at least.
LADDERS = {
    ("single_pendulum", 2): (0.025, 0.0125, 0.00625, 0.003125),
    ("single_pendulum", 4): (0.05, 0.025, 0.0125, 0.00625),
    ("single_pendulum", 6): (0.1, 0.05, 0.1 / 3, 0.025),
    ("single_pendulum", 8): (0.1, 0.1 / 1.5, 0.05, 0.04),
    ("double_pendulum", 2): (0.01, 0.005, 0.0025, 0.00125),
    ("double_pendulum", 4): (0.02, 0.01, 0.005, 0.0025),
    ("double_pendulum", 6): (0.0125, 0.01, 0.00625, 0.005),
    ("double_pendulum", 8): (0.02, 0.1 / 6, 0.1 / 7, 0.0125),
}


def motion_errors(system, method, h, coordinate_map="exp"):
    t, x, R, u, _ = truth(system)
    run = lieeuler.integrate(SYSTEMS[system](), method, h, t, map=coordinate_map)
    velocity = np.concatenate([run.v, run.w], axis=2).reshape(u.shape)
    errors = np.abs(run.x - x).max(), np.abs(run.R - R).max(), np.abs(velocity - u).max()
    return (run.stats.step, *errors), run.stats.maxima


@pytest.mark.parametrize("system", ["single_pendulum", "double_pendulum"])
@pytest.mark.parametrize("method", COMPOSITIONS)
def test_order(system, method):
    order = lieeuler.METHODS[method].order
    rows = []
    for h in LADDERS[system, order]:
        errors, maxima = motion_errors(system, method, h)
        rows.append(errors)
        size = 1 + maxima["kinetic"] ** 0.5 * 10
        assert maxima["constraint_position"] < 50 * EPS * size
        assert maxima["constraint_velocity"] < 50 * EPS * size
        assert maxima["constraint_acceleration"] < 50 * EPS * size**2
        assert maxima["orthogonality"] < 50 * EPS
    steps, *errors = np.log(rows).T
    for quantity, values in zip(("position", "attitude", "velocity"), errors, strict=True):
        assert np.polyfit(steps, values, 1)[0] == pytest.approx(order, abs=0.3 if order == 8 else 0.15), quantity


OTHERS = {  # published weights that METHODS does not have
    "Forest and Ruth 4": methods._symmetric(1 / (2 - 2 ** (1 / 3))),
    "McLachlan 4": methods.MCLACHLAN_4,
    "Yoshida 6, solution A": methods._symmetric(0.784513610477560, 0.235573213359357, -1.17767998417887),
    "Kahan and Li 8, 17 stages": methods._symmetric(
        0.13020248308889008088, 0.56116298177510838456, -0.38947496264484728641, 0.15884190655515560090,
        -0.39590389413323757734, 0.18453964097831570709, 0.25837438768632204729, 0.29501172360931029887)}


@pytest.mark.parametrize(("method", "other", "most"), [
    ("rattle4", "Forest and Ruth 4", 1), ("rattle4", "McLachlan 4", 1), ("rattle6", "Yoshida 6, solution A", 1),
    ("rattle8", "Kahan and Li 8, 17 stages", 1.05)])
def test_the_weights_in_use_are_the_better_ones(monkeypatch, method, other, most):
    """At equal numbers of stages: the geometric mean of the errors over both pendulums and four budgets.

    Those of order 8 are equals: 2.4 times worse on one pendulum and 2.3 times better on the other, 1.02 in the mean.
    """
    ratios, used = [], lieeuler.METHODS[method]
    for system in ("single_pendulum", "double_pendulum"):
        for stages in (40, 50, 60, 70) if system == "single_pendulum" else (60, 70, 80, 90):
            errors = []
            for weights in (used.composition, OTHERS[other]):
                monkeypatch.setattr(lieeuler.METHODS["rattle2"], "composition", weights)
                step, error, *_ = motion_errors(system, "rattle2", 0.1 / max(1, round(stages / len(weights))))[0]
                errors.append(error * (len(weights) / step / (10 * stages)) ** used.order)
            ratios.append(errors[0] / errors[1])
    assert np.exp(np.mean(np.log(ratios))) < most, ratios
