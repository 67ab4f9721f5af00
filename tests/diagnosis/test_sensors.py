"""Sensors read wrongly on purpose: none of them passes, and most are named. Right ones are never accused.

The wrong readings are made by formulas in this file, from the states and the right readings of one run.
"""

import functools

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.compare.apart import largest
from crosscheck.diagnosis import of_sensors
from crosscheck.document import Record, Way, extended
from crosscheck.scene.building import scene_from
from crosscheck.scene.mechanics import index1
from crosscheck.scene.model import rotation_from_quaternion
from crosscheck.scene.sensors import readings
from crosscheck.scene.states import States
from crosscheck.verification import solution
from crosscheck.verification.probe import answer_of
from tests.engines.stepper import Misbuilt
from tests.scene.test_sensors import watched

STEP, COUNT = 3e-3, 40
G = np.array([0.0, 0.0, -9.81])
SITE, TURN = np.array([0.1, -0.2, 0.3]), np.array([0.8, 0.1, -0.4, 0.3]) / np.sqrt(0.9)
SENSORS = ("accelerometer", "gyroscope", "acceleration", "velocity", "attitude", "force", "torque")


def arm(**hinge):
    """Two bodies on hinges that are not parallel, with springs, dampers, rotors and a motor; sensors on the outer."""
    inertia = [[0.05, 0.004, 0.0], [0.004, 0.06, 0.003], [0.0, 0.003, 0.03]]
    bodies = [{"name": name, "mass": mass, "inertia": inertia} for name, mass in (("upper", 2.0), ("lower", 1.2))]
    hinge = hinge or {"stiffness": 3.0, "damping": 0.4, "rest_position": 0.2, "armature": 0.02}
    joints = [
        {"name": "shoulder", "type": "revolute", "parent": "ground", "child": "upper", "parent_anchor": [0.0, 0.0, 1.0],
         "child_anchor": [0.0, 0.1, 0.4], "parent_axis": [0.0, 1.0, 0.0], "child_axis": [0.0, 1.0, 0.0],
         "position": 0.9, "velocity": 2.0} | hinge,
        {"name": "elbow", "type": "revolute", "parent": "upper", "child": "lower", "parent_anchor": [0.1, 0.0, -0.4],
         "child_anchor": [0.0, 0.05, 0.3], "parent_axis": [1.0, 0.0, 0.0], "child_axis": [1.0, 0.0, 0.0],
         "position": -0.7, "velocity": 3.0} | hinge]
    where = {"site": "imu"}
    sensors = [{"name": kind, "type": kind, **where, **({"joint": "elbow"} if kind in ("force", "torque") else {})}
               for kind in SENSORS]
    sensors.append({"name": "place", "type": "position", **where})
    sensors += [{"name": kind, "type": kind, "joint": "elbow"} for kind in (
        "joint_position", "joint_velocity", "joint_acceleration", "joint_effort")]
    return scene_from({
        "schema": 3, "name": "arm", "gravity": G.tolist(), "duration": COUNT * STEP, "samples": COUNT + 1,
        "bodies": bodies, "joints": joints, "sensors": sensors,
        "forces": [{"type": "joint_torque", "joint": "elbow", "torque": {"type": "sine", "terms": [[2.0, 9.0, 0.4]]}}],
        "sites": [{"name": "imu", "body": "lower", "position": SITE.tolist(), "attitude": TURN.tolist()},
                  {"name": "base", "body": "upper", "attitude": [0.6, 0.8, 0.0, 0.0]}]}, "arm.toml")


