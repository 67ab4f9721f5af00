"""Two more variations of each case of strangers, by a second hand: what is right is from closed forms, SciPy or MuJoCo.

The answers were committed before any of these commands was run on them.
"""

from __future__ import annotations

import functools
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import crosscheck
from tests.cases import test_variations as first
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
)
from tests.cases.test_variations import OFFSET, PIVOT, SHARE, TIMES, TOUCH, answered, every, flown, write

CASES: dict[str, first.Case] = {}
VALUES = {}
case = functools.partial(first.case, to=CASES)


def value(make):
    """Add a function that yields pairs of what was found and what is right, with the tolerance."""
    VALUES[make.__name__] = make
    return make


# --- models that differ -------------------------------------------------------------------------------------------

TWIN = """<mujoco model="twin">{defaults}<worldbody><body name="a"><joint name="swing" axis="0 1 0" {own}/>
<inertial pos="0 0 -.2" mass="1" diaginertia=".01 .01 .001"/><body name="b" pos="0 0 -.4"><joint name="slip"
type="slide" axis="1 0 0" {own}/><inertial pos="0 0 0" mass=".3" diaginertia=".001 .001 .001"/></body></body>
</worldbody></mujoco>"""


@case(0, lacks=(r"^(swing|slip):",))
def numbers_of_a_default_class_are_those_of_each_joint():
    numbers = 'damping=".3" frictionloss=".15" armature=".02"'
    write("a.xml", TWIN.format(defaults=f"<default><joint {numbers}/></default>", own=""))
    write("b.xml", TWIN.format(defaults="", own=numbers))
    return "inspect a.xml b.xml"


@case(1, shows=(r"hoist_z.*mimic.*-1\.5",), lacks=(r"^bridge_x",))
def a_mimic_with_another_sign():
    for name, factor in (("a.urdf", 1.5), ("b.urdf", -1.5)):
        write(name, gantry().replace('<axis xyz="0 0 1"/>', f'<axis xyz="0 0 1"/><mimic joint="bridge_x" '
                                                            f'multiplier="{factor}" offset=".05"/>'))
    return "diff a.urdf b.urdf"


# --- a touch ends what can be judged ------------------------------------------------------------------------------

BELL = """<mujoco model="bell"><worldbody><geom name="plate" type="box" size=".05 1 1" pos="-.2 0 0"/>
<body name="clapper"><joint name="swing" axis="0 1 0" damping=".02"/>
<inertial pos="0 0 -.4" mass=".7" diaginertia=".004 .004 .002"/><geom type="sphere" size=".05" pos="0 0 -.4"/></body>
</worldbody></mujoco>"""


@case(3, shows=("touch", "unresolved"))
def a_pendulum_until_it_hits_a_plate():
    """The centre of the ball is at -.4 sin(q) along x; it touches at -.1."""
    def rate(_, y):
        return [y[1], (-0.7 * 9.81 * 0.4 * np.sin(y[0]) - 0.02 * y[1]) / (0.004 + 0.7 * 0.16)]

    def hit(_, y):
        return y[0] - math.asin(0.25)

    touched = solve_ivp(rate, (0, 2), [-1.2, 0.0], "DOP853", events=hit, rtol=1e-11, atol=1e-12).t_events[0][0]
    q, v, _ = simulated(BELL, TIMES, qpos=[-1.2], step=1e-4)
    write("bell.xml", BELL)
    table(Path("log.csv"), {"time_ms": 1e3 * TIMES, "swing_pos_deg": np.degrees(q[0]),
                            "swing_vel_deg_s": np.degrees(v[0])})
    return "judge bell.xml log.csv --start recorded --tol joint_position=1e-3", {SHARE: (100 * touched, 1.5)}


def carriages(form):
    """Two on one rail, half a side of .1, .8 apart, that meet after .8 s at .6 and .4 m/s, without gravity along it."""
    if form == "urdf":
        box = '<collision><geometry><box size=".2 .2 .2"/></geometry></collision>'
        return ('<robot name="rail"><link name="base"/>' + "".join(
            f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" '
            f'ixz="0" iyz="0"/></inertial>{box}</link><joint name="{name}_x" type="prismatic"><parent link="base"/>'
            f'<child link="{name}"/><origin xyz="{place} 0 1"/><axis xyz="1 0 0"/><limit lower="-9" upper="9" '
            f'effort="9" velocity="9"/></joint>' for name, mass, place in (("left", 2, -0.5), ("right", 3, 0.5)))
            + "</robot>")
    return ('<mujoco model="rail"><worldbody>' + "".join(
        f'<body name="{name}" pos="{place} 0 1"><joint name="{name}_x" type="slide" axis="1 0 0"/><geom type="box" '
        f'size=".1 .1 .1" mass="{mass}"/></body>' for name, mass, place in (("left", 2, -0.5), ("right", 3, 0.5)))
        + "</worldbody></mujoco>")


@case(0, shows=("touch",))
def two_carriages_until_they_meet_as_far_as_is_needed():
    write("rail.urdf", carriages("urdf"))
    table(Path("log.tsv"), {"t": TIMES, "left_x_pos_cm": -10 / 7 + 60 * TIMES,
                            "right_x_pos_cm": 10 / 7 - 40 * TIMES}, "\t")
    return ("judge rail.urdf log.tsv --start recorded --tol joint_position=1e-4 --need .75",
            {TOUCH: (0.8 + 0.2 / 7, 5e-3)})


