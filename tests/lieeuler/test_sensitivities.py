"""Sensitivities: against complex steps through other code for the same discrete maps, closed forms, and orders."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

import lieeuler
from lieeuler import METHODS, Servo, Stops
from tests import oracle
from tests.lieeuler.systems import GRAVITY, UP, chain
from tests.lieeuler.test_laws import AXIS, INERTIA, one

SMALL = 1e-25
STEP = 0.02
MAPS = (*lieeuler.EULER_METHODS, "INDEX1_LE", "BAUMGARTE_LE", "generalized_alpha", "rattle2", "rattle4", "rattle6",
        "rattle8")


def pendulum():
    return chain([1.0, 0.7], [np.diag([0.1, 0.2, 0.15]), np.diag([0.06, 0.1, 0.09])],
                 [(np.zeros(3), UP), (np.array([0.0, 0.1, -0.5]), np.array([0.1, 0.0, 0.6]))],
                 [oracle.exp_series(np.array([0.2, -0.1, 0.15])), oracle.exp_series(np.array([-0.1, 0.2, 0.1]))],
                 [np.array([0.5, 0.3, 1.0]), np.array([-0.4, 1.0, 0.2])])


def tangent_by_series(_, theta):
    """`oracle.right_tangent` of the exponential map for complex arguments, which a complex step cannot take."""
    X, term, total = oracle.hat(theta), np.eye(3), np.eye(3)
    for k in range(2, 19):
        term = term @ X / k
        total = total + term
    return total


def imaginary(problem, path, sensitivity, method, steps):
    """Derivatives of (x, turn, v, w) at the end by a complex step through the oracle.

    The start moves as the sensitivity says at t = 0; that this closes the joints is another test.
    """
    words = path.split(".")
    numbers = {"mass": [[complex(body.mass)] for body in problem.bodies],
               "inertia": [np.array(body.inertia, complex) for body in problem.bodies],
               "parent_anchor": [np.array(joint.parent_anchor, complex) for joint in problem.joints],
               "child_anchor": [np.array(joint.child_anchor, complex) for joint in problem.joints],
               "gravity": np.array(GRAVITY, complex)}
    direction = [part[0] for part in (sensitivity.x, sensitivity.turn, sensitivity.v, sensitivity.w)]
    if words[0] == "gravity":
        numbers["gravity"][int(words[1])] += SMALL * 1j
    elif words[0] != "start":
        place = tuple(int(word) for word in words[3:]) or 0
        for index in {place, place[::-1]} if words[2] == "inertia" else (place,):
            numbers[words[2]][int(words[1])][index] += SMALL * 1j
    system = oracle.Chain([mass[0] for mass in numbers["mass"]], numbers["inertia"],
                          [(joint.parent, joint.child, numbers["parent_anchor"][k], numbers["child_anchor"][k])
                           for k, joint in enumerate(problem.joints)], numbers["gravity"])
    x, v, w = (np.array(values) + SMALL * 1j * change for values, change in zip(
        (problem.x, problem.v, problem.w), (direction[0], *direction[2:]), strict=True))
    R = np.array([R + SMALL * 1j * R @ oracle.hat(turn) for R, turn in zip(problem.R, direction[1], strict=True)])
    q, u = (x, R), np.concatenate([v, w], axis=1).ravel()
    record = METHODS[method]
    if method == "generalized_alpha":
        *_, (q, u, _, _) = oracle.integrate_alpha(system, record.spectral_radius, q, u, STEP, steps)
    elif record.composition or method == "rattle2":
        guess = np.concatenate([u, np.zeros(system.m)])
        for weight in (record.composition or (1.0,)) * steps:
            q, u, guess = oracle.rattle_step(system, q, u, weight * STEP, guess)
    else:
        q, u, *_ = oracle.integrate(system, method=record, q=q, u=u, h=STEP, steps=steps,
                                    gains=record.gains or (0.0, 0.0))
    skew = [np.real(R).T @ np.imag(R) / SMALL for R in q[1]]
    turn = np.array([[each[2, 1], each[0, 2], each[1, 0]] for each in skew])
    u = np.imag(u).reshape(-1, 6) / SMALL
    return np.array([np.imag(q[0]) / SMALL, turn, u[:, :3], u[:, 3:]])


@pytest.mark.parametrize("method", MAPS)
def test_the_discrete_map_against_complex_steps(method, monkeypatch):
    monkeypatch.setattr(oracle, "right_tangent", tangent_by_series)
    problem = pendulum()
    paths = ("bodies.0.mass", "bodies.1.inertia.0.0", "bodies.1.inertia.0.1", "joints.1.child_anchor.2",
             "joints.1.parent_anchor.1", "gravity.2", "start")
    stages = len(METHODS[method].composition)
    steps, paths = (1, paths[:2] + paths[3:4] + paths[5:6]) if stages > 1 else (2, paths)
    run = lieeuler.integrate(problem, method, STEP, [0.0, STEP * steps], sensitivities=paths)
    for path, sensitivity in run.sensitivities.items():
        parts = [sensitivity.x, sensitivity.turn, sensitivity.v, sensitivity.w]
        if path == "start":  # one direction of poses, one of velocities
            assert parts[0].shape == (2, 2, 3, 12)
            each = [[part[..., k] for part in parts] for k in (1, 8)]
        else:
            each = [parts]
        for x, turn, v, w in each:
            direction = lieeuler.Sensitivity(x, turn, v, w, 0.0, 0)
            wanted = imaginary(problem, path, direction, method, steps)
            found = np.array([x[-1], turn[-1], v[-1], w[-1]])
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * max(1.0, np.abs(wanted).max()))


def test_the_start_of_a_changed_anchor_closes_the_joints():
    problem = pendulum()
    moved = lieeuler.integrate(problem, "rattle2", STEP, [0.0, STEP], sensitivities=(
        "joints.1.child_anchor.2", "bodies.0.mass")).sensitivities
    gap = moved["joints.1.child_anchor.2"]
    ends = [(R @ np.cross(turn, s), x) for R, turn, s, x in zip(
        problem.R, gap.turn[0], (problem.joints[1].parent_anchor, problem.joints[1].child_anchor), gap.x[0],
        strict=True)]
    opened = ends[1][1] + ends[1][0] + problem.R[1] @ UP - ends[0][1] - ends[0][0]
    np.testing.assert_allclose(opened, 0.0, atol=1e-10)
    for part in (moved["bodies.0.mass"].x, moved["bodies.0.mass"].turn, moved["bodies.0.mass"].w):
        assert np.abs(part[0]).max() < 1e-11


def oscillator(k=30.0, c=0.7, m=INERTIA, servo=False):
    """A mass on a slide with a spring and a damper, or a servo with their gains."""
    free = one("slide", 0.3, 0.4)
    body = dataclasses.replace(free.bodies[0], mass=m)
    if servo:
        law = dataclasses.replace(free.laws[0], servos=(Servo(proportional=k, derivative=c),))
        return dataclasses.replace(free, bodies=(body,), laws=(law,))
    # two springs of k / 2, one on each side
    springs = tuple(lieeuler.LinearSpring(-1, 0, side * AXIS, np.zeros(3), k / 2, 1.0, c / 2) for side in (5.0, -5.0))
    return dataclasses.replace(free, bodies=(body,), laws=(), forces=springs)


def scalar_map(method, k, c, m, h, steps):
    """The discrete map of the oscillator in its one coordinate, for complex numbers too; of methods that choose their
    steps the motion itself.
    """
    q, u = 0.3, 0.4
    record = METHODS[method]

    def pull(q, u):
        return -(k * q + c * u) / m

    if "step" not in record.controls:
        return expm(steps * h * np.array([[0.0, 1.0], [-k / m, -c / m]])) @ [q, u]
    if method == "generalized_alpha":
        return alpha_map(pull, k, c, m, h, steps, oracle.alpha_coefficients(record.spectral_radius))
    for _ in range(steps):
        if record.tableau:
            q, u = runge_kutta(record.tableau, pull, np.array([q, u]), h)
        elif record.composition or method == "rattle2":
            for weight in record.composition or (1.0,):
                half = weight * h / 2
                xi = (m * u - half * k * q) / (m + half * c)
                q = q + weight * h * xi
                u = xi + half * pull(q, xi)
        else:
            u = (m * u - h * k * q) / (m + h * c + h * h * k * (record.formulation != "hamilton"))
            q = q + h * u
    return np.array([q, u])


def runge_kutta(tableau, pull, y, h):
    """A step of a tableau for q'' = pull(q, q')."""
    slopes = []
    for row in ((), *tableau.stages):
        q, u = y + h * sum((a * slope for a, slope in zip(row, slopes, strict=False)), 0 * y)
        slopes.append(np.array([u, pull(q, u)]))
    return y + h * sum(b * slope for b, slope in zip(tableau.weights, slopes, strict=True))


def alpha_map(pull, k, c, m, h, steps, coefficients):
    """Steps of generalized-alpha for the oscillator."""
    alpha_m, alpha_f, gamma, beta = coefficients
    q, u = 0.3, 0.4
    a, ahead, share = pull(q, u), (alpha_m - alpha_f) * h, (1 - alpha_f) / (1 - alpha_m)
    A = pull(q + ahead * (u + ahead / 2 * a), u + ahead * a)
    for _ in range(steps):
        known = (alpha_f * a - alpha_m * A) / (1 - alpha_m)
        q += h * u + h * h * ((0.5 - beta) * A + beta * known)
        u += h * ((1 - gamma) * A + gamma * known)
        a = -(k * q + c * u) / (m + share * h * (c * gamma + k * h * beta))
        A = known + share * a
        q, u = q + h * h * beta * share * a, u + h * gamma * share * a
    return np.array([q, u])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("servo", [False, True])
def test_springs_dampers_and_gains_against_complex_steps(method, servo):
    record = METHODS[method]
    more = {"events": True} if servo and record.order == 1 else {}
    paths = (("laws.0.servos.0.proportional", "laws.0.servos.0.derivative", "bodies.0.mass") if servo else
             {"k": lambda s: oscillator(k=30.0 + s), "c": lambda s: oscillator(c=0.7 + s), "bodies.0.mass":
              lambda s: oscillator(m=INERTIA + s)})
    how = more | ({"step": 0.01} if "step" in record.controls else {"rtol": 1e-13})
    run = lieeuler.integrate(oscillator(servo=servo), method, t_eval=[0.0, 0.05], sensitivities=paths, **how)
    for k, sensitivity in enumerate(run.sensitivities.values()):
        numbers = np.array([30.0, 0.7, INERTIA], complex)
        numbers[k] += SMALL * 1j
        wanted = scalar_map(method, *numbers, 0.01, 5).imag / SMALL
        found = [sensitivity.x[-1, 0] @ AXIS, sensitivity.v[-1, 0] @ AXIS]
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)


