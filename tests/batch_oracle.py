"""The step of DAE2H_LE on ball joints, for many trial solutions at once: dense Newton and continuation on long chains.

The same equation (4.4) as `lieeuler.reference.hamilton_step`, whose solutions solve it, as a test asserts. Like that
one it shares nothing with the kernel; its exponential and its D* are closed forms over arrays (K, n, 3).
"""

from __future__ import annotations

import numpy as np


def hats(a):
    return np.cross(np.eye(3), a[..., None, :]).swapaxes(-1, -2) * -1


def rotation_and_trivialisation(theta):
    """exp(hat(theta)) and D*(theta), for 1e-4 < |theta| < 2 pi or so."""
    t = np.linalg.norm(theta, axis=-1)[..., None, None]
    X = hats(theta)
    XX = X @ X
    return (np.eye(3) + np.sin(t) / t * X + (1 - np.cos(t)) / t**2 * XX,
            np.eye(3) + X / 2 + (1 / t**2 - 1 / (2 * t * np.tan(t / 2))) * XX)


def residual(system, q0, u0, h):
    """The function of trial solutions (K, 9 n): the xi of all bodies, then the lam of all joints."""
    n, G0, free = system.n, system.G(q0), system.M @ u0 + h * system.applied()
    mass, J = np.array(system.masses)[:, None], np.array(system.inertias)
    parents, children, above, below = (np.array([getattr(joint, name) for joint in system.joints]) for name in (
        "parent", "child", "parent_anchor", "child_anchor"))
    inner = parents >= 0

    def rows(z):
        xi, lam = z[:, :6 * n].reshape(-1, n, 6), z[:, 6 * n:]
        v, w = xi[..., :3], xi[..., 3:]
        E, D = rotation_and_trivialisation(h * w)
        y = D @ (J @ w[..., None])
        w, R = np.linalg.solve(J, E.swapaxes(-1, -2) @ y)[..., 0], q0[1] @ E
        joint = v[:, children] + (R[:, children] @ np.cross(w[:, children], below)[..., None])[..., 0]
        joint[:, inner] -= v[:, parents[inner]] + (
            R[:, parents[inner]] @ np.cross(w[:, parents[inner]], above[inner])[..., None])[..., 0]
        momenta = np.concatenate([mass * v, y[..., 0]], -1).reshape(len(z), -1)
        return np.hstack([momenta - free + h * lam @ G0, joint.reshape(len(z), -1)])
    return rows


def newton(rows, z):
    """The solution next to z by a Newton iteration that halves its steps until they help; None where that ends."""
    left = rows(z[None])[0]
    for _ in range(20):
        shifts = np.diag(1e-6 * np.maximum(1, np.abs(z)))
        A = np.vstack([(rows(z + part) - rows(z - part)) / (2 * part.sum(1)[:, None])
                       for part in np.array_split(shifts, max(1, len(z) // 96))]).T
        dz, share = np.linalg.solve(A, left), 1.0
        while np.linalg.norm(rows((z - share * dz)[None])) > (1 - 1e-4 * share) * np.linalg.norm(left):
            share /= 2
            if share < 1e-3:
                return z if np.linalg.norm(left) < 1e-10 * np.abs(z).max() else None
        z = z - share * dz
        left = rows(z[None])[0]
        if np.abs(dz).max() < 1e-9 * np.abs(z).max():
            return z
    return None


def turning_point(system, q0, u0, h):
    """How far the solution followed from vanishing steps reaches, as a share of h; 1 if it reaches the step."""
    z, reached, pace = np.r_[u0, system.index1(q0, u0)[1]], 0.0, 0.1
    before = None
    while reached < 1 and pace > 1e-3:
        share = min(1.0, reached + pace)
        guess = z if before is None else z + (z - before[1]) * (share - reached) / (reached - before[0])
        found = newton(residual(system, q0, u0, share * h), guess)
        if found is None or np.abs(found - guess).max() > 0.2 * np.abs(guess).max():
            pace /= 2
            continue
        before, z, reached = (reached, z), found, share
    return reached