@case(3, shows=("touch", "left.*right|right.*left", "unresolved"))
def two_carriages_that_would_pass_through_each_other():
    write("rail.xml", carriages("xml"))
    table(Path("log.csv"), {"stamp": 100.0 + TIMES, "left_x.position": 0.6 * TIMES, "left_x.velocity": 0.6 + 0 * TIMES,
                            "right_x.position": -0.4 * TIMES, "right_x.velocity": -0.4 + 0 * TIMES})
    return ("judge rail.xml log.csv --start recorded --tol joint_position=1e-4", {SHARE: (80.0, 1.5)})


@case(3, shows=("unresolved", "touch"))
def a_leg_of_a_urdf_whose_shin_meets_its_base():
    text = leg(0.05, 0.02, shapes=True)
    q, v, touched = simulated(text, 2 * TIMES, qpos=[1.2, -0.3], step=2e-4)
    write("leg.urdf", text)
    table(Path("log.csv"), {"t": 2 * TIMES, "hip": q[0], "knee": q[1], "hip_vel": v[0], "knee_vel": v[1]})
    return ("judge leg.urdf log.csv --start recorded --tol joint_position=1e-3", {SHARE: (50 * touched, 1.5)})


# --- causes -------------------------------------------------------------------------------------------------------


@case(1, shows=(r"cause.*friction|friction.*(cause|missing|absent|0)", "fail"), lacks=("internal",))
def a_cart_without_its_dry_friction():
    write("cart.xml", CART.format(damping=0.7).replace('damping="0.7"', 'damping="0.7" frictionloss="1.2"'))
    x, v = cart(TIMES)
    table(Path("log.csv"), {"t": TIMES, "cart.position [mm]": 1e3 * x, "cart.velocity [mm/s]": 1e3 * v})
    return "judge cart.xml log.csv --start recorded --tol joint_position=1e-3"


@case(1, shows=("armature|rotor", "fail"), lacks=("internal",))
def a_pendulum_without_the_inertia_of_its_rotor():
    write("pend.xml", PIVOT.replace('axis="1 0 0"', 'axis="1 0 0" armature=".004"'))
    q, v = solved(lambda _, y: [y[1], -0.4 * 9.81 * 0.2 * np.sin(y[0]) / (0.0006 + 0.4 * 0.04)], [1.2, 0.0], TIMES)
    table(Path("log.csv"), {"t": TIMES, "pivot": q, "pivot_vel": v})
    return "judge pend.xml log.csv --start recorded --tol joint_position=1e-3"


# --- when parts touch ---------------------------------------------------------------------------------------------

DIE = """<mujoco model="die"><worldbody><geom name="floor" type="plane" size="0 0 .1"/>
<body name="die" pos="0 0 .6"><freejoint/><geom type="box" size=".05 .08 .11" mass=".6"/></body></worldbody>
<keyframe><key name="throw" qpos="0 0 .6 .8 .36 .48 0" qvel="1 0 1 4 -3 2"/></keyframe></mujoco>"""


@case(0, shows=("die", "floor"))
def a_die_that_tumbles_to_the_floor():
    write("die.xml", DIE)
    *_, touched = simulated(DIE, np.array([1.0]), key="throw", step=5e-5)
    assert 0.2 < touched < 0.9
    return "truth die.xml --keyframe throw", {TOUCH: (touched, 1e-3)}


FLAIL = """<mujoco model="flail"><worldbody><geom name="post" type="capsule" fromto="0 0 0 0 0 .55" size=".03"/>
<body name="arm" pos="0 .0 1.2"><joint name="top" axis="0 1 0"/><inertial pos="0 0 -.2" mass=".8"
diaginertia=".01 .01 .001"/><body name="stick" pos="0 0 -.4"><joint name="low" axis="0 1 0" damping=".01"/>
<geom type="cylinder" fromto="0 .02 0 0 .02 -.35" size=".025" mass=".3"/></body></body></worldbody></mujoco>"""


@case(0, shows=("stick", "post"))
def a_stick_on_two_hinges_that_hits_a_post():
    write("flail.xml", FLAIL)
    *_, touched = simulated(FLAIL, np.array([1.9]), qpos=[1.4, 0.3], step=1e-4)
    assert 0.1 < touched < 1.8
    return "truth flail.xml --qpos 1.4,.3", {TOUCH: (touched, 1e-3)}


# --- what touches at the start ------------------------------------------------------------------------------------


@case(2, shows=("ground - crate", "--drop"))
def a_crate_that_stands_on_a_table():
    write("crate.xml", """<mujoco><worldbody><geom name="table" type="box" size="1 1 .4" pos="0 0 .4"/>
        <body name="crate" pos="0 0 1"><freejoint/><geom type="box" size=".2 .2 .2" mass="3"/></body></worldbody>
        </mujoco>""")
    return "import crate.xml -o crate.toml"


