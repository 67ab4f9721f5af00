"""Two variations of each case of strangers: other robots, units, joints, formats, laws and sizes.

What is right comes from closed forms, SciPy or MuJoCo (`inputs.py`), never from this project. A case is a function that
writes its files into the working folder and returns the command, with the figures that the answer has to print.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import crosscheck
from crosscheck.errors import EngineError
from crosscheck.inspection import bisect as releases
from crosscheck.inspection.reproduce import Reproduction
from crosscheck.scene.sensors import readings
from tests.cases.inputs import (
    CART,
    body,
    cart,
    gantry,
    joint,
    leg,
    opensim,
    scene,
    simulated,
    solved,
    table,
    thrown,
    written,
)
from tests.commands import crosscheck as command

mujoco = pytest.importorskip("mujoco")

TIMES = np.arange(0.0, 1.005, 0.01)
TOUCH = r"touch\w*.*? at (\d*\.\d+) s"
SHARE = r"(\d+(?:\.\d+)?) ?%"


@dataclasses.dataclass(frozen=True)
class Case:
    """A command: its exit codes, what its answer shows and what it lacks (patterns, without case)."""

    make: Callable[[], str | tuple[str, dict[str, tuple[float, float]]]]
    codes: tuple[int, ...]
    shows: tuple[str, ...]
    lacks: tuple[str, ...]


CASES: dict[str, Case] = {}


def case(*codes, shows=(), lacks=(), to=CASES):
    """Add a case to a table."""

    def keep(make):
        to[make.__name__] = Case(make, codes, shows, lacks)
        return make

    return keep


# --- models that differ -------------------------------------------------------------------------------------------


@case(1, shows=(r"bridge_x.*friction.*\b6\b.*\b9\b", r"hoist_z.*velocity.*\.4\b.*\.3\b"), lacks=("effort",))
def diff_of_slides():
    write("a.urdf", gantry())
    write("b.urdf", gantry(friction=9).replace('name="hoist_z" type="prismatic"', "@").replace(
        'velocity="0.4"', 'velocity="0.3"').replace("@", 'name="hoist_z" type="prismatic"'))
    return "diff a.urdf b.urdf"


WRIST = """<mujoco><compiler angle="{angle}"/><worldbody><body name="post"><joint name="yaw" range="{low} {high}"/>
<inertial pos=".1 0 0" mass="2" diaginertia=".01 .02 .02"/><body name="head" pos=".3 0 0"><joint name="wrist"
type="ball" damping=".2"/><inertial pos="0 0 .1" mass=".5" diaginertia=".003 .003 .002"/></body></body></worldbody>
<actuator><position joint="yaw" kp="{kp}"/></actuator></mujoco>"""


@case(1, shows=(r"yaw.*\b20\b.*\b25\b",), lacks=(r"limits:", "wrist"))
def against_other_units_of_angles():
    write("a.xml", WRIST.format(angle="degree", low=-90, high=90, kp=20))
    write("b.xml", WRIST.format(angle="radian", low=-math.pi / 2, high=math.pi / 2, kp=25))
    return "inspect a.xml b.xml"


# --- a touch ends what can be judged ------------------------------------------------------------------------------


@case(3, shows=("touch", "unresolved"))
def judge_until_a_weight_is_on_the_floor():
    """Dry friction of 5 N against 2 kg: it falls at g - 2.5, .6 m, in millimetres."""
    write("crane.xml", """<mujoco model="crane"><worldbody><geom name="floor" type="plane" size="0 0 .1"/>
        <body name="ball" pos="0 0 .65"><joint name="hoist" type="slide" axis="0 0 1" frictionloss="5"/>
        <inertial pos="0 0 0" mass="2" diaginertia=".01 .01 .01"/><geom type="sphere" size=".05"/></body></worldbody>
        </mujoco>""")
    a = 9.81 - 2.5
    table(Path("log.csv"), {"time [s]": TIMES, "hoist_pos_mm": 1e3 * np.maximum(-0.6, -a * TIMES**2 / 2)})
    return ("judge crane.xml log.csv --start recorded --tol joint_position=1e-4",
            {SHARE: (100 * math.sqrt(1.2 / a), 1.0)})


SCARA = """<mujoco model="scara"><compiler angle="degree"/><worldbody>
<geom name="column" type="sphere" size=".06"/>
<body name="upper"><joint name="shoulder" axis="0 0 1"/><inertial pos=".2 0 0" mass="3" diaginertia=".01 .04 .04"/>
<body name="fore" pos=".4 0 0"><joint name="elbow" axis="0 0 1"/><inertial pos=".15 0 0" mass="1"
diaginertia=".002 .01 .01"/><geom name="hand" type="sphere" size=".05" pos=".3 0 0"/></body></body></worldbody>
<keyframe><key name="fold" qpos=".3 1.05" qvel="0 4.5"/></keyframe></mujoco>"""


@case(0, shows=("touch",))
def judge_in_degrees_with_decimal_commas():
    q, v, touched = simulated(SCARA, TIMES, key="fold", step=5e-4)
    write("scara.xml", SCARA)
    table(Path("log.csv"), {"Time": TIMES, "shoulder_pos_deg": np.degrees(q[0]), "elbow_pos_deg": np.degrees(q[1]),
                            "elbow_vel_deg_s": np.degrees(v[1])}, ";", comma=True)
    return ("judge scara.xml log.csv --keyframe fold --tol joint_position=1e-3 --tol joint_velocity=1e-2 --need .2",
            {TOUCH: (touched, 5e-3)})


@case(3, shows=("touch", "unresolved"))
def judge_a_gantry_whose_hook_reaches_the_slab():
    """Free fall of .5 m above a bridge that rolls on, as a plot's export names them."""
    write("gantry.urdf", gantry(start=0.65, shapes=True))
    fallen = np.minimum(TIMES, math.sqrt(2 * 0.5 / 9.81))
    table(Path("log.csv"), {
        "__time": TIMES, "/joint_states/bridge_x/position": 0.3 * TIMES,
        "/joint_states/hoist_z/position": -9.81 * fallen**2 / 2, "/joint_states/bridge_x/velocity": 0.3 + 0 * TIMES,
        "/joint_states/hoist_z/velocity": -9.81 * fallen})
    return ("judge gantry.urdf log.csv --start recorded --tol joint_position=1e-4",
            {SHARE: (100 * math.sqrt(1.0 / 9.81), 1.0)})


@case(0, shows=("ball|sphere|shin",))
def truth_of_a_leg_that_kicks_its_base():
    """MuJoCo reads the same file."""
    write("leg.urdf", leg(0.05, 0.02, shapes=True))
    *_, touched = simulated(leg(0.05, 0.02, shapes=True), np.array([2.0]), qpos=[1.2, -0.3], step=2e-4)
    assert touched < 1.5
    return "truth leg.urdf --qpos 1.2,-.3", {TOUCH: (touched, 1e-3)}


# --- causes -------------------------------------------------------------------------------------------------------


