"""Random admissible states of a scene, and bases of its admissible velocities.

The velocity u of the system, (6n,), is (v in the world, w in body axes) of one body after the other.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene, quaternion_from_rotation
from crosscheck.scene.starts import Configuration, bodies_at
from crosscheck.scene.states import States

TURN = 0.1, 0.4
"""Range of the distance of a random state from the start, in rad and in the scene's length.

The distance is halved until the joints can be closed there.
"""

_CLOSED = 1e-14  # times the scene's length; Newton's method reaches a few eps
_ITERATIONS = 30
_HALVINGS = 20


def length(scene: Scene) -> float:
    """The scene's length, m: the largest of 1e-3, the distances of mass centres from the origin, anchors and rods."""
    anchors = [np.linalg.norm(anchor) for joint in scene.joints for anchor in (joint.parent_anchor, joint.child_anchor)]
    rods = [joint.length for joint in scene.joints if joint.length is not None]
    return float(max([1e-3, *np.linalg.norm(scene.x0, axis=1), *anchors, *rods]))


def inverse_root_mass(scene: Scene) -> np.ndarray:
    """B, (6n, 6n), with B^T M B = I."""
    return np.linalg.cholesky(mechanics.inverse_mass(scene))


def basis(scene: Scene, constraints: Constraints, x: np.ndarray, R: np.ndarray) -> np.ndarray:
    """N, (6n, d), with G N = 0 and N^T M N = I, at one state x (n, 3), R (n, 3, 3)."""
    B = inverse_root_mass(scene)
    if constraints.m == 0:
        return B
    _, sigma, Vt = np.linalg.svd(constraints.jacobian(x[None], R[None])[0] @ B)
    rank = int(np.count_nonzero(sigma > mechanics.RANK_TOLERANCE * sigma[0]))
    return np.asarray(B @ Vt[rank:].T)


def states(scene: Scene, count: int, seed: int) -> States:
    """The start, then `count` random states. Each is moved in an admissible direction, and its joints are closed."""
    constraints = Constraints(scene)
    rng = np.random.default_rng(seed)
    poses = [(scene.x0, scene.R0)] + [_pose(scene, constraints, rng) for _ in range(count)]
    x, R = (np.array(part) for part in zip(*poses, strict=True))
    u = np.concatenate([scene.v0, scene.w0], axis=1).ravel()
    rates = [u] + [_velocity(scene, constraints, rng, u, *pose) for pose in poses[1:]]
    v, w = np.split(np.reshape(rates, (count + 1, scene.n, 6)), 2, axis=2)
    return States(np.zeros(count + 1), x, R, v, w)


def posed(scene: Scene, at: States, k: int) -> Scene:
    """The scene with its bodies in the k-th state of `at`."""
    state = Configuration(at.x[k], quaternion_from_rotation(at.R[k]), at.v[k], at.w[k])
    return scene.replace(bodies=bodies_at(scene, state))


def _pose(scene: Scene, constraints: Constraints, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A random pose near the start with closed joints."""
    N = basis(scene, constraints, scene.x0, scene.R0)
    step = (N @ rng.normal(size=N.shape[1])).reshape(-1, 6)
    L = length(scene)
    step *= rng.uniform(*TURN) / max(np.abs(step[:, :3]).max() / L, np.abs(step[:, 3:]).max(), np.finfo(float).tiny)
    for _ in range(_HALVINGS):
        pose = _close(scene, constraints, *_moved(scene.x0, scene.R0, step), L)
        if pose is not None:
            return pose
        step = step / 2
    return scene.x0, scene.R0  # the bodies cannot move


def _close(scene: Scene, constraints: Constraints, x: np.ndarray, R: np.ndarray,
           L: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Close the joints by Newton's method with the least mass-weighted change; None if no pose nearby is found."""
    B = inverse_root_mass(scene)
    for _ in range(_ITERATIONS):
        phi = constraints.position(x[None], R[None])[0]
        if not np.abs(phi).max(initial=0.0) > _CLOSED * max(1.0, L):
            return x, R
        scaled = constraints.jacobian(x[None], R[None])[0] @ B
        change = (B @ np.linalg.lstsq(scaled, -phi, rcond=mechanics.RANK_TOLERANCE)[0]).reshape(-1, 6)
        if not np.abs(change).max() < max(1.0, L):
            return None
        x, R = _moved(x, R, change)
    return None


def closed(scene: Scene, constraints: Constraints, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray
           ) -> tuple[np.ndarray, ...] | None:
    """The admissible state (x, R, v, w) nearest to a given one; None if no pose nearby closes the joints."""
    pose = _close(scene, constraints, x, R, length(scene))
    if pose is None:
        return None
    u = _projected(scene, constraints, np.concatenate([v, w], axis=1).ravel(), *pose)
    return (*pose, *np.split(u.reshape(scene.n, 6), 2, axis=1))


def _moved(x: np.ndarray, R: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x + dx and R exp(hat(theta)) for step (n, 6) = (dx, theta)."""
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(R) * Rotation.from_rotvec(step[:, 3:])
    return x + step[:, :3], turned.as_matrix()


def _velocity(scene: Scene, constraints: Constraints, rng: np.random.Generator, u: np.ndarray, x: np.ndarray,
              R: np.ndarray) -> np.ndarray:
    """The start's velocities plus random ones of their size, projected on those that the joints allow at this pose."""
    N = basis(scene, constraints, x, R)
    extra = N @ rng.normal(size=N.shape[1])
    L = length(scene)
    size = max(np.abs(scene.w0).max(initial=0.0), np.abs(scene.v0).max(initial=0.0) / L, 1.0)
    turning, moving = np.abs(extra.reshape(-1, 6)[:, 3:]).max(), np.abs(extra.reshape(-1, 6)[:, :3]).max() / L
    extra *= rng.uniform(0.5, 1.0) * size / max(turning, moving, np.finfo(float).tiny)
    return _projected(scene, constraints, u + extra, x, R)


def _projected(scene: Scene, constraints: Constraints, u: np.ndarray, x: np.ndarray, R: np.ndarray) -> np.ndarray:
    """The velocity nearest to u, in the metric of the masses, that the joints and drives allow at a pose."""
    N = basis(scene, constraints, x, R)
    B, M = inverse_root_mass(scene), np.linalg.inv(mechanics.inverse_mass(scene))
    allowed: np.ndarray = N @ (N.T @ M @ u)
    if constraints.drives:  # plus the velocity of least energy that follows the drives
        rest = np.zeros((1, scene.n, 3))
        rate = -constraints.velocity(x[None], R[None], rest, rest)[0]
        scaled = constraints.jacobian(x[None], R[None])[0] @ B
        allowed += B @ np.linalg.lstsq(scaled, rate, rcond=mechanics.RANK_TOLERANCE)[0]
    return allowed