@case(3, shows=("left.*right|right.*left", "unresolved"), lacks=(r"^pass",))
def fingers_of_a_gripper_that_are_closed():
    write("gripper.xml", carriages("xml").replace('pos="-0.5 ', 'pos="-.0995 ').replace('pos="0.5 ', 'pos=".0995 ')
          .replace('axis="1 0 0"', 'axis="1 0 .2"'))
    return "run gripper.xml --drop"


# --- logs of free bodies ------------------------------------------------------------------------------------------


@case(0)
def a_motion_capture_in_millimetres_with_signs_of_quaternions_that_flip():
    """At 100 Hz; q and -q are one attitude."""
    x, R, *_ = flown()
    q = R.as_quat() * np.where(np.arange(len(x)) % 2, -1.0, 1.0)[:, None]
    table(Path("mocap.csv"), dict(zip(["t", *(f"torso_pos_{axis}_mm" for axis in "xyz"), "torso_qx", "torso_qy",
                                       "torso_qz", "torso_qw"], [TIMES, *1e3 * (x + R.apply(OFFSET)).T, *q.T],
                                      strict=True)), digits=9)
    return "judge trunk.xml mocap.csv --keyframe go --tol position=1e-4 --tol attitude=1e-4"


@case(0)
def a_root_state_whose_velocities_are_those_of_the_centre_of_mass():
    """Pose of the frame's origin, w first; velocities of the centre of mass in axes of the world."""
    x, R, _, w, _ = flown()
    speeds = np.array([0.4, -0.2, 2.5]) + R[0].apply(np.cross([1.5, -0.7, 2.0], OFFSET)) + np.outer(
        TIMES, [0, 0, -9.81])
    columns = [TIMES, *x.T, *R.as_quat(scalar_first=True).T, *speeds.T, *R.apply(w).T]
    table(Path("log.csv"), dict(zip(["time", *(f"root_pos_w_{axis}" for axis in "xyz"), *(
        f"root_quat_w_{part}" for part in "wxyz"), *(f"root_com_lin_vel_w_{axis}" for axis in "xyz"), *(
        f"root_com_ang_vel_w_{axis}" for axis in "xyz")], columns, strict=True)), digits=10)
    return "judge trunk.xml log.csv --keyframe go --start recorded --tol position=1e-4 --tol attitude=1e-4"


# --- OpenSim, Modelica, tables without times ----------------------------------------------------------------------


@case(0)
def states_in_radians_beside_activations():
    q, v, _ = simulated(leg(0.05, 0.02), TIMES, qpos=[0.9, -0.4])
    write("leg.urdf", leg(0.05, 0.02))
    opensim(Path("states.sto"), {"time": TIMES} | {
        f"/jointset/{name}_joint/{name}/{key}": values[k] for k, name in enumerate(("hip", "knee"))
        for key, values in (("value", q), ("speed", v))} | {
        "/forceset/vastus/activation": 0.1 + 0 * TIMES, "/forceset/vastus/fiber_length": 0.2 + 0 * TIMES},
        "inDegrees=no", "DataType=double", "version=3")
    return "judge leg.urdf states.sto --start recorded --tol joint_position=1e-4 --tol joint_velocity=1e-3"


@case(0)
def a_motion_that_begins_at_half_a_second():
    q, v, _ = simulated(leg(0.05, 0.02), TIMES, qpos=[0.9, -0.4])
    write("leg.urdf", leg(0.05, 0.02))
    opensim(Path("motion.mot"), {"time": 0.5 + TIMES, "hip": np.degrees(q[0]), "knee": np.degrees(q[1]),
                                 "hip_u": np.degrees(v[0]), "knee_u": np.degrees(v[1])}, "inDegrees=yes")
    return "judge leg.urdf motion.mot --start recorded --tol joint_position=1e-4"


def hinges_of_modelica(digits, shift=0.0):
    """Angles and rates of the leg with three rows at an event at .4 s; the last digits of a repeat may differ."""
    t = np.sort(np.concatenate([TIMES, [0.4, 0.4, 1.0]]))
    q, v, _ = simulated(leg(0.05, 0.02), TIMES, qpos=[0.9, -0.4])
    rows = np.searchsorted(TIMES, t - 1e-9)
    again = np.append(0, np.diff(rows) == 0) * shift
    write("leg.urdf", leg(0.05, 0.02))
    table(Path("leg_res.csv"), {"time": t, "hip.phi": q[0, rows] + again, "hip.w": v[0, rows] - again,
                                "knee.phi": q[1, rows] - again, "knee.w": v[1, rows] + again},
          quoted=True, digits=digits)
    return "judge leg.urdf leg_res.csv --start recorded --tol joint_position=1e-4 --tol joint_velocity=1e-3"


@case(0)
def angles_and_rates_by_their_names_of_modelica():
    return hinges_of_modelica(17)


@case(0)
def rows_at_an_event_that_differ_in_their_last_digits():
    return hinges_of_modelica(15, 3e-15)


@case(2, shows=("--period", "time"))
def angles_without_times_and_without_a_period():
    q, v, _ = simulated(leg(), TIMES, qpos=[0.9, -0.4])
    write("leg.urdf", leg())
    table(Path("log.csv"), {"hip": q[0], "knee": q[1], "hip_vel": v[0], "knee_vel": v[1]})
    return "judge leg.urdf log.csv --start recorded --tol joint_position=1e-4"


