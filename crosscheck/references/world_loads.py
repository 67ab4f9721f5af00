"""Springs, dampers and constant loads of the maximal formulation: forces in world axes, torques in body axes.

A torque that is rotated from world to body axes would have a rounding error about the thin axis of a needle, where no
torque acts; cross products of exact vectors in body axes have none.

The angle of a torsional spring is an additional state, integrated from the relative rate about the axis, and so
continuous over any number of turns.
"""

from __future__ import annotations

import numpy as np

from crosscheck.references.world import Motion, cross, turned
from crosscheck.scene.coordinates import angle_from
from crosscheck.scene.functions import at
from crosscheck.scene.model import Force, Scene
from crosscheck.scene.vectors import shortest_rotation

AT_CENTRE = np.zeros(3)


class LinearSpring:
    """Force k (L - free length) + c dL/dt that pulls two points towards each other."""

    def __init__(self, force: Force) -> None:
        p = force.parameters
        self.ends = np.array([force.parent, force.child])  # the ground, -1, is the last entry
        self.points = np.array([p["parent_point"], p["child_point"]])
        self.stiffness, self.free_length, self.damping = p["stiffness"], p["free_length"], p["damping"]

    def add(self, motion: Motion, force: np.ndarray, torque: np.ndarray) -> None:
        """Add to forces (world axes) and torques about the centres of mass (body axes), (n + 1, 3) each."""
        levers = turned(motion.R[self.ends], self.points)
        parent, child = motion.x[self.ends] + levers
        parent_rate, child_rate = motion.v[self.ends] + cross(motion.omega[self.ends], levers)
        length = float(np.linalg.norm(child - parent))
        if length == 0.0:  # without a direction there is no force
            return
        along = (child - parent) / length
        pull = spring_pull(self.stiffness, length - self.free_length, self.damping,
                           along @ (child_rate - parent_rate))
        for end, sign in ((0, 1.0), (1, -1.0)):
            force[self.ends[end]] += sign * pull * along
            torque[self.ends[end]] += sign * pull * cross(self.points[end:end + 1],
                                                          (along @ motion.R[self.ends[end]])[None])[0]


class TorsionalSpring:
    """Torque -(k (angle - rest angle) + c d angle/dt) about a joint's axis on its child, the opposite on the parent."""

    def __init__(self, force: Force, scene: Scene) -> None:
        p = force.parameters
        joint = next(joint for joint in scene.joints if joint.name == force.joint)
        self.parent, self.child, self.axis = joint.parent, joint.child, joint.parent_axis
        self.stiffness, self.rest_angle, self.damping = p["stiffness"], p["rest_angle"], p["damping"]
        frames = [scene.R0[body] if body >= 0 else np.eye(3) for body in (joint.parent, joint.child)]
        zero = shortest_rotation(joint.child_axis, joint.parent_axis)
        self.start = float(angle_from(zero, joint.parent_axis, frames[0].T @ frames[1]))
        if joint.start is not None:
            begin = joint.start[0] + joint.zero_angle
            self.start += 2 * np.pi * float(np.round((begin - self.start) / (2 * np.pi)))

    def rate(self, motion: Motion) -> float:
        """d angle/dt."""
        turning: float = motion.R[self.parent] @ self.axis @ (motion.omega[self.child] - motion.omega[self.parent])
        return turning

    def add(self, motion: Motion, angle: float, torque: np.ndarray) -> None:
        """Add to the torques (n + 1, 3)."""
        size = torsion(self.stiffness, angle - at(self.rest_angle, motion.t), self.damping, self.rate(motion))
        torque[self.child] += size * (motion.R[self.parent] @ self.axis @ motion.R[self.child])
        torque[self.parent] -= size * self.axis


class SlideSpring:
    """Force -(k (slide - rest position) + c d slide/dt) along a joint's axis on its child, the opposite on the parent.

    Both anchors, at which it acts, lie on the axis.
    """

    def __init__(self, force: Force, scene: Scene) -> None:
        p = force.parameters
        self.joint = next(joint for joint in scene.joints if joint.name == force.joint)
        self.ends = np.array([self.joint.parent, self.joint.child])
        self.points = np.array([self.joint.parent_anchor, self.joint.child_anchor])
        self.stiffness, self.rest, self.damping = p["stiffness"], p["rest_position"], p["damping"]

    def add(self, motion: Motion, force: np.ndarray, torque: np.ndarray) -> None:
        """Add to forces (world axes) and torques about the centres of mass (body axes), (n + 1, 3) each."""
        levers = turned(motion.R[self.ends], self.points)
        axis = motion.R[self.joint.parent] @ self.joint.parent_axis
        places = motion.x[self.ends] + levers
        rates = motion.v[self.ends] + cross(motion.omega[self.ends], levers)
        pull = spring_pull(self.stiffness, axis @ (places[1] - places[0]) - self.rest, self.damping,
                           axis @ (rates[1] - rates[0]))
        for end, sign in ((0, pull), (1, -pull)):
            force[self.ends[end]] += sign * axis
            torque[self.ends[end]] += sign * np.cross(self.points[end], axis @ motion.R[self.ends[end]])


class ConstantLoad:
    """A force at a point of a body, or a torque on it, constant in world or body axes, times a factor."""

    def __init__(self, force: Force) -> None:
        p = force.parameters
        self.body, self.in_body, self.turns = force.child, p["frame"] == "body", force.type == "constant_torque"
        self.vector = np.array(p["torque" if self.turns else "force"])
        self.point = np.array(p.get("child_point", AT_CENTRE))
        self.factor = p.get("factor", 1.0)

    def add(self, motion: Motion, force: np.ndarray, torque: np.ndarray) -> None:
        """Add to forces (world axes) and torques about the centres of mass (body axes), (n + 1, 3) each."""
        R, vector = motion.R[self.body], at(self.factor, motion.t) * self.vector
        own = vector if self.in_body else vector @ R
        if self.turns:
            torque[self.body] += own
        else:
            force[self.body] += R @ vector if self.in_body else vector
            torque[self.body] += cross(self.point[None], own[None])[0]


class JointLoad:
    """A torque about a joint's axis on its child, or a force along it; the opposite on the parent.

    The line of the force is the axis, on which both anchors lie.
    """

    def __init__(self, force: Force, scene: Scene) -> None:
        self.joint = next(joint for joint in scene.joints if joint.name == force.joint)
        self.turns = force.type == "joint_torque"
        self.size = force.parameters["torque" if self.turns else "force"]

    def add(self, motion: Motion, force: np.ndarray, torque: np.ndarray) -> None:
        """Add to forces (world axes) and torques about the centres of mass (body axes), (n + 1, 3) each."""
        joint, size = self.joint, at(self.size, motion.t)
        axis = motion.R[joint.parent] @ joint.parent_axis
        for body, anchor, sign in ((joint.child, joint.child_anchor, size), (joint.parent, joint.parent_anchor, -size)):
            if self.turns:
                torque[body] += sign * (axis @ motion.R[body])
            else:
                force[body] += sign * axis
                torque[body] += sign * np.cross(anchor, axis @ motion.R[body])


def spring_pull(stiffness: float, extension: float, damping: float, rate: float) -> float:
    """Tension of a linear spring-damper."""
    return stiffness * extension + damping * rate


def torsion(stiffness: float, twist: float, damping: float, rate: float) -> float:
    """Torque of a torsional spring-damper on the child."""
    return -(stiffness * twist + damping * rate)
