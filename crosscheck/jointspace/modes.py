"""Modes: eigenvalues and shapes of small motions about an equilibrium or a steady motion.

The linearised equations have constant coefficients where the motion is steady. They are written in the coordinates of
the spanning tree, with the small turn of a body that is symmetric about an axis in axes that do not spin with it, and
restricted to what joints, loops and rolling allow. A cyclic coordinate, such as where a bicycle is on its plane, gives
eigenvalues of zero.
"""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, Unsupported
from crosscheck.jointspace.derivatives import linearised
from crosscheck.jointspace.laws import smooth
from crosscheck.jointspace.motion import NONE, TreeSpace
from crosscheck.references.tree import FREE
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene, quaternion_from_rotation, quaternion_product
from crosscheck.scene.starts import started
from crosscheck.scene.vectors import exponential

LATER = 0.37
"""s after the start, at which the coefficients have to be the same: no multiple of a period of a round number."""

NULL = 1e-11
"""Singular values below this part of the largest coefficient are those of cyclic coordinates."""

ALIKE = 1e-6
"""Relative difference of coefficients that rounding may make."""


@dataclasses.dataclass(frozen=True)
class Modes:
    """Small motions about the start of a scene, sorted by growth.

    Attributes
    ----------
    eigenvalues : (m,) complex, 1/s; the real part is the growth, the imaginary one the angular frequency.
    shapes : (6n, m) complex, unit columns; per body a shift in the world and a small turn in body axes.
    """

    scene: str
    eigenvalues: np.ndarray
    shapes: np.ndarray


def modes(scene: Scene | str | os.PathLike[str]) -> Modes:
    """The modes of a scene about its start.

    Raises
    ------
    SceneError
        As `crosscheck.load_scene`.
    Unsupported
        The start is neither an equilibrium nor a steady motion, or a law changes there.
    """
    loaded = smooth(scene_file.as_scene(scene))
    space = TreeSpace(loaded)
    tangent, _, free = linearised(space)
    A = _coefficients(space)
    _check_steady(space, A)
    values, vectors = _eigen(free.T @ A @ free)
    order = np.lexsort((-values.imag, -values.real.round(12)))
    shapes = tangent[:6 * loaded.n] @ vectors[:, order]
    sizes = np.linalg.norm(shapes, axis=0)
    return Modes(loaded.name, values[order], shapes / np.where(sizes > 0, sizes, 1.0))


def at_speed(scene: Scene, speed: float) -> Scene:
    """The scene with all velocities multiplied so that the first body's centre of mass has this speed (m/s)."""
    now = float(np.linalg.norm(scene.v0[0]))
    if now == 0.0:
        raise ArgumentError(f"speed: the first body of scene {scene.name!r} is at rest")
    return started(scene, scene.x0, scene.R0, speed / now * scene.v0, speed / now * scene.w0)


