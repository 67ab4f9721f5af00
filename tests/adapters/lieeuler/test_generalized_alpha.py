"""generalized_alpha: hard springs, stiff dampers, redundant loops, its radius (theory note, generalized-alpha)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from tests.adapters.lieeuler import against_truth
from tests.lieeuler import accuracy
from tests.lieeuler.systems import SYSTEMS
from tests.lieeuler.test_generalized_alpha import NAME, ORDER, STEPS
from tests.lieeuler.test_methods import ROUNDING


@pytest.mark.parametrize("name", ["stiff_spring", "stiff_damped"])
def test_long_steps_over_hard_springs(name):
    """Within a tenth of the size of the system in eight steps, where implicit Euler needs 32 and RATTLE 512."""
    problem = against_truth.library(name)

    def rate(_, y):
        x, R, v, w = (part.reshape(np.shape(like)) for part, like in zip(np.split(y, cuts), start, strict=True))
        turns = np.cross(R, w[:, None])  # its rows are those of R hat(w)
        return np.concatenate([v, turns, *np.split(accuracy.dense_index1(problem, x, R, v, w)[0], [3], axis=1)],
                              axis=None)

    start = [np.ascontiguousarray(getattr(problem, each)) for each in accuracy.QUANTITIES]
    cuts = np.cumsum([each.size for each in start])[:-1]
    # Truth would take ten seconds for its twelve digits; the answer is one digit, and this has four.
    exact = solve_ivp(rate, (0.0, 1.0), np.concatenate(start, axis=None), "Radau", rtol=1e-3, atol=1e-5).y[:cuts[0], -1]

    def error(method):
        return np.abs(lieeuler.integrate(problem, method, 1 / 8, [0.0, 1.0]).x[-1] - exact).max()

    size = problem.kernel.length
    assert error(NAME) < 0.1 * size < error("DAE1L_LSE")


@pytest.mark.parametrize("name", ["four_bar", "bricard"])
def test_redundant_loops(name):
    scene = dataclasses.replace(crosscheck.load_scene(name), duration=0.5, samples=6)
    problem = build_problem(scene)
    truth = lieeuler.integrate(problem, "rkmk853", rtol=1e-12, t_eval=scene.t)
    errors = []
    for h in STEPS[1:]:
        run = lieeuler.integrate(problem, NAME, h, scene.t)
        for level, bound in ROUNDING.items():  # a loop near a singular position loses digits, as in DAE1L_LSE
            name = level if level == "orthogonality" else f"constraint_{level}"
            assert run.stats.maxima[name] < bound, level
        errors.append([np.abs(getattr(run, q) - getattr(truth, q)).max() for q in ("x", "v", "lam")])
    assert np.abs(np.polyfit(np.log(STEPS[1:]), np.log(errors), 1)[0] - 2).max() < ORDER


@pytest.mark.parametrize("step", [0.2, 0.25])
def test_a_stiff_damper_at_the_largest_steps(step):
    """From the motion at the start the iteration leaves the map's domain; from half the step it does not."""
    scene = crosscheck.load_scene("stiff_damped")
    problem = build_problem(scene)
    run = lieeuler.integrate(problem, NAME, step, [0, scene.duration])
    truth = lieeuler.integrate(problem, "seulex", rtol=1e-9, t_eval=[0, scene.duration])
    assert np.abs(run.x - truth.x).max() < 0.25  # of 1.5 m


def test_the_radius_is_checked_and_passed_on():
    problem = SYSTEMS["single_pendulum"]()
    for wrong in (-0.1, 1.1, float("nan"), "0.8", True):
        with pytest.raises(lieeuler.ArgumentError, match="spectral_radius"):
            lieeuler.integrate(problem, NAME, 0.1, [0, 1], spectral_radius=wrong)
    with pytest.raises(lieeuler.ArgumentError, match="for generalized_alpha; leave it out with rattle2"):
        lieeuler.integrate(problem, "rattle2", 0.1, [0, 1], spectral_radius=0.8)
    with pytest.raises(lieeuler.ArgumentError, match="ccsk"):
        lieeuler.integrate(problem, NAME, 0.1, [0, 1], map="ccsk")
    scene = crosscheck.load_scene("single_pendulum")
    ends = [crosscheck.run(scene, "lieeuler", NAME, 0.02, duration=1.0, samples=2, spectral_radius=radius).x[-1]
            for radius in (0.2, 0.8)]
    assert np.abs(ends[0] - ends[1]).max() > 1e-4
