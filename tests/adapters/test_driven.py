"""Engines on scenes that depend on time: their documented orders, and reasons where they cannot."""

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec

CASES = [("mujoco", "RK4", 1e-2), ("mujoco", "implicitfast", 2e-3), ("pinocchio", "RKMK4", 1e-2),
         ("pinocchio", "SymplecticEuler", 2e-3), ("exudyn", "GeneralizedAlpha", 1e-2), ("exudyn", "RK44", 1e-2)]


@pytest.mark.parametrize(("engine", "method", "step"), CASES)
def test_documented_order_on_a_driven_pendulum(engine, method, step):
    """A force held over a step, or taken at its wrong end, leaves order one."""
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
