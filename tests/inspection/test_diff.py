"""Pairs of models that are the same under other names, orders, axes and formats, and pairs with one change."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
from crosscheck.scene.building import scene_from
from tests.scene.models.model_files import ARM_MJCF, ARM_URDF, ZOO

ROBOT = """<mujoco><compiler angle="radian"/><worldbody>
<body name="torso" pos="0 0 1"><joint name="waist" axis="0 0 1" damping=".2" armature=".05"/>
 <inertial pos=".1 0 .2" mass="4" fullinertia=".2 .25 .15 .01 .02 .03"/>
 <body name="left" pos="0 .3 .4"><joint name="ls" axis="0 1 0" stiffness="3" springref=".4" pos="0 .1 0"/>
  <inertial pos=".1 .02 -.3" mass="1.5" fullinertia=".1 .12 .05 .01 .002 0"/>
  <body name="fore" pos=".2 0 -.6"><joint name="le" axis=".6 .8 0"/><site name="tip" pos="0 0 -.4"/>
   <inertial pos="0 .02 -.2" mass=".7" fullinertia=".02 .025 .01 0 0 .001"/></body></body>
 <body name="right" pos="0 -.3 .4"><joint name="rs" axis="0 1 0"/>
  <inertial pos=".1 -.02 -.3" mass="1.6" diaginertia=".1 .12 .05"/>
  <body name="rod" pos="0 0 -.5"><joint name="rod" type="slide" axis="0 0 1" damping="2"/>
   <inertial pos="0 .1 -.2" mass=".4" diaginertia=".02 .03 .025"/><site name="pin" pos="0 0 -.3"/></body></body>
 <body name="head" pos="0 0 .6"><joint name="neck" type="ball"/>
  <inertial pos=".02 0 .1" mass=".9" diaginertia=".01 .012 .013"/></body></body>
