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


def test_the_weights_in_use_are_the_better_ones(monkeypatch):
    """At equal numbers of stages: the geometric mean of the errors over both pendulums and four budgets."""
    ratios = []
    for system in ("single_pendulum", "double_pendulum"):
        for stages in (40, 50, 60, 70) if system == "single_pendulum" else (60, 70, 80, 90):
            errors = []
            for weights in (methods.SUZUKI_4, methods.MCLACHLAN_4):
                monkeypatch.setattr(lieeuler.METHODS["rattle2"], "composition", weights)
                step, error, *_ = motion_errors(system, "rattle2", 0.1 / max(1, round(stages / len(weights))))[0]
                errors.append(error * (len(weights) / step / (10 * stages)) ** 4)
            ratios.append(errors[0] / errors[1])
    assert np.exp(np.mean(np.log(ratios))) < 1, ratios
