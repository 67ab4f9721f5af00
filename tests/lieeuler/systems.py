"""The pendulums of ENGINES (scenes A and B) and the heavy top (C), built directly as problems."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import lieeuler

GRAVITY = np.array([0.0, 0.0, -9.81])
INERTIA = np.diag([0.1, 0.2, 0.15])
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
TILT_Y = Rotation.from_euler("y", 60, degrees=True).as_matrix()
TILT_X = Rotation.from_euler("x", 40, degrees=True).as_matrix()


def chain(masses, inertias, anchors, attitudes, rates):
    """Bodies hung one below the other; anchors: (on the parent or ground, on the child) from the centres of mass."""
    x, v = [], []
    for k, ((above, below), R, w) in enumerate(zip(anchors, attitudes, rates, strict=True)):
        joint, speed = (np.array(above, float), np.zeros(3)) if k == 0 else (
            x[-1] + attitudes[k - 1] @ above, v[-1] + attitudes[k - 1] @ np.cross(rates[k - 1], above))
        x.append(joint - R @ below)
        v.append(speed - R @ np.cross(w, below))
    bodies = [lieeuler.Body(m, J) for m, J in zip(masses, inertias, strict=True)]
    joints = [lieeuler.spherical_joint(k - 1, k, above, below) for k, (above, below) in enumerate(anchors)]
    return lieeuler.Problem(bodies, joints, GRAVITY, np.array(x), np.array(attitudes), np.array(v), np.array(rates))


def single_pendulum():
    return chain([1.0], [INERTIA], [(np.zeros(3), UP)], [TILT_Y], [np.array([0.5, 0.3, 1.0])])


def double_pendulum():
    return chain([1.0, 1.0], [INERTIA, INERTIA], [(np.zeros(3), UP), (DOWN, UP)], [TILT_Y, TILT_X],
                 [np.array([0.5, 0.3, 1.0]), np.array([-0.3, 0.4, 0.2])])


def heavy_top():
    return chain([15.0], [np.diag([0.234375, 0.46875, 0.234375])], [(np.zeros(3), np.array([0.0, -1.0, 0.0]))],
                 [np.eye(3)], [np.array([0.0, 150.0, -4.61538])])


def spring_chain(n, damping=0.1):
    """n bodies hung sideways one below the other, the last on a spring to the ground."""
    rates = [np.zeros(3)] * n
    p = chain([1.0] * n, [INERTIA] * n, [(np.zeros(3), UP)] + [(DOWN, UP)] * (n - 1), [TILT_Y] * n, rates)
    spring = lieeuler.LinearSpring(lieeuler.types.GROUND, n - 1, p.x[-1] + [0, 0, 1.0], np.zeros(3), 10.0, 0.5, damping)
    return lieeuler.Problem(p.bodies, p.joints, p.gravity, p.x, p.R, p.v, p.w, (spring,))


def hung_by_both_ends(n):
    """n bodies in a zigzag, the first and the last on ball joints to the ground."""
    p = chain([1.0] * n, [INERTIA] * n, [(np.zeros(3), UP)] + [(DOWN, UP)] * (n - 1), ([TILT_Y, TILT_X] * n)[:n],
              [np.zeros(3)] * n)
    last = lieeuler.spherical_joint(lieeuler.types.GROUND, n - 1, p.x[-1] + p.R[-1] @ DOWN, DOWN)
    return lieeuler.Problem(p.bodies, (*p.joints, last), p.gravity, p.x, p.R, p.v, p.w)


SYSTEMS = {"single_pendulum": single_pendulum, "double_pendulum": double_pendulum, "heavy_top": heavy_top}
