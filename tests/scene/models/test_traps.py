"""Attributes of model files that readers lose: each comes in as MuJoCo reads it, or is named."""

import re

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.mechanics import index1
from crosscheck.scene.models import known
from tests import saved
from tests.scene.models.model_files import ARM_URDF

ROUNDING = 1e-9  # relative to the largest acceleration: the mass matrices below have conditions of at most 1e4

ROD = '<inertial pos=".1 0 -.3" mass="1.5" diaginertia=".1 .12 .05"/>'
TWO = ('<body name="a" pos="0 0 1"><joint name="j" axis="0 1 0"{j}/>' + ROD + '<site name="s" pos="0 0 -.5"/>{a}'
       '<body name="b" pos="0 0 -.6"{b}><joint name="k" axis="1 0 0"{k}/>' + ROD + '<site name="t" pos="0 0 -.4"/>'
       '</body></body>')


def mjcf(top="", world="", rest="", **parts):
    two = TWO.format(**{"j": "", "k": "", "a": "", "b": ""} | parts) if "bare" not in parts else ""
    return f'<mujoco>{top}<worldbody>{world}{two}</worldbody>{rest}</mujoco>'


def urdf(*changes, end=""):
    text = ARM_URDF.replace('lower="-1" upper="1"', 'lower="-1e9" upper="1e9"')
    for old, new in changes:
        assert text.count(old) >= 1, old
        text = text.replace(old, new)
    return text.replace("</robot>", f"{end}</robot>")


def motors(words):
    return f"<actuator>{words}</actuator>"


def weld(words):
    fly = ('<body name="fly" pos=".2 0 -.1"><freejoint/>' + ROD + '<site name="u" pos="-.2 0 .6" euler="0 0 30"/>'
           '<site name="v" pos="-.2 0 .6"/></body>')
    return mjcf(world=fly, rest=f"<equality>{words}</equality>")


MESH = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 2 0 0 0 3 1 1 1"{}/></asset>'
BOX = '<body name="m"><joint axis="1 2 0"/><geom type="mesh" mesh="m" contype="0" conaffinity="0"/></body>'
GEOM = ('<body name="g"><joint axis="1 2 0"/><geom type="capsule" fromto="0 0 0 .1 .2 .5" size=".1" contype="0"{}/>'
        "</body>")

