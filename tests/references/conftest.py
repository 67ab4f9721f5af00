"""Scenes for the reference tests, built in code: a tree of spherical joints from a few numbers a body."""

import numpy as np
import pytest

from crosscheck.scene.model import GROUND, Body, Joint, Scene, rotation_from_quaternion

J = np.diag([0.1, 0.2, 0.15])


def make_tree(bodies, joints=(), gravity=(0.0, 0.0, -9.81), duration=1.0, samples=11, name="tree"):
    """bodies: (mass, inertia, quaternion, body angular velocity); joints: (parent, child, parent and child anchor).

    Jointed bodies get the position and velocity the joints determine; a free root starts at the origin, moving.
    """
    quaternions = [np.array(body[2], float) / np.linalg.norm(body[2]) for body in bodies]
    R = rotation_from_quaternion(np.array(quaternions))
    x, v = np.zeros((len(bodies), 3)), np.tile([0.3, -0.2, 0.5], (len(bodies), 1))
    for parent, child, here, there in joints:
        point, velocity = np.array(here, float), np.zeros(3)
        if parent != GROUND:
            point, velocity = x[parent] + R[parent] @ here, v[parent] + R[parent] @ np.cross(bodies[parent][3], here)
        x[child] = point - R[child] @ there
        v[child] = velocity - R[child] @ np.cross(bodies[child][3], there)
    return Scene(
        name,
        tuple(Body(f"body{i}", mass, inertia, quaternions[i], w, x[i], v[i])
              for i, (mass, inertia, _, w) in enumerate(bodies)),
        tuple(Joint(f"joint{k}", "spherical", parent, child, here, there)
              for k, (parent, child, here, there) in enumerate(joints)),
        (), gravity, duration, samples)


@pytest.fixture(scope="session")
def build():
    """`make_tree`, for scenes of a test's own."""
    return make_tree


TILTED = [np.cos(np.pi / 6), 0.0, np.sin(np.pi / 6), 0.0]
ROLLED = [np.cos(np.pi / 9), np.sin(np.pi / 9), 0.0, 0.0]
TOP = (15.0, np.diag([0.234375, 0.46875, 0.234375]), [1, 0, 0, 0], [0.0, 150.0, -4.61538])
UPPER, LOWER = (1.0, J, TILTED, [0.5, 0.3, 1.0]), (1.0, J, ROLLED, [-0.3, 0.4, 0.2])
THIRD = (0.7, np.diag([0.1, 0.06, 0.12]), [0.9, 0.1, -0.3, 0.2], [1.0, -0.6, 0.4])
PIVOT, ELBOW = (GROUND, 0, [0, 0, 0], [0, 0, 1]), (0, 1, [0, 0, -1], [0, 0, 1])

TREES = {
    "single": ([UPPER], [PIVOT]),
    "double": ([UPPER, LOWER], [PIVOT, ELBOW]),
    "top": ([TOP], [(GROUND, 0, [0, 0, 0], [0, -1, 0])]),
    "branching": ([UPPER, LOWER, THIRD],
                  [PIVOT, (0, 1, [0.3, 0.1, -1], [0, 0.2, 1]), (0, 2, [-0.4, 0, -0.8], [0, 0, 0.5])]),
    "two roots": ([UPPER, LOWER], [PIVOT, (GROUND, 1, [2, 1, 0], [0.1, 0, 0.7])]),
    "free chain": ([UPPER, LOWER, THIRD], [ELBOW, (1, 2, [0.2, 0, -0.6], [0, 0.3, 0.4])]),
    "free body": ([THIRD], []),
}


@pytest.fixture(scope="session", params=list(TREES))
def tree(request):
    """Every shape of tree the formulations claim to reach, over one second."""
    return make_tree(*TREES[request.param], name=request.param)


@pytest.fixture(scope="session")
def double():
    """The double pendulum of ENGINES scene B, over one second."""
    return make_tree(*TREES["double"], name="double")


@pytest.fixture(scope="session")
def top():
    """The heavy top of ENGINES scene C."""
    return make_tree(*TREES["top"], name="top", samples=101)
