"""Accelerations of a Pinocchio model with redundant constraints: constraint forces of least norm with fixed rank.

An overconstrained mechanism can move because some constraint rows depend on the others. As soon as positions have
drifted they no longer do, and a solver that satisfies every row, as the proximal one of `constraintDynamics` does with
any mu, locks the mechanism: a parallelogram within half a second with steps of 1 ms. Here the number of independent
directions is that at the start; the ones with the smallest singular values are left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from crosscheck.adapters.pinocchio.models import Closure

if TYPE_CHECKING:
    pass

DAMPING = 1.0
"""mu of one proximal iteration; the right-hand side computed from its forces does not depend on it."""


def accelerations(model: object, data: object, closure: Closure, q: np.ndarray, v: np.ndarray,
                  torque: np.ndarray) -> np.ndarray:
    """Joint accelerations (nv,) under joint torques (nv,); writes constraint forces into the closure's workspaces.

    One damped proximal iteration of `constraintDynamics` from zero gives forces f with (G M^-1 G^T + mu) f = -r. This
    yields r = G a + gamma + 2 alpha G u + beta^2 Phi at the accelerations without constraints, as Pinocchio forms it.
    """
    import pinocchio as pin
    from scipy.linalg import solve_triangular

    if not (np.isfinite(q).all() and np.isfinite(v).all()):
        return np.full(len(v), np.nan)  # the loop over steps reports the time of the divergence
    once = pin.ProximalSettings(0.0, DAMPING, 1)
    pin.constraintDynamics(model, data, q, v, torque, closure.models, closure.workspaces, once)
    sizes = [held.residualSize() for held in closure.models]
    damped = np.concatenate([each.contact_force.vector[:size]
                             for each, size in zip(closure.workspaces, sizes, strict=True)])
    jacobian = pin.getConstraintsJacobian(model, data, closure.models, closure.workspaces)
    upper = np.triu(pin.crba(model, data, q))
    if not all(np.isfinite(values).all() for values in (damped, jacobian, upper)):  # squares of the state overflow
        return np.full(len(v), np.nan)
    root = np.linalg.cholesky(upper + np.triu(upper, 1).T)
    scaled = solve_triangular(root, jacobian.T, lower=True).T
    residual = -(scaled @ (scaled.T @ damped) + DAMPING * damped)
    U, sigma, W = np.linalg.svd(scaled, full_matrices=False)
    U, sigma, W = U[:, :closure.rank], sigma[:closure.rank], W[:closure.rank]
    share = U.T @ residual / sigma
    for each, force in zip(closure.workspaces, np.split(-U @ (share / sigma), np.cumsum(sizes)[:-1]), strict=True):
        each.contact_force = pin.Force(np.concatenate([force, np.zeros(6 - len(force))]))
    free = solve_triangular(root, torque - pin.nonLinearEffects(model, data, q, v), lower=True)
    rates: np.ndarray = solve_triangular(root.T, free - W.T @ share)
    return rates