RIGHT = {
    "an axis and an angle": mjcf(b=' axisangle="1 2 0 30"'),
    "two axes that are not quite normal": mjcf(b=' xyaxes="1 .1 0 0 1 .3"'),
    "a shape along an axis": mjcf(world='<body name="g"><joint axis="1 2 0"/><geom type="cylinder" zaxis="1 1 2" '
                                  'size=".1 .3" pos="0 .1 .2" contype="0" conaffinity="0"/></body>'),
    "a damping ratio of a servo": mjcf(rest='<actuator><position joint="j" kp="5" dampratio=".7"/></actuator>'),
    "a default class": mjcf('<default><default class="x"><joint damping=".4"/></default></default>', j=' class="x"'),
    "a childclass": mjcf('<default><default class="x"><joint armature=".4"/></default></default>', b=' childclass="x"'),
    "nested frames": mjcf(world='<frame euler="10 20 30" pos="1 0 0"><frame quat="1 .5 0 0"><body name="f">'
                          '<joint axis="0 1 0"/>' + ROD + "</body></frame></frame>"),
    "a mirrored mesh": mjcf(MESH.format(' scale="-1 1 1"'), world=BOX),
    "a mesh with a place": mjcf(MESH.format(' refpos=".1 0 .3" refquat="1 0 1 0"'), world=BOX),
    "a mesh as a shell": mjcf(MESH.format(' inertia="shell"'), world=BOX),
    "degrees": mjcf(j=' ref="30" springref="20" stiffness="3"'),
    "radians": mjcf('<compiler angle="radian"/>', j=' ref=".3" springref=".2" stiffness="3"'),
    "another order of angles": mjcf('<compiler eulerseq="ZYX"/>', b=' euler="10 20 30"'),
    "a gear of a motor at rest": mjcf(rest=motors('<motor joint="j" gear="100"/>')),
    "bodies repeated": mjcf(world='<replicate count="3" euler="0 0 40" offset=".5 0 0"><body name="r">'
                            '<joint axis="0 1 0"/>' + ROD + "</body></replicate>"),
    "the total mass": mjcf('<compiler settotalmass="7"/>'),
    "least masses": mjcf('<compiler boundmass="2" boundinertia=".2"/>'),
    "balanced inertias": mjcf('<compiler balanceinertia="true"/>', world='<body name="p"><joint axis="1 0 0"/>'
                              '<inertial pos="0 0 1" mass="1" diaginertia="1 1 3"/></body>'),
    "groups with mass": mjcf('<compiler inertiagrouprange="0 1"/>', world=GEOM.format(' group="0"')),
    "inertia of shapes though given": mjcf('<compiler inertiafromgeom="true"/>', world=GEOM.format(""), bare=1),
    "a shell": mjcf(world=GEOM.format(' shellinertia="true"')),
    "spring by its frequency": mjcf(j=' springdamper=".5 .3"'),
    "no gravity": mjcf('<option><flag gravity="disable"/></option>'),
    "no springs": mjcf('<option><flag spring="disable"/></option>', j=' stiffness="5" damping=".3"'),
    "no dampers": mjcf('<option><flag damper="disable"/></option>', j=' stiffness="5" damping=".3"'),
    "an aligned free joint": mjcf(world='<body name="free" pos="0 3 0"><freejoint align="true"/>' + ROD + "</body>"),
    "compensated gravity": mjcf(b=' gravcomp=".7"'),
    "gravity compensated by no actuator": mjcf(b=' gravcomp=".7"', j=' actuatorgravcomp="true"',
                                               k=' actuatorgravcomp="true"'),
    "gravity compensated by an actuator": mjcf(b=' gravcomp=".7"', j=' actuatorgravcomp="true"',
                                               rest=motors('<motor joint="j"/>')),
    "a group of actuators off": mjcf('<option actuatorgroupdisable="2"/>',
                                     rest=motors('<position joint="j" kp="5" group="2"/>')),
    "actuators off": mjcf('<option><flag actuation="disable"/></option>', rest=motors('<position joint="j" kp="5"/>')),
    "a sphere of three hinges": mjcf(world='<body name="w" pos="0 2 0"><joint axis="1 0 0"/><joint axis="0 1 0"/>'
                                     '<joint axis="0 0 1"/>' + ROD + "</body>"),
    "a range that a motor's clamp leaves at rest": mjcf(rest=motors('<motor joint="j" ctrlrange="-1 2"/>')),
}
RIGHT |= {
    "repeated in repeated": mjcf(world='<replicate count="2" offset="0 2 0"><replicate count="2" euler="0 0 70" '
                                 'offset=".5 0 0"><body name="r"><joint axis="0 1 0"/>' + ROD + "</body></replicate>"
                                 "</replicate>"),
    "a keyframe that is not asked for": mjcf(rest='<keyframe><key name="up" qpos="1 -1" qvel="2 3"/></keyframe>'),
    "a default of tendons": mjcf('<default><tendon width=".1" rgba="1 0 0 1" stiffness="3"/></default>',
                                 rest='<tendon><spatial springlength=".2"><site site="s"/><site site="t"/></spatial>'
                                 "</tendon>"),
    "a class inside a class": mjcf('<default><joint damping=".2"/><default class="x"><joint armature=".1"/><default '
                                   'class="y"><joint damping=".7"/></default></default></default>', k=' class="y"'),
    "a frame in a body with a class": mjcf('<default><default class="x"><joint axis="0 0 1"/></default></default>',
                                           a='<frame pos=".1 0 0" euler="0 40 0" childclass="x"><body name="f"><joint/>'
                                           + ROD + "</body></frame>"),
}
CHAIN = ('<body name="c" pos="0 2 0"><joint name="c1" axis="1 0 0" armature=".02" damping=".1"/><joint name="c2" '
         'axis="0 1 .3" pos="0 .1 0" stiffness="2" springref=".1" range="-170 170"/>{}' + ROD + "</body>")
