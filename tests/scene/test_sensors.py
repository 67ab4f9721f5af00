"""Sensors against Newton's and Euler's equations in this file, which share nothing with either reference.

Rates are derivatives in time of what is measured: central differences of order twelve over thirteen samples. Wrenches
solve the balance of momentum of every body, with six unknowns a joint.
"""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from crosscheck.references.maximal import Maximal
from crosscheck.references.taylor import Taylor
from crosscheck.scene.building import scene_from
from crosscheck.scene.file import read_scene
from crosscheck.scene.sensors import DERIVED, OWN, SENSOR_TYPES, Readings, readings
from crosscheck.scene.states import States

H, REACH, MIDDLE = 0.004, 12, 6  # s between samples; samples; the one at which sensors are compared
SCENES = ("double_pendulum", "driven_double_pendulum", "geared_arm", "cylindrical_pendulum", "universal_pendulum",
          "branching_tree", "four_bar", "rolling_disk", "driven_slider_crank", "prismatic_slider")
LOOPS = ("four_bar", "rolling_disk", "driven_slider_crank")  # nothing works on the free motions of their joints
ATTITUDE = [0.8, 0.1, -0.4, 0.3]

# Of the differences: rounding 1e-16 times the largest weight over H is 2e-14 of the size of what is differentiated.
RELATIVE = 1e-10


def watched(name, **changes):
    """A bundled scene with every sensor on every joint, and on its last body, away from its centre."""
    path, data = read_scene(name)
    last = data["bodies"][-1]["name"]
    site = {"site": "tip"}
    sensors = [{"name": f"{kind} {frame}", "type": kind, "frame": frame, **site} for kind, known in SENSOR_TYPES.items()
               for frame in ("site", "world") if known.axes and known.needs == ("site",)]
    sensors.append({"name": "attitude", "type": "attitude", **site})
    for joint in data.get("joints", []):
        turns = joint["type"] in ("revolute", "prismatic", "cylindrical")
        for kind, known in SENSOR_TYPES.items():
            coordinates = joint["type"] not in ("rolling_disk", "fixed", "distance")
            if known.needs == ("joint", "site"):
                sensors += [{"name": f"{kind} {frame} {joint['name']}", "type": kind, "joint": joint["name"],
                             "frame": frame, **site} for frame in ("site", "world")]
            elif known.needs == ("joint",) and coordinates and (turns or kind != "joint_effort"):
                sensors.append({"name": f"{kind} {joint['name']}", "type": kind, "joint": joint["name"]})
    data |= {"schema": 3, "sites": [{"name": "tip", "body": last, "position": [0.1, -0.2, 0.3], "attitude": ATTITUDE},
                                    {"name": "post", "body": "ground", "position": [1.0, 2.0, 3.0]}],
             "sensors": sensors, "duration": REACH * H, "samples": REACH + 1} | changes
    return scene_from(data, path)


def slope(values):
    """The derivative of samples (13, ...) at the middle one."""
    k = np.arange(-MIDDLE, MIDDLE + 1)
    weights = np.linalg.solve(np.vander(k / MIDDLE, increasing=True).T.astype(np.longdouble).astype(float),
                              np.eye(13)[1]) / (MIDDLE * H)
    return np.einsum("k,k...->...", weights, values)


def close(value, wanted, size=1.0):
    np.testing.assert_allclose(value, wanted, rtol=0, atol=RELATIVE * max(1.0, size, np.abs(wanted).max()))


@pytest.fixture(scope="module", params=SCENES)
def measured(request):
    """A scene, its states by the Taylor formulation, and the readings from them."""
    scene = watched(request.param)
    integrator = Taylor(scene)
    states = integrator.states(integrator.run())
    return scene, states, readings(scene, states)


def test_both_formulations_read_the_same(measured):
    scene, _, read = measured
    other = readings(scene, Maximal(scene).run())
    assert set(other.not_unique) == set(read.not_unique)
    for name, values in read.items():
        size = max(1.0, np.abs(values[np.isfinite(values)]).max(initial=0.0))
        if name == "attitude":  # a half turn has two quaternions
            values = values * np.sign(np.sum(values[0] * other[name][0]))
        np.testing.assert_allclose(values, other[name], rtol=0, atol=1e-11 * size, err_msg=name)