def _eigen(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and vectors; those of zero are split off first, because their chains cost others half of the digits.

    A chain is a place that grows with a constant speed, say; its vectors are those of its links.
    """
    rest, lift, zeros = A, np.eye(len(A)), []
    while len(rest):
        _, sizes, V = np.linalg.svd(rest)
        rank = int(np.count_nonzero(sizes > NULL * max(1.0, float(np.abs(A).max()))))
        if rank == len(rest):
            break
        zeros.append(lift @ V[rank:].T)
        rest, lift = V[:rank] @ rest @ V[:rank].T, lift @ V[:rank].T
    values = np.linalg.eigvals(rest)
    vectors = [np.linalg.svd(A - value * np.eye(len(A)))[2][-1].conj() for value in values]
    count = len(A) - len(values)
    return (np.concatenate([values, np.zeros(count)]).astype(complex),
            np.concatenate([np.array(vectors).reshape(-1, len(A)).T, *zeros], axis=1))


def _coefficients(space: TreeSpace) -> np.ndarray:
    """(2 size, 2 size) of the changes of coordinates and speeds, before any restriction."""
    size = space.size
    A = np.zeros((2 * size, 2 * size))
    A[size:, :size], A[size:, size:] = space.derivative(lambda bodies: bodies.rates)
    A[:size, size:] = np.eye(size)
    for link in space.links:
        own = space.slots[link.body]
        if link.turn == FREE:
            turn = slice(own.start, own.start + 3)
            hat = -np.cross(space.speeds[turn], np.eye(3)).T
            spin = _spin(space, link)
            A[turn, turn] += hat + spin
            A[size + turn.start:size + turn.stop, size + turn.start:size + turn.stop] += spin
    return A


def _spin(space: TreeSpace, link: Any) -> np.ndarray:
    """The matrix of s e x (.), by which axes that do not spin with a symmetric body turn against its own.

    They turn as the body does, but about the direction of gravity only.
    """
    own = space.slots[link.body]
    w = space.speeds[own.start:own.start + 3]
    e = symmetry(np.array(link.inertia))
    if e is None or not np.any(w):
        return np.zeros((3, 3))
    down = np.real(space.start.R[link.body]).T @ space.scene.gravity
    across = np.cross(e, down)
    upright = np.linalg.norm(across) <= NONE * max(1.0, float(np.linalg.norm(down)))
    rate = float(w @ e) if upright else float(np.cross(w, down) @ across / (across @ across))
    return rate * np.cross(e, np.eye(3)).T


def symmetry(inertia: np.ndarray) -> np.ndarray | None:
    """The axis about which two principal moments are equal, or None."""
    moments, axes = np.linalg.eigh(inertia)
    for k in range(3):
        one, other = (moments[j] for j in range(3) if j != k)
        if abs(one - other) <= NONE * moments[2]:
            return np.asarray(axes[:, k])
    return None


def _check_steady(space: TreeSpace, A: np.ndarray) -> None:
    """Raise unless speeds and coefficients do not change."""
    scene, size = space.scene, space.size
    if scene.timed:
        raise Unsupported(f"modes of {scene.name!r}: its forces or drives depend on time")
    rates = np.real(space.start.rates)
    later, speeds, turned, axes = np.zeros(size), space.speeds.copy(), {}, np.eye(size)
    for link in space.links:
        own = space.slots[link.body]
        if link.turn == FREE:
            turn = slice(own.start, own.start + 3)
            w, spin = space.speeds[turn], _spin(space, link)
            along = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            rates[turn] += spin @ w
            down = scene.R0[link.body].T @ scene.gravity
            if np.abs(np.cross(w - along, down)).max() > NONE * max(1.0, np.abs(w).max() * np.abs(down).max()):
                raise Unsupported(f"modes of {scene.name!r}: the start is no steady motion, body "
                                  f"{scene.bodies[link.body].name!r} turns against gravity")
            axes[turn, turn] = exponential(LATER * along)
            turned[link.body] = exponential(LATER * (w - along)) @ axes[turn, turn]
            speeds[turn] = axes[turn, turn].T @ w
            own = slice(own.start + 3, own.stop)
        later[own] = LATER * space.speeds[own]
    limit = NONE * max(1.0, float(np.linalg.norm(scene.gravity)), float(np.abs(space.speeds).max(initial=0.0)) ** 2)
    if np.abs(rates).max(initial=0.0) > limit:
        raise Unsupported(f"modes of {scene.name!r}: the start is neither an equilibrium nor a steady motion, a "
                          f"coordinate accelerates by {np.abs(rates).max():.2g} (SI)")
    if np.any(space.speeds):
        moved = TreeSpace(scene)
        state = np.real(np.array(space.state(later, speeds)))
        for body, rotation in turned.items():
            first = space.equations.tree.coordinates[body].start
            state[first:first + 4] = quaternion_product(scene.bodies[body].attitude, quaternion_from_rotation(rotation))
        moved.equations.initial[:] = state
        both = np.kron(np.eye(2), axes)
        change = both @ _coefficients(moved) @ both.T - A
        if np.abs(change).max() > ALIKE * np.abs(A).max():
            raise Unsupported(f"modes of {scene.name!r}: the start is no steady motion, its linearised equations "
                              "change with time")
