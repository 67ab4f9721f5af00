"""Initial states: open positions and velocities, the check of given ones, projection and assembly."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from crosscheck.scene import assembly
from crosscheck.scene.checks import Draft
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.file import load_scene
from crosscheck.scene.mechanics import RANK_TOLERANCE
from crosscheck.scene.model import GROUND, Body, Joint, rotation_from_quaternion
from crosscheck.scene.schema import EntryError
from tests.scene_making import JOINT_TYPES, closed, drawn, jointed_pair, make_scene, moved, random_body, random_joint

seeds = st.integers(0, 2**32 - 1)
EPS = np.finfo(float).eps


def residuals(scene, constraints=None):
    """Largest violation in position and in velocity."""
    constraints = constraints or Constraints(scene)
    state = scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]
    levels = constraints.position(*state[:2]), constraints.velocity(*state)
    return tuple(np.abs(rows).max(initial=0) for rows in levels)


def lengths(scene):
    """Bounds on 50 eps of the terms of Phi and of G u."""
    anchors = [np.abs(a).max() for joint in scene.joints for a in (joint.parent_anchor, joint.child_anchor)]
    length = 1 + np.abs(scene.x0).max() + 3 * max(anchors)
    return 50 * EPS * length, 50 * EPS * (np.abs(scene.v0).max() + 3 * length * (1 + np.abs(scene.w0).max()))


def complete(scene, positions=True, velocities=True, assemble=False):
    flags = [(value,) * scene.n if isinstance(value, bool) else value for value in (positions, velocities)]
    return assembly.completed(Draft(scene, *flags, assemble))


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_open_states_of_a_ball_jointed_tree_close_it(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    order = rng.permutation(n)  # the bodies stand in the file in any order, and so do the joints
    joints = [random_joint(rng, "spherical", int(order[rng.integers(0, k)]) if k else GROUND, int(order[k]), f"j{k}")
              for k in range(n)]
    scene = make_scene([random_body(rng, f"b{k}") for k in range(n)], [joints[k] for k in rng.permutation(n)])
    found = complete(scene, False, False)
    for size, bound in zip(residuals(found), lengths(found), strict=True):
        assert size <= bound
    np.testing.assert_array_equal(found.w0, scene.w0)
    np.testing.assert_array_equal(found.R0, scene.R0)


@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_open_position_lets_the_anchors_meet_or_hang(kind):
    rng = np.random.default_rng(3)
    bodies = [random_body(rng, "first"), random_body(rng, "second")]
    still = [dataclasses.replace(body, angular_velocity=np.zeros(3), velocity=np.zeros(3)) for body in bodies]
    axis = np.array([1.0, 0, 0])
    bare = random_joint(rng, kind, 0, 1)
    # axes along world x and y, so that the given attitudes close every type
    R = [body.attitude[[1, 2, 3, 0]] for body in bodies]
    local = [Rotation.from_quat(q).inv().apply(axis) for q in R]
    across = Rotation.from_quat(R[1]).inv().apply([0, 1.0, 0])
    joint = dataclasses.replace(bare, parent_axis=None if bare.parent_axis is None else local[0],
                                child_axis=None if bare.child_axis is None
                                else across if kind == "universal" else local[1])
    found = complete(make_scene(still, [joint]), (True, False), False)
    gap = (found.x0[1] + found.R0[1] @ joint.child_anchor - found.x0[0] - found.R0[0] @ joint.parent_anchor)
    np.testing.assert_allclose(gap, [0, 0, -0.7 if kind == "distance" else 0], rtol=0, atol=lengths(found)[0])


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_open_velocity_is_that_of_a_rigid_pair_when_both_spin_alike(seed):
    rng = np.random.default_rng(seed)
    spin = rng.uniform(-2, 2, size=3)
    joint = random_joint(rng, "point_on_line", 0, 1)
    bodies = [random_body(rng, "first"), random_body(rng, "second")]
    R = [rotation_from_quaternion(body.attitude) for body in bodies]
    on_line = joint.parent_anchor + rng.uniform(-1, 1) * joint.parent_axis
    place = bodies[0].position + R[0] @ on_line - R[1] @ joint.child_anchor
    bodies = [dataclasses.replace(body, angular_velocity=turn.T @ spin, position=position)
              for body, turn, position in zip(bodies, R, (bodies[0].position, place), strict=True)]
    found = complete(make_scene(bodies, [joint]), True, (True, False))
    expected = found.v0[0] + np.cross(spin, found.x0[1] - found.x0[0])
    np.testing.assert_allclose(found.v0[1], expected, rtol=0, atol=lengths(found)[1])


def test_joints_whose_anchors_coincide_place_a_body_before_others_do():
    rng = np.random.default_rng(6)
    ball = random_joint(rng, "spherical", GROUND, 0, "ball")
    arm = ball.parent_anchor - rotation_from_quaternion((body := random_body(rng, "b")).attitude) @ ball.child_anchor
    plane = dataclasses.replace(random_joint(rng, "point_on_plane", GROUND, 0, "plane"), child_anchor=np.zeros(3))
    # the plane passes through where the ball puts the body, far from the plane's own anchor
    beside = np.cross(plane.parent_axis, [0.3, 0.8, 0.1]) * 5
    plane = dataclasses.replace(plane, parent_anchor=arm + beside)
    found = complete(make_scene([body], [plane, ball]), False, True, assemble=True)
    np.testing.assert_allclose(found.x0[0], arm, rtol=0, atol=lengths(found)[0])


def test_a_parent_is_placed_from_its_child():
    rng = np.random.default_rng(11)
    scene = make_scene([random_body(rng, "first"), random_body(rng, "second")], [random_joint(rng, "spherical", 0, 1)])
    found = complete(scene, (False, True), (False, True))
    np.testing.assert_array_equal(found.x0[1], scene.x0[1])
    assert residuals(found)[0] <= lengths(found)[0]
    assert residuals(found)[1] <= lengths(found)[1]


def test_a_floating_chain_without_velocities_starts_with_its_first_body_at_rest():
    rng = np.random.default_rng(11)
    scene = make_scene([random_body(rng, "first"), random_body(rng, "second")], [random_joint(rng, "spherical", 0, 1)])
    found = complete(scene, (True, False), False)
    np.testing.assert_array_equal(found.v0[0], np.zeros(3))
    assert residuals(found)[1] <= lengths(found)[1]


def test_a_body_that_nothing_places_is_named():
    rng = np.random.default_rng(2)
    bodies = [random_body(rng, name) for name in ("first", "second", "third")]
    joints = [random_joint(rng, "spherical", GROUND, 0), random_joint(rng, "spherical", 1, 2, "other")]
    scene = make_scene(bodies, joints)
    with pytest.raises(EntryError, match=r'bodies\[1\] "second": position: missing') as caught:
        complete(scene, False, False)
    assert "add position" in str(caught.value)


def pushed(scene, direction, size, field):
    last = scene.bodies[-1]
    other = dataclasses.replace(last, **{field: getattr(last, field) + size * np.asarray(direction)})
    return scene.replace(bodies=(*scene.bodies[:-1], other))


@pytest.mark.parametrize(("field", "size", "words"), [
    ("position", 2e-8, "in position by 2e-08 m (allowed 1e-08)"),
    ("velocity", 3e-8, "in velocity by 3e-08 m/s (allowed 1.16e-08)"),  # |w| = 1.158 rad/s on the upper body
])
def test_a_state_off_its_joints_is_refused_by_the_joint_it_violates(field, size, words):
    scene = load_scene("double_pendulum")
    with pytest.raises(EntryError) as caught:
        complete(pushed(scene, [0, 1, 0], size, field))
    text = str(caught.value)
    assert text.startswith('joints[1] "elbow": the given state violates it ')
    assert words in text
    assert f'correct {field} or ' in text
    assert '"upper" or "lower"' in text
    assert "assemble = true" in text


@pytest.mark.parametrize("field", ["position", "velocity"])
def test_a_state_a_little_off_is_brought_to_rounding_level(field):
    scene = load_scene("double_pendulum")
    found = complete(pushed(scene, [0, 1, 0], 8e-9, field))
    for size, bound in zip(residuals(found), lengths(found), strict=True):
        assert size <= bound
    assert np.abs(found.x0 - scene.x0).max() < 1e-8  # no further than the joint was open
    assert np.abs(found.v0 - scene.v0).max() < 1e-8


def test_a_closed_state_is_kept_to_the_last_bit():
    scene = load_scene("triple_pendulum")
    assert complete(scene).hash == scene.hash


def test_allowed_violation_grows_with_the_largest_anchor():
    rng = np.random.default_rng(8)
    scene = complete(make_scene([random_body(rng, "b")], [Joint("j", "spherical", GROUND, 0, np.array([0, 0, 50.0]),
                                                                np.zeros(3))]), False, False)
    assert residuals(complete(pushed(scene, [1, 0, 0], 4e-7, "position")))[0] <= 50 * EPS * 50
    with pytest.raises(EntryError, match="allowed 5e-07"):
        complete(pushed(scene, [1, 0, 0], 6e-7, "position"))


def test_misaligned_axes_are_refused_without_a_unit():
    axis = np.array([0.0, 0.0, 1.0])
    body = Body("b", 1.0, np.eye(3), [1, 0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0])
    joint = Joint("hinge", "revolute", GROUND, 0, np.zeros(3), np.zeros(3), axis, np.array([0.6, 0.0, 0.8]))
    with pytest.raises(EntryError, match=r"in position by 0.6 \(allowed 1e-08\)"):
        complete(make_scene([body], [joint]))


@pytest.mark.parametrize("kind", JOINT_TYPES)
@given(seed=seeds)
@example(seed=25083610)  # of a revolute joint: more than half a turn is not the shorter way round
@settings(max_examples=8, deadline=None)
def test_assembled_states_close_every_joint_with_the_least_change(kind, seed):
    rng = np.random.default_rng(seed)
    guesses = []
    found = drawn(lambda: guesses.append(jointed_pair(rng, kind)) or guesses[-1])
    guess = guesses[-1]
    constraints = Constraints(guess)  # with the relative attitudes of the guess, which is what assembly keeps
    sizes, bounds = residuals(found, constraints), lengths(found)
    assert sizes[0] <= bounds[0]
    assert sizes[1] <= 10 * bounds[1]  # a least-norm solve of condition below 10 between the rates and their rounding
    G = constraints.jacobian(found.x0[None], found.R0[None])[0]
    rank = np.linalg.matrix_rank(G, tol=RANK_TOLERANCE)
    free = np.linalg.svd(G)[2][rank:]
    # on the manifold the weighted distance to the guess is stationary: its slope along every free direction vanishes
    for direction in free:
        h = 1e-4
        slope = (distance(guess, found, h * direction) - distance(guess, found, -h * direction)) / (2 * h)
        # central difference of a smooth function of size up to 50, third derivative of its size
        assert abs(slope) < 1e-6 * (1 + distance(guess, found, 0 * direction))
    # and of all velocities with G u = 0 these are the nearest: the change is mass-orthogonal to every free direction
    change = np.concatenate([found.v0 - guess.v0, found.w0 - guess.w0], -1)
    weighted = np.concatenate([guess.masses[:, None] * change[:, :3],
                               np.einsum("nij,nj->ni", guess.inertias, change[:, 3:])], -1)
    assert np.abs(free @ weighted.ravel()).max(initial=0) < 1e-11  # 1e3 eps of momenta up to 20


def distance(guess, found, step):
    """Half the mass-weighted square of the displacement from the guess, a step away from the found state."""
    x, R = moved(found.x0, found.R0, step.reshape(-1, 6))
    shift, turn = x - guess.x0, (Rotation.from_matrix(guess.R0).inv() * Rotation.from_matrix(R)).as_rotvec()
    return 0.5 * (np.einsum("n,ni,ni", guess.masses, shift, shift) + np.einsum("ni,nij,nj", turn, guess.inertias, turn))


def four_bar(closing_anchor=(2.0, 0.0, 0.0), tilt=0.0):
    """A parallelogram of three bars with four hinges about y: three of its equations are redundant."""
    y = np.array([0.0, 1.0, 0.0])
    half = np.array([0, 0, 0.5]), np.array([1.0, 0, 0])
    inertia = np.diag([0.3, 0.4, 0.2])
    tilted = [np.cos(tilt / 2), 0, np.sin(tilt / 2), 0]
    bars = [Body("crank", 1.0, inertia, tilted, [0, 0.3, 0], [0, 0, 0.5], [0.15, 0, 0]),
            Body("rod", 2.0, inertia, [1, 0, 0, 0], [0, 0, 0], [1.0, 0, 1.0], [0.3, 0, 0]),
            Body("rocker", 1.0, inertia, [1, 0, 0, 0], [0, 0.3, 0], [2.0, 0, 0.5], [0.15, 0, 0])]
    joints = [Joint("a", "revolute", GROUND, 0, np.zeros(3), -half[0], y, y),
              Joint("b", "revolute", 0, 1, half[0], -half[1], y, y),
              Joint("c", "revolute", 1, 2, half[1], half[0], y, y),
              Joint("d", "revolute", GROUND, 2, np.array(closing_anchor), -half[0], y, y)]
    return make_scene(bars, joints)


def test_a_closed_loop_with_redundant_rows_is_accepted_as_it_is():
    scene = four_bar()
    assert np.linalg.matrix_rank(Constraints(scene).jacobian(scene.x0[None], scene.R0[None])[0]) == 17  # of 20 rows
    assert complete(scene).hash == scene.hash


def test_a_loop_with_redundant_rows_is_assembled_from_a_guess():
    found = complete(four_bar(tilt=0.2), assemble=True)
    for size, bound in zip(residuals(found), lengths(found), strict=True):
        assert size <= bound


@pytest.mark.parametrize(("kind", "seed"), [("distance", 13347), ("distance", 13555), ("revolute", 341)])
def test_guesses_from_which_no_least_change_is_found_are_closed(kind, seed):
    rng = np.random.default_rng(seed)
    scene = drawn(lambda: jointed_pair(rng, kind))
    assert np.abs(Constraints(scene).position(scene.x0[None], scene.R0[None])).max() < 500 * np.finfo(float).eps


def test_a_loop_that_cannot_close_names_the_joint_with_the_largest_gap():
    scene = four_bar(closing_anchor=(9.0, 0.0, 0.0))  # three bars of 1 + 2 + 1 m over 9 m
    with pytest.raises(EntryError) as caught:
        complete(scene, assemble=True)
    text = str(caught.value)
    assert text.startswith('joints[')
    assert "cannot be closed together" in text
    assert "check its anchors" in text
    # 5 m are missing, and least squares leaves as much in each of the four hinges
    gap = float(text.split("largest gap, ")[1].split(" m")[0])
    assert 5 / 4 - 0.01 <= gap < 5.0


def test_a_state_that_has_drifted_is_closed_to_the_attitudes_that_the_scene_keeps():
    scene = load_scene("prismatic_slider")
    body = scene.bodies[1]
    turned = dataclasses.replace(body, attitude=np.asarray(body.attitude) + 1e-6 * np.array([0.0, 1.0, -2.0, 3.0]))
    off = scene.replace(bodies=(scene.bodies[0], turned))
    rows = Constraints(scene)
    assert residuals(assembly.closed(off, scene), rows)[0] < 1e-14 < 1e-8 < residuals(assembly.closed(off), rows)[0]


def test_assembly_keeps_the_relative_attitude_of_a_fixed_joint():
    rng = np.random.default_rng(9)
    guess = jointed_pair(rng, "fixed")
    found = closed(guess)
    np.testing.assert_allclose(found.R0[0].T @ found.R0[1], guess.R0[0].T @ guess.R0[1], rtol=0, atol=50 * EPS)


@pytest.mark.parametrize("name", ["rolling_disk", "wobbling_disk", "rolling_ball"])
def test_what_rolls_stands_on_its_plane(name):
    scene = load_scene(name)
    bodies = tuple(dataclasses.replace(body, position=np.zeros(3)) for body in scene.bodies)
    draft = Draft(scene.replace(bodies=bodies), (False,), (True,), False)
    assert assembly.completed(draft).x0[0, 2] == pytest.approx(scene.x0[0, 2], abs=1e-14)