def test_motion_of_a_site(measured):
    scene, states, read = measured
    q = read["attitude"]
    axes = np.array([[1 - 2 * (q[:, 2]**2 + q[:, 3]**2), 2 * (q[:, 1] * q[:, 2] - q[:, 0] * q[:, 3]),
                      2 * (q[:, 1] * q[:, 3] + q[:, 0] * q[:, 2])],
                     [2 * (q[:, 1] * q[:, 2] + q[:, 0] * q[:, 3]), 1 - 2 * (q[:, 1]**2 + q[:, 3]**2),
                      2 * (q[:, 2] * q[:, 3] - q[:, 0] * q[:, 1])],
                     [2 * (q[:, 1] * q[:, 3] - q[:, 0] * q[:, 2]), 2 * (q[:, 2] * q[:, 3] + q[:, 0] * q[:, 1]),
                      1 - 2 * (q[:, 1]**2 + q[:, 2]**2)]]).transpose(2, 0, 1)
    unit = np.array(ATTITUDE) / np.linalg.norm(ATTITUDE)
    hat = np.array([[0, -unit[3], unit[2]], [unit[3], 0, -unit[1]], [-unit[2], unit[1], 0]])
    own = np.eye(3) + 2 * unit[0] * hat + 2 * hat @ hat
    close(axes, states.R[:, -1] @ own)
    place = states.x[:, -1] + states.R[:, -1] @ [0.1, -0.2, 0.3]
    close(read["position world"], place)
    velocity = read["velocity world"]
    close(velocity[MIDDLE], slope(place))
    turning = axes[MIDDLE].T @ slope(axes)
    spin = np.array([turning[2, 1], turning[0, 2], turning[1, 0]])  # site axes
    close(read["gyroscope site"][MIDDLE], spin)
    close(read["acceleration world"][MIDDLE], slope(velocity))
    close(read["angular_acceleration world"][MIDDLE], slope(read["angular_velocity world"]))
    close(read["accelerometer world"], read["acceleration world"] - scene.gravity)
    for sensor in scene.sensors:
        if sensor.frame == "site":
            world = read[sensor.name.replace(" site", " world")]
            turned = np.einsum("tji,tj->ti", axes, world)  # a component that is lost in the world is a part of each
            close(np.nan_to_num(read[sensor.name], nan=1.0), np.nan_to_num(turned, nan=1.0))
    close(read["angular_velocity site"], read["gyroscope site"])


def test_joint_coordinates(measured):
    scene, _, read = measured
    for joint in scene.joints:
        if f"joint_position {joint.name}" not in read:
            continue
        position, rate, second = (read[f"joint_{kind} {joint.name}"] for kind in ("position", "velocity",
                                                                                   "acceleration"))
        if joint.type == "spherical":  # q' = q (0, w) / 2
            q, dq = position[MIDDLE], slope(position)
            w = 2 * (q[0] * dq[1:] - dq[0] * q[1:] - np.cross(q[1:], dq[1:]))
            close(rate[MIDDLE], w)
        else:
            close(rate[MIDDLE], slope(position))
        close(second[MIDDLE], slope(rate))


