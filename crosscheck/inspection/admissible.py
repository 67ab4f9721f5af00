"""Random admissible states of a scene, and bases of its admissible velocities.

The velocity u of the system, (6n,), is (v in the world, w in body axes) of one body after the other.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scene import mechanics
from crosscheck.scene.assembly import projected
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from crosscheck.scene.schema import EntryError
from crosscheck.scene.starts import started
from crosscheck.scene.states import States

TURN = 0.1, 0.4
"""Range of the distance of a random state from the start, in rad and in the scene's length.

The distance is halved until the joints can be closed there.
"""

_HALVINGS = 20


def length(scene: Scene) -> float:
    """The scene's length, m: the largest of 1e-3, the distances of mass centres from the origin, anchors and rods."""
    anchors = [np.linalg.norm(anchor) for joint in scene.joints for anchor in (joint.parent_anchor, joint.child_anchor)]
    rods = [joint.length for joint in scene.joints if joint.length is not None]
    return float(max([1e-3, *np.linalg.norm(scene.x0, axis=1), *anchors, *rods]))


def basis(scene: Scene, constraints: Constraints, x: np.ndarray, R: np.ndarray) -> np.ndarray:
    """N, (6n, d), with G N = 0 and N^T M N = I, at one state x (n, 3), R (n, 3, 3)."""
    B = np.linalg.cholesky(mechanics.inverse_mass(scene))  # (6n, 6n) with B^T M B = I
    if constraints.m == 0:
        return B
    _, sigma, Vt = np.linalg.svd(constraints.jacobian(x[None], R[None])[0] @ B)
    rank = int(np.count_nonzero(sigma > mechanics.RANK_TOLERANCE * sigma[0]))
    return np.asarray(B @ Vt[rank:].T)


def states(scene: Scene, count: int, seed: int) -> States:
    """The start, then `count` random states. Each is moved in an admissible direction, and its joints are closed."""
    constraints, rng = Constraints(scene), np.random.default_rng(seed)
    starts = [_placed(scene, constraints, rng) for _ in range(count)]
    every = [scene, *(_moving(scene, start, constraints, rng) for start in starts)]
    return States(np.zeros(count + 1), *(np.array([getattr(one, name) for one in every])
                                         for name in ("x0", "R0", "v0", "w0")))


def posed(scene: Scene, at: States, k: int) -> Scene:
    """The scene with its bodies in the k-th state of `at`."""
    return started(scene, at.x[k], at.R[k], at.v[k], at.w[k])


def near(scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> Scene | None:
    """The scene in an admissible state close to a given one, (n, ...); None if its joints cannot be closed there."""
    try:
        return projected(scene, started(scene, x, R, v, w))
    except EntryError:
        return None


def _placed(scene: Scene, constraints: Constraints, rng: np.random.Generator) -> Scene:
    """The scene in a random pose near its start."""
    from scipy.spatial.transform import Rotation

    N = basis(scene, constraints, scene.x0, scene.R0)
    step = (N @ rng.normal(size=N.shape[1])).reshape(-1, 6)
    step *= rng.uniform(*TURN) / max(np.abs(step[:, :3]).max() / length(scene), np.abs(step[:, 3:]).max(),
                                     np.finfo(float).tiny)
    for _ in range(_HALVINGS):
        turned = scene.R0 @ Rotation.from_rotvec(step[:, 3:]).as_matrix()
        if (closed := near(scene, scene.x0 + step[:, :3], turned, scene.v0, scene.w0)) is not None:
            return closed
        step = step / 2
    return scene  # the bodies cannot move


def _moving(scene: Scene, placed: Scene, constraints: Constraints, rng: np.random.Generator) -> Scene:
    """The placed scene with the start's velocities plus random ones of their size, as joints and drives allow."""
    N = basis(scene, constraints, placed.x0, placed.R0)
    extra = (N @ rng.normal(size=N.shape[1])).reshape(-1, 6)
    L = length(scene)
    size = max(np.abs(scene.w0).max(initial=0.0), np.abs(scene.v0).max(initial=0.0) / L, 1.0)
    extra *= rng.uniform(0.5, 1.0) * size / max(np.abs(extra[:, 3:]).max(), np.abs(extra[:, :3]).max() / L,
                                                np.finfo(float).tiny)
    moving = near(scene, placed.x0, placed.R0, scene.v0 + extra[:, :3], scene.w0 + extra[:, 3:])
    return placed if moving is None else moving
