"""The work along a run: a closed form however few the outputs are, and nothing where it is not known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck.compare.errors import energy_gap
from crosscheck.running.work import work
from crosscheck.scene.building import scene_from
from crosscheck.scene.states import States

J, C, W = 0.2, 0.3, 9.0


def wheel(**joint):
    """A wheel with a damper on its axis, which turns by 6 rad until it rests."""
    return scene_from({"schema": 3, "name": "wheel", "gravity": [0.0] * 3, "duration": 2.0, "samples": 3,
                       "bodies": [{"name": "wheel", "mass": 1.0, "inertia": np.diag([J] * 3).tolist()}],
                       "joints": [{"name": "pin", "type": "revolute", "parent": "ground", "child": "wheel",
                                   "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3, "damping": C,
                                   "parent_axis": [0.0, 0.0, 1.0], "child_axis": [0.0, 0.0, 1.0],
                                   "position": 0.0, "velocity": W} | joint]}, "wheel")


def states(times, rates):
    """Rates of the wheel at times; its attitudes are all that of the start."""
    w = np.zeros((len(times), 1, 3))
    w[:, 0, 2] = rates
    rest = np.zeros((len(times), 1, 3))
    return States(np.array(times), rest, np.tile(np.eye(3), (len(times), 1, 1, 1)), rest, w,
                  hinges=np.zeros((len(times), 1)))


@pytest.mark.parametrize("times", [[0.0, 2.0], [0.0, 0.3, 2.0]])
def test_work_is_that_of_the_true_motion_from_the_states_of_a_run(times):
    rates = np.linspace(W, 1.0, len(times))  # of no true motion
    lost = 0.5 * J * rates[:-1] ** 2 * np.expm1(-2 * C / J * np.diff(times))
    np.testing.assert_allclose(work(wheel(), states(times, rates)), [0.0, *np.cumsum(lost)], rtol=0, atol=1e-10 * W**2)


def test_work_is_not_known_from_where_states_or_turns_are_not():
    scene, run = wheel(stiffness=1.0), states([0.0, 1.0, 2.0, 3.0], [W, 4.0, 2.0, 1.0])
    run.w[2] = np.nan
    np.testing.assert_array_equal(np.isnan(work(scene, run)), [False, False, False, True])
    far = dataclasses.replace(run, w=states(run.t, [W] * 4).w, hinges=None)  # 9 rad from one to the next
    np.testing.assert_array_equal(np.isnan(work(scene, far)), [False, False, True, True])
    assert np.isnan(energy_gap(scene, far, None, {}, lambda: work(scene, far)))


def test_work_is_not_known_where_steps_do_not_settle(monkeypatch):
    monkeypatch.setattr("crosscheck.running.work.HALVINGS", 4)
    scene = wheel(damping=1e6)  # far faster than the finest step
    np.testing.assert_array_equal(np.isnan(work(scene, states([0.0, 2.0], [W, 0.0]))), [False, True])


def test_the_energy_error_of_a_run_without_truth_is_that_beside_its_work():
    traj = crosscheck.run(wheel(), "lieeuler", "rkmk853", rtol=1e-11)
    exact = 0.5 * J * W**2 * np.expm1(-2 * C / J * traj.t)
    np.testing.assert_allclose(traj.work, exact, rtol=0, atol=1e-9)
    assert energy_gap(traj.scene, traj, None, {}, lambda: traj.work) < 1e-9
