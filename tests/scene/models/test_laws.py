"""Import of what robots have: actuators, dry friction, limits and contacts, compared with MuJoCo's own numbers."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from crosscheck.errors import ArgumentError, SceneError
from crosscheck.scene import mechanics, touching
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.models import laws, neutral, table
from crosscheck.scene.models.neutral import Reading
from crosscheck.scene.models.writing import toml

mujoco = pytest.importorskip("mujoco")

ROBOT = """<mujoco model="robot"><option gravity="0 0 -9.81"/>
<worldbody><geom name="floor" type="plane" size="5 5 .1" pos="0 0 -3"/>
<body name="a" pos="0 0 0"><joint name="one" axis="0 1 0" range="-100 100" frictionloss=".2" armature=".02"/>
 <geom name="rod" type="capsule" fromto="0 0 0 0 0 -.5" size=".05" mass="1"/>
 <body name="b" pos="0 0 -.5"><joint name="two" type="slide" axis=".6 0 -.8" range="-.2 .3" frictionloss=".3"/>
  <geom name="box" type="box" size=".1 .1 .1" pos=".1 0 -.2" mass=".7" {box}/>
  <body name="c" pos=".1 .3 -.5"><joint name="three" axis="1 1 0" damping=".1"/>
   <geom name="ball" size=".1" mass=".4" {ball}/></body></body></body></worldbody>
<contact>{contact}</contact><actuator>{actuator}</actuator></mujoco>"""

ACTUATORS = {  # each with the controls of a keyframe
    "position": ('<position name="p" joint="one" kp="20" kv="2" gear="-3" forcerange="-4 5"/>', {"p": 0.4}),
    "velocity": ('<velocity name="v" joint="two" kv="7" gear="2" ctrlrange="-1 1"/>', {"v": 5.0}),
    "motor": ('<motor name="m" joint="three" gear="9" ctrlrange="0.1 1"/>', {}),
    "general": ('<general name="g" joint="one" gainprm="3" biastype="affine" biasprm=".5 -6 -.7" gear="2"/>'
                '<motor joint="three" gear="-2" forcerange="1 2"/>', {"g": -0.3, "three": 0.2}),
    "clamped": ('<position joint="one" kp="90" gear="3"/>', {"one": 2.0}),
}


def written(folder, text, name="robot.xml"):
    path = folder / name
    path.write_text(text)
    return path


def robot(tmp_path, actuator="", contact="", box="", ball="", change=("", "")):
    text = ROBOT.format(actuator=actuator, contact=contact, box=box, ball=ball)
    return written(tmp_path, text.replace(*change))


FINGER = """<mujoco><worldbody><body name="hand"><joint name="wrist" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/>
<body name="finger"><joint name="grip" type="slide" axis="{axis}" range="{range}" frictionloss="{friction}"/>
<geom size=".02"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("axis", "ends", "friction", "watched"), [
    ("0 0 1", "0 .04", 0, False),  # falls out of its range
    ("0 0 -1", "0 .04", 0, True),
    ("0 0 1", "-.04 0", 0, True),
    ("0 0 -1", "-.04 0", 0, False),
    ("0 1 0", "0 .04", 0, False),  # stays where it is, and rounding decides
    ("0 0 1", "-.01 .04", 0, True),
    ("0 0 1", "0 .04", 2, True)])  # friction may hold it
def test_a_joint_at_the_end_of_its_range_is_watched_only_if_it_turns_inside(tmp_path, axis, ends, friction, watched):
    scene = crosscheck.import_model(written(tmp_path, FINGER.format(axis=axis, range=ends, friction=friction)))
    assert [each.joint for each in scene.monitors] == ["grip"] * watched
    assert [each[:2] for each in scene.left_out] == [("grip", "limits of joint")] * (not watched)


def test_thrusters_without_a_control_are_named(tmp_path):
    text = FINGER.format(axis="0 0 1", range="-1 1", friction=0)
    text = text.replace("</body></body>", '<site name="tip"/></body></body>').replace(
        "</mujoco>", '<actuator><motor name="jet" site="tip" gear="0 0 1 0 0 .02"/></actuator></mujoco>')
    path = written(tmp_path, text)
    assert crosscheck.import_model(path).description.endswith("motors without a control: 'jet'")
    with pytest.raises(SceneError, match="cannot hold actuator 'jet'"):
        crosscheck.import_model(path, controls={"jet": 1.0})