@case(0)
def joint_states_in_another_order_with_seconds_and_nanoseconds():
    """As a bag's export: `secs` and `nsecs` of the stamp, names in cells, the knee first."""
    q, v, _ = simulated(leg(0.05, 0.02), TIMES, qpos=[0.9, -0.4])
    write("leg.urdf", leg(0.05, 0.02))
    names = ["header.stamp.secs", "header.stamp.nsecs", "name0", "name1", "position0", "position1", "velocity0",
             "velocity1"]
    lines = [",".join(names)]
    for k, t in enumerate(TIMES):
        whole = int(t + 1e-9)
        cells = [1700000000 + whole, round((t - whole) * 1e9), "knee", "hip", q[1, k], q[0, k], v[1, k], v[0, k]]
        lines.append(",".join(str(cell) for cell in cells))
    write("log.csv", "\n".join(lines) + "\n")
    return "judge leg.urdf log.csv --start recorded --tol joint_position=1e-4"


# --- steps --------------------------------------------------------------------------------------------------------


@case(1, shows=(r"order\D{0,20}1\b|order\D{0,20}(\.9\d|1\.0\d?)",))
def two_steps_of_explicit_euler():
    write("pend.xml", PIVOT)
    for step in (0.01, 0.005):
        table(Path(f"log_{step:g}.csv"), first.explicit(step), digits=11)
    return ("judge pend.xml log_0.01.csv log_0.005.csv --step .01 --step .005 --start recorded "
            "--tol joint_position=1e-3")


@case(0, shows=(r"order\D{0,20}2\b|order\D{0,20}(1\.9\d|2\.0\d?)",))
def two_steps_of_the_midpoint_rule():
    A = np.array([[0.0, 1.0], [-15.0, -0.35]])
    write("cart.xml", CART.format(damping=0.7))
    for step in (0.02, 0.01):
        advance, rows = np.eye(2) + step * A + step**2 / 2 * A @ A, [np.array([0.3, 0.1])]
        for _ in range(round(2 / step)):
            rows.append(advance @ rows[-1])
        x, v = np.array(rows).T
        table(Path(f"log_{step:g}.csv"), {"t": step * np.arange(len(x)), "cart.position": x, "cart.velocity": v},
              digits=15)
    return "judge cart.xml log_0.02.csv log_0.01.csv --step .02 --step .01 --start recorded --tol joint_position=1e-2"


# --- models of Gazebo, papers -------------------------------------------------------------------------------------


@case(2, shows=("pip install", "pybullet|drake|newton"), lacks=("internal",))
def a_run_of_a_hinge_of_gazebo():
    write("swing.sdf", first.SDF.format(name="swing", kind="revolute", axis="<axis><xyz>0 1 0</xyz></axis>"))
    return "run swing.sdf --engine mujoco --method RK4"


@case(2, shows=("pip install", "pybullet|drake|newton"), lacks=("internal",))
def a_log_of_a_screw_of_gazebo():
    write("screw.world", first.SDF.format(name="screw", kind="screw", axis="<axis><xyz>0 0 1</xyz></axis>"))
    table(Path("log.csv"), {"t": TIMES, "b": TIMES})
    return "judge screw.world log.csv"


@case(0, 3, shows=("größe|gr|spin",), lacks=("internal",))
def a_paper_on_an_engine_with_letters_beyond_ascii():
    return first.paper("größe~^{}", ("#1 & co",)) + "\nreport out --format paper"


# --- the error of a run -------------------------------------------------------------------------------------------


@case(0, 3, shows=("resolved",))
def the_error_of_pinocchios_symplectic_euler():
    x, v, places = 0.3, 0.0, [0.3]
    for _ in range(100):
        v -= 0.02 * 15.0 * x
        x += 0.02 * v
        places.append(x)
    error = np.abs(np.array(places)[::5] - 0.3 * np.cos(math.sqrt(15.0) * np.linspace(0.0, 2.0, 21))).max()
    write("cart.xml", CART.format(damping=0))
    return ("run cart.xml --engine pinocchio --method SymplecticEuler --step .02 --qpos .3 --duration 2 --samples 21",
            {r"error against truth: position (\S+) m": (error, 0.06 * error)})


BOOK = """<mujoco model="spin"><option gravity="0 0 0"/><worldbody><body name="book"><freejoint/>
<inertial pos="0 0 0" mass="1" diaginertia=".01 .03 .025"/></body></worldbody>
<keyframe><key name="go" qpos="0 0 0 1 0 0 0" qvel="0 0 0 2 1 5"/></keyframe></mujoco>"""


@case(0, 3, shows=("resolved",))
def the_error_of_an_attitude():
    write("spin.xml", BOOK)
    t = np.linspace(0.0, 1.0, 21)
    q, *_ = simulated(BOOK, t, key="go", step=5e-3, integrator="Euler")
    *_, R, _ = thrown(t, (0.01, 0.03, 0.025), np.zeros(3), np.zeros(3), [1.0, 0, 0, 0], [2.0, 1.0, 5.0])
    error = (Rotation.from_quat(q[3:].T, scalar_first=True).inv() * R).magnitude().max()
    return ("run spin.xml --engine mujoco --method Euler --step 5e-3 --keyframe go --duration 1 --samples 21",
            {r"attitude (\S+) rad": (error, 0.06 * error)})


