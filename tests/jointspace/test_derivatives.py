"""Derivatives of accelerations: truth against differences of another mechanics, and verdicts on sources."""

from __future__ import annotations

import dataclasses
import functools
import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck import adapters
from crosscheck.cli.app import app
from crosscheck.jointspace.derivatives import WEIGHTS, truth
from crosscheck.jointspace.laws import smooth
from crosscheck.jointspace.motion import JointSpace, of_coordinates, placed, positions
from crosscheck.jointspace.sources import Blocks
from crosscheck.jointspace.verdicts import judge
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import starting
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.starts import started
from crosscheck.scene.states import States
from tests.engines.stepper import Misbuilt
from tests.jointspace.arms import arm

TREES = {"arm": lambda: arm(), "hanging": lambda: hanging(),
         "seven hinges": lambda: arm(7, armature=0.2, stiffness=1.0, seed=3),
         **{name: (lambda name=name: crosscheck.load_scene(name)) for name in (
             "double_pendulum", "universal_pendulum", "cylindrical_pendulum", "heavy_top", "planar_slider",
             "branching_tree")}}


def hanging():
    """An arm at rest in equilibrium, but for a little damping."""
    scene = arm(stiffness=0.0, forces=[])
    for _ in range(30):  # Newton's method for no acceleration
        space = JointSpace(scene)
        a = np.real(space.accelerations(space.bodies(np.zeros(2), np.zeros(2))))
        scene = space.moved(-np.linalg.solve(space.derivative(space.accelerations)[0], a), -space.rates)
    return scene


def accelerations(scene):
    """Of the coordinates at the start, by the index-1 equations."""
    state = scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]
    a, alpha, _ = mechanics.index1(scene, *state)
    return of_coordinates(scene, States(np.zeros(1), *state, a, alpha), True)[0]


@pytest.mark.parametrize("name", TREES)
def test_truth_of_trees_against_differences_of_the_index_1_equations(name):
    (scene, exact), h = judged(TREES[name]), 5e-3
    space = JointSpace(scene)
    assert exact.coordinates == scene.coordinates
    assert exact.error < 1e-10
    for block, part in ((exact.da_dq, 0), (exact.da_dv, 1)):
        for k, row in enumerate(np.eye(space.size)):
            column = sum(sign * weight / h * accelerations(space.moved(*(
                sign * j * h * row if side == part else 0 * row for side in range(2))))
                for j, weight in WEIGHTS for sign in (1, -1))
            np.testing.assert_allclose(block[:, k], column, rtol=0, atol=1e-9 * max(1.0, np.abs(block).max()))
    mass = mass_by_bodies(scene, space)
    np.testing.assert_allclose(exact.da_dtau @ mass, np.eye(space.size), atol=1e-9 * np.linalg.cond(mass))


def mass_by_bodies(scene, space):
    """M by the kinetic energy of unit rates."""
    def energy(v):
        found = starting(placed(scene, positions(scene), v))
        rotors = sum(value * v[space.own[link.body]][k] ** 2 for link in space.links if link.joint is not None
                     for k, value in enumerate(link.joint.armature))
        return float(np.real(np.einsum("n,nk,nk->", scene.masses, found.v[0], found.v[0])
                             + np.einsum("ni,nij,nj->", found.w[0], scene.inertias, found.w[0])) + rotors) / 2

    rows = np.eye(space.size)
    return np.array([[energy(a + b) - energy(a) - energy(b) for b in rows] for a in rows])


@pytest.mark.parametrize("name", ["four_bar", "rolling_disk", "bricard", "driven_slider_crank", "coupled_arm",
                                  "double_pendulum", "chaplygin_sleigh"])
def test_the_generator_keeps_to_the_constraints(name):
    scene = crosscheck.load_scene(name)
    exact = crosscheck.derivatives(scene)
    n, k = scene.n, exact.basis.shape[1]
    assert exact.matrix.shape == (2 * k, 2 * k)
    np.testing.assert_allclose(exact.basis.T @ exact.basis, np.eye(k), atol=1e-13)
    rows = Constraints(scene)
    G = rows.jacobian(scene.x0[None], scene.R0[None])[0][~rows.slips]
    assert np.abs(G @ exact.basis).max() < 1e-12 * np.abs(G).max()
    assert exact.basis.shape[0] == 6 * n
    assert exact.error < 1e-10
    if name in ("four_bar", "bricard", "rolling_disk"):
        assert exact.da_dq is exact.da_dv is exact.da_dtau is None


