"""Forces, energies, momenta and index-1 accelerations: against potentials, power balances and bodies at rest."""

from __future__ import annotations

import dataclasses

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from crosscheck.references import truth
from crosscheck.scene import functions, mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import followed, starting
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import GROUND, Body, Force, Joint
from crosscheck.scene.states import States
from crosscheck.scene.vectors import shortest_rotation
from tests.scene_making import (
    DIFFERENCE,
    JOINT_TYPES,
    closed,
    derivative,
    drawn,
    jointed_pair,
    make_scene,
    moved,
    random_body,
    random_joint,
)

seeds = st.integers(0, 2**32 - 1)
EPS = np.finfo(float).eps
GRAVITY = 9.81


def spring_length(scene, x, R):
    force = scene.forces[0]
    p, parent = force.parameters, force.parent
    end = p["parent_point"] if parent == GROUND else x[parent] + R[parent] @ p["parent_point"]
    return np.linalg.norm(x[force.child] + R[force.child] @ p["child_point"] - end)


def one_state(x, R, v, w):
    return States(np.zeros(1), x[None], R[None], v[None], w[None])


def start(scene):
    return scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]


def springs(rng, parent, torsion=True, damping=0.0, loads=False):
    """Forces of every kind: between ground or the first body and the second, and in the joint named "joint"."""
    p = rng.uniform(-1, 1, size=(6, 3)).tolist()
    forces = [Force("linear_spring", parent, 1, None, {"parent_point": p[0], "child_point": p[1], "stiffness": 7.0,
                                                       "free_length": 0.5, "damping": damping})]
    if torsion:
        forces.append(Force("torsional_spring", None, None, "joint", {"stiffness": 3.0, "rest_angle": 0.4,
                                                                      "damping": damping}))
    if loads:
        forces += [Force("constant_force", None, 1, None, {"child_point": p[2], "frame": "world", "force": p[3]}),
                   Force("constant_force", None, 0, None, {"child_point": p[2], "frame": "body", "force": p[4]}),
                   Force("constant_torque", None, 1, None, {"frame": "world", "torque": p[5]}),
                   Force("constant_torque", None, 0, None, {"frame": "body", "torque": p[3]})]
    return forces


def driven(rng):
    """Loads with factors that depend on time, and a torque and a force along the joint named "joint"."""
    p = rng.uniform(-1, 1, size=(4, 3)).tolist()
    f = functions.sine([rng.uniform(-2, 2, 3).tolist()], 0.8)
    return [Force("constant_force", None, 1, None, {"child_point": p[0], "frame": "world", "force": p[1], "factor": f}),
            Force("constant_force", None, 1, None, {"child_point": p[0], "frame": "body", "force": p[1], "factor": f}),
            Force("constant_torque", None, 0, None, {"frame": "world", "torque": p[2], "factor": f}),
            Force("constant_torque", None, 1, None, {"frame": "body", "torque": p[3], "factor": f}),
            Force("torsional_spring", None, None, "joint", {"stiffness": 2.0, "rest_angle": f, "damping": 0.3}),
            Force("joint_torque", None, None, "joint", {"torque": f}),
            Force("joint_force", None, None, "joint", {"force": f})]


def aligned_pair(rng, parent, kind="revolute"):
    """Two bodies whose relative attitude is a rotation about the axes of the joint "joint"."""
    bodies = [random_body(rng, "first"), random_body(rng, "second")]
    joint = random_joint(rng, kind, parent, 1)
    frame = bodies[0].attitude[[1, 2, 3, 0]] if parent == 0 else np.array([0.0, 0.0, 0.0, 1.0])
    shortest = Rotation.from_matrix(shortest_rotation(joint.child_axis, joint.parent_axis))
    attitude = Rotation.from_quat(frame) * Rotation.from_rotvec(rng.uniform(-3, 3) * joint.parent_axis) * shortest
    bodies[1] = Body("second", bodies[1].mass, bodies[1].inertia, attitude.as_quat()[[3, 0, 1, 2]],
                     bodies[1].angular_velocity, bodies[1].position, bodies[1].velocity)
    return make_scene(bodies, [joint], springs(rng, parent))


