"""Springs and dampers of joints are laws of the coordinate: along any slide, over any turns, at any anchor."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import crosscheck
from crosscheck import run
from crosscheck.references.maximal import Maximal
from crosscheck.references.taylor import Taylor
from crosscheck.scene.building import scene_from
from crosscheck.scene.mechanics import energy
from crosscheck.scene.model import Scene
from crosscheck.scene.sensors import readings

ROUNDING = 1e-10
"""Sums of terms near 40, of series to 1e-15 and runs to 1e-12."""
SECOND = 2e-6
"""Generalised alpha at steps of 1 ms, m."""
FOURTH = 1e-8
"""Methods of order 4 or more at steps of 1 ms, rad/s."""
FIRST = 0.05
"""An Euler method at steps of 1 ms over 20 m, m."""

BODY = {"name": "body", "mass": 2.0, "inertia": np.diag([0.1, 0.1, 0.1]).tolist()}
WAYS = [("lieeuler", "rkmk853", None), ("lieeuler", "taylor", None), ("lieeuler", "DAE1H_LSE", None),
        ("mujoco", "RK4", None), ("pinocchio", "RKMK4", "tree"), ("pinocchio", "RKMK4", "maximal"),
        ("exudyn", "GeneralizedAlpha", "tree"), ("exudyn", "GeneralizedAlpha", "maximal")]


def near(value: np.ndarray, wanted: object, tolerance: float = ROUNDING) -> None:
    assert np.abs(value - np.asarray(wanted)).max() <= tolerance, (value, wanted)


def made(kind: str, axis: tuple[float, float, float], gravity: float = 0.0, anchor: float = 0.0, **keys: object
         ) -> Scene:
    joint = {"name": "joint", "type": kind, "parent": "ground", "child": "body", "parent_anchor": [0.3, -0.2, 0.1],
             "child_anchor": [anchor * part for part in axis], "parent_axis": axis, "child_axis": axis, **keys}
    return scene_from({"schema": 3, "name": kind, "gravity": [0.0, 0.0, gravity], "duration": 1.5, "samples": 4,
                       "bodies": [BODY], "joints": [joint],
                       "sites": [{"name": "cell", "body": "body", "position": [0.0, 0.0, 0.0]}],
                       "sensors": [{"name": "load", "type": "force", "joint": "joint", "site": "cell"}]}, "made")


def falling() -> Scene:
    """A weight that falls by more than 20 m on a soft spring: z = -(m g / k) (1 - cos(sqrt(k / m) t))."""
    return made("prismatic", (0.0, 0.0, 1.0), -9.81, stiffness=0.5).replace(duration=4.0)


def fallen(t: np.ndarray) -> np.ndarray:
    return np.asarray(-2.0 * 9.81 / 0.5 * (1.0 - np.cos(math.sqrt(0.25) * t)))


@pytest.mark.parametrize("formulation", [Taylor, Maximal])
def test_a_slide_may_go_as_far_as_it_likes(formulation: type) -> None:
    scene = falling()
    solved = formulation(scene)
    states = solved.states(solved.run()) if formulation is Taylor else solved.run()
    near(states.x[:, 0, 2] - 0.1, fallen(scene.t))
    near(energy(scene, states), np.full(4, energy(scene, states)[0]))


@pytest.mark.parametrize(("engine", "method", "form"), WAYS)
def test_in_every_engine(engine: str, method: str, form: str | None) -> None:
    scene = falling()
    how = {"rtol": 1e-12} if method == "taylor" else {"step": 1e-3}
    tolerance = SECOND if engine == "exudyn" else FIRST if "DAE" in method else ROUNDING
    near(run(scene, engine, method, form=form, **how).x[:, 0, 2] - 0.1, fallen(scene.t), tolerance)


def test_a_joint_carries_its_spring_and_damper() -> None:
    scene = made("prismatic", (1.0, 0.0, 0.0), -9.81, position=0.1, velocity=0.5, stiffness=40.0, damping=0.6)
    near(readings(scene, crosscheck.truth(scene).states)["load"][0], [-4.3, 0.0, 19.62])
    near(run(scene, "lieeuler", "rkmk4", step=1e-3).sensors["load"][0], [-4.3, 0.0, 19.62])


@pytest.mark.parametrize("engine", ["truth", "pinocchio", "mujoco"])
def test_inverse_dynamics_far_along_and_many_turns_on(engine: str) -> None:
    slide = made("prismatic", (0.0, 0.0, 1.0), -9.81, stiffness=0.5)
    hinge = made("revolute", (0.0, 0.0, 1.0), stiffness=2.0, rest_position=0.5, damping=0.1)
    q, v, still = np.array([[-20.0], [4.0], [15.0]]), np.array([[0.0], [0.3], [-0.2]]), np.zeros((3, 1))
    near(crosscheck.inverse_dynamics(slide, q, still, still, engine=engine), 0.5 * q + 2.0 * 9.81)
    near(crosscheck.inverse_dynamics(hinge, q, v, still, engine=engine), 2.0 * (q - 0.5) + 0.1 * v)


@pytest.mark.parametrize("reference", [None, [math.cos(1.4), 0.0, 0.0, math.sin(1.4)]])
def test_two_spellings_of_a_hinge_spring_are_one(reference: list[float] | None) -> None:
    """The angle of a torsional spring counts from the shortest turn between the axes, here 2.8 rad from the joint's."""
    keys = {"position": 7.5, "velocity": -2.0} | ({} if reference is None else {"reference_attitude": reference})
    of_joint = made("revolute", (0.0, 0.0, 1.0), stiffness=2.0, rest_position=0.5, damping=0.1, **keys)
    data = {"type": "torsional_spring", "joint": "joint", "stiffness": 2.0, "damping": 0.1,
            "rest_angle": 0.5 + (0.0 if reference is None else 2.8)}
    bare = made("revolute", (0.0, 0.0, 1.0), **keys)
    of_force = bare.replace(forces=(dataclasses.replace(of_joint.joints[0].springs[0], parameters={
        key: data[key] for key in ("stiffness", "damping", "rest_angle")}),))
    states = [crosscheck.truth(scene).states for scene in (of_joint, of_force)]
    near(states[0].w, states[1].w)
    near(energy(of_joint, states[0]), energy(of_force, states[1]))
    assert abs(energy(of_joint, states[0])[0] - (0.05 * 4.0 + 49.0)) < 1e-9
    for engine, method, form in WAYS[:1] + WAYS[3:6]:
        near(run(of_joint, engine, method, step=1e-3, form=form).w, states[0].w, FOURTH)


def test_the_spring_of_a_slide_follows_its_anchor() -> None:
    """With another anchor on the child the slide is another one, and so is the pull of the spring."""
    scene = made("prismatic", (1.0, 0.0, 0.0), position=0.2, stiffness=5.0)
    moved = scene.replace(joints=(dataclasses.replace(scene.joints[0], child_anchor=np.array([0.1, 0.0, 0.0])),))
    for formulation in (Taylor, Maximal):
        solved = formulation(moved)
        states = solved.states(solved.run()) if formulation is Taylor else solved.run()
        assert abs(states.a[0, 0, 0] + 5.0 * 0.3 / 2.0) < 1e-12
    assert abs(run(moved, "lieeuler", "rkmk4", step=1e-3).a[0, 0, 0] + 5.0 * 0.3 / 2.0) < 1e-12


def test_a_changed_spring_is_another_scene() -> None:
    scene = made("prismatic", (1.0, 0.0, 0.0), stiffness=5.0)
    assert not scene.forces
    assert len({scene.key, *(scene.replace(joints=(dataclasses.replace(scene.joints[0], **{key: (0.3,)}),)).key
                             for key in ("stiffness", "damping", "rest_position"))}) == 4
