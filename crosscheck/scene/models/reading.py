"""Reads a model file into the tables of a scene file."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, SceneError, unknown
from crosscheck.scene.building import scene_from
from crosscheck.scene.model import ACTS, LeftOut
from crosscheck.scene.models import checking, compiling, features, known, laws, neutral, source, watched
from crosscheck.scene.models.neutral import Reading
from crosscheck.scene.models.source import Source
from crosscheck.scene.models.words import distinct, shortened
from crosscheck.scene.schema import Content as Table

MOST_DRAWS = 200
"""Random starts that are drawn until one is free of touching bodies."""

ROOM = 0.1
"""rad or m. Distance from its limit at which a joint starts whose reference is outside."""

DROPPED = {"actuators": "actuator", "friction": "dry friction of", "limits": "limits of", "contacts": "contacts of"}
"""Options of an import that take "drop", and how `LeftOut.what` of their elements begins."""

AT_START = ("which touch at the start", "which starts beyond them")
"""How the value of contacts and limits begins that act at once, so that a scene without them claims no time."""

MOST_ROOTS = 6
"""Largest number of names in a message."""


def table(path: str | os.PathLike[str], keyframe: str | int | None = None, drop: bool = False, base: str = "fixed",
          qpos: Sequence[float] | None = None, qvel: Sequence[float] | None = None, duration: float = 2.0,
          samples: int = 101, balance: bool = False, root: str | None = None, actuators: str = "keep",
          controls: Mapping[str, Any] | None = None, limits: str = "monitor", contacts: str = "monitor",
          friction: str = "keep", start: str | int = "model",
          within: str | os.PathLike[str] | None = None) -> Table:
    """The content of a scene file, see `crosscheck.import_model`."""
    if base not in ("fixed", "free"):
        raise ArgumentError(unknown("base", base, ("fixed", "free")))
    wants = laws.Wants(actuators, limits, contacts, friction, controls or {})
    if drop:
        wants = laws.Wants("drop", limits, contacts, "drop", controls or {})
    model = source.read(Path(path), within=within)
    if root is not None:
        source.cut(model, root)
    if model.is_urdf and len(tops := source.roots(model)) > 1:
        most = max(tops, key=lambda top: len(source.hanging(model, top)))
        raise SceneError(f"{model.path}: has {len(tops)} roots, {', '.join(map(repr, tops[:MOST_ROOTS]))}; a URDF is "
                         f"one tree: join them by fixed joints, or give --root {most} for a part")
    lost = [each for part in (model, *source.nested(model)) for each in known.unknown(part)]
    held = _urdf_limits(model) if model.is_urdf else []
    lost += [LeftOut(str(link.get("name")), "the inertial of link", "which has no mass")
             for link in model.root.findall("link") if link.find("inertial") is not None
             and link.find("inertial/mass") is None]
    unread = [each for each in lost if model.is_urdf and known.unread(each)]
    m, gone, noted = _compiled(model, base, balance)  # raises with advice if MuJoCo is not installed
    lost += [LeftOut("", words) for words in gone]
    listed = [LeftOut("", words) for words in noted]
    d = _start(model, m, keyframe, qpos, qvel, listed if wants.limits != "drop" else None)
    if start != "model":
        if keyframe is not None or qpos is not None:
            raise ArgumentError("start: a keyframe or qpos says where it starts; leave one of the two out")
        _draw(model, m, d, start, wants)
    wants = laws.controlled(m, d, wants)
    reading = read(model, m, d, gone)
    reading.lost += [each for each in lost if each not in unread] + (held if wants.limits != "drop" else [])
    reading.noted += [*listed, *unread, *(held if wants.limits == "drop" else [])]
    joints = neutral.joint_tables(reading)
    further, forces = features.collect(reading, joints)
    own = laws.find(reading, joints, wants)
    try:
        sites, sensors = watched.of_gazebo(model, reading, joints) if model.is_urdf else watched.find(reading, joints)
    except ValueError as error:
        raise SceneError(f"{model.path}: {error}; correct it there") from None
    if model.is_urdf:
        by_name = {each["name"]: each for each in joints}
        for name, mimic in _mimics(model):
            if name in by_name and mimic["joint"] in by_name:
                by_name[name]["mimic"] = mimic
            else:
                reading.lost.append(LeftOut(name, "mimic of joint", (mimic["joint"], mimic["ratio"], mimic["offset"])))
        _check_against_pinocchio(model, reading, base)
    checking.loops(reading)
    _check_motion(model, reading, wants)
    if reading.impossible:
        raise SceneError(f"{model.path}: cannot be a scene: {'; '.join(map(model.located, reading.impossible))}")
    if reading.lost and not drop:
        words = "; ".join(shortened(dict.fromkeys(reading.lost), model.located))
        some = " ".join(f"--{name} drop" for name, begins in DROPPED.items()
                        if any(each.what.startswith(begins) for each in reading.lost))
        offer = "give --drop (drop=True) to leave all this out"
        if all(each.what.startswith(tuple(DROPPED.values())) for each in reading.lost):
            offer = f"crosscheck convert {some} leaves this out, --drop all actuators, friction, limits and contacts"
        raise SceneError(f"{model.path}: a scene cannot hold {words}; {offer}")
    left_out = [*(each._replace(what=ACTS + each.what) if str(each.value).startswith(AT_START) else each
                  for each in reading.lost), *reading.noted]
    own.motors += _transmitted(model, {each["name"] for each in joints})
    third = own.forces or own.monitors or own.motors or sites or sensors or any(
        {"dry_friction", "limits"} & joint.keys() for joint in joints)
    own.idle += [f"of transmission {each.get('name')!r}" for each in model.root.findall("transmission")]
    idle = [f"motors without a control: {', '.join(own.idle)}"] if own.idle else []
    content: Table = {
        "schema": 3 if third else 2, "name": _name(model),
        "description": "; ".join([f"imported from {Path(path).name}", *(f"left out: {each}" for each in left_out),
                                  *idle]),
        "source": Path(path).name, "tags": ["imported"], "gravity": neutral.gravity(m).tolist(),
        "duration": duration, "samples": samples,
        "left_out": [[each.where, each.what, list(each.value) if isinstance(each.value, tuple) else each.value]
                     for each in left_out],
        "bodies": [*map(neutral.body_table, reading.bodies.values()), *reading.frames],
        "joints": distinct([*joints, *further]), "forces": [*forces, *own.forces], "shapes": own.shapes,
        "monitors": own.monitors, "sites": sites, "sensors": sensors, "motors": own.motors}
    return {key: value for key, value in content.items() if value not in ([], "")}


def _transmitted(model: Source, joints: set[str]) -> list[list[Any]]:
    """The actuators of a URDF's transmissions, see `Motor`; the effort of one times its reduction acts on its joint."""
    made = []
    for each in model.root.findall("transmission"):
        joint, actuator = each.find("joint"), each.find("actuator")
        name = joint.get("name", "") if joint is not None else ""
        if name in joints and actuator is not None and actuator.get("name"):
            with contextlib.suppress(ValueError):  # no number is no gear
                gear = float(actuator.findtext("mechanicalReduction", "1"))
                made += [[actuator.get("name"), name, "effort", gear]] * math.isfinite(gear)
    return made


