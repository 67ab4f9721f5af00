"""Needles, wires and point masses at joints: accelerations lose as many digits as the moments span, not twice as many.

The truth is that of the free directions N of the joint alone, y = N (N^T M N)^-1 N^T f, in fifty digits: the kernel
solves with the constraint rows instead, and shares no formula with it.
"""

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler

EPS = np.finfo(float).eps
ANCHOR = np.array([0.3, 0.2, 0.5])  # m, from the centre of mass
X, Y, Z = np.eye(3)
MOTIONS = {  # (v of the anchor, w) of every free direction
    "fixed": (), "revolute": ((0 * X, Z),), "prismatic": ((Z, 0 * X),), "universal": ((0 * X, Z), (0 * X, X)),
    "cylindrical": ((0 * X, Z), (Z, 0 * X)), "spherical": ((0 * X, X), (0 * X, Y), (0 * X, Z))}  # fmt: skip
JOINTS = {
    "fixed": lambda: lieeuler.fixed_joint(-1, 0, 0 * X, ANCHOR, np.eye(3)),
    "revolute": lambda: lieeuler.revolute_joint(-1, 0, 0 * X, ANCHOR, Z, Z),
    "prismatic": lambda: lieeuler.prismatic_joint(-1, 0, 0 * X, ANCHOR, Z, Z, np.eye(3)),
    "universal": lambda: lieeuler.universal_joint(-1, 0, 0 * X, ANCHOR, Z, X),
    "cylindrical": lambda: lieeuler.cylindrical_joint(-1, 0, 0 * X, ANCHOR, Z, Z),
    "spherical": lambda: lieeuler.spherical_joint(-1, 0, 0 * X, ANCHOR)}  # fmt: skip


def needle(ratio):
    """Moments (1, 1, ratio), kg m^2, about axes that are not those of the frame."""
    T = Rotation.from_rotvec([0.3, 0.5, 0.2]).as_matrix()
    J = T @ np.diag([1.0, 1.0, ratio]) @ T.T
    return (J + J.T) / 2


def point(ratio):
    """All moments small beside mass times the anchor's distance squared."""
    return ratio * np.diag([1.0, 1.1, 1.2])


def at_rest(joint, inertia):
    load = lieeuler.ConstantLoad(0, torque=[1.0, 0.5, 1.0], frame="body")
    return lieeuler.Problem([lieeuler.Body(1.0, inertia)], [JOINTS[joint]()], [0, 0, -9.81], [-ANCHOR], [np.eye(3)],
                            [np.zeros(3)], [np.zeros(3)], [load])


def acceleration(joint, inertia):
    """(v', w') in fifty digits."""
    if not MOTIONS[joint]:
        return np.zeros(6)
    with mpmath.workdps(50):
        N = mpmath.matrix(np.array([[*(v + np.cross(ANCHOR, w)), *w] for v, w in MOTIONS[joint]]).T.tolist())
        M = mpmath.eye(6)
        for i in range(3):
            for j in range(3):
                M[3 + i, 3 + j] = mpmath.mpf(inertia[i, j])
        f = mpmath.matrix([0, 0, -9.81, 1.0, 0.5, 1.0])
        y = N * mpmath.lu_solve(N.T * M * N, N.T * f)
        return np.array([float(value) for value in y])


@pytest.mark.parametrize("make", [needle, point])
@pytest.mark.parametrize("joint", JOINTS)
def test_accelerations_lose_no_more_digits_than_the_moments_span(joint, make):
    for method, ratio in (*(("DAE1H_LSE", ratio) for ratio in (1e-2, 1e-4, 1e-6)), ("rkmk4", 1e-6), ("rkmk4", 1e-8)):
        inertia = make(ratio)
        start = lieeuler.integrate(at_rest(joint, inertia), method, step=1e-4, t_eval=[0.0, 1e-4])
        truth = acceleration(joint, inertia)
        error = np.abs(np.concatenate([start.a[0, 0], start.alpha[0, 0]]) - truth).max()
        assert error <= 10 * EPS / ratio * (np.abs(truth).max() + 10.0)  # of gravity and the load


@pytest.mark.parametrize(("method", "ratio"), [("DAE1L_LSE", 1e-6), ("DAE1H_LSE", 1e-6), ("rattle2", 1e-6),
                                               ("rkmk4", 1e-8), ("taylor", 1e-8)])
@pytest.mark.parametrize("make", [needle, point])
@pytest.mark.parametrize("joint", ["fixed", "revolute", "prismatic"])
def test_held_rows_stay_at_rounding(joint, make, method, ratio):
    control = {"rtol": 1e-8} if method == "taylor" else {"step": 1e-3}
    solution = lieeuler.integrate(at_rest(joint, make(ratio)), method, t_eval=np.linspace(0, 0.1, 3), **control)
    assert solution.success
    assert solution.stats.maxima["constraint_velocity"] < 1e-13  # m/s, 1/s
    assert solution.stats.maxima["constraint_acceleration"] < 1e-12 * (10 + np.abs(solution.alpha).max())