class Run1:
    """One run of a right engine, its right readings, and what the mutations need of them."""

    def __init__(self):
        self.scene = arm()
        raw = Misbuilt(adapters.get("lieeuler")).run(self.scene, adapters.base.RunSpec("rkmk4", STEP))
        s = raw.states
        a, alpha, _ = index1(self.scene, s.x, s.R, s.v, s.w, t=s.t)
        self.states = States(s.t, s.x, s.R, s.v, s.w, a, alpha)
        self.right = dict(readings(self.scene, self.states))
        self.R, self.w, self.alpha = s.R[:, 1], s.w[:, 1], alpha[:, 1]
        self.axes = self.R @ rotation_from_quaternion(TURN)

    def seen(self, world, axes=None):
        """A world vector in the axes of the site, or in others."""
        return np.einsum("tji,tj->ti", self.axes if axes is None else axes, np.broadcast_to(world, (COUNT + 1, 3)))

    def world(self, name):
        return np.einsum("tij,tj->ti", self.axes, self.right[name])

    def lever(self, vector):
        """A vector (T, 3) in axes of the body, in those of the site."""
        return self.seen(np.einsum("tij,tj->ti", self.R, vector))

    def altered(self, **changes):
        """Readings of the scene with other joints or forces, at the same states."""
        return readings(self.scene.replace(**changes), self.states)


run = functools.cache(Run1)


def late(values, steps=1):
    return np.concatenate([np.repeat(values[:1], steps, axis=0), values[:-steps]])


def filtered(values, share):
    made = values.copy()
    for k in range(1, len(made)):
        made[k] = made[k - 1] + share * (values[k] - made[k - 1])
    return made


def anchor(r):
    return r.states.x[:, 1] + r.R @ np.array([0.0, 0.05, 0.3])


def place(r):
    return r.states.x[:, 1] + r.R @ SITE


def axis(r):
    return r.R @ np.array([1.0, 0.0, 0.0])