def _draw(model: Source, m: Any, d: Any, start: str | int, wants: laws.Wants) -> None:
    """A seeded random start in place, inside the limits and, where contacts are watched, free of them."""
    import mujoco

    seed = 0 if start == "random" else start
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ArgumentError(f'start: "model", "random" or a whole number, a seed, is wanted, not {start!r}')
    rng = np.random.default_rng(seed)
    for _ in range(MOST_DRAWS):
        laws.draw(m, d, int(rng.integers(2**31)))
        follow(model, m, d.qpos, d.qvel)
        if wants.contacts == "drop":
            return
        mujoco.mj_kinematics(m, d)
        if laws.clear(read(model, m, d)):
            return
    raise SceneError(f"{model.path}: none of {MOST_DRAWS} random starts is free of touching bodies; give qpos, or "
                     'contacts="drop"')


def _check_motion(model: Source, reading: Reading, wants: laws.Wants) -> None:
    """List as lost that MuJoCo accelerates bodies otherwise than the scene does in seeded states away from the start,
    and as noted what may be rounding."""
    if any(checking.unlike(each.what) for each in reading.lost):
        return
    if len(reading.bodies) + len(reading.frames) > checking.MOST_BODIES:
        reading.noted.append(LeftOut("", "a comparison of accelerations with MuJoCo's",
                                     f"more than {checking.MOST_BODIES} bodies"))
        return
    gaps = []
    for seed in checking.SEEDS:
        d = checking.away(reading, seed)
        there = read(model, reading.model, d)
        joints = neutral.joint_tables(there)
        _, forces = features.collect(there, joints)
        own = laws.find(there, joints, dataclasses.replace(wants, limits="drop", contacts="drop", friction="drop"))
        if there.impossible:
            return
        for joint in joints:
            joint.pop("mimic", None)  # the constraints that MuJoCo solves softly are left out on both sides
        gaps.append(checking.motion(reading, d, scene_from({
            "schema": 3, "name": "away", "gravity": neutral.gravity(reading.model).tolist(), "duration": 1.0,
            "samples": 2, "bodies": [*map(neutral.body_table, there.bodies.values()), *there.frames],
            "joints": distinct(joints), "forces": [*forces, *([] if checking.unactuated(reading) else own.forces)]},
            model.path)))
    gap, relative, name = max(gaps, key=lambda each: (not each[1] <= checking.LOOSEST, each[1]))
    if not relative <= checking.LOOSEST:
        reading.lost.append(LeftOut(name, "something that moves in MuJoCo, and that the reader does not know, body",
                                    f"accelerations differ by {gap:.3g} m/s^2 or rad/s^2"))
    elif relative > checking.TOLD:
        reading.noted.append(LeftOut(name, "that it is ill-conditioned: body", "its acceleration differs from MuJoCo's "
                                     f"by {relative:.1g} of the largest"))