def tilted(s):
    """A body that slides down an axis, which is AXIS at s = 0."""
    axis = (AXIS + s * np.array([-0.8, 0.0, 0.6])) / np.sqrt(1 + s * s)
    joint = lieeuler.prismatic_joint(-1, 0, [0, 0, 0], [0, 0, 0], axis, axis, np.eye(3))
    return lieeuler.Problem([lieeuler.Body(INERTIA, np.eye(3))], [joint], GRAVITY, [0.3 * axis], [np.eye(3)],
                            [0.4 * axis], [np.zeros(3)])


@pytest.mark.parametrize("method", METHODS)
def test_an_axis_against_complex_steps(method):
    how = {"step": 0.01} if "step" in METHODS[method].controls else {"rtol": 1e-13}
    run = lieeuler.integrate(tilted(0.0), method, t_eval=[0.0, 0.05], sensitivities={"axis": tilted}, **how)
    axis = AXIS + SMALL * 1j * np.array([-0.8, 0.0, 0.6])
    a, q, u = GRAVITY @ axis, 0.3 + 0j, 0.4 + 0j
    late = 0.5 if METHODS[method].order == 1 else 0.0  # Euler's step has the velocity of its end
    for _ in range(5):
        q, u = q + 0.01 * u + (0.5 + late) * 1e-4 * a, u + 0.01 * a
    np.testing.assert_allclose(run.sensitivities["axis"].x[-1, 0], np.imag(q * axis) / SMALL, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.sensitivities["axis"].v[-1, 0], np.imag(u * axis) / SMALL, rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_all_methods_converge_to_the_derivative_of_the_motion_at_their_order(method):
    record, t = METHODS[method], 0.4

    def flow(k, c, m):
        return expm(t * np.array([[0.0, 1.0], [-k / m, -c / m]])) @ [0.3, 0.4]

    numbers, h = np.array([30.0, 0.7, INERTIA]), 1e-3
    wanted = [sum(weight * (flow(*(numbers + j * h * row)) - flow(*(numbers - j * h * row))) / h
                  for j, weight in ((1, 0.8), (2, -0.2), (3, 4 / 105), (4, -1 / 280))) for row in np.eye(3)]
    paths = {"k": lambda s: oscillator(k=30.0 + s), "c": lambda s: oscillator(c=0.7 + s),
             "m": lambda s: oscillator(m=INERTIA + s)}
    coarse = {1: 4e-3, 2: 2e-2, 4: 5e-2, 5: 5e-2}.get(record.order or 0, 0.1 if method == "rattle8" else 0.2)
    errors = []
    for size in (coarse, coarse / 2):
        how = {"step": size} if "step" in record.controls else {"rtol": 1e-9}
        run = lieeuler.integrate(oscillator(), method, t_eval=[0.0, t], sensitivities=paths, **how)
        found = [(each.x[-1, 0] @ AXIS, each.v[-1, 0] @ AXIS) for each in run.sensitivities.values()]
        errors.append(np.abs(np.subtract(found, wanted)).max())
    if "step" in record.controls:
        assert np.log2(errors[0] / errors[1]) == pytest.approx(record.order, abs=0.3), errors
    else:
        assert errors[0] < 1e-9


def friction(s):
    return one("slide", 0.0, 1.0, sliding=1.5 + s, static=1.5 + s)


@pytest.mark.parametrize("method", ["rattle2", "taylor"])
def test_the_jump_at_events_is_in_the_derivative(method):
    how = {"step": 0.01} if method == "rattle2" else {"rtol": 1e-10}
    run = lieeuler.integrate(friction(0.0), method, t_eval=[0.0, 1.0, 2.0], sensitivities={"c": friction}, **how)
    assert [event[2] for event in run.events] == ["sticks"]  # at m v0 / c, after v0^2 m / 2c
    found = run.sensitivities["c"].x[:, 0] @ AXIS
    np.testing.assert_allclose(found, [0.0, -1.0 / (2 * INERTIA), -INERTIA / (2 * 1.5**2)], atol=1e-9)
    stop = one("slide", 0.0, 1.0, stops=Stops(upper=0.5, restitution=0.6))
    run = lieeuler.integrate(stop, method, t_eval=[0.0, 2.0], sensitivities=(
        "laws.0.stops.upper", "laws.0.stops.restitution", "start"), **how)
    q = [np.einsum("k...,k->...", each.x[-1, 0], AXIS) for each in run.sensitivities.values()]
    v = [np.einsum("k...,k->...", each.v[-1, 0], AXIS) for each in run.sensitivities.values()]
    begin = np.einsum("k...,k->...", run.sensitivities["start"].v[0, 0], AXIS)  # q = u + e (u - q0) - e v0 t
    np.testing.assert_allclose([q[0], q[1], v[0], v[1]], [1.6, 0.5 - 2.0, 0.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(q[2][1], -0.6 * 2.0 * begin[1], atol=1e-9)
    np.testing.assert_allclose(v[2][1], -0.6 * begin[1], atol=1e-9)


@pytest.mark.parametrize(("problem", "method", "t", "wanted", "said"), [
    (friction(0.0), "DAE1L_LSE", 1.0, {"c": friction}, "events=True"),
    (one("slide", 0.0, 1.0, stops=Stops(upper=0.5)), "rattle2", 0.5, ("laws.0.stops.upper",), "pass an output time"),
    (pendulum(), "rattle2", 0.1, "bodies.0.mass", "tuple of paths"),
    (pendulum(), "rattle2", 0.1, ("bodies.0.maas",), "mass, inertia"),
    (pendulum(), "rattle2", 0.1, ("bodies.2.mass",), "none of 0, 1"),
    (pendulum(), "rattle2", 0.1, ("gravity",), "gravity.2"),
])
def test_what_cannot_be_differentiated(problem, method, t, wanted, said):
    with pytest.raises(lieeuler.ArgumentError, match=said):
        lieeuler.integrate(problem, method, 0.01, [0.0, t], sensitivities=wanted)


def test_directions_that_leave_a_plane_or_a_symmetry_are_of_the_whole_system():
    paths, t = ("bodies.0.inertia.0.0", "start"), [0.0, 0.1]
    still = chain([1.0], [np.diag([0.1, 0.2, 0.15])], [(np.zeros(3), UP)], [np.eye(3)], [np.zeros(3)])
    top = chain([15.0], [np.diag([0.3, 0.4, 0.3])], [(np.zeros(3), -np.eye(3)[1])], [np.eye(3)],
                [np.array([0.0, 50.0, -4.0])])
    for problem in (top, still):
        found, wanted = (lieeuler.integrate(problem, "rattle4", 1e-3, t, sensitivities=paths, **how).sensitivities
                         for how in ({}, {"reduce": "off", "spin_free": False}))
        for path in paths:
            np.testing.assert_allclose(found[path].w, wanted[path].w, rtol=0, atol=1e-9 * np.abs(wanted[path].w).max())
            assert found[path].error < 1e-9 * max(1.0, np.abs(wanted[path].w).max())


def test_a_run_without_sensitivities_has_none_and_they_change_nothing_of_the_run():
    plain = lieeuler.integrate(pendulum(), "rattle2", STEP, [0.0, 0.1])
    given = lieeuler.integrate(pendulum(), "rattle2", STEP, [0.0, 0.1], sensitivities=("gravity.2",))
    assert plain.sensitivities == {}
    np.testing.assert_array_equal(plain.R, given.R)
    assert given.sensitivities["gravity.2"].runs <= 16


LEVER = 0.6


def swinging():
    """A hinge pendulum at 2.4 rad from below."""
    hinge, arm = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, LEVER])
    joint = lieeuler.revolute_joint(-1, 0, [0, 0, 0], arm, hinge, hinge)
    R = np.array([[np.cos(2.4), 0.0, np.sin(2.4)], [0.0, 1.0, 0.0], [-np.sin(2.4), 0.0, np.cos(2.4)]])
    x = -R @ arm
    return lieeuler.Problem([lieeuler.Body(1.5, 0.2 * np.eye(3))], [joint], [0.0, 0.0, -9.81], [x], [R],
                            [np.cross(0.7 * hinge, x)], [0.7 * hinge])


def pull(mass, g, lever, inertia, sine):
    """Its angular acceleration where the sine of the angle is this."""
    return g * mass * lever * sine / (inertia + mass * lever**2)


NUMBERS = {"bodies.0.mass": 1.5, "gravity.2": -9.81, "joints.0.child_anchor.2": LEVER, "bodies.0.inertia.1.1": 0.2}


@pytest.mark.parametrize("method", ["rkmk4", "rkmk54", "rkmk853"])
def test_steps_of_runge_kutta_against_complex_steps(method):
    """In the coordinate of the joint, a step is that of the tableau in the angle and its rate."""
    run = lieeuler.integrate(swinging(), method, 0.05, [0.0, 0.5], reduce="joints", sensitivities=tuple(NUMBERS))
    for k, path in enumerate(NUMBERS):
        numbers = np.array([*NUMBERS.values()], complex)
        numbers[k] += SMALL * 1j
        made = run.sensitivities[path]  # a longer arm moves the start too
        y = np.array([2.4 + SMALL * 1j * made.turn[0, 0, 1], 0.7 + SMALL * 1j * made.w[0, 0, 1]])
        for _ in range(10):
            y = runge_kutta(METHODS[method].tableau, lambda q, u, at=numbers: pull(*at, np.sin(q)), y, 0.05)
        np.testing.assert_allclose([made.turn[-1, 0, 1], made.w[-1, 0, 1]], y.imag / SMALL, rtol=0, atol=1e-9)


@pytest.mark.parametrize("path", NUMBERS)
def test_methods_that_choose_their_steps_against_forty_digits(path):
    """Their derivative is that of the motion: differences of a series with forty digits."""
    mp = pytest.importorskip("mpmath").mp.clone()
    mp.dps = 40
    small = mp.mpf(10)**-15
    found = [lieeuler.integrate(swinging(), method, rtol=1e-13, t_eval=[0.0, 0.1], sensitivities=(path,))
             .sensitivities[path] for method in ("seulex", "taylor", "rkmk853")]
    begun, ends = found[0], []
    for change in (small, -small):
        at = [mp.mpf(value) + (name == path) * change for name, value in NUMBERS.items()]
        ends.append(mp.odefun(lambda t, y, at=at: [y[1], pull(*at, mp.sin(y[0]))], 0, [
            mp.mpf(2.4) + change * float(begun.turn[0, 0, 1]), mp.mpf(0.7) + change * float(begun.w[0, 0, 1])])(
                mp.mpf(0.1)))
    wanted = [float((up - down) / (2 * small)) for up, down in zip(*ends, strict=True)]
    for made in found:
        np.testing.assert_allclose(made.turn[0], begun.turn[0], atol=1e-9)
        np.testing.assert_allclose([made.turn[-1, 0, 1], made.w[-1, 0, 1]], wanted, rtol=0, atol=1e-9)
