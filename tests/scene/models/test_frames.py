"""Several joints on one body: frames without mass between them, against MuJoCo and an equation by hand."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck.scene import mechanics
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.states import States

mujoco = pytest.importorskip("mujoco")

ROUNDING = 1e-12
CROSSED = """<body name="a" pos="0 0 1">
<joint name="one" axis="1 0 0" pos="0 0 .1" armature=".01" damping=".1" stiffness="2" springref=".3"/>
<joint name="two" axis="0 .8 .6" pos="0 0 .1" armature=".02" damping=".05"/>
<inertial pos=".02 .03 -.3" mass="1.3" diaginertia=".02 .03 .025"/>
<body name="b" pos="0 0 -.5"><joint name="three" axis="0 1 0"/>
<inertial pos="0 .01 -.2" mass=".7" diaginertia=".01 .012 .005"/></body></body>"""
HIP = """<body name="base" pos="0 0 2"><freejoint/><inertial pos="0 0 .1" mass="5" diaginertia=".2 .25 .3"/>
<body name="thigh" pos="0 .1 -.1"><joint name="x" axis="1 0 0" armature=".01" damping=".3"/>
<joint name="y" axis="0 1 0" stiffness="3"/><joint name="z" axis="0 0 1"/>
<inertial pos=".01 0 -.2" mass="1.5" diaginertia=".03 .03 .01"/></body></body>"""
SKEW = """<body name="a" pos="0 0 1"><joint name="s" type="slide" axis=".6 0 .8" stiffness="20" damping=".5"/>
<joint name="h" axis="0 1 .2" pos=".1 .05 0"/><inertial pos=".02 .03 -.3" mass="1.3" diaginertia=".02 .03 .025"/>
<body name="b" pos="0 0 -.5"><joint name="t" axis="0 1 0"/><joint name="r" type="slide" axis="1 0 .3" stiffness="50"/>
<inertial pos="0 .01 -.2" mass=".7" diaginertia=".01 .012 .005"/></body></body>"""
LEG = """<body name="thigh{0}" pos="0 {1} -.2"><joint axis="1 0 0" damping=".2"/><joint axis="0 1 0" armature=".01"/>
<joint axis="0 0 1" damping=".1"/><inertial pos="0 0 -.2" mass="4" diaginertia=".08 .08 .01"/>
<body name="shin{0}" pos="0 0 -.4"><joint axis="0 1 0" damping=".3"/>
<inertial pos="0 0 -.2" mass="3" diaginertia=".05 .05 .01"/><body name="foot{0}" pos="0 0 -.4">
<joint axis="0 1 0" stiffness="4"/><joint axis="1 0 .1"/>
<inertial pos=".05 0 -.02" mass="1" diaginertia=".002 .004 .004"/></body></body></body>"""
WALKER = ("""<body name="pelvis" pos="0 0 1"><freejoint/><inertial pos="0 0 0" mass="8" diaginertia=".1 .1 .1"/>
<body name="torso" pos="0 0 .2"><joint axis="0 0 1"/><joint axis="0 1 0"/><joint axis="1 0 0" armature=".02"/>
<inertial pos="0 0 .2" mass="15" diaginertia=".4 .4 .2"/></body>""" + LEG.format("l", .1) + LEG.format("r", -.1)
          + LEG.replace("thigh", "upper").replace("shin", "lower").replace("foot", "hand").format("l", .3)
          + "</body>")
ROBOTS = {"crossed": CROSSED, "hip": HIP, "skew": SKEW, "walker": WALKER}


def text(name):
    return (f'<mujoco model="{name}"><compiler angle="radian"/><option integrator="RK4" timestep="0.0005"/><worldbody>'
            f"{ROBOTS[name]}</worldbody></mujoco>")


def started(name, tmp_path):
    """The scene of a robot in a seeded state, and MuJoCo's model and data of it."""
    path = tmp_path / f"{name}.xml"
    path.write_text(text(name))
    m = mujoco.MjModel.from_xml_path(str(path))
    d, rng = mujoco.MjData(m), np.random.default_rng(len(name))
    mujoco.mj_integratePos(m, d.qpos, 0.4 * rng.normal(size=m.nv), 1.0)
    d.qvel[:] = rng.normal(size=m.nv)
    mujoco.mj_forward(m, d)
    return crosscheck.import_model(path, qpos=d.qpos, qvel=d.qvel), m, d


def accelerations(scene):
    """By body with mass: acceleration and angular acceleration in the world."""
    state = [part[None] for part in (scene.x0, scene.R0, scene.v0, scene.w0)]
    a, alpha, _ = mechanics.index1(scene, *state, mechanics.torsion_angles(scene, States(np.zeros(1), *state)))
    return {body.name: np.concatenate([a[0, k], scene.R0[k] @ alpha[0, k]])
            for k, body in enumerate(scene.bodies) if body.mass}


