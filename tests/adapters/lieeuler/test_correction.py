"""The plain correction of stabilised Lagrangian methods: order, energy, momentum, gears and springs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import crosscheck
import lieeuler
from tests.adapters.lieeuler.test_methods import truth
from tests.lieeuler.systems import SYSTEMS, spring_chain
from tests.lieeuler.test_correction import METHODS

STEPS = (4e-3, 2e-3, 1e-3, 5e-4)


@pytest.mark.parametrize("method", METHODS)
def test_order_energy_and_momentum(method):
    """Of the documented order, all of them, and so is the distance from the run weighted with the mass."""
    problem, order = SYSTEMS["double_pendulum"](), lieeuler.METHODS[method].order
    t, x, R, u, lam = truth("double_pendulum")

    def vertical(run):
        spins = np.einsum("tbij,bjk,tbk->tbi", run.R, np.array([b.inertia for b in problem.bodies]), run.w)
        return (np.cross(run.x, run.v) + spins).sum(axis=1)[:, 2]  # masses are 1 kg

    values = []
    for h in STEPS:
        plain, mass = (lieeuler.integrate(problem, method, h, t, correction=word) for word in ("plain", "mass"))
        rates = np.concatenate([plain.v, plain.w], axis=2).reshape(u.shape)
        values.append([np.abs(plain.x - x).max(), np.abs(plain.R - R).max(), np.abs(rates - u).max(),
                       np.abs(plain.lam - lam)[1:].max(), plain.stats.maxima["energy_error"],
                       np.ptp(vertical(plain)), np.abs(plain.x - mass.x).max()])
    slopes = np.polyfit(np.log(STEPS), np.log(values), 1)[0]
    within = 0.1 if order == 1 else 0.15
    assert (np.abs(slopes[:4] - order) < within).all(), slopes
    assert (slopes[4:] > order - within).all(), slopes


def test_gears_slips_and_springs_take_it():
    for problem in (spring_chain(3), *(crosscheck.adapters.lieeuler.build_problem(crosscheck.load_scene(name))
                                       for name in ("geared_arm", "rolling_disk", "driven_cart"))):
        runs = [lieeuler.integrate(problem, "DAE1L_LSE", h, [0, 0.1], correction="plain") for h in (2e-3, 1e-3, 5e-4)]
        assert all(run.success for run in runs)
        coarse, fine = (np.abs(a.R[-1] - b.R[-1]).max() + np.abs(a.x[-1] - b.x[-1]).max()
                         for a, b in itertools.pairwise(runs))
        assert coarse / fine == pytest.approx(2, rel=0.1)


def test_crosscheck_passes_it_on():
    runs = {word: crosscheck.run("heavy_top", "lieeuler", "DAE1L_LSE", step=1e-3, duration=0.05, samples=3,
                                 **({} if word is None else {"correction": word})) for word in (None, "mass", "plain")}
    assert np.array_equal(runs[None].x, runs["mass"].x)
    assert not np.array_equal(runs[None].x, runs["plain"].x)
    with pytest.raises(crosscheck.ArgumentError, match="correction"):
        crosscheck.run("heavy_top", "lieeuler", "DAE1L_LSE", step=1e-3, correction="heavy")