# --- advice -------------------------------------------------------------------------------------------------------


def spring_errors(order):
    """The largest step, an even part of .1 s, whose error is below a bound, of the method of `OWN`."""
    A, t = np.array([[0.0, 1.0], [-20.0, 0.0]]), np.linspace(0.0, 2.0, 21)

    def largest(bound):
        for n in range(1, 10**6):
            h = 0.1 / n
            power = np.linalg.matrix_power(np.eye(2) + h * A + (order - 1) * h * h / 2 * A @ A, n)
            rows = [np.array([0.3, 0.0])]
            for _ in t[1:]:
                rows.append(power @ rows[-1])
            if np.abs(np.array(rows)[:, 0] - 0.3 * np.cos(math.sqrt(20.0) * t)).max() <= bound:
                return h
        raise AssertionError

    return largest


@case(0, shows=("euler",), lacks=("no method reaches",))
def advice_of_a_method_of_order_one():
    right = spring_errors(1)(5e-3)
    return first.advised(1, "euler", 5e-3), {r"step[^\d]*(\d[\d.e-]*) s": (right * 0.75, right * 0.3)}


@case(0, shows=("midpoint",), lacks=("no method reaches",))
def advice_of_a_method_of_order_two_for_a_small_error():
    right = spring_errors(2)(1e-6)
    return first.advised(2, "midpoint", 1e-6), {r"step[^\d]*(\d[\d.e-]*) s": (right * 0.75, right * 0.3)}


@value
def advice_for_a_wheel_that_turns_about_its_centre():
    """Positions rest; the angle is .9 cos(3 t) + sin(3 t) / 3 on a spring of .9 N m/rad and .1 kg m^2."""
    data = scene([body("wheel")], [joint("pin", "revolute", "wheel", position=0.9, velocity=1.0, stiffness=0.9)], 3.0,
                 31)
    advice = crosscheck.advise(data, engine="mujoco", error=1e-5)
    assert advice.method is not None
    made = crosscheck.run(data, "mujoco", advice.method, step=advice.step)
    yield made.joints["pin"].position, 0.9 * np.cos(3 * data.t) + np.sin(3 * data.t) / 3, 1e-5 * np.pi


@value
def advice_of_lieeuler_for_a_book():
    data = scene([body("book", 1.0, (0.01, 0.03, 0.025), position=[0.0, 0.0, 0.0],
                       angular_velocity=[0.2, 0.1, 5.0])], [], 2.0, 21)
    advice = crosscheck.advise(data, engine="lieeuler", error=1e-7)
    assert advice.method is not None
    how = {"step": advice.step} if advice.step is not None else {"rtol": advice.rtol}
    made = crosscheck.run(data, "lieeuler", advice.method, **how)
    *_, R, _ = thrown(data.t, (0.01, 0.03, 0.025), np.zeros(3), np.zeros(3), [1.0, 0, 0, 0], [0.2, 0.1, 5.0])
    yield (Rotation.from_matrix(made.R[:, 0]).inv() * R).magnitude().max(), 0, 1e-7 * np.pi


# --- bisect -------------------------------------------------------------------------------------------------------


@value
def a_release_without_a_wheel_between_two_answers():
    words = first.changed(1.0, None, 2.0, 2.0)
    yield len(words), 1, 0
    yield "3.2.0" in words[0], True, 0


@value
def an_answer_that_goes_and_comes_back():
    words = first.changed(1.0, 2.0, 2.0, 1.0)
    yield [re.search(r"3\.\d\.0", each)[0] == name for each, name in zip(words, ("3.1.0", "3.3.0"), strict=True)], 1, 0


# --- what a joint carries -----------------------------------------------------------------------------------------


def cell(kind, name):
    return {"sites": [{"name": "cell", "body": name, "position": [0.0, 0.0, 0.0]}],
            "sensors": [{"name": "load", "type": kind, "joint": "j", "site": "cell"}]}


@value
def a_weight_that_hangs_on_its_spring():
    """At rest the joint carries the weight, along the slide and across."""
    u, m = np.array([0.8, 0.0, -0.6]), 2.5
    data = scene([body("box", m)], [joint("j", "prismatic", "box", u, position=m * 9.81 * 0.6 / 90.0, velocity=0.0,
                                          stiffness=90.0, damping=3.0)], gravity=-9.81, **cell("force", "box"))
    for load in first.carried(data):
        yield load, [0.0, 0.0, m * 9.81], 1e-8


@value
def a_motor_and_a_damper_about_a_shaft():
    """The centre of mass is .3 m along the shaft, so that its weight is carried across it."""
    m, r, v = 1.5, 0.3, 2.0
    data = scene([body("bar", m, (0.02, 0.05, 0.05))], [
        joint("j", "revolute", "bar", (1, 0, 0), arm=(-r, 0, 0), position=0.0, velocity=v, damping=0.4)],
        gravity=-9.81, forces=[{"type": "joint_torque", "joint": "j", "torque": 2.0}],
        sites=[{"name": "cell", "body": "bar", "position": [-r, 0.0, 0.0]}],
        sensors=[{"name": "load", "type": "torque", "joint": "j", "site": "cell"}])
    for load in first.carried(data):
        yield load, [2.0 - 0.4 * v, -r * m * 9.81, 0.0], 1e-8