def gap(scene, m, d):
    """Largest difference of accelerations from MuJoCo's, over the largest."""
    mujoco.mj_rnePostConstraint(m, d)
    off, size, found = 0.0, 0.0, accelerations(scene)
    for number in range(1, m.nbody):
        rate = np.zeros(6)  # angular, then linear against gravity
        mujoco.mj_objectAcceleration(m, d, mujoco.mjtObj.mjOBJ_BODY, number, rate, 0)
        theirs = np.r_[rate[3:] + m.opt.gravity, rate[:3]]
        off, size = max(off, np.abs(found[m.body(number).name] - theirs).max()), max(size, np.abs(theirs).max())
    return off / size


@pytest.mark.parametrize("name", ROBOTS)
def test_bodies_on_several_joints_accelerate_as_in_mujoco(name, tmp_path):
    scene, m, d = started(name, tmp_path)
    assert scene.left_out == ()
    assert scene.n == m.nbody - 1 + scene.frames.sum()
    assert gap(scene, m, d) < ROUNDING


def test_two_hinges_accelerate_a_body_as_by_hand(tmp_path):
    """About a fixed point: S^T (J (S q'' + c) + w x J w - r x m g) = 0, S = (a1, R1 a2), c = q1' q2' a1 x R1 a2."""
    (tmp_path / "one.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint axis="1 0 0"/><joint axis=".6 .8 0"/>'
        '<inertial pos=".1 .2 -.4" mass="2" diaginertia=".1 .12 .05"/></body></worldbody></mujoco>')
    q, u = (0.4, -0.7), np.array([1.1, -0.6])
    scene = crosscheck.import_model(tmp_path / "one.xml", qpos=q, qvel=u)

    def turn(axis, angle):
        K = np.cross(axis, np.eye(3)).T
        return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K

    one, two = np.array([1.0, 0, 0]), np.array([0.6, 0.8, 0])
    R1 = turn(one, q[0])
    R = R1 @ turn(two, q[1])
    S = np.stack([one, R1 @ two], axis=1)
    w, r = S @ u, R @ [0.1, 0.2, -0.4]
    J = R @ np.diag([0.1, 0.12, 0.05]) @ R.T + 2 * (r @ r * np.eye(3) - np.outer(r, r))
    c = u[0] * u[1] * np.cross(one, R1 @ two)
    torque = np.cross(r, [0, 0, -2 * 9.81]) - np.cross(w, J @ w) - J @ c
    rates = S @ np.linalg.solve(S.T @ J @ S, S.T @ torque) + c
    np.testing.assert_allclose(accelerations(scene)["a"][3:], rates, rtol=0, atol=1e-13 * np.abs(rates).max())


@pytest.mark.parametrize("name", ["crossed", "hip", "skew"])
def test_truths_two_formulations_agree_on_frames(name, tmp_path):
    scene, m, d = started(name, tmp_path)
    truth = crosscheck.truth(scene.replace(duration=0.5, samples=11))
    assert truth.horizon == 0.5
    assert truth.disagreement <= truth.allowed
    for _ in range(1000):
        mujoco.mj_step(m, d)
    mujoco.mj_kinematics(m, d)
    for k, body in enumerate(scene.bodies):
        if body.mass:
            np.testing.assert_allclose(truth.states.x[-1, k], d.body(body.name).xipos, atol=1e-8)


@pytest.mark.parametrize("order", [[2, 3, 0, 1], [3, 2, 1, 0]])
def test_the_order_of_bodies_does_not_matter(order, tmp_path):
    scene, m, d = started("hip", tmp_path)
    place = {old: new for new, old in enumerate(order)} | {-1: -1}
    moved = scene.replace(bodies=tuple(scene.bodies[k] for k in order), joints=tuple(
        dataclasses.replace(joint, parent=place[joint.parent], child=place[joint.child]) for joint in scene.joints))
    assert gap(moved, m, d) < ROUNDING
    truths = [crosscheck.truth(each.replace(duration=0.2, samples=3)).states.x for each in (moved, scene)]
    np.testing.assert_allclose(truths[0], truths[1][:, order], atol=1e-12)


def test_a_wrong_order_of_joints_or_a_frame_with_mass_shows(tmp_path):
    scene, m, d = started("crossed", tmp_path)
    swapped = text("crossed").replace('name="one" axis="1 0 0"', 'name="one" axis="0 .8 .6"').replace(
        'name="two" axis="0 .8 .6"', 'name="two" axis="1 0 0"')
    (tmp_path / "other.xml").write_text(swapped)
    assert gap(crosscheck.import_model(tmp_path / "other.xml", qpos=d.qpos[[1, 0, 2]], qvel=d.qvel[[1, 0, 2]]),
               m, d) > 1e-3
    heavy = scene.replace(bodies=tuple(body if body.mass else dataclasses.replace(
        body, mass=1e-7, inertia=1e-9 * np.eye(3)) for body in scene.bodies))
    assert gap(heavy, m, d) > 100 * ROUNDING


