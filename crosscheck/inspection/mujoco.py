"""What MuJoCo says about a scene: `mj_forward` on the adapter's model, which is built anew with each state as qpos0."""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.adapters import get
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.mujoco import models
from crosscheck.inspection.admissible import posed
from crosscheck.inspection.base import Probe, stacked
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

MOVED = "a moving rest angle is an actuator here, and MuJoCo computes spring energy only about a fixed rest angle"
SOFT = "equality constraints are soft: MuJoCo solves a regularised problem, not that of rigid joints"
OWN = "its friction and limits are soft, so that they follow a law of its own here; crosscheck advise compares the two"


def probe(scene: Scene, states: States, form: str | None = None) -> Probe:
    """Probe the MuJoCo model in form "tree" or "maximal"."""
    chosen = form or get("mujoco").form(scene, RunSpec("Euler"))  # type: ignore[attr-defined]
    return stacked([_at(posed(scene, states, k), chosen) for k in range(len(states.t))])


def _at(scene: Scene, form: str) -> Probe:
    """The model at the initial state of `scene`."""
    import mujoco

    model = models.build(scene, "Euler", 1e-3, form)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    models.set_initial_state(scene, model, data)
    if control := models.controls(scene):
        control(model, data)
    mujoco.mj_forward(model, data)
    mujoco.mj_rnePostConstraint(model, data)  # the accelerations of bodies
    bodies = [model.body(str(k)).id for k in range(scene.n)]
    R = data.xmat[bodies].reshape(-1, 3, 3)
    principal = np.swapaxes(R, 1, 2) @ data.ximat[bodies].reshape(-1, 3, 3)
    twists, rates, jacobian = _motion(model, data, bodies)
    jacobian[:, 1] = np.einsum("nji,njk->nik", R, jacobian[:, 1])
    matrix = np.zeros((model.nv, model.nv))
    if model.nv:
        mujoco.mj_fullM(model, data, matrix)
    probe = Probe(
        "mujoco", form, model.body_mass[bodies],
        np.einsum("nij,nj,nkj->nik", principal, model.body_inertia[bodies], principal), data.xipos[None, bodies],
        R[None], twists[None, :, 3:], np.einsum("nji,nj->ni", R, twists[:, :3])[None],
        kinetic=data.energy[1:].copy(), potential=data.energy[:1].copy(),
        jacobian=jacobian.reshape(1, 6 * scene.n, model.nv), mass_matrix=matrix[None])
    # Its own law is another where it is not cut to the coefficient of friction, 0 of limits, or acts along the motion.
    cut = np.allclose(np.abs(data.efc_force), data.efc_frictionloss, rtol=1e-12, atol=0.0)
    if model.neq or not cut or (data.efc_force * data.efc_vel > 0.0).any():
        probe.notes = dict.fromkeys(("acceleration", "angular acceleration"), SOFT if model.neq else OWN)
    else:
        probe.a, probe.alpha = rates[None, :, 3:], np.einsum("nji,nj->ni", R, rates[:, :3])[None]
    if any(force.is_spring and force.functions for force in scene.forces):
        probe.potential, probe.notes["potential energy"] = None, MOVED
    if form == "maximal":
        probe.applied_force = data.qfrc_smooth[None].copy()
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
    probe.gravity_force = -data.qfrc_bias[None].copy()  # at rest the bias is gravity alone
    return probe


def _motion(model: Any, data: Any, bodies: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocities and accelerations (n, 6) of the centres of mass, rotation first, world axes; Jacobians (n, 6, nv)."""
    import mujoco

    twists, rates, jacobian = (np.zeros((len(bodies), *shape)) for shape in ((6,), (6,), (2, 3, model.nv)))
    for k, body in enumerate(bodies):
        for function, target in ((mujoco.mj_objectVelocity, twists), (mujoco.mj_objectAcceleration, rates)):
            column = np.zeros((6, 1))
            function(model, data, mujoco.mjtObj.mjOBJ_BODY, body, column, 0)
            target[k] = column[:, 0]
        mujoco.mj_jacBodyCom(model, data, jacobian[k, 0], jacobian[k, 1], body)
    rates[:, 3:] += model.opt.gravity  # MuJoCo gives accelerations relative to free fall
    return twists, rates, jacobian
