"""Frames that do not spin with a symmetric body, so that its fast rotation need not be integrated.

Take a body whose inertia is the same about every normal of an axis e, and whose joints, springs and loads all act on
that axis. Its angular velocity Omega = e . w about e is constant. In the frame R' = R exp(-Omega t hat(e)) its
equations, (13.1) of docs/theory.md, are

    J dw'/dt + w' x (J w' + Omega J e) = torque,    w' = w - Omega e at the start,

those of a body with the constant angular momentum Omega J e inside it. They are exact, and the fast rotation is gone.
R and w are turned back to the body frame at the samples.
"""

from __future__ import annotations

import numpy as np

from lieeuler import _kernel
from lieeuler.forces import LinearSpring, SlideForce, TorsionalSpring
from lieeuler.problem import Problem, once
from lieeuler.reduced import Reduced
from lieeuler.types import GROUND

SYMMETRIC = 1e-12
"""Relative size below which a difference of moments of inertia, or a distance from the axis, is rounding."""


@once
def spin_free_frames(problem: Problem) -> Reduced | None:
    """The problem of spin-free frames, whose w are those in them and whose compiled system has the spins as constant
    angular momenta; None if no symmetric body spins."""
    rates = {b: (axis, rate) for b, axis in symmetric_bodies(problem).items() if (rate := float(axis @ problem.w[b]))}
    if not rates:
        return None
    system, spins = problem.new_system(), np.zeros((problem.n, 3))
    for b, (axis, rate) in rates.items():
        spins[b] = rate * axis
        system.set_spin(b, rate * (problem.bodies[b].inertia @ axis))
    framed = Problem.unchecked(problem, w=problem.w - spins)
    vars(framed)["kernel"] = _kernel.Plan(system)  # in place of that without spins
    frames = Reduced("spin-free", problem, spins=spins)
    frames.problem = framed
    return frames


def symmetric_bodies(problem: Problem) -> dict[int, np.ndarray]:
    """The bodies with an axis of symmetry on which everything attached to them acts, and that axis: if they spin, they
    are integrated in a spin-free frame."""
    attached = _attached(problem).items()
    return {body: axis for body, directions in attached if (axis := _axis(problem, body, directions)) is not None}


def _axis(problem: Problem, body: int, directions: list[np.ndarray]) -> np.ndarray | None:
    moments, vectors = np.linalg.eigh(problem.bodies[body].inertia)
    equal = np.diff(moments) <= SYMMETRIC * moments[2]
    if equal.all():  # a sphere: its axis is that of its attachments, or of its rotation
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


def _attached(problem: Problem) -> dict[int, list[np.ndarray]]:
    """Anchors over the length of the system, joint axes and directions of loads, in the frames of their bodies.

    A body is left out if something acts on it that no axis of symmetry allows.
    """
    found: dict[int, list[np.ndarray]] = {body: [] for body in range(GROUND, problem.n)}
    turned, length = {GROUND}, problem.kernel.length
    leaders = {joint.mimic.joint for joint in problem.joints if joint.mimic is not None}
    for index, joint in enumerate(problem.joints):
        for body, side, anchor in ((joint.parent, "parent", joint.parent_anchor),
                                   (joint.child, "child", joint.child_anchor)):
            found[body].append(anchor / length)
            found[body] += [axis for dot in joint.dots
                            for carrier, axis in ((dot.a, dot.a_axis), (dot.b, dot.b_axis)) if carrier == side]
        if any((joint.drive, joint.mimic, joint.contact, joint.rotors)) or index in leaders:
            turned |= {joint.parent, joint.child}
    for force in problem.forces:
        if isinstance(force, TorsionalSpring | SlideForce):
            turned |= {force.parent, force.child}
        elif isinstance(force, LinearSpring):
            found[force.parent].append(force.parent_point / length)
            found[force.child].append(force.child_point / length)
        elif np.any(force.torque):
            turned.add(force.child)
        else:
            found[force.child].append(force.point / length)
            if force.frame == "body" and np.any(force.force):
                found[force.child].append(force.force / np.linalg.norm(force.force))
    return {body: directions for body, directions in found.items() if body not in turned}
