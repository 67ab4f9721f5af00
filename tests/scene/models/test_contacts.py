"""Contacts of model files: the collision shapes of a URDF are watched as those of an MJCF are."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.errors import Unsupported

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("coal")

MJCF = """<mujoco model="arm"><compiler angle="radian"/><option gravity="0 0 -9.81"/>
<worldbody><geom name="base" type="cylinder" size=".08 .05" pos="0 0 .05"/>
<body name="turret" pos="0 0 .1"><inertial pos="0 0 .1" mass="3.2" diaginertia=".012 .012 .006"/>
 <joint name="pan"/><geom type="cylinder" size=".05 .09" pos="0 0 .1"/>
 <body name="upper" pos="0 0 .2"><inertial pos=".15 0 0" mass="2.1" diaginertia=".003 .02 .021"/>
  <joint name="lift" axis="0 1 0"/><geom type="capsule" size=".035 .13" pos=".15 0 0" euler="0 1.5708 0"/>
  <body name="fore" pos=".3 0 0"><inertial pos=".12 0 0" mass="1.3" diaginertia=".001 .009 .009"/>
   <joint name="elbow" axis="0 1 0"/><geom type="box" size=".1 .03 .03" pos=".14 0 0"/>
</body></body></body></worldbody></mujoco>"""

LINK = ('<link name="{}"><inertial><origin xyz="{}"/><mass value="{}"/><inertia ixx="{}" iyy="{}" izz="{}"/></inertial>'
        '<collision><origin xyz="{}" rpy="{}"/><geometry>{}</geometry></collision></link>')
JOINT = ('<joint name="{}" type="continuous"><parent link="{}"/><child link="{}"/><origin xyz="{}"/><axis xyz="{}"/>'
         '</joint>')
FORE = '<box size=".2 .06 .06"/>'
URDF = '<robot name="arm">' + "".join((
    LINK.format("base", "0 0 0", 1, 1, 1, 1, "0 0 .05", "0 0 0", '<cylinder radius=".08" length=".1"/>'),
    LINK.format("turret", "0 0 .1", 3.2, 0.012, 0.012, 0.006, "0 0 .1", "0 0 0",
                '<cylinder radius=".05" length=".18"/>'),
    LINK.format("upper", ".15 0 0", 2.1, 0.003, 0.02, 0.021, ".15 0 0", "0 1.5708 0",
                '<capsule radius=".035" length=".26"/>'),
    LINK.format("fore", ".12 0 0", 1.3, 0.001, 0.009, 0.009, ".14 0 0", "0 0 0", FORE),
    JOINT.format("pan", "base", "turret", "0 0 .1", "0 0 1"),
    JOINT.format("lift", "turret", "upper", "0 0 .2", "0 1 0"),
    JOINT.format("elbow", "upper", "fore", ".3 0 0", "0 1 0"))) + "</robot>"

START = [0.2, 0.4, 0.5]


def written(folder, text, name):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def stl(path, corners):
    """A mesh of all triangles between the corners."""
    import itertools

    faces = list(itertools.combinations(corners, 3))
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(face), 0) for face in faces)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + body)


def first_touch(path):
    """When MuJoCo, by its RK4 at steps of .1 ms, sees the first contact that is none between neighbours."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep, model.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:] = START
    while not data.ncon:
        mujoco.mj_step(model, data)
    return data.time


def test_a_urdf_ends_its_claim_where_the_same_mjcf_does(tmp_path):
    one, other = written(tmp_path, MJCF, "arm.xml"), written(tmp_path, URDF, "arm.urdf")
    horizons = [crosscheck.truth(crosscheck.import_model(path, qpos=START)).horizon for path in (one, other)]
    assert horizons[1] == pytest.approx(horizons[0], abs=1e-9)
    assert horizons[0] == pytest.approx(first_touch(one), abs=1e-3)
    assert crosscheck.import_model(other).left_out == (("", "contacts of links that share a joint", ""),)


@pytest.mark.parametrize(("file", "name"), [
    ("box.stl", "box.stl"), ("meshes/box.stl", "package://arm_description/meshes/box.stl")])
def test_a_mesh_is_its_hull(tmp_path, file, name):
    folder = tmp_path / "arm_description"
    stl(folder / file, [[x, y, z] for x in (-100, 100) for y in (-30, 30) for z in (-30, 30)])
    scenes = [crosscheck.import_model(written(folder, URDF.replace(FORE, form), "arm.urdf"), qpos=START)
              for form in (FORE, f'<mesh filename="{name}" scale=".001 .001 .001"/>')]
    assert scenes[1].left_out == scenes[0].left_out
    assert crosscheck.truth(scenes[1]).horizon == pytest.approx(crosscheck.truth(scenes[0]).horizon, abs=1e-6)


