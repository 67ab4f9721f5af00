"""Engines on scenes that depend on time: their documented orders, and their reasons if they cannot run them."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec
from crosscheck.document import Record

CASES = [("mujoco", "RK4", 1e-2), ("mujoco", "implicitfast", 2e-3), ("pinocchio", "RKMK4", 1e-2),
         ("pinocchio", "SymplecticEuler", 2e-3), ("exudyn", "GeneralizedAlpha", 1e-2), ("exudyn", "RK44", 1e-2)]


@pytest.mark.parametrize(("engine", "method", "step"), CASES)
def test_documented_order_on_a_driven_pendulum(engine, method, step):
    """A force that is held over a step, or taken at the wrong end of it, reduces the order to one."""
    scene = crosscheck.load_scene("driven_double_pendulum").replace(duration=0.5, samples=6)
    exact = references.truth(scene).states
    errors = [np.abs(crosscheck.run(scene, engine=engine, method=method, step=h).x - exact.x).max()
              for h in (step, step / 2)]
    order = adapters.get(engine).documented_order(scene, RunSpec(method, step=step))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize(("engine", "method"), [("mujoco", "RK4"), ("pinocchio", "RKMK4")])
def test_rail_motor_spline_and_moving_rest_angle(engine, method):
    scene = crosscheck.load_scene("driven_cart").replace(duration=0.5, samples=6)
    exact = references.truth(scene).states
    run = crosscheck.run(scene, engine=engine, method=method, step=5e-3)
    assert np.abs(run.x - exact.x).max() < 1e-8  # order four: 4e-9 at this step
    assert np.abs(run.a - exact.a).max() < 1e-5  # accelerations at the samples' own times


def test_the_control_of_one_run_does_not_reach_the_next():
    scene = crosscheck.load_scene("driven_double_pendulum").replace(duration=0.1, samples=2)
    free = crosscheck.load_scene("single_pendulum").replace(duration=0.1, samples=2)
    before = crosscheck.run(free, engine="mujoco", method="RK4", step=1e-2).x
    crosscheck.run(scene, engine="mujoco", method="RK4", step=1e-2)
    np.testing.assert_array_equal(crosscheck.run(free, engine="mujoco", method="RK4", step=1e-2).x, before)


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio", "exudyn"])
def test_prescribed_joints_are_refused_by_name(engine):
    scene = crosscheck.load_scene("driven_slider_crank")
    method = adapters.get(engine).methods[0]
    with pytest.raises(crosscheck.Unsupported, match="'motor' has the key drive"):
        crosscheck.run(scene, engine=engine, method=method, step=1e-3)


def test_a_moving_rest_angle_is_refused_by_exudyn():
    with pytest.raises(crosscheck.Unsupported, match="rest angle that moves"):
        crosscheck.run("driven_cart", engine="exudyn", method="GeneralizedAlpha", step=1e-2)


def judged(scene, traj, step):
    """The verdict on a run of rattle4 that claims to be one of the scene."""
    from crosscheck.verification.cell import judge_run

    asked = Record(scene=scene.name, engine="lieeuler", version="", method="rattle4", form=None, step=step, rtol=None,
                documented_order=4)
    levels = frozenset({"position", "velocity", "acceleration"})
    return judge_run(asked, scene, dataclasses.replace(traj, scene=scene), levels)


def test_the_energy_error_of_a_driven_run_is_less_the_work_done():
    """Of order h^4 for rattle4, where the energy itself changes by as much as the motors do: some joules."""
    scene = crosscheck.load_scene("driven_double_pendulum")
    found = [judged(scene, crosscheck.run(scene, engine="lieeuler", method="rattle4", step=h), h) for h in (1e-2, 5e-3)]
    assert [each.outcome for each in found] == ["pass", "pass"]
    assert np.log2(found[0].energy_error / found[1].energy_error) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("wrong", [lambda f: f.times(1.02), lambda f: f.times(-1.0), lambda f: f.delayed(2e-3)])
def test_a_wrong_drive_does_not_pass(wrong):
    """Two percent, the sign, two milliseconds: with bounds of order four at steps of 1 ms."""
    scene = crosscheck.load_scene("driven_double_pendulum")
    motor = scene.forces[0]
    altered = dataclasses.replace(motor, parameters={"torque": wrong(motor.parameters["torque"])})
    other = scene.replace(forces=(altered, *scene.forces[1:]))
    traj = crosscheck.run(other, engine="lieeuler", method="rattle4", step=1e-3)
    assert judged(scene, traj, 1e-3).outcome == "fail"
