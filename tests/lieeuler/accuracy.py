"""Measures of accuracy: differences, slopes, constraint levels and dense equations."""

from __future__ import annotations

import numpy as np

import lieeuler
from lieeuler import _kernel

EPS = np.finfo(float).eps
QUANTITIES = ("x", "R", "v", "w")
FIELDS = (*QUANTITIES, "a", "alpha", "lam")


def largest_difference(a, b):
    """Of two runs in any field, over its size."""
    return max(np.abs(getattr(a, name) - getattr(b, name)).max(initial=0.0)
               / (1 + np.abs(getattr(a, name)).max(initial=0.0)) for name in FIELDS)


def slopes(abscissae, values):
    """Least-squares slopes of log(values) (rows of x, R, v, w) against log(abscissae)."""
    return np.polyfit(np.log(abscissae), np.log(np.array(values)), 1)[0]


def agrees_with_order(found, method):
    """Whether slopes are those of the method's order, to the usual margin."""
    order = lieeuler.METHODS[method].order
    return np.abs(found - order).max() < (0.1 if order == 1 else 0.15)


def assert_on_the_constraints(solution, problem):
    """Phi, G u, G a + gamma and R^T R - I within 50 eps times the size of their terms, after every step."""
    anchors = [np.linalg.norm(s) for j in problem.joints for s in (j.parent_anchor, j.child_anchor)]
    length = max([1.0, *anchors, np.abs(solution.x).max()])
    speed = length * max(1.0, np.abs(solution.w).max(), np.abs(solution.v).max() / length)
    maxima = solution.stats.maxima
    assert maxima["constraint_position"] < 50 * EPS * length
    assert maxima["constraint_velocity"] < 50 * EPS * speed
    # a = M^-1 (f - G^T lam): its terms are as large as the multipliers over the lightest body's inertia
    inertias = [np.linalg.eigvalsh(body.inertia)[0] for body in problem.bodies]
    mobility = 1 / min(body.mass for body in problem.bodies) + length**2 / min(inertias)
    load = np.abs(solution.lam).max(initial=0)
    sizes = speed**2 / length, np.abs(solution.a).max(), length * np.abs(solution.alpha).max(), mobility * load
    assert maxima["constraint_acceleration"] < 50 * EPS * max(sizes)
    assert maxima["orthogonality"] < 50 * EPS


def mass_matrix(problem):
    """Dense, (6n, 6n)."""
    M = np.zeros((6 * problem.n, 6 * problem.n))
    for b, body in enumerate(problem.bodies):
        M[6 * b:6 * b + 3, 6 * b:6 * b + 3] = body.mass * np.eye(3)
        M[6 * b + 3:6 * b + 6, 6 * b + 3:6 * b + 6] = body.inertia
    return M


def dense_index1(problem, x, R, v, w):
    """Accelerations (n, 6) and least-norm multipliers, from rows and forces that other tests check."""
    rows = _kernel.constraints(problem.kernel, x, R, v, w, np.zeros(problem.rows))
    f = _kernel.forces(problem.kernel, x, R, v, w)["f"].reshape(problem.n, 6).copy()
    for b, body in enumerate(problem.bodies):
        f[b, 3:] -= np.cross(w[b], body.inertia @ w[b])
    G, inverse = rows["G"], np.linalg.inv(mass_matrix(problem))
    lam = np.linalg.lstsq(G @ inverse @ G.T, G @ inverse @ f.ravel() + rows["gamma"], rcond=1e-11)[0]
    return (inverse @ (f.ravel() - G.T @ lam)).reshape(-1, 6), lam
