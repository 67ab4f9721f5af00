"""Andrews' squeezing mechanism against published digits.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section VII.7, and the test set for IVP solvers: the
seven angles at 0.03 s and the accelerations at the start. Three formulations here agree with each other to 2e-12; the
published angles keep ten digits.
"""

import numpy as np
import pytest

import crosscheck

ANGLES = (15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948, 0.5244099658805304,
          0.5347301163226948, 1.048080741042263)
STARTS = (14222.4439199541138705911625887, -10666.8329399655854029433719415)  # rad/s^2, of the first two angles


def attitudes(angles):
    """Of the bodies K1 to K7 (rad), from the angles beta, Theta, gamma, phi, delta, Omega, epsilon."""
    beta, theta, gamma, phi, delta, omega, epsilon = angles
    return np.array([beta, beta + theta, gamma, phi + delta, delta, omega + epsilon, epsilon])


@pytest.mark.parametrize("reduce", ["planar", "off"])
def test_published_angles(reduce):
    traj = crosscheck.run("squeezer", "lieeuler", "taylor", rtol=1e-13, reduce=reduce)
    turned = traj.R[-1] @ np.array([1.0, 0.0, 0.0])
    published = attitudes(ANGLES)
    difference = np.arctan2(turned[:, 1], turned[:, 0]) - published
    difference = np.abs((difference + np.pi) % (2 * np.pi) - np.pi)
    assert (difference / np.abs(published)).max() < 6e-9  # of K2, whose angle is the difference of two large ones
    assert difference.max() < 1.2e-9  # rad; of the motor's 15.8 rad


def test_published_accelerations_at_the_start():
    traj = crosscheck.run("squeezer", "lieeuler", "rkmk4", step=1e-5, duration=1e-3, samples=2)
    beta, theta = STARTS
    np.testing.assert_allclose(traj.alpha[0, :2, 2], [beta, beta + theta], rtol=1e-12)