RIGHT |= {
    "two hinges apart": mjcf(world=CHAIN.format("")),
    "two hinges and a slide": mjcf(world=CHAIN.format('<joint name="c3" type="slide" axis="0 .6 .8" damping=".3"/>')),
    "two hinges and a ball": mjcf(world=CHAIN.format('<joint name="c3" type="ball" pos="0 0 -.2"/>')),
    "a spherical wrist with motors' armature": mjcf(
        world='<body name="w" pos="0 2 0"><joint axis="1 0 0" armature=".1"/><joint axis="0 1 0" armature=".2"/>'
        '<joint axis="0 0 1" armature=".3"/>' + ROD + "</body>"),
    "two slides": mjcf(world='<body name="w" pos="0 2 0"><joint type="slide" axis="1 0 0"/><joint type="slide" '
                       'axis="0 1 0"/>' + ROD + "</body>"),
    "a quill that is driven": mjcf(
        world='<body name="q" pos="0 2 0"><joint name="lift" type="slide" axis="0 0 1" range="-.5 .5" damping="3"/>'
        '<joint name="spin" axis="0 0 1" damping=".1"/>' + ROD + "</body>",
        rest='<actuator><position joint="lift" kp="80" kv="4"/><motor joint="spin"/></actuator>'),
}
"""Several joints on one body that are no joint of a scene have light bodies between them."""

NAMED = {
    "a joint's range of forces": (mjcf(j=' actuatorfrcrange="1 2"', rest=motors('<motor joint="k"/>')),
                                  "actuator force on joint 'j'"),
    "an actuator with two controls": (mjcf(rest=motors('<pid name="g" joint="j" kp="5" kv="1" input="pos vel"/>'
                                                       '<motor name="m" joint="k" ctrlrange="1 2"/>')),
                                      "actuator 'g'"),
    "gravity compensated by one joint": (mjcf(b=' gravcomp=".7"', k=' actuatorgravcomp="true"'),
                                         "gravity compensation by actuators of body 'b'"),
    "armature of an actuator": (mjcf(rest=motors('<motor name="m" joint="j" armature=".3"/>')), "actuator 'm'"),
    "a yielding spring": (mjcf(j=' stiffness="5" springyield=".1"'), "springyield of <joint> 'j' (line 1)"),
    "a nonlinear spring": (mjcf(j=' stiffness="5 2"'), "nonlinear stiffness of joint 'j'"),
    "sleep": (mjcf('<option><flag sleep="enable"/></option>'), "sleep of <flag>"),
    "drag of an ellipsoid": (mjcf('<option viscosity=".1"/>', a='<geom type="ellipsoid" size=".1 .2 .3" mass="0" '
                                  'contype="0" fluidshape="ellipsoid"/>'), "drag of the medium"),
    "wind": (mjcf('<option wind="1 0 0" density="1.2"/>'), "drag of the medium"),
    "a mesh that is missing": (mjcf('<compiler inertiafromgeom="true"/><asset><mesh name="m" file="no.stl"/></asset>',
                                    a='<geom type="mesh" mesh="m"/><geom size=".1" contype="0"/>'), "no.stl"),
    "a weld that is open": (weld('<weld name="w" body1="a" body2="fly" relpose="0 0 2 1 0 0 0"/>'),
                            "equality 'w', which is open by"),
    "a weld by two points that do not meet": (
        weld('<weld body1="a" body2="fly" anchor=".1 .2 .3" relpose=".2 0 -1.1 1 0 0 0"/>'), "open by 0.374 m"),
    "a weld of turned sites": (weld('<weld site1="s" site2="u"/>'), "and 30 degrees"),
    "a coupling of higher order": (mjcf(rest='<equality><joint name="e" joint1="j" joint2="k" polycoef="0 1 2 0 0"/>'
                                        "</equality>"), "equality 'e'"),
    "a coupled tendon": (mjcf(rest='<tendon><fixed name="t"><joint joint="j" coef="1"/><joint joint="k" coef="2"/>'
                              '</fixed></tendon><equality><tendon name="e" tendon1="t"/></equality>'), "equality 'e'"),
    "options of a URDF": (urdf(end='<mujoco><compiler boundmass="3"/></mujoco>'), "boundmass of <compiler>"),
    "masses of shapes in a URDF": (urdf(end='<mujoco><compiler inertiafromgeom="true"/></mujoco>'), "inertiafromgeom"),
    "a rotor of Drake": (urdf(('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><drake:rotor_inertia value="1"/>')),
                         "<drake:rotor_inertia>"),
    "a loop of Drake": (urdf(end='<drake:ball_constraint/>'), "<drake:ball_constraint>"),
    "a loop of another program": (urdf(end='<loop_joint name="l"/>'), "<loop_joint> 'l' (line 20)"),
    "a link that moves without mass": (urdf(('<mass value="0.2"/>', '<mass value="0"/>')),
                                       "give each that moves an inertial"),
    "two roots": (urdf(end='<link name="other"/>'), "2 roots, 'base', 'other'"),
    "limits that leave no room": (urdf(('lower="-1e9" upper="1e9"', 'lower="0" upper="0"')), "limits of joint 'reach'"),
    "limits left out": (urdf(('lower="-1e9" upper="1e9"', "")), "limits of joint 'reach'"),
    "limits exchanged": (urdf(('lower="-1e9" upper="1e9"', 'lower="1" upper="-1"')),
                         "limits of joint 'reach': 1, -1"),
    "limits in words": (urdf(('lower="-1e9"', 'lower="far"')), "<limit> (line 18): 'far' is not written in numbers"),
    "two numbers for three": (urdf(('xyz="0 0 1"', 'xyz="0 1"')), "(line 18): xyz has 2 numbers, not three"),
    "an inertial without mass": (urdf(('<mass value="0.1"/>', "")), "the inertial of link 'tool', which has no mass"),
    "another spelling of an attitude": (urdf(('rpy="0.2 0.1 0"', 'quat_xyzw="0 1 0 0"')), "quat_xyzw"),
    "gravity off in Gazebo": (urdf(end='<gazebo reference="upper"><turnGravityOff>1</turnGravityOff></gazebo>'),
                              "turnGravityOff"),
}

