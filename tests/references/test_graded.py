"""Needles and light bodies under heavy ones: right formulas may lose their digits here; those of the truth do not."""

import mpmath
import numpy as np
import pytest

from crosscheck.references import articulated, compute, maximal
from crosscheck.scene.file import load_scene

EPS = np.finfo(float).eps


def test_equal_moments_leave_exactly_no_moment_about_the_third_axis():
    rng = np.random.default_rng(3)
    for _ in range(100):
        moment, w = rng.uniform(0.01, 10.0), rng.normal(size=3)
        for axis in range(3):
            J = np.diag(np.where(np.arange(3) == axis, 1e-6 * moment, moment))
            assert articulated.gyroscopic(J.tolist(), w.tolist())[axis] == 0.0
            assert maximal.gyroscopic(J[None], w[None])[0, axis] == 0.0


def test_the_moment_is_that_of_the_textbook():
    rng = np.random.default_rng(4)
    for _ in range(20):
        factor, w = rng.normal(size=(3, 3)), rng.normal(size=3)
        J = factor @ factor.T
        expected, atol = np.cross(w, J @ w), 50 * EPS * np.linalg.norm(J) * (w @ w)
        np.testing.assert_allclose(articulated.gyroscopic(J.tolist(), w.tolist()), expected, rtol=0, atol=atol)
        np.testing.assert_allclose(maximal.gyroscopic(J[None], w[None])[0], expected, rtol=0, atol=atol)


def exact_accelerations(equations):
    """The saddle-point system in 50 digits, (n, 6)."""
    motion, angles = equations.motion(equations.initial())
    G, target = equations._constraint_terms(motion)
    force, torque = equations._applied(motion, angles)
    scene, flat, n = equations.scene, G.reshape(len(G), -1), equations.scene.n
    effort = np.concatenate([force, torque - maximal.gyroscopic(scene.inertias, motion.w[:-1])], axis=1).ravel()
    with mpmath.workdps(50):
        K = mpmath.zeros(6 * n + len(G))
        for body in range(n):
            for k in range(3):
                K[6 * body + k, 6 * body + k] = scene.masses[body]
                for j in range(3):
                    K[6 * body + 3 + k, 6 * body + 3 + j] = scene.inertias[body][k, j]
        for row, entries in enumerate(flat.tolist()):
            for column, entry in enumerate(entries):
                K[6 * n + row, column] = K[column, 6 * n + row] = entry
        solved = mpmath.lu_solve(K, mpmath.matrix([*effort.tolist(), *(-target).tolist()]))
        return np.array([float(entry) for entry in solved[:6 * n]]).reshape(n, 6)


@pytest.mark.parametrize("name", ["light_heavy", "heavy_light"])
def test_accelerations_of_unequal_masses_keep_their_digits(name, monkeypatch):
    scene = load_scene(name)
    equations = maximal.Maximal(scene)
    exact = exact_accelerations(equations)
    size = np.abs(exact).max()
    found = np.concatenate(equations.accelerations(*equations.motion(equations.initial())), axis=1)
    # a dozen pivots, each a rounding of numbers of the size of the result
    assert np.abs(found - exact).max() <= 50 * EPS * size
    if name == "light_heavy":  # what the other branch would have lost: digits of the mass ratio, 1e6
        monkeypatch.setattr(maximal, "GRADED", np.inf)
        quick = maximal.Maximal(scene)
        lost = np.concatenate(quick.accelerations(*quick.motion(quick.initial())), axis=1)
        assert np.abs(lost - exact).max() > 1e3 * EPS * size


@pytest.mark.parametrize("name", ["needle", "axis_flip",
                                  "light_heavy",
                                  "heavy_light",
                                  "taut_chain"])
def test_hard_scenes_have_a_truth(name):
    reference = compute(load_scene(name))
    assert reference.disagreement <= reference.allowed <= 1e-11
