"""Prepared runs give the solutions of `integrate`, from any state, and share nothing with each other."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from tests.lieeuler.test_prepare import FIELDS, T, assert_equal

SCENES = ("single_pendulum", "heavy_top", "four_bar", "fixed_pair", "geared_arm", "torsion_wheel",
          "driven_slider_crank")
STATE = ("x", "R", "v", "w")


def problem_of(name):
    return build_problem(crosscheck.load_scene(name))


def size_of(method):
    return {"rtol": 1e-8} if "rtol" in lieeuler.METHODS[method].controls else {"step": 1e-2}


@pytest.mark.parametrize("monitor", [True, False])
@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle2", "rkmk54", "taylor", "seulex"])
@pytest.mark.parametrize("name", SCENES)
def test_solutions_are_those_of_integrate(name, method, monitor):
    run = lieeuler.prepare(problem_of(name), method, t_eval=T, monitor=monitor, **size_of(method))
    first, second = run(), run()
    assert_equal(first, lieeuler.integrate(problem_of(name), method, t_eval=T, monitor=monitor, **size_of(method)))
    assert_equal(first, second)
    first.t[:], first.x[:], first.R[:] = 0, 0, 0  # no other solution has this memory
    assert_equal(second, run())


@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle4", "rkmk4", "rkmk853", "taylor"])
@pytest.mark.parametrize("name", SCENES[:-1])
def test_from_another_state(name, method):
    problem = problem_of(name)
    later = lieeuler.integrate(problem, "rkmk853", t_eval=[0, 0.3], rtol=1e-13)
    state = {key: getattr(later, key)[-1] for key in STATE}
    run = lieeuler.prepare(problem, method, t_eval=T, **size_of(method))
    here = run()
    other = lieeuler.integrate(dataclasses.replace(problem, **state), method, t_eval=T, **size_of(method))
    if (plane := run._plane) and plane.entered(0.0, *state.values()):  # planned anew, its axes are those of this state
        same = {"rtol": 1e-6, "atol": 1e-6} if run._step is None else {"rtol": 1e-11, "atol": 1e-12}
        assert all(np.allclose(getattr(run(**state), each), getattr(other, each), **same) for each in FIELDS)
    else:
        assert_equal(run(**state), other)
    assert_equal(run(**{key: value.tolist() for key, value in state.items()}), run(**state))
    assert_equal(run(), here)


@pytest.mark.parametrize("monitor", [True, False])
@pytest.mark.parametrize("name", ["single_pendulum", "chain_8", "four_bar", "bead_on_line"])
def test_a_system_at_rest_without_gravity_is_closed(name, monitor):
    """All that moves is rounding, 1e-29 m/s: no joint opens by it."""
    problem = problem_of(name)
    still = dataclasses.replace(problem, gravity=np.zeros(3), v=0 * problem.v, w=0 * problem.w)
    for method in lieeuler.METHODS:
        run = lieeuler.integrate(still, method, t_eval=T, monitor=monitor, **size_of(method))
        assert run.success, (method, run.stats)
        assert np.abs(run.x[-1] - still.x).max() < 1e-13
    ensemble = lieeuler.integrate_ensemble(still, "rattle4", 1e-2, T, x=still.x[None])
    assert ensemble.success.all()


def test_a_level_that_opens_is_still_seen():
    """A system that falls apart slowly is no system at rest."""
    problem = problem_of("bricard")
    slow = dataclasses.replace(problem, gravity=1e-6 * problem.gravity)
    for scale, given in ((1.0, problem), (1e3, slow)):  # the same motion, a thousand times slower
        run = lieeuler.integrate(given, "DAE2L_LE", 1e-2 * scale, [0, scale])
        assert run.status is lieeuler.Status.CONSTRAINTS_OPEN


@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle4", "rkmk853", "taylor"])
@pytest.mark.parametrize("name", ["driven_slider_crank"])
def test_a_driven_mechanism_starts_at_any_time(name, method):
    """A run to .7 s is a run to .3 s and one from there, to the tolerance or the order of the method."""
    problem = problem_of(name)
    size = {"rtol": 1e-11} if "rtol" in lieeuler.METHODS[method].controls else {"step": 1e-3}
    whole = lieeuler.integrate(problem, method, t_eval=[0, 0.3, 0.7], **size)
    state = {key: getattr(whole, key)[1] for key in STATE}
    with pytest.raises(lieeuler.ArgumentError, match="violates"):
        dataclasses.replace(problem, **state)
    later = dataclasses.replace(problem, **state, time=0.3)
    rest = lieeuler.integrate(later, method, t_eval=[0.3, 0.7], **size)
    assert rest.success
    order = lieeuler.METHODS[method].order
    bound = 1e-3 if order == 1 else 1e-8
    assert np.abs(rest.x[-1] - whole.x[-1]).max() < bound
    assert np.abs(rest.R[-1] - whole.R[-1]).max() < bound
    with pytest.raises(lieeuler.ArgumentError, match=r"at t = 0 s, where the run begins, not at Problem\.time"):
        lieeuler.integrate(later, method, t_eval=[0, 0.7], **size)


@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle2", "rkmk853", "taylor"])
@pytest.mark.parametrize("name", ["hinge_pendulum", "four_bar", "squeezer"])
def test_states_in_the_plane_of_the_first_one_plan_nothing(name, method, monkeypatch):
    """And a state that leaves it by a little does: tilted, shifted, turned upside down, moving out, open."""
    problem = problem_of(name)
    h = 1e-2 * crosscheck.load_scene(name).duration
    control = {"rtol": 1e-9} if "rtol" in lieeuler.METHODS[method].controls else {"step": h}
    run = lieeuler.prepare(problem, method, t_eval=[0.0, h], **control)
    later = lieeuler.integrate(problem, "rkmk853", t_eval=[0.0, 7 * h], rtol=1e-13)
    state = {key: getattr(later, key)[-1] for key in STATE}
    other = lieeuler.integrate(dataclasses.replace(problem, **state), method, t_eval=[0.0, h], **control)
    e = run._plane.world[2]
    turn = np.eye(3) + 1e-9 * np.cross(np.array([1.0, 0, 0]), np.eye(3))
    away = {"x": state["x"] + 1e-9 * e, "v": state["v"] + 1e-6 * e, "w": state["w"] + 1e-6,
            "R": turn @ state["R"], "open": None}
    for key, value in away.items():
        changed = {**state, **({key: value} if value is not None else {"x": state["x"] + 1e-10 * (np.eye(3)[0] + e)})}
        assert run._plane.entered(0.0, *changed.values()) is None, key
    monkeypatch.setattr(sys.modules["lieeuler.integrate"], "reductions", None)
    here = run(**state)
    for each in FIELDS:
        size = np.abs(getattr(other, each)).max()
        assert np.abs(getattr(here, each) - getattr(other, each)).max() <= (1e-10 if "step" in control else 1e-7) * size