def test_the_generator_of_a_tree_follows_from_its_blocks():
    scene = arm(3, seed=2)
    space, exact = JointSpace(scene), truth(scene)
    V = space.motions
    # rates of the change of pose, of the shifts in the world: B^T V dv, where B spans what V does
    T = exact.basis.T @ V
    bodies = space.derivative(lambda bodies: np.concatenate([bodies.v, bodies.w], 1).ravel())
    k = space.size
    # d(pose)' = d(velocity), up to the turning axes of bodies; the lower right block maps rates of coordinates
    lower = exact.matrix[k:]
    accelerated = space.derivative(lambda bodies: np.concatenate([bodies.a, bodies.alpha], 1).ravel())
    into = np.block([[T, np.zeros((k, k))], [exact.basis.T @ bodies[0], T]])
    np.testing.assert_allclose(lower @ into, exact.basis.T @ np.concatenate(accelerated, axis=1), atol=1e-10)


def test_a_given_state():
    scene = arm()
    q, v = np.array([0.4, -0.9]), np.array([2.0, 0.5])
    assert np.abs(positions(placed(scene, q, v)) - q).max() < 1e-14
    one = crosscheck.derivatives(scene, state=(q, v))
    other = truth(arm(bodies=[{"name": f"b{k}", "mass": body.mass, "inertia": body.inertia.tolist()}
                              for k, body in enumerate(scene.bodies)],
                      joints=[{"name": joint.name, "type": "revolute", "parent": ["ground", "b0"][k], "child": f"b{k}",
                               "parent_anchor": joint.parent_anchor.tolist(), "parent_axis": [0.0, 1.0, 0.0],
                               "child_anchor": joint.child_anchor.tolist(), "child_axis": [0.0, 1.0, 0.0],
                               "damping": 0.3, "rest_position": 0.1, "position": float(q[k]), "velocity": float(v[k])}
                              for k, joint in enumerate(scene.joints)]))
    np.testing.assert_allclose(one.da_dq, other.da_dq, rtol=1e-12)
    np.testing.assert_allclose(one.da_dv, other.da_dv, rtol=1e-12, atol=1e-13)


SERVO = {"type": "servo", "joint": "j0", "target": 0.9, "proportional": 8.0, "derivative": 1.5, "effort_limit": 50.0}


def with_laws(servo=(), **law):
    """An arm with a servo on its first hinge and a law on its second."""
    given = arm(damping=0.0, forces=[SERVO | dict(servo)])
    return given.replace(joints=(given.joints[0], dataclasses.replace(given.joints[1], **law)))


@pytest.mark.parametrize(("servo", "law", "stiffness", "damping", "force"), [
    ({}, {}, [8.0, 0.0], [1.5, 0.0], [8.0 * 0.6 - 1.5, 0.0]),
    ({}, {"dry_friction": (DryFriction(0.4, 0.4),)}, [8.0, 0.0], [1.5, 0.0], [3.3, 0.4]),
    ({"effort_limit": 2.0}, {}, [0.0, 0.0], [0.0, 0.0], [2.0, 0.0]),
    ({"effort_limit": 2.0, "no_load_speed": 4.0}, {}, [0.0, 0.0], [0.5, 0.0], [1.5, 0.0]),
    ({"period": 0.1}, {}, [0.0, 0.0], [0.0, 0.0], [3.3, 0.0]),
    ({}, {"limits": (Limits(upper=0.4, stiffness=20.0, damping=0.1),)}, [8.0, 20.0], [1.5, 0.1], [3.3, -1.87]),
])
def test_laws_count_as_the_piece_that_acts(servo, law, stiffness, damping, force):
    scene, given = with_laws(servo, **law), crosscheck.derivatives(with_laws(servo, **law))
    plain = arm(damping=0.0, forces=[{"type": "joint_torque", "joint": f"j{k}", "torque": torque}
                                     for k, torque in enumerate(force)])
    exact = truth(plain)
    np.testing.assert_allclose(given.da_dq, exact.da_dq - exact.da_dtau @ np.diag(stiffness), atol=1e-11)
    np.testing.assert_allclose(given.da_dv, exact.da_dv - exact.da_dtau @ np.diag(damping), atol=1e-11)
    assert judge(smooth(scene), "mujoco:differences").right


