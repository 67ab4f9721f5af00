"""Every derived figure of truth and of a run against Newton's and Euler's mechanics of `mechanics`.

What a source does not know may be NaN; a number has to be right.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.oracle_values.cases import TREES, close, content, figures, mechanism, source

both = pytest.mark.parametrize("who", ["truth", "lieeuler"])
OF_JOINTS = {"joint_position", "joint_velocity"}
OF_LOADS = {"force", "torque", "joint_effort"}


@pytest.fixture(scope="module", params=TREES)
def name(request):
    """A scene whose motion is known."""
    figures(request.param)
    return request.param


def sensors(name, who, kinds):
    """Readings beside their values by definition."""
    for sensor in content(name)["sensors"]:
        if sensor["type"] not in kinds:
            continue
        wanted = np.array([figure.read(sensor) for figure in figures(name)])
        value = np.asarray(source(name, who).sensors[sensor["name"]])
        if sensor["type"] == "attitude":  # a quaternion and its negative are one attitude
            wanted *= np.where(np.sum(wanted * value, axis=1) < 0, -1.0, 1.0)[:, None]
        if sensor["type"] == "joint_effort":  # of a cylindrical joint that about its axis
            wanted = wanted[:, 0]
        yield value, wanted, sensor["name"]


@both
def test_motion_and_accelerations(name, who):
    run = source(name, who)
    run = run.states if who == "truth" else run
    for key in ("x", "R", "v", "w"):
        close(getattr(run, key), [figure.states()[key] for figure in figures(name)], key)
    if run.a is not None:
        for key in ("a", "alpha"):
            close(getattr(run, key), [figure.accelerations()[key] for figure in figures(name)], key)


@both
def test_sensors_of_sites(name, who):
    rest = {sensor["type"] for sensor in content(name)["sensors"]} - OF_JOINTS - OF_LOADS
    for value, wanted, what in sensors(name, who, rest):
        close(value, wanted, what)


@both
def test_joint_sensors_count_turns(name, who):
    for value, wanted, what in sensors(name, who, OF_JOINTS):
        if wanted.shape[-1] == 4:
            wanted = wanted * np.where(np.sum(wanted * value, axis=1) < 0, -1.0, 1.0)[:, None]
        close(value, wanted, what)


@both
def test_wrenches_and_efforts(name, who):
    for value, wanted, what in sensors(name, who, OF_LOADS):
        close(value, wanted, what)


def test_joint_coordinates(name):
    run = source(name, "lieeuler")
    for joint in figures(name)[0].joints():
        position, rate = (np.array([figure.joints()[joint][k] for figure in figures(name)]) for k in (0, 1))
        value = run.joints[joint].position
        if position.shape[1] == 4:
            position *= np.where(np.sum(position * value, axis=1) < 0, -1.0, 1.0)[:, None]
        close(value, position, joint)
        close(run.joints[joint].velocity, rate, joint)


def test_energies(name):
    run = source(name, "lieeuler")
    for key, value in {"kinetic": run.kinetic_energy, "potential": run.potential_energy, "energy": run.energy}.items():
        close(value, [figure.energy()[key] for figure in figures(name)], key)


def test_work(name):
    """At the outputs of the scene, a second and many radians apart. What a stop takes is work here, not there."""
    wanted = np.array([figure.energy()["work"] for figure in figures(name)])
    if any("restitution" in stop for stop in mechanism(name).limits.values()):
        wanted = np.array([figure.energy()["energy"] for figure in figures(name)])
        wanted -= wanted[0]
    close(source(name, "lieeuler").work, wanted, "work")


def test_momentum(name):
    if np.any(mechanism(name).g):
        close(source(name, "lieeuler").momentum_vertical, [figure.momentum() for figure in figures(name)], "momentum")


def test_own_energy_is_that_of_the_start_and_work(name):
    """The oracle against itself: nothing is lost but at a stop."""
    if not any("restitution" in stop for stop in mechanism(name).limits.values()):
        energies = [figure.energy() for figure in figures(name)]
        left = np.array([energy["energy"] - energy["work"] for energy in energies])
        size = max(abs(value) for energy in energies for value in energy.values())
        np.testing.assert_allclose(left, left[0], rtol=0, atol=1e-10 * max(1.0, size))
