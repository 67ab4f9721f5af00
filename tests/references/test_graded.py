"""Needles and light bodies under heavy ones: right formulas may lose their digits here; those of the truth do not."""

import mpmath
import numpy as np
import pytest

from crosscheck.references import articulated, compute, maximal
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import starting
from crosscheck.scene.file import load_scene

EPS = np.finfo(float).eps


def test_equal_moments_leave_exactly_no_moment_about_the_third_axis():
    rng = np.random.default_rng(3)
    for _ in range(100):
        moment, w = rng.uniform(0.01, 10.0), rng.normal(size=3)
        for axis in range(3):
            J = np.diag(np.where(np.arange(3) == axis, 1e-6 * moment, moment))
            assert articulated.gyroscopic(J.tolist(), w.tolist())[axis] == 0.0
            assert mechanics.gyroscopic(J[None], w[None])[0, axis] == 0.0


def test_the_moment_is_that_of_the_textbook():
    rng = np.random.default_rng(4)
    for _ in range(20):
        factor, w = rng.normal(size=(3, 3)), rng.normal(size=3)
        J = factor @ factor.T
        expected, atol = np.cross(w, J @ w), 50 * EPS * np.linalg.norm(J) * (w @ w)
        np.testing.assert_allclose(articulated.gyroscopic(J.tolist(), w.tolist()), expected, rtol=0, atol=atol)
        np.testing.assert_allclose(mechanics.gyroscopic(J[None], w[None])[0], expected, rtol=0, atol=atol)


def exact_accelerations(scene):
    """The saddle-point system in 50 digits, (n, 6)."""
    at, rows, n = starting(scene), Constraints(scene), scene.n
    state = at.x, at.R, at.v, at.w
    G, target, effort = rows.jacobian(at.x, at.R)[0], rows.gamma(*state, 0.0)[0], mechanics.applied_forces(
        scene, *state)[0]
    with mpmath.workdps(50):
        K = mpmath.zeros(6 * n + len(G))
        for body in range(n):
            for k in range(3):
                K[6 * body + k, 6 * body + k] = scene.masses[body]
                for j in range(3):
                    K[6 * body + 3 + k, 6 * body + 3 + j] = scene.inertias[body][k, j]
        for row, entries in enumerate(G.tolist()):
            for column, entry in enumerate(entries):
                K[6 * n + row, column] = K[column, 6 * n + row] = entry
        solved = mpmath.lu_solve(K, mpmath.matrix([*effort.tolist(), *(-target).tolist()]))
        return np.array([float(entry) for entry in solved[:6 * n]]).reshape(n, 6)


@pytest.mark.parametrize("name", ["light_heavy", "heavy_light"])
def test_accelerations_of_unequal_masses_keep_their_digits(name):
    scene = load_scene(name)
    exact = exact_accelerations(scene)
    found = np.concatenate(maximal.Maximal(scene).accelerations(starting(scene))[:2], axis=-1)[0]
    # a dozen pivots, each a rounding of numbers of the size of the result
    assert np.abs(found - exact).max() <= 50 * EPS * np.abs(exact).max()


@pytest.mark.parametrize("name", ["needle", "axis_flip",
                                  "light_heavy",
                                  "heavy_light",
                                  "taut_chain"])
def test_hard_scenes_have_a_truth(name):
    reference = compute(load_scene(name))
    assert reference.disagreement <= reference.allowed <= 1e-11
