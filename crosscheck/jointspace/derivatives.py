"""Derivatives of accelerations at a state: truth, and those of engines.

Truth is a complex step through the articulated formulation, compared with central differences of order eight of the
index-1 equations. Trees have da/dq, da/dv and da/dtau in the coordinates of `scene.coordinates`; every scene has the
generator of its linearised flow on the tangent space of its constraints.
"""

from __future__ import annotations

import dataclasses
import os

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.jointspace.laws import smooth
from crosscheck.jointspace.motion import NONE, Bodies, JointSpace, TreeSpace, checked, of_coordinates, placed, responses
from crosscheck.jointspace.sources import allowed, condition, taken
from crosscheck.references.base import TruthError
from crosscheck.scene import file as scene_file
from crosscheck.scene.mechanics import index1
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.scene.vectors import exponential

AGREED = 1e-8
"""Largest relative difference of the two routes of truth; what it is counts as the error of the truth."""

DIFFERENCE = 5e-3
"""Step of the second route, rad or m and per second. Its truncation is 1e-18 times a ninth derivative."""

WEIGHTS = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
"""Of the central difference of order eight, by multiples of the step."""


@dataclasses.dataclass(frozen=True)
class Derivatives:
    """Derivatives of the acceleration of a scene at a state.

    Attributes
    ----------
    coordinates : names, in the order of the rows and columns.
    da_dq, da_dv, da_dtau : (n, n) of trees in joint coordinates, else None; da_dq is taken at fixed rates.
    error : what truth claims, relative to the largest entry; of a source, its rounding or what it documents.
    matrix : (2k, 2k), the generator of the linearised flow: its rows are the rates of (change of pose, change of
        velocity) in `basis`. None where a source has only the blocks.
    basis : (6n, k), orthonormal; per body a shift in the world and a small turn in body axes, the directions in which
        the joints let the bodies move.
    """

    scene: str
    source: str
    coordinates: tuple[str, ...]
    da_dq: np.ndarray | None
    da_dv: np.ndarray | None
    da_dtau: np.ndarray | None
    error: float
    matrix: np.ndarray | None = None
    basis: np.ndarray | None = None

    @property
    def blocks(self) -> dict[str, np.ndarray]:
        """The derivatives that there are, by name."""
        named = {"da_dq": self.da_dq, "da_dv": self.da_dv, "da_dtau": self.da_dtau, "matrix": self.matrix}
        return {name: values for name, values in named.items() if values is not None}


def derivatives(scene: Scene | str | os.PathLike[str], source: object = "truth", state: object = None) -> Derivatives:
    """Derivatives of the acceleration at the start of a scene, or at a given state.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    source : "truth"; an engine, "engine:way", where ways are listed by `crosscheck linearise`; or an object or
        "module:Class" of an own engine that has `derivatives(scene, state)`
    state : (q, v), (n,) each in the order of `scene.coordinates`; None: the start

    Raises
    ------
    ArgumentError, SceneError
        An argument is wrong.
    Unsupported
        The scene or the source has no such derivatives, or a law changes at just this state; the message says why.
    TruthError
        The two routes of the truth differ by more than 1e-8.
    """
    loaded = scene_file.as_scene(scene)
    if state is not None:
        wanted = f"state: give (q, v), {len(loaded.coordinates)} numbers each"
        loaded = placed(loaded, *checked(loaded, wanted, state, 2))
    loaded = smooth(loaded)
    if source == "truth":
        return truth(loaded)
    return of(loaded, source)


def of(scene: Scene, source: object) -> Derivatives:
    """The derivatives of a source at the start of the scene."""
    label, blocks = taken(scene, source)
    size = max(float(np.abs(part).max(initial=1.0)) for part in (blocks.da_dq, blocks.da_dv))
    space = JointSpace(scene)
    bound = allowed(blocks, size, condition(space.mass), float(np.abs(space.rates).max(initial=0.0)))
    return Derivatives(scene.name, label, scene.coordinates, blocks.da_dq, blocks.da_dv, blocks.da_dtau, bound)


def truth(scene: Scene) -> Derivatives:
    """See `derivatives`."""
    da_dq = da_dv = da_dtau = None
    try:
        space: TreeSpace = JointSpace(scene)
    except Unsupported:
        space = TreeSpace(scene)
    matrix, basis, gap = generator(space)
    if isinstance(space, JointSpace):
        da_dq, da_dv = space.derivative(space.accelerations)
        da_dtau = np.linalg.inv(space.mass)
    if not gap <= AGREED:
        raise TruthError(f"derivatives of {scene.name!r}: the two routes of the truth differ by {gap:.1e}")
    return Derivatives(scene.name, "truth", scene.coordinates, da_dq, da_dv, da_dtau, max(gap, 1e-13), matrix,
                       basis)


def generator(space: TreeSpace) -> tuple[np.ndarray, np.ndarray, float]:
    """The matrix and the basis of `Derivatives`, and the relative difference of the two routes."""
    tangent, flow, _ = linearised(space)
    poses = tangent[:6 * space.scene.n]
    U, sizes, _ = np.linalg.svd(poses)
    basis = U[:, :int(np.count_nonzero(sizes > NONE * sizes[0]))] if sizes.size and sizes[0] else poses[:, :0]
    k = basis.shape[1]
    both = np.kron(np.eye(2), basis)
    made = both.T @ flow @ np.linalg.pinv(both.T @ tangent)
    other = both.T @ differences(space.scene, tangent @ np.linalg.pinv(both.T @ tangent))
    return made, basis, float(np.abs(made - other).max(initial=0.0) / np.abs(made).max(initial=1.0)) if k else 0.0


