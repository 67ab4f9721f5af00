"""The turns of hinges are part of the state: followed by who makes it, and not guessed from samples."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import crosscheck
from crosscheck import run
from crosscheck.scene.building import scene_from
from crosscheck.scene.coordinates import hinge_angles, histories
from crosscheck.scene.mechanics import energy
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import States

EXACT = 1e-9
"""Series to 1e-15 and runs of order 8 to 1e-12, over 18 rad and 80 J."""
COARSE = 0.02
"""Methods of order two to four at steps of 1 ms, rad."""

FREQUENCY = math.sqrt(0.5 / 0.1)
TIMES = np.arange(7.0)
WOUND = 40.0 / FREQUENCY * np.sin(FREQUENCY * TIMES)

WAYS = [("lieeuler", "rkmk853", None), ("lieeuler", "taylor", None), ("lieeuler", "DAE1H_LSE", None),
        ("mujoco", "RK4", "tree"), ("pinocchio", "RKMK4", "tree"), ("pinocchio", "RKMK4", "maximal"),
        ("exudyn", "GeneralizedAlpha", "tree"), ("exudyn", "GeneralizedAlpha", "maximal"), ("exudyn", "RK44", "tree")]


def wheel(sprung: bool = True, stop: float | None = None, **keys: object) -> Scene:
    """A wheel on a torsion spring that turns by almost three turns, seven outputs in six seconds."""
    axis = [0.0, 0.0, 1.0]
    joint = {"name": "pin", "type": "revolute", "parent": "ground", "child": "wheel", "parent_anchor": [0.0] * 3,
             "child_anchor": [0.0] * 3, "parent_axis": axis, "child_axis": axis, "position": 0.0, "velocity": 40.0}
    joint |= {"stiffness": 0.5} if sprung else {}
    joint |= {} if stop is None else {"limits": {"upper": stop, "stiffness": 5.0}}
    return scene_from({"schema": 3, "name": "wheel", "gravity": [0.0] * 3, "duration": 6.0, "samples": 7,
                       "bodies": [{"name": "wheel", "mass": 1.0, "inertia": np.diag([0.1] * 3).tolist()}],
                       "joints": [joint | keys],
                       "sensors": [{"name": "angle", "type": "joint_position", "joint": "pin"}]}, "made")


def near(value: np.ndarray, wanted: object, tolerance: float = EXACT) -> None:
    assert np.abs(value - np.asarray(wanted)).max() <= tolerance, (value, wanted)


@pytest.mark.parametrize(("engine", "method", "form"), WAYS)
@pytest.mark.parametrize("sprung", [True, False])
def test_every_engine_counts_the_turns_between_its_outputs(engine: str, method: str, form: str | None, sprung: bool
                                                           ) -> None:
    scene = wheel(sprung)
    how = {"rtol": 1e-12} if method == "taylor" else {"step": 1e-3}
    made = run(scene, engine, method, form=form, **how)
    wanted = WOUND if sprung else 40.0 * TIMES
    tolerance = EXACT if method in ("rkmk853", "taylor") else 2.0 if method == "DAE1H_LSE" else COARSE
    near(made.joints["pin"].position, wanted, tolerance)
    near(made.sensors["angle"], wanted, tolerance)
    near(made.energy, 80.0, 40.0 * tolerance)


def test_truth_counts_them_and_other_times_change_nothing() -> None:
    scene = wheel()
    truth = crosscheck.truth(scene).states
    near(histories(scene, truth)["pin"].position, WOUND)
    near(energy(scene, truth), 80.0)
    other = scene.replace(samples=4)
    near(histories(other, crosscheck.truth(other).states)["pin"].position, WOUND[::2])


def test_a_hinge_that_closes_a_loop_is_counted() -> None:
    scene = crosscheck.load_scene("four_bar").replace(samples=3)
    fine = scene.replace(samples=2001)
    coarse, dense = (hinge_angles(each, crosscheck.truth(each).states) for each in (scene, fine))
    assert np.isfinite(coarse).all()
    near(coarse, dense[::1000])


@pytest.mark.parametrize("kind", ["universal", "planar", "cylindrical"])
def test_turns_of_other_joints(kind: str) -> None:
    """Free of forces, with rates that stay: the angle of a plane, of a cylinder, and the first of a cross."""
    first, second = ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]) if kind == "universal" else ([0.0, 0.0, 1.0],) * 2
    k, count = {"universal": (0, 2), "planar": (2, 3), "cylindrical": (0, 2)}[kind]
    rates = np.eye(count)[k] * 30.0
    scene = wheel(False, type=kind, parent_axis=first, child_axis=second, position=[0.0] * count,
                  velocity=rates.tolist()).replace(sensors=())
    for states in (crosscheck.truth(scene).states, run(scene, "lieeuler", "rkmk853", step=1e-3),
                   run(scene, "pinocchio", "RKMK4", step=1e-3), run(scene, "mujoco", "RK4", step=1e-3)):
        near(histories(scene, states)["pin"].position[:, k], 30.0 * TIMES, 1e-6)


def test_a_run_goes_on_from_any_of_its_states() -> None:
    scene = wheel()
    truth = crosscheck.truth(scene).states
    later = restarted(scene, truth, 2, 4.0, 5)
    assert later.joints[0].start == pytest.approx((WOUND[2],), abs=EXACT)
    states = crosscheck.truth(later).states
    near(states.R, truth.R[2:])
    near(energy(later, states), 80.0)
    near(run(later, "lieeuler", "rkmk853", step=1e-3).joints["pin"].position, WOUND[2:])


def test_a_stop_far_around_is_met_where_it_is() -> None:
    """A soft stop at 13 rad: two turns and a bit, with three outputs."""
    scene = wheel(False, 13.0).replace(duration=0.5, samples=3)
    after = 13.0 + 40.0 / math.sqrt(50.0) * math.sin(math.sqrt(50.0) * 0.1)  # .425 s: 13 rad + .1 s
    assert after > 13.0
    truth = crosscheck.truth(scene)
    made = run(scene, "lieeuler", "rkmk853", step=1e-3)
    for position in (histories(scene, truth.states)["pin"].position, made.joints["pin"].position):
        near(position[1], 10.0, 1e-8)
        wanted = 13.0 + 40.0 / math.sqrt(50.0) * math.sin(math.sqrt(50.0) * (0.5 - 13.0 / 40.0))
        near(position[2], wanted, 1e-7)


def test_what_a_source_has_not_counted_is_not_known() -> None:
    scene = wheel()
    truth = crosscheck.truth(scene).states
    bodies = States(truth.t, truth.x, truth.R, truth.v, truth.w)
    assert np.isnan(histories(scene, bodies)["pin"].position[1:]).all()
    assert np.isnan(energy(scene, bodies)[1:]).all()
    fine = scene.replace(samples=601)  # .4 rad apart: these samples tell
    truth = crosscheck.truth(fine).states
    near(histories(fine, States(truth.t, truth.x, truth.R, truth.v, truth.w))["pin"].position[::100], WOUND)


def test_an_engine_of_the_user_may_say_them() -> None:
    class Wound:
        name, methods, adaptive_methods = "wound", ("exact",), ()

        def unsupported(self, scene: Scene, spec: object) -> None:
            return None

        def run(self, scene: Scene, spec: object) -> States:
            q, rate = WOUND, 40.0 * np.cos(FREQUENCY * TIMES)
            R = np.zeros((7, 1, 3, 3))
            R[:, 0, 0, 0] = R[:, 0, 1, 1] = np.cos(q)
            R[:, 0, 1, 0], R[:, 0, 0, 1], R[:, 0, 2, 2] = np.sin(q), -np.sin(q), 1.0
            w = rate[:, None, None] * np.array([0.0, 0.0, 1.0])
            return States(scene.t, np.zeros((7, 1, 3)), R, 0.0 * w, w, hinges=q[:, None])

    made = run(wheel(), Wound(), "exact", step=1e-3)
    near(made.joints["pin"].position, WOUND)
    near(made.energy, 80.0)


@pytest.mark.parametrize("turns", [0, 1, -3])
def test_derivatives_and_starts_beyond_half_a_turn(turns: int) -> None:
    q = 0.7 + 2 * math.pi * turns
    scene = wheel(position=q, velocity=1.0)
    a = crosscheck.truth(scene).states.alpha[0, 0, 2]
    assert a == pytest.approx(-5.0 * q, abs=EXACT)
    flow = crosscheck.flow_derivative(scene, 0.3).matrix
    c, s = math.cos(FREQUENCY * 0.3), math.sin(FREQUENCY * 0.3)
    near(flow, [[c, s / FREQUENCY], [-s * FREQUENCY, c]], 1e-8)
    found = crosscheck.derivatives(scene, state=(np.array([q + 2 * math.pi]), np.array([0.0])))
    near(found.da_dq, [[-5.0]])


def test_angles_far_around_stay_in_the_joint_that_is_replaced() -> None:
    scene = wheel(position=20.0)
    assert scene.joints[0].start == (20.0,)
    softer = scene.replace(joints=(dataclasses.replace(scene.joints[0], stiffness=(0.25,)),))
    assert energy(softer, crosscheck.truth(softer).states)[0] == pytest.approx(80.0 + 0.125 * 400.0, abs=EXACT)


def test_a_recording_may_start_far_around() -> None:
    import pandas as pd

    scene = wheel().replace(duration=2.0, samples=101)
    t = np.linspace(0.2, 2.0, 91)  # from 7.74 rad on
    q = 40.0 / FREQUENCY * np.sin(FREQUENCY * t)
    frame = pd.DataFrame({"t": t, "pin.position": q, "pin.velocity": 40.0 * np.cos(FREQUENCY * t)})
    verdict = crosscheck.judge_recording(scene, frame, start="recorded", tolerance={"joint_position": 1e-6})
    assert verdict.outcome == "pass", str(verdict)
    assert verdict.errors["joint_position"] < 1e-8
