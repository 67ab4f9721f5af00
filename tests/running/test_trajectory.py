"""Trajectories and the monitor: the same quantities for all engines, from their raw states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crosscheck.adapters.base import RawRun
from crosscheck.running.trajectory import derive
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import GROUND, Body, Force, Joint
from crosscheck.scene.monitor import MAXIMA, Monitor
from crosscheck.scene.states import States
from tests.scene_making import make_scene, moved


@pytest.fixture
def scene():
    return load_scene("double_pendulum")


@pytest.fixture
def states(scene):
    """Eleven states that drift off the joints, with arbitrary accelerations and multipliers."""
    rng = np.random.default_rng(7)
    poses = [moved(scene.x0, scene.R0, 0.01 * k * rng.normal(size=(2, 6))) for k in range(11)]
    drift = 0.01 * np.arange(11)[:, None, None]
    return States(np.linspace(0, 10, 11), np.stack([x for x, _ in poses]), np.stack([R for _, R in poses]),
                  scene.v0 + drift, scene.w0 - drift, rng.normal(size=(11, 2, 3)), rng.normal(size=(11, 2, 3)),
                  rng.normal(size=(11, 6)))


def raw_run(states, **changes):
    return RawRun(states, **{"wall_time": 0.5, "steps": 100, "step": 0.1, **changes})


def test_levels_are_the_largest_rows(scene, states):
    traj = derive(scene, "some", "method", raw_run(states))
    constraints = Constraints(scene)
    phi = constraints.position(states.x, states.R)
    np.testing.assert_array_equal(traj.constraint_position, np.abs(phi).max(axis=1))
    rates = np.einsum("tmk,tk->tm", constraints.jacobian(states.x, states.R),
                      np.concatenate([states.v, states.w], -1).reshape(11, -1))
    # two orders of summing a dozen products below 3
    np.testing.assert_allclose(traj.constraint_velocity, np.abs(rates).max(axis=1), rtol=0, atol=40 * 2.3e-16)


def test_accelerations_at_the_start_are_the_index1_values(scene, states):
    traj = derive(scene, "some", "method", raw_run(states))
    a, alpha, lam = mechanics.index1(scene, states.x[:1], states.R[:1], states.v[:1], states.w[:1])
    for found, first, given in ((traj.a, a, states.a), (traj.alpha, alpha, states.alpha), (traj.lam, lam, states.lam)):
        np.testing.assert_array_equal(found[:1], first)
        np.testing.assert_array_equal(found[1:], given[1:])
    assert traj.constraint_acceleration[0] < 1e-13  # 50 eps of accelerations of 10 m/s^2
    assert traj.constraint_acceleration[1] > 0.1  # the made-up ones belong to no motion


def test_the_raw_run_is_left_as_it_was(scene, states):
    before = states.a.copy()
    derive(scene, "some", "method", raw_run(states))
    np.testing.assert_array_equal(states.a, before)


def test_what_an_engine_does_not_know_is_none(scene, states):
    states.a = states.alpha = states.lam = None
    traj = derive(scene, "some", "method", raw_run(states))
    assert [traj.a, traj.alpha, traj.lam, traj.constraint_acceleration, traj.reactions] == [None] * 5


def test_reactions_move_every_body_with_gravity(scene, states):
    traj = derive(scene, "some", "method", raw_run(states))
    pivot, elbow = traj.reactions["pivot"][0][0], traj.reactions["elbow"][0][0]
    for k, force in enumerate((pivot - elbow, elbow)):
        expected = scene.bodies[k].mass * (traj.a[0, k] - scene.gravity)
        np.testing.assert_allclose(force, expected, rtol=0, atol=1e-13)  # 50 eps of forces of 10 N


def test_stats_hold_counters_step_and_maxima(scene, states):
    traj = derive(scene, "some", "method", raw_run(states, stats={"newton_iterations": 3},
                                                   maxima={"orthogonality": 1e-15}, form="tree", status="success"))
    assert traj.stats == {"newton_iterations": 3, "step": 0.1, "orthogonality": 1e-15}
    assert (traj.engine, traj.method, traj.form, traj.status) == ("some", "method", "tree", "success")
    assert (traj.wall_time, traj.steps, traj.scene) == (0.5, 100, scene)


def test_monitor_finds_the_maxima_of_the_trajectory(scene, states):
    traj = derive(scene, "some", "method", raw_run(states))
    monitor = Monitor(scene)
    monitor.update(states.x, states.R, states.v, states.w, traj.a, traj.alpha)
    maxima = monitor.maxima()
    assert tuple(maxima) == MAXIMA
    for key in MAXIMA[1:]:
        assert maxima[key] == getattr(traj, key).max()
    kinetic = mechanics.kinetic_energy(scene, states)
    start = States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    expected = np.abs(traj.energy - mechanics.energy(scene, start)).max() / kinetic.max()
    assert maxima["energy_error"] == pytest.approx(expected, rel=1e-13)  # 50 eps, energies ten times their gap


def test_monitor_does_not_care_how_steps_are_batched(scene, states):
    whole, parts = Monitor(scene), Monitor(scene)
    arrays = (states.x, states.R, states.v, states.w, states.a, states.alpha)
    whole.update(*arrays)
    for cut in (slice(0, 4), slice(4, 4), slice(4, 5), slice(5, 11)):
        parts.update(*(values[cut] for values in arrays))
    assert parts.maxima() == whole.maxima()


def test_monitor_without_accelerations_reports_none(scene, states):
    monitor = Monitor(scene)
    monitor.update(states.x, states.R, states.v, states.w)
    assert tuple(monitor.maxima()) == tuple(key for key in MAXIMA if key != "constraint_acceleration")


def test_energy_error_is_relative_to_the_largest_kinetic_energy():
    body = Body("b", 2.0, np.eye(3), [1, 0, 0, 0], [0, 0, 0], [0, 0, 0], [1.0, 0, 0])
    monitor = Monitor(make_scene([body], [], gravity=np.zeros(3)))  # kinetic energy 1 J
    R, w = np.broadcast_to(np.eye(3), (1, 1, 3, 3)), np.zeros((1, 1, 3))
    monitor.update(np.zeros((1, 1, 3)), R, np.array([[[3.0, 0, 0]]]), w)  # 9 J, 8 too many
    assert monitor.maxima()["energy_error"] == 8 / 9
    monitor.update(np.zeros((1, 1, 3)), R, np.array([[[5.0, 0, 0]]]), w)  # 25 J, 24 too many
    assert monitor.maxima()["energy_error"] == 24 / 25
    monitor.update(np.zeros((1, 1, 3)), R, np.array([[[1.0, 0, 0]]]), w)  # back to 1 J
    assert monitor.maxima()["energy_error"] == 24 / 25


def test_monitor_unwraps_torsion_angles_across_batches():
    axis = np.array([0.0, 0.0, 1.0])
    body = Body("b", 1.0, np.eye(3), [1, 0, 0, 0], [0, 0, 1.0], [0, 0, 0], [0, 0, 0])
    hinge = Joint("hinge", "revolute", GROUND, 0, np.zeros(3), np.zeros(3), axis, axis)
    spring = Force("torsional_spring", None, None, "hinge", {"stiffness": 2.0, "rest_angle": 0.0, "damping": 0.0})
    scene = make_scene([body], [hinge], [spring])
    monitor = Monitor(scene)
    turns = np.linspace(0, 4 * np.pi, 41)
    R = Rotation.from_rotvec(turns[:, None] * axis).as_matrix()[:, None]
    for k in range(0, 41, 5):
        part = R[k:k + 5]
        monitor.update(np.zeros((len(part), 1, 3)), part, np.zeros((len(part), 1, 3)), np.zeros((len(part), 1, 3)))
    # the spring stores theta^2 after two turns; the start had 0.5 J, all of it kinetic
    assert monitor.maxima()["energy_error"] == pytest.approx(((4 * np.pi) ** 2 - 0.5) / 0.5, rel=1e-13)


def test_a_diverged_run_shows_in_its_maxima(scene, states):
    states.v[5] = 1e200
    states.w[6] = np.nan
    monitor = Monitor(scene)
    monitor.update(states.x, states.R, states.v, states.w)
    assert not np.isfinite(monitor.maxima()["energy_error"])
    assert np.isnan(monitor.maxima()["constraint_velocity"])
    assert np.isnan(derive(scene, "some", "method", raw_run(states)).energy[6])
