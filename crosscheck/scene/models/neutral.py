"""Turns a compiled MuJoCo model in one state into the tables of a scene file.

Bodies welded together become one body, with the name and the axes of the one that carries the joints, at their common
centre of mass. The parent of a joint is the parent body in the model.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.scene.coordinates import turned
from crosscheck.scene.model import LeftOut, quaternion_from_rotation
from crosscheck.scene.vectors import cross, welded

if TYPE_CHECKING:
    import mujoco

if TYPE_CHECKING:  # the schema needs msgspec, which the environment of an engine version does not have
    from crosscheck.scene.schema import Content as Table

ALIGNED = 1e-9
"""Sine of the angle, and relative distance, below which axes count as parallel and points as one."""

@dataclasses.dataclass
class Rigid:
    """A group of welded bodies with its total mass, centre of mass, inertia and motion."""

    index: int  # MuJoCo's index of the body with the joints
    name: str
    mass: float
    centre: np.ndarray  # (3,) world
    inertia: np.ndarray  # (3, 3) about the centre, axes of the body
    R: np.ndarray  # (3, 3) axes of the body to world
    v: np.ndarray  # (3,) of the centre, world
    w: np.ndarray  # (3,) world
    origin: np.ndarray  # (3,) of its frame, world


@dataclasses.dataclass
class Reading:
    """A model in one state, and what a scene cannot hold of it."""

    model: mujoco.MjModel
    data: mujoco.MjData
    bodies: dict[int, Rigid]
    lost: list[LeftOut]  # can be left out, but would change the motion
    impossible: list[str]  # cannot be left out
    noted: list[LeftOut] = dataclasses.field(default_factory=list)  # read otherwise than it is written, which is told
    frames: list[Table] = dataclasses.field(default_factory=list)  # bodies between several joints of one body
    chained: dict[int, Table] = dataclasses.field(default_factory=dict)  # these joints by their number in the model
    urdf: bool = False  # whose shapes may overlap where links are joined, and no engine looks there

    @functools.cached_property
    def groups(self) -> np.ndarray:
        """(nbody,) the group of each body of the model, see `grouped`."""
        return grouped(self.model)

    def end(self, group: int, point: np.ndarray) -> tuple[str, list[float]]:
        """(name, anchor in its frame) of a point in the world on a group of bodies; 0 is the ground."""
        if group == 0:
            return "ground", point.tolist()
        body = self.bodies[group]
        return body.name, (body.R.T @ (point - body.centre)).tolist()

    def direction(self, group: int, vector: np.ndarray) -> list[float]:
        """A world vector in the frame of a group."""
        return [float(part) for part in (vector if group == 0 else self.bodies[group].R.T @ vector)]

    def attitude(self, group: int) -> np.ndarray:
        """(3, 3) attitude of a group."""
        return np.eye(3) if group == 0 else self.bodies[group].R


def grouped(model: mujoco.MjModel) -> np.ndarray:
    """(nbody,) the first body of the group that a body is welded to; 0 is the ground, also of mocap bodies."""
    groups: np.ndarray = model.body_weldid.copy()
    groups[model.body_mocapid[groups] >= 0] = 0
    return groups


def off(model: mujoco.MjModel, *flags: str) -> bool:
    """Whether a compiled model disables one of these."""
    import mujoco

    return any(int(model.opt.disableflags) & getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}") for flag in flags)


def label(model: mujoco.MjModel, j: int) -> str:
    """The name of a joint of the model."""
    return str(model.jnt(j).name or f"joint {j}")


def body_label(model: mujoco.MjModel, body: int) -> str:
    """The name of a body of the model."""
    return str(model.body(body).name or f"body {body}") if body else "ground"


def joints_of(model: mujoco.MjModel, body: int) -> list[int]:
    """The joints of a body of the model."""
    return [*range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])]


def gravity(model: mujoco.MjModel) -> np.ndarray:
    """(3,) the gravity of a compiled model, m/s^2; zero if its flag disables it."""
    return np.zeros(3) if off(model, "GRAVITY") else np.array(model.opt.gravity)


def bodies(model: mujoco.MjModel, data: mujoco.MjData) -> dict[int, Rigid]:
    """The moving groups of welded bodies by the index of their first body, parents before children."""
    import mujoco

    rigid, groups = {}, grouped(model)
    for first in sorted(set(groups.tolist()) - {0}):
        members = np.flatnonzero(groups == first)
        axes = data.ximat[members].reshape(-1, 3, 3)
        mass, centre, inertia = welded(model.body_mass[members], data.xipos[members],
                                       (axes * model.body_inertia[members][:, None]) @ np.swapaxes(axes, 1, 2))
        centre = centre if mass > 0 else data.xpos[first].copy()
        R = data.xmat[first].reshape(3, 3).copy()
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, first, twist, 0)
        v = twist[3:] + cross(twist[:3], centre - data.xpos[first])
        local = R.T @ inertia @ R
        rigid[first] = Rigid(first, body_label(model, first), mass, centre, (local + local.T) / 2, R, v,
                             twist[:3].copy(), data.xpos[first].copy())
    return rigid


def body_table(body: Rigid) -> Table:
    """One of [[bodies]]."""
    origin = body.R.T @ (body.origin - body.centre)
    return {"name": body.name, "mass": body.mass, "inertia": body.inertia.tolist(),
            "attitude": quaternion_from_rotation(body.R).tolist(), "angular_velocity": (body.R.T @ body.w).tolist(),
            "position": body.centre.tolist(), "velocity": body.v.tolist()} | (
                {"origin": origin.tolist()} if np.linalg.norm(origin) > 1e-12 else {})


def joint_tables(reading: Reading) -> list[Table]:
    """One of [[joints]] for every body that is not free, or several with frames without mass between them."""
    tables: list[Table] = []
    for group in reading.bodies:
        ids = joints_of(reading.model, group)
        if _is_free(reading, group, ids):
            _plain(reading, ids, "a free body")
        elif table := _alone(reading, group, ids):
            tables.append(table)
        else:
            tables += _in_series(reading, group, ids)
    return tables


def _in_series(reading: Reading, group: int, ids: list[int]) -> list[Table]:
    """Joints with one coordinate each, a ball last, and frames between them with the axes of the last body."""
    m, d, body = reading.model, reading.data, reading.bodies[group]
    if any(m.jnt_type[j] == 1 for j in ids[:-1]):
        reading.impossible.append(f"the joints of body {body.name!r} are none of a scene: its ball is not the last")
        return []
    parent = int(reading.groups[m.body_parentid[group]])
    made: list[Table] = []
    inner, centre, R = "", np.zeros(3), body.R
    for k, j in enumerate(ids):
        axis, at = d.xaxis[j], d.xanchor[j]
        back = float(d.qpos[m.jnt_qposadr[j]]) * axis if m.jnt_type[j] == 2 else np.zeros(3)
        name = m.jnt(j).name or f"{body.name} joint {k + 1}"
        start, near = reading.end(parent, at - back) if k == 0 else (inner, (R.T @ (at - back - centre)).tolist())
        if k < len(ids) - 1:
            inner, centre, far = f"{body.name} after {name}", at, [0.0, 0.0, 0.0]
            reading.frames.append({"name": inner, "mass": 0.0, "inertia": [[0.0] * 3] * 3})
        else:
            inner, far = reading.end(group, at)
        table: Table = {"name": name, "type": {1: "spherical", 2: "prismatic", 3: "revolute"}[int(m.jnt_type[j])],
                        "parent": start, "child": inner, "parent_anchor": near, "child_anchor": far}
        if table["type"] == "spherical":
            _plain(reading, [j], "a chain")
        else:
            table |= {"parent_axis": reading.direction(parent if k == 0 else group, axis),
                      "child_axis": reading.direction(group, axis)}
            table |= _one(reading, parent if k == 0 else group, group, j)
            reading.chained[j] = table
        made.append(table)
    return made


def _alone(reading: Reading, group: int, ids: list[int]) -> Table | None:
    """The joint that stands for all joints of a group that is not free; None if nothing fits."""
    m, d, first = reading.model, reading.data, ids[0]
    kinds = "".join("fbsh"[m.jnt_type[j]] for j in ids)  # free, ball, slide, hinge
    parent = int(reading.groups[m.body_parentid[group]])
    turning, slides = [j for j in ids if m.jnt_type[j] == 3], [j for j in ids if m.jnt_type[j] == 2]
    axes, anchors, together = d.xaxis, d.xanchor, _meet(d, turning)
    name = next((m.jnt(j).name for j in [*turning, *ids] if m.jnt(j).name), f"{reading.bodies[group].name} joint")

    def table(kind: str, at: np.ndarray, parent_axis: np.ndarray | None = None, child_axis: np.ndarray | None = None,
              back: np.ndarray | None = None) -> Table:
        parent_name, parent_anchor = reading.end(parent, at if back is None else at - back)
        child_name, child_anchor = reading.end(group, at)
        made: Table = {"name": name, "type": kind, "parent": parent_name, "child": child_name,
                       "parent_anchor": parent_anchor, "child_anchor": child_anchor}
        if parent_axis is not None:
            made |= {"parent_axis": reading.direction(parent, parent_axis),
                     "child_axis": reading.direction(group, parent_axis if child_axis is None else child_axis)}
        return made

    if len(ids) > 1 and kinds.strip("b") and _has_coordinates(reading, ids, sorted(kinds) == ["h", "s"]):
        return None  # a spherical, universal or planar joint has no place for springs, a cylindrical one for servos
    if kinds == "b" or (kinds == "hhh" and together and _independent(axes[ids])):
        _plain(reading, ids, "a spherical joint")
        return table("spherical", anchors[ids[0]])
    if kinds == "h":
        return table("revolute", anchors[first], axes[first]) | _one(reading, parent, group, first)
    if kinds == "s":
        travel = float(d.qpos[m.jnt_qposadr[first]])
        return table("prismatic", anchors[first], axes[first], back=travel * axes[first]) | _one(
            reading, parent, group, first)
    if sorted(kinds) == ["h", "s"] and np.linalg.norm(cross(axes[ids[0]], axes[ids[1]])) < ALIGNED:
        (turn,), (slide,) = turning, slides
        back = float(d.qpos[m.jnt_qposadr[slide]]) * axes[slide]
        return table("cylindrical", anchors[turn], axes[turn], back=back) | _pair(reading, parent, group, turn, slide)
    if kinds == "hh" and together and abs(axes[ids[0]] @ axes[ids[1]]) < ALIGNED:
        _plain(reading, ids, "a universal joint")
        return table("universal", anchors[ids[0]], axes[ids[0]], axes[ids[1]])
    if sorted(kinds) == ["h", "s", "s"] and abs(axes[slides[0]] @ axes[slides[1]]) < ALIGNED and all(
            abs(axes[turning[0]] @ axes[j]) < ALIGNED for j in slides):
        _plain(reading, ids, "a planar joint")
        return table("planar", anchors[turning[0]], axes[turning[0]])
    return None


def _has_coordinates(reading: Reading, ids: list[int], is_pair: bool) -> bool:
    """Whether one of the joints has limits, an actuator or, but for a pair, armature, a spring, damping or friction."""
    m = reading.model
    dofs = [int(m.jnt_dofadr[j]) for j in ids]
    moved = set(m.actuator_trnid[np.isin(m.actuator_trntype, (0, 1)), 0].tolist())
    more = [] if is_pair else [m.dof_armature[dofs], m.dof_damping[dofs], m.dof_frictionloss[dofs],
                               m.jnt_stiffness[ids]]
    return bool(moved.intersection(ids) or any(np.any(each) for each in (m.jnt_limited[ids], *more)))


def _meet(d: mujoco.MjData, ids: list[int]) -> bool:
    """Whether the anchors of some joints coincide."""
    size = max(1.0, float(np.abs(d.xanchor).max()))
    return all(np.linalg.norm(d.xanchor[j] - d.xanchor[ids[0]]) < ALIGNED * size for j in ids)


def _is_free(reading: Reading, group: int, ids: list[int]) -> bool:
    """Whether the joints of a group on the ground leave it free, as three slides and then a ball or three hinges do."""
    m, d = reading.model, reading.data
    kinds = [int(m.jnt_type[j]) for j in ids]
    if kinds == [0]:
        return True
    if kinds not in ([2, 2, 2, 1], [2, 2, 2, 3, 3, 3]) or reading.groups[m.body_parentid[group]] != 0:
        return False
    return _independent(d.xaxis[ids[:3]]) and (len(ids) == 4 or (_meet(d, ids[3:]) and _independent(d.xaxis[ids[3:]])))


def _independent(axes: np.ndarray) -> bool:
    """Whether three axes are independent, well away from gimbal lock."""
    return abs(float(np.linalg.det(axes))) > 1e-3


def _dof(reading: Reading, j: int) -> tuple[float, float, float, float]:
    """Armature, damping, stiffness and rest position of a joint with one coordinate; zero if the flags disable them."""
    m = reading.model
    damped, sprung = not off(m, "DAMPER"), not off(m, "SPRING")
    dof, at = int(m.jnt_dofadr[j]), int(m.jnt_qposadr[j])
    return (float(m.dof_armature[dof]), float(m.dof_damping[dof]) if damped else 0.0,
            float(m.jnt_stiffness[j]) if sprung else 0.0, float(m.qpos_spring[at]))


def _one(reading: Reading, parent: int, group: int, j: int) -> Table:
    """Coordinates, reference attitude, springs and armature of a hinge or slide."""
    m, d = reading.model, reading.data
    position, velocity = float(d.qpos[m.jnt_qposadr[j]]), float(d.qvel[m.jnt_dofadr[j]])
    relative = reading.attitude(parent).T @ reading.attitude(group)
    if m.jnt_type[j] == 3:  # a hinge: turn back by its angle
        axis = reading.attitude(parent).T @ d.xaxis[j]
        relative = turned(axis / np.linalg.norm(axis), -position) @ relative
    armature, damping, stiffness, rest = _dof(reading, j)
    made: Table = {"reference_attitude": quaternion_from_rotation(relative).tolist(), "position": position,
                   "velocity": velocity}
    made |= {key: value for key, value in (("armature", armature), ("damping", damping), ("stiffness", stiffness))
             if value}
    return made | ({"rest_position": rest} if stiffness else {})


def _pair(reading: Reading, parent: int, group: int, hinge: int, slide: int) -> Table:
    """The same for a hinge and a slide along its axis, which make one cylindrical joint."""
    m, d = reading.model, reading.data
    made = _one(reading, parent, group, hinge)
    way = 1.0 if d.xaxis[hinge] @ d.xaxis[slide] > 0 else -1.0  # of the slide, along the hinge's axis
    made["position"] = [made["position"], way * float(d.qpos[m.jnt_qposadr[slide]])]
    made["velocity"] = [made["velocity"], way * float(d.qvel[m.jnt_dofadr[slide]])]
    values = np.array([_dof(reading, hinge), _dof(reading, slide)]) * [[1.0] * 4, [1.0, 1.0, 1.0, way]]
    keys = ("armature", "damping", "stiffness", "rest_position")
    sprung = values[:, 2].any()
    return made | {key: values[:, k].tolist() for k, key in enumerate(keys)
                   if values[:, k].any() and (key != "rest_position" or sprung)}


def _plain(reading: Reading, ids: list[int], kind: str) -> None:
    """List as lost the armature, damping and stiffness of joints that become part of another joint."""
    m = reading.model
    for j in ids:
        dofs = range(int(m.jnt_dofadr[j]), int(m.jnt_dofadr[j]) + (6, 3, 1, 1)[int(m.jnt_type[j])])
        values = {"armature": m.dof_armature[dofs], "stiffness": _dof(reading, j)[2:3],
                  "damping": 0.0 * m.dof_damping[dofs] if off(m, "DAMPER") else m.dof_damping[dofs]}
        reading.lost += [LeftOut(label(m, j), f"{key} of joint", (f"which is part of {kind}", *map(float, value)))
                         for key, value in values.items() if np.any(value)]