@pytest.mark.parametrize("parent", [GROUND, 0])
@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_force_is_minus_the_derivative_of_the_potential(parent, seed):
    rng = np.random.default_rng(seed)
    scene = aligned_pair(rng, parent)
    direction = rng.uniform(-1, 1, size=(2, 6))
    x, R, still = scene.x0, scene.R0, np.zeros((2, 3))
    angle = mechanics.torsion_angles(scene, one_state(x, R, still, still))["joint"][0]
    length = spring_length(scene, x, R)
    assume(np.pi - abs(angle) > 0.01 and length > 0.1)  # no derivative at the angle's jump and the length's kink

    def potential(e):
        xe, Re = moved(x, R, e * direction)
        return mechanics.potential_energy(scene, one_state(xe, Re, still, still))[0]

    force = mechanics.applied_forces(scene, x[None], R[None], still[None], still[None])[0]
    # the fifth derivative of a length grows as 1 / length^4, so that the step falls with it
    slope = derivative(potential, 1e-3 * min(1, length))
    assert slope == pytest.approx(-force @ direction.ravel(), abs=100 * DIFFERENCE)


def path_energy(scene, u, rates):
    """Energy along a path that leaves the initial state with velocities `u` and their rates, both (n, 6)."""

    def at(t):
        xt, Rt = moved(scene.x0, scene.R0, t * u)
        ut = u + t * rates
        return mechanics.energy(scene, one_state(xt, Rt, ut[:, :3], ut[:, 3:]))[0]

    return at


@pytest.mark.parametrize("kind", JOINT_TYPES)
@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_power_of_dampers_and_loads_is_all_that_changes_the_energy(kind, seed):
    rng = np.random.default_rng(seed)
    torsion = kind in ("revolute", "cylindrical")
    forces = springs(rng, GROUND, torsion, damping=0.3, loads=True)
    scene = drawn(lambda: jointed_pair(rng, kind, forces))
    x, R, v, w = start(scene)
    a, alpha, _ = mechanics.index1(scene, x, R, v, w)
    u, rates = np.concatenate([v, w], -1)[0], np.concatenate([a, alpha], -1)[0]
    undamped = scene.replace(forces=tuple(springs_of(scene)))
    # force of dampers and loads = all forces less those of the conservative scene
    extra = mechanics.applied_forces(scene, x, R, v, w) - mechanics.applied_forces(undamped, x, R, v, w)
    kinetic = mechanics.kinetic_energy(scene, one_state(scene.x0, scene.R0, scene.v0, scene.w0))[0]
    expected = extra[0] @ u.ravel()
    # energies and their derivatives scale with velocity x force, some 10^3 W here; the path follows the joints
    size = 1 + kinetic + np.linalg.norm(rates) * np.linalg.norm(u)
    assume(spring_length(scene, scene.x0, scene.R0) > 0.1)
    assume(not torsion or np.pi - abs(mechanics.torsion_angles(scene, starting(scene))["joint"][0]) > 0.1)
    assert derivative(path_energy(scene, u, rates)) == pytest.approx(expected, abs=DIFFERENCE * 1e3 * size)


def springs_of(scene):
    for force in scene.forces:
        if force.type.endswith("spring"):
            yield Force(force.type, force.parent, force.child, force.joint, {**force.parameters, "damping": 0.0})


def test_dampers_take_energy_at_the_rate_of_their_definition():
    rng = np.random.default_rng(5)
    scene = aligned_pair(rng, 0)
    damped = scene.replace(forces=tuple(Force(f.type, f.parent, f.child, f.joint, {**f.parameters, "damping": 0.7})
                                        for f in scene.forces))
    x, R, v, w = start(scene)
    extra = mechanics.applied_forces(damped, x, R, v, w) - mechanics.applied_forces(scene, x, R, v, w)
    power = extra[0] @ np.concatenate([scene.v0, scene.w0], -1).ravel()
    u = np.concatenate([scene.v0, scene.w0], -1)

    def length(e):
        return spring_length(scene, *moved(scene.x0, scene.R0, e * u))

    def angle(e):
        state = one_state(*moved(scene.x0, scene.R0, e * u), scene.v0, scene.w0)
        return mechanics.torsion_angles(scene, state)["joint"][0]

    expected = -0.7 * (derivative(length) ** 2 + derivative(angle) ** 2)
    assert power == pytest.approx(expected, rel=DIFFERENCE * 100)