<body name="ball" pos="1 0 2"><freejoint/><inertial pos="0 0 .1" mass=".5" diaginertia=".01 .02 .015"/></body>
</worldbody>
<tendon><spatial stiffness="7" damping=".1" springlength=".5"><site site="tip"/><site site="pin"/></spatial></tendon>
<equality><joint joint1="rs" joint2="ls" polycoef="0 .5 0 0 0"/></equality></mujoco>"""

BAR = ('<body name="{0}" pos="{1} 0 0"><joint name="j{0}" axis="0 1 0"/><inertial pos=".5 .1 0" mass="1" '
       'diaginertia=".1 .1 .1"/>{2}</body>')
LOOP = (f"<mujoco><worldbody>{BAR.format('a', 0, BAR.format('b', 1, ''))}{BAR.format('c', 2, '')}</worldbody><equality>"
        '<connect name="closed" body1="b" body2="c" anchor="1 0 0"/></equality></mujoco>')


def turned_frame(text):
    """The robot with the axes of its forearm turned by 90 degrees about x: its own y was z, its own -z was y."""
    old = text[text.index('<body name="fore"'):text.index("</body></body>")]
    new = ('<body name="fore" pos=".2 0 -.6" quat="0.7071067811865476 0.7071067811865476 0 0"><joint name="le" '
           'axis=".6 0 -.8"/><site name="tip" pos="0 -.4 0"/><inertial pos="0 -.2 -.02" mass=".7" '
           'fullinertia=".02 .01 .025 0 0 -.001"/>')
    return text.replace(old, new)


def swapped(text):
    """The robot with its arms in the other order."""
    left, right = text[text.index(' <body name="left"'):text.index(' <body name="right"')], text[
        text.index(' <body name="right"'):text.index(' <body name="head"')]
    return text.replace(left + right, right + left)


def renamed(text):
    names = ["torso", "waist", "left", "fore", "right", "rod", "head", "neck", "ls", "le", "rs", "ball"]
    for k, name in enumerate(names):
        text = text.replace(f'name="{name}"', f'name="x{k}"').replace(f'joint1="{name}"', f'joint1="x{k}"').replace(
            f'joint2="{name}"', f'joint2="x{k}"')
    return text


def split(text):
    """The forearm as two bodies welded together: half of it each."""
    half = '<inertial pos="0 .02 -.2" mass=".35" fullinertia=".01 .0125 .005 0 0 .0005"/>'
    whole = '<inertial pos="0 .02 -.2" mass=".7" fullinertia=".02 .025 .01 0 0 .001"/>'
    return text.replace(whole, f'{half}<body name="more">{half}</body>')


def exported(text, ending=".xml"):
    return lambda folder: made(folder, text, "one"), ending


def arm_as_mjcf():
    turn = Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_matrix()
    J = turn @ np.array([[0.1, 0.01, 0.002], [0.01, 0.12, 0.0], [0.002, 0.0, 0.05]]) @ turn.T
    quats = [" ".join(map(repr, Rotation.from_euler("xyz", angles).as_quat(scalar_first=True).tolist()))
             for angles in ([0.2, 0.1, 0.0], [0.0, 0.0, 0.4])]
    inertia = " ".join(repr(float(J[entry])) for entry in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    return ARM_MJCF.format(quat=quats[0], turn=quats[1], inertia=inertia)


ARM = ARM_URDF.replace('lower="-1" upper="1" effort="1"', 'lower="-1e9" upper="1e9" effort="1e9"')
DEGREES = ROBOT.replace('<compiler angle="radian"/>', "").replace(
    'springref=".4"', f'springref="{float(np.degrees(0.4))!r}"')

SAME = {
    "itself": (ROBOT, ROBOT), "other names": (ROBOT, renamed(ROBOT)), "another order": (ROBOT, swapped(ROBOT)),
    "names and order": (ROBOT, renamed(swapped(ROBOT))), "other axes": (ROBOT, turned_frame(ROBOT)),
    "axes, names and order": (renamed(swapped(ROBOT)), turned_frame(ROBOT)), "welded parts": (ROBOT, split(ROBOT)),
    "degrees": (ROBOT, DEGREES), "other numbers for one inertia": (
        ROBOT.replace('diaginertia=".1 .12 .05"', 'fullinertia=".1 .12 .05 0 0 0"'), ROBOT),
    "anchors along an axis": (ROBOT, ROBOT.replace('springref=".4" pos="0 .1 0"', 'springref=".4" pos="0 .7 0"')),
    "a slide from elsewhere": (ROBOT, ROBOT.replace('type="slide"', 'type="slide" pos="1 2 3"')),
    "a default class": (ROBOT, ROBOT.replace('damping=".2"', 'class="d"').replace(
        "<worldbody>", '<default><default class="d"><joint damping=".2"/></default></default><worldbody>')),
    "a frame around": (ROBOT, ROBOT.replace('<body name="torso" pos="0 0 1">', '<frame pos="0 0 1"><body name="torso">')
                       .replace('<body name="ball"', '</frame><body name="ball"')),
    "the loop from its other end": (LOOP, LOOP.replace('body1="b" body2="c" anchor="1 0 0"',
                                                       'body1="c" body2="b" anchor="0 0 0"')),
    "URDF and MJCF": (ARM, arm_as_mjcf()),
    "URDF with other names": (ARM, ARM.replace('"upper"', '"x"').replace("elbow", "y")),
    "a loop": (LOOP, LOOP.replace('name="closed"', 'name="other"').replace('"c"', '"z"')),
    "there and back": (ROBOT, exported(ROBOT)), "the zoo": (ZOO, ZOO.replace('"b"', '"q"')),
    "a URDF there and back": (ARM, exported(ARM, ".urdf")), "a URDF as MJCF": (ARM, exported(ARM)),
}

ONE_CHANGE = [
    ('mass="1.5"', 'mass="1.6"', "left", "mass"), ('mass=".9"', 'mass=".901"', "head", "mass"),
    ('mass=".4"', 'mass=".4000004"', "rod", "mass"), ('mass=".5"', 'mass=".6"', "ball", "mass"),
    ('fullinertia=".1 .12 .05 .01 .002 0"', 'fullinertia=".1 .12 .05 .01 -.002 0"', "left", "inertia"),
    ('diaginertia=".1 .12 .05"', 'diaginertia=".12 .1 .05"', "right", "inertia"),
    ('diaginertia=".01 .02 .015"', 'diaginertia=".01 .02 .016"', "ball", "inertia"),
    ('pos="0 .02 -.2"', 'pos="0 .02 -.21"', "fore", "centre of mass"),
    ('pos=".1 .02 -.3"', 'pos=".1 .03 -.3"', "left", "centre of mass"),
    ('pos=".02 0 .1"', 'pos=".02 .01 .1"', "head", "centre of mass"),
    ('pos="0 .3 .4"', 'pos="0 .31 .4"', "ls", "place"), ('pos=".2 0 -.6"', 'pos=".2 0 -.7"', "le", "place"),
    ('pos="0 0 .6"', 'pos="0 0 .65"', "neck", "place"), ('axis=".6 .8 0"', 'axis=".6 .8 .1"', "le", "axis"),
    ('axis="0 0 1" damping=".2"', 'axis="0 .01 1" damping=".2"', "waist", "axis"),
    ('type="slide" axis="0 0 1"', 'type="slide" axis="0 0 -1"', "rod", "axis"),
    ('pos=".2 0 -.6"', 'pos=".2 0 -.6" euler="0 0 .3"', "le", "frame"),
    ('<body name="rod" pos="0 0 -.5">', '<body name="rod" pos="0 0 -.5" euler="0 .2 0">', "rod", "frame"),
    ('damping=".2"', 'damping=".3"', "waist", "damping"), ('damping="2"', 'damping="20"', "rod", "damping"),
    ('armature=".05"', 'armature=".5"', "waist", "armature"), (' armature=".05"', "", "waist", "armature"),
    ('stiffness="3"', 'stiffness="3.1"', "ls", "stiffness"),
    ('springref=".4"', 'springref=".5"', "ls", "rest_position"),
    ('polycoef="0 .5 0 0 0"', 'polycoef="0 -.5 0 0 0"', "rs", "mimic"),
    ('polycoef="0 .5 0 0 0"', 'polycoef=".1 .5 0 0 0"', "rs", "mimic"),
    ('stiffness="7"', 'stiffness="8"', "rod", "stiffness of linear_spring"),
    ('springlength=".5"', 'springlength=".6"', "rod", "free_length of linear_spring"),
    ('site name="tip" pos="0 0 -.4"', 'site name="tip" pos="0 0 -.41"', "", "point of linear_spring"),
    ('<joint name="rs" axis="0 1 0"/>', '<joint name="rs" type="slide" axis="0 1 0"/>', "rs", "joint type"),
    ('<joint name="neck" type="ball"/>', '<joint name="neck" axis="0 1 0"/>', "neck", "joint type"),
    ('<compiler angle="radian"/>', '<compiler angle="radian"/><option gravity="0 0 -9.8"/>', "", "gravity"),
    ("<freejoint/>", '<joint axis="0 1 0"/>', "", "joint type"),
    ('<body name="ball"', '<body name="extra" pos="3 0 0"><joint axis="1 0 0"/><inertial pos="0 0 .1" mass=".3" '
     'diaginertia=".01 .02 .015"/></body><body name="ball"', "extra", "body"),
    ('<joint name="le"', '<joint name="le" range="-1 1"', "le", "limits"),
    ('<joint name="le"', '<joint name="le" frictionloss=".2"', "le", "dry friction"),
]
"""What is replaced by what in the robot, the place (all of it if "") and the quantity that have to be named."""


def made(folder, text, name):
    if isinstance(text, tuple):
        source, ending = text
        crosscheck.export_model(crosscheck.import_model(source(folder), drop=True), folder / f"{name}-again{ending}")
        return folder / f"{name}-again{ending}"
    path = folder / f"{name}{'.urdf' if '<robot' in text else '.xml'}"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", SAME)
def test_the_same_model_is_the_same(name, tmp_path):
    one, other = (made(tmp_path, text, place) for text, place in zip(SAME[name], "ab", strict=True))
    report = crosscheck.diff(one, other)
    assert report.same, report.lines
    assert report.moves < 1e-9
    assert len(report.pairs) == crosscheck.import_model(one, drop=True).n


@pytest.mark.parametrize(("old", "new", "where", "what"), ONE_CHANGE, ids=[
    f"{what} of {where or 'the robot'}" for *_, where, what in ONE_CHANGE])
@pytest.mark.parametrize("disguise", [str, lambda text: renamed(swapped(text))], ids=["plain", "disguised"])
def test_one_change_is_named_with_its_place(old, new, where, what, disguise, tmp_path):
    assert ROBOT.count(old) == 1, old
    one, other = made(tmp_path, ROBOT, "a"), made(tmp_path, disguise(ROBOT.replace(old, new)), "b")
    report = crosscheck.diff(one, other)
    assert not report.same
    assert any(what in each.what and where in each.where for each in report.differences), report.lines
    allowed = 3 if what in ("joint type", "mass") else 2  # another type has other keys
    assert len({(each.where, each.what) for each in report.differences}) <= allowed, report.lines


HELD = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="elbow" axis="0 1 0" frictionloss=".3"
 range="-2.4 2.4" limited="true" actuatorfrcrange="-40 40" actuatorfrclimited="true"/>
 <inertial pos=".2 0 0" mass="1" diaginertia=".1 .1 .1"/></body></worldbody>
 <actuator><position joint="elbow" kp="20"/></actuator></mujoco>"""


