"""Loads a model file with MuJoCo alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.adapters.common.native import Hinge, JointStates, Link, Native, moved, solids
from crosscheck.errors import EngineError, errors_as
from crosscheck.scene.model import rotation_from_quaternion
from crosscheck.scene.models import neutral, source
from crosscheck.scene.models.compiling import listening

if TYPE_CHECKING:
    import mujoco


def _model(path: Path) -> tuple[mujoco.MjModel, str]:
    """(model, MuJoCo's error if the file is a URDF that was read without its meshes because these cannot be opened)."""
    import mujoco

    def refused(error: Exception) -> EngineError:  # a ValueError or MuJoCo's own FatalError
        return EngineError(" ".join(str(error).split()).removeprefix("Error: "))

    try:
        with errors_as(refused):
            return mujoco.MjModel.from_xml_path(str(path.resolve())), ""
    except EngineError as error:
        words = str(error)
    model = source.read(path)
    if "opening file" not in words or not model.is_urdf:
        raise EngineError(words)
    for link in model.root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            if shape.find("geometry/mesh") is not None:
                link.remove(shape)
    with errors_as(lambda error: EngineError(f"{words}; without its meshes: {refused(error)}")):
        return mujoco.MjModel.from_xml_string(model.text), words


def _laws(model: mujoco.MjModel, name: str) -> dict[str, float | str]:
    """Limits of a joint, its dry friction, the range of what acts on it, and the gains of its actuators."""
    if not (j := next((j for j in range(model.njnt) if model.jnt(j).name == name), -1)) >= 0:
        return {}
    on = [a for a in range(model.nu) if model.actuator_trntype[a] == 0 and model.actuator_trnid[a, 0] == j]
    gears = [float(model.actuator_gear[a, 0]) for a in on]
    kp, kv = (sum((-float(model.actuator_biasprm[a, column]) * gear**2 for a, gear in zip(on, gears, strict=True)), 0.0)
              for column in (1, 2))
    lower, upper = map(float, model.jnt_range[j]) if model.jnt_limited[j] else (-np.inf, np.inf)
    return {"lower limit": lower, "upper limit": upper, "kp": kp, "kv": kv,
            "friction": float(model.dof_frictionloss[model.jnt_dofadr[j]]),
            "effort": float(np.abs(model.jnt_actfrcrange[j]).max()) if model.jnt_actfrclimited[j] else np.inf}


def _shapes(reading: neutral.Reading) -> dict[str, str]:
    """The geometries that may collide, in the frame of the first body of each link."""
    import mujoco

    m, d, listed = reading.model, reading.data, []
    for g in np.flatnonzero((m.geom_contype != 0) | (m.geom_conaffinity != 0)).tolist():
        group, kind = int(reading.groups[m.geom_bodyid[g]]), mujoco.mjtGeom(m.geom_type[g]).name
        kind, size = kind.removeprefix("mjGEOM_").lower(), m.geom_size[g].tolist()
        sizes = {"sphere": size[:1], "plane": [], "box": [2 * each for each in size]}.get(kind, size)
        sizes = [size[0], 2 * size[1]] if kind in ("capsule", "cylinder") else sizes
        link = reading.bodies[group].name if group in reading.bodies else "ground"
        listed.append((link, kind, sizes, d.xmat[group].reshape(3, 3).T @ (d.geom_xpos[g] - d.xpos[group])))
    return solids(listed)


def load(path: str, states: JointStates) -> Native:
    """The file read by MuJoCo; limits, friction, contacts and controls are switched off for the accelerations."""
    import mujoco

    with listening():
        model, refusal = _model(Path(path))
        if not all(np.isfinite(each).all() for each in (model.body_mass, model.body_inertia, model.body_ipos)):
            raise EngineError("its model has masses or inertias that are not finite")
        data = mujoco.MjData(model)
        model.qpos0[:] = np.where(np.isfinite(model.qpos0), model.qpos0, 0.0)
        data.qpos[:] = model.qpos0
        mujoco.mj_forward(model, data)
        reading = neutral.Reading(model, data, neutral.bodies(model, data), [], [])
        tables = neutral.joint_tables(reading)
        follows = {model.jnt(int(model.eq_obj1id[e])).name: model.jnt(int(model.eq_obj2id[e])).name
                   for e in range(model.neq) if model.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and data.eq_active[e]
                   and model.eq_obj2id[e] >= 0}
        off = mujoco.mjtDisableBit
        gravity = np.zeros(3) if int(model.opt.disableflags) & off.mjDSBL_GRAVITY else model.opt.gravity.copy()
        model.opt.disableflags |= (off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
                                   | off.mjDSBL_ACTUATION)
        links = {body.name: Link(body.mass, body.inertia) for body in reading.bodies.values()}
        links |= {frame["name"]: Link(0.0, np.zeros((3, 3))) for frame in reading.frames}
        joints = {table["name"]: Hinge(
            table["parent"], table["child"], np.array(table["parent_anchor"]), np.array(table["child_anchor"]),
            np.array(table["child_axis"]), rotation_from_quaternion(np.array(table["reference_attitude"])),
            table["type"], table.get("damping", 0.0), table.get("armature", 0.0), table.get("stiffness", 0.0),
            table.get("rest_position", 0.0), follows.get(table["name"], ""), laws=_laws(model, table["name"]))
            for table in tables if "position" in table}
        native = Native("mujoco", links, joints, gravity, solver="mj_forward", refusal=refusal,
                        shapes=_shapes(reading))
        if len(joints) != model.nv:
            return native
        only = {body.name: int(model.body_jntadr[index]) for index, body in reading.bodies.items()}
        only |= {table["child"]: j for j, table in reading.chained.items()}
        columns = {name: int(model.jnt_dofadr[only[joint.child]]) for name, joint in joints.items()}

        def terms(position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, ...]:
            data.qpos[:], data.qvel[:] = position, velocity  # all joints are hinges and slides
            mujoco.mj_forward(model, data)
            M = np.zeros((model.nv, model.nv))
            try:
                mujoco.mj_fullM(model, data, M)
            except TypeError:  # before version 4
                mujoco.mj_fullM(model, M, data.qM)
            return M, data.qfrc_bias.copy(), data.qacc.copy()

        return moved(native, states, columns, "mj_forward", terms)