def _compiled(model: Source, base: str, balance: bool) -> tuple[Any, list[str], list[str]]:
    """As `compiling.compiled`; with `balance` inertias that no body has are only replaced where that is needed."""
    if not balance:
        return compiling.compiled(model, base)
    try:
        return compiling.compiled(copy.deepcopy(model), base)
    except SceneError as error:
        m, gone, noted = compiling.compiled(model, base, balance=True)
        words = str(error).partition(": ")[2].partition("; --")[0]
        return m, gone, noted if model.is_urdf else [f"inertias replaced by their mean, {words}"]


def joint_data(model: Source) -> dict[str, dict[str, tuple[float | str, ...]]]:
    """See `crosscheck.scene.models.joint_data`. A range that nothing reaches is none."""
    import mujoco

    m, _, _ = _compiled(model, "fixed", balance=True)
    found: dict[str, dict[str, tuple[float | str, ...]]] = {}
    for j in range(m.njnt):
        given = found.setdefault(neutral.label(m, j), {})
        if m.jnt_actfrclimited[j] and np.abs(m.jnt_actfrcrange[j]).min() < laws.UNREACHABLE:
            given["effort limits"] = tuple(m.jnt_actfrcrange[j].tolist())
    for joint in model.root.findall("joint"):  # of a URDF
        limit = joint.find("limit")
        if limit is not None and joint.get("name") in found and "velocity" in limit.attrib:
            try:
                speed = compiling.finite(limit, limit.get("velocity", ""))
            except ValueError as error:
                raise SceneError(f"{model.path}: {error}; correct it there") from None
            if abs(speed) < laws.UNREACHABLE:
                found[joint.get("name", "")]["velocity limits"] = (speed,)
    for j in range(m.njnt):
        on = m.body_weldid[m.geom_bodyid] == m.body_weldid[m.jnt_bodyid[j]]
        shapes = sorted((mujoco.mjtGeom(m.geom_type[g]).name.removeprefix("mjGEOM_").lower(), *_sizes(m, g))
                        for g in np.flatnonzero(on & ((m.geom_contype != 0) | (m.geom_conaffinity != 0))).tolist())
        if shapes:
            found[neutral.label(m, j)]["collision shapes"] = tuple(part for shape in shapes for part in shape)
    on_joints = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    for a in np.flatnonzero(np.isin(m.actuator_trntype, on_joints)):
        given = found[neutral.label(m, int(m.actuator_trnid[a, 0]))]
        what = "gear, gain and bias of actuators"
        given[what] = (*given.get(what, ()), *laws.drive(m, int(a)))
    return found