@pytest.mark.parametrize(("old", "new", "what", "values"), [
    ('frictionloss=".3"', 'frictionloss="3"', "dry friction", (0.3, 3.0)),
    ('frictionloss=".3"', "", "dry friction", (0.3, "missing")),
    ("-2.4 2.4", "-2.4 .5", "limits", ((-2.4, 2.4), (-2.4, 0.5))),
    ("-40 40", "-1 1", "effort limits", ((-40.0, 40.0), (-1.0, 1.0))),
    ('kp="20"', 'kp="2"', "gear, gain and bias of actuators", None)])
def test_what_a_scene_cannot_hold_is_compared_by_value(old, new, what, values, tmp_path):
    assert HELD.count(old) == 1
    one, same = made(tmp_path, HELD, "a"), made(tmp_path, HELD.replace("elbow", "e"), "b")
    assert crosscheck.diff(one, same).same, crosscheck.diff(one, same).lines
    report = crosscheck.diff(one, made(tmp_path, HELD.replace(old, new), "c"))
    found = {each.what: (each.a, each.b) for each in report.differences if each.where == "elbow"}
    assert what in found, report.lines
    assert values is None or found[what] == values


@pytest.mark.parametrize(("shape", "same"), [("box size='.2 .1 .1'", True), ("box size='.2 .1 .3'", False),
                                             ("sphere radius='.1'", False)])