NAMED |= {
    "halves of an inertia that differ": (urdf(('ixz="0.002"', 'ixz="0.002" izx="0.003"')), "izx of <inertia>"),
    "gravity off in another spelling": (urdf(end='<gazebo reference="upper"><gravity>false</gravity></gazebo>'),
                                        "the element gravity of <gazebo>"),
    "a joint that follows one that is not there": (
        urdf(('<joint name="elbow" type="continuous">', '<joint name="elbow" type="continuous"><mimic joint="no"/>')),
        "mimic of joint 'elbow'"),
    "a rope of bodies": (mjcf(world='<body name="h" pos="0 5 2"><composite type="cable" curve="s 0 0" count="5 1 1" '
                              'size="1"><geom type="capsule" size=".02"/></composite></body>'),
                         "<composite> (line 1), which MuJoCo refuses"),
    "a sensor of what is not there": (mjcf(rest='<sensor><gyro name="g" site="no"/></sensor>'),
                                      "<gyro> 'g' (line 1), which MuJoCo refuses"),
    "a tendon over a joint that is not there": (mjcf(rest='<tendon><fixed name="t"><joint joint="j" coef="1"/><joint '
                                                     'joint="no" coef="1"/></fixed></tendon>'), "<fixed> 't' (line 1)"),
    "an attribute of an older version": (mjcf('<option collision="all"/>'), "the attribute collision of <option>"),
    "a body that bends": (mjcf(world='<body name="h" pos="0 5 2"><flexcomp name="x" type="grid" count="3 3 1" '
                               'spacing=".1 .1 .1" radius=".01" mass="1" dim="2"/></body>'),
                          "the flexible body <flexcomp> 'x'"),
    "a coupled chain of joints that ends in a circle": (
        mjcf(rest='<equality><joint joint1="j" joint2="k"/><joint joint1="k" joint2="j"/></equality>'),
        "j follows k follows j"),
}
HARMLESS = {
    "both halves of an inertia": (('ixz="0.002"', 'ixz="0.002" izx="0.002"'),),
    "gravity on in Gazebo": (('<link name="base"/>', '<link name="base"/><gazebo reference="upper"><gravity>1</gravity>'
                              "<turnGravityOff>false</turnGravityOff></gazebo>"),),
    "a frame and a filter of contacts of Drake": (('<link name="base"/>', '<link name="base"/><frame name="f" '
                                                   'link="base"/><drake:collision_filter_group name="g"/>'),),
    "a world that is not declared": (('<link name="base"/>', ""), ('parent link="base"', 'parent link="world"')),
    "limits of accelerations": (('effort="1"', 'effort="1" drake:acceleration="9" current="3"'),),
}