def test_constant_loads_by_hand():
    # a quarter turn about z: body x is world y, body y is world -x
    body = Body("b", 1.0, np.eye(3), [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], [0, 0, 0], [5.0, 6.0, 7.0], [0, 0, 0])
    point = (0.0, 0.0, 2.0)
    cases = [
        (Force("constant_force", None, 0, None, {"child_point": point, "frame": "world", "force": (3.0, 0, 0)}),
         [3, 0, 0, 6, 0, 0]),  # in body axes the force is (0, -3, 0), and (0, 0, 2) x (0, -3, 0) = (6, 0, 0)
        (Force("constant_force", None, 0, None, {"child_point": point, "frame": "body", "force": (3.0, 0, 0)}),
         [0, 3, 0, 0, 6, 0]),
        (Force("constant_torque", None, 0, None, {"frame": "world", "torque": (4.0, 0, 0)}), [0, 0, 0, 0, -4, 0]),
        (Force("constant_torque", None, 0, None, {"frame": "body", "torque": (4.0, 0, 0)}), [0, 0, 0, 4, 0, 0]),
    ]
    for force, expected in cases:
        scene = make_scene([body], [], [force], gravity=np.zeros(3))
        np.testing.assert_allclose(mechanics.applied_forces(scene, *start(scene))[0], expected, atol=20 * EPS)


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_vertical_momentum_of_a_hanging_chain_is_constant(seed):
    rng = np.random.default_rng(seed)
    bodies = [random_body(rng, "first"), random_body(rng, "second")]
    base = Joint("base", "spherical", GROUND, 0, np.array([0, 0, rng.uniform(-1, 1)]), rng.uniform(-1, 1, size=3))
    scene = closed(make_scene(bodies, [base, random_joint(rng, "universal", 0, 1)], springs(rng, 0, torsion=False)))
    x, R, v, w = start(scene)
    a, alpha, _ = mechanics.index1(scene, x, R, v, w)
    u, rates = np.concatenate([v, w], -1)[0], np.concatenate([a, alpha], -1)[0]

    def momentum(t):
        xt, Rt = moved(scene.x0, scene.R0, t * u)
        ut = u + t * rates
        return mechanics.momentum_vertical(scene, one_state(xt, Rt, ut[:, :3], ut[:, 3:]))[0]

    size = 1 + np.linalg.norm(rates) + np.linalg.norm(u) ** 2
    assert derivative(momentum) == pytest.approx(0, abs=DIFFERENCE * 100 * size)


def test_momentum_of_a_circling_body_by_hand():
    inertia = np.diag([0.2, 0.3, 0.4])
    body = Body("b", 2.0, inertia, [1, 0, 0, 0], [0, 0, 3.0], [1.5, 0, 0.7], [0, 4.0, 0])
    scene = make_scene([body], [])
    momentum = mechanics.momentum_vertical(scene, one_state(scene.x0, scene.R0, scene.v0, scene.w0))
    assert momentum == pytest.approx(2.0 * 1.5 * 4.0 + 0.4 * 3.0, rel=4 * EPS)  # m x v_y + J_z w_z
    sideways = scene.replace(gravity=np.array([0, -5.0, 0]))  # up is now y, about which neither body turns
    assert mechanics.momentum_vertical(sideways, one_state(scene.x0, scene.R0, scene.v0, scene.w0)) == 0


def test_energy_of_the_single_pendulum_by_hand():
    scene = load_scene("single_pendulum")
    # w = (.5, .3, 1), COM one metre down the body's z axis: v^2 = w_x^2 + w_y^2; height -cos(60 deg)
    kinetic = 0.5 * (0.5**2 + 0.3**2) + 0.5 * (0.1 * 0.5**2 + 0.2 * 0.3**2 + 0.15)
    state = one_state(scene.x0, scene.R0, scene.v0, scene.w0)
    assert mechanics.kinetic_energy(scene, state) == pytest.approx(kinetic, rel=10 * EPS)
    assert mechanics.energy(scene, state) == pytest.approx(kinetic - 0.5 * GRAVITY, rel=10 * EPS)


