"""Sites and sensors of a compiled MuJoCo model, and those of a URDF for Gazebo, as entries of a scene file."""

from __future__ import annotations

from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import LeftOut, quaternion_from_rotation
from crosscheck.scene.models.compiling import finite
from crosscheck.scene.models.neutral import Reading
from crosscheck.scene.models.source import Source
from crosscheck.scene.schema import Content as Table

AT_SITE = {"ACCELEROMETER": "accelerometer", "VELOCIMETER": "velocity", "GYRO": "gyroscope"}
OF_FRAME = {"FRAMEPOS": "position", "FRAMEQUAT": "attitude", "FRAMELINVEL": "velocity",
            "FRAMEANGVEL": "angular_velocity", "FRAMELINACC": "accelerometer", "FRAMEANGACC": "angular_acceleration"}
"""In world axes; the linear acceleration of a frame is minus gravity, as an accelerometer has it."""
OF_JOINT = {"JOINTPOS": "joint_position", "JOINTVEL": "joint_velocity", "BALLQUAT": "joint_position",
            "BALLANGVEL": "joint_velocity", "JOINTACTFRC": "joint_effort"}
OF_WRENCH = {"FORCE": "force", "TORQUE": "torque"}


def find(reading: Reading, joints: list[Table]) -> tuple[list[Table], list[Table]]:
    """(sites, sensors); adds the sensors that have no counterpart to `reading.noted`."""
    import mujoco

    m = reading.model
    sites = {m.site(k).name: _site(reading, m.site(k).name, int(m.site_bodyid[k]), reading.data.site_xpos[k],
                                   reading.data.site_xmat[k]) for k in range(m.nsite)
             if m.site(k).name and _is_there(reading, int(m.site_bodyid[k]))}
    sensors: list[Table] = []
    for k in range(m.nsensor):
        name = m.sensor(k).name or f"sensor {k}"
        kind = mujoco.mjtSensor(int(m.sensor_type[k])).name.removeprefix("mjSENS_")
        entry = _sensor(reading, sites, joints, k, kind)
        if entry is None or m.sensor_cutoff[k] or any(each["name"] == name for each in sensors):
            reading.noted.append(LeftOut(name, "sensor", kind.lower()))
        else:
            sensors.append({"name": name} | entry)
    return list(sites.values()), sensors


def of_gazebo(model: Source, reading: Reading, joints: list[Table]) -> tuple[list[Table], list[Table]]:
    """(sites, sensors) of the <sensor> blocks of a URDF; links are sites then. Others are added to `reading.noted`.

    Raises `ValueError` for a pose that is no six numbers.
    """
    blocks = [(gazebo.get("reference", ""), sensor) for gazebo in model.root.findall("gazebo")
              for sensor in gazebo.findall("sensor")]
    if not blocks:
        return [], []
    m, d = reading.model, reading.data
    bodies = {m.body(k).name: k for k in range(m.nbody)}
    numbers = {name: bodies.get(name, 0) for link in model.root.findall("link") if (name := link.get("name", ""))}
    sites = {name: _site(reading, name, k, d.xpos[k], d.xmat[k]) for name, k in numbers.items()
             if _is_there(reading, k)}
    sensors: list[Table] = []
    for reference, block in blocks:
        name, kind = block.get("name", ""), block.get("type", "")
        place, axes = _posed(block)
        if kind == "imu" and reference in sites and place is not None and name not in sites:
            k = numbers[reference]
            R = d.xmat[k].reshape(3, 3)
            sites[name] = _site(reading, name, k, d.xpos[k] + R @ place, R @ axes)
            sensors += [{"name": f"{name} {each}", "type": each, "site": name}
                        for each in ("accelerometer", "gyroscope")]
            if block.findtext("imu/initial_orientation_as_reference", "true").strip() in ("false", "0"):
                sensors.append({"name": f"{name} attitude", "type": "attitude", "site": name})
            else:
                reading.noted.append(LeftOut(name, "orientation of sensor", "which counts from the start"))
            continue
        child = {joint["name"]: joint["child"] for joint in joints}.get(reference)
        frame = block.findtext("force_torque/frame", "child").strip()
        if kind != "force_torque" or child not in sites or frame != "child":
            reading.noted.append(LeftOut(name, "sensor", kind))
            continue
        sensors += [{"name": f"{name} {each}", "type": each, "joint": reference, "site": child}
                    for each in ("force", "torque")]
        if block.findtext("force_torque/measure_direction", "child_to_parent").strip() != "parent_to_child":
            reading.noted.append(LeftOut(name, "sign of sensor",
                                         "which reads the wrench on the parent: here it is that on the child"))
    return list(sites.values()), sensors