@pytest.mark.parametrize(("law", "said"), [
    ({"dry_friction": (DryFriction(0.4, 0.4),)}, "at rest with dry friction"),
    ({"limits": (Limits(upper=0.5),)}, "at its limit")])
def test_a_state_at_which_a_law_changes_has_no_derivative(law, said):
    with pytest.raises(crosscheck.Unsupported, match=said):
        crosscheck.derivatives(with_laws(**law), state=([0.3, 0.5], [1.0, 0.0]))


@pytest.mark.parametrize(("scene", "source", "right", "cause"), [
    ("arm", "pinocchio", False, "missing damper: damping of every spring times 0 (da_dv)"),
    ("arm", "mujoco", True, ""), ("arm", "mujoco:transitionFD", True, ""), ("arm", "mujoco:differences", True, ""),
    ("arm", "pinocchio:differences", True, ""), ("arm", "lieeuler", True, ""), ("arm", "exudyn:differences", True, ""),
    ("arm", "exudyn", False, "the change of the mass matrix with position is left out (da_dq)"),
    ("hanging", "exudyn", True, ""), ("seven hinges", "exudyn", False, "change of the mass matrix"),
    ("double_pendulum", "pinocchio", True, ""), ("double_pendulum", "mujoco:inverseFD@1e-4", True, ""),
    ("heavy_top", "pinocchio", True, ""), ("heavy_top", "mujoco", True, ""),
    ("heavy_top", "exudyn:differences", True, ""), ("heavy_top", "mujoco:inverseFD@1e-9", True, ""),
    ("universal_pendulum", "pinocchio", False, "JointModelComposite"), ("universal_pendulum", "mujoco", True, ""),
    ("universal_pendulum", "pinocchio:rnea", False, "not the derivatives of its own accelerations"),
    ("seven hinges", "pinocchio", False, "missing damper: damping of every spring times 0 (da_dv)"),
    ("seven hinges", "mujoco", True, ""),
])
def test_verdicts_on_engines(scene, source, right, cause):
    made, exact = judged(TREES[scene])
    verdict = judge(made, source, exact)
    assert verdict.right == right, verdict
    assert cause in verdict.cause
    assert bool(cause) == bool(verdict.cause)


def test_a_cause_that_leaves_least_is_named():
    """At rest and without its dampers da_dv is 0, which is near all small matrices."""
    made = TREES["arm"]()
    slow = started(made, made.x0, made.R0, 0.0 * made.v0, 0.0 * made.w0)
    light = slow.replace(bodies=tuple(dataclasses.replace(
        each, mass=0.03 * each.mass, inertia=0.03 * each.inertia) for each in slow.bodies))
    assert "missing damper" in judge(light, "pinocchio").cause


@pytest.mark.parametrize(("source", "module"), [
    ("drake:autodiff", "pydrake"), ("mjx:jacfwd", "jax"), ("mjx:jacrev", "jax")])
def test_automatic_derivatives_where_they_are_installed(source, module):
    pytest.importorskip(module)
    scene = arm(3, seed=4).unloaded
    verdict = judge(scene, source)
    assert verdict.right
    assert max(verdict.errors.values()) < 1e-13
    with pytest.raises(crosscheck.Unsupported, match=r"ball|quaternions"):
        judge(balls(), source)


@pytest.mark.parametrize(("scene", "source", "said"), [
    ("heavy_top", "exudyn:linearised", "its ball joint 'tip' has three angles"),
    ("driven_cart", "exudyn:linearised", "a rest angle that moves"),
    ("rolling_disk", "pinocchio:aba", "joint 'rim' is a rolling_disk"),
    ("driven_slider_crank", "pinocchio:constrained", "joint 'motor' has the key drive")])
def test_sources_refuse_what_their_engines_lack(scene, source, said):
    with pytest.raises(crosscheck.Unsupported, match=said):
        judge(crosscheck.load_scene(scene), source)


@pytest.mark.parametrize(("source", "most", "cause"), [
    ("pinocchio:constrained", 1e-13, ""), ("mujoco:transitionFD", 3e-5, ""), ("pinocchio:differences", 1e-9, ""),
    ("lieeuler:differences", 1e-9, ""), ("mujoco:inverseFD", None, "forward differences of soft loops"),
    ("mujoco:inverseFD@1e-9", None, "forward differences of soft loops")])
