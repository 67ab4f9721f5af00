"""Members: their number, their distribution, closed joints, and the same again from the same seed."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
from crosscheck import references
from crosscheck.compare.apart import turn
from crosscheck.references.members import Members
from crosscheck.scene.constraints import Constraints
from crosscheck.sweeps import members, plan
from crosscheck.sweeps.job import structure_of


def made(scene, perturb, **more):
    asked = plan.read({"scenes": [scene], "engines": {"lieeuler": ["rattle2"]}, "steps": [1e-2], "duration": 0.5,
                       "samples": 6, "perturb": perturb, **more})
    (start,) = members.starts(asked)
    return start.scene, list(members.of_start(start, asked.perturbation))


PERTURBED = [{"angular_velocity": 1e-2}, {"attitude": 1e-2}, {"joint_position": 1e-2, "joint_velocity": 1e-2}]
SCENES = ["double_pendulum", "hinge_pendulum", "universal_pendulum", "cylindrical_pendulum", "planar_slider",
          "prismatic_slider", "four_bar", "branching_tree", "fixed_pair", "bead_on_line"]


@pytest.mark.parametrize("perturb", PERTURBED, ids=lambda table: "+".join(table))
@pytest.mark.parametrize("scene", SCENES)
def test_members_lie_on_the_joints(scene, perturb):
    start, found = made(scene, {**perturb, "count": 3, "seed": 1})
    constraints = Constraints(start)
    scale = max(1.0, float(np.abs(start.x0).max()), float(np.abs(start.w0).max()), float(np.abs(start.v0).max()))
    for member in found:
        x, R, v, w = (values[None] for values in (member.x0, member.R0, member.v0, member.w0))
        rounding = 500 * np.finfo(float).eps * scale  # a projection ends within 50 roundings of the largest length
        assert np.abs(constraints.position(x, R)).max(initial=0.0) < rounding
        assert np.abs(constraints.velocity(x, R, v, w)).max(initial=0.0) < rounding * scale


def test_deviations_are_those_asked_for():
    start, found = made("double_pendulum", {"angular_velocity": 1e-2, "count": 400, "seed": 3})
    w = np.array([member.w0 for member in found]) - start.w0
    # of 400 normal numbers: the mean lies within 5 / sqrt(400) deviations, the deviation within 5 / sqrt(800)
    np.testing.assert_allclose(w.mean(axis=0), 0.0, atol=1e-2 * 5 / 20)
    np.testing.assert_allclose(w.std(axis=0), 1e-2, rtol=5 / np.sqrt(800))
    start, found = made("double_pendulum", {"attitude": 1e-2, "count": 400, "seed": 3})
    angles = np.array([np.linalg.norm(turn(start.R0, member.R0), axis=-1) for member in found])
    np.testing.assert_allclose((angles**2).mean(axis=0), 3e-4, rtol=5 * np.sqrt(2 / 1200))


def test_latin_hypercube_has_one_member_a_stratum():
    from scipy.stats import norm

    start, found = made("single_pendulum", {"angular_velocity": 1e-2, "count": 50, "sampling": "latin_hypercube"})
    w = (np.array([member.w0 for member in found]) - start.w0).reshape(50, -1) / 1e-2
    strata = np.sort(np.floor(50 * norm.cdf(w)).astype(int), axis=0)
    np.testing.assert_array_equal(strata, np.repeat(np.arange(50)[:, None], 3, axis=1))


def test_a_number_by_path_is_perturbed_in_proportion():
    start, found = made("double_pendulum", {"bodies.upper.mass": 0.1, "count": 300, "seed": 5})
    masses = np.array([member.bodies[0].mass for member in found])
    np.testing.assert_allclose(masses.std(), 0.1, rtol=5 / np.sqrt(600))
    assert {member.bodies[1].mass for member in found} == {start.bodies[1].mass}


def test_exactly_count_members_none_unperturbed_reproducible():
    start, found = made("double_pendulum", {"attitude": 1e-3, "count": 7, "seed": 2})
    assert len(found) == len({member.hash for member in found}) == 7
    assert start.hash not in {member.hash for member in found}
    again = made("double_pendulum", {"attitude": 1e-3, "count": 7, "seed": 2})[1]
    assert [member.hash for member in again] == [member.hash for member in found]
    other = made("double_pendulum", {"attitude": 1e-3, "count": 7, "seed": 4})[1]
    assert not {member.hash for member in other} & {member.hash for member in found}
    more = made("double_pendulum", {"attitude": 1e-3, "count": 9, "seed": 2})[1]
    assert [member.hash for member in more[:7]] == [member.hash for member in found]


@pytest.mark.parametrize("scene", ["double_pendulum", "hinge_pendulum", "universal_pendulum", "cylindrical_pendulum",
                                   "planar_slider", "four_bar", "torsion_wheel"])
def test_one_compiled_truth_serves_all_members(scene):
    start, found = made(scene, {"joint_position": 0.05, "joint_velocity": 0.05, "count": 2, "seed": 1})
    compiled = Members(start)
    for member in found:
        assert structure_of(member) == structure_of(start)
        assert compiled._state(member) is not None
        own = references.compute(member)
        shared = compiled.states(member)
        np.testing.assert_allclose(shared.x, own.states.x, rtol=0, atol=1e-11)  # 100 roundings of lengths near 1, grown
        np.testing.assert_allclose(shared.R, own.states.R, rtol=0, atol=1e-11)
        assert compiled.check(member, shared) < 1e-11


def test_a_wrong_truth_of_a_member_is_caught():
    start, (member,) = made("double_pendulum", {"angular_velocity": 0.05, "count": 1})
    compiled = Members(start)
    with pytest.raises(references.TruthError, match="disagree"):
        compiled.check(member, compiled.states(start))


def turned(axis, angle):
    return Rotation.from_rotvec(angle * np.asarray(axis)).as_matrix()


def members_of(content, tmp_path, **perturb):
    (tmp_path / "scene.json").write_text(json.dumps(content))
    return made(str(tmp_path / "scene.json"), {"count": 6, "seed": 2, **perturb})


def universal():
    """A cross on a turning arm, in motion."""
    J = np.diag([0.1, 0.12, 0.15]).tolist()
    place = {"parent_anchor": [0.3, 0.0, 0.1], "child_anchor": [0.0, 0.2, 0.0]}
    return {"schema": 2, "name": "cross", "gravity": [0.0, 0.0, -9.81], "duration": 1.0, "samples": 3,
            "bodies": [{"name": name, "mass": 1.0, "inertia": J} for name in ("arm", "tip")],
            "joints": [{"name": "pin", "type": "revolute", "parent": "ground", "child": "arm", **place,
                        "parent_axis": [0.0, 0.0, 1.0], "child_axis": [0.0, 0.0, 1.0], "position": 0.4,
                        "velocity": 1.5},
                       {"name": "cross", "type": "universal", "parent": "arm", "child": "tip", **place,
                        "parent_axis": [1.0, 0.0, 0.0], "child_axis": [0.0, 1.0, 0.0], "position": [0.3, 0.7],
                        "velocity": [2.0, -1.0]}]}


def test_rates_stay_where_positions_are_perturbed(tmp_path):
    start, found = members_of(universal(), tmp_path, joint_position=0.2)
    for scene in (start, *found):
        arm, tip = scene.R0
        spin = arm.T @ (tip @ scene.w0[1] - arm @ scene.w0[0])
        other = arm.T @ tip @ [0.0, 1.0, 0.0]
        np.testing.assert_allclose([scene.w0[0, 2], spin[0], spin @ other], [1.5, 2.0, -1.0], rtol=0, atol=1e-12)
    assert min(np.abs(scene.R0 - start.R0).max() for scene in found) > 0.01


def test_positions_and_rates_are_those_asked_for(tmp_path):
    _, found = members_of(universal(), tmp_path, joint_position=0.2, joint_velocity=0.3, seed=7)
    drawn = np.random.default_rng(7).standard_normal((6, 6))
    for scene, row in zip(found, drawn, strict=True):
        (pin, first, second), rates = np.array([0.4, 0.3, 0.7]) + 0.2 * row[:3], [1.5, 2.0, -1.0] + 0.3 * row[3:]
        arm = turned([0, 0, 1], pin)
        np.testing.assert_allclose(scene.R0[0], arm, rtol=0, atol=1e-13)
        np.testing.assert_allclose(scene.R0[1], arm @ turned([1, 0, 0], first) @ turned([0, 1, 0], second), rtol=0,
                                   atol=1e-13)
        spin = arm.T @ (scene.R0[1] @ scene.w0[1] - arm @ scene.w0[0])
        other = turned([1, 0, 0], first) @ [0.0, 1.0, 0.0]
        np.testing.assert_allclose([scene.w0[0, 2], spin[0], spin @ other], rates, rtol=0, atol=1e-12)


def test_a_perturbation_beyond_half_a_turn_keeps_the_energy_continuous(tmp_path):
    content = universal()
    content["bodies"], content["joints"], pin = content["bodies"][:1], content["joints"][:1], content["joints"][0]
    content["bodies"][0]["attitude"] = [np.cos(1.57), 0.0, 0.0, np.sin(1.57)]  # 3.14 rad
    pin |= {"stiffness": 3.0, "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3}
    del pin["position"], pin["velocity"]
    _, found = members_of(content, tmp_path, joint_position=0.01)
    energies = [crosscheck.run(scene, "lieeuler", "taylor", duration=0.1, rtol=1e-8).energy[0] for scene in found]
    drawn = 3.14 + 0.01 * np.random.default_rng(2).standard_normal(6)
    assert (drawn > np.pi).any()
    np.testing.assert_allclose(energies, 1.5 * drawn**2, rtol=1e-12)


def test_a_joint_whose_child_is_nearer_to_the_ground(tmp_path):
    """Two links about z; the second joint's parent is the outer one."""
    J, axes = np.diag([0.1] * 3).tolist(), {"parent_axis": [0.0, 0.0, 1.0], "child_axis": [0.0, 0.0, 1.0]}
    outer = turned([0, 0, 1], 0.4 - 0.5)  # R_inner = R_outer exp(q), q = 0.5
    content = {"schema": 2, "name": "reversed", "gravity": [0.0, -9.81, 0.0], "duration": 1.0, "samples": 3, "bodies": [
        {"name": "inner", "mass": 1.0, "inertia": J, "attitude": [np.cos(0.2), 0.0, 0.0, np.sin(0.2)],
         "angular_velocity": [0.0, 0.0, 1.0]},
        {"name": "outer", "mass": 1.0, "inertia": J, "angular_velocity": [0.0, 0.0, -1.0],
         "attitude": Rotation.from_matrix(outer).as_quat(scalar_first=True).tolist()}], "joints": [
        {"name": "near", "type": "revolute", "parent": "ground", "child": "inner", "parent_anchor": [0.0] * 3,
         "child_anchor": [-0.5, 0.0, 0.0], **axes},
        {"name": "far", "type": "revolute", "parent": "outer", "child": "inner", "parent_anchor": [-0.5, 0.0, 0.0],
         "child_anchor": [0.5, 0.0, 0.0], **axes}]}
    start, found = members_of(content, tmp_path, joint_position=0.2, seed=9)
    drawn = 0.2 * np.random.default_rng(9).standard_normal((6, 2))
    for scene, (near, far) in zip(found, drawn, strict=True):
        angles = np.array([0.4 + near, 0.4 + near - 0.5 - far])
        np.testing.assert_allclose(scene.R0, [turned([0, 0, 1], angle) for angle in angles], rtol=0, atol=1e-13)
        np.testing.assert_allclose(scene.w0[:, 2], [1.0, -1.0], rtol=0, atol=1e-12)
        ends = [0.5 * np.array([np.cos(angle), np.sin(angle), 0.0]) for angle in angles]
        np.testing.assert_allclose(scene.x0, [ends[0], 2 * ends[0] + ends[1]], rtol=0, atol=1e-13)
    np.testing.assert_allclose(start.w0[:, 2], [1.0, -1.0], rtol=0, atol=1e-12)
