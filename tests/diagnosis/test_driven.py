"""`explain` on scenes that depend on time: a drive of wrong size, sign, unit, phase or delay, and one that is right."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.diagnosis import altered, fit, of_run
from crosscheck.references.maximal import Maximal
from crosscheck.scene import mechanics
from crosscheck.scene.alterations import alterations
from crosscheck.scene.altered import Accelerations, Points, of_scene
from crosscheck.scene.file import load_scene
from crosscheck.scene.functions import TimeFunction

MISTAKES = {
    "amplitude of a drive": lambda f: f.times(1.1),
    "sign of a drive": lambda f: f.times(-1.0),
    "unit of a drive": lambda f: f.times(np.pi / 180),
    "missing drive": lambda f: f.times(0.0),
    "delay of a drive": lambda f: f.delayed(0.02),
    "phase of a drive": lambda f: dataclasses.replace(f, terms=tuple((a, w, p + 0.2) for a, w, p in f.terms)),
}


def with_motor(scene, change):
    """The scene with the function of its first force altered."""
    motor = scene.forces[0]
    parameters = {key: change(value) if value in motor.functions else value for key, value in motor.parameters.items()}
    return scene.replace(forces=(dataclasses.replace(motor, parameters=parameters), *scene.forces[1:]))


def at(scene, states):
    """What `explain` sees of states."""
    rates = np.concatenate([states.a, states.alpha], axis=2)
    angles = mechanics.torsion_angles(scene, states)
    return Points(states.x, states.R, states.v, states.w, rates, angles, states.t)


@pytest.mark.parametrize("name", ["driven_double_pendulum", "driven_cart", "driven_slider_crank"])
def test_unaltered_accelerations_are_those_of_the_motion(name):
    scene = load_scene(name).replace(duration=0.4, samples=5)
    points = at(scene, Maximal(scene).run())
    found = Accelerations(points)(of_scene(scene))
    assert np.abs(found - points.rates).max() < 1e-10 * np.abs(points.rates).max()


def test_a_restart_goes_on_at_its_own_time():
    scene = load_scene("driven_cart").replace(duration=0.8, samples=5)
    states = Maximal(scene).run()
    later = of_run.restarted(scene, states, 2, 0.4, 3)
    np.testing.assert_allclose(Maximal(later).run().x, states.x[2:], rtol=0, atol=1e-11)
    free = scene.replace(joints=scene.joints, forces=scene.forces, duration=0.4, samples=3)
    predicted = altered.predict(of_scene(free), free.t)
    np.testing.assert_allclose(predicted.x, states.x[:3], rtol=0, atol=1e-10)


def test_a_restart_keeps_the_turns_that_a_spring_is_wound_by():
    scene = load_scene("torsion_wheel").replace(duration=0.9, samples=10)  # 9 rad
    states = Maximal(scene).run()
    later = of_run.restarted(scene, states, 6, 0.3, 4)
    np.testing.assert_allclose(Maximal(later).run().x, states.x[6:], rtol=0, atol=1e-11)
    moving = scene.forces[0].parameters | {"rest_angle": TimeFunction(pieces=((0.4, 0.1),))}
    timed = scene.replace(forces=(dataclasses.replace(scene.forces[0], parameters=moving),))
    states = Maximal(timed).run()
    np.testing.assert_allclose(Maximal(of_run.restarted(timed, states, 6, 0.3, 4)).run().x, states.x[6:], rtol=0,
                               atol=1e-11)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_wrong_drive_is_told_by_its_accelerations(name):
    scene = load_scene("driven_double_pendulum").replace(duration=0.8, samples=17)
    wrong = with_motor(scene, MISTAKES[name])
    points = at(wrong, Maximal(wrong).run())
    points.rates += 1e-7 * np.random.default_rng(0).uniform(-1, 1, points.rates.shape)
    data = fit.Data([fit.Copy(of_scene(scene), Accelerations(points), 1e-7, np.ones(6))])
    kinds = ("drive", "drive delay", "drive phase", "load", "gravity")
    found, _ = fit.search(data, [each for each in alterations(scene) if each.cause in kinds])
    assert [each.names for each in found] == [(name,)]


@pytest.mark.parametrize(("damped", "words"), [((1,), "at joint 'elbow'"), ((0, 1), "at every joint")])
def test_a_damper_of_one_joint_is_not_that_of_every_joint(damped, words):
    scene = load_scene("driven_double_pendulum").replace(duration=0.8, samples=17)
    wrong = scene.replace(joints=tuple(dataclasses.replace(joint, damping=(0.2,)) if k in damped else joint
                                       for k, joint in enumerate(scene.joints)))
    points = at(scene, Maximal(scene).run())
    points.angles = {joint.name: np.zeros(17) for joint in scene.joints}  # of dampers without stiffness
    points.rates = Accelerations(points)(of_scene(wrong))
    data = fit.Data([fit.Copy(of_scene(scene), Accelerations(points), 1e-7, np.ones(6))])
    found, _ = fit.search(data, [each for each in alterations(scene) if each.cause == "extra damping"])
    assert [each.names for each in found] == [("extra damping",)]
    assert words in found[0].words
    assert "0.2" in found[0].words


class Wrong:
    """lieeuler's methods on another scene than they are given."""

    elements = ("joint_torque", "function")

    def __init__(self, change):
        self._change, self._engine = change, adapters.get("lieeuler")

    def __getattr__(self, name):
        return getattr(self._engine, name)

    def run(self, scene, spec):
        return self._engine.run(self._change(scene), spec)


@pytest.mark.parametrize("name", [None, *MISTAKES])
def test_explain_names_a_wrong_drive_and_nothing_where_there_is_none(name):
    scene = load_scene("driven_double_pendulum")
    engine = Wrong(lambda given: given if name is None else with_motor(given, MISTAKES[name]))
    found = crosscheck.explain(scene, engine, method="rattle4")
    assert [cause.name for cause in found.causes] == ([] if name is None else [name])
