"""Random trees in the coordinates of their joints move like the whole systems, and return all states."""

import dataclasses

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from tests.lieeuler.accuracy import largest_difference


class Growing:
    """A random tree, grown body by body with rates of its joints that are known.

    Every body, joint and force is unlike the others; the state closes all joints by construction.
    """

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.bodies, self.joints, self.forces = [], [], []
        self.x, self.R, self.v, self.w = [], [], [], []

    def vector(self, size=1.0):
        return self.random.normal(scale=size, size=3)

    def unit(self):
        a = self.vector()
        return a / np.linalg.norm(a)

    def frame(self, body):
        if body == -1:
            return np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3)
        return self.x[body], self.R[body], self.v[body], self.R[body] @ self.w[body]

    def add(self, kind, parent):
        child = len(self.bodies)
        x, R, v, w = self.frame(parent)
        R_child = Rotation.random(random_state=int(self.random.integers(2**31))).as_matrix()
        pa, ca, axis = self.vector(), self.vector(0.5), self.unit()  # the axis in the world
        slides, turns, extra = [], [], ()
        in_parent, in_child = R.T @ axis, R_child.T @ axis
        across = np.linalg.svd(axis[None])[2][1:]
        if kind == "spherical":
            joint, turns = lieeuler.spherical_joint(parent, child, pa, ca), list(np.eye(3))
        elif kind == "revolute":
            joint, turns = lieeuler.revolute_joint(parent, child, pa, ca, in_parent, in_child), [axis]
        elif kind == "universal":
            joint = lieeuler.universal_joint(parent, child, pa, ca, in_parent, R_child.T @ across[0])
            turns = [axis, across[0]]
        elif kind == "cylindrical":
            joint = lieeuler.cylindrical_joint(parent, child, pa, ca, in_parent, in_child)
            slides, turns = [axis], [axis]
        elif kind == "prismatic":
            joint = lieeuler.prismatic_joint(parent, child, pa, ca, in_parent, in_child, R_child.T @ R)
            slides = [axis]
        elif kind == "planar":
            joint = lieeuler.planar_joint(parent, child, pa, ca, in_parent, in_child)
            slides, turns = list(across), [axis]
        elif kind == "point_on_line":
            joint = lieeuler.point_on_line_joint(parent, child, pa, ca, in_parent)
            slides, turns = [axis], list(np.eye(3))
        else:
            joint = lieeuler.point_on_plane_joint(parent, child, pa, ca, in_parent)
            slides, turns = list(across), list(np.eye(3))
        if kind in ("revolute", "prismatic", "cylindrical") and self.random.random() < 0.5:
            extra = (lieeuler.Rotor(0.3, in_parent, in_child, kind != "prismatic"),)
        self.joints.append(dataclasses.replace(joint, rotors=extra))
        slid = sum((self.random.normal(scale=0.3) * a for a in slides), np.zeros(3))
        sliding = sum((self.random.normal() * a for a in slides), np.zeros(3))
        turning = sum((self.random.normal() * a for a in turns), np.zeros(3))
        anchor = x + R @ pa + slid
        w_child = w + turning
        self.x.append(anchor - R_child @ ca)
        self.R.append(R_child)
        self.v.append(v + np.cross(w, anchor - x) + sliding - np.cross(w_child, R_child @ ca))
        self.w.append(R_child.T @ w_child)
        a, b, c = self.random.uniform(0.05, 0.4, 3)
        P = Rotation.random(random_state=child).as_matrix()
        inertia = P @ np.diag([a + b, b + c, c + a]) @ P.T
        self.bodies.append(lieeuler.Body(self.random.uniform(0.5, 3.0), (inertia + inertia.T) / 2))
        if kind == "revolute":
            self.forces.append(lieeuler.TorsionalSpring(parent, child, in_parent, in_child, 2.0, 0.7, 0.1, torque=0.5))
        if kind == "prismatic":
            self.forces.append(lieeuler.SlideForce(parent, child, pa, ca, in_parent, 3.0))
        self.forces.append(lieeuler.LinearSpring(-1, child, self.vector(3.0), self.vector(0.2), 5.0, 1.0, 0.2))
        self.forces.append(lieeuler.ConstantLoad(child, self.vector(), self.vector(), self.vector(0.3), "body"))

    def problem(self):
        return lieeuler.Problem(self.bodies, self.joints, self.vector(6.0), self.x, self.R, self.v, self.w, self.forces)


KINDS = ("spherical", "revolute", "universal", "cylindrical", "prismatic", "planar", "point_on_line", "point_on_plane")


def grown(seed):
    tree = Growing(seed)
    for child in range(tree.random.integers(2, 6)):
        tree.add(KINDS[(seed + 3 * child) % len(KINDS)], int(tree.random.integers(-1, child)) if child else -1)
    return tree.problem()


@pytest.mark.parametrize("seed", range(24))
def test_random_trees_move_alike(seed):
    """All joints, at the ground and behind each other, with rotors, springs, drives of constant size and loads."""
    problem = grown(seed)
    times = [0.0, 0.05, 0.11, 0.3]
    off, on = (lieeuler.integrate(problem, "rkmk853", t_eval=times, rtol=1e-12, reduce=word)
               for word in ("off", "joints"))
    assert largest_difference(off, on) < 1e-9


def test_hinges_wind_up():
    """Ten turns of a hinge behind a slide, against a spring that counts them."""
    tree = Growing(5)
    tree.add("prismatic", -1)
    tree.add("revolute", 0)
    problem = tree.problem()
    spring = next(force for force in problem.forces if isinstance(force, lieeuler.TorsionalSpring))
    world = problem.R[1] @ spring.child_axis
    spin = 60.0 * world
    w = problem.w.copy()
    w[1] += problem.R[1].T @ spin
    v = problem.v.copy()
    v[1] += np.cross(spin, -problem.R[1] @ problem.joints[1].child_anchor)
    fast = dataclasses.replace(problem, v=v, w=w)
    off, on = (lieeuler.integrate(fast, "rkmk853", t_eval=np.linspace(0, 1.2, 5), rtol=1e-13, reduce=word)
               for word in ("off", "joints"))
    assert largest_difference(off, on) < 1e-9


def test_attitudes_stay_rotations_over_many_turns():
    """A wheel without weight on a hinge at the end of a slide: 50 000 turns at a constant rate. What is left is the
    rounding of the tableau's weights, the same in the coordinates of the bodies."""
    z, still = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    bodies = [lieeuler.Body(2.0, np.eye(3)), lieeuler.Body(1.0, np.diag([0.1, 0.12, 0.15]))]
    joints = [lieeuler.prismatic_joint(-1, 0, still, still, [1, 0, 0], [1, 0, 0], np.eye(3)),
              lieeuler.revolute_joint(0, 1, still, still, z, z)]
    wheel = lieeuler.Problem(bodies, joints, still, np.zeros((2, 3)), [np.eye(3)] * 2, np.zeros((2, 3)),
                             [still, 100.0 * z])
    truth = [float(mpmath.cos(314100)), float(mpmath.sin(314100))]
    off, on = (lieeuler.integrate(wheel, "rkmk4", 1 / 32, [0.0, 3141.0], reduce=word, monitor=False).R[-1, 1]
               for word in ("off", "joints"))
    assert np.abs(on[:2, 0] - truth).max() < 1.1 * np.abs(off[:2, 0] - truth).max() < 1e-10
    assert np.abs(on.T @ on - np.eye(3)).max() < 1e-15
