"""The elements of a compiled MuJoCo model besides its tree: loads and loops for a scene, and what it cannot hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.scene.models.neutral import Reading
from crosscheck.scene.schema import Content as Table

MOST_NAMED = 6
"""Largest number of names of one kind in a message; the rest is counted."""

UNREACHABLE = 1e6
"""rad or m. A URDF that needs no limits writes limits at least this far away."""


def collect(reading: Reading, joints: list[Table]) -> tuple[list[Table], list[Table]]:
    """(further joints, forces); adds what a scene cannot hold to `reading.lost`, and mimics to `joints`."""
    m = reading.model
    _limits(reading)
    media = (("the drag of the medium (option density or viscosity)", m.opt.density or m.opt.viscosity),
             ("flexible bodies", m.nflex), ("plugins", m.nplugin))
    reading.lost += [words for words, there in media if there]
    _contacts(reading)
    _actuators(reading)
    return _equalities(reading, joints), [*_tendons(reading), *_compensation(reading)]


def _off(reading: Reading, flag: str) -> bool:
    import mujoco

    return bool(int(reading.model.opt.disableflags) & getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))


def _named(kind: str, names: list[str]) -> list[str]:
    if not names:
        return []
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return [f"{kind} {', '.join(repr(name) for name in names[:MOST_NAMED])}{more}"]


def _limits(reading: Reading) -> None:
    m = reading.model
    labels = [m.jnt(j).name or f"joint {j}" for j in range(m.njnt)]
    if not _off(reading, "LIMIT"):
        reading.lost += _named("limits of joint", [
            labels[j] for j in range(m.njnt) if m.jnt_limited[j] and np.abs(m.jnt_range[j]).min() < UNREACHABLE])
    if not _off(reading, "FRICTIONLOSS"):
        dry = sorted({int(m.dof_jntid[dof]) for dof in range(m.nv) if m.dof_frictionloss[dof]})
        reading.lost += _named("dry friction of joint", [labels[j] for j in dry])
    for field, flag, owner in (("jnt_stiffnesspoly", "SPRING", None), ("dof_dampingpoly", "DAMPER", "dof_jntid")):
        values = getattr(m, field, None)
        if values is not None and np.any(values) and not _off(reading, flag):
            rows = np.flatnonzero(np.any(np.atleast_2d(values), axis=1))
            which = rows if owner is None else getattr(m, owner)[rows]
            reading.lost += _named(f"nonlinear {'stiffness' if owner is None else 'damping'} of joint",
                                   [labels[int(j)] for j in which])


def _contacts(reading: Reading) -> None:
    """List as lost the pairs of bodies whose geometries MuJoCo would let collide."""
    m = reading.model
    if _off(reading, "CONTACT") or _off(reading, "CONSTRAINT"):
        return
    weld = reading.groups
    parents = weld[m.body_parentid]
    masks: dict[int, set[tuple[int, int]]] = {}
    for g in range(m.ngeom):
        if m.geom_contype[g] or m.geom_conaffinity[g]:
            masks.setdefault(int(m.geom_bodyid[g]), set()).add((int(m.geom_contype[g]), int(m.geom_conaffinity[g])))
    excluded = {(int(code) >> 16, int(code) & 0xFFFF) for code in m.exclude_signature}
    found = []
    for a in sorted(masks):
        for b in sorted(masks):
            wa, wb = int(weld[a]), int(weld[b])
            if a >= b or wa == wb or (a, b) in excluded or (b, a) in excluded:
                continue
            kin = wa and wb and (wa == int(parents[wb]) or wb == int(parents[wa]))
            if kin and not _off(reading, "FILTERPARENT"):
                continue
            if any(ta & cb or tb & ca for ta, ca in masks[a] for tb, cb in masks[b]):
                found.append(f"{_label(m, a)} - {_label(m, b)}")
    found += [f"{_label(m, int(m.geom_bodyid[a]))} - {_label(m, int(m.geom_bodyid[b]))}"
              for a, b in zip(m.pair_geom1, m.pair_geom2, strict=True)]
    reading.lost += _named("contacts of the colliding bodies", list(dict.fromkeys(found)))


def _label(m: Any, body: int) -> str:
    return str(m.body(body).name or f"body {body}") if body else "ground"


def _actuators(reading: Reading) -> None:
    """List as lost the actuators that act at the state's control; a motor with zero control does nothing."""
    import mujoco

    m, d = reading.model, reading.data
    if _off(reading, "ACTUATION"):
        return
    acting = []
    for a in range(m.nu):
        fixed = m.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
        idle = fixed and (m.actuator_gainprm[a, 0] == 0 or (d.ctrl[a] == 0 and m.actuator_actadr[a] < 0))
        biased = m.actuator_biastype[a] != mujoco.mjtBias.mjBIAS_NONE and np.any(m.actuator_biasprm[a])
        passive = any(np.any(getattr(m, field)[a]) for field in ("actuator_damping", "actuator_dampingpoly",
                                                                 "actuator_armature") if hasattr(m, field))
        if not idle or biased or passive:
            acting.append(m.actuator(a).name or f"actuator {a}")
    reading.lost += _named("actuator", acting)