def test_plane_pendulum_accelerates_by_its_textbook_law():
    angle, mass, arm, moment = 0.7, 2.0, 0.8, 0.3
    body = Body("b", mass, np.diag([0.2, moment, 0.25]), [np.cos(angle / 2), 0, np.sin(angle / 2), 0], [0, 0, 0],
                [-arm * np.sin(angle), 0, -arm * np.cos(angle)], [0, 0, 0])
    axis = np.array([0.0, 1.0, 0.0])
    hinge = Joint("hinge", "revolute", GROUND, 0, np.zeros(3), np.array([0, 0, arm]), axis, axis)
    scene = make_scene([body], [hinge])
    a, alpha, lam = mechanics.index1(scene, *start(scene))
    expected = -mass * GRAVITY * arm * np.sin(angle) / (moment + mass * arm**2)
    np.testing.assert_allclose(alpha[0, 0], [0, expected, 0], rtol=0, atol=100 * EPS * abs(expected))
    # the joint balances the rest of gravity
    force, _ = Constraints(scene).reactions(scene.x0[None], scene.R0[None], lam)["hinge"]
    np.testing.assert_allclose(force[0], mass * (a[0, 0] + [0, 0, GRAVITY]), rtol=0, atol=100 * EPS * mass * GRAVITY)


def test_a_cantilever_carries_weight_and_moment():
    body = Body("beam", 3.0, np.diag([0.2, 0.3, 0.4]), [0.8, 0.6, 0, 0], [0, 0, 0], [2.0, 0, 0], [0, 0, 0])
    scene = closed(make_scene([body], [Joint("wall", "fixed", GROUND, 0, np.zeros(3), np.array([-2.0, 0, 0]))]))
    a, alpha, lam = mechanics.index1(scene, *start(scene))
    force, torque = Constraints(scene).reactions(scene.x0[None], scene.R0[None], lam)["wall"]
    rounding = 1000 * EPS * 3.0 * GRAVITY * 2  # the moment's size, times the condition of the six equations
    np.testing.assert_allclose(force[0], [0, 0, 3.0 * GRAVITY], rtol=0, atol=rounding)
    np.testing.assert_allclose(torque[0], [0, -2.0 * 3.0 * GRAVITY, 0], rtol=0, atol=rounding)  # r x (0, 0, m g)
    assert max(np.abs(a).max(), np.abs(alpha).max()) < rounding


def test_redundant_joints_share_the_load():
    scene = load_scene("single_pendulum")
    pivot = scene.joints[0]
    twin = Joint("twin", "spherical", pivot.parent, pivot.child, pivot.parent_anchor, pivot.child_anchor)
    a, alpha, lam = mechanics.index1(scene, *start(scene))
    a2, alpha2, lam2 = mechanics.index1(scene.replace(joints=(pivot, twin)), *start(scene))
    rounding = 1000 * EPS * GRAVITY  # a 3 x 3 solve of condition below 100
    np.testing.assert_allclose(a2, a, rtol=0, atol=rounding)
    np.testing.assert_allclose(alpha2, alpha, rtol=0, atol=rounding)
    np.testing.assert_allclose(lam2, np.concatenate([lam, lam], -1) / 2, rtol=0, atol=rounding)  # least norm