WELDS = {
    "a weld by a pose": '<weld body1="a" body2="fly" relpose=".2 0 -1.1 1 0 0 0"/>',
    "a weld by a pose and an anchor": '<weld body1="a" body2="fly" anchor=".1 .2 .3" relpose=".3 .2 -.8 1 0 0 0"/>',
    "a weld by an anchor": '<weld body1="a" body2="fly" anchor=".1 .2 .3"/>', "a weld": '<weld body1="a" body2="fly"/>',
    "a weld to the world": '<weld body1="fly" anchor=".1 .2 .3"/>', "a weld of sites": '<weld site1="s" site2="v"/>',
    "a connect": '<connect body1="a" body2="fly" anchor="1 2 3"/>',
    "a connect to the world": '<connect body1="fly" anchor="1 2 3"/>'}


@pytest.mark.parametrize(("suffix", "text", "named"), [
    ("urdf", urdf(('axis xyz="0 1 0"', 'axis xyz="0 nan 0"')), "its axis is not finite"),
    ("xml", mjcf(j=' pos="0 nan 0"'), "joint 'j': its pos is not finite"),
])
def test_what_is_no_number_is_named(suffix, text, named, tmp_path):
    """MuJoCo compiles it."""
    path = saved(tmp_path / f"model.{suffix}", text)
    with pytest.raises(crosscheck.SceneError, match=named):
        crosscheck.import_model(path)


@pytest.mark.parametrize("name", RIGHT)
def test_what_is_read_moves_as_in_mujoco(name, tmp_path):
    import mujoco

    path = saved(tmp_path / "robot.xml", RIGHT[name])
    m = mujoco.MjModel.from_xml_path(str(path))
    d, rng = mujoco.MjData(m), np.random.default_rng(len(name))
    mujoco.mj_integratePos(m, d.qpos, 0.3 * rng.normal(size=m.nv), 1.0)
    d.qvel[:] = rng.normal(size=m.nv)
    mujoco.mj_forward(m, d)
    scene = crosscheck.import_model(path, qpos=d.qpos, qvel=d.qvel)
    assert scene.left_out == ()
    a, alpha, _ = index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    mujoco.mj_rnePostConstraint(m, d)
    for k, body in enumerate(scene.bodies[:m.nbody - 1]):  # frames come last
        rate, number = np.zeros((6, 1)), m.body(body.name).id
        mujoco.mj_objectAcceleration(m, d, mujoco.mjtObj.mjOBJ_BODY, number, rate, 0)
        assert np.isclose(m.body_mass[number], body.mass, rtol=1e-12)
        size = max(1.0, float(np.abs(rate).max()))
        np.testing.assert_allclose(a[0, k] - scene.gravity, rate[3:, 0], atol=ROUNDING * size)
        np.testing.assert_allclose(scene.R0[k] @ alpha[0, k], rate[:3, 0], atol=ROUNDING * size)