def _tendons(reading: Reading) -> list[Table]:
    """Tendons between two sites as linear springs; other tendons that exert forces are listed as lost."""
    import mujoco

    m, d = reading.model, reading.data
    made: list[Table] = []
    lost = []
    for t in range(m.ntendon):
        k, c = float(m.tendon_stiffness[t]), float(m.tendon_damping[t])
        k, c = (0.0 if _off(reading, "SPRING") else k), (0.0 if _off(reading, "DAMPER") else c)
        hard = (m.tendon_limited[t] and not _off(reading, "LIMIT")) or m.tendon_frictionloss[t] or (
            hasattr(m, "tendon_armature") and m.tendon_armature[t])
        bent = any(np.any(getattr(m, field)[t]) for field in ("tendon_stiffnesspoly", "tendon_dampingpoly")
                   if hasattr(m, field))
        if not (k or c or hard or bent):
            continue
        wraps = range(int(m.tendon_adr[t]), int(m.tendon_adr[t]) + int(m.tendon_num[t]))
        sites = [int(m.wrap_objid[each]) for each in wraps if m.wrap_type[each] == mujoco.mjtWrap.mjWRAP_SITE]
        low, high = m.tendon_lengthspring[t]
        if hard or bent or len(sites) != 2 or len(wraps) != 2 or (k and low != high):
            lost.append(m.tendon(t).name or f"tendon {t}")
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
    reading.lost += _named("tendon", lost)
    return made


def _compensation(reading: Reading) -> list[Table]:
    """MuJoCo's gravity compensation of bodies as constant forces."""
    m, d = reading.model, reading.data
    if _off(reading, "GRAVITY"):
        return []
    made = []
    for body in np.flatnonzero(m.body_gravcomp):
        group = int(reading.groups[body])
        if group:
            name, point = reading.end(group, d.xipos[body])
            made.append({"type": "constant_force", "child": name, "child_point": point, "frame": "world",
                         "force": (-m.body_gravcomp[body] * m.body_mass[body] * m.opt.gravity).tolist()})
    return made


def coupled_joints(m: Any) -> list[tuple[int, int, float, float]]:
    """(follower, leader, ratio, offset) of the equalities between two joints that are linear and active."""
    import mujoco

    found = []
    for e in np.flatnonzero((m.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (m.eq_active0 != 0) & (m.eq_obj2id >= 0)):
        if not np.any(m.eq_data[e, 2:5]):
            follower, leader = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            zero = [float(m.qpos0[m.jnt_qposadr[j]]) for j in (follower, leader)]
            offset, ratio = (float(value) for value in m.eq_data[e, :2])
            found.append((follower, leader, ratio, offset + zero[0] - ratio * zero[1]))
    return found


def _equalities(reading: Reading, joints: list[Table]) -> list[Table]:
    """Connect and weld constraints as joints, coupled joint coordinates as mimics."""
    import mujoco

    m, d = reading.model, reading.data
    made: list[Table] = []
    if _off(reading, "EQUALITY") or _off(reading, "CONSTRAINT"):
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
                reading.lost.append(f"equality {name!r} of joint {labels[0]!r}")
                continue
            ratio, offset = coupled[follower, motor]
            known[labels[0]]["mimic"] = {"joint": labels[1], "ratio": ratio, "offset": offset}
        else:
            reading.lost.append(f"equality {name!r}")
    return made


def _closed(reading: Reading, e: int, name: str, kind: str) -> Table | None:
    import mujoco

    m, d = reading.model, reading.data
    ids = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
    if m.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
        groups = [int(reading.groups[m.site_bodyid[site]]) for site in ids]
        points = [d.site_xpos[site] for site in ids]
    else:
        groups = [int(reading.groups[body]) for body in ids]
        local = m.eq_data[e]
        offsets = (local[0:3], local[3:6]) if kind == "spherical" else (
            local[3:6] + d.xmat[ids[0]].reshape(3, 3).T @ d.xmat[ids[1]].reshape(3, 3) @ local[0:3], local[0:3])
        points = [d.xpos[body] + d.xmat[body].reshape(3, 3) @ offset for body, offset in zip(ids, offsets, strict=True)]
    if groups[0] == groups[1]:
        return None
    if groups[1] == 0:
        groups, points = groups[::-1], points[::-1]
    (parent, near), (child, far) = (reading.end(*each) for each in zip(groups, points, strict=True))
    return {"name": name, "type": kind, "parent": parent, "child": child, "parent_anchor": near, "child_anchor": far}
