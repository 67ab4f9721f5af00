"""Reads a model file into the tables of a scene file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, SceneError, unknown
from crosscheck.scene.models import compiling, features, neutral, source
from crosscheck.scene.models.neutral import Reading
from crosscheck.scene.models.source import Source
from crosscheck.scene.models.words import quoted, together
from crosscheck.scene.schema import Content as Table


def table(path: str | os.PathLike[str], keyframe: str | int | None = None, drop: bool = False, base: str = "fixed",
          qpos: Sequence[float] | None = None, qvel: Sequence[float] | None = None, duration: float = 2.0,
          samples: int = 101) -> Table:
    """The content of a scene file, see `crosscheck.import_model`."""
    if not isinstance(path, str | os.PathLike):
        raise ArgumentError(f"path: the name of a model file is wanted, not {type(path).__name__}")
    if base not in ("fixed", "free"):
        raise ArgumentError(unknown("base", base, ("fixed", "free")))
    model = source.read(Path(path))
    m = compiling.compiled(model, base)  # raises with advice if MuJoCo is not installed
    import mujoco

    reading = read(model, m, _start(model, m, keyframe, qpos, qvel))
    joints = neutral.joint_tables(reading)
    further, forces = features.collect(reading, joints)
    if model.is_urdf:
        by_name = {each["name"]: each for each in joints}
        for name, mimic in _mimics(model):
            if name in by_name and mimic["joint"] in by_name:
                by_name[name]["mimic"] = mimic
            else:
                reading.lost.append(f"mimic of joint {name!r}")
        _check_against_pinocchio(model, reading, base)
    if reading.impossible:
        raise SceneError(f"{model.path}: cannot be a scene: {'; '.join(reading.impossible)}")
    if reading.lost and not drop:
        raise SceneError(f"{model.path}: a scene cannot hold {'; '.join(together(map(quoted, reading.lost)))}; give "
                         "--drop (drop=True) to leave all this out")
    weightless = int(m.opt.disableflags) & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gravity = np.zeros(3) if weightless else m.opt.gravity
    if model.is_urdf:
        gravity = np.array([0.0, 0.0, -9.81])
    content: Table = {
        "schema": 2, "name": _name(model),
        "description": "; ".join([f"imported from {Path(path).name}",
                                  *(f"left out: {words}" for words in reading.lost)]),
        "source": Path(path).name, "tags": ["imported"], "gravity": np.asarray(gravity).tolist(),
        "duration": duration, "samples": samples, "left_out": reading.lost,
        "bodies": [neutral.body_table(body) for body in reading.bodies.values()],
        "joints": _distinct([*joints, *further]), "forces": forces}
    return {key: value for key, value in content.items() if value not in ([], "")}


def read(model: Source, m: Any, d: Any) -> Reading:
    """The compiled model in the state of its data."""
    import mujoco

    with compiling.listening():
        mujoco.mj_fwdPosition(m, d)
        mujoco.mj_fwdVelocity(m, d)
    found = neutral.bodies(m, d)
    if not found:
        raise SceneError(f"{model.path}: nothing in it moves; a scene needs at least one body on a joint")
    return Reading(m, d, found, [], [])


def _start(model: Source, m: Any, keyframe: str | int | None, qpos: Sequence[float] | None,
           qvel: Sequence[float] | None) -> Any:
    """The `mujoco.MjData` of the keyframe or the reference, overridden by what is given."""
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
            raise ArgumentError(f"{name}: {target.size} finite numbers are wanted, joints in file order, not "
                                f"{values.size}")
        target[:] = values
    if qpos is None:  # a joint that follows another one has no position of its own
        follow(model, m, q, v if qvel is None else v.copy())
    return d


def follow(model: Source, m: Any, q: np.ndarray, v: np.ndarray) -> None:
    """Put joints that follow others where those put them, in place."""
    found = followers(model, m)
    for follower, leader, ratio, offset in found * len(found):  # as often as one may lead the next
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
    found = ((joint.get("name", ""), joint.find("mimic")) for joint in model.root.findall("joint")
             if joint.get("type") != "fixed")
    return [(name, {"joint": mimic.get("joint", ""), "ratio": float(mimic.get("multiplier", 1.0)),
                    "offset": float(mimic.get("offset", 0.0))}) for name, mimic in found if mimic is not None]


def _name(model: Source) -> str:
    text = model.root.get("name") or model.root.get("model") or model.path.stem
    clean = "".join(letter if letter.isprintable() and letter not in "/\\" else " " for letter in text).strip(" .")
    return clean or "model"


def _distinct(joints: list[Table]) -> list[Table]:
    """The joints with a number added to every name that occurred before."""
    names: set[str] = set()
    for joint in joints:
        name, count = joint["name"], 1
        while joint["name"] in names:
            count += 1
            joint["name"] = f"{name} {count}"
        names.add(joint["name"])
    return joints


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
        if body.name not in theirs:
            continue
        mass, moments = theirs[body.name]
        ours = np.linalg.eigvalsh(body.inertia)
        if not np.isclose(mass, body.mass, rtol=1e-9) or not np.allclose(moments, ours, rtol=1e-9, atol=1e-12):
            raise SceneError(f"{model.path}: MuJoCo and Pinocchio read link {body.name!r} differently: masses "
                             f"{body.mass:.12g} and {mass:.12g} kg, principal moments {ours} and {moments} kg m^2; "
                             "crosscheck inspect tells more")
