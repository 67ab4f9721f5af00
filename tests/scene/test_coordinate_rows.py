"""Rows of mimics and drives against differences in the group, along motions that keep joints closed."""

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.constraints import Constraints
from tests.scene_making import DIFFERENCE, derivative, moved

SCENES = ["coupled_arm", "driven_slider_crank"]


def on_the_way(name, seed):
    """Constraints, a state, velocities (n, 6) that leave all joints closed but not these rows, and rates of them.

    An angle is that of a joint whose axes coincide: its row is a derivative along such velocities alone.
    """
    scene, rng = crosscheck.load_scene(name), np.random.default_rng(seed)
    constraints = Constraints(scene)
    rows = [each.row for each in constraints.followers] + [row for row, *_ in constraints.drives]
    assert rows
    others = np.delete(constraints.jacobian(scene.x0[None], scene.R0[None])[0], rows, axis=0)
    _, sizes, V = np.linalg.svd(others)
    free = V[int((sizes > 1e-9 * sizes[0]).sum()):]
    u = (rng.uniform(-2, 2, size=len(free)) @ free).reshape(-1, 6)
    return constraints, rows, scene.x0, scene.R0, u, rng.uniform(-2, 2, size=u.shape)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("seed", range(5))
def test_jacobian_is_the_derivative_in_the_group(name, seed):
    constraints, rows, x, R, u, _ = on_the_way(name, seed)

    def along(e):
        xe, Re = moved(x, R, e * u)
        return constraints.position(xe[None], Re[None])[0][rows]

    G = constraints.jacobian(x[None], R[None])[0]
    # |G| |u| stays below 50: a ratio of -2.5 and speeds of two bodies
    np.testing.assert_allclose(derivative(along), (G @ u.ravel())[rows], rtol=0, atol=50 * DIFFERENCE)
    np.testing.assert_allclose(constraints.sparse_jacobian(x[None], R[None]).toarray(), G, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("seed", range(5))
def test_rates_are_derivatives_in_time(name, seed):
    constraints, rows, x, R, u, rates = on_the_way(name, seed)
    t0 = 0.3

    def velocity(t):
        xt, Rt = moved(x, R, t * u)
        ut = u + t * rates
        return constraints.velocity(xt[None], Rt[None], ut[None, :, :3], ut[None, :, 3:], t0 + t)[0][rows]

    def position(t):
        xt, Rt = moved(x, R, t * u)
        return constraints.position(xt[None], Rt[None], t0 + t)[0][rows]

    motion = u[None, :, :3], u[None, :, 3:]
    found = constraints.velocity(x[None], R[None], *motion, t0)[0][rows]
    np.testing.assert_allclose(derivative(position), found, rtol=0, atol=50 * DIFFERENCE)
    found = constraints.acceleration(x[None], R[None], *motion, rates[None, :, :3], rates[None, :, 3:], t0)[0][rows]
    np.testing.assert_allclose(derivative(velocity), found, rtol=0, atol=500 * DIFFERENCE)  # |w|^2 |d| below 500