@case(1, shows=("damping|damper", "fail"), lacks=("internal",))
def judge_a_cart_without_its_damper():
    """It rolls to a wall under dry friction alone, and slower with its damper."""
    write("cart.xml", """<mujoco model="cart"><worldbody><geom name="wall" type="box" size=".1 1 1" pos="1.2 0 0"/>
        <body name="box"><joint name="roll" type="slide" axis="1 0 0" damping="1.5" frictionloss=".4"/>
        <inertial pos="0 0 0" mass="1.3" diaginertia=".01 .01 .01"/><geom type="sphere" size=".1"/></body></worldbody>
        </mujoco>""")
    table(Path("log.csv"), {"t [ms]": 1e3 * TIMES, "roll.position [cm]": 100 * (2 * TIMES - 0.4 / 1.3 * TIMES**2 / 2),
                            "roll.velocity [cm/s]": 100 * (2 - 0.4 / 1.3 * TIMES)})
    return "judge cart.xml log.csv --start recorded --tol joint_position=1e-3"


@case(1, shows=("damping|damper", "hip"), lacks=("internal",))
def judge_a_leg_with_twice_the_damping():
    q, v, _ = simulated(leg(0.1, 0.02), TIMES, qpos=[0.9, -0.4])
    write("leg.urdf", leg(0.05, 0.02))
    table(Path("log.tsv"), {"stamp": TIMES, "hip_pos_deg": np.degrees(q[0]), "knee_pos_deg": np.degrees(q[1]),
                            "hip_vel_deg_s": np.degrees(v[0]), "knee_vel_deg_s": np.degrees(v[1])}, "\t")
    return "judge leg.urdf log.tsv --start recorded --tol joint_position=1e-4"


# --- when parts touch ---------------------------------------------------------------------------------------------


CAPSULE = """<mujoco model="stick"><worldbody><geom name="floor" type="plane" size="0 0 .1"/>
<body name="stick" pos="0 0 1"><freejoint/><inertial pos="0 0 .05" mass=".4" diaginertia=".004 .0041 .0004"/>
<geom type="capsule" size=".02 .2"/></body></worldbody>
<keyframe><key name="drop" qpos="0 0 1 .9689 .2474 0 0" qvel=".3 0 .5 5 2 1"/></keyframe></mujoco>"""


@case(0)
def truth_of_a_stick_that_tumbles_to_the_floor():
    write("stick.xml", CAPSULE)
    *_, touched = simulated(CAPSULE, np.array([1.0]), key="drop", step=1e-4)
    return "truth stick.xml --keyframe drop", {TOUCH: (touched, 1e-3)}


CRADLE = """<mujoco model="cradle"><worldbody>
<body name="left" pos="0 0 1"><joint name="l" type="ball"/>
<inertial pos="0 0 -.5" mass=".5" diaginertia=".002 .002 .001"/>
<geom type="sphere" size=".06" pos="0 0 -.5"/></body>
<body name="right" pos=".3 0 1"><joint name="r" type="ball"/>
<inertial pos="0 0 -.5" mass=".3" diaginertia=".001 .001 .001"/>
<geom type="box" size=".05 .06 .07" pos="0 0 -.5"/></body>
</worldbody><keyframe><key name="go" qpos=".97 0 .2431 0 1 0 0 0" qvel="0 -1 0 0 .3 0"/></keyframe></mujoco>"""


@case(0, shows=("left", "right"))
def truth_of_two_balls_on_joints_of_three_turns():
    write("cradle.xml", CRADLE)
    *_, touched = simulated(CRADLE, np.array([2.0]), key="go", step=1e-4)
    assert touched < 1.9
    return "truth cradle.xml --keyframe go", {TOUCH: (touched, 1e-3)}


# --- budgets ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("budget", "file", "text", "more"), [
    (1, "gantry.urdf", gantry(), ()), (2, "cradle.xml", CRADLE, ("--keyframe", "go"))])