def _posed(block: Element) -> tuple[np.ndarray | None, np.ndarray]:
    """Point and attitude of <pose> in its link; no point if it is in another frame."""
    from scipy.spatial.transform import Rotation

    pose = block.find("pose")
    if pose is None:
        return np.zeros(3), np.eye(3)
    numbers = [finite(pose, word) for word in (pose.text or "").split()]
    if len(numbers) != 6:
        raise ValueError(f"sensor {block.get('name', '')!r}: its pose has {len(numbers)} numbers, not six")
    away = pose.get("relative_to") or pose.get("frame")
    return None if away else np.array(numbers[:3]), Rotation.from_euler("xyz", numbers[3:]).as_matrix()


def _site(reading: Reading, name: str, body: int, place: np.ndarray, axes: np.ndarray) -> Table:
    group = int(reading.groups[body])
    owner, position = reading.end(group, place)
    attitude = reading.attitude(group).T @ axes.reshape(3, 3)
    return {"name": name, "body": owner, "position": position, "attitude": quaternion_from_rotation(attitude).tolist()}


def _sensor(reading: Reading, sites: dict[str, Table], joints: list[Table], k: int, kind: str) -> Table | None:
    """The keys of a sensor without its name, or None."""
    import mujoco

    m = reading.model
    thing, index = int(m.sensor_objtype[k]), int(m.sensor_objid[k])
    if kind in OF_JOINT:
        name = m.jnt(index).name
        read = next((JOINT_TYPES[joint["type"]] for joint in joints if joint["name"] == name), None)
        fits = read is not None and (read.is_ball if kind.startswith("BALL") else read.has_one)
        return {"type": OF_JOINT[kind], "joint": name} if fits else None
    if kind in OF_FRAME and int(m.sensor_reftype[k]) == int(mujoco.mjtObj.mjOBJ_UNKNOWN):
        site = _frame(reading, sites, thing, index)
        axes = {} if kind == "FRAMEQUAT" else {"frame": "world"}
        return None if site is None else {"type": OF_FRAME[kind], "site": site} | axes
    if kind not in AT_SITE and kind not in OF_WRENCH:
        return None
    site = _frame(reading, sites, thing, index)
    if site is None:
        return None
    if kind in AT_SITE:
        return {"type": AT_SITE[kind], "site": site, "frame": "site"}
    carrying = [joint["name"] for joint in joints if joint["child"] == sites[site]["body"]]
    alone = len(carrying) == 1 and _is_root(reading, int(m.site_bodyid[index]))
    return {"type": OF_WRENCH[kind], "joint": carrying[0], "site": site} if alone else None


def _is_there(reading: Reading, body: int) -> bool:
    """Whether the scene has the body, which a massless one may not be."""
    group = int(reading.groups[body])
    return group == 0 or group in reading.bodies


def _is_root(reading: Reading, body: int) -> bool:
    """Whether nothing welds the body to its parent, so that the joint of its group is what carries it."""
    parent = int(reading.model.body_parentid[body])
    return bool(reading.groups[body] != reading.groups[parent])


def _frame(reading: Reading, sites: dict[str, Table], thing: int, index: int) -> str | None:
    """The name of the site at a frame, which is made for bodies; None for other things."""
    import mujoco

    m, d = reading.model, reading.data
    if thing == int(mujoco.mjtObj.mjOBJ_SITE):
        return str(m.site(index).name) if m.site(index).name in sites else None
    frames: dict[int, Any] = {int(mujoco.mjtObj.mjOBJ_XBODY): (d.xpos, d.xmat),
                              int(mujoco.mjtObj.mjOBJ_BODY): (d.xipos, d.ximat)}
    if thing not in frames or not _is_there(reading, index):
        return None
    name = f"{m.body(index).name or f'body {index}'} frame {thing}"
    if name not in sites:
        place, axes = frames[thing]
        sites[name] = _site(reading, name, index, place[index], axes[index])
    return name
