"""Derivatives of flows: closed forms, orders of methods, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import crosscheck
from crosscheck.scene.building import scene_from
from tests.jointspace.arms import arm


def slider(*forces):
    """A damped mass on a spring, or under other forces."""
    return scene_from({
        "schema": 3, "name": "slider", "gravity": [0.0, 0.0, 0.0], "duration": 1.0, "samples": 2,
        "bodies": [{"name": "mass", "mass": 2.0, "inertia": np.diag([0.1] * 3).tolist()}],
        "joints": [{"name": "slide", "type": "prismatic", "parent": "ground", "child": "mass",
                    "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3, "parent_axis": [1.0, 0.0, 0.0],
                    "child_axis": [1.0, 0.0, 0.0], "position": 0.3, "velocity": 0.1}],
        "forces": list(forces) or [{"type": "linear_spring", "parent": "ground", "child": "mass",
                                    "parent_point": [-1.0, 0.0, 0.0], "child_point": [0.0] * 3,
                                    "stiffness": 30.0, "free_length": 1.0, "damping": 0.7}]}, "slider")


def test_a_linear_oscillator():
    found = crosscheck.flow_derivative(slider(), 0.9, parameters=("forces.0.stiffness", "bodies.mass.mass"))

    def flow(k, m):
        return expm(0.9 * np.array([[0.0, 1.0], [-k / m, -0.7 / m]]))

    np.testing.assert_allclose(found.matrix, flow(30.0, 2.0), atol=1e-11)
    start, h = np.array([0.3, 0.1]), 1e-5
    wanted = np.stack([(flow(30.0 + h, 2.0) - flow(30.0 - h, 2.0)) @ start / (2 * h),
                       (flow(30.0, 2.0 + h) - flow(30.0, 2.0 - h)) @ start / (2 * h)], axis=1)
    np.testing.assert_allclose(found.parameters, wanted, atol=1e-9)
    assert found.error < 1e-10


@pytest.mark.parametrize("duration", [0.2, 0.7, 1.3])
def test_a_ball_that_turns_by_more_than_half_a_turn(duration):
    """A body of equal moments keeps its rate w; turns in its axes go as expm(-w x t), whatever its quaternion."""
    w = np.array([2.0, -3.0, 6.0])
    scene = scene_from({
        "schema": 2, "name": "ball", "gravity": [0.0, 0.0, 0.0], "duration": 1.0, "samples": 2,
        "bodies": [{"name": "ball", "mass": 1.0, "inertia": np.diag([0.2] * 3).tolist(), "position": [0.0] * 3,
                    "angular_velocity": w.tolist()}],
        "joints": [{"name": "joint", "type": "spherical", "parent": "ground", "child": "ball",
                    "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3}]}, "ball")
    found = crosscheck.flow_derivative(scene, duration)
    turning = np.zeros((6, 6))
    turning[:3] = np.hstack([np.cross(w, np.eye(3)), np.eye(3)])
    np.testing.assert_allclose(found.matrix, expm(duration * turning), atol=1e-12)


def test_the_gains_of_a_servo():
    scene = slider({"type": "servo", "joint": "slide", "proportional": 30.0, "derivative": 0.7})
    found = crosscheck.flow_derivative(scene, 0.9, parameters=("forces.0.proportional", "forces.0.derivative"))

    def end(k, c):
        return expm(0.9 * np.array([[0.0, 1.0], [-k / 2.0, -c / 2.0]])) @ [0.3, 0.1]

    h = 1e-5
    wanted = [(end(30.0 + h, 0.7) - end(30.0 - h, 0.7)) / (2 * h), (end(30.0, 0.7 + h) - end(30.0, 0.7 - h)) / (2 * h)]
    np.testing.assert_allclose(found.parameters.T, wanted, atol=1e-9)


def block(duration=2.0, **law):
    """A block on a slide, at 1 m/s, with dry friction or a stop."""
    return scene_from({
        "schema": 3, "name": "block", "gravity": [0.0, 0.0, 0.0], "duration": duration, "samples": 2,
        "bodies": [{"name": "block", "mass": 2.0, "inertia": np.diag([0.1] * 3).tolist()}],
        "joints": [{"name": "slide", "type": "prismatic", "parent": "ground", "child": "block",
                    "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3, "parent_axis": [1.0, 0.0, 0.0],
                    "child_axis": [1.0, 0.0, 0.0], "position": 0.0, "velocity": 1.0} | law]}, "block")


@pytest.mark.parametrize(("law", "source", "wanted"), [
    ({"dry_friction": 1.5}, "truth", [[1.0, 4 / 3], [0.0, 0.0]]),  # it stops after v^2 m / 2c
    ({"dry_friction": 1.5}, "lieeuler:rattle2", [[1.0, 4 / 3], [0.0, 0.0]]),
    ({"limits": {"upper": 0.5, "restitution": 0.6}}, "lieeuler:taylor", [[-0.6, -1.2], [0.0, -0.6]]),
])
def test_the_jump_at_an_event_is_in_the_derivative(law, source, wanted):
    step = 0.01 if "rattle" in source else None
    found = crosscheck.flow_derivative(block(**law), 2.0, source=source, step=step)
    np.testing.assert_allclose(found.matrix, wanted, atol=1e-8)


def test_events_that_change_with_the_start_leave_no_derivative():
    with pytest.raises(crosscheck.Unsupported, match="events of its laws"):  # it comes to rest at just this time
        crosscheck.flow_derivative(block(dry_friction=1.5), 4 / 3, source="lieeuler:rattle2", step=0.01)


@pytest.mark.parametrize(("source", "order"), [("lieeuler:rattle2", 2), ("mujoco:RK4", 4)])
def test_a_discrete_map_converges_at_its_order(source, order):
    scene, paths = arm(damping=0.0), ("bodies.b1.mass", "gravity.2", "joints.j1.parent_anchor.2")
    exact = crosscheck.flow_derivative(scene, 0.4, parameters=paths)
    errors = []
    for step in (2e-2, 1e-2):
        given = crosscheck.flow_derivative(scene, 0.4, source=source, step=step, parameters=paths)
        errors.append([np.abs(given.matrix - exact.matrix).max(), np.abs(given.parameters - exact.parameters).max()])
    np.testing.assert_allclose(np.log2(np.divide(*errors)), order, atol=0.25)


@pytest.mark.parametrize(("arguments", "said"), [
    ({"parameters": ("bodies.b9.mass",)}, "has no 'bodies.b9'"),
    ({"parameters": ("bodies.b1.mas",)}, "did you mean 'bodies.b1.mass'"),
    ({"parameters": ("gravity",)}, "name one of them, 'gravity.0'"),
    ({"parameters": ("bodies.b1.inertia.0.3",)}, "has no 'bodies.b1.inertia.0.3'"),
    ({"parameters": ("bodies.b1",)}, "is no number"), ({"parameters": "gravity.2"}, "give a tuple"),
    ({"duration": -1.0}, "duration"), ({"source": "lieeuler"}, "name a method too")])
def test_wrong_arguments(arguments, said):
    with pytest.raises(crosscheck.ArgumentError, match=said):
        crosscheck.flow_derivative(arm(), **{"duration": 0.1} | arguments)