def test_what_there_is_within_a_budget_is_told(budget, file, text, more, tmp_path):
    """The command goes on after its line, for minutes where truth takes them; here it is killed."""
    (tmp_path / file).write_text(text, encoding="utf-8")
    words = ["verify", "--scene", file, *more, "--engine", "mujoco", "--budget", str(budget), "-o", "out"]
    with subprocess.Popen([sys.executable, "-m", "crosscheck", *words], cwd=tmp_path, text=True, start_new_session=True,
                          stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        first = process.stdout.readline()
        os.killpg(process.pid, signal.SIGKILL)
    assert re.match(r"provisional: .* tasks left after \d+ s; .*out/index.html$", first), first
    assert "Nothing was run" not in first
    assert "Provisional." in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")


# --- what touches at the start ------------------------------------------------------------------------------------


HOPPER = """<mujoco model="hopper"><compiler angle="degree"/><worldbody><geom name="ground" type="plane" size="0 0 .1"/>
<body name="trunk" pos="0 0 .35"><freejoint/><inertial pos="0 0 0" mass="4" diaginertia=".03 .03 .02"/>
<body name="left_leg" pos="0 .1 0"><joint name="left" type="slide" axis="0 0 1" range="-.1 .1" damping="9"/>
<inertial pos="0 0 -.15" mass=".5" diaginertia=".002 .002 .0004"/><geom name="left_foot" type="sphere" size=".03"
pos="0 0 -.3"/></body>
<body name="right_leg" pos="0 -.1 0"><joint name="right" type="slide" axis="0 0 1" range="-.1 .1" damping="9"/>
<inertial pos="0 0 -.15" mass=".5" diaginertia=".002 .002 .0004"/><geom name="right_foot" type="sphere" size=".03"
pos="0 0 -.3"/></body></body></worldbody>
<actuator><position joint="left" kp="900"/><position joint="right" kp="900"/></actuator>
<keyframe><key name="stand" qpos="0 0 .329 1 0 0 0 0 0"/></keyframe></mujoco>"""


@case(2, shows=("left_leg", "ground", "--drop"))
def import_of_a_hopper_on_its_feet():
    write("hopper.xml", HOPPER)
    return "import hopper.xml --keyframe stand -o hopper.toml"


CYCLE = """<mujoco model="cycle"><worldbody><geom name="road" type="plane" size="0 0 .1"/>
<body name="seat" pos="0 0 .8"><freejoint/><inertial pos="0 0 0" mass="5" diaginertia=".1 .1 .05"/>
<body name="tyre" pos="0 0 -.6"><joint name="axle" axis="0 1 0" damping=".02"/><inertial pos="0 0 0" mass="1"
diaginertia=".01 .02 .01"/><geom name="rim" type="cylinder" size=".2 .02" euler="90 0 0"/></body></body></worldbody>
<actuator><motor joint="axle"/></actuator>
<keyframe><key name="stand" qpos="0 0 .799 1 0 0 0 0"/></keyframe></mujoco>"""


@case(3, shows=("ground - tyre", "unresolved"), lacks=(r"^pass",))
def run_of_a_cycle_that_would_fall_through_the_road():
    write("cycle.xml", CYCLE)
    return "run cycle.xml --keyframe stand --drop"


# --- logs of free bodies ------------------------------------------------------------------------------------------


TRUNK = """<mujoco model="trunk"><worldbody><body name="torso" pos="0 0 2"><freejoint name="floating"/>
<inertial pos=".03 -.01 .02" mass="7" diaginertia=".05 .2 .22"/></body></worldbody>
<keyframe><key name="go" qpos="{}" qvel="{}"/></keyframe></mujoco>"""
OFFSET = np.array([0.03, -0.01, 0.02])


def flown():
    """The trunk's file, and of its motion: origins, attitudes, velocities of origins (world), rates (body), centres."""
    q, w, v = np.array([0.8, 0.36, -0.48, 0.0]), np.array([1.5, -0.7, 2.0]), np.array([0.4, -0.2, 2.5])
    start, turn = np.array([0.0, 0.0, 2.0]), Rotation.from_quat(q, scalar_first=True)
    write("trunk.xml", TRUNK.format(" ".join(map(str, [*start, *q])), " ".join(map(str, [*v, *w]))))
    x, speeds, R, rates = thrown(TIMES, (0.05, 0.2, 0.22), start + turn.apply(OFFSET),
                                 v + turn.apply(np.cross(w, OFFSET)), q, w)
    return x - R.apply(OFFSET), R, speeds - R.apply(np.cross(rates, OFFSET)), rates, x


@case(0, shows=("body axes",))
def judge_odometry_whose_twist_is_in_body_axes():
    """The pose of the frame's origin, w last; the twist in axes of the child, as the convention of odometry has it."""
    x, R, v, w, _ = flown()
    columns = [TIMES, *x.T, *R.as_quat().T, *R.inv().apply(v).T, *w.T]
    names = ["time", *(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw"),
             *(f"twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")]
    table(Path("odom.csv"), dict(zip(names, columns, strict=True)), digits=9)
    return "judge trunk.xml odom.csv --keyframe go --tol position=1e-4 --tol velocity=1e-3 --tol angular_velocity=1e-3"


@case(0)
def judge_a_mapping_in_millimetres_and_degrees():
    """Centres of mass in mm, quaternions with w last, rates in degrees in axes of the world."""
    _, R, _, w, centres = flown()
    table(Path("log.csv"), dict(zip(["clock", "px", "py", "pz", "q1", "q2", "q3", "q4", "w1", "w2", "w3"], [
        1e3 * TIMES, *1e3 * centres.T, *R.as_quat().T, *np.degrees(R.apply(w)).T], strict=True)), "\t")
    write("columns.toml", """[columns]
        "clock" = { is = "t", unit = "ms" }
        "place" = { is = "torso.position", columns = ["px", "py", "pz"], unit = "mm" }
        "turn" = { is = "torso.q", columns = ["q1", "q2", "q3", "q4"], order = "xyzw" }
        "rate" = { is = "torso.w", columns = ["w1", "w2", "w3"], unit = "deg/s", frame = "world" }\n""")
    return ("judge trunk.xml log.csv --columns columns.toml --keyframe go --tol position=1e-4 --tol attitude=1e-4 "
            "--tol angular_velocity=1e-3")


# --- OpenSim, Modelica, tables without times ----------------------------------------------------------------------


POLE = """<mujoco model="pole"><worldbody><body name="sled"><joint name="rail" type="slide" axis="1 0 0" damping=".5"/>
<inertial pos="0 0 0" mass="1.2" diaginertia=".01 .01 .01"/><body name="rod"><joint name="pole" axis="0 1 0"/>
<inertial pos="0 0 -.3" mass=".4" diaginertia=".01 .01 .001"/></body></body></worldbody></mujoco>"""


@case(0)
def judge_degrees_of_hinges_beside_metres_of_slides():
    q, *_ = simulated(POLE, TIMES, qpos=[0.2, 1.1])
    write("pole.xml", POLE)
    opensim(Path("motion.mot"), {"time": TIMES, "rail": q[0], "pole": np.degrees(q[1])}, "inDegrees=yes", "",
            "Units are S.I. units (second, meters, Newtons, ...)", "Angles are in degrees.", "")
    return "judge pole.xml motion.mot --start recorded --tol joint_position=1e-4"


@case(0, shows=("deg",))
def judge_states_that_do_not_say_that_they_are_degrees():
    q, v, _ = simulated(leg(0.05, 0.02), TIMES, qpos=[0.9, -0.4])
    write("leg.urdf", leg(0.05, 0.02))
    opensim(Path("states.sto"), {"time": TIMES} | {
        f"/jointset/{joint}_joint/{joint}/{key}": np.degrees(values[k]) for k, joint in enumerate(("hip", "knee"))
        for key, values in (("value", q), ("speed", v))})
    return "judge leg.urdf states.sto --start recorded --tol joint_position=1e-4 --tol joint_velocity=1e-3"


@case(0)
def judge_rows_thrice_with_decimal_commas():
    """An event at .3 s and the end: the same row three times and twice."""
    t = np.sort(np.concatenate([TIMES, [0.3, 0.3, 1.0]]))
    x, v = cart(t)
    write("cart.xml", CART.format(damping=0.7))
    table(Path("result.csv"), {"time": t, "cart.s": x, "cart.v": v}, ";", comma=True, digits=17, quoted=True)
    return "judge cart.xml result.csv --start recorded --tol joint_position=1e-6 --tol joint_velocity=1e-5"


@case(0)
def judge_derivatives_beside_velocities():
    """The derivative of the position and the velocity are one quantity in two columns, as Modelica writes them."""
    t = np.sort(np.concatenate([TIMES, [0.5, 1.0]]))
    x, v = cart(t)
    write("cart.xml", CART.format(damping=0.7))
    table(Path("result.csv"), {"time": t, "cart.s": x, "cart.v": v, "cart.a": -15 * x - 0.35 * v, "der(cart.s)": v,
                               "der(cart.v)": -15 * x - 0.35 * v}, quoted=True, digits=17)
    return "judge cart.xml result.csv --start recorded --tol joint_position=1e-6 --tol joint_velocity=1e-5"


@case(0)
def judge_a_table_without_times():
    x, v = cart(np.arange(0.0, 1.01, 0.02))
    write("cart.xml", CART.format(damping=0.7))
    table(Path("log.csv"), {"q1": x, "qd1": v}, ";", comma=True)
    return "judge cart.xml log.csv --start recorded --tol joint_position=1e-6 --period .02"


@case(2, shows=(r"\b2 names", r"\b4 numbers"))
def judge_fewer_names_than_numbers():
    q, v, _ = simulated(leg(), TIMES[:20], qpos=[0.9, -0.4])
    write("leg.urdf", leg())
    table(Path("log.csv"), {"hip": q[0], "knee": q[1], "c": v[0], "d": v[1]})
    write("log.csv", Path("log.csv").read_text().replace("hip,knee,c,d", "hip,knee"))
    return "judge leg.urdf log.csv --start recorded --tol joint_position=1e-4 --period .01"


# --- steps --------------------------------------------------------------------------------------------------------


@case(1, shows=(r"implicit Euler", r"5 ms|\.005|5e-0?3"), lacks=("extra damping",))
def judge_implicit_euler_on_a_spring():
    step, A = 0.005, np.array([[0.0, 1.0], [-15.0, -0.35]])
    advance, rows = np.linalg.inv(np.eye(2) - step * A), [np.array([0.3, 0.1])]
    for _ in range(300):
        rows.append(advance @ rows[-1])
    x, v = np.array(rows).T
    write("cart.xml", CART.format(damping=0.7))
    table(Path("log.csv"), {"t": step * np.arange(301), "cart_pos_mm": 1e3 * x, "cart_vel_mm_s": 1e3 * v}, digits=10)
    return "judge cart.xml log.csv --start recorded --tol joint_position=1e-4"


def explicit(step):
    """A pendulum by explicit Euler: times, angles in degrees, rates in degrees."""
    y, rows = np.array([1.2, 0.0]), []
    for k in range(round(1.0 / step) + 1):
        rows.append((k * step, *np.degrees(y)))
        y = y + step * np.array([y[1], -0.4 * 9.81 * 0.2 * np.sin(y[0]) / (0.0006 + 0.4 * 0.04)])
    return dict(zip(["t", "pivot_pos_deg", "pivot_vel_deg_s"], np.array(rows).T, strict=True))


PIVOT = """<mujoco model="pend"><worldbody><body name="bob" pos="0 0 1"><joint name="pivot" axis="1 0 0"/>
<inertial pos="0 0 -.2" mass=".4" diaginertia=".0006 .0006 .0005"/></body></worldbody></mujoco>"""


@case(1, shows=(r"explicit Euler",))
def judge_explicit_euler_in_degrees():
    write("pend.xml", PIVOT)
    table(Path("log.csv"), explicit(0.005), digits=11)
    return "judge pend.xml log.csv --start recorded --tol joint_position=1e-3"


# --- models of Gazebo, papers -------------------------------------------------------------------------------------


SDF = """<?xml version="1.0"?><sdf version="1.7"><model name="{name}"><link name="frame"/><link name="part">
<pose>0 0 .5 0 0 .3</pose><inertial><pose>.1 0 0 0 0 0</pose><mass>1.5</mass><inertia><ixx>.01</ixx><iyy>.02</iyy>
<izz>.02</izz></inertia></inertial></link>
<joint name="a" type="fixed"><parent>world</parent><child>frame</child></joint>
<joint name="b" type="{kind}"><parent>frame</parent><child>part</child>{axis}</joint></model></sdf>"""


def readers():
    from importlib.util import find_spec

    return any(find_spec(name) for name in ("pybullet", "pydrake", "newton"))


@case(2, shows=("pip install", "pybullet|drake|newton"), lacks=("internal",))
def import_of_a_slide_of_gazebo():
    if readers():
        pytest.skip("a reader of SDF is installed")
    write("slide.sdf", SDF.format(name="slide", kind="prismatic",
                                  axis="<axis><xyz>1 0 0</xyz><dynamics><damping>4</damping></dynamics></axis>"))
    return "import slide.sdf -o slide.toml"


@case(2, shows=("pip install", "pybullet|drake|newton"), lacks=("internal",))
def inspect_of_a_ball_of_gazebo():
    if readers():
        pytest.skip("a reader of SDF is installed")
    write("ball.sdf", SDF.format(name="ball", kind="ball", axis=""))
    return "inspect ball.sdf"


ENGINE = '''import numpy as np
from crosscheck.adapters.base import steps_per_sample
from crosscheck.scene.states import States


class Hinge:
    """A body on a hinge about z without gravity and forces: it keeps its rate."""

    name = "{name}"
    methods = {methods}
    orders = {{}}

    def unsupported(self, scene, spec):
        return None if [each.type for each in scene.joints] == ["revolute"] else "it knows one hinge"

    def run(self, scene, spec):
        w = np.repeat(scene.w0[None], len(scene.t), axis=0)
        angle = scene.w0[0, 2] * scene.t
        c, s, zero, one = np.cos(angle), np.sin(angle), 0 * angle, 1 + 0 * angle
        R = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)[:, None]
        still = np.zeros((len(scene.t), 1, 3))
        return States(scene.t, still, R, still, w)
'''


def paper(name, methods):
    write("own.py", ENGINE.format(name=name, methods=methods))
    written(Path("spin.json"), [body("rotor")], [joint("axle", "revolute", "rotor", position=0.0, velocity=3.0)])
    return "verify --scene spin.json --engine own.py:Hinge --profile smoke --jobs 1 -o out"


@case(0, 3, shows=(r"exact|spin",), lacks=("internal",))
def paper_of_an_engine_with_special_characters():
    return paper("my_engine", ("exact_50%",)) + "\nreport out --format paper"


@case(0, 3, shows=(r"A1", "B2"), lacks=("internal",))
def paper_of_two_methods():
    return paper("rotor", ("A1", "B2")) + "\nreport out --format paper"


# --- the error of a run -------------------------------------------------------------------------------------------


@case(0, 3, shows=("resolved",))
def run_prints_the_error_of_mujocos_euler():
    """MuJoCo's Euler against MuJoCo's RK4, at the output times."""
    text, times = leg(), np.linspace(0.0, 1.0, 21)
    write("leg.urdf", text)
    centres = []
    for step, integrator in ((5e-3, "Euler"), (2e-4, "RK4")):
        q, *_ = simulated(text, times, qpos=[1.2, -0.3], step=step, integrator=integrator)
        model = mujoco.MjModel.from_xml_string(text)
        data, places = mujoco.MjData(model), []
        for row in q.T:
            data.qpos[:] = row
            mujoco.mj_forward(model, data)
            places.append(data.xipos[1:].copy())
        centres.append(np.array(places))
    error = np.linalg.norm(centres[0] - centres[1], axis=2).max()
    return ("run leg.urdf --engine mujoco --method Euler --step 5e-3 --qpos 1.2,-.3 --duration 1 --samples 21",
            {r"error against truth: position (\S+) m": (error, 0.06 * error)})


@case(0, 3, shows=("resolved",))
def run_prints_the_error_of_semi_implicit_euler():
    x, v, places = 0.3, 0.0, [0.3]
    for _ in range(200):
        v -= 0.01 * 15.0 * x
        x += 0.01 * v
        places.append(x)
    t = np.linspace(0.0, 2.0, 41)
    error = np.abs(np.array(places)[::5] - 0.3 * np.cos(math.sqrt(15.0) * t)).max()
    write("cart.xml", CART.format(damping=0))
    return ("run cart.xml --engine mujoco --method Euler --step .01 --qpos .3 --duration 2 --samples 41",
            {r"error against truth: position (\S+) m": (error, 0.06 * error)})


# --- advice -------------------------------------------------------------------------------------------------------


OWN = '''import numpy as np
from crosscheck.adapters.base import steps_per_sample
from crosscheck.scene.states import States


class Own:
    """{kind} for a body on a slide along x with the spring of its joint."""

    name = "own"
    methods = ("{kind}",)
    orders = {{"{kind}": {order}}}

    def unsupported(self, scene, spec):
        return None if [each.type for each in scene.joints] == ["prismatic"] else "it knows one slide"

    def run(self, scene, spec):
        (steps, h), y, rows = steps_per_sample(scene, spec.step), np.array([scene.x0[0, 0], scene.v0[0, 0]]), []
        A = np.array([[0.0, 1.0], [-20.0, 0.0]])
        advance = np.eye(2) + h * A + ({order} - 1) * h * h / 2 * A @ A
        for k in range(len(scene.t)):
            if k:
                y = np.linalg.matrix_power(advance, steps) @ y
            rows.append(y)
        x, v = np.zeros((2, len(scene.t), 1, 3))
        x[:, 0, 0], v[:, 0, 0] = np.array(rows).T
        return States(scene.t, x, np.broadcast_to(np.eye(3), (len(x), 1, 3, 3)).copy(), v, np.zeros_like(v))
'''


def advised(order, kind, error):
    write("own.py", OWN.format(order=order, kind=kind))
    written(Path("spring.json"), [body("block", 2.0)], [
        joint("rail", "prismatic", "block", (1, 0, 0), position=0.3, velocity=0.0, stiffness=40.0)], 2.0, 21)
    return f"advise spring.json --engine own.py:Own --error position={error:g}"


@case(0, shows=("midpoint",), lacks=("no method reaches",))
def advise_a_method_of_order_two():
    """The largest step whose error is 1e-4 m: that of (1 + hA + (hA)^2 / 2)^n, known by repeated multiplication."""
    A, t = np.array([[0.0, 1.0], [-20.0, 0.0]]), np.linspace(0.0, 2.0, 21)

    def error(h):
        power = np.linalg.matrix_power(np.eye(2) + h * A + h * h / 2 * A @ A, round(0.1 / h))
        rows = [np.array([0.3, 0.0])]
        for _ in t[1:]:
            rows.append(power @ rows[-1])
        return np.abs(np.array(rows)[:, 0] - 0.3 * np.cos(math.sqrt(20.0) * t)).max()

    steps = [0.1 / n for n in range(5, 400)]
    right = max(step for step in steps if error(step) <= 1e-4)
    return advised(2, "midpoint", 1e-4), {r"step[^\d]*(\d[\d.e-]*) s": (right * 0.75, right * 0.3)}


@case(3, shows=("within the budget|errors fall no more", "finest step"), lacks=("no method reaches",))
def advise_a_method_of_order_one_beyond_any_budget():
    """Its steps cost nothing, so that a fast machine comes to where rounding ends the fall of errors."""
    return advised(1, "euler", 1e-11)


# --- commands -----------------------------------------------------------------------------------------------------


def write(name, text):
    Path(name).write_text(text, encoding="utf-8")


def answered(case):
    """Whether the command of a case gives its answer; in an empty working folder."""
    made = case.make()
    lines, figures = (made, {}) if isinstance(made, str) else made
    done = [command(*shlex.split(line)) for line in lines.splitlines()]
    text = "\n".join([each.stdout + each.stderr for each in done] + [
        file.read_text(encoding="utf-8") for file in sorted(Path().glob("out/paper/**/*.tex"))])
    assert done[-1].returncode in case.codes, text
    for pattern in case.shows:
        assert re.search(pattern, text, re.IGNORECASE | re.MULTILINE), (pattern, text)
    for pattern in case.lacks:
        assert not re.search(pattern, text, re.IGNORECASE | re.MULTILINE), (pattern, text)
    for pattern, (wanted, tolerance) in figures.items():
        found = re.search(pattern, text)
        assert found, (pattern, text)
        assert abs(float(found[1]) - wanted) <= tolerance, (pattern, found[1], wanted, text)


@pytest.mark.parametrize("name", CASES)
def test_commands_are_answered(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    answered(CASES[name])


# --- figures ------------------------------------------------------------------------------------------------------


WAYS = (("lieeuler", "rkmk853", {"rtol": 1e-10}), ("mujoco", "RK4", {"step": 1e-3}), (
    "pinocchio", "RKMK4", {"step": 1e-3}))
VALUES = {}


def value(make):
    """Add a function that yields pairs of what was found and what is right, with the tolerance."""
    VALUES[make.__name__] = make
    return make


def every(data, ways=WAYS):
    """The trajectories of truth and of engines, by name."""
    reference = crosscheck.truth(data)
    yield "truth", reference
    for engine, method, how in ways:
        yield engine, crosscheck.run(data, engine, method, **how)


# bisect: a run that ends in NaN is a state of a release


def changed(*answers):
    """The changes between releases with these answers, in words."""
    listed = [f"3.{minor}.0" for minor in range(len(answers))]
    given = dict(zip(listed, answers, strict=True))

    def run(script, engine, version):
        if given[version] is None:
            raise EngineError(f"{version} has no wheel")
        states = np.full((2, 3), given[version])
        return releases.Release(version, states, states * (1 + 1e-15), 1.0, 0.25)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(releases, "released", lambda engine, span: listed)
        patch.setattr(releases, "_run", run)
        script = Reproduction("text", None, "title", "truth", 1e-3, np.zeros((2, 1, 3)), {})
        return [str(each) for each in releases.bisect(script, "mujoco", f"{listed[0]}..{listed[-1]}").changes]


@value
def releases_that_all_end_in_nan():
    yield len(changed(np.nan, np.nan, np.nan)), 0, 0


@value
def a_release_that_ends_the_nan():
    words = changed(np.nan, np.nan, 1.0, 1.0)
    yield len(words), 1, 0
    yield "nan m" in words[0], False, 0
    yield words[0].startswith("3.2.0"), True, 0


# advise: the attitude counts where positions rest


@value
def advice_for_a_spinning_body():
    """The step advised for MuJoCo is good for the attitude, by MuJoCo itself against SciPy."""
    text = """<mujoco model="spin"><option gravity="0 0 0"/><worldbody><body name="book"><freejoint/>
        <inertial pos="0 0 0" mass="1" diaginertia=".01 .03 .025"/></body></worldbody>
        <keyframe><key name="go" qpos="0 0 0 1 0 0 0" qvel="0 0 0 .2 .1 5"/></keyframe></mujoco>"""
    write("spin.xml", text)
    data = crosscheck.import_model("spin.xml", keyframe="go")
    advice = crosscheck.advise(data, engine="mujoco", error=1e-4)
    assert advice.method is not None
    _, _, R, w = thrown(data.t, (0.01, 0.03, 0.025), np.zeros(3), np.zeros(3), [1.0, 0, 0, 0], [0.2, 0.1, 5.0])
    q, v, _ = simulated(text, data.t, key="go", step=advice.step, integrator=advice.method)
    yield (Rotation.from_quat(q[3:].T, scalar_first=True).inv() * R).magnitude().max(), 0, 1e-4 * np.pi
    yield np.linalg.norm(v[3:].T - w, axis=1).max(), 0, 1e-4 * 10


@value
def advice_for_a_gyroscope_on_its_centre():
    data = scene([body("rotor", 1.0, (0.02, 0.03, 0.04), angular_velocity=[0.3, 6.0, 0.1])],
                 [joint("gimbal", "spherical", "rotor")], 2.0, 21, -9.81)
    advice = crosscheck.advise(data, engine="pinocchio", error=1e-5)
    assert advice.method is not None
    *_, R, _ = thrown(data.t, (0.02, 0.03, 0.04), np.zeros(3), np.zeros(3), [1.0, 0, 0, 0], [0.3, 6.0, 0.1])
    found = crosscheck.run(data, "pinocchio", advice.method, step=advice.step, form=advice.form)
    yield (Rotation.from_matrix(found.R[:, 0]).inv() * R).magnitude().max(), 0, 1e-5 * np.pi


# what a joint carries


def carried(data):
    for name, made in every(data):
        load = readings(data, made.states)["load"] if name == "truth" else made.sensors["load"]
        yield np.asarray(load)[0]


@value
def torque_that_a_hinge_carries():
    """About the pin: the spring and damper along the axis, the weight's moment across it."""
    k, c, q, v, m, r = 4.0, 0.3, 0.5, 2.0, 1.5, 0.3
    data = scene([body("bar", m, (0.02, 0.05, 0.05))], [
        joint("pin", "revolute", "bar", arm=(-r, 0, 0), position=q, velocity=v, stiffness=k, damping=c)], gravity=-9.81,
        sites=[{"name": "cell", "body": "bar", "position": [-r, 0.0, 0.0]}],
        sensors=[{"name": "load", "type": "torque", "joint": "pin", "site": "cell"}])
    for load in carried(data):
        yield load, [0.0, -r * m * 9.81, -(k * q + c * v)], 1e-8


@value
def force_that_an_inclined_slide_carries():
    """A servo and a damper along the slide, the weight's part across it."""
    u, q, v, m = np.array([0.6, 0.0, 0.8]), 0.2, 0.4, 2.0
    data = scene([body("box", m)], [joint("way", "prismatic", "box", u, position=q, velocity=v, damping=1.5)],
                 gravity=-9.81, forces=[{"type": "servo", "joint": "way", "target": 0.0, "proportional": 50.0,
                                         "derivative": 2.0}],
                 sites=[{"name": "cell", "body": "box", "position": [0.0, 0.0, 0.0]}],
                 sensors=[{"name": "load", "type": "force", "joint": "way", "site": "cell"}])
    weight = np.array([0.0, 0.0, m * 9.81])
    along = -(50.0 * q + 2.0 * v + 1.5 * v)
    for load in carried(data):
        yield load, weight - u * (weight @ u) + along * u, 1e-8


# derivatives of flows


def differences(end, at):
    """Central differences of a function of a vector."""
    at = np.asarray(at, float)
    steps = 1e-5 * np.maximum(1.0, np.abs(at))
    return np.stack([(end(at + step * row) - end(at - step * row)) / (2 * step) for step, row in zip(
        steps, np.eye(len(at)), strict=True)], axis=-1)


@value
def a_flow_by_stiffness_and_damper_of_a_hinge():
    data = scene([body("disk", 1.0, (0.2, 0.2, 0.4))], [
        joint("pin", "revolute", "disk", position=2.5, velocity=-1.0, stiffness=3.0, damping=0.2, rest_position=0.4)])
    names = ("joints.pin.stiffness", "joints.pin.damping", "joints.pin.rest_position")

    def end(p):
        return expm(0.7 * np.array([[0.0, 1.0], [-p[0] / 0.4, -p[1] / 0.4]])) @ [2.5 - p[2], -1.0] + [p[2], 0.0]

    for source in ("truth", "lieeuler:rkmk853"):
        how = {} if source == "truth" else {"rtol": 1e-12}
        found = crosscheck.flow_derivative(data, 0.7, source=source, parameters=names, **how)
        yield found.parameters, differences(end, [3.0, 0.2, 0.4]), 1e-6


@value
def a_flow_by_mass_and_armature_of_two_slides():
    data = scene([body("a", 2.0), body("b", 1.0)], [
        joint("first", "prismatic", "a", (1, 0, 0), position=0.2, velocity=0.0, stiffness=30.0),
        joint("second", "prismatic", "b", (1, 0, 0), parent="a", place=(0.0, 0.5, 0.0), position=-0.1, velocity=0.3,
              stiffness=12.0, damping=0.4, armature=0.5)])

    def end(p):
        M = np.array([[2.0 + p[0], p[0]], [p[0], p[0] + p[1]]])
        A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, np.diag([30.0, 12.0])),
                                                      -np.linalg.solve(M, np.diag([0.0, 0.4]))]])
        return expm(0.9 * A) @ [0.2, -0.1, 0.0, 0.3]

    found = crosscheck.flow_derivative(data, 0.9, parameters=("bodies.b.mass", "joints.second.armature"))
    yield found.parameters, differences(end, [1.0, 0.5]), 1e-6


