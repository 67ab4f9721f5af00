"""Every joint type, force and kind of loop: both formulations agree."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crosscheck.references import compute, taylor
from crosscheck.references.maximal import Maximal
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import GROUND, Force, Joint
from tests.scene_making import JOINT_TYPES, closed, drawn, make_scene, random_body, random_joint

DURATION = {"duration": 0.3, "samples": 4}


def loads(joint=None):
    """Springs with dampers, between bodies and to the ground, loads in both frames, and torsion in a joint."""
    forces = [
        Force("linear_spring", GROUND, 1, None, {"parent_point": (0.5, -1.0, 2.0), "child_point": (0.3, 0.1, 0.2),
                                                 "stiffness": 8.0, "free_length": 0.4, "damping": 0.5}),
        Force("linear_spring", 1, 0, None, {"parent_point": (1.5, 1.0, 2.0), "child_point": (-0.3, 2.1, 0.2),
                                            "stiffness": 5.0, "free_length": 0.7, "damping": 0.3}),
        Force("constant_force", None, 1, None, {"child_point": (0.1, 0.2, 0.3), "frame": "body",
                                                "force": (1.0, -0.5, 0.7)}),
        Force("constant_force", None, 0, None, {"child_point": (-0.1, 0.2, 0.3), "frame": "world",
                                                "force": (0.4, 1.5, 0.7)}),
        Force("constant_torque", None, 0, None, {"frame": "world", "torque": (0.3, 0.5, -0.6)}),
        Force("constant_torque", None, 1, None, {"frame": "body", "torque": (-0.3, 0.2, 0.6)}),
    ]
    if joint is not None:
        forces.append(Force("torsional_spring", None, None, joint, {"stiffness": 3.0, "rest_angle": 0.4,
                                                                    "damping": 0.2}))
    return forces


def aligned(rng, bodies, joint):
    """The bodies with the outer one turned so that the joint's axes coincide; opposite axes would close it as well."""
    if joint.child_axis is None or joint.type == "universal":
        return bodies
    frames = [Rotation.from_quat(body.attitude[[1, 2, 3, 0]]) for body in bodies]
    turn = Rotation.align_vectors(joint.parent_axis[None], joint.child_axis[None])[0]
    turn = Rotation.from_rotvec(rng.uniform(-3, 3) * joint.parent_axis) * turn
    attitude = (frames[joint.parent] * turn).as_quat()[[3, 0, 1, 2]]
    return [dataclasses.replace(body, attitude=attitude) if k == joint.child else body for k, body in enumerate(bodies)]


def joined(kind, seed, parent=0, child=1, **changes):
    """A body on a ball joint of the ground and a second one joined to it, both ways round, under all loads."""
    rng = np.random.default_rng(seed)
    bodies = [random_body(rng, "first"), random_body(rng, "second")]
    joints = [random_joint(rng, "spherical", GROUND, 0, "base"), random_joint(rng, kind, parent, child, "joint")]
    forces = loads("joint" if kind in ("revolute", "cylindrical") else None)
    return closed(make_scene(aligned(rng, bodies, joints[-1]), joints, forces, **(DURATION | changes)))


def looped(kind, seed):
    """Two bodies on ball joints of the ground, and a joint of the given type between them: a closed loop."""
    rng = np.random.default_rng(seed)
    bodies = [random_body(rng, "first"), random_body(rng, "second")]
    joints = [Joint("left", "spherical", GROUND, 0, (0.0, 0.0, 0.0), (0.0, 0.5, 0.8)),
              Joint("right", "spherical", GROUND, 1, (1.2, 0.3, 0.0), (0.2, 0.0, 0.9)),
              random_joint(rng, kind, 0, 1, "joint")]
    forces = loads("joint" if kind in ("revolute", "cylindrical") else None)
    return closed(make_scene(aligned(rng, bodies, joints[-1]), joints, forces, **DURATION))


def agree(scene):
    """Run both formulations up to the comparison of `compute`, which raises where they disagree."""
    reference = compute(scene)
    assert 0 < reference.disagreement <= reference.allowed  # formulations that agree to the last bit are the same
    return reference