@pytest.mark.parametrize(("name", "taken"), [("four_bar", 0), ("bricard", 9), ("parallelogram", 9), ("squeezer", 9)])
@pytest.mark.parametrize("open_by", [0.0, 1e-9, 1e-4, 1e-2])
def test_redundant_rows_are_left_out_as_singular_values_do(name, taken, open_by, monkeypatch):
    """Against the dense pseudo-inverse of the rank at the first state, on paths and where all joints are open.

    Where joints are closed few states need singular values.
    """
    scene = load_scene(name).replace(samples=21)
    scene = scene.replace(duration=min(1.0, scene.duration))
    states, rng = truth(scene).states, np.random.default_rng(3)
    x, R, v, w = states.x.copy(), states.R.copy(), states.v, states.w
    x[1:] += open_by * rng.normal(size=x[1:].shape)
    R[1:] = R[1:] @ Rotation.from_rotvec(open_by * rng.normal(size=(20 * scene.n, 3))).as_matrix().reshape(
        R[1:].shape)
    constraints, batches = Constraints(scene), []
    G, gamma = constraints.jacobian(x, R), constraints.gamma(x, R, v, w, states.t)
    root = np.linalg.cholesky(mechanics.inverse_mass(scene))
    sigma = np.linalg.svd(G[0] @ root, compute_uv=False)
    rank = int((sigma > 1e-9 * sigma[0]).sum())
    assert rank < constraints.m
    svd = np.linalg.svd
    monkeypatch.setattr(np.linalg, "svd", lambda A, **options: batches.append(A) or svd(A, **options))
    a, alpha, lam = mechanics.index1(scene, x, R, v, w, t=states.t)
    monkeypatch.undo()
    if not open_by:
        assert sum(len(A) for A in batches if A.ndim == 3) <= taken
    free = mechanics.applied_forces(scene, x, R, v, w, t=states.t) @ root
    for k in range(len(x)):
        U, sigma, V = svd(G[k] @ root, full_matrices=False)
        U, sigma, V = U[:, :rank], sigma[:rank], V[:rank]
        # L^-1 du/dt is nearest to L^T f among all that obey the rows, lam of least norm.
        scaled = free[k] - V.T @ (V @ free[k] + U.T @ gamma[k] / sigma)
        wanted = (root @ scaled).reshape(scene.n, 6)
        of_rows = U @ ((V @ free[k] + U.T @ gamma[k] / sigma) / sigma)
        digits = 1e-12 * (sigma[0] / sigma[-1]) ** 2
        size = max(np.abs(wanted).max(), 1.0)
        assert max(np.abs(a[k] - wanted[:, :3]).max(), np.abs(alpha[k] - wanted[:, 3:]).max()) < digits * size
        assert np.abs(lam[k] - of_rows).max() < digits * max(np.abs(of_rows).max(), 1.0)


OPEN_TREES = ("branching_tree", "bead_on_line", "chain_8", "light_heavy", "thrown_double", "driven_cart")


@pytest.mark.parametrize("name", OPEN_TREES)
def test_sparse_and_dense_index1_systems_of_open_trees_agree(name, monkeypatch):
    scene = load_scene(name)
    states = [np.repeat(each, 2, axis=0) for each in start(scene)]
    dense = mechanics.index1(scene, *states, t=np.array([0.0, 0.1]))
    monkeypatch.setattr(mechanics, "FEW_BODIES", 0)
    monkeypatch.setattr(mechanics, "inverse_mass", None)  # what is dense is not made
    for some, others in zip(mechanics.index1(scene, *states, t=np.array([0.0, 0.1])), dense, strict=True):
        assert np.abs(some - others).max() < 1e-12 * np.abs(others).max()  # light_heavy spans four decades of masses


def test_a_rotor_of_any_size_leaves_the_other_accelerations_accurate():
    """Against the limit: the hinge does not turn faster, and the body is carried around."""
    scene = load_scene("hinge_pendulum")
    hinge = scene.joints[0]
    a, alpha, _ = mechanics.index1(scene.replace(joints=(dataclasses.replace(hinge, armature=(1e89,)),)), *start(scene))
    assert np.abs(alpha).max() < 1e-12
    arm, spin = -scene.R0[0] @ hinge.child_anchor, scene.R0[0] @ scene.w0[0]
    assert np.abs(a[0, 0] - np.cross(spin, np.cross(spin, arm))).max() < 1e-12


@pytest.mark.parametrize(("name", "rotor"), [
    ("light_heavy", 0.0), ("heavy_light", 0.0), ("double_pendulum", 0.0), ("geared_arm", 2e9)])