def test_collision_shapes_are_compared_by_value(shape, same, tmp_path):
    form = "<collision><geometry><{}/></geometry></collision></link>"
    one, other = (made(tmp_path, ARM_URDF.replace("</link>", form.format(each)), name)
                  for each, name in (("box size='.2 .1 .1'", "a.urdf"), (shape, "b.urdf")))
    report = crosscheck.diff(one, other)
    assert {each.what for each in report.differences} == (set() if same else {"collision shapes"}), report.lines


def test_limits_of_velocities_are_compared_between_urdfs(tmp_path):
    one, other = (made(tmp_path, ARM_URDF.replace("</joint>", f'<limit effort="9" velocity="{speed}"/></joint>'), name)
                  for speed, name in ((2.5, "a.urdf"), (3.5, "b.urdf")))
    found = {(each.what, each.a, each.b) for each in crosscheck.diff(one, other).differences}
    assert found == {("velocity limits", (2.5,), (3.5,))}


def watched(**changes):
    """A box that falls to the floor on a round foot, which is watched."""
    size, attitude = changes.get("box", ([0.1, 0.2, 0.3], [1.0, 0.0, 0.0, 0.0]))
    shapes = [{"name": changes.get("name", "foot"), "body": "b", "type": "sphere", "size": [changes.get("radius", 0.1)],
               "position": changes.get("position", [0.0, 0.0, -0.3])},
              {"name": "crate", "body": "b", "type": "box", "size": size, "attitude": attitude},
              {"name": "floor", "body": "ground", "type": "plane"}]
    monitors = [{"type": "touch", "shapes": [shapes[0]["name"], "floor"], "margin": changes.get("margin", 0.01)}]
    return scene_from({
        "schema": 3, "name": "crate", "gravity": [0.0, 0.0, -9.81], "duration": 0.1, "samples": 2, "shapes": shapes,
        "monitors": monitors[:changes.get("monitors", 1)],
        "bodies": [{"name": "b", "mass": 1.0, "inertia": np.diag([0.1, 0.11, 0.12]).tolist(), "position": [0, 0, 1.0],
                    "angular_velocity": [1.0, 2.0, 0.5]}]}, "crate")


@pytest.mark.parametrize(("changes", "where", "what"), [
    ({"margin": 0.02}, "floor and foot", "margin of a watched touch"), ({"monitors": 0}, "floor and foot", "margin"),
    ({"radius": 0.2}, "foot", "size of the shape"), ({"position": [0.0, 0.0, -0.31]}, "foot", "place of the shape"),
    ({"box": ([0.1, 0.2, 0.3], [0.8, 0.6, 0.0, 0.0])}, "crate", "turn of the shape")])
def test_what_ends_a_claim_is_compared(changes, where, what):
    report = crosscheck.diff(watched(), watched(**changes))
    assert [each.where for each in report.differences] == [where], report.lines
    assert what in report.differences[0].what


@pytest.mark.parametrize("changes", [{}, {"name": "heel"}, {"box": ([0.2, 0.1, 0.3], [0.5**0.5, 0.0, 0.0, 0.5**0.5])}])
def test_shapes_are_compared_whatever_their_names_and_axes(changes):
    assert crosscheck.diff(watched(), watched(**changes)).same


