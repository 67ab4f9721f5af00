"""Joint coordinates as initial state and as output, and the springs and dampers of joints."""

import json

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.coordinates import histories, relative_pose
from crosscheck.scene.states import States
from tests.scene_making import unit

EPS = np.finfo(float).eps
INERTIA = [[0.3, 0.02, 0.01], [0.02, 0.25, 0.03], [0.01, 0.03, 0.2]]
START = {"revolute": ([0.7], [-1.1]), "prismatic": ([0.3], [0.4]), "cylindrical": ([-2.0, 0.3], [0.5, -0.2]),
         "universal": ([0.6, -0.9], [0.3, 0.8]), "planar": ([0.2, -0.4, 1.3], [0.1, 0.3, -0.7]),
         "spherical": ([0.5, 0.5, -0.1, 0.7], [0.4, -0.5, 0.6])}


def body(name, **state):
    return {"name": name, "mass": 1.0, "inertia": INERTIA, **state}


def joint(kind, rng, parent="ground", child="a", **more):
    axis, other = unit(rng), unit(rng)
    found = {"name": f"on {parent}", "type": kind, "parent": parent, "child": child,
             "parent_anchor": rng.normal(size=3).tolist(), "child_anchor": rng.normal(size=3).tolist(), **more}
    return found if kind == "spherical" else {**found, "parent_axis": axis.tolist(), "child_axis": other.tolist()}


def load(tmp_path, bodies, joints, **more):
    path = tmp_path / "scene.json"
    path.write_text(json.dumps({"schema": 2, "name": "made", "gravity": [0, 0, -9.81], "duration": 1.0, "samples": 101,
                                "bodies": bodies, "joints": joints, **more}))
    return crosscheck.load_scene(path)


def start_of(scene):
    return histories(scene, States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]))


@pytest.mark.parametrize("kind", START)
@pytest.mark.parametrize("seed", range(3))
def test_the_child_starts_where_the_coordinates_say(kind, seed, tmp_path):
    rng = np.random.default_rng(seed)
    position, velocity = START[kind]
    reference = {"reference_attitude": rng.normal(size=4).tolist()} if kind == "spherical" else {}
    chain = [joint("revolute", rng, position=0.4, velocity=2.0),
             joint(kind, rng, "a", "b", position=position, velocity=velocity, **reference)]
    scene = load(tmp_path, [body("a"), body("b")], chain)
    found = start_of(scene)["on a"]
    goal = np.array(position) / (np.linalg.norm(position) if kind == "spherical" else 1.0)
    # a dozen products of terms up to 10
    np.testing.assert_allclose(np.atleast_1d(found.position[0]), goal, rtol=0, atol=500 * EPS)
    np.testing.assert_allclose(np.atleast_1d(found.velocity[0]), velocity, rtol=0, atol=2000 * EPS)
    assert start_of(scene)["on ground"].velocity[0] == pytest.approx(2.0, abs=500 * EPS)


@pytest.mark.parametrize("kind", [kind for kind in START if kind != "spherical"])
def test_rates_are_the_derivatives_of_the_coordinates(kind, tmp_path):
    position, velocity = START[kind]
    scene = load(tmp_path, [body("a")], [joint(kind, np.random.default_rng(5), position=position, velocity=velocity)])
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-12, samples=2001)
    found = traj.joints["on ground"]
    h = traj.t[1]
    slope = (found.position[2:] - found.position[:-2]) / (2 * h)
    # central differences leave h^2 / 6 times the third derivative
    third = np.abs(np.diff(found.velocity, 2, axis=0)).max() / h**2
    assert np.abs(slope - found.velocity[1:-1]).max() <= h**2 / 6 * third * 1.2 + 1e-9


def test_angles_begin_at_the_turn_that_the_scene_gives(tmp_path):
    scene = load(tmp_path, [body("a")], [joint("revolute", np.random.default_rng(1), position=7.0, velocity=9.0)],
                 gravity=[0, 0, 0])
    angle = crosscheck.run(scene, "mujoco", "RK4", step=1e-3).joints["on ground"].position
    assert angle[0] == pytest.approx(7.0, abs=1e-12)
    assert angle[-1] > 12.0
    assert np.diff(angle).min() > 0


def test_a_reference_attitude_says_where_the_angle_is_zero(tmp_path):
    rng = np.random.default_rng(2)
    made = joint("revolute", rng, position=0.5)
    plain = load(tmp_path, [body("a")], [made])
    turned = relative_pose(plain.joints[0], np.array([0.3]))[0]
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(turned).as_quat(scalar_first=True).tolist()
    moved = load(tmp_path, [body("a")], [{**made, "reference_attitude": quaternion, "position": 0.2}])
    np.testing.assert_allclose(moved.R0, plain.R0, atol=20 * EPS)
    assert start_of(moved)["on ground"].position[0] == pytest.approx(0.2, abs=50 * EPS)


@pytest.mark.parametrize(("state", "word"), [({"attitude": [1.0, 0.0, 0.0, 0.0]}, "attitude"),
                                             ({"angular_velocity": [0.0, 0.0, 0.0]}, "angular_velocity"),
                                             ({"position": [0.0, 0.0, -0.5], "attitude": [0.0, 0.0, 1.0, 0.0]}, "")])