@pytest.mark.parametrize("name", NAMED)
def test_what_is_not_read_is_named(name, tmp_path):
    text, words = NAMED[name]
    path = saved(tmp_path / ("robot.urdf" if "<robot" in text else "robot.xml"), text)
    with pytest.raises(crosscheck.SceneError) as caught:
        crosscheck.import_model(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    if "--drop" in str(caught.value):
        assert words in " ".join(map(str, crosscheck.import_model(path, drop=True).left_out))


@pytest.mark.parametrize("name", HARMLESS)
def test_what_says_nothing_about_the_motion_changes_nothing(name, tmp_path):
    scenes = []
    for place, text in (("a", urdf()), ("b", urdf(*HARMLESS[name]))):
        (tmp_path / place).mkdir()
        path = saved(tmp_path / place / "robot.urdf", text)
        scenes.append(crosscheck.import_model(path))
    assert scenes[0].hash == scenes[1].hash
    assert scenes[1].left_out == ()


@pytest.mark.parametrize("attribute", ["K", "mu_viscous"])
def test_an_attribute_that_no_reader_takes_is_named_and_no_refusal(tmp_path, attribute):
    path = saved(tmp_path / "robot.urdf", urdf(('damping="2"', f'damping="2" {attribute}="7000"')))
    scene = crosscheck.import_model(path)
    assert scene.left_out == (("", f"the attribute {attribute} of <dynamics> (line 19)", (7000.0,)),)
    assert scene.joints[-1].damping == (2.0,)


def test_followers_of_followers_start_where_their_leaders_put_them(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(urdf(('<joint name="elbow" type="continuous">', '<joint name="elbow" type="continuous">'
                          '<mimic joint="shoulder" multiplier="2" offset=".1"/>'),
                         ('<joint name="reach" type="prismatic">', '<joint name="reach" type="prismatic">'
                          '<mimic joint="elbow" multiplier="-.5" offset=".3"/>')))
    scene = crosscheck.import_model(path, qpos=None, start=3)
    q, e, r = (joint.start[0] for joint in scene.joints)
    assert abs(q) > 1e-3
    assert (e, r) == pytest.approx((2 * q + 0.1, 0.3 - 0.5 * e), abs=1e-12)


def test_the_list_of_known_words_is_that_of_the_schema_of_mujoco():
    """A word that MuJoCo lacks is a typing error; one that a new release adds has to be read or named."""
    import mujoco

    schema: dict[str, set[str]] = {}
    tag = ""
    for line in mujoco.mj_printSchema(False, False).splitlines():
        head = re.match(r" *([\w()]+) \([!*?R]\)(.*)", line)
        tag, words = (head[1], head[2]) if head else (tag, line)
        schema.setdefault(tag, set()).update(words.split())
    for tag in ("compiler", "option", "flag", "inertial", "freejoint", "key"):
        assert set(str(known.MJCF[tag]).split()) - {"passive"} <= schema[tag], tag  # a flag of older releases
    missing = {tag: schema[tag] - set(str(known.MJCF[tag]).split()) for tag in ("compiler", "option", "flag", "key")}
    assert missing == {"compiler": {"passthrough"}, "option": set(), "flag": {"sleep"}, "key": {"plastic"}}


@pytest.mark.parametrize("name", WELDS)
def test_a_loop_is_the_constraint_of_mujoco(name, tmp_path):
    path = saved(tmp_path / "robot.xml", weld(WELDS[name]))
    scene = crosscheck.import_model(path)
    assert scene.left_out == ()
    joint = scene.joints[-1]
    assert joint.type == ("fixed" if "weld" in name else "spherical")
    # the ends coincide where MuJoCo's own residual is zero, and there only
    import mujoco

    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    assert np.abs(d.efc_pos).max() < 1e-12
    mujoco.mj_integratePos(m, d.qpos, 0.2 * np.random.default_rng(1).normal(size=m.nv), 1.0)
    mujoco.mj_forward(m, d)
    residual = d.efc_pos[:3].copy()
    ends = []
    for body, anchor in ((joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor)):
        x, R = (np.zeros(3), np.eye(3)) if body < 0 else (d.body(scene.bodies[body].name).xipos,
                                                          d.body(scene.bodies[body].name).xmat.reshape(3, 3))
        ends.append(x + R @ anchor)
    assert min(np.abs(ends[0] - ends[1] - sign * residual).max() for sign in (1, -1)) < 1e-12
    assert np.abs(residual).max() > 1e-2