def _sizes(m: Any, g: int) -> list[float]:
    """Half sizes of a geometry, m, whatever its axes are called; none of a mesh, whose file has them."""
    import mujoco

    kind, sizes = mujoco.mjtGeom(m.geom_type[g]), m.geom_size[g].tolist()
    if kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return sorted(sizes)
    return [] if kind == mujoco.mjtGeom.mjGEOM_MESH else sizes


def _urdf_limits(model: Source) -> list[LeftOut]:
    """Limits that are none: the same below and above, or the lower one above the upper; these are taken away."""
    held = []
    for joint in model.root.findall("joint"):
        limit = joint.find("limit")
        if limit is None or joint.get("type") not in ("revolute", "prismatic", "spherical"):
            continue
        try:
            lower, upper = (compiling.finite(limit, limit.get(key, "0")) for key in ("lower", "upper"))
        except ValueError as error:
            raise SceneError(f"{model.path}: {error}; correct it there") from None
        if lower > upper or joint.get("type") == "spherical":  # MuJoCo refuses it
            limit.attrib.update(lower="0", upper="0")
        if lower >= upper or joint.get("type") == "spherical":
            held.append(LeftOut(str(joint.get("name")), "limits of joint", (lower, upper)))
    return held


def read(model: Source, m: Any, d: Any, gone: Sequence[str] = ()) -> Reading:
    """The compiled model in the state of its data; `gone`: what is left out of it already, in words."""
    import mujoco

    with compiling.listening():
        mujoco.mj_fwdPosition(m, d)
        mujoco.mj_fwdVelocity(m, d)
    moving = neutral.bodies(m, d)
    if not moving:
        offer = "; give --base free (base='free') to let its base move" if m.nbody > 1 or model.is_urdf else ""
        but = f" but {'; '.join(shortened(gone))}" if gone else ""
        raise SceneError(f"{model.path}: nothing in it moves{but}; a scene needs at least one body on a joint{offer}")
    return Reading(m, d, moving, [], [], urdf=model.is_urdf)


def _start(model: Source, m: Any, keyframe: str | int | None, qpos: Sequence[float] | None,
           qvel: Sequence[float] | None, moved: list[LeftOut] | None) -> Any:
    """The `mujoco.MjData` of the keyframe or the reference, overridden by what is given.

    Where neither is, joints whose reference is outside their limits start inside, which is added to `moved` if given.
    """
    import mujoco

    d = mujoco.MjData(m)
    q, v = d.qpos, d.qvel
    if keyframe is not None:
        names = [m.key(k).name or str(k) for k in range(m.nkey)]
        chosen = str(keyframe)
        if chosen not in names and not (chosen.isdigit() and int(chosen) < m.nkey):
            raise ArgumentError(unknown("keyframe", chosen, names) if names else
                                f"keyframe: {model.path} has none; leave it out")
        mujoco.mj_resetDataKeyframe(m, d, names.index(chosen) if chosen in names else int(chosen))
        if not all(np.isfinite(each).all() for each in (q, v, d.ctrl, d.mocap_pos, d.mocap_quat)):
            raise SceneError(f"{model.path}: keyframe {chosen!r} holds a number that is not finite; correct it there")
    for name, given, target in (("qpos", qpos, q), ("qvel", qvel, v)):
        if given is None:
            continue
        values = np.asarray(given, dtype=float)
        if values.shape != target.shape or not np.isfinite(values).all():
            raise ArgumentError(f"{name}: {target.size} finite numbers are wanted, joints in file order, not " + (
                f"{values.size}" if values.shape != target.shape else f"{values.tolist()}"))
        target[:] = values
    if qpos is None and keyframe is None and moved is not None:
        moved += _inside(m, q)
    if qpos is None:  # a joint that follows another one has no position of its own
        follow(model, m, q, v if qvel is None else v.copy())
    return d