def test_a_state_beside_the_coordinates_has_to_agree(state, word, tmp_path):
    swing = {"name": "on ground", "type": "revolute", "parent": "ground", "child": "a", "parent_anchor": [0, 0, 0],
             "child_anchor": [0, 0, 0.5], "parent_axis": [0, 1, 0], "child_axis": [0, 1, 0], "position": 0.3,
             "velocity": 1.0}
    with pytest.raises(crosscheck.SceneError, match=f'"on ground": its coordinates and the {word}'):
        load(tmp_path, [body("a", **state)], [swing])
    half = [np.cos(0.15), 0.0, np.sin(0.15), 0.0]
    scene = load(tmp_path, [body("a", attitude=half, angular_velocity=[0, 1.0, 0])], [swing])
    assert start_of(scene)["on ground"].position[0] == pytest.approx(0.3, abs=50 * EPS)


def test_springs_and_dampers_of_joints_move_every_engine_alike(tmp_path):
    rng = np.random.default_rng(8)
    elastic = {"damping": 0.2, "stiffness": 30.0, "rest_position": 0.1}
    scene = load(tmp_path, [body("a"), body("b")], [
        joint("revolute", rng, position=4.0, velocity=1.0, **elastic),
        joint("prismatic", rng, "a", "b", position=0.2, velocity=-0.5, **elastic)])
    truth = crosscheck.truth(scene).states.x
    for engine, method in (("lieeuler", "rattle8"), ("mujoco", "RK4"), ("pinocchio", "RKMK4")):
        traj = crosscheck.run(scene, engine, method, step=1e-3)
        assert np.abs(traj.x - truth).max() < 1e-8, engine  # order 4 at 1 ms, rates below 10 / s


def test_a_prismatic_spring_obeys_its_equation(tmp_path):
    m, k, c, rest, s, v = 1.0, 40.0, 0.8, 0.1, 0.3, -0.4
    made = joint("prismatic", np.random.default_rng(3), position=s, velocity=v, stiffness=k, damping=c,
                 rest_position=rest)
    scene = load(tmp_path, [body("a")], [made], gravity=[0, 0, 0])
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
    decay, w = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
    y = s - rest
    goal = rest + np.exp(-decay * traj.t) * (y * np.cos(w * traj.t) + (v + decay * y) / w * np.sin(w * traj.t))
    np.testing.assert_allclose(traj.joints["on ground"].position, goal, atol=1e-12)  # rounding of a length of 16 m


def test_version_1_refuses_what_version_2_brings(tmp_path):
    made = joint("revolute", np.random.default_rng(1), position=0.5)
    with pytest.raises(crosscheck.SceneError, match="schema = 2"):
        load(tmp_path, [body("a")], [made], schema=1)


@pytest.mark.parametrize(("change", "words"), [
    ({"position": [0.1, 0.2]}, "position: 2 given; write one number"),
    ({"damping": -1.0}, "damping: -1 is negative"), ({"armature": [0.1, 0.1]}, "armature: 2 given"),
    ({"mimic": {"joint": "nobody", "ratio": 2.0}}, "no other revolute or prismatic joint"),
    ({"type": "planar", "damping": 1.0}, "a planar joint cannot have it"),
    ({"mimic": {"joint": "a", "ratio": 2.0, "speed": 1.0}}, "speed")])
def test_wrong_joint_options_are_named(change, words, tmp_path):
    made = joint("revolute", np.random.default_rng(1))
    with pytest.raises(crosscheck.SceneError, match=words):
        load(tmp_path, [body("a")], [{**made, **change}])


def test_armature_is_one_motion_in_the_engines_that_have_it(tmp_path):
    rng = np.random.default_rng(4)
    scene = load(tmp_path, [body("a"), body("b"), body("c")], [
        joint("revolute", rng, position=0.4, velocity=1.0, armature=0.2),
        joint("prismatic", rng, "a", "b", position=0.2, velocity=-0.5, armature=0.7),
        joint("cylindrical", rng, "b", "c", position=[0.1, 0.3], velocity=[0.4, -0.5], armature=[0.3, 0.6])])
    one, other = (crosscheck.run(scene, engine, method, step=1e-3) for engine, method in (("mujoco", "RK4"),
                                                                                        ("pinocchio", "RKMK4")))
    assert np.abs(one.x - other.x).max() < 1e-9  # order 4 at 1 ms, rates of a few / s
    # two formulations with different equations of the rotors
    truth = crosscheck.truth(scene)
    assert truth.disagreement < 1e-12
    assert np.abs(one.x - truth.states.x).max() < 1e-9
    # our energy is conserved, and our accelerations (d'Alembert with rotors) equal those of the engines
    assert np.ptp(one.energy) < 1e-8
    from crosscheck.scene.mechanics import index1

    a, alpha, _ = index1(scene, one.x, one.R, one.v, one.w)
    assert np.abs(a[1:] - one.a[1:]).max() < 1e-9
    assert np.abs(alpha[1:] - one.alpha[1:]).max() < 1e-9
    bare = load(tmp_path, [body("a")], [joint("revolute", rng, position=0.4)])
    assert bare.hash != bare.replace(joints=(bare.joints[0].__class__(**{**vars(bare.joints[0]), "armature": (0.2,)}),)
                                     ).hash


def test_exudyn_without_coordinates_for_armature_says_so(tmp_path):
    scene = load(tmp_path, [body("a")], [joint("revolute", np.random.default_rng(1), position=0.4, armature=0.1)])
    with pytest.raises(crosscheck.Unsupported, match="armature, which needs a joint coordinate: form tree"):
        crosscheck.run(scene, "exudyn", "GeneralizedAlpha", step=1e-3, form="maximal")
