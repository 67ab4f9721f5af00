"""The elements of a compiled MuJoCo model besides its tree: loads and loops for a scene, and what it cannot hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from crosscheck.scene.model import LeftOut, rotation_from_quaternion
from crosscheck.scene.models.neutral import Reading, body_label, joints_of, label, off
from crosscheck.scene.schema import Content as Table

if TYPE_CHECKING:
    import mujoco

MOST_OPEN, ROUNDED = 1e-3, 1e-9
"""rad, and relative to the model's size: a loop that is open by more is not closed by the start of the file; one open
by less than the second is closed up to rounding."""


def collect(reading: Reading, joints: list[Table]) -> tuple[list[Table], list[Table]]:
    """(further joints, forces); adds what a scene cannot hold to `reading.lost`, and mimics to `joints`."""
    m = reading.model
    _nonlinear(reading)
    media = (("the drag of the medium (option density or viscosity)", (float(m.opt.density), float(m.opt.viscosity))),
             ("plugins", (float(m.nplugin),)))
    reading.lost += [LeftOut("", what, values) for what, values in media if any(values)]
    return _equalities(reading, joints), [*_tendons(reading), *_compensation(reading)]


def _nonlinear(reading: Reading) -> None:
    m = reading.model
    for kind, flag, values, joints in (("stiffness", "SPRING", m.jnt_stiffnesspoly, np.arange(m.njnt)),
                                       ("damping", "DAMPER", m.dof_dampingpoly, m.dof_jntid)):
        if not off(m, flag):
            bent = joints[np.any(values.reshape(len(joints), -1), axis=1)].tolist()
            reading.lost += [LeftOut(label(m, j), f"nonlinear {kind} of joint", tuple(
                values[joints == j].ravel().tolist())) for j in dict.fromkeys(bent)]


def _tendons(reading: Reading) -> list[Table]:
    """Tendons between two sites as linear springs; other tendons that exert forces are listed as lost."""
    import mujoco

    m, d = reading.model, reading.data
    made: list[Table] = []
    for t in range(m.ntendon):
        k, c = float(m.tendon_stiffness[t]), float(m.tendon_damping[t])
        k, c = (0.0 if off(m, "SPRING") else k), (0.0 if off(m, "DAMPER") else c)
        hard = (m.tendon_limited[t] and not off(m, "LIMIT")) or m.tendon_frictionloss[t] or m.tendon_armature[t]
        bent = np.any(m.tendon_stiffnesspoly[t]) or np.any(m.tendon_dampingpoly[t])
        if not (k or c or hard or bent):
            continue
        wraps = range(int(m.tendon_adr[t]), int(m.tendon_adr[t]) + int(m.tendon_num[t]))
        sites = [int(m.wrap_objid[each]) for each in wraps if m.wrap_type[each] == mujoco.mjtWrap.mjWRAP_SITE]
        low, high = m.tendon_lengthspring[t]
        if hard or bent or len(sites) != 2 or len(wraps) != 2 or (k and low != high):
            reading.lost.append(LeftOut(m.tendon(t).name or f"tendon {t}", "tendon", (
                k, c, *map(float, (low, high, *m.tendon_range[t], m.tendon_frictionloss[t], m.tendon_armature[t])))))
            continue
        groups = [int(reading.groups[m.site_bodyid[site]]) for site in sites]
        if groups[1] == 0:
            groups, sites = groups[::-1], sites[::-1]
        if groups[0] == groups[1]:
            continue
        (parent, near), (child, far) = (reading.end(group, d.site_xpos[site])
                                        for group, site in zip(groups, sites, strict=True))
        made.append({"type": "linear_spring", "parent": parent, "child": child, "parent_point": near,
                     "child_point": far, "stiffness": k, "free_length": float(low) if k else 0.0, "damping": c})
    return made


def _compensation(reading: Reading) -> list[Table]:
    """MuJoCo's gravity compensation of bodies as constant forces."""
    m, d = reading.model, reading.data
    if off(m, "GRAVITY"):
        return []
    made = []
    idle = m.nactuator == 0 or off(m, "ACTUATION")  # MuJoCo then leaves out what actuators should compensate
    for body in np.flatnonzero(m.body_gravcomp):
        group, above, carried = int(reading.groups[body]), int(body), set()
        while above:
            carried |= {bool(m.jnt_actgravcomp[j]) for j in joints_of(m, above)}
            above = int(m.body_parentid[above])
        if not group or (idle and carried == {True}):
            continue
        if True in carried and (idle or np.any(m.jnt_actfrclimited & m.jnt_actgravcomp)):
            reading.lost.append(LeftOut(body_label(m, int(body)), "gravity compensation by actuators of body",
                                        float(m.body_gravcomp[body])))
            continue
        name, point = reading.end(group, d.xipos[body])
        made.append({"type": "constant_force", "child": name, "child_point": point, "frame": "world",
                     "force": (-m.body_gravcomp[body] * m.body_mass[body] * m.opt.gravity).tolist()})
    return made


