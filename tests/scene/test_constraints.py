"""The constraint library against definitions: differences in the group, time derivatives, free directions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crosscheck.scene.constraints import Constraints
from crosscheck.scene.vectors import normal_references
from tests.scene_making import DIFFERENCE, JOINT_TYPES, ROWS, derivative, drawn, jointed_pair, moved

seeds = st.integers(0, 2**32 - 1)
EPS = np.finfo(float).eps


def state(scene):
    return scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]


def elsewhere(scene, rng):
    """The scene's constraints, and a state of its bodies far from the initial one and from closure."""
    x, R = moved(scene.x0, scene.R0, rng.uniform(-1, 1, size=(scene.n, 6)))
    return Constraints(scene), x, R


@pytest.mark.parametrize("kind", JOINT_TYPES)
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_jacobian_is_the_derivative_in_the_group(kind, seed):
    rng = np.random.default_rng(seed)
    constraints, x, R = elsewhere(jointed_pair(rng, kind), rng)
    direction = rng.uniform(-1, 1, size=(2, 6))

    def along(e):
        xe, Re = moved(x, R, e * direction)
        return constraints.position(xe[None], Re[None])[0]

    expected = constraints.jacobian(x[None], R[None])[0] @ direction.ravel()
    np.testing.assert_allclose(derivative(along), expected, rtol=0, atol=DIFFERENCE * 10)  # |G| |u| stays below 10


@pytest.mark.parametrize("kind", JOINT_TYPES)
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_velocity_is_the_jacobian_times_the_velocities(kind, seed):
    rng = np.random.default_rng(seed)
    constraints, x, R = elsewhere(jointed_pair(rng, kind), rng)
    u = rng.uniform(-2, 2, size=(2, 6))
    rates = constraints.velocity(x[None], R[None], u[None, :, :3], u[None, :, 3:])[0]
    # two orders of the same sum of fewer than 40 products, none above 40
    np.testing.assert_allclose(rates, constraints.jacobian(x[None], R[None])[0] @ u.ravel(), rtol=0, atol=40 * 40 * EPS)


@pytest.mark.parametrize("kind", JOINT_TYPES)
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_acceleration_is_the_time_derivative_of_the_velocity_level(kind, seed):
    rng = np.random.default_rng(seed)
    constraints, x, R = elsewhere(jointed_pair(rng, kind), rng)
    u, rates = rng.uniform(-2, 2, size=(2, 2, 6))

    def velocity_at(t):
        xt, Rt = moved(x, R, t * u)
        ut = u + t * rates
        # dR/dt is R hat(w) at t = 0 only, so the path is right to first order, which a derivative there needs
        return constraints.velocity(xt[None], Rt[None], ut[None, :, :3], ut[None, :, 3:])[0]

    expected = constraints.acceleration(x[None], R[None], u[None, :, :3], u[None, :, 3:], rates[None, :, :3],
                                        rates[None, :, 3:])[0]
    np.testing.assert_allclose(derivative(velocity_at), expected, rtol=0, atol=DIFFERENCE * 100)  # |w|^2 |d| < 100


@pytest.mark.parametrize("kind", JOINT_TYPES)
@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_rows_are_independent_where_the_joint_is_closed(kind, seed):
    rng = np.random.default_rng(seed)
    scene = drawn(lambda: jointed_pair(rng, kind))
    constraints = Constraints(scene)
    rows = constraints.rows["joint"]
    assert rows.stop - rows.start == ROWS[kind]
    assert constraints.m == 3 + ROWS[kind]
    child = constraints.jacobian(*state(scene)[:2])[0][rows, 6:]
    # unit directions and unit axes, anchors up to sqrt(3): a joint singular here would give zero
    assert np.linalg.svd(child, compute_uv=False)[-1] > 0.1


def free_motion(kind, scene, rng):
    """A motion (x, R) of the second body that the joint `kind` allows, by its definition rather than its rows."""
    joint = scene.joints[1]
    Rp, Rc = scene.R0
    anchor = scene.x0[0] + Rp @ joint.parent_anchor
    own = scene.x0[1] + Rc @ joint.child_anchor
    axis = Rp @ (joint.parent_axis if joint.parent_axis is not None else np.array([0.0, 0.0, 1.0]))
    n1, n2 = (Rp @ n for n in normal_references(joint.parent_axis)) if joint.parent_axis is not None else (axis, axis)
    angle, slide, across = rng.uniform(-2, 2, size=3)
    ball = rng.uniform(-1, 1, size=3)
    turns = {"spherical": ball, "revolute": angle * axis, "cylindrical": angle * axis, "planar": angle * axis,
             "distance": ball, "point_on_line": ball, "point_on_plane": ball, "universal": angle * axis}
    shifts = {"cylindrical": slide * axis, "prismatic": slide * axis, "planar": slide * n1 + across * n2,
              "point_on_line": slide * axis, "point_on_plane": slide * n1 + across * n2}
    turn = rotation(turns.get(kind, np.zeros(3)))
    if kind == "universal":
        turn = turn @ rotation(across * Rc @ joint.child_axis)
    if kind == "distance":
        own = anchor + rotation(rng.uniform(-1, 1, size=3)) @ (own - anchor)
    attitude = turn @ Rc
    return own + shifts.get(kind, np.zeros(3)) - attitude @ joint.child_anchor, attitude


def rotation(vector):
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


@pytest.mark.parametrize("kind", JOINT_TYPES)
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_every_motion_a_joint_allows_satisfies_its_rows(kind, seed):
    rng = np.random.default_rng(seed)
    scene = drawn(lambda: jointed_pair(rng, kind))
    constraints = Constraints(scene)
    position, attitude = free_motion(kind, scene, rng)
    x, R = np.stack([scene.x0[0], position]), np.stack([scene.R0[0], attitude])
    # closed to 50 eps of lengths up to 10, and carried through three rotations
    assert np.abs(constraints.position(x[None], R[None])).max() < 200 * EPS * 10


@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_a_batch_is_the_stack_of_its_states(kind):
    rng = np.random.default_rng(4)
    constraints, x, R = elsewhere(jointed_pair(rng, kind), rng)
    x2, R2 = moved(x, R, rng.uniform(-1, 1, size=(2, 6)))
    both = np.stack([x, x2]), np.stack([R, R2])
    for method in (constraints.position, constraints.jacobian):
        single = np.concatenate([method(x[None], R[None]), method(x2[None], R2[None])])
        np.testing.assert_array_equal(method(*both), single)


@given(seed=seeds)
@settings(max_examples=50, deadline=None)
def test_reference_vectors_are_a_right_handed_triad(seed):
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    n1, n2 = normal_references(axis)
    triad = np.stack([n1, n2, axis])
    np.testing.assert_allclose(triad @ triad.T, np.eye(3), rtol=0, atol=10 * EPS)  # three products of size 1 each
    assert np.linalg.det(triad) > 0


def test_reference_vectors_take_the_first_of_equal_components():
    n1, n2 = normal_references(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_array_equal([n1, n2], [[1, 0, 0], [0, 1, 0]])


def test_a_scene_without_joints_has_no_rows():
    scene = jointed_pair(np.random.default_rng(1), "fixed").replace(joints=())
    constraints = Constraints(scene)
    assert constraints.m == 0
    assert constraints.position(*state(scene)[:2]).shape == (1, 0)
    assert constraints.jacobian(*state(scene)[:2]).shape == (1, 0, 12)