def _inside(m: Any, q: np.ndarray) -> list[LeftOut]:
    """Put hinges and slides that are outside their limits a little inside, in place; which."""
    import mujoco

    listed: list[LeftOut] = []
    if neutral.off(m, "LIMIT", "CONSTRAINT"):
        return listed
    for j in np.flatnonzero((m.jnt_limited != 0) & (m.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE))).tolist():
        (lower, upper), at = m.jnt_range[j], int(m.jnt_qposadr[j])
        if not lower <= q[at] <= upper:
            reach = min(ROOM, (upper - lower) / 2)
            q[at] = np.clip(q[at], lower + reach, upper - reach)
            listed.append(LeftOut(neutral.label(m, j), "the reference, which its limits exclude, of joint",
                                f"it starts at {q[at]:.4g}"))
    return listed


def follow(model: Source, m: Any, q: np.ndarray, v: np.ndarray) -> None:
    """Put joints that follow others where those put them, in place."""
    couples = followers(model, m)
    for follower, leader, ratio, offset in couples * len(couples):  # as often as one may lead the next
        q[m.jnt_qposadr[follower]] = ratio * q[m.jnt_qposadr[leader]] + offset
        v[m.jnt_dofadr[follower]] = ratio * v[m.jnt_dofadr[leader]]


def followers(model: Source, m: Any) -> list[tuple[int, int, float, float]]:
    """(follower, leader, ratio, offset) of joints whose coordinates are coupled, by their numbers in MuJoCo."""
    if model.is_urdf:
        numbers = {m.jnt(j).name: j for j in range(m.njnt)}
        return [(numbers[name], numbers[mimic["joint"]], mimic["ratio"], mimic["offset"])
                for name, mimic in _mimics(model) if {name, mimic["joint"]} <= numbers.keys()]
    return features.coupled_joints(m)


def _mimics(model: Source) -> list[tuple[str, Table]]:
    """Moving joints of a URDF that follow others, and whom; MuJoCo does not read it."""
    joints = ((joint.get("name", ""), joint.find("mimic")) for joint in model.root.findall("joint")
             if joint.get("type") != "fixed")
    return [(name, {"joint": mimic.get("joint", ""), "ratio": float(mimic.get("multiplier", 1.0)),
                    "offset": float(mimic.get("offset", 0.0))}) for name, mimic in joints if mimic is not None]


def _name(model: Source) -> str:
    text = model.root.get("name") or model.root.get("model") or model.path.stem
    clean = "".join(letter if letter.isprintable() and letter not in "/\\" else " " for letter in text).strip(" .")
    return clean or "model"


def _check_against_pinocchio(model: Source, reading: Reading, base: str) -> None:
    """Raise if MuJoCo and Pinocchio, where installed, read different bodies."""
    import importlib.util

    if importlib.util.find_spec("pinocchio") is None:
        return
    from crosscheck.scene.models.second import bodies as second

    try:
        theirs = second(model, base)
    except SceneError:  # Pinocchio may refuse what MuJoCo reads; `inspect` reports it
        return
    for body in reading.bodies.values():
        if body.name not in theirs or not body.mass:
            continue
        mass, moments = theirs[body.name]
        ours = np.linalg.eigvalsh(body.inertia)
        if not np.isclose(mass, body.mass, rtol=1e-9) or not np.allclose(moments, ours, rtol=1e-9, atol=1e-12):
            raise SceneError(f"{model.path}: MuJoCo and Pinocchio read link {body.name!r} differently: masses "
                             f"{body.mass:.12g} and {mass:.12g} kg, principal moments {ours} and {moments} kg m^2; "
                             "crosscheck inspect tells more")