# --- derivatives of flows -----------------------------------------------------------------------------------------


@value
def a_flow_by_gravity_and_damping():
    """A weight of 2 kg falls along a slide with a damper."""
    def end(p):
        rate = p[1] / 2.0
        fallen = (1 - math.exp(-0.8 * rate)) / rate
        return np.array([0.1 + 0.5 * fallen + p[0] / rate * (0.8 - fallen), 0.5 * math.exp(-0.8 * rate)
                         + p[0] * fallen])

    data = scene([body("box", 2.0)], [joint("way", "prismatic", "box", (0, 0, 1), position=0.1, velocity=0.5,
                                            damping=1.2)], gravity=-9.81)
    for source, how in (("truth", {}), ("lieeuler:rkmk853", {"rtol": 1e-12})):
        found = crosscheck.flow_derivative(data, 0.8, source=source, parameters=("gravity.2", "joints.way.damping"),
                                           **how)
        yield found.parameters, first.differences(end, [-9.81, 1.2]), 1e-6


@value
def a_flow_by_the_arm_of_a_pendulum():
    """By its mass and by a moment of inertia."""
    def end(p):
        return solve_ivp(lambda _, y: [y[1], p[0] * 9.81 * 0.3 * np.cos(y[0]) / (p[1] + p[0] * 0.09)], (0, 0.6),
                         [0.2, -0.4], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]

    data = scene([body("bar", 1.5, (0.02, 0.05, 0.05))], [
        joint("pin", "revolute", "bar", (0, 1, 0), arm=(-0.3, 0, 0), position=0.2, velocity=-0.4)], gravity=-9.81)
    found = crosscheck.flow_derivative(data, 0.6, parameters=("bodies.bar.mass", "bodies.bar.inertia.1.1"))
    yield found.parameters, first.differences(end, [1.5, 0.05]), 1e-6


@value
def a_flow_of_a_pendulum_on_a_ball_joint():
    J, m, c = np.diag([0.1, 0.12, 0.02]) + 2.0 * 0.25 * np.diag([1.0, 1.0, 0.0]), 2.0, np.array([0.0, 0.0, -0.5])

    def rate(R, w):
        return np.linalg.solve(J, np.cross(c, R.inv().apply([0.0, 0.0, -9.81 * m])) - np.cross(w, J @ w))

    q, w = np.array([0.6, 0.0, 0.8, 0.0]), np.array([0.2, 3.0, -1.0])
    for duration in (0.04, 0.25, 0.9):
        data = scene([body("bob", m, (0.1, 0.12, 0.02), attitude=q.tolist(), angular_velocity=w.tolist())],
                     [joint("pivot", "spherical", "bob", arm=-c)], gravity=-9.81)
        yield crosscheck.flow_derivative(data, duration).matrix, first.flow(rate, q, w, duration), 1e-6


@value
def a_flow_of_a_fast_spinning_disk_on_a_ball_joint():
    J = np.diag([0.05, 0.05, 0.09])
    q, w = np.array([0.5, 0.5, -0.5, 0.5]), np.array([0.3, -0.2, 120.0])
    for duration in (0.05, 0.2):
        data = scene([body("disk", 1.0, (0.05, 0.05, 0.09), attitude=q.tolist(), angular_velocity=w.tolist())],
                     [joint("pivot", "spherical", "disk")], gravity=-9.81)
        wanted = first.flow(lambda R, rate: np.linalg.solve(J, -np.cross(rate, J @ rate)), q, w, duration)
        yield crosscheck.flow_derivative(data, duration).matrix, wanted, 1e-4


# --- turns, long ways, inverse dynamics ---------------------------------------------------------------------------


@value
def a_wheel_that_a_torque_speeds_up():
    data = scene([body("wheel")], [joint("pin", "revolute", "wheel", (0, 1, 0), position=-0.5, velocity=35.0)], 6.0, 7,
                 forces=[{"type": "joint_torque", "joint": "pin", "torque": 0.25}])
    t = np.arange(7.0)
    for name, made in every(data):
        if name != "truth":
            yield made.joints["pin"].position, -0.5 + 35.0 * t + 1.25 * t**2, 1e-6
            yield 0.05 * made.w[:, 0, 1] ** 2, 0.05 * (35.0 + 2.5 * t) ** 2, 1e-6


@value
def a_wheel_on_a_damped_spring_over_many_turns():
    data = scene([body("wheel")], [joint("pin", "revolute", "wheel", (0, 0, 1), position=2.0, velocity=55.0,
                                         stiffness=0.3, damping=0.02, rest_position=1.0)], 8.0, 9)
    A = np.array([[0.0, 1.0], [-3.0, -0.2]])
    wanted = np.array([1.0 + (expm(A * t) @ [1.0, 55.0])[0] for t in data.t])
    for name, made in every(data):
        if name != "truth":
            yield made.joints["pin"].position, wanted, 1e-3 if name != "lieeuler" else 1e-7