def test_accelerations_agree_with_forty_digits(name, rotor):
    """M u' + G^T lam = f, G u' = -gamma: elimination may lose no digits, nor may a rotor heavy beside its body."""
    scene = load_scene(name)
    if rotor:
        scene = scene.replace(joints=tuple(dataclasses.replace(each, armature=(rotor,)) for each in scene.joints))
    at = (scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    constraints = Constraints(scene)
    G, gamma = constraints.jacobian(*at[:2])[0], constraints.gamma(*at)[0]
    size = 6 * scene.n
    with mpmath.workdps(40):
        whole = mpmath.zeros(size + len(G))
        whole[size:, :size], whole[:size, size:] = mpmath.matrix(G), mpmath.matrix(G.T)
        right = mpmath.matrix(np.concatenate([mechanics.applied_forces(scene, *at)[0], -gamma]))
        M = mpmath.matrix(mechanics.inverse_mass(scene)) ** -1
        for inertia, S, bias in mechanics.rotors(scene, *at):
            along = mpmath.matrix(S[0])
            M += mpmath.mpf(inertia) * along * along.T
            right[:size] -= mpmath.mpf(inertia) * mpmath.mpf(bias[0]) * along
        whole[:size, :size] = M
        exact = np.array(mpmath.lu_solve(whole, right), dtype=float).ravel()
    a, alpha, lam = mechanics.index1(scene, *at)
    found = np.concatenate([np.concatenate([a[0], alpha[0]], axis=1).ravel(), lam[0]])
    for some, others in ((found[:size], exact[:size]), (found, exact)):
        assert np.abs(some - others).max() < 1e-13 * np.abs(others).max()


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_free_body_feels_gravity_and_eulers_torque_only(seed):
    scene = make_scene([random_body(np.random.default_rng(seed), "free")], [])
    a, alpha, lam = mechanics.index1(scene, *start(scene))
    body = scene.bodies[0]
    assert lam.shape == (1, 0)
    np.testing.assert_allclose(a[0, 0], scene.gravity, rtol=4 * EPS)
    residual = body.inertia @ alpha[0, 0] + np.cross(body.angular_velocity, body.inertia @ body.angular_velocity)
    np.testing.assert_allclose(residual, 0, atol=1000 * EPS * 50)  # torques up to 50 N m, inertia of condition < 50


def test_a_thin_body_is_not_spun_up_by_rounding():
    """J alpha = -w x J w of needles along each axis, whose moment about it is a millionth of those across."""
    rng = np.random.default_rng(5)
    w = rng.normal(size=(50, 1, 3))
    states = [np.broadcast_to(each, (50, *each.shape)) for each in (np.zeros((1, 3)), np.eye(3)[None])]
    for axis in range(3):
        J = np.diag(np.where(np.arange(3) == axis, 1e-7, rng.uniform(0.1, 1.0)))
        scene = make_scene([Body("needle", 1.0, J, *[[1, 0, 0, 0], *[[0, 0, 0]] * 3])], [], gravity=np.zeros(3))
        alpha = mechanics.index1(scene, *states, np.zeros_like(w), w)[1]
        with mpmath.workdps(40):
            I = [mpmath.mpf(moment) for moment in np.diag(J)]
            exact = [[(I[j] - I[k]) * spin[j] * spin[k] / I[i] for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))]
                     for spin in w[:, 0].tolist()]
        assert np.abs(alpha[:, 0] - np.array(exact, dtype=float)).max() < 1e-15 * (w**2).sum(axis=-1).max()


def test_spring_of_zero_length_exerts_no_force():
    body = Body("b", 1.0, np.eye(3), [1, 0, 0, 0], [0, 0, 0], [0, 0, 0], [1.0, 0, 0])
    spring = Force("linear_spring", GROUND, 0, None, {"parent_point": (0, 0, 0), "child_point": (0, 0, 0),
                                                      "stiffness": 10.0, "free_length": 0.5, "damping": 1.0})
    scene = make_scene([body], [], [spring], gravity=np.zeros(3))
    assert not mechanics.applied_forces(scene, *start(scene)).any()