def linearised(space: TreeSpace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Admissible changes of the states of all bodies, (12n, m), their rates of change, and those changes in the
    coordinates of the tree, (2 size, m).

    A change has shifts in the world, small turns in body axes, then the changes of v and w, per body.
    """
    n, w, R = space.scene.n, np.real(space.start.w), np.real(space.start.R)
    names = ("x", "R", "v", "w", "a", "alpha", "values", "slopes")

    def states(bodies: Bodies) -> np.ndarray:
        return np.concatenate([np.ravel(getattr(bodies, name)) for name in names])

    ends = np.cumsum([getattr(space.start, name).size for name in names])[:-1]
    # By the coordinates of the tree, also of a `JointSpace`, whose own derivative is by those of its scene.
    *parts, values, slopes = np.split(np.concatenate(TreeSpace.derivative(space, states), axis=1), ends)
    x, turned, v, dw, a, alpha = (part.reshape(n, len(part) // n, -1) for part in parts)
    turns = np.einsum("nji,njkm->nikm", R, turned.reshape(n, 3, 3, -1))
    turn = np.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], axis=1)
    spread = np.einsum("nij,njm->nim", -np.cross(w[:, None], np.eye(3)).transpose(0, 2, 1), turn)  # -w x turn
    changes, rates = (np.concatenate([np.concatenate(pair, axis=1).reshape(6 * n, -1) for pair in pairs])
                      for pairs in (((x, turn), (v, dw)), ((v, dw + spread), (a, alpha))))
    rows = np.concatenate([values, slopes, _ties(space)])
    free = np.eye(2 * space.size)
    if len(rows):
        _, sizes, V = np.linalg.svd(rows)
        free = V[int(np.count_nonzero(sizes > NONE * sizes[0])):].T
    return changes @ free, rates @ free, free


@dataclasses.dataclass(frozen=True)
class Tangent:
    """m directions along which a scene can move, loops closed: a basis of the tangent space of its constraints.

    Attributes
    ----------
    changes : (12n, m) of the states of all bodies, see `linearised`.
    q, v, a : (n, m) changes of the coordinates of the scene, of their rates and of their accelerations.
    """

    changes: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


def tangent_space(scene: Scene) -> Tangent:
    """The directions, and what truth says about each."""
    space = TreeSpace(scene)
    changes, _, free = linearised(space)
    pose = np.moveaxis(changes.reshape(2, scene.n, 6, -1)[0], 2, 0)
    x, R = (np.broadcast_to(each, (len(pose), *each.shape)) for each in (scene.x0, scene.R0))

    v, a = (np.concatenate(space.derivative(lambda bodies, later=later: responses(  # type: ignore[misc]
        scene, bodies.states, later)[0]), axis=1) @ free for later in (False, True))
    q = of_coordinates(scene, States(np.zeros(len(pose)), x, R, pose[..., :3], pose[..., 3:])).T
    return Tangent(changes, q, v, a)


def _ties(space: TreeSpace) -> np.ndarray:
    """Rows of what keeps coordinates of the tree together, and of driven ones, which do not change."""
    ties = [*space.equations.ties, *({body: [1.0]} for body in space.equations.driven)]
    rows = np.zeros((len(ties), space.size))
    for row, tie in zip(rows, ties, strict=True):
        for body, factors in tie.items():
            row[space.slots[body]] = factors
    return np.kron(np.eye(2), rows)


def differences(scene: Scene, directions: np.ndarray) -> np.ndarray:
    """Rates of change of the states of all bodies, (12n, m), by central differences of the index-1 equations.

    `directions` (12n, m) as in `linearised`. Straight steps along them open the rows by the square of the step, which
    has no first derivative; the first state is the start, whose rank is that of the rows.
    """
    n, none = scene.n, np.zeros((1, 12 * scene.n))
    sizes, weights = np.array([(sign * k, sign * weight) for k, weight in WEIGHTS for sign in (1.0, -1.0)]).T
    moved = np.concatenate([none, *(DIFFERENCE * size * directions.T for size in sizes)])
    pose, speed = np.moveaxis(moved.reshape(-1, 2, n, 6), 1, 0)
    v, w = scene.v0 + speed[..., :3], scene.w0 + speed[..., 3:]
    a, alpha, _ = index1(scene, scene.x0 + pose[..., :3], scene.R0 @ exponential(pose[..., 3:]), v, w)
    rates = np.stack([np.concatenate(pair, axis=2) for pair in ((v, w), (a, alpha))], axis=1)
    total: np.ndarray = np.einsum("s,smk->km", weights / DIFFERENCE, rates[1:].reshape(
        len(weights), directions.shape[1], -1))
    turn = directions.reshape(2, n, 6, -1)[0, :, 3:]
    total.reshape(2, n, 6, -1)[0, :, 3:] -= np.cross(scene.w0[:, :, None], turn, axis=1)
    return total