@value
def what_two_wound_springs_need():
    data = scene([body("a"), body("b")], [
        joint("ja", "revolute", "a", position=0.0, velocity=0.0, stiffness=2.0, rest_position=0.5),
        joint("jb", "revolute", "b", parent="a", position=0.0, velocity=0.0, stiffness=3.0, rest_position=-1.0,
              damping=0.1)])
    q, v = np.array([[9.0, -14.0], [-33.0, 21.0]]), np.array([[0.0, 2.0], [0.0, -1.0]])
    for engine in ("truth", "pinocchio", "mujoco"):
        yield crosscheck.inverse_dynamics(data, q, v, np.zeros((2, 2)), engine=engine), np.stack(
            [2.0 * (q[:, 0] - 0.5), 3.0 * (q[:, 1] + 1.0) + 0.1 * v[:, 1]], 1), 1e-8


@value
def what_a_nut_needs_far_away():
    """Of a hinge that carries a slide along its axis: 70 m and eleven turns on."""
    data = scene([body("arm", 1.0), body("nut", 2.0)], [
        joint("turn", "revolute", "arm", position=0.0, velocity=0.0, stiffness=1.5),
        joint("lift", "prismatic", "nut", parent="arm", position=0.0, velocity=0.0, stiffness=0.2, rest_position=5.0,
              armature=0.3)], gravity=-9.81)
    q, v, a = np.array([[70.0, 70.0]]), np.array([[1.0, -1.0]]), np.array([[2.0, 3.0]])
    for engine in ("truth", "pinocchio", "mujoco"):
        yield crosscheck.inverse_dynamics(data, q, v, a, engine=engine), [
            [1.5 * 70.0 + 0.2 * 2.0, 0.2 * 65.0 + 2.3 * 3.0 + 2.0 * 9.81]], 1e-8


@value
def a_sledge_on_a_soft_spring_far_out():
    """150 m at .1 rad/s."""
    data = scene([body("sledge", 2.0)], [joint("way", "prismatic", "sledge", (0, 1, 0), position=0.0, velocity=15.0,
                                               stiffness=0.02)], 20.0, 11)
    for name, made in every(data):
        x = made.states.x if name == "truth" else made.x
        yield x[:, 0, 1], 150.0 * np.sin(0.1 * data.t), 1e-6


@value
def a_weight_that_falls_far_against_a_damper():
    data = scene([body("weight", 3.0)], [joint("way", "prismatic", "weight", (0, 0, 1), position=2.0, velocity=0.0,
                                               damping=1.5)], 5.0, 6, -9.81)
    wanted = 2.0 - 2 * 9.81 * (data.t - 2 * (1 - np.exp(-data.t / 2)))
    for name, made in every(data):
        x = made.states.x if name == "truth" else made.x
        yield x[:, 0, 2], wanted, 1e-7


# --- held torques, stops ------------------------------------------------------------------------------------------


@value
def a_torque_held_on_a_damped_hinge():
    times, values = [0.0, 0.21, 0.9], [1.5, -2.5, 0.4]
    data = scene([body("disk", 1.0, (0.2, 0.2, 0.4))], [joint("pin", "revolute", "disk", position=0.0, velocity=1.0,
                                                               damping=0.6)], 1.5, 31, forces=[
        {"type": "joint_torque", "joint": "pin", "torque": {"type": "hold", "times": times, "values": values}}])
    A, wanted = np.array([[0.0, 1.0, 0.0], [0.0, -1.5, 2.5], [0.0, 0.0, 0.0]]), []
    for end in data.t:
        y, at = np.array([0.0, 1.0]), 0.0
        for torque, until in zip(values, [*times[1:], np.inf], strict=True):
            until = min(end, until)
            if until > at:
                y, at = (expm(A * (until - at)) @ [*y, torque])[:2], until
        wanted.append(y[0])
    made = crosscheck.run(data, "lieeuler", "rkmk853", rtol=1e-10)
    yield made.joints["pin"].position, wanted, 1e-8
    yield made.verdict().outcome == "pass", True, 0


@value
def a_sampled_servo_on_a_slide():
    """kp 30, kd 4, a constant of 2 N, every 40 ms, on 2 kg."""
    data = scene([body("box", 2.0)], [joint("way", "prismatic", "box", (1, 0, 0), position=0.1, velocity=0.0)], 1.2, 31,
                 forces=[{"type": "servo", "joint": "way", "target": 0.5, "proportional": 30.0, "derivative": 4.0,
                          "feedforward": 2.0, "period": 0.04}])
    q, v, wanted = 0.1, 0.0, []
    for _ in data.t:
        wanted.append(q)
        a = (30.0 * (0.5 - q) - 4.0 * v + 2.0) / 2.0
        q, v = q + 0.04 * v + 0.04**2 / 2 * a, v + 0.04 * a
    made = crosscheck.run(data, "lieeuler", "rkmk853", rtol=1e-10)
    yield made.joints["way"].position, wanted, 1e-8
    yield made.verdict().outcome == "pass", True, 0