def spun(rate, times):
    """A body that turns steadily about the axis of its hinge, which carries a spring."""
    axis = np.array([0.0, 0.6, 0.8])
    hinge = Joint("hinge", "revolute", GROUND, 0, np.zeros(3), np.zeros(3), axis, axis)
    body = Body("b", 1.0, np.eye(3), [1, 0, 0, 0], rate * axis, [0, 0, 0], [0, 0, 0])
    spring = Force("torsional_spring", None, None, "hinge", {"stiffness": 2.0, "rest_angle": 0.4, "damping": 0.0})
    R = Rotation.from_rotvec(rate * times[:, None] * axis).as_matrix()[:, None]
    return make_scene([body], [hinge], [spring]), R, np.broadcast_to(rate * axis, (len(times), 1, 3))


def turning(R, w, times):
    still = np.zeros((len(times), 1, 3))
    return States(times, still, R, still, w)


@pytest.mark.parametrize("rate", [5.0, -7.0])
def test_torsion_angle_counts_full_turns(rate):
    times = np.linspace(0, 10, 501)  # a seventh of a radian at a time
    scene, R, w = spun(rate, times)
    angle = mechanics.torsion_angles(scene, turning(R, w, times))["hinge"]
    np.testing.assert_allclose(angle, rate * times, rtol=0, atol=10 * EPS * abs(rate) * 10)
    still = np.zeros((501, 1, 3))
    torque = mechanics.applied_forces(scene, still, R, still, still)
    expected = -2.0 * (rate * times - 0.4)[:, None] * [0, 0.6, 0.8]
    np.testing.assert_allclose(torque[:, 3:], expected, rtol=0, atol=100 * EPS * 2 * abs(rate) * 10)


def test_turns_are_those_that_the_source_counted_or_not_known():
    times = np.linspace(0, 10, 11)
    scene, R, w = spun(9.0, times)  # 1.4 turns a sample: nothing in the samples tells how many
    states = turning(R, w, times)
    assert np.isnan(mechanics.torsion_angles(scene, states)["hinge"][1:]).all()
    assert np.isnan(mechanics.energy(scene, states)[1:]).all()
    states.hinges = 9.0 * times[:, None] + 0.1  # only whole turns are taken from it
    angle = mechanics.torsion_angles(scene, states)["hinge"]
    np.testing.assert_allclose(angle, 9.0 * times, rtol=0, atol=100 * EPS * 90)


def test_a_source_follows_its_steps_in_batches():
    times = np.linspace(0, 10, 51)  # 1.8 rad a step
    scene, R, w = spun(9.0, times)
    states = turning(R, w, times)
    before, angles = starting(scene), []
    before.hinges = np.zeros((1, 1))
    for part in (slice(0, 20), slice(20, 51)):
        here = states.at(part)
        here.hinges = followed(scene, here, before)
        before = here.at(slice(-1, None))
        angles.append(here.hinges[:, 0])
    np.testing.assert_allclose(np.concatenate(angles), 9.0 * times, rtol=0, atol=100 * EPS * 90)


@given(seed=seeds)
@settings(max_examples=50, deadline=None)
def test_shortest_rotation_takes_one_axis_to_the_other_about_their_normal(seed):
    rng = np.random.default_rng(seed)
    start_axis, end = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    Q = shortest_rotation(start_axis, end)
    rounding = 100 * EPS / (1 + start_axis @ end)  # near opposite axes the normal is the small difference of large ones
    np.testing.assert_allclose(Q @ start_axis, end, rtol=0, atol=rounding)
    normal = np.cross(start_axis, end)
    np.testing.assert_allclose(Q @ normal, normal, rtol=0, atol=rounding)
    np.testing.assert_allclose(Q.T @ Q, np.eye(3), rtol=0, atol=rounding)


def test_opposite_axes_turn_about_the_first_reference_vector():
    z = np.array([0.0, 0.0, 1.0])
    np.testing.assert_array_equal(shortest_rotation(-z, z), np.diag([1.0, -1.0, -1.0]))


def test_orthogonality_is_the_largest_entry_over_all_bodies():
    R = np.broadcast_to(np.eye(3), (2, 3, 3, 3)).copy()
    R[1, 2, 0, 1] = 0.25
    np.testing.assert_array_equal(mechanics.orthogonality(R), [0.0, 0.25])