def test_a_robot_comes_in_whole_and_says_until_when_it_holds(tmp_path):
    scene = crosscheck.import_model(robot(tmp_path, ACTUATORS["position"][0] + '<motor name="idle" joint="two"/>'))
    assert scene.left_out == ()
    assert "motors without a control: 'idle'" in scene.description
    assert [joint.dry_friction[0].sliding if joint.dry_friction else None for joint in scene.joints] == [0.2, 0.3, None]
    watched = [(m.type, m.joint or m.shapes) for m in scene.monitors]
    assert watched == [("range", "one"), ("range", "two"), ("touch", ("floor", "rod")), ("touch", ("floor", "box")),
                       ("touch", ("floor", "ball")), ("touch", ("rod", "ball"))]
    kept = crosscheck.import_model(robot(tmp_path), limits="keep", contacts="drop")
    assert [joint.limits[0].upper if joint.limits else None for joint in kept.joints] == pytest.approx(
        [np.radians(100), 0.3, None])
    assert kept.monitors == ()
    assert any("contacts of" in each.what for each in kept.left_out)
    bare = crosscheck.import_model(robot(tmp_path, ACTUATORS["position"][0]), drop=True)
    assert not bare.has_laws
    assert bare.monitors == scene.monitors  # what is dropped is watched still
    assert {("one", "dry friction of joint", 0.2), ("two", "dry friction of joint", 0.3),
            ("p", "actuator", (-3.0, 20.0, 0.0, 0.0, 0.0, -20.0, -2.0))} <= set(bare.left_out)
    path = tmp_path / "bare.toml"
    path.write_text(toml(table(robot(tmp_path, ACTUATORS["position"][0]), drop=True)))
    assert crosscheck.load_scene(path).left_out == bare.left_out
    path.write_text(path.read_text().replace("left_out = [", 'left_out = ["friction", '))
    with pytest.raises(SceneError, match=r'left_out.*\["elbow", "dry friction of joint", 0.3\]'):
        crosscheck.load_scene(path)


@pytest.mark.parametrize("case", ACTUATORS)
def test_accelerations_with_actuators_and_sliding_friction_are_mujocos(case, tmp_path):
    actuator, controls = ACTUATORS[case]
    change = ('name="one"', 'name="one" actuatorfrcrange="-8 6"') if case == "clamped" else ("", "")
    path = robot(tmp_path, actuator, change=change)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.tolerance = 1e-14
    data, rng = mujoco.MjData(model), np.random.default_rng(5)
    for name, value in controls.items():
        joints = [model.jnt(model.actuator_trnid[a, 0]).name for a in range(model.nu)]
        data.ctrl[next(a for a in range(model.nu) if name in (model.actuator(a).name, joints[a]))] = value
    for _ in range(6):
        q = rng.uniform(-0.2, 0.3, 3)
        v = rng.choice([-1.0, 1.0], 3) * rng.uniform(2.0, 4.0, 3)  # friction slides at its full size
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        scene = crosscheck.import_model(path, qpos=q, qvel=v, controls=controls, limits="drop", contacts="drop")
        a, alpha, _ = mechanics.index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
        own = np.zeros((3, 6))
        mujoco.mj_rnePostConstraint(model, data)
        for k in range(3):
            rate = np.zeros((6, 1))
            mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_XBODY, k + 1, rate, 0)
            own[k] = rate[:, 0]
        turning = np.einsum("nij,nj->ni", scene.R0, alpha[0])
        np.testing.assert_allclose(turning, own[:, :3], rtol=0, atol=1e-8 * np.abs(own).max())
        arm = scene.x0 - data.xpos[1:]
        w = np.einsum("nij,nj->ni", scene.R0, scene.w0)
        moving = own[:, 3:] + scene.gravity + np.cross(turning, arm) + np.cross(w, np.cross(w, arm))
        np.testing.assert_allclose(a[0], moving, rtol=0, atol=1e-8 * np.abs(own).max())


@pytest.mark.parametrize(("contact", "box", "ball"), [
    ("", "", ""), ('<exclude body1="a" body2="c"/>', "", ""), ("", 'contype="2" conaffinity="4"', 'contype="4"'),
    ('<pair geom1="rod" geom2="box" margin=".01"/>', 'contype="0" conaffinity="0"', 'margin=".02"')])
def test_the_pairs_are_those_of_mujoco(contact, box, ball, tmp_path):
    """All geometries at one place, so that every pair that MuJoCo admits is in contact."""
    model = mujoco.MjModel.from_xml_path(str(robot(tmp_path, contact=contact, box=box, ball=ball)))
    data = mujoco.MjData(model)
    model.body_pos[1:] = model.geom_pos[1:] = 0.0
    model.geom_pos[0] = 0.0
    mujoco.mj_forward(model, data)
    theirs = {tuple(sorted((int(c.geom1), int(c.geom2)))): c.includemargin for c in data.contact}
    reading = Reading(model, data, neutral.bodies(model, data), [], [])
    ours = {(a, b): margin for a, b, margin in laws.colliding(reading)}
    assert ours == pytest.approx(theirs)