def balance(scene, states, site):
    """Wrenches (k, 6) of the joints on their children about the site, world axes, and directions that are not known.

    Unknown are a force and a torque about the child's anchor of every joint.
    """
    n, count = scene.n, len(scene.joints)
    x, R = states.x[MIDDLE], states.R[MIDDLE]
    rows, right = np.zeros((6 * n, 6 * count)), np.zeros(6 * n)
    momentum = slope(np.einsum("n,tnk->tnk", scene.masses, states.v))
    spin = slope(np.einsum("tnij,njk,tnk->tni", states.R, scene.inertias, states.w))
    for k in range(n):
        right[6 * k:6 * k + 3] = momentum[k] - scene.masses[k] * scene.gravity
        right[6 * k + 3:6 * k + 6] = spin[k]
    for force in scene.forces:
        if force.type == "linear_spring":
            ends = [np.array(force.parameters[key]) if body < 0 else x[body] + R[body] @ force.parameters[key]
                    for body, key in ((force.parent, "parent_point"), (force.child, "child_point"))]
            series = [np.broadcast_to(force.parameters[key], (13, 3)) if body < 0 else
                      states.x[:, body] + states.R[:, body] @ force.parameters[key]
                      for body, key in ((force.parent, "parent_point"), (force.child, "child_point"))]
            length = np.linalg.norm(series[1] - series[0], axis=1)
            p = force.parameters
            pull = p["stiffness"] * (length[MIDDLE] - p["free_length"]) + p["damping"] * slope(length)
            along = pull * (ends[0] - ends[1]) / length[MIDDLE]
            for body, end, sign in ((force.child, ends[1], 1), (force.parent, ends[0], -1)):
                if body >= 0:
                    right[6 * body:6 * body + 6] -= sign * np.concatenate([along, np.cross(end - x[body], along)])
        elif force.type == "constant_force":
            assert force.parameters["frame"] == "world"
            factor = force.parameters.get("factor", lambda t: 1.0)(states.t[MIDDLE])
            push, arm = factor * np.array(force.parameters["force"]), R[force.child] @ force.parameters["child_point"]
            right[6 * force.child:6 * force.child + 6] -= np.concatenate([push, np.cross(arm, push)])
    conditions = []
    for j, joint in enumerate(scene.joints):
        anchor = x[joint.child] + R[joint.child] @ joint.child_anchor
        for body, sign in ((joint.child, 1.0), (joint.parent, -1.0)):
            if body >= 0:
                at = slice(6 * body, 6 * body + 3), slice(6 * body + 3, 6 * body + 6)
                own = slice(6 * j, 6 * j + 3), slice(6 * j + 3, 6 * j + 6)
                rows[at[0], own[0]] += sign * np.eye(3)
                rows[at[1], own[0]] += sign * np.cross(anchor - x[body], np.eye(3)).T
                rows[at[1], own[1]] += sign * np.eye(3)
        free = np.zeros((0, 6))  # motions of the child that the joint leaves free: no wrench works on them
        axes = [R[joint.child] @ joint.child_axis] if joint.child_axis is not None else []
        if joint.type == "universal":
            axes.append(joint.parent_axis if joint.parent < 0 else R[joint.parent] @ joint.parent_axis)
        if joint.type in ("revolute", "universal") and joint.drive is None:
            free = np.array([[0.0, 0.0, 0.0, *axis] for axis in axes])
        elif joint.type == "spherical":
            free = np.eye(6)[3:]
        elif joint.type == "prismatic":
            free = np.array([[*axes[0], 0.0, 0.0, 0.0]])
        elif joint.type == "rolling_disk":  # no torque about the lowest point of the rim
            axis = R[joint.child] @ joint.child_axis
            down = (joint.parent_axis @ axis) * axis - joint.parent_axis
            arm = joint.radius * down / np.linalg.norm(down)
            free = np.concatenate([-np.cross(arm, np.eye(3)).T, np.eye(3)], axis=1)
        if scene.name in LOOPS:
            line = np.zeros((len(free), 6 * count))
            line[:, 6 * j:6 * j + 6] = free
            conditions.append(line)
    A = np.concatenate([rows, *conditions])
    b = np.concatenate([right, np.zeros(len(A) - len(right))])
    U, sizes, V = np.linalg.svd(A)
    rank = int(np.sum(sizes > 1e-10 * sizes[0]))
    solved = V[:rank].T @ ((U[:, :rank].T @ b) / sizes[:rank])
    assert np.abs(A @ solved - b).max() < 1e-9 * max(1.0, np.abs(b).max())
    shifted = []
    for values in (solved, *V[rank:]):
        parts = values.reshape(count, 6).copy()
        for j, joint in enumerate(scene.joints):
            anchor = x[joint.child] + R[joint.child] @ joint.child_anchor
            parts[j, 3:] += np.cross(anchor - site, parts[j, :3])
        shifted.append(parts)
    return shifted[0], np.array(shifted[1:]).reshape(-1, count, 6)