def coupled_joints(m: mujoco.MjModel) -> list[tuple[int, int, float, float]]:
    """(follower, leader, ratio, offset) of the equalities between two joints that are linear and active."""
    import mujoco

    couples = []
    for e in np.flatnonzero((m.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (m.eq_active0 != 0) & (m.eq_obj2id >= 0)):
        if not np.any(m.eq_data[e, 2:5]):
            follower, leader = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            zero = [float(m.qpos0[m.jnt_qposadr[j]]) for j in (follower, leader)]
            offset, ratio = (float(value) for value in m.eq_data[e, :2])
            couples.append((follower, leader, ratio, offset + zero[0] - ratio * zero[1]))
    return couples


def _equalities(reading: Reading, joints: list[Table]) -> list[Table]:
    """Connect and weld constraints as joints, coupled joint coordinates as mimics."""
    import mujoco

    m, d = reading.model, reading.data
    made: list[Table] = []
    if off(m, "EQUALITY", "CONSTRAINT"):
        return made
    kinds = mujoco.mjtEq
    for e in range(m.neq):
        if not d.eq_active[e]:
            continue
        name = m.equality(e).name or f"equality {e}"
        kind = kinds(m.eq_type[e])
        if kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            table = _closed(reading, e, name, "spherical" if kind == kinds.mjEQ_CONNECT else "fixed")
            made += [table] if table else []
        elif kind == kinds.mjEQ_JOINT:
            follower, motor = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            labels = [m.jnt(j).name for j in (follower, motor) if j >= 0]
            known = {table["name"]: table for table in reversed(joints) if table["name"] and "position" in table}
            coupled = {each[:2]: each[2:] for each in coupled_joints(m)}
            if not known.keys() >= set(labels) or (follower, motor) not in coupled:
                reading.lost.append(LeftOut(name, "equality", f"of joint {labels[0]!r}"))
                continue
            ratio, offset = coupled[follower, motor]
            known[labels[0]]["mimic"] = {"joint": labels[1], "ratio": ratio, "offset": offset}
        else:
            reading.lost.append(LeftOut(name, "equality", tuple(m.eq_data[e].tolist())))
    return made


def _closed(reading: Reading, e: int, name: str, kind: str) -> Table | None:
    """The joint of a connect or weld; None if it joins nothing, or is open at the start and listed as lost."""
    m, d = reading.model, reading.data
    ends, turn = closure_ends(m, d, e)
    groups = [int(reading.groups[body]) for body, _ in ends]
    points = [d.xpos[body] + d.xmat[body].reshape(3, 3) @ offset for body, offset in ends]
    if groups[0] == groups[1]:
        return None
    size = max(1.0, float(np.abs(d.xpos).max()))
    gap, angle = float(np.linalg.norm(points[0] - points[1])), turned_by(m, d, ends, turn) if kind == "fixed" else 0.0
    if gap > MOST_OPEN * size or angle > MOST_OPEN:
        words = f"{gap:.3g} m" + (f" and {np.degrees(angle):.3g} degrees" if angle else "")
        reading.lost.append(LeftOut(name, "equality", f"which is open by {words} at the start"))
        return None
    if gap > ROUNDED * size:
        reading.noted.append(LeftOut(name, "equality", f"which is taken as closed where it is open by {gap:.3g} m"))
    if groups[1] == 0:
        groups, points = groups[::-1], points[::-1]
    (parent, near), (child, far) = (reading.end(group, points[0]) for group in groups)
    return {"name": name, "type": kind, "parent": parent, "child": child, "parent_anchor": near, "child_anchor": far}


def closure_ends(m: mujoco.MjModel, d: mujoco.MjData, e: int) -> tuple[list[tuple[int, np.ndarray]], np.ndarray]:
    """((body, point in its frame) of both ends of a connect or weld, attitude of the second body in the first).

    The attitude counts for a weld. Sites coincide; between bodies, MuJoCo keeps the anchors of both, and for a weld the
    relative attitude, in `eq_data`.
    """
    import mujoco

    ids, data = (int(m.eq_obj1id[e]), int(m.eq_obj2id[e])), m.eq_data[e]
    if m.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
        axes = [rotation_from_quaternion(m.site_quat[site]) for site in ids]
        return [(int(m.site_bodyid[site]), m.site_pos[site].copy()) for site in ids], axes[0] @ axes[1].T
    if m.eq_type[e] == mujoco.mjtEq.mjEQ_CONNECT:
        return [(ids[0], data[0:3].copy()), (ids[1], data[3:6].copy())], np.eye(3)
    return [(ids[0], data[3:6].copy()), (ids[1], data[0:3].copy())], rotation_from_quaternion(data[6:10])


def turned_by(m: mujoco.MjModel, d: mujoco.MjData, ends: list[tuple[int, np.ndarray]], turn: np.ndarray) -> float:
    """Angle, rad, by which the second body is away from its attitude in the first."""
    one, other = (d.xmat[body].reshape(3, 3) for body, _ in ends)
    away = other.T @ one @ turn
    axial = np.array([away[2, 1] - away[1, 2], away[0, 2] - away[2, 0], away[1, 0] - away[0, 1]]) / 2
    return float(np.arctan2(np.linalg.norm(axial), (np.trace(away) - 1) / 2))