@pytest.mark.parametrize(("form", "words"), [
    ('<mesh filename="none.stl"/>', "collision shapes none.stl: missing"),
    ('<mesh filename="../outside.stl"/>', "outside the folder of the model; --within FOLDER"),
    ('<mesh filename="broken.stl"/>', "broken.stl: not read by coal"),
    ('<mesh filename="flat.stl"/>', "flat.stl: flat"),
    ('<cone radius="1"/>', "<cone> (line 1): their sizes are not those of"),
    ('<box size="1 2"/>', "<box> (line 1): their sizes are not those of")])
def test_a_shape_that_cannot_be_watched_is_listed(tmp_path, form, words):
    folder = tmp_path / "model"
    stl(folder / "flat.stl", [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    stl(tmp_path / "outside.stl", [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    (folder / "broken.stl").write_bytes(b"no mesh")
    scene = crosscheck.import_model(written(folder, URDF.replace(FORE, form), "arm.urdf"))
    assert any(words in str(each) for each in scene.left_out)
    assert {shape.body for shape in scene.shapes} == {-1, 1}  # the base and the upper arm, whose others it touches not


def test_what_overlaps_at_the_start_is_listed_and_the_rest_watched(tmp_path):
    scene = crosscheck.import_model(written(tmp_path, URDF.replace(FORE, FORE.replace(".2", ".3")), "arm.urdf"),
                                    qpos=[0.0, 0.0, np.pi])
    assert ("turret - fore", "contacts of the colliding bodies", "which touch at the start") in scene.left_out
    assert len(scene.monitors) == 2


@pytest.mark.parametrize("command", ["run", "truth", "judge", "explain", "advise", "convert", "linearise",
                                     "bisect", "verify"])
def test_every_command_takes_a_start(command):
    told = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).output
    assert all(f"--{name}" in told for name in ("keyframe", "qpos", "qvel"))


def test_a_start_from_the_command_line(tmp_path):
    path = written(tmp_path, MJCF, "arm.xml")
    told = CliRunner().invoke(app, ["convert", str(path), "-o", str(tmp_path / "arm.toml"), "--qpos", ".2,.4,.5",
                                    "--qvel", "0 1 -1"])
    assert told.exit_code == 0
    scene = crosscheck.load_scene(tmp_path / "arm.toml")
    assert scene.hash == crosscheck.import_model(path, qpos=START, qvel=[0.0, 1.0, -1.0]).hash


@pytest.mark.parametrize(("options", "words"), [
    (["double_pendulum", "--qpos", "1,2"], "go with a model file"),
    (["arm.xml", "--qpos", "1;2"], "--qpos: '1;2' is not a list of numbers"),
    (["arm.xml", "--qvel", "1,2"], "qvel: 3 finite numbers are wanted")])
def test_a_wrong_start_is_told(tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, MJCF, "arm.xml")
    told = CliRunner().invoke(app, ["truth", *options])
    assert words in " ".join(str(told.exception or told.output).split())


def test_what_is_dropped_is_watched_still(tmp_path):
    """The claim of a model without its contacts ends where one would act; at the start nothing is claimed."""
    path = tmp_path / "ball.xml"
    path.write_text('<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body name="ball" pos="0 0 1"><freejoint/>'
                    '<geom size=".1" mass="1"/></body></worldbody></mujoco>')
    fall = crosscheck.truth(crosscheck.import_model(path, drop=True, duration=1.0))
    assert fall.horizon == pytest.approx((2 * 0.9 / 9.81) ** 0.5, abs=1e-9)
    lying = crosscheck.import_model(path, drop=True, qpos=[0, 0, 0.05, 1, 0, 0, 0], duration=1.0)
    assert not lying.monitors
    assert lying.left_out[0].what == "acts at the start: contacts of the colliding bodies"
    with pytest.raises(Unsupported, match="holds until something acts that was left out, which is at the start"):
        crosscheck.truth(lying)
    told = CliRunner().invoke(app, ["run", str(path), "--drop", "--qpos", "0,0,.05,1,0,0,0", "--duration", "1"])
    assert told.exit_code == 3, told.output
    assert "resolved over 0 % of its 1 s" in told.output
    assert "what would mend it: a start at which nothing acts that was left out" in told.output