def test_wrenches(measured):
    scene, states, read = measured
    wanted, idle = balance(scene, states, read["position world"][MIDDLE])
    size = np.abs(wanted).max()
    lost = np.abs(idle).max(axis=0, initial=0.0) > 1e-8
    for j, joint in enumerate(scene.joints):
        for kind, part in (("force", slice(3)), ("torque", slice(3, 6))):
            value = read[f"{kind} world {joint.name}"][MIDDLE]
            assert np.array_equal(np.isnan(value), lost[j, part])
            close(value[~lost[j, part]], wanted[j, part][~lost[j, part]], size)
    assert lost.any() == bool(read.not_unique) == (scene.name == "four_bar")
    if scene.name == "four_bar":  # forces in the plane, and no others, are what everybody measures
        assert np.array_equal(lost.any(axis=0), [False, True, False, True, False, True])


def test_efforts(measured):
    scene, states, read = measured
    site = read["position world"]
    for joint in scene.joints:
        name = f"joint_effort {joint.name}"
        motors = any(force.type.startswith("joint_") and force.joint == joint.name for force in scene.forces)
        if joint.drive is None and not motors:
            if name in read:
                close(read[name], np.zeros(len(states.t)))
            continue
        axis = states.R[:, joint.child] @ joint.child_axis
        anchor = states.x[:, joint.child] + states.R[:, joint.child] @ joint.child_anchor
        force, torque = read[f"force world {joint.name}"], read[f"torque world {joint.name}"]
        about = torque + np.cross(site - anchor, force)
        assert joint.type == "revolute"
        close(read[name], np.einsum("tk,tk->t", about, axis), np.abs(torque).max())


def test_the_same_for_every_engine_and_for_truth():
    scene = watched("double_pendulum")
    truth = crosscheck.truth(scene).sensors
    for engine, method in (("lieeuler", "rkmk853"), ("lieeuler", "DAE1L_LSE"), ("pinocchio", "RKMK4")):
        size = {"rtol": 1e-12} if method == "rkmk853" else {"step": 1e-3}
        made = crosscheck.run(scene, engine, method, **size).sensors
        assert list(made) == list(truth) == [sensor.name for sensor in scene.sensors]
        assert set(made.source.values()) == {DERIVED}
        for name, values in truth.items():
            assert made[name].shape == values.shape
            # DAE1L_LSE is of order 1: 0.1 s at a step of 1e-3
            allowed = (0.05 if method == "DAE1L_LSE" else 1e-8) * max(1.0, np.abs(values).max())
            np.testing.assert_allclose(made[name], values, rtol=0, atol=allowed, err_msg=name)


class Reading:
    """An engine that holds a body still and reads what it is told."""

    name, methods = "reading", ("still",)

    def __init__(self, sensors):
        self.sensors = sensors

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        T, n = scene.samples, scene.n
        return States(scene.t, np.tile(scene.x0, (T, 1, 1)), np.tile(scene.R0, (T, 1, 1, 1)), np.zeros((T, n, 3)),
                      np.zeros((T, n, 3)), sensors=self.sensors)


def test_an_own_engine_may_read_its_own():
    scene = watched("double_pendulum")
    own = np.ones((scene.samples, 3))
    made = crosscheck.run(scene, Reading({"gyroscope site": own.tolist()}), "still", step=H).sensors
    assert isinstance(made, Readings)
    np.testing.assert_array_equal(made["gyroscope site"], own)
    assert made.source["gyroscope site"] == OWN
    assert made.source["accelerometer site"] == f"{DERIVED}, accelerations by the scene's equations"
    assert made.source["position world"].startswith(DERIVED)


@pytest.mark.parametrize(("given", "said"), [
    ({"nothing": [1.0]}, "sensors of the name 'nothing', which the scene has not"),
    ({"gyroscope site": np.ones((2, 3))}, r"shape \(2, 3\), not \(13, 3\)"),
    ({"gyroscope site": "text"}, "something else than real numbers"),
    ({"gyroscope site": np.full((13, 3), np.nan)}, "not finite"),
    (3.0, "sensors of the name '3.0'"),
])
def test_wrong_readings_of_an_own_engine_end_its_run(given, said):
    with pytest.raises(crosscheck.EngineError, match=said):
        crosscheck.run(watched("double_pendulum"), Reading(given), "still", step=H)


