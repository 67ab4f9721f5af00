"""Every coordinate map passes the same identities, at angles from 1e-12 to pi, against mpmath."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lieeuler import COORDINATE_MAPS, _kernel
from lieeuler.reference import hat

ANGLES = np.r_[np.logspace(-12, np.log10(3.1), 60), 0.499, 0.5, 0.501]  # 0.5: where closed forms replace the series
INERTIA = np.array([[0.3, 0.02, -0.01], [0.02, 0.25, 0.03], [-0.01, 0.03, 0.4]])
AXES = [np.array(a) / np.linalg.norm(a) for a in ([1.0, 2.0, -2.0], [0.3, -0.1, 0.9], [1.0, 0.0, 0.0])]
ROUNDING = 8 * np.finfo(float).eps


def inside(coordinate_map, theta):
    return coordinate_map != "ccsk" or abs(theta[1]) < 1.5  # ccsk ends at pi/2


def mp_hat(t):
    return mp.matrix([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])


def mp_map(name, theta):
    t = [mp.mpf(value) for value in theta]
    if name == "exp":
        return mp.expm(mp_hat(t))
    if name == "cayley":
        return (mp.eye(3) - mp_hat(t) / 2) ** -1 * (mp.eye(3) + mp_hat(t) / 2)
    first, second, third = (mp.expm(mp_hat([t[i] if i == j else mp.mpf(0) for i in range(3)])) for j in range(3))
    return first * second * third


def mp_right_tangent(name, theta):
    """Central difference of the map in 60 digits: exact to 1e-30."""
    step, columns = mp.mpf(10) ** -20, []
    for j in range(3):
        ahead, behind = ([mp.mpf(v) + sign * (step if i == j else 0) for i, v in enumerate(theta)] for sign in (1, -1))
        W = (mp_map(name, ahead) - mp_map(name, behind)) / (2 * step) * mp_map(name, theta).T
        columns.append([W[2, 1], W[0, 2], W[1, 0]])
    return mp.matrix(columns).T


@pytest.mark.parametrize("name", COORDINATE_MAPS)
@pytest.mark.parametrize("axis", AXES, ids=str)
def test_values_against_sixty_digits(name, axis):
    with mp.workdps(60):
        for angle in (*ANGLES[::7], *ANGLES[-3:]):
            theta = angle * axis
            if not inside(name, theta):
                continue
            value = _kernel.map_values(_kernel.CoordinateMap[name], theta, np.eye(3), 1.0)
            E, D = mp_map(name, theta), mp_right_tangent(name, theta)
            momentum = mp.lu_solve(D.T, mp.matrix(INERTIA @ theta))
            kernel_momentum = _kernel.map_values(_kernel.CoordinateMap[name], theta, INERTIA, 1.0)["momentum"]
            exact = np.array(E.tolist(), dtype=float)
            tangent = np.array((E.T * D).tolist(), dtype=float)
            conditioning = max(1.0, np.linalg.norm(np.linalg.inv(tangent)))
            assert np.abs(value["rotation"] - exact).max() < ROUNDING
            assert np.abs(value["left_tangent"] - tangent).max() < ROUNDING
            expected = np.array([float(v) for v in momentum])
            assert np.abs(kernel_momentum - expected).max() <= ROUNDING * conditioning * np.abs(expected).max()


@pytest.mark.parametrize("name", COORDINATE_MAPS)
@given(st.floats(1e-12, 3.1), st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.floats(1e-4, 1))
def test_identities(name, angle, direction, h):
    if np.linalg.norm(direction) < 1e-3:
        return
    theta = angle * np.array(direction) / np.linalg.norm(direction)
    xi = theta / h
    value = _kernel.map_values(_kernel.CoordinateMap[name], xi, INERTIA, h)
    assert value["inside"] == (name != "ccsk" or bool(abs((h * xi)[1]) < np.pi / 2))
    if not inside(name, theta):
        return
    E, T = value["rotation"], value["left_tangent"]
    assert np.abs(E.T @ E - np.eye(3)).max() < 4 * ROUNDING
    assert np.linalg.det(E) > 0
    # D* J xi . (D eta) = J xi . eta with D = E T: the momentum map is the dual of the tangent.
    L = INERTIA @ xi
    defect = (E @ T).T @ value["momentum"] - L
    assert np.abs(defect).max() < 100 * ROUNDING * np.abs(value["momentum"]).max()


@pytest.mark.parametrize("name", COORDINATE_MAPS)
@given(st.floats(1e-8, 2.5), st.integers(0, 2), st.floats(0.05, 1))
def test_derivatives_against_central_differences(name, angle, which, h):
    xi = angle / h * AXES[which]
    if not inside(name, h * xi * 1.01):
        return
    value = _kernel.map_values(_kernel.CoordinateMap[name], xi, INERTIA, h)
    step = 1e-5 * max(1.0, np.linalg.norm(xi))
    slope, turn = np.empty((3, 3)), np.empty((3, 3))
    for j in range(3):
        ahead, behind = (_kernel.map_values(_kernel.CoordinateMap[name], xi + d * np.eye(3)[j], INERTIA, h)
                         for d in (step, -step))
        slope[:, j] = (ahead["momentum"] - behind["momentum"]) / (2 * step)
        W = value["rotation"].T @ (ahead["rotation"] - behind["rotation"]) / (2 * step * h)
        turn[:, j] = W[2, 1], W[0, 2], W[1, 0]
    # Second-order differences: relative error step^2 and rounding eps / step, times the map's own growth near its edge.
    size = max(1.0, np.abs(value["momentum_slope"]).max())
    assert np.abs(value["momentum_slope"] - slope).max() < 1e-7 * size**3
    assert np.abs(value["left_tangent"] - turn).max() < 1e-7


def test_domains():
    identity = np.eye(3)
    edge = np.array([0, 2 * np.pi, 0])
    assert _kernel.map_values(_kernel.CoordinateMap.exp, 0.999 * edge, identity, 1.0)["inside"]
    assert not _kernel.map_values(_kernel.CoordinateMap.exp, 1.001 * edge, identity, 1.0)["inside"]
    assert not _kernel.map_values(_kernel.CoordinateMap.ccsk, edge / 4 * 1.001, identity, 1.0)["inside"]
    assert _kernel.map_values(_kernel.CoordinateMap.cayley, 1e3 * edge, identity, 1.0)["inside"]


def test_hat_of_the_oracle_is_the_cross_product():
    a, b = AXES[0], AXES[1]
    assert np.allclose(hat(a) @ b, np.cross(a, b), rtol=0, atol=ROUNDING)