def test_distances_of_shapes_are_those_of_geometry(tmp_path):
    scene = crosscheck.import_model(robot(tmp_path))
    watched = touching.Touching(scene)
    pairs = [scene.monitors[k].shapes for k in watched.monitors]
    gaps = dict(zip(pairs, watched.gaps(scene.x0, scene.R0), strict=True))
    expected = {("floor", "rod"): 3.0 - 0.5 - 0.05, ("floor", "box"): 3.0 - 0.8, ("floor", "ball"): 3.0 - 1.1,
                ("rod", "ball"): np.hypot(np.hypot(0.1, 0.3), 0.5) - 0.15}
    assert {pair: gaps[pair] for pair in expected} == pytest.approx(expected, abs=touching.TOLERANCE)


def test_a_mesh_keeps_its_place(tmp_path):
    """MuJoCo moves the frame of a mesh to its centre of mass; the hull stays where the file has it."""
    mesh = ('<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody>', '<geom type="mesh" mesh="m" '
            'pos="0 0 -.9"/>')
    text = ROBOT.format(actuator="", contact="", box="", ball="").replace("<worldbody>", mesh[0]).replace(
        '<geom name="ball" size=".1" mass=".4" />', mesh[1])
    scene = crosscheck.import_model(written(tmp_path, text))
    watched = touching.Touching(scene)
    floor = [k for k, index in enumerate(watched.monitors) if "c mesh" in scene.monitors[index].shapes
             and "floor" in scene.monitors[index].shapes]
    assert watched.gaps(scene.x0, scene.R0)[floor[0]] == pytest.approx(3.0 - 1.9, abs=1e-7)  # float32 vertices


def test_what_touches_or_is_beyond_its_range_at_the_start_is_refused_by_name(tmp_path):
    path = robot(tmp_path, change=('pos="0 0 -3"', 'pos="0 0 -.7"'))
    with pytest.raises(SceneError, match=r"'ground - b', which touch at the start.*convert --contacts drop leaves"):
        crosscheck.import_model(path)
    assert crosscheck.import_model(path, contacts="drop").forces == crosscheck.import_model(robot(tmp_path)).forces
    with pytest.raises(SceneError, match=r"limits of joint 'two', which starts beyond them, at 0\.5"):
        crosscheck.import_model(robot(tmp_path), qpos=[0.0, 0.5, 0.0])
    path = robot(tmp_path, change=('pos="0 0 -3"', 'pos="0 0 -.7"'))
    assert any(str(each).startswith("acts at the start: contacts of the colliding bodies 'ground - b'")
               for each in crosscheck.import_model(path, drop=True).left_out)


@pytest.mark.parametrize(("limits", "start"), [("1 2", 1.1), ("-3 -2.9", -2.95), ("-1 1", 0.0)])
def test_a_joint_whose_limits_exclude_its_reference_starts_inside_which_is_told(limits, start, tmp_path):
    """A knee or a finger often has zero outside its range; the file then says no start that it may have."""
    text = (f'<mujoco><compiler angle="radian"/><worldbody><body><joint name="knee" axis="0 1 0" range="{limits}"/>'
            '<inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>')
    scene = crosscheck.import_model(written(tmp_path, text))
    assert scene.joints[0].start == pytest.approx((start,), abs=1e-12)
    told = " ".join(map(str, scene.left_out))
    assert ("the reference, which its limits exclude, of joint 'knee', it starts at" in told) == (start != 0.0)
    dropped = crosscheck.import_model(written(tmp_path, text), drop=True)
    assert dropped.joints[0].start == pytest.approx((start,), abs=1e-12)


def test_a_scene_file_whose_shapes_touch_at_the_start_is_refused(tmp_path):
    target = tmp_path / "robot.toml"
    target.write_text(toml(table(robot(tmp_path))))
    assert crosscheck.import_model(robot(tmp_path)).hash == crosscheck.load_scene(target).hash
    target.write_text(target.read_text().replace("-3.0", "-0.7"))
    with pytest.raises(SceneError, match=r"monitors\[3\] \(touch\): at the start floor and box are .* apart"):
        crosscheck.load_scene(target)


def test_random_starts_are_seeded_and_inside_the_limits(tmp_path):
    path = robot(tmp_path)
    first, again, other = (crosscheck.import_model(path, start=seed) for seed in (3, 3, "random"))
    assert first.hash == again.hash != other.hash
    for scene in (first, other):
        q = at_start(scene)
        assert abs(q["one"][0][0]) <= np.radians(100)
        assert -0.2 <= q["two"][0][0] <= 0.3
        assert all(np.abs(rate).max() > 0 for _, rate in q.values())
    with pytest.raises(ArgumentError, match="start"):
        crosscheck.import_model(path, start="anywhere")


