"""Coordinates of joints: there and back, rates against differences, and a motion by hand."""

from __future__ import annotations

import numpy as np
import pytest

import lieeuler

BODY = lieeuler.Body(1.0, np.diag([0.02, 0.03, 0.04]))
A, C = np.array([0.6, 0.0, 0.8]), np.array([0.0, -0.8, 0.6])
ABOVE, BELOW = [0.1, 0.2, -0.3], [-0.2, 0.1, 0.4]
Q = np.linalg.qr(np.arange(9.0).reshape(3, 3) + np.eye(3))[0]
Q = Q * np.linalg.det(Q)
JOINTS = {
    "revolute": (lambda p, c: lieeuler.revolute_joint(p, c, ABOVE, BELOW, A, C), 1),
    "universal": (lambda p, c: lieeuler.universal_joint(p, c, ABOVE, BELOW, A, C), 2),
    "spherical": (lambda p, c: lieeuler.spherical_joint(p, c, ABOVE, BELOW), 3),
    "cylindrical": (lambda p, c: lieeuler.cylindrical_joint(p, c, ABOVE, BELOW, A, C), 2),
    "prismatic": (lambda p, c: lieeuler.prismatic_joint(p, c, ABOVE, BELOW, A, Q @ A, Q), 1),
    "planar": (lambda p, c: lieeuler.planar_joint(p, c, ABOVE, BELOW, A, C), 3),
    "point_on_line": (lambda p, c: lieeuler.point_on_line_joint(p, c, ABOVE, BELOW, A), 4),
    "point_on_plane": (lambda p, c: lieeuler.point_on_plane_joint(p, c, ABOVE, BELOW, A), 5),
    "fixed": (lambda p, c: lieeuler.fixed_joint(p, c, ABOVE, BELOW, Q), 0),
}


def pair(name, rng):
    """Two bodies on two joints of a type, the outer one on the inner one; `Problem` checks that they are closed."""
    make, size = JOINTS[name]
    joints = [make(-1, 0), make(0, 1)]
    q, rate = rng.uniform(-1.2, 1.2, (2, 2, size))
    return lieeuler.from_joints([BODY] * 2, joints, [0, 0, -9.81], list(q), list(rate)), q, rate


@pytest.mark.parametrize("name", JOINTS)
def test_there_and_back(name):
    problem, q, rate = pair(name, np.random.default_rng(3))
    for k, found in enumerate(lieeuler.joint_coordinates(problem, problem)):
        np.testing.assert_allclose(found.position[0], q[k], atol=1e-14)
        np.testing.assert_allclose(found.rate[0], rate[k], atol=1e-13)


@pytest.mark.parametrize("name", [name for name in JOINTS if name not in ("spherical", "point_on_line",
                                                                        "point_on_plane", "fixed")])
def test_rates_are_derivatives_along_a_run(name):
    problem = pair(name, np.random.default_rng(5))[0]
    h = 1e-3
    run = lieeuler.integrate(problem, lieeuler.RKMK853(rtol=1e-12), np.arange(5) * h)
    for each in lieeuler.joint_coordinates(problem, run):
        q, slope = each.position, (8 * (each.position[3] - each.position[1]) - each.position[4] + each.position[0])
        np.testing.assert_allclose(slope / (12 * h), each.rate[2], atol=1e-8 * max(1.0, np.abs(q).max()))


def test_angles_are_continuous_over_turns():
    hinge = lieeuler.revolute_joint(-1, 0, [0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 0])
    wheel = lieeuler.from_joints([BODY], [hinge], [0, 0, 0], [[0.5]], [[10.0]])
    run = lieeuler.integrate(wheel, lieeuler.Taylor(), np.linspace(0, 2, 21))
    np.testing.assert_allclose(lieeuler.joint_coordinates(wheel, run)[0].position[:, 0], 0.5 + 10 * run.t, atol=1e-7)


def test_a_half_turn_and_none_of_a_ball():
    ball = lieeuler.spherical_joint(-1, 0, [0, 0, 0], [0, 0, 1])
    for vector in ([0, 0, 0], [1e-9, 0, 0], [0, np.pi, 0], [2.0, -1.0, 0.5]):
        problem = lieeuler.from_joints([BODY], [ball], [0, 0, 0], [vector])
        np.testing.assert_allclose(np.abs(lieeuler.joint_coordinates(problem, problem)[0].position[0]), np.abs(vector),
                                   atol=1e-12)


def test_what_has_none_and_what_is_wrong():
    rod = lieeuler.distance_joint(-1, 0, [0, 0, 1], [0, 0, 0], 1.0)
    hinge = lieeuler.revolute_joint(-1, 0, [0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 0])
    both = lieeuler.from_joints([BODY], [hinge, rod], [0, 0, 0], [[0.3], None])
    assert lieeuler.joint_coordinates(both, both)[1] is None
    for joints, positions, words in (
            ([rod], [None], "no coordinates"), ([hinge], [[1.0, 2.0]], r"positions\[0\]"),
            ([hinge, rod], [[0.0], [1.0]], "close loops"), ([hinge], [], "an entry for each"),
            ([hinge], 3, "positions must be a sequence"), (["hinge"], [[0.0]], "must be lieeuler.Joint")):
        with pytest.raises(lieeuler.ArgumentError, match=words):
            lieeuler.from_joints([BODY], joints, [0, 0, 0], positions)
    with pytest.raises(lieeuler.ArgumentError, match="joint_coordinates takes"):
        lieeuler.joint_coordinates(both, "run")
    with pytest.raises(lieeuler.ArgumentError, match=r"bodies \[1\] do not hang"):
        lieeuler.from_joints([BODY] * 2, [hinge], [0, 0, 0], [[0.0]])