ACC, GYR, FOR, TOR, EFF = "accelerometer", "gyroscope", "force", "torque", "joint_effort"
CORIOLIS = "Coriolis or centripetal term"
WRONG = {  # name: (sensor, wrong readings of a run, the cause to be named; "" if any answer but silence will do)
    "no gravity": (ACC, lambda r, z: z + r.seen(G), "gravity"),
    "gravity twice": (ACC, lambda r, z: z - r.seen(G), "gravity"),
    "gravity upwards": (ACC, lambda r, z: z + 2 * r.seen(G), "gravity"),
    "world axes": (ACC, lambda r, z: r.world(ACC), "world for site axes"),
    "body axes": (ACC, lambda r, z: r.seen(r.world(ACC), r.R), "frame of the body"),
    "axes of the other body": (ACC, lambda r, z: r.seen(r.world(ACC), r.states.R[:, 0]), "frame of another body"),
    "sign": (ACC, lambda r, z: -z, "sign"),
    "no lever": (ACC, lambda r, z: r.seen(r.states.a[:, 1] - G), "lever"),
    "lever reversed": (ACC, lambda r, z: 2 * r.seen(r.states.a[:, 1] - G) - z, "lever"),
    "no centripetal term": (ACC, lambda r, z: z - r.lever(np.cross(r.w, np.cross(r.w, SITE))), CORIOLIS),
    "centripetal term twice": (ACC, lambda r, z: z + r.lever(np.cross(r.w, np.cross(r.w, SITE))), CORIOLIS),
    "no tangential term": (ACC, lambda r, z: z - r.lever(np.cross(r.alpha, SITE)), CORIOLIS),
    "derivative in body axes": (ACC, lambda r, z: z - r.seen(np.cross(
        np.einsum("tij,tj->ti", r.R, r.w), r.right["velocity"])), CORIOLIS),
    "one step late": (ACC, lambda r, z: late(z), "one step late"),
    "two steps late": (ACC, lambda r, z: late(z, 2), "late"),
    "half a step late": (ACC, lambda r, z: (z + late(z)) / 2, ""),
    "before the constraint solve": (ACC, lambda r, z: r.seen(_free(r)), "before the constraint solve"),
    "low-pass filter": (ACC, lambda r, z: filtered(z, 0.3), "filtered"),
    "mean of four": (ACC, lambda r, z: sum(late(z, k) if k else z for k in range(4)) / 4, "filtered"),
    "components": (ACC, lambda r, z: z[:, [1, 0, 2]], "order of components"),
    "in g": (ACC, lambda r, z: z / 9.81, "gear"),
    "noise": (ACC, lambda r, z: z + 1e-3 * np.random.default_rng(0).normal(size=z.shape), ""),
    "gyro in world axes": (GYR, lambda r, z: r.world(GYR), "world for site axes"),
    "gyro sign": (GYR, lambda r, z: -z, "sign"),
    "gyro late": (GYR, lambda r, z: late(z), "one step late"),
    "gyro relative": (GYR, lambda r, z: z - r.seen(np.einsum("tij,tj->ti", r.states.R[:, 0], r.states.w[:, 0])),
                      "relative to another body"),
    "gyro in degrees": (GYR, lambda r, z: np.degrees(z), "unit"),
    "gyro of the other body": (GYR, lambda r, z: r.seen(np.einsum("tij,tj->ti", r.states.R[:, 0], r.states.w[:, 0])),
                               ""),
    "gyro bias": (GYR, lambda r, z: z + np.array([0.01, 0.0, -0.02]), "offset"),
    "gyro clamped": (GYR, lambda r, z: np.clip(z, -1.0, 1.0), "clamp"),
    "a - g": ("acceleration", lambda r, z: z - G, "gravity"),
    "velocity of the centre": ("velocity", lambda r, z: r.states.v[:, 1], "lever"),
    "inverse attitude": ("attitude", lambda r, z: z * [1, -1, -1, -1], "inverse rotation"),
    "scalar last": ("attitude", lambda r, z: z[:, [1, 2, 3, 0]], "order of components"),
    "attitude late": ("attitude", lambda r, z: late(z), "one step late"),
    "force on the parent": (FOR, lambda r, z: -z, "force on the parent"),
    "force in world axes": (FOR, lambda r, z: r.world(FOR), "world for site axes"),
    "force in the parent's axes": (FOR, lambda r, z: r.seen(r.world(FOR), r.states.R[:, 0]), "frame of another body"),
    "force without weight": (FOR, lambda r, z: z + r.seen(1.2 * G), "gravity"),
    "force before the solve": (FOR, lambda r, z: 0.0 * z, "before the constraint solve"),
    "torque about the anchor": (TOR, lambda r, z: z + r.seen(np.cross(place(r) - anchor(r), r.world(FOR))), "lever"),
    "torque about the centre": (TOR, lambda r, z: z + r.seen(np.cross(place(r) - r.states.x[:, 1], r.world(FOR))),
                                "lever"),
    "torque without springs": (TOR, lambda r, z: z - r.seen(axis(r) * _springs(r)[:, None]),
                               "springs or drives not counted"),
    "torque without the motor": (TOR, lambda r, z: z - r.seen(axis(r) * r.right[EFF][:, None]),
                                 "springs or drives not counted"),
    "torque without the rotor": (TOR, lambda r, z: z + r.seen(axis(r) * 0.02 * r.right["joint_acceleration"][:, None]),
                                 "springs or drives not counted"),
    "torque on the parent, late": (TOR, lambda r, z: -late(z), ""),
    "effort times a gear": (EFF, lambda r, z: 50.0 * z, "gear"),
    "effort with the spring": (EFF, lambda r, z: z + _springs(r), "springs or drives not counted"),
    "angle of the other joint": ("joint_position", lambda r, z: r.altered(sensors=(
        crosscheck.scene.model.Sensor("q", "joint_position", None, "shoulder"),))["q"], "another joint"),
    "angle in degrees": ("joint_position", lambda r, z: np.degrees(z), "unit"),
}


def _free(r):
    """a - g of the site on a body on which gravity, gyroscopic torque and the elbow's spring and motor act alone."""
    scene, w = r.scene, r.w
    torque = -np.cross(w, w @ scene.inertias[1]) + np.array([1.0, 0.0, 0.0]) * (_springs(r) + r.right[EFF])[:, None]
    alpha = torque @ np.linalg.inv(scene.inertias[1])
    return np.einsum("tij,tj->ti", r.R, np.cross(alpha, SITE) + np.cross(w, np.cross(w, SITE)))


def _springs(r):
    return -3.0 * (r.right["joint_position"] - 0.2) - 0.4 * r.right["joint_velocity"]


def missed(r, name, values):
    """How far an engine's own reading is from that of its states, which the verdict compares, over its size."""
    states = States(r.states.t, r.states.x, r.states.R, r.states.v, r.states.w, sensors={name: values})
    rows = answer_of(r.scene, states, COUNT).own
    assert rows.keys() == {f"sensor {name}"}
    return largest(rows[f"sensor {name}"]) / max(1.0, float(np.abs(r.right[name]).max()))