def falls(t, restitution):
    """From .5 at 1 m/s^2: its height."""
    end, up, heights = 1.0, restitution, np.where(t < 1.0, 0.5 - t**2 / 2, 0.0)
    while end < t[-1]:
        u = t - end
        heights, end, up = np.where((u >= 0) & (u < 2 * up), up * u - u**2 / 2, heights), end + 2 * up, (
            up * restitution)
    return heights


@value
def two_bounces_beside_one_that_rests_on_the_upper_stop():
    data = scene([body("a"), body("b")], [
        joint("ja", "prismatic", "a", (0, 0, 1), position=0.2, velocity=0.0, limits={"upper": 0.2}),
        joint("jb", "prismatic", "b", (0, 0, 1), place=(0.0, 1.0, 0.0), position=0.5, velocity=0.0,
              limits={"lower": 0.0, "restitution": 0.7})], 3.0, 31, forces=[
        {"type": "joint_force", "joint": "ja", "force": 3.0}, {"type": "joint_force", "joint": "jb", "force": -1.0}])
    reference, wanted = crosscheck.truth(data), falls(data.t, 0.7)
    yield reference.horizon, 3.0, 1e-9
    yield reference.states.x[:, 1, 2], wanted, 1e-8
    for method, how in (("rkmk4", {"step": 1e-3}), ("rkmk853", {"rtol": 1e-10}), ("taylor", {"rtol": 1e-10})):
        made = crosscheck.run(data, "lieeuler", method, **how)
        yield made.joints["jb"].position, wanted, 1e-5
        yield made.joints["ja"].position, 0.2, 1e-12


@value
def two_that_bounce_at_different_times():
    """One from .5 at 1 m/s^2 with .5; one from .32, thus at .8 s, with .6."""
    data = scene([body("a"), body("b")], [
        joint("ja", "prismatic", "a", (1, 0, 0), position=0.5, velocity=0.0, limits={"lower": 0.0, "restitution": 0.5}),
        joint("jb", "prismatic", "b", (1, 0, 0), place=(0.0, 1.0, 0.0), position=0.32, velocity=0.0,
              limits={"lower": 0.0, "restitution": 0.6})], 1.7, 18, -1.0, axis=0)
    u = np.maximum(data.t - 0.8, 0.0)
    second = np.where(data.t < 0.8, 0.32 - data.t**2 / 2, 0.48 * u - u**2 / 2)
    reference = crosscheck.truth(data)
    yield reference.horizon, 1.7, 1e-9
    yield reference.states.x[:, 0, 0], falls(data.t, 0.5), 1e-9
    yield reference.states.x[:, 1, 0], second, 1e-9
    made = crosscheck.run(data, "lieeuler", "rkmk853", rtol=1e-10)
    yield made.joints["jb"].position, second, 1e-6


@value
def a_slide_pressed_on_its_stop_carries_a_hinge_that_hits_its_own():
    """a rests under 4 N; b turns about its own centre by .4 rad at .8 N m on .1 kg m^2: sqrt(.1) s."""
    data = scene([body("a"), body("b")], [
        joint("ja", "prismatic", "a", (1, 0, 0), position=0.3, velocity=0.0, limits={"upper": 0.3, "restitution": 0.0}),
        joint("jb", "revolute", "b", (1, 0, 0), parent="a", position=0.0, velocity=0.0,
              limits={"upper": 0.4, "restitution": 0.5})], 1.0, 21, forces=[
        {"type": "joint_force", "joint": "ja", "force": 4.0}, {"type": "joint_torque", "joint": "jb", "torque": 0.8}])
    found = crosscheck.truth(data).states.x[:, 0, 0]
    yield np.where(np.isfinite(found), found, 0.3), 0.3, 1e-9
    yield np.isfinite(found[:6]).all(), True, 0


@value
def a_weight_that_is_pulled_off_its_stop():
    """It rests at 0 under -2 N until .5 s, then 3 N on 1.5 kg pull it: (t - .5)^2."""
    data = scene([body("a", 1.5)], [joint("ja", "prismatic", "a", (0, 1, 0), position=0.0, velocity=0.0,
                                          limits={"lower": 0.0, "restitution": 0.0})], 1.0, 21, forces=[
        {"type": "joint_force", "joint": "ja", "force": {"type": "hold", "times": [0.0, 0.5], "values": [-2.0, 3.0]}}])
    wanted = np.where(data.t > 0.5, (data.t - 0.5) ** 2, 0.0)
    reference = crosscheck.truth(data)
    found = reference.states.x[:, 0, 1]
    yield np.where(np.isfinite(found), found, wanted[:len(found)]), wanted[:len(found)], 1e-9
    yield np.isfinite(found[:10]).all(), True, 0
    yield crosscheck.run(data, "lieeuler", "rkmk853", rtol=1e-10).joints["ja"].position, wanted, 1e-7


@pytest.mark.parametrize("name", CASES)
def test_commands_are_answered(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    answered(CASES[name])


@pytest.mark.parametrize("name", VALUES)
def test_figures_are_right(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for found, wanted, tolerance in VALUES[name]():
        difference = np.abs(np.asarray(found, float) - np.asarray(wanted, float))
        assert np.all(difference <= tolerance), (found, wanted)