def test_verdicts_on_a_loop(source, most, cause):
    verdict = judge(crosscheck.load_scene("four_bar"), source)
    assert verdict.right == (not cause)
    assert cause in verdict.cause
    assert most is None or verdict.errors["tangent"] < most


def test_constrained_derivatives_where_rows_depend_on_each_other():
    verdict = judge(crosscheck.load_scene("bricard"), "pinocchio:constrained")
    assert verdict.right, verdict
    assert verdict.bound < 1e-8


@pytest.mark.parametrize(("name", "source", "cause"), [
    ("rolling_disk", "lieeuler:differences", ""), ("chaplygin_sleigh", "lieeuler:differences", ""),
    ("bicycle", "lieeuler:differences", ""), ("bicycle", "exudyn:differences", ""),
    ("rolling_disk", "exudyn:differences", "its accelerations are wrong themselves, by 0.12 of the largest")])
def test_verdicts_where_something_rolls(name, source, cause):
    """Exudyn starts a rolling disk with accelerations that lack gamma; on the straight bicycle that is zero."""
    verdict = judge(crosscheck.load_scene(name), source)
    assert (verdict.right, verdict.cause) == (not cause, cause), verdict
    assert verdict.right == (verdict.errors["tangent"] < 3e-6)


def test_noise_that_is_odd_about_the_start_is_seen():
    """Second differences about the start are blind to it, and so are directions one by one."""
    plain = arm(forces=[], damping=0.0)

    def odd(scene, raw):
        turned = positions(scene)[1] - positions(plain)[1]
        raw.states.alpha[:, :, 1] += 1e-6 * np.sin(3e7 * turned)
        return raw

    engine = Misbuilt(adapters.get("lieeuler"), report=(odd,))
    engine.name = "own"
    verdict = judge(plain, engine)
    assert verdict.right, verdict
    assert verdict.bound > 1e-4


@pytest.mark.parametrize(("change", "cause"), [
    (lambda scene: scene, ""),
    (lambda scene: scene.replace(gravity=2 * scene.gravity), "gravity counts twice"),
    (lambda scene: scene.replace(gravity=0 * scene.gravity),
     "gravity size: gravity (0, 0, 0) m/s^2 instead of (0, 0, -9.81)")])
def test_wrong_sources_on_a_loop_are_named(change, cause):
    engine = Misbuilt(adapters.get("lieeuler"), (change,))
    engine.name = "own"
    verdict = judge(crosscheck.load_scene("four_bar"), engine)
    assert (verdict.right, verdict.cause) == (not cause, cause), verdict


@pytest.mark.parametrize("name", ["arm", "double_pendulum", "universal_pendulum"])
def test_inverse_dynamics_of_pinocchio_gives_what_its_accelerations_give(name):
    scene = arm(3, seed=4, damping=0.0) if name == "arm" else crosscheck.load_scene(name)
    one, other = (crosscheck.derivatives(scene, f"pinocchio:{way}") for way in ("aba", "rnea"))
    for block, values in one.blocks.items():
        np.testing.assert_allclose(other.blocks[block], values, rtol=0, atol=1e-12 * np.abs(values).max())
    with pytest.raises(crosscheck.Unsupported, match="closed loops"):
        crosscheck.derivatives(scene, "pinocchio:constrained")


def test_mujocos_differences_have_the_error_of_their_order():
    scene, exact = arm(), truth(arm())
    errors = [judge(scene, f"mujoco:inverseFD@{eps}", exact).errors["da_dq"] for eps in (1e-2, 1e-3, 1e-4, 1e-5)]
    np.testing.assert_allclose(np.diff(np.log10(errors)), -1.0, atol=0.05)
    assert judge(scene, "mujoco:inverseFD@1e-9", exact).errors["da_dq"] > errors[-1] / 100  # rounding


class Own:
    """An engine whose derivatives are those of the truth, changed."""

    name, methods = "own", ("none",)

    def __init__(self, change):
        self.change = change

    def unsupported(self, scene, spec):
        return "it only differentiates"

    def run(self, scene, spec):
        raise NotImplementedError

    def derivatives(self, scene, state):
        exact = truth(placed(scene, *state))
        return self.change({"da_dq": exact.da_dq, "da_dv": exact.da_dv, "da_dtau": exact.da_dtau}, scene)