@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_a_run_of_the_second_formulation_is_the_series(kind):
    scene = joined(kind, 55, duration=0.3)
    series = taylor.Taylor(scene)
    found, other = Maximal(scene).run(), series.states(series.run())
    rate = max(np.abs(other.w).max(), 1.0)  # velocities carry it once, accelerations twice
    for name, allowed in (("x", 1e-12), ("R", 1e-12), ("v", 1e-11 * rate), ("w", 1e-11 * rate),
                          ("a", 1e-10 * rate**2), ("alpha", 1e-10 * rate**2)):
        np.testing.assert_allclose(getattr(found, name), getattr(other, name), rtol=0, atol=allowed, err_msg=name)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)], ids=["outward", "inward"])
@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_joint_in_a_tree(kind, order):
    scene = joined(kind, 10 + JOINT_TYPES.index(kind), *order)
    # minimal coordinates keep the joints closed at rounding level; (14.2) of docs/theory.md asks no more of a position
    assert max(abs(value) for value in closing_error(scene, agree(scene))) < 1e-12


@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_joint_on_the_ground(kind):
    rng = np.random.default_rng(50 + JOINT_TYPES.index(kind))
    scene = drawn(lambda: make_scene([random_body(rng, "body")], [random_joint(rng, kind, GROUND, 0)], **DURATION))
    if kind == "fixed":  # nothing to disagree on
        assert compute(scene).disagreement <= 1e-12
    else:
        agree(scene)


@pytest.mark.parametrize("kind", [kind for kind in JOINT_TYPES if kind not in ("revolute", "prismatic", "fixed")])
def test_joint_that_closes_a_loop(kind):
    agree(looped(kind, 30 + JOINT_TYPES.index(kind)))


def closing_error(scene, reference):
    """Phi at all samples by the common measure, which neither formulation uses."""
    from crosscheck.scene.constraints import Constraints

    return Constraints(scene).position(reference.states.x, reference.states.R).ravel()


@pytest.mark.parametrize("name", ["four_bar", "slider_crank", "bricard", "parallelogram"])
def test_loops_of_the_library(name):
    scene = load_scene(name)
    scene = scene.replace(duration=min(scene.duration, 1.5), samples=16)
    reference = agree(scene)
    assert reference.horizon == scene.duration
    # rows are kept closed by accelerations alone: round-off of thousands of steps, not of one
    assert max(abs(value) for value in closing_error(scene, reference)) < 1e-12


def test_double_four_bar_reaches_the_published_point():
    """IFToMM library A02: B0 at t = 10 s, printed with ten and eleven decimals."""
    scene = load_scene("double_four_bar")
    integrator = taylor.Taylor(scene)
    states = integrator.states(integrator.run())
    end = states.x[-1, 0] + states.R[-1, 0] @ [0.0, 0.5, 0.0]
    np.testing.assert_allclose(end[:2], [.32845811154, .94451853818], rtol=0, atol=1e-11)


def test_torsion_follows_full_turns():
    """A wheel thrown against a weak spring turns several times; the angle that counts is not the wrapped one."""
    rng = np.random.default_rng(3)
    body = dataclasses.replace(random_body(rng, "wheel"), attitude=np.array([1.0, 0, 0, 0]))
    joint = Joint("axle", "revolute", GROUND, 0, (0, 0, 0), (0, 0, 0), (0, 0, 1.0), (0, 0, 1.0))
    spring = Force("torsional_spring", None, None, "axle", {"stiffness": 0.05, "rest_angle": 0.3, "damping": 0.01})
    scene = closed(make_scene([body], [joint], [spring], **DURATION))
    wheel = scene.bodies[0]
    inertia, rate, stiffness, damping = wheel.inertia[2, 2], 15.0, 0.05, 0.01
    scene = scene.replace(duration=3.0, bodies=(type(wheel)(
        wheel.name, wheel.mass, wheel.inertia, [1, 0, 0, 0], [0, 0, rate], [0, 0, 0], [0, 0, 0]),))
    states = agree(scene).states
    decay = damping / (2 * inertia)
    swing = np.sqrt(stiffness / inertia - decay**2)
    t, start = scene.t, -0.3
    angle = 0.3 + np.exp(-decay * t) * (start * np.cos(swing * t) + (rate + decay * start) / swing * np.sin(swing * t))
    assert np.max(angle) > 4 * np.pi
    exact = np.column_stack([np.cos(angle), np.sin(angle)])
    # (14.2) of docs/theory.md, with the turns of order ten that the angle makes
    np.testing.assert_allclose(states.R[:, 0, :2, 0], exact, rtol=0, atol=1e-11)