def test_a_scene_is_compared_with_a_model_and_names_are_matched(tmp_path):
    path = made(tmp_path, renamed(ROBOT), "b")
    report = crosscheck.diff(crosscheck.import_model(made(tmp_path, ROBOT, "a"), drop=True), path)
    assert ("fore", "x3") in report.pairs
    assert ("le", "x9") in report.joints
    with pytest.raises(crosscheck.SceneError, match="no built-in scene"):
        crosscheck.diff("no_such_scene", path)


@pytest.mark.parametrize(("change", "code"), [(("", ""), 0), (('mass="4"', 'mass="5"'), 1),
                                               (("<mujoco>", "<html>"), 2)])
def test_the_command_answers_by_its_exit_code(change, code, tmp_path):
    from typer.testing import CliRunner

    from crosscheck.cli.app import app

    one, other = made(tmp_path, ROBOT, "a"), made(tmp_path, ROBOT.replace(*change), "b")
    told = CliRunner().invoke(app, ["inspect", str(one), str(other)])
    refused = isinstance(told.exception, crosscheck.SceneError)  # which `main` turns into exit code 2
    assert (2 if refused else told.exit_code) == code
    if code == 1:
        assert "torso: mass: 4 and 5" in told.output


def test_a_model_differs_from_a_scene_that_has_dropped_its_friction(tmp_path):
    """The scene that keeps all of it is the same; the one that left it out differs in one line."""
    path = made(tmp_path, ROBOT.replace('<joint name="le"', '<joint name="le" frictionloss=".2"'), "a")
    assert crosscheck.diff(path, crosscheck.import_model(path)).same
    report = crosscheck.diff(path, crosscheck.import_model(path, drop=True))
    assert [line for line in report.lines if "dry friction" in line] == ["le: dry friction: 0.2 and left out (0.2)"]
    back = crosscheck.diff(crosscheck.import_model(path, drop=True), path)
    assert [line for line in back.lines if "dry friction" in line] == ["le: dry friction: left out (0.2) and 0.2"]


def link(name, at, mass):
    return (f'<link name="{name}"><inertial><origin xyz="{at} 0 .01" rpy="0 0 .2"/><mass value="{mass}"/><inertia '
            'ixx=".0031" iyy=".02" izz=".021" ixy="0" ixz=".0005" iyz="0"/></inertial><collision><origin '
            f'xyz="{at} 0 0"/><geometry><box size=".1 .04 .04"/></geometry></collision></link>')


def hinge(name, parent, child, kind="revolute"):
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            '<origin xyz=".3 0 .1"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="2"/></joint>')


FUSED = ('<robot name="fused">' + link("stand", 0, 4) + link("upper", .15, 2.1) + link("lower", .12, 1.3)
         + link("tool", 0, .3) + hinge("lift", "stand", "upper") + hinge("bend", "upper", "lower")
         + hinge("flange", "lower", "tool", "fixed") + "</robot>")
"""A stand that is fused to the world and a tool that is fused to a link, both with shapes that may collide."""


def test_a_file_that_mujoco_wrote_of_another_is_the_same_robot(tmp_path):
    """It has six digits, and no body for what is fused to the world: contacts with that are those with the ground."""
    import mujoco

    given, written = tmp_path / "robot.urdf", tmp_path / "robot.xml"
    given.write_text(FUSED)
    mujoco.mj_saveLastXML(str(written), mujoco.MjModel.from_xml_path(str(given)))
    for pair in ((given, written), (written, given)):
        found = crosscheck.diff(*pair)
        assert found.same, found
        assert {each.what for each in found.rounded} <= {"inertia", "centre of mass", "mass", "frame"}
        assert found.rounded
        assert "the same motion to 6 digits" in found.lines[0]
        assert "equal to 6 digits, to which a file is rounded: " in str(found)
    text = written.read_text()
    for old, new in (('mass="2.1"', 'mass="2.1001"'), ('range="-2 2"', 'range="-2 2.001"')):
        other = tmp_path / "other.xml"
        other.write_text(text.replace(old, new, 1))
        assert other.read_text() != text
        found = crosscheck.diff(given, other)
        assert [each.what for each in found.differences] == ["mass" if "mass" in old else "limits"], found
    apart = tmp_path / "apart.xml"  # the lower link no longer collides with the ground
    apart.write_text(text.replace(
        "</worldbody>", "</worldbody><contact><exclude body1='world' body2='lower'/></contact>"))
    found = crosscheck.diff(given, apart)
    assert [str(each) for each in found.differences] == [
        "ground - lower: contacts of the colliding bodies: there and missing"]