@functools.cache
def judged(make):
    """A scene and its truth, for all sources that are judged on it."""
    scene = make()
    return scene, truth(scene)


PARTS = {"armature": 0.1, "stiffness": 2.0}


def joints():
    """Three hinges with rotors, springs and dampers."""
    return arm(3, seed=4, **PARTS)


def balls():
    return crosscheck.load_scene("double_pendulum")


def of_scene(**parts):
    """The derivatives of a scene in which something is otherwise."""
    def change(blocks, scene):
        return dict(truth(arm(3, seed=4, **PARTS | parts)).blocks)
    return change


def altered(make):
    """The derivatives of what `make` makes of the scene."""
    return lambda blocks, scene: dict(truth(make(scene)).blocks)


def one_joint(scene, k, **changes):
    return scene.replace(joints=tuple(dataclasses.replace(joint, **changes) if j == k else joint
                                      for j, joint in enumerate(scene.joints)))


def without_damping_of(scene, name):
    return scene.replace(joints=tuple(dataclasses.replace(joint, damping=()) if joint.name == name else joint
                                      for joint in scene.joints))


def each(function, *names):
    """The named blocks, all by default, changed by a function of a matrix."""
    return lambda blocks, scene: blocks | {name: function(blocks[name]) for name in names or blocks}


def by_differences(step, central=False):
    """Differences of the accelerations, forward or central."""
    def change(blocks, scene):
        space = JointSpace(scene)

        def accelerated(q, v):
            return np.real(space.accelerations(space.bodies(q, space.speeds + v)))

        zero, both = np.zeros(space.size), []
        for part in range(2):
            columns = []
            for row in np.eye(space.size):
                ends = [accelerated(*(h * row if side == part else zero for side in range(2)))
                        for h in (step, -step if central else 0.0)]
                columns.append((ends[0] - ends[1]) / (step * (1 + central)))
            both.append(np.array(columns).T)
        return blocks | {"da_dq": both[0], "da_dv": both[1]}
    return change


def in_parent_axes(left, right):
    def change(blocks, scene):
        turns = np.zeros((6, 6))
        R = scene.R0
        turns[:3, :3], turns[3:, 3:] = R[0], R[0].T @ R[1]  # the attitude of each child in its parent
        return {name: (turns if left else np.eye(6)) @ values @ (turns.T if right else np.eye(6))
                for name, values in blocks.items()}
    return change