@pytest.mark.parametrize(("change", "words"), [
    ('parent = "frame"', "parent of 0"), ("parent_axis = [1.0, 0.0, 0.0]\nchild_axis = [1.0, 0.0, 0.0]", "can move")])
def test_a_frame_that_nothing_holds_is_refused_in_one_line(change, words, tmp_path):
    joint = '[[joints]]\nname = "{}"\ntype = "revolute"\nparent = "{}"\nchild = "{}"\n' \
            "parent_anchor = [0.0, 0.0, 0.0]\nchild_anchor = [0.0, 0.0, 0.3]\n" \
            "parent_axis = [1.0, 0.0, 0.0]\nchild_axis = [1.0, 0.0, 0.0]\n"
    lines = ('schema = 2\nname = "s"\ngravity = [0.0, 0.0, -9.81]\nduration = 1.0\nsamples = 3\n'
             '[[bodies]]\nname = "body"\n'
             "mass = 1.0\ninertia = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]\n[[bodies]]\nname = "
             '"frame"\nmass = 0.0\ninertia = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]\n')
    lines += joint.format("one", "ground", "frame").replace("0.3]", "0.0]")
    held = lines + joint.format("two", "frame", "body").replace("[1.0, 0.0, 0.0]", "[0.0, 1.0, 0.0]")
    path = tmp_path / "s.toml"
    path.write_text(held)
    assert crosscheck.load_scene(path).frames.tolist() == [False, True]
    path.write_text(held.replace(change, 'parent = "ground"') if "parent =" in change else
                    lines + joint.format("two", "frame", "body").replace("0.3]", "0.0]"))
    with pytest.raises(crosscheck.SceneError, match=words) as caught:
        crosscheck.load_scene(path)
    assert "\n" not in str(caught.value)
    assert '"frame": mass' in str(caught.value)


@pytest.mark.parametrize("name", ["crossed", "hip", "skew"])
def test_a_written_model_has_its_joints_on_one_body_again(name, tmp_path):
    scene, m, _ = started(name, tmp_path)
    crosscheck.export_model(scene, tmp_path / "written.xml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "written.xml")).nbody == m.nbody
    back = crosscheck.import_model(tmp_path / "written.xml", keyframe="start")
    first, second = accelerations(scene), accelerations(back)
    for each, ours in first.items():
        np.testing.assert_allclose(second[each], ours, atol=ROUNDING * max(map(np.ptp, first.values())))


def test_a_urdf_keeps_its_links_without_mass(tmp_path):
    (tmp_path / "two.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint axis="1 0 0"/><joint axis=".6 .8 0"/>'
        '<inertial pos=".1 .2 -.4" mass="2" diaginertia=".1 .12 .05"/></body></worldbody></mujoco>')
    scene = crosscheck.import_model(tmp_path / "two.xml", qpos=[0.3, 0.4], qvel=[1.0, -2.0])
    crosscheck.export_model(scene, tmp_path / "two.urdf")
    start = at_start(scene)
    q, u = ([float(start[joint.name][k][0]) for joint in scene.joints] for k in (0, 1))
    back = crosscheck.import_model(tmp_path / "two.urdf", qpos=q, qvel=u)
    assert back.left_out == ()
    assert [body.name for body in back.bodies if not body.mass] == [
        body.name for body in scene.bodies if not body.mass]
    ours, theirs = accelerations(scene)["a"], accelerations(back)["a"]
    np.testing.assert_allclose(theirs, ours, atol=ROUNDING * np.abs(ours).max())


@pytest.mark.parametrize("name", ["crossed", "hip", "skew"])
@pytest.mark.parametrize(("engine", "method"), [("mujoco", "RK4"), ("pinocchio", "RKMK4")])
def test_engines_in_joint_coordinates_have_frames(engine, method, name, tmp_path):
    if engine == "pinocchio":
        pytest.importorskip("pinocchio")
    scene = started(name, tmp_path)[0].replace(duration=0.2, samples=5)
    run = crosscheck.run(scene, engine, method=method, step=1e-3)
    np.testing.assert_allclose(run.x, crosscheck.truth(scene).states.x, atol=1e-8)


def test_lieeuler_refuses_a_frame_by_name(tmp_path):
    scene = started("crossed", tmp_path)[0]
    with pytest.raises(crosscheck.Unsupported, match="body 'a after one' is a frame without mass, which is not built"):
        crosscheck.run(scene, "lieeuler", method="rattle4", step=1e-3)
