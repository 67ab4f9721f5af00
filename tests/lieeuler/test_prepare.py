"""Prepared runs give the solutions of `integrate`, from any state, and share nothing with each other."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from lieeuler import checks
from tests.lieeuler.systems import SYSTEMS

T = np.linspace(0, 0.2, 3)
FIELDS = ("t", "x", "R", "v", "w", "a", "alpha", "lam")
SCENES = ("single_pendulum", "heavy_top", "four_bar", "fixed_pair", "geared_arm", "torsion_wheel",
          "driven_slider_crank")
STATE = ("x", "R", "v", "w")


def problem_of(name):
    return build_problem(crosscheck.load_scene(name))


def size_of(method):
    return {"rtol": 1e-8} if "rtol" in lieeuler.METHODS[method].controls else {"step": 1e-2}


def assert_equal(one, other):
    assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in FIELDS)
    assert (one.status, one.t_end, one.method) == (other.status, other.t_end, other.method)
    assert dataclasses.replace(one.stats, wall_time=0.0) == dataclasses.replace(other.stats, wall_time=0.0)


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
        same = {"rtol": 1e-6, "atol": 1e-6} if run._arguments.step is None else {"rtol": 1e-11, "atol": 1e-12}
        assert all(np.allclose(getattr(run(**state), each), getattr(other, each), **same) for each in FIELDS)
    else:
        assert_equal(run(**state), other)
    assert_equal(run(**{key: value.tolist() for key, value in state.items()}), run(**state))
    assert_equal(run(), here)


@pytest.mark.parametrize(("change", "message"), [
    ({"v": [[9.0, 0, 0]]}, "violates the velocity constraints"), ({"x": [[9.0, 0, 0]]}, "violates the joints"),
    ({"R": [2 * np.eye(3)]}, "rotation matrices"), ({"R": [np.diag([1.0, 1, -1])]}, "rotation matrices"),
    ({"w": [[np.nan, 0, 0]]}, "w must be finite"), ({"w": [0, 0]}, "w must be finite and of shape"),
    ({"x": "here"}, "x must be numbers"), ({"v": [[1e200, 0, 0]]}, "out of range"),
])
def test_a_wrong_state_is_named(change, message):
    run = lieeuler.prepare(SYSTEMS["single_pendulum"](), "rattle2", 1e-2, T)
    with pytest.raises(lieeuler.ArgumentError, match=message):
        run(**change)
    assert run().success


def test_kept_runs_are_those_of_their_arguments():
    problem = SYSTEMS["single_pendulum"]()
    times = np.array([0.0, 1.0])
    problem = dataclasses.replace(problem, gravity=0 * problem.gravity, v=0 * problem.v, w=0 * problem.w)
    one = lieeuler.integrate(problem, "rattle2", 1, times)
    with pytest.raises(lieeuler.ArgumentError, match="step"):
        lieeuler.integrate(problem, "rattle2", True, times)
    times[1] = 2.0  # other times in the same array
    assert lieeuler.integrate(problem, "rattle2", 1, times).t[-1] == 2.0
    assert_equal(one, lieeuler.integrate(problem, "rattle2", 1, [0.0, 1.0]))
    for h in np.linspace(0.1, 0.5, 40):
        lieeuler.integrate(problem, "rattle2", h, times)
    assert len(vars(problem)["_runs"]) <= 16
    assert_equal(one, lieeuler.integrate(problem, "rattle2", 1, np.array([0.0, 1.0])))


@pytest.mark.parametrize("monitor", [True, False])
def test_a_run_that_fails_fails_again(monitor):
    run = lieeuler.prepare(SYSTEMS["double_pendulum"](), "rattle2", 2.0, [0, 2.0, 40.0], monitor=monitor)
    ended = []
    for _ in range(2):
        with pytest.raises(lieeuler.IntegrationError) as caught:
            run()
        ended.append(caught.value.solution)
    assert_equal(*ended)
    assert len(ended[0].t) < 3


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
    e = run._plane.normal
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


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1e100])
def test_an_axis_of_any_size_has_its_direction(size):
    np.testing.assert_allclose(checks.unit("axis", [0.0, size, 0.0]), [0.0, 1.0, 0.0])
