"""Derivatives of accelerations: truth against differences of another mechanics, and verdicts on sources."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.jointspace.derivatives import WEIGHTS, truth
from crosscheck.jointspace.motion import JointSpace, placed, positions
from crosscheck.jointspace.sources import Blocks, coordinate_accelerations
from crosscheck.jointspace.verdicts import judge
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.states import States
from tests.jointspace.arms import arm

TREES = {"arm": lambda: arm(), "seven hinges": lambda: arm(7, armature=0.2, stiffness=1.0, seed=3),
         **{name: (lambda name=name: crosscheck.load_scene(name)) for name in (
             "double_pendulum", "universal_pendulum", "cylindrical_pendulum", "heavy_top", "planar_slider",
             "branching_tree")}}


def accelerations(scene):
    """Of the coordinates at the start, by the index-1 equations."""
    state = scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]
    a, alpha, _ = mechanics.index1(scene, *state)
    return coordinate_accelerations(scene, States(np.zeros(1), *state, a, alpha))


@pytest.mark.parametrize("name", TREES)
def test_truth_of_trees_against_differences_of_the_index_1_equations(name):
    scene = TREES[name]()
    space, exact, h = JointSpace(scene), truth(scene), 5e-3
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
        found = space.bodies(np.zeros(space.size), v)
        rotors = sum(value * v[space.own[link.body]][k] ** 2 for link in space.links if link.joint is not None
                     for k, value in enumerate(link.joint.armature))
        return float(np.real(np.einsum("n,nk,nk->", scene.masses, found.v, found.v)
                             + np.einsum("ni,nij,nj->", found.w, scene.inertias, found.w)) + rotors) / 2

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
    bodies = space.derivative(lambda q, v: np.concatenate([space.bodies(q, v).v, space.bodies(q, v).w], 1).ravel())
    k = space.size
    # d(pose)' = d(velocity), up to the turning axes of bodies; the lower right block maps rates of coordinates
    lower = exact.matrix[k:]
    accelerated = space.derivative(lambda q, v: np.concatenate([space.bodies(q, v).a, space.bodies(q, v).alpha],
                                                               1).ravel())
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


@pytest.mark.parametrize(("scene", "source", "right", "cause"), [
    ("arm", "pinocchio", False, "the damping of joints is left out (da_dv)"),
    ("arm", "mujoco", True, ""), ("arm", "mujoco:transitionFD", True, ""), ("arm", "mujoco:differences", True, ""),
    ("arm", "pinocchio:differences", True, ""), ("arm", "lieeuler", True, ""), ("arm", "exudyn", True, ""),
    ("double_pendulum", "pinocchio", True, ""), ("double_pendulum", "mujoco:inverseFD@1e-4", True, ""),
    ("heavy_top", "pinocchio", True, ""), ("heavy_top", "mujoco", True, ""),
    ("universal_pendulum", "pinocchio", False, "JointModelComposite"), ("universal_pendulum", "mujoco", True, ""),
    ("seven hinges", "pinocchio", False, "the damping of joints is left out (da_dv)"),
    ("seven hinges", "mujoco", True, ""),
])
def test_verdicts_on_engines(scene, source, right, cause):
    verdict = judge(TREES[scene](), source)
    assert verdict.right == right, verdict
    assert cause in verdict.cause
    assert bool(cause) == bool(verdict.cause)


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


def without(**parts):
    def change(blocks, scene):
        altered = truth(arm(3, seed=4, **parts))
        return {"da_dq": altered.da_dq, "da_dv": altered.da_dv, "da_dtau": altered.da_dtau}
    return change


WRONG = {
    "damping": (without(armature=0.1, stiffness=2.0, damping=0.0), "damping of joints is left out"),
    "armature": (without(stiffness=2.0), "armature is left out"),
    "springs": (without(armature=0.1), "springs of joints are left out"),
    "gravity": (without(armature=0.1, stiffness=2.0, gravity=[0.0] * 3), "gravity is left out"),
    "gravity's sign": (without(armature=0.1, stiffness=2.0, gravity=[0.0, 0.0, 9.81]), "gravity has the wrong sign"),
    "sign": (lambda b, _: b | {"da_dq": -b["da_dq"]}, "sign is reversed (da_dq)"),
    "transposed": (lambda b, _: b | {"da_dv": b["da_dv"].T}, "rows and columns are exchanged (da_dv)"),
    "order": (lambda b, _: {key: value[::-1, ::-1] for key, value in b.items()}, "order of the coordinates"),
    "twice": (lambda b, _: b | {"da_dv": 2 * b["da_dv"]}, "twice as large (da_dv)"),
    "inverse": (lambda b, _: b | {"da_dq": -np.linalg.solve(b["da_dtau"], b["da_dq"])}, "of the inverse dynamics"),
    "noise": (lambda b, _: b | {"da_dq": b["da_dq"] + np.arange(9).reshape(3, 3)}, ""),
    "a little": (lambda b, _: b | {"da_dq": b["da_dq"] * (1 + 1e-8)}, ""),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_wrong_sources_do_not_pass_and_are_named(mistake):
    change, cause = WRONG[mistake]
    verdict = judge(arm(3, armature=0.1, stiffness=2.0, seed=4), Own(change))
    assert not verdict.right
    assert cause in verdict.cause
    assert bool(cause) == bool(verdict.cause)


@pytest.mark.parametrize("change", [lambda b, _: b, lambda b, _: {key: b[key] for key in ("da_dq", "da_dv")},
                                    lambda b, _: {key: (value * (1 + 1e-15)).tolist() for key, value in b.items()}])
def test_right_sources_are_not_accused(change):
    assert judge(arm(3, armature=0.1, stiffness=2.0, seed=4), Own(change)).right


def test_a_ball_differentiated_in_other_axes_is_named():
    scene = crosscheck.load_scene("double_pendulum")

    def turned(blocks, scene):
        from crosscheck.jointspace.verdicts import _bases

        turns, _ = _bases(scene)
        return {key: turns @ value @ turns.T for key, value in blocks.items()}

    verdict = judge(scene, Own(turned))
    assert not verdict.right
    assert "small turns of balls are taken in the parent's axes" in verdict.cause


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
    answer = CliRunner().invoke(app, ["derivatives", "hinge_pendulum", "--source", "mujoco", "--json"])
    assert answer.exit_code == 0, answer.output
    assert json.loads(answer.output)["verdicts"][0]["right"]
    answer = CliRunner().invoke(app, ["derivatives", "branching_tree"])
    assert answer.exit_code == 1
    assert "✗ pinocchio:aba" in answer.output
    assert "the damping of joints is left out (da_dv)" in answer.output
    assert re.search(r"of MuJoCo's steps 1e-0[678] is the best", answer.output)
