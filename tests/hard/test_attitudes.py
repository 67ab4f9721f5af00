"""Attitudes at the worst places, each with an exact property."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

import crosscheck
import lieeuler
from crosscheck.scene.model import GROUND, Body, Joint
from tests.hard.methods import FIXED, MOMENTUM
from tests.scene_making import make_scene

EPS = np.finfo(float).eps
INERTIA = np.diag([0.1, 0.2, 0.15])
STEP = 0.01


def body(inertia=INERTIA, attitude=(1.0, 0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0), position=(0.0, 0.0, 0.0)):
    return Body("body", 1.0, inertia, np.array(attitude), np.array(rate), np.array(position), np.zeros(3))


@pytest.mark.parametrize("angle", [np.pi - 1e-3, np.pi - 1e-9, np.pi, np.pi + 1e-3])
@pytest.mark.parametrize("method", FIXED)
def test_half_a_turn_per_step_about_a_principal_axis(method, angle):
    """The angular velocity is constant: with the exponential map every method is exact; from pi on, where the logarithm
    of a step ends, Runge-Kutta methods may instead say that this is beyond their domain."""
    rate = angle / STEP
    attitude = np.array([0.9, 0.1, -0.4, 0.2])
    scene = make_scene([body(attitude=attitude / np.linalg.norm(attitude), rate=(0.0, 0.0, rate))], [],
                       gravity=np.zeros(3), duration=20 * STEP, samples=21)
    if angle >= np.pi and lieeuler.METHODS[method].tableau is not None:
        try:
            traj = crosscheck.run(scene, "lieeuler", method, step=STEP)
        except lieeuler.IntegrationError as error:
            if error.status is lieeuler.Status.MAP_DOMAIN:
                return
            raise
    else:
        traj = crosscheck.run(scene, "lieeuler", method, step=STEP)
    exact = scene.R0[0] @ Rotation.from_rotvec(np.outer(scene.t, [0.0, 0.0, rate])).as_matrix()
    # the angle 20 pi is itself rounded, and each of 20 products of rotations adds a rounding
    assert np.abs(traj.R[:, 0] - exact).max() < 50 * EPS * (rate * scene.duration)
    assert np.abs(traj.w[:, 0] - [0.0, 0.0, rate]).max() < 50 * EPS * rate * np.sqrt(20)


def inverted(rate=(0.0, 0.0, 0.0)):
    joint = Joint("pivot", "spherical", GROUND, 0, np.zeros(3), np.array([0.0, 0.0, -1.0]))
    return make_scene([body(rate=rate, position=(0.0, 0.0, 1.0))], [joint], duration=1.0, samples=11)


@pytest.mark.parametrize("rate", [0.0, 5.0])
@pytest.mark.parametrize("method", FIXED)
def test_an_exactly_inverted_pendulum_stays_where_it_is(method, rate):
    """At rest, and turning about the vertical: equilibria, though unstable ones."""
    traj = crosscheck.run(inverted((0.0, 0.0, rate)), "lieeuler", method, step=STEP)
    # a rounding grows by at most exp(3.1 T), sqrt(m g l / J) = 3.1 1/s; a hundred steps make one each
    assert np.abs(traj.x[:, 0] - [0.0, 0.0, 1.0]).max() < 100 * 50 * EPS * np.exp(3.1)


def test_an_inverted_pendulum_off_by_one_rounding_falls_as_linear_theory_says():
    """From 1e-12 rad the angle grows as cosh: no threshold in the kernel swallows small angles."""
    tilt = 1e-12
    turn = Rotation.from_rotvec([tilt, 0.0, 0.0])
    scene = inverted()
    start = body(attitude=np.roll(turn.as_quat(), 1), position=turn.apply([0.0, 0.0, 1.0]))
    scene = scene.replace(bodies=(start,))
    traj = crosscheck.run(scene, "lieeuler", "rattle4", step=STEP)
    growth = np.sqrt(9.81 / (0.1 + 1.0))
    angle = np.arcsin(traj.R[:, 0, 2, 1])
    # relative: 1e-16 of rounding per step against 1e-12 of angle, a hundred steps
    np.testing.assert_allclose(angle, tilt * np.cosh(growth * scene.t), rtol=1e-2)


FLIP = np.diag([0.1, 0.2, 0.29])
RATE = np.array([0.25, 5.0, 0.0])


def flipping(duration, samples):
    return make_scene([body(FLIP, rate=RATE)], [], gravity=np.zeros(3), duration=duration, samples=samples)


def exact_rates(t):
    """Euler's equations by Jacobi's functions, Landau and Lifshitz, Mechanics, section 37: w2 is largest at t = 0."""
    J1, J2, J3 = np.diag(FLIP)
    energy, momentum = J1 * RATE[0] ** 2 + J2 * RATE[1] ** 2, (J1 * RATE[0]) ** 2 + (J2 * RATE[1]) ** 2
    first = np.sqrt((energy * J3 - momentum) / (J1 * (J3 - J1)))
    third = np.sqrt((momentum - energy * J1) / (J3 * (J3 - J1)))
    m = 1.0 - (RATE[0] / first) ** 2
    sn, cn, dn, _ = ellipj((J3 - J1) * first * third / (J2 * RATE[1]) * t + ellipk(m), m)
    return np.stack([first * dn, RATE[1] * sn, third * cn], axis=-1)


def test_a_body_flips_about_its_intermediate_axis_as_jacobi_says():
    scene = flipping(20.0, 201)
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
    exact = exact_rates(scene.t)
    assert np.count_nonzero(np.diff(np.sign(exact[:, 1]))) >= 6
    # rtol 1e-13 at 100 rad: each of the flips magnifies by the 20 of its start, w2 / w1, and they add up
    assert np.abs(traj.w[:, 0] - exact).max() < 1e-13 * 100 * 20 * 6 * RATE[1]


@pytest.mark.parametrize("method", MOMENTUM)
def test_angular_momentum_holds_over_many_flips(method):
    """Methods in momentum form carry the momentum itself: in world axes it is constant to rounding, at any step."""
    traj = crosscheck.run(flipping(100.0, 101), "lieeuler", method, step=STEP)
    momentum = np.einsum("tij,jk,tk->ti", traj.R[:, 0], FLIP, traj.w[:, 0])
    size = np.linalg.norm(momentum[0])
    # 1e4 steps, and steps of compositions, each a few roundings of a product of rotations
    assert np.abs(momentum - momentum[0]).max() < 50 * EPS * size * 1e4**0.6
    assert np.sum(np.diff(np.sign(traj.w[:, 0, 1])) != 0) > 10


@pytest.mark.parametrize("method", ["rattle2", "rattle4", "rattle8"])
def test_a_thousand_flips_keep_energy_and_momentum(method):
    """3.1 s to a flip; a symmetric and symplectic method has no trend in the energy."""
    traj = crosscheck.run(flipping(3300.0, 3301), "lieeuler", method, step=STEP)
    momentum = np.einsum("tij,jk,tk->ti", traj.R[:, 0], FLIP, traj.w[:, 0])
    steps = 3.3e5
    assert np.abs(momentum - momentum[0]).max() < 50 * EPS * np.linalg.norm(momentum[0]) * steps**0.6
    error = (traj.energy - traj.energy[0]) / traj.energy[0]
    band = np.ptp(error) + 50 * EPS * steps**0.6
    assert abs(np.polyfit(traj.t, error, 1)[0]) * traj.t[-1] < 0.05 * band


def in_body_axes(scene, turn):
    """The same body with other axes drawn on it: nothing that the world sees changes."""
    (old,), (joint,) = scene.bodies, scene.joints
    attitude = Rotation.from_matrix(scene.R0[0] @ turn).as_quat(scalar_first=True)
    fresh = dataclasses.replace(old, inertia=turn.T @ old.inertia @ turn, attitude=attitude,
                                angular_velocity=turn.T @ old.angular_velocity)
    moved = dataclasses.replace(joint, child_anchor=turn.T @ joint.child_anchor)
    return scene.replace(bodies=(fresh,), joints=(moved,))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("engine", "method"), [("lieeuler", "rkmk4"), ("mujoco", "RK4"), ("pinocchio", "RKMK4"),
                                                ("exudyn", "RK44")])
def test_an_engine_starts_well_from_a_gimbal_lock_of_any_axis(engine, method, axis):
    """A quarter turn about an axis of the body is the lock of some order of angles: with axes drawn such that the body
    starts there, no digit may be lost."""
    scene = crosscheck.load_scene("single_pendulum").replace(duration=0.5, samples=6)
    lock = Rotation.from_rotvec(np.pi / 2 * np.eye(3)[axis]).as_matrix()
    turned = in_body_axes(scene, scene.R0[0].T @ lock)
    plain, locked = (crosscheck.run(each, engine, method, step=1e-3) for each in (scene, turned))
    exact = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
    error = np.abs(plain.x - exact.x).max()
    # other angles, other constants of the same order: more than tenfold would be a lock, and below 1e-12 is rounding
    assert np.abs(locked.x - exact.x).max() < 10 * error + 1e-12


NEARLY_A_SPHERE = np.diag([0.1, 0.1 + 1e-7, 0.1 + 2e-7])


@pytest.mark.parametrize("method", FIXED)
def test_a_body_that_is_nearly_a_sphere_turns_steadily(method):
    """Moments differ by a millionth: so may the angular velocity change a radian, and no faster."""
    rate = np.array([1.0, -2.0, 0.5])
    scene = make_scene([body(NEARLY_A_SPHERE, rate=rate)], [], gravity=np.zeros(3), duration=2.0, samples=11)
    traj = crosscheck.run(scene, "lieeuler", method, step=STEP)
    speed = np.linalg.norm(rate)
    change = 2e-6 * speed**2 * scene.duration  # |J^-1 (w x J w)| is at most w^2 times the share by which moments differ
    assert np.abs(traj.w[:, 0] - rate).max() < change
    exact = scene.R0[0] @ Rotation.from_rotvec(np.outer(scene.t, rate)).as_matrix()
    assert np.abs(traj.R[:, 0] - exact).max() < change * scene.duration