def flow(rate, q0, w0, duration):
    """Of an attitude (turns in body axes, right) and the rate: the derivative of the end by the start."""
    start = Rotation.from_quat(q0, scalar_first=True)

    def end(y):
        q = (start * Rotation.from_rotvec(y[:3])).as_quat(scalar_first=True)

        def slope(_, z):
            turned = np.array([-z[1:4] @ z[4:], *(z[0] * z[4:] + np.cross(z[1:4], z[4:]))]) / 2
            return np.concatenate([turned, rate(Rotation.from_quat(z[:4], scalar_first=True), z[4:])])

        z = solve_ivp(slope, (0.0, duration), [*q, *(w0 + y[3:])], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        return Rotation.from_quat(z[:4], scalar_first=True), z[4:]

    middle, columns = end(np.zeros(6))[0], []
    for row in 1e-5 * np.eye(6):
        (R1, w1), (R2, w2) = end(row), end(-row)
        columns.append(np.concatenate([(middle.inv() * R1).as_rotvec() - (middle.inv() * R2).as_rotvec(), w1 - w2])
                       / 2e-5)
    return np.array(columns).T


@value
def a_flow_of_a_fast_top_on_an_offset_pivot():
    J, m, c = np.diag([0.2, 0.3, 0.25]) + 0.6 * 0.16 * np.diag([1.0, 1.0, 0.0]), 0.6, np.array([0.0, 0.0, -0.4])

    def rate(R, w):
        pull = R.inv().apply([0.0, 0.0, -9.81 * m])
        return np.linalg.solve(J, np.cross(c, pull) - np.cross(w, J @ w))

    q, w = np.array([0.8, 0.6, 0.0, 0.0]), np.array([1.0, -4.0, 9.0])
    for duration in (0.05, 0.34, 0.7):
        data = scene([body("top", m, (0.2, 0.3, 0.25), attitude=q.tolist(), angular_velocity=w.tolist())],
                     [joint("pivot", "spherical", "top", arm=-c)], gravity=-9.81)
        yield crosscheck.flow_derivative(data, duration).matrix, flow(rate, q, w, duration), 1e-6


@value
def a_flow_of_a_tumbling_free_body():
    """Turns and rates of a free body; its place and velocity do not meet them."""
    J = np.diag([0.1, 0.25, 0.3])
    q, w = np.array([0.5, -0.5, 0.5, 0.5]), np.array([0.4, 7.0, -0.3])
    for duration in (0.2, 0.45):
        data = scene([body("book", 1.0, (0.1, 0.25, 0.3), attitude=q.tolist(), angular_velocity=w.tolist(),
                           position=[0.0, 0.0, 0.0], velocity=[1.0, 0.0, 0.0])], [])
        matrix = np.asarray(crosscheck.flow_derivative(data, duration).matrix)
        turns = [3, 4, 5, 9, 10, 11]
        wanted = flow(lambda R, rate: np.linalg.solve(J, -np.cross(rate, J @ rate)), q, w, duration)
        yield matrix[np.ix_(turns, turns)], wanted, 1e-6
        yield matrix[np.ix_([0, 1, 2, 6, 7, 8], [0, 1, 2, 6, 7, 8])], np.block([
            [np.eye(3), duration * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]]), 1e-9


# turns between outputs


@value
def a_nut_that_turns_and_slides_on_springs():
    """A cylindrical joint with a spring in either coordinate: 40 rad/s and 3 m/s."""
    data = scene([body("nut")], [joint("screw", "cylindrical", "nut", position=[0.0, 0.0], velocity=[40.0, 3.0],
                                       stiffness=[0.5, 2.0])], 6.0, 7)
    t = np.arange(7.0)
    wanted = np.stack([40 / math.sqrt(5) * np.sin(math.sqrt(5) * t), 3 / math.sqrt(2) * np.sin(math.sqrt(2) * t)], 1)
    for name, made in every(data):
        if name != "truth":
            yield made.joints["screw"].position, wanted, 1e-3 if name != "lieeuler" else 1e-7
            yield made.energy, 80.0 + 4.5, 1e-2 if name != "lieeuler" else 1e-6


@value
def two_wheels_one_on_the_other():
    """Balanced wheels on one axis keep their rates: 31 rad/s, and -17 rad/s of the second to the first."""
    data = scene([body("drum"), body("disk")], [
        joint("axle", "revolute", "drum", (0, 1, 0), position=0.2, velocity=31.0),
        joint("bearing", "revolute", "disk", (0, 1, 0), parent="drum", position=0.0, velocity=-17.0)], 5.0, 6)
    t = np.arange(6.0)
    for name, made in every(data):
        if name != "truth":
            yield made.joints["axle"].position, 0.2 + 31.0 * t, 1e-6
            yield made.joints["bearing"].position, -17.0 * t, 1e-6


# inverse dynamics and long ways


@value
def what_a_slide_far_from_its_rest_needs():
    data = scene([body("box", 2.0)], [joint("way", "prismatic", "box", (0.6, 0, 0.8), position=0.0, velocity=0.0,
                                            stiffness=7.0, rest_position=3.0, damping=0.5)], gravity=-9.81)
    q, v, a = np.array([[-12.0], [40.0]]), np.array([[2.0], [-1.0]]), np.array([[0.0], [3.0]])
    for engine in ("truth", "pinocchio", "mujoco"):
        yield crosscheck.inverse_dynamics(data, q, v, a, engine=engine), (
            7.0 * (q - 3.0) + 0.5 * v + 2.0 * a + 2.0 * 9.81 * 0.8), 1e-8


@value
def what_a_pendulum_three_turns_on_needs():
    m, r = 1.5, 0.3
    data = scene([body("bar", m, (0.02, 0.05, 0.05))], [
        joint("pin", "revolute", "bar", (0, 1, 0), arm=(-r, 0, 0), position=0.0, velocity=0.0, stiffness=4.0,
              rest_position=-1.0, damping=0.2, armature=0.01)], gravity=-9.81)
    q, v, a = np.array([[19.0], [-25.5]]), np.array([[1.0], [-3.0]]), np.array([[0.5], [0.0]])
    for engine in ("truth", "pinocchio", "mujoco"):
        yield crosscheck.inverse_dynamics(data, q, v, a, engine=engine), (
            (0.05 + m * r * r + 0.01) * a + 4.0 * (q + 1.0) + 0.2 * v - m * 9.81 * r * np.cos(q)), 1e-8


@value
def a_long_inclined_slide():
    """Damped, 2 kg, 25 m down a slope."""
    u = np.array([0.8, 0.0, -0.6])
    data = scene([body("sledge", 2.0)], [joint("slope", "prismatic", "sledge", u, position=0.0, velocity=0.0,
                                               stiffness=0.4, damping=0.3)], 4.0, 9, -9.81)
    A = np.array([[0.0, 1.0, 0.0], [-0.2, -0.15, 9.81 * 0.6], [0.0, 0.0, 0.0]])
    wanted = np.array([expm(A * t)[0, 2] for t in data.t])
    for name, made in every(data):
        x = made.states.x if name == "truth" else made.x
        yield x[:, 0] @ u, wanted, 1e-7


@value
def a_bead_that_flies_out_along_a_turning_rod():
    """r'' = r w^2 - k (r - 2) / m, w (J + m r^2) constant: 30 m out."""
    data = scene([body("rod", 1.0, (0.1, 0.5, 0.5)), body("bead", 0.5, (0.01, 0.01, 0.01))], [
        joint("pin", "revolute", "rod", position=0.0, velocity=20.0),
        joint("way", "prismatic", "bead", (1, 0, 0), parent="rod", position=1.0, velocity=0.0, stiffness=0.05,
              rest_position=2.0)], 4.0, 9)
    spin = 20.0 * (0.5 + 0.01 + 0.5)
    r, *_ = solved(lambda _, y: [y[1], y[0] * (spin / (0.51 + 0.5 * y[0] ** 2)) ** 2 - 0.1 * (y[0] - 2.0),
                                 spin / (0.51 + 0.5 * y[0] ** 2)], [1.0, 0.0, 0.0], data.t)
    assert r.max() > 20.0
    for name, made in every(data):
        if name == "truth":
            yield np.linalg.norm(made.states.x[:, 1], axis=1), r, 1e-7
        else:
            yield made.joints["way"].position, r, 1e-5


# held torques, servos, stops


@value
def a_force_held_on_a_slide():
    """The times of its changes meet no output."""
    times, values = [0.33, 0.71, 1.27], [3.0, -2.0, 5.0]
    data = scene([body("box", 2.0)], [joint("way", "prismatic", "box", (0, 1, 0), position=0.1, velocity=0.0,
                                            stiffness=40.0, damping=0.5)], 2.0, 41, forces=[
        {"type": "joint_force", "joint": "way", "force": {"type": "hold", "times": times, "values": values}}])
    wanted = held(data.t, times, values)
    made = crosscheck.run(data, "lieeuler", "rkmk853", rtol=1e-10)
    yield made.joints["way"].position, wanted, 1e-7
    verdict = made.verdict() if hasattr(made, "verdict") else None
    yield verdict is None or verdict.outcome == "pass", True, 0
    yield crosscheck.truth(data).states.x[:, 0, 1], wanted, 1e-9


def held(t, times, values):
    """A spring of 40 N/m, .5 N s/m, 2 kg from .1 m at rest under forces that are held."""
    A, found = np.array([[0.0, 1.0, 0.0], [-20.0, -0.25, 0.5], [0.0, 0.0, 0.0]]), []
    for end in t:
        y, at = np.array([0.1, 0.0]), 0.0
        for begin, force in zip([0.0, *times[1:]], values, strict=True):
            until = min(end, ([*times[1:], np.inf])[values.index(force)])
            if until > begin:
                y, at = (expm(A * (until - at)) @ [*y, force])[:2], until
        found.append(y[0])
    return np.array(found)


@value
def a_sampled_servo_on_a_hinge():
    """kp 8, kd .6, every 50 ms, cut at 1.2 N m, on .2 kg m^2."""
    data = scene([body("arm", 1.0, (0.2, 0.2, 0.2))], [joint("pin", "revolute", "arm", position=0.0, velocity=0.0)],
                 1.5, 31, forces=[{"type": "servo", "joint": "pin", "target": 0.7, "proportional": 8.0,
                                   "derivative": 0.6, "effort_limit": 1.2, "period": 0.05}])
    q, v, wanted = 0.0, 0.0, []
    for _ in data.t:
        wanted.append(q)
        a = np.clip(8.0 * (0.7 - q) - 0.6 * v, -1.2, 1.2) / 0.2
        q, v = q + 0.05 * v + 0.05**2 / 2 * a, v + 0.05 * a
    made = crosscheck.run(data, "lieeuler", "rkmk853", rtol=1e-10)
    yield made.joints["pin"].position, wanted, 1e-8
    spent = 0.1 * made.w[:, 0, 2] ** 2
    yield made.energy, spent, 1e-9


def bouncing(extra_bodies, extra_joints, ways, axis=(0, 0, 1), kind="revolute"):
    """One that falls by .5 at 1 and leaves at .5: t > 1: .5 (t - 1) - .5 (t - 1)^2."""
    data = scene([*extra_bodies, body("b")], [*extra_joints, joint(
        "jb", kind, "b", axis, place=(0.0, 1.0, 0.0), position=0.5, velocity=0.0,
        limits={"lower": 0.0, "restitution": 0.5})], 1.9, 20, forces=[
        {"type": "joint_torque" if kind == "revolute" else "joint_force", "joint": f"j{name}",
         "torque" if kind == "revolute" else "force": value} for name, value in ways])
    u = np.maximum(data.t - 1.0, 0.0)
    return data, np.where(u > 0, 0.5 * u - 0.5 * u**2, 0.5 - 0.5 * data.t**2)


@value
def a_hinge_bounces_while_another_rests():
    data, wanted = bouncing([body("a")], [joint("ja", "revolute", "a", position=0.0, velocity=0.0,
                                                limits={"lower": 0.0, "restitution": 0.3})], [("a", -2.0), ("b", -0.1)])
    reference = crosscheck.truth(data)
    yield reference.horizon, 1.9, 1e-9
    yield np.arctan2(reference.states.R[:, 1, 1, 0], reference.states.R[:, 1, 0, 0]), wanted, 1e-9
    for method, how in (("rkmk4", {"step": 1e-3}), ("rkmk853", {"rtol": 1e-10}), ("taylor", {"rtol": 1e-10})):
        made = crosscheck.run(data, "lieeuler", method, **how)
        yield made.joints["jb"].position, wanted, 1e-6
        yield made.joints["ja"].position, 0.0, 1e-12


@value
def a_slide_bounces_beside_two_that_rest():
    """One on a rigid stop, one that sinks into a soft one."""
    data, wanted = bouncing([body("a"), body("c")], [
        joint("ja", "prismatic", "a", (1, 0, 0), position=0.0, velocity=0.0, limits={"lower": 0.0}),
        joint("jc", "prismatic", "c", (1, 0, 0), place=(0.0, 2.0, 0.0), position=0.0, velocity=0.0,
              limits={"lower": 0.0, "stiffness": 200.0, "damping": 3.0})],
        [("a", -1.0), ("c", -2.0), ("b", -1.0)], (1, 0, 0), "prismatic")
    sunk, _ = solved(lambda _, y: [y[1], -2.0 - 200.0 * y[0] - 3.0 * y[1]], [0.0, 0.0], data.t)
    reference = crosscheck.truth(data)
    yield reference.horizon, 1.9, 1e-9
    yield reference.states.x[:, 2, 0], wanted, 1e-9
    yield reference.states.x[:, 1, 0], sunk, 1e-9
    for method, how in (("rkmk4", {"step": 1e-3}), ("rkmk853", {"rtol": 1e-10}), ("taylor", {"rtol": 1e-10})):
        made = crosscheck.run(data, "lieeuler", method, **how)
        yield made.joints["jb"].position, wanted, 1e-6
        yield made.joints["jc"].position, sunk, 1e-7


def never_wrong(data, body_index, coordinate, wanted, horizon):
    """States of truth are right, or they are not numbers."""
    reference = crosscheck.truth(data)
    yield reference.horizon, horizon, 1e-6
    found = coordinate(reference.states, body_index)
    known = np.isfinite(found)
    yield known[data.t[:len(known)] <= reference.horizon - 1e-9].all(), True, 0
    yield np.where(known, found, wanted[:len(found)]), wanted[:len(found)], 1e-8


@value
def a_hinge_pressed_on_its_stop_carries_one_that_hits_its_own():
    """a rests under 3 N m; b turns on it by .5 rad at .5 N m on .1 kg m^2: .4472 s, where both stops act."""
    data = scene([body("a"), body("b")], [
        joint("ja", "revolute", "a", position=0.5, velocity=0.0, limits={"upper": 0.5, "restitution": 0.0}),
        joint("jb", "revolute", "b", parent="a", position=0.0, velocity=0.0,
              limits={"upper": 0.5, "restitution": 0.5})], 1.0, 21, forces=[
        {"type": "joint_torque", "joint": "ja", "torque": 3.0}, {"type": "joint_torque", "joint": "jb", "torque": 0.5}])
    yield from never_wrong(data, 0, lambda states, k: np.arctan2(states.R[:, k, 1, 0], states.R[:, k, 0, 0]),
                           np.full(21, 0.5), math.sqrt(0.2))


@value
def three_carriages_in_a_row_of_which_two_are_pressed():
    """c rides on b, b on a; a and b rest on stops, c hits an elastic one after sqrt(.6) s at 1 m/s^2."""
    slide = {"velocity": 0.0, "limits": {"upper": 0.3, "restitution": 0.0}}
    data = scene([body("a"), body("b"), body("c")], [
        joint("ja", "prismatic", "a", (1, 0, 0), position=0.3, **slide),
        joint("jb", "prismatic", "b", (1, 0, 0), parent="a", place=(0.0, 1.0, 0.0), position=0.3, **slide),
        joint("jc", "prismatic", "c", (1, 0, 0), parent="b", place=(0.0, 1.0, 0.0), position=0.0, velocity=0.0,
              limits={"upper": 0.3, "restitution": 0.8})], 1.5, 16, 1.0, axis=0)
    yield from never_wrong(data, 1, lambda states, k: states.x[:, k, 0], np.full(16, 0.6), math.sqrt(0.6))


@pytest.mark.parametrize("name", VALUES)
def test_figures_are_right(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for found, wanted, tolerance in VALUES[name]():
        difference = np.abs(np.asarray(found, float) - np.asarray(wanted, float))
        assert np.all(difference <= tolerance), (found, wanted)
