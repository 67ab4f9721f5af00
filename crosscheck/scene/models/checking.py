"""Checks what was made of a compiled MuJoCo model by MuJoCo's own numbers, away from the start."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.scene.coordinates import at_start, rates
from crosscheck.scene.mechanics import index1
from crosscheck.scene.model import LeftOut, Scene
from crosscheck.scene.models.features import closure_ends, turned_by
from crosscheck.scene.models.neutral import Reading, off
from crosscheck.scene.schema import Content
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import mujoco

AWAY, SEEDS = 0.1, (20240, 20241, 20242)
"""Size of the velocity with which checked states lie one second from the start, and seeds of its directions."""

ALIKE = 1e-9
"""Largest difference of a residual, relative to the size of the model: both are rounded from the same numbers."""

MOST_BODIES = 128
"""Largest model whose accelerations are checked: the scene's are solved densely."""

TOLD, LOOSEST = 1e-8, 1e-6
"""Differences of accelerations, relative to the largest, from which they are told, and from which something is wrong:
mass matrices of condition 1e9 have their room."""

AT_END = 1e-8
"""How near (rad, m) a joint starts to an end of its range to be at it, and how slow (rad/s, m/s) to rest."""

_CONSTRAINTS = ("limits of", "dry friction", "contacts of", "equality", "mimic of", "actuator", "range of the actuator")
"""Beginnings of `LeftOut.what` that is also missing in the smooth accelerations of MuJoCo without actuators."""


def unlike(what: str) -> bool:
    """Whether this (`LeftOut.what`) changes the accelerations that `motion` compares."""
    return not what.startswith(_CONSTRAINTS)


def away(reading: Reading, seed: int = SEEDS[0]) -> mujoco.MjData:
    """The `mujoco.MjData` of a seeded state near that of the reading, in motion."""
    import mujoco

    m, d, rng = reading.model, copy.copy(reading.data), np.random.default_rng(seed)
    mujoco.mj_integratePos(m, d.qpos, AWAY * rng.normal(size=m.nv), 1.0)
    d.qvel[:] = rng.normal(size=m.nv)
    return d


def motion(reading: Reading, d: mujoco.MjData, scene: Scene) -> tuple[float, float, str]:
    """(largest difference between the accelerations of MuJoCo and of the scene, m/s^2 or rad/s^2, the same over the
    largest acceleration, name of the body that has it), all in the state of `d`.

    MuJoCo's are without actuators if one of them is left out; then the scene has to be without servos.
    """
    import mujoco

    m = copy.copy(reading.model)
    if unactuated(reading):
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    mujoco.mj_forward(m, d)
    d.qacc[:] = d.qacc_smooth
    mujoco.mj_rnePostConstraint(m, d)
    a, alpha, _ = index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    gaps, sizes = [], [1.0]
    for k, body in enumerate(reading.bodies.values()):
        rate = np.zeros((6, 1))
        mujoco.mj_objectAcceleration(m, d, mujoco.mjtObj.mjOBJ_XBODY, body.index, rate, 0)
        turning = rate[:3, 0]
        # from the body's frame to the common centre of mass
        arm, w = scene.x0[k] - d.xpos[body.index], scene.R0[k] @ scene.w0[k]
        moving = rate[3:, 0] + scene.gravity + np.cross(turning, arm) + np.cross(w, np.cross(w, arm))
        gaps.append(float(max(np.abs(moving - a[0, k]).max(), np.abs(turning - scene.R0[k] @ alpha[0, k]).max())))
        sizes += [float(np.abs(moving).max()), float(np.abs(turning).max())]
    worst = int(np.argmax(gaps))  # of NaN, too
    return gaps[worst], gaps[worst] / max(sizes), scene.bodies[worst].name


def unactuated(reading: Reading) -> bool:
    """Whether an actuator is left out, so that accelerations are compared without any."""
    return any(each.what.startswith("actuator") for each in (*reading.lost, *reading.noted))


def watchable(content: Content, scene: Scene) -> Content:
    """The content of a scene file without the ranges of joints that start at an end of them and do not turn inside.

    Such as a gripper that is closed at its stop: nothing of the motion would be before the monitor. They are listed.
    """
    start = at_start(scene)
    near = {each.joint: each for each in scene.monitors if each.type == "range" and each.joint is not None and min(
        abs(start[each.joint][0][0] - end) for end in (each.lower, each.upper)) < AT_END}
    if not near:
        return content
    x, R, v, w = (part[None] for part in (scene.x0, scene.R0, scene.v0, scene.w0))
    a, alpha, _ = index1(scene, x, R, v, w)
    states, gone = States(np.zeros(1), x, R, v, w, a, alpha), []
    for joint in (each for each in scene.joints if each.name in near and not any(each.dry_friction)):
        rate = float(rates(joint, states)[0])
        pushed = rate if abs(rate) > AT_END else float(rates(joint, states, accelerated=True)[0])
        q, monitor = float(start[joint.name][0][0]), near[joint.name]
        if pushed * (1 if abs(q - monitor.upper) < AT_END else -1) > -AT_END:
            gone.append(joint.name)
    listed = [[name, "limits of joint", "it starts at an end of them and does not turn inside; limits kept are stops"]
            for name in gone]
    return content | {
        "monitors": [each for each in content["monitors"] if each.get("joint") not in gone],
        "left_out": [*content.get("left_out", ()), *listed]} if gone else content


def loops(reading: Reading) -> None:
    """List as lost the loops whose residual is not that of MuJoCo's own constraint in a state where they are open."""
    import mujoco

    m = reading.model
    closed = [e for e in range(m.neq) if m.eq_type[e] in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
             and reading.data.eq_active[e]]
    if not closed or off(m, "EQUALITY", "CONSTRAINT"):
        return
    d = away(reading)
    mujoco.mj_fwdPosition(m, d)
    size = max(1.0, float(np.abs(d.xpos).max()))
    for e in closed:
        rows = (d.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (d.efc_id == e)
        theirs = d.efc_pos[rows]
        ends, turn = closure_ends(m, d, e)
        one, other = (d.xpos[body] + d.xmat[body].reshape(3, 3) @ offset for body, offset in ends)
        gaps = [float(np.abs(theirs[:3] - (one - other)).max())]
        if len(theirs) == 6 and m.eq_data[e, 10]:
            gaps.append(abs(float(np.linalg.norm(theirs[3:])) / abs(m.eq_data[e, 10])
                            - abs(np.sin(turned_by(m, d, ends, turn) / 2))))
        if not max(gaps) < ALIKE * size:
            reading.lost.append(LeftOut(m.equality(e).name or f"equality {e}", "equality", (
                f"which MuJoCo and the reader take differently: by {max(gaps):.3g} m or rad")))
