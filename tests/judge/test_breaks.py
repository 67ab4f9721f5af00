"""Where functions of time jump: the true motion over an interval, work, and the energy error of sweeps."""

from __future__ import annotations

import json

import numpy as np
import pytest

import crosscheck
from crosscheck.running.work import work
from crosscheck.scene.batch import integrate
from crosscheck.scene.building import scene_from
from crosscheck.scene.states import States

J, K, C = 0.1, 1.0, 0.02
TIMES, TORQUES = (0.3, 0.9, 1.4), (0.2, -0.5, 0.7)


def content(samples=81, **torque):
    """A sprung and damped wheel under a torque that is held from time to time."""
    return {"schema": 3, "name": "held", "gravity": [0.0] * 3, "duration": 2.0, "samples": samples,
            "bodies": [{"name": "wheel", "mass": 1.0, "inertia": np.diag([J] * 3).tolist()}],
            "joints": [{"name": "pin", "type": "revolute", "parent": "ground", "child": "wheel",
                        "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3, "parent_axis": [0.0, 0.0, 1.0],
                        "child_axis": [0.0, 0.0, 1.0], "position": 0.3, "velocity": 0.4, "stiffness": K, "damping": C}],
            "forces": [{"type": "joint_torque", "joint": "pin",
                        "torque": {"type": "hold", "times": TIMES, "values": TORQUES} | torque}]}


def exact(t):
    """(q, q') of J q'' + C q' + K q = torque at times t, by the closed form from jump to jump."""
    a, w = C / (2 * J), np.sqrt(K / J - (C / (2 * J)) ** 2)
    q, v, begin, rows = 0.3, 0.4, 0.0, []
    for end, torque in zip((TIMES[1], TIMES[2], np.inf), TORQUES, strict=True):
        def at(s, q=q, v=v, torque=torque):
            y = q - torque / K
            b = (v + a * y) / w
            value = np.exp(-a * s) * (y * np.cos(w * s) + b * np.sin(w * s))
            rate = -a * value + np.exp(-a * s) * w * (b * np.cos(w * s) - y * np.sin(w * s))
            return value + torque / K, rate

        rows += [at(s - begin) for s in t if begin <= s < end]
        if end < np.inf:
            (q, v), begin = at(end - begin), end
    return np.array(rows).T


def motion(samples):
    t = np.linspace(0.0, 2.0, samples)
    q, v = exact(t)
    R, w = np.zeros((samples, 1, 3, 3)), np.zeros((samples, 1, 3))
    R[:, 0, 0, 0], R[:, 0, 0, 1], R[:, 0, 1, 0], R[:, 0, 1, 1], R[:, 0, 2, 2] = (
        np.cos(q), -np.sin(q), np.sin(q), np.cos(q), 1.0)
    w[:, 0, 2] = v
    return States(t, np.zeros((samples, 1, 3)), R, np.zeros((samples, 1, 3)), w)


@pytest.mark.parametrize("samples", [81, 44])  # jumps at samples, and between them
def test_the_flow_of_an_interval_stops_at_jumps(samples):
    scene, true = scene_from(content(samples), "held"), motion(samples)
    begin = States(true.t[:-1], true.x[:-1], true.R[:-1], true.v[:-1], true.w[:-1])
    end = integrate(scene, begin, np.diff(true.t), 3)[0]
    np.testing.assert_allclose(end.w, true.w[1:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(end.R, true.R[1:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(end.t, true.t[1:], rtol=1e-15)


@pytest.mark.parametrize("samples", [81, 44, 3])
def test_the_work_of_a_torque_that_jumps(samples):
    scene, true = scene_from(content(samples), "held"), motion(samples)
    gained = 0.5 * J * true.w[:, 0, 2] ** 2 + 0.5 * K * exact(true.t)[0] ** 2
    true.hinges = exact(true.t)[0][:, None]
    np.testing.assert_allclose(work(scene, true), gained - gained[0], rtol=0, atol=1e-10)


def test_the_energy_error_of_a_sweep_is_that_of_a_run(tmp_path):
    (tmp_path / "held.json").write_text(json.dumps(content()))
    frame = crosscheck.sweep({"scenes": [str(tmp_path / "held.json")], "engines": {"lieeuler": ["taylor"]},
                              "rtols": [1e-10]}, out=tmp_path / "out")
    assert frame["energy_error"][0] < 1e-9