def test_controls_are_functions_of_time_too(tmp_path):
    path = robot(tmp_path, ACTUATORS["position"][0] + '<motor name="m" joint="three" gear="2" ctrlrange="-1 1"/>')
    sine = {"type": "sine", "terms": [[0.5, 3.0, 0.0]], "offset": 0.1}
    scene = crosscheck.import_model(path, controls={"p": sine, "m": {"type": "hold", "times": [0.0, 1.0],
                                                                    "values": [0.5, -0.5]}})
    position, motor = (scene.forces[index].parameters for index in scene.servos)
    assert position["target"](0.2) == pytest.approx(-(0.5 * np.sin(0.6) + 0.1) / 3, abs=1e-15)
    assert position["proportional"] == 180.0
    assert position["effort_limit"] == (-15.0, 12.0)
    assert motor["feedforward"](1.5) == -1.0
    for controls, words in (({"q": 1.0}, "controls: 'q'"), ({"p": "much"}, "that of 'p' is neither"),
                            ({"m": sine | {"offset": 0.9}}, "reaches from 0.4 to 1.4"), ({"p": float("nan")}, "'p'"),
                            ({"p": {"type": "sinus"}}, "'p'")):
        with pytest.raises(ArgumentError) as caught:
            crosscheck.import_model(path, controls=controls)
        assert words in str(caught.value)
    with pytest.raises(ArgumentError, match=r"limits: 'hold' .*monitor"):
        crosscheck.import_model(path, limits="hold")


def test_what_a_robot_has_comes_back_from_its_export(tmp_path):
    path = robot(tmp_path, ACTUATORS["general"][0], contact='<exclude body1="a" body2="c"/>',
                 change=('<geom name="floor" type="plane" size="5 5 .1" pos="0 0 -3"/>', ""))
    scene = crosscheck.import_model(path, controls={"g": -0.3, "three": 0.2})
    crosscheck.export_model(scene, tmp_path / "again.xml")
    again = crosscheck.import_model(tmp_path / "again.xml", keyframe="start")
    assert again.left_out == scene.left_out == ()
    assert again.monitors == scene.monitors
    assert [joint.dry_friction for joint in again.joints] == [joint.dry_friction for joint in scene.joints]
    rates = [mechanics.index1(each, each.x0[None], each.R0[None], each.v0[None], each.w0[None])[0]
             for each in (scene, again)]
    np.testing.assert_allclose(*rates, rtol=0, atol=1e-10)
    kept = crosscheck.import_model(path, limits="keep", actuators="drop")
    crosscheck.export_model(kept, tmp_path / "kept.xml")
    limits = crosscheck.import_model(tmp_path / "kept.xml", limits="keep").joints
    assert [joint.limits for joint in limits] == [joint.limits for joint in kept.joints]
    with pytest.raises(SceneError, match=r"URDF cannot hold forces\[0\], a servo"):
        crosscheck.export_model(scene, tmp_path / "again.urdf")
    with pytest.raises(SceneError, match="touch of"):
        crosscheck.export_model(crosscheck.import_model(robot(tmp_path)), tmp_path / "again.xml")


def test_the_motor_of_a_transmission_has_no_control(tmp_path):
    from tests.scene.models.test_traps import urdf

    text = urdf(end='<transmission name="t"><mechanicalReduction>9</mechanicalReduction></transmission>')
    scene = crosscheck.import_model(written(tmp_path, text, "robot.urdf"))
    assert scene.left_out == ()
    assert "motors without a control: of transmission 't'" in scene.description


def test_controls_and_limits_on_the_command_line(tmp_path, monkeypatch):
    """A position servo that is told where to go, and stops instead of monitors."""
    from crosscheck.cli.options import Reading, loaded

    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text("""<mujoco><compiler angle="radian"/><worldbody><body>
        <joint name="h" limited="true" range="-.5 1" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5" mass="1"/></body></worldbody>
        <actuator><position name="p" joint="h" kp="20"/></actuator></mujoco>""")
    scene = loaded("arm.xml", Reading(control=["p=0.7"], limits="keep"))
    assert [force.parameters["target"] for force in scene.forces if force.type == "servo"] == [0.7]
    assert scene.joints[0].limits[0].rigid
    assert not scene.monitors
    for bare in ("p", ".7", "=.7", "p="):
        with pytest.raises(crosscheck.ArgumentError, match=f"'{bare}' is not NAME=NUMBER"):
            loaded("arm.xml", Reading(control=[bare]))