@pytest.mark.parametrize(("change", "said"), [
    ({"schema": 2}, "is a key of version 3; write schema = 3"),
    ({"sites": [{"name": "a", "body": "uper"}]}, 'sites[0] "a": body: no body is named "uper"; did you mean "upper"?'),
    ({"sites": [{"name": "a", "body": "upper"}] * 2}, 'sites[1] "a": name: sites[0] has the same name'),
    ({"sites": [{"name": "a", "body": "upper", "attitude": [0.0] * 4}]}, 'sites[0] "a": attitude: all its numbers'),
    ({"sites": [{"name": "a", "body": "upper", "point": [0.0] * 3}]}, 'sites[0] "a": point: unknown key "point"'),
    ({"sensors": [{"name": "s", "type": "accelerometre"}]}, '"accelerometre"; did you mean "accelerometer"'),
    ({"sensors": [{"name": "s", "type": "accelerometer"}]}, 'sensors[0] "s": site: missing, the type accelerometer '
                                                            'needs it; write one of "tip", "post"'),
    ({"sensors": [{"name": "s", "type": "accelerometer", "site": "top"}]}, 'no site is named "top"'),
    ({"sensors": [{"name": "s", "type": "force", "site": "tip"}]}, 'sensors[0] "s": joint: missing, the type force'),
    ({"sensors": [{"name": "s", "type": "joint_velocity", "joint": "elbw"}]}, 'no joint is named "elbw"; did you mean'),
    ({"sensors": [{"name": "s", "type": "joint_effort", "joint": "elbow"}]}, "a spherical joint, which has no drive"),
    ({"sensors": [{"name": "s", "type": "gyroscope", "site": "tip", "joint": "elbow"}]}, "gyroscope has none; remove"),
    ({"sensors": [{"name": "s", "type": "attitude", "site": "tip", "frame": "site"}]}, "attitude has no axes; remove"),
    ({"sensors": [{"name": "s", "type": "velocity", "site": "tip", "frame": "body"}]}, "frame"),
    ({"sensors": [{"name": "s", "type": "velocity", "site": "tip"}] * 2}, 'sensors[0] has the same name'),
])
def test_wrong_entries(change, said):
    with pytest.raises(crosscheck.SceneError) as caught:
        watched("double_pendulum", **change)
    assert said in str(caught.value)


def test_sensors_do_not_change_the_system():
    scene = watched("double_pendulum")
    plain = scene.replace(sites=(), sensors=())
    assert plain.key == scene.key
    assert plain.hash != scene.hash
    assert plain.hash == crosscheck.load_scene("double_pendulum").replace(duration=REACH * H, samples=REACH + 1).hash


def test_a_site_on_the_ground():
    scene = watched("double_pendulum", sensors=[{"name": "still", "type": "accelerometer", "site": "post"},
                                                {"name": "there", "type": "position", "site": "post"}])
    read = readings(scene, Maximal(scene).run())
    np.testing.assert_array_equal(read["still"], np.tile(-scene.gravity, (13, 1)))
    np.testing.assert_array_equal(read["there"], np.tile([1.0, 2.0, 3.0], (13, 1)))


@pytest.mark.parametrize(("name", "of_loads"), [
    ("double_pendulum", 0.0), ("cylindrical_pendulum", 0.0),
    ("driven_double_pendulum", 0.3),  # N; a load on a site is not among the wrenches from which MuJoCo's force follows
])
def test_mujoco_reads_its_own(name, of_loads):
    scene = watched(name)
    truth, made = crosscheck.truth(scene).sensors, crosscheck.run(scene, "mujoco", "RK4", step=1e-3).sensors
    own = [name for name, source in made.source.items() if source == OWN]
    last = scene.joints[-1].name
    assert {"accelerometer site", "gyroscope site", "acceleration world", f"force site {last}",
            f"torque site {last}"} <= set(own)
    for name in own:
        gap = np.linalg.norm(made[name] - truth[name], axis=1)
        if name == "acceleration world":  # its framelinacc is a - g
            np.testing.assert_allclose(gap, 9.81, rtol=1e-9)
        elif name.startswith(("force", "torque")) and of_loads:
            assert gap.max() > of_loads * (name.startswith("force") or 0.3)
        else:
            assert gap.max() < 1e-8
    for name, values in made.items():
        if name not in own:
            np.testing.assert_allclose(values, truth[name], rtol=0, atol=1e-8 * max(1.0, np.abs(values).max()))
