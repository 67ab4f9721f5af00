"""Frames that do not spin with a symmetric body: what cannot influence the motion is not integrated.

A body whose inertia is the same about every normal of an axis e, and whose joints, springs and loads all sit on that
axis, keeps its angular velocity Omega = e . w for ever. In the frame R' = R exp(-Omega t hat(e)) its equations are

    J dw'/dt + w' x (J w' + Omega J e) = torque,    w' = w - Omega e at the start,

those of a body with the constant angular momentum Omega J e inside it: exact, and free of the fast rotation. R and w
return to the body frame at the samples.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lieeuler import _kernel
from lieeuler.forces import ConstantLoad, SlideForce, TorsionalSpring
from lieeuler.problem import Problem

SYMMETRIC = 1e-12
"""Relative: a difference of moments of inertia, or a distance off the axis, that is rounding."""


@dataclasses.dataclass(frozen=True)
class SpinFreeFrames:
    """The bodies of a problem that are carried in a spin-free frame.

    Attributes
    ----------
    bodies : tuple of int
    axes : (k, 3)
        Unit axes of symmetry, body frame.
    rates : (k,)
        Omega, rad/s.
    kernel : Plan
        The problem with these bodies' spins.
    w : (n, 3)
        Initial angular velocities in the frames, rad/s.
    """

    bodies: tuple[int, ...]
    axes: np.ndarray
    rates: np.ndarray
    kernel: _kernel.Plan
    w: np.ndarray

    def restore(self, t: np.ndarray, R: np.ndarray, w: np.ndarray, alpha: np.ndarray | None = None) -> None:
        """Turn R (T, n, 3, 3), w and alpha (T, n, 3) of the frames into those of the bodies, in place; t in s."""
        for body, axis, rate in zip(self.bodies, self.axes, self.rates, strict=True):
            spin = rate * axis
            angles = rate * (t - t[:1])  # a run may end before its first sample
            hat = np.cross(axis, np.eye(3)).T
            sine, versine = np.sin(angles)[:, None, None], 2 * np.sin(0.5 * angles)[:, None, None] ** 2
            turn = np.eye(3) + sine * hat + versine * (hat @ hat)  # body to frame
            if alpha is not None:
                slope = alpha[:, body] - np.cross(spin, w[:, body])
                alpha[:, body] = np.einsum("tji,tj->ti", turn, slope)
            R[:, body] = R[:, body] @ turn
            w[:, body] = np.einsum("tji,tj->ti", turn, w[:, body]) + spin


def symmetric_bodies(problem: Problem) -> tuple[int, ...]:
    """The bodies that a spin-free frame would carry, should they spin."""
    return tuple(b for b in range(problem.n) if _axis(problem, b) is not None)


def spin_free_frames(problem: Problem) -> SpinFreeFrames | None:
    """The spin-free frames a problem allows, None where no body has one or none of them spins; found once."""
    known = vars(problem)
    if "_spin_free_frames" in known:
        frames: SpinFreeFrames | None = known["_spin_free_frames"]
        return frames
    found = {b: axis for b in range(problem.n) if (axis := _axis(problem, b)) is not None}
    rates = {b: float(axis @ problem.w[b]) for b, axis in found.items()}
    bodies = tuple(b for b in found if rates[b] != 0.0)
    frames = None
    if bodies:
        system, w = problem.new_system(), problem.w.copy()
        for b in bodies:
            w[b] -= rates[b] * found[b]
            system.set_spin(b, rates[b] * (problem.bodies[b].inertia @ found[b]))
        frames = SpinFreeFrames(bodies, np.array([found[b] for b in bodies]), np.array([rates[b] for b in bodies]),
                                _kernel.Plan(system), w)
    known["_spin_free_frames"] = frames
    return frames


def _axis(problem: Problem, body: int) -> np.ndarray | None:
    """The axis of symmetry that carries everything attached to the body, or None."""
    directions = _attached(problem, body)
    if directions is None:
        return None
    moments, vectors = np.linalg.eigh(problem.bodies[body].inertia)
    equal = np.diff(moments) <= SYMMETRIC * moments[2]
    if equal.all():  # a sphere: the axis is that of what is attached, or of its rotation
        candidates = [*directions, problem.w[body]]
        axis = next((c / np.linalg.norm(c) for c in candidates if np.linalg.norm(c) > 0), vectors[:, 0])
    elif equal.any():
        axis = vectors[:, 2] if equal[0] else vectors[:, 0]
    else:
        return None
    # Eigenvectors carry rounding that the unit vectors of most scenes do not have.
    nearest = np.zeros(3)
    nearest[np.argmax(np.abs(axis))] = np.sign(axis[np.argmax(np.abs(axis))])
    axis = nearest if np.abs(axis - nearest).max() < SYMMETRIC else axis
    off = [np.linalg.norm(np.cross(axis, d)) > SYMMETRIC * max(1.0, float(np.linalg.norm(d))) for d in directions]
    return None if any(off) else axis


def _attached(problem: Problem, body: int) -> list[np.ndarray] | None:
    """Anchors over the length of the system, axes and directions of loads, in the body's frame.

    None where something acts about every axis.
    """
    found = []
    length = problem.kernel.length
    for joint in problem.joints:
        for end, side in ((joint.parent, "parent"), (joint.child, "child")):
            if end != body:
                continue
            if joint.drive is not None or joint.rotors:
                return None
            found.append((joint.parent_anchor if side == "parent" else joint.child_anchor) / length)
            found += [axis for dot in joint.dots for carrier, axis in ((dot.a, dot.a_axis), (dot.b, dot.b_axis))
                      if carrier == side]
    for force in problem.forces:
        if body not in (force.parent, force.child):
            continue
        if isinstance(force, TorsionalSpring | SlideForce):
            return None
        if isinstance(force, ConstantLoad):
            if np.any(force.torque):
                return None
            found.append(force.point / length)
            if force.frame == "body" and np.any(force.force):
                found.append(force.force / np.linalg.norm(force.force))
        else:
            found.append((force.parent_point if force.parent == body else force.child_point) / length)
    return found