FLIP, SWAP = np.diag([1.0, -1.0, 1.0]), np.eye(3)[[2, 1, 0]]
WRONG = {
    "damping": (joints, of_scene(damping=0.0), "missing damper: damping of every spring times 0"),
    "damping of one": (joints, altered(lambda s: without_damping_of(s, "j1")),
                       "missing damper: joint 'j1' (torsional_spring): damping 0"),
    "armature": (joints, of_scene(armature=0.0), "missing armature: armature of all joints"),
    "armature of one": (joints, altered(lambda s: one_joint(s, 2, armature=())),
                        "missing armature: armature of joint 'j2' 0"),
    "springs": (joints, of_scene(stiffness=0.0), "missing spring: stiffness of every spring times 0"),
    "torques": (joints, altered(lambda s: s.replace(forces=tuple(
        force for force in s.forces if force.type == "torsional_spring"))), "load: all constant loads times 0"),
    "gravity": (joints, of_scene(gravity=[0.0] * 3), "gravity size: gravity (0, 0, 0) m/s^2"),
    "gravity's sign": (joints, of_scene(gravity=[0.0, 0.0, 9.81]), "gravity sign: gravity (0, 0, 9.81) m/s^2"),
    "gravity twice": (joints, of_scene(gravity=[0.0, 0.0, -19.62]), "gravity counts twice"),
    "at rest": (joints, altered(lambda s: s.replace(bodies=tuple(dataclasses.replace(
        body, velocity=np.zeros(3), angular_velocity=np.zeros(3)) for body in s.bodies))), "rates are left out"),
    "at zero": (joints, altered(lambda s: placed(s, np.zeros(3), JointSpace(s).rates)), "at zero coordinates"),
    "sign": (joints, each(np.negative, "da_dq"), "sign is reversed (da_dq)"),
    "transposed": (joints, each(np.transpose, "da_dv"), "rows and columns are exchanged (da_dv)"),
    "upper": (joints, each(np.triu, "da_dtau"), "lower triangle is left out (da_dtau)"),
    "lower": (joints, each(np.tril, "da_dtau"), "upper triangle is left out (da_dtau)"),
    "symmetric": (joints, each(lambda values: (values + values.T) / 2, "da_dq"), "only the symmetric part"),
    "order": (joints, each(lambda values: values[::-1, ::-1]), "order of the coordinates"),
    "swapped": (lambda: arm(4, seed=5), each(lambda values: values[np.ix_([1, 0, 2, 3], [1, 0, 2, 3])]),
                "coordinates 'j0' and 'j1' are exchanged"),
    "one sign": (joints, each(lambda values: FLIP @ values @ FLIP), "coordinate 'j1' has the other sign"),
    "twice": (joints, each(lambda values: 2 * values, "da_dv"), "2 times as large (da_dv)"),
    "degrees": (joints, each(lambda values: np.pi / 180 * values, "da_dq"), "0.01745329252 times"),
    "inverse": (joints, lambda b, _: b | {"da_dq": -np.linalg.solve(b["da_dtau"], b["da_dq"])}, "inverse dynamics"),
    "mass": (joints, each(np.linalg.inv, "da_dtau"), "mass matrix, not its inverse"),
    "exchanged": (joints, lambda b, _: b | {"da_dq": b["da_dv"], "da_dv": b["da_dq"]}, "da_dq and da_dv are exchanged"),
    "step too large": (joints, by_differences(1e-4), "forward differences with a step of 1.0e-04, which is too large"),
    "central, too large": (joints, by_differences(1e-2, True), "central differences with a step of 1.0e-02"),
    "step too small": (joints, by_differences(1e-12), "a step of 1e-12, which leaves nothing but rounding"),
    "parent's axes": (balls, in_parent_axes(True, True), "small turns of balls are taken in the parent's axes"),
    "rows in the parent's axes": (balls, in_parent_axes(True, False), "rows of balls are in the parent's axes"),
    "columns by the parent's": (balls, in_parent_axes(False, True), "columns of balls are by turns in the parent's"),
    "quaternions": (balls, each(lambda values: 2 * values, "da_dq"), "vector part of the balls' quaternions"),
    "noise": (joints, lambda b, _: b | {"da_dq": b["da_dq"] + np.arange(9).reshape(3, 3)}, ""),
    "one entry": (joints, each(lambda values: values + np.outer([0, 0, 1], [1e-6, 0, 0]), "da_dv"), ""),
    "a little": (joints, each(lambda values: values * (1 + 1e-8), "da_dq"), "1.00000001 times"),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_wrong_sources_do_not_pass_and_are_named(mistake):
    make, change, cause = WRONG[mistake]
    scene, exact = judged(make)
    verdict = judge(scene, Own(change), exact)
    assert not verdict.right
    assert cause in verdict.cause, verdict
    assert bool(cause) == bool(verdict.cause), verdict


RIGHT = {
    "exact": (joints, lambda b, _: b),
    "two blocks": (joints, lambda b, _: {key: b[key] for key in ("da_dq", "da_dv")}),
    "lists with rounding": (joints, lambda b, _: {key: (value * (1 + 1e-15)).tolist() for key, value in b.items()}),
    "a symmetric matrix, transposed": (joints, each(np.transpose, "da_dtau")),
    "single terms in another order": (joints, each(lambda values: (values + 3.0) - 3.0)),
    "no dampers to leave out": (lambda: arm(2, damping=0.0), altered(lambda s: without_damping_of(s, "j1"))),
    "no gravity to leave out": (lambda: arm(gravity=[0.0] * 3), altered(lambda s: s.replace(gravity=np.zeros(3)))),
    "differences that say so": (joints, lambda b, s: by_differences(1e-6)(b, s) | {"order": 1, "eps": 1e-6}),
    "central ones that say so": (joints, lambda b, s: by_differences(1e-4, True)(b, s) | {"order": 2, "eps": 1e-4}),
    "balls": (balls, lambda b, _: b),
    **{name: (lambda name=name: crosscheck.load_scene(name), lambda b, _: b) for name in (
        "heavy_top", "universal_pendulum", "cylindrical_pendulum", "geared_arm")},
    "a transposed inverse of rotors": (lambda: arm(3, seed=4, armature=5.0), each(np.transpose, "da_dtau")),
}


@pytest.mark.parametrize("source", RIGHT)
def test_right_sources_are_not_accused(source):
    make, change = RIGHT[source]
    scene, exact = judged(make)
    verdict = judge(scene, Own(change), exact)
    assert verdict.right, verdict


@pytest.mark.parametrize(("call", "kind", "said"), [
    (lambda: crosscheck.derivatives(arm(), "pinochio"), crosscheck.ArgumentError, "pinocchio"),
    (lambda: crosscheck.derivatives(arm(), "mujoco:inverse"), crosscheck.ArgumentError, "way of mujoco"),
    (lambda: crosscheck.derivatives(arm(), "mujoco:inverseFD@fine"), crosscheck.ArgumentError, "between 0 and 1"),
    (lambda: crosscheck.derivatives(arm(), state=([0.0], [0.0])), crosscheck.ArgumentError, "j0, j1"),
    (lambda: crosscheck.derivatives("four_bar", "mujoco"), crosscheck.Unsupported, "closes a loop"),
    (lambda: crosscheck.derivatives("rod_pendulum"), crosscheck.Unsupported, "no joint coordinates"),
    (lambda: crosscheck.derivatives(arm(), Own(lambda *_: {"da_dq": np.eye(2)})), crosscheck.EngineError, "da_dv"),
    (lambda: crosscheck.derivatives(arm(), Own(lambda *_: {"da_dq": np.eye(3), "da_dv": np.eye(2)})),
     crosscheck.EngineError, "shape"),
])
def test_wrong_arguments(call, kind, said):
    with pytest.raises(kind, match=re.escape(said)):
        call()


def test_blocks_claim_what_they_are():
    assert Blocks(np.eye(2), np.eye(2), None).order is None


def test_the_command_finds_pinocchios_damping_and_mujocos_curve():
    answer = CliRunner().invoke(app, ["linearise", "hinge_pendulum", "--source", "mujoco", "--json"])
    assert answer.exit_code == 0, answer.output
    assert json.loads(answer.output)["verdicts"][0]["right"]
    answer = CliRunner().invoke(app, ["linearise", "branching_tree"])
    assert answer.exit_code == 1
    assert "✗ pinocchio:aba" in answer.output
    assert "missing damper: forces[0] (torsional_spring): damping 0 instead of 1 (da_dv)" in answer.output
    assert re.search(r"of MuJoCo's steps 1e-0[678] is the best", answer.output)


def test_a_model_file_is_linearised(tmp_path):
    file = tmp_path / "arm.xml"
    crosscheck.export_model(arm(2, stiffness=0.0, forces=[]), file)
    answer = CliRunner().invoke(app, ["linearise", str(file), "--source", "pinocchio:aba", "--source",
                                      "mujoco:inverseFD"])
    assert answer.exit_code == 1, answer.output
    assert "✗ pinocchio:aba" in answer.output
    assert "missing damper: damping of every spring times 0" in answer.output
    assert "✓ mujoco:inverseFD" in answer.output


@pytest.mark.parametrize(("scene", "name"), [("hinge_pendulum", "da_dq"), ("four_bar", "tangent")])
def test_the_page_of_derivatives(tmp_path, scene, name):
    sources = ("pinocchio:differences", *(f"mujoco:inverseFD@1e-{k}" for k in (4, 5, 6)))
    answer = CliRunner().invoke(app, ["linearise", scene, "--out", str(tmp_path), *(
        word for source in sources for word in ("--source", source))])
    assert answer.exit_code == (scene == "four_bar"), answer.output
    text = (tmp_path / "index.html").read_text("utf-8")
    told = json.loads(text.partition('id="found">')[2].partition("</script>")[0])
    assert told["rows"][0]["source"] == sources[0]
    assert all(row["cost"] > 0 for row in told["rows"])
    assert [row["eps"] for row in told["curve"]] == [1e-4, 1e-5, 1e-6]
    assert all(name in row["errors"] for row in told["rows"])
    assert ("soft loops" in text) == (scene == "four_bar")