@pytest.mark.parametrize("case", WRONG)
def test_wrong_sensors(case):
    r = run()
    name, wrong, cause = WRONG[case]
    values = wrong(r, r.right[name])
    assert missed(r, name, values) > 1e-5
    sensor = next(each for each in r.scene.sensors if each.name == name)
    left, after, told = of_sensors.named(r.scene, r.states, sensor, values)
    assert left > of_sensors.AGREES
    assert (told.cause if told else "") == cause or not cause
    assert told is None or after < 0.04 * left


RIGHT = {  # readings that look wrong and are not
    "as they are": lambda z: z,
    "rounded in the last digits": lambda z: z * (1 + 1e-12 * np.random.default_rng(0).uniform(-1, 1, z.shape)),
}


@pytest.mark.parametrize("how", RIGHT)
@pytest.mark.parametrize("name", [*SENSORS, "joint_position", "joint_velocity", "joint_acceleration", EFF])
def test_right_sensors(name, how):
    r = run()
    for values in (RIGHT[how](r.right[name]), *([-r.right[name]] if name == "attitude" else [])):
        assert missed(r, name, values) < 1e-11
        sensor = next(each for each in r.scene.sensors if each.name == name)
        assert of_sensors.named(r.scene, r.states, sensor, values)[2] is None


def test_accelerations_of_its_own():
    """Generalised alpha has accelerations that lag behind the state; sensors that read them are right."""
    def report(scene, raw):
        raw.states.sensors = dict(readings(scene, raw.states))
        return raw

    scene = arm()
    with adapters.lent(Misbuilt(adapters.get("exudyn"), (), (report,))) as name:
        traj = crosscheck.run(scene, name, "GeneralizedAlpha", step=STEP)
        asked = extended(Record, Way(name, "GeneralizedAlpha", STEP), scene="arm", version="", documented_order=2)
        found = solution.judge(asked, scene, traj, crosscheck.truth(scene)).findings
    seen = {finding.kind: finding.status for finding in found if "sensor" in finding.kind}
    assert len(seen) >= len(scene.sensors)
    assert "fail" not in seen.values(), seen


def test_explain_names_them():
    """Of an own engine, by the public function, and MuJoCo's `framelinacc`, which is a - g (its issue 1216)."""
    def report(scene, raw):
        states = raw.states
        a, alpha, _ = index1(scene, states.x, states.R, states.v, states.w, t=states.t)
        own = readings(scene, States(states.t, states.x, states.R, states.v, states.w, a, alpha))
        states.sensors = {"accelerometer": own["accelerometer"] * 1.0, "gyroscope": late(own["gyroscope"])}
        return raw

    plain = arm(damping=0.0).replace(forces=())
    answer = crosscheck.explain(plain, Misbuilt(adapters.get("lieeuler"), (), (report,)), "rkmk4", step=STEP)
    assert answer.outcome == "fail"
    assert [(cause.name, "'gyroscope'" in cause.magnitude) for cause in answer.causes] == [("one step late", True)]
    answer = crosscheck.explain(plain, "mujoco", "RK4", step=STEP)
    assert {cause.name for cause in answer.causes} == {"gravity"}
    assert "it is a - g" in answer.sentence


def test_what_mujoco_leaves_out():
    """Its wrenches at a site are those without the loads that act on a site, which are actuators."""
    scene = watched("driven_double_pendulum")
    states = adapters.get("mujoco").run(scene, adapters.base.RunSpec("RK4", 1e-3)).states
    told = {name: of_sensors.named(scene, states, sensor, states.sensors[name])[2] for sensor in scene.sensors
            if (name := sensor.name) in states.sensors}
    assert {name: cause.cause for name, cause in told.items() if cause is not None} == {
        "acceleration world": "gravity", "force site elbow": "loads not counted",
        "torque site elbow": "loads not counted"}


def test_enough_of_them():
    assert len(WRONG) >= 40
    assert sum(bool(cause) for _, _, cause in WRONG.values()) >= 0.8 * len(WRONG)
