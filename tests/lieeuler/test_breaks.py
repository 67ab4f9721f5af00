"""Functions of time that jump or bend at the end of a step: every method keeps its order, and says what holds after.

The oracles are equations in minimal coordinates, integrated by SciPy from break to break with the piece between them.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import lieeuler

BREAKS, END = (0.0, 0.3, 0.5, 0.9), 1.2
GRAVITY, DOWN, UP, AXIS = np.array([0.0, 0.0, -9.81]), np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]), [0, 1, 0]
HELD = ([1.0], [-2.0], [3.0], [-1.0])
BENT = ([0.0, 4.0], [1.2, -9.0], [-0.6, 5.0], [1.4])
FIXED = [name for name, method in lieeuler.METHODS.items() if "step" in method.controls]
FREE = [name for name, method in lieeuler.METHODS.items() if "rtol" in method.controls]
STEPS = {1: 5e-3, 2: 1e-2, 4: 2.5e-2, 5: 1.25e-2, 6: 5e-2, 8: 0.1}
"""The larger of two steps by order, s; both divide the times between breaks."""


def hat(w):
    return np.cross(w, np.eye(3)).T


def moving(slopes, start):
    """A function with these pieces of its second derivative, and with its value and rate where it starts."""
    pieces, (value, rate) = [], start
    for slope, duration in zip(slopes, np.diff([*BREAKS, END]), strict=True):
        pieces.append([value, rate, slope / 2])
        value, rate = value + rate * duration + slope / 2 * duration**2, rate + slope * duration
    return lieeuler.TimeFunction(pieces, breaks=BREAKS)


def pushed_top():
    """A body on a ball joint, off its principal axes; one load jumps, one bends. y = (R, w)."""
    J, R, w = np.diag([0.1, 0.2, 0.15]), Rotation.from_euler("yx", [0.8, 0.4]).as_matrix(), np.array([0.5, 0.3, 1.0])
    at, held, bent = np.array([0.2, 0.1, -0.3]), np.array([2.0, 1.0, 0.5]), np.array([0.3, -1.0, 0.4])
    problem = lieeuler.Problem(
        [lieeuler.Body(1.0, J)], [lieeuler.spherical_joint(-1, 0, np.zeros(3), UP)], GRAVITY, [-R @ UP], [R],
        [-R @ np.cross(w, UP)], [w],
        forces=[lieeuler.ConstantLoad(0, point=at, force=held, factor=lieeuler.TimeFunction(HELD, breaks=BREAKS)),
                lieeuler.ConstantLoad(0, point=at, torque=bent, factor=lieeuler.TimeFunction(BENT, breaks=BREAKS))])
    about = J + np.eye(3) - np.outer(UP, UP)

    def slope(t, y, k):
        R, w = y[:9].reshape(3, 3), y[9:]
        torque = (np.cross(-UP, R.T @ GRAVITY) + HELD[k][0] * np.cross(at - UP, R.T @ held)
                  + np.polyval(BENT[k][::-1], t - BREAKS[k]) * R.T @ bent)
        return np.r_[(R @ hat(w)).ravel(), np.linalg.solve(about, torque - np.cross(w, about @ w))]

    return problem, np.r_[R.ravel(), w], slope, lambda run, k: np.r_[run.R[k, 0].ravel(), run.w[k, 0]], (
        lambda run, k: run.alpha[k, 0])


def turned_wheel():
    """A sprung and damped wheel under a torque that jumps, about a pin. y = (angle, rate)."""
    R, w = Rotation.from_euler("y", 0.3).as_matrix(), 0.4
    spring = lieeuler.TorsionalSpring(-1, 0, AXIS, AXIS, 6.0, 0.0, 0.2, lieeuler.TimeFunction(HELD, breaks=BREAKS))
    pin, still = lieeuler.revolute_joint(-1, 0, np.zeros(3), np.zeros(3), AXIS, AXIS), np.zeros((1, 3))
    problem = lieeuler.Problem([lieeuler.Body(1.0, 0.1 * np.eye(3))], [pin], np.zeros(3), still, [R], still,
                               [[0, w, 0]], forces=[spring])

    def slope(t, y, k):
        return np.array([y[1], (-6.0 * y[0] - 0.2 * y[1] + HELD[k][0]) / 0.1])

    return problem, np.array([0.3, w]), slope, angle_of(0), lambda run, k: run.alpha[k, 0, 1:2]


def carried_pendulum():
    """A pendulum on a slide whose prescribed acceleration jumps. y = (angle, rate)."""
    slopes, R, w, L, J = (2.0, -6.0, 5.0, -1.0), Rotation.from_euler("y", 0.7).as_matrix(), -0.5, 0.8, 0.05
    path = moving(slopes, (0.1, 0.3))
    slide = lieeuler.prismatic_joint(-1, 0, np.zeros(3), np.zeros(3), [1, 0, 0], [1, 0, 0], np.eye(3)).driven(
        lieeuler.Drive(path, lieeuler.Coordinate([1, 0, 0], [1, 0, 0])))
    hinge, at, speed = lieeuler.revolute_joint(0, 1, np.zeros(3), -L * DOWN, AXIS, AXIS), [0.1, 0, 0], [0.3, 0, 0]
    problem = lieeuler.Problem(
        [lieeuler.Body(2.0, 0.1 * np.eye(3)), lieeuler.Body(1.0, J * np.eye(3))], [slide, hinge], GRAVITY,
        [at, at + L * R @ DOWN], [np.eye(3), R], [speed, speed + L * R @ np.cross([0, w, 0], DOWN)],
        [np.zeros(3), [0, w, 0]])

    def slope(t, y, k):
        return np.array([y[1], (L * np.cos(y[0]) * slopes[k] - 9.81 * L * np.sin(y[0])) / (J + L**2)])

    return problem, np.array([0.7, w]), slope, angle_of(1), lambda run, k: run.alpha[k, 1, 1:2]


def angle_of(body):
    return lambda run, k: np.array([np.arctan2(run.R[k, body, 0, 2], run.R[k, body, 0, 0]), run.w[k, body, 1]])


CASES = {case.__name__: case for case in (pushed_top, turned_wheel, carried_pendulum)}
ENDS = {}


def ends(case):
    """The problem, its oracle's states at the breaks and at the end with the slopes from there on, and what reads a
    run."""
    if case not in ENDS:
        problem, y, slope, state_of, acceleration_of = CASES[case]()
        ys = [y]
        for k, (begin, end) in enumerate(itertools.pairwise([*BREAKS, END])):
            ys.append(solve_ivp(slope, (begin, end), ys[-1], "DOP853", args=(k,), rtol=1e-13, atol=1e-14).y[:, -1])
        ENDS[case] = problem, ys, [slope(t, y, k) for k, (t, y) in enumerate(zip(BREAKS, ys, strict=False))], (
            state_of, acceleration_of)
    return ENDS[case]


def error(case, method, reduce, **accuracy):
    """That of the state at the end, and of the accelerations at the breaks."""
    problem, ys, slopes, (state_of, acceleration_of) = ends(case)
    run = lieeuler.integrate(problem, method, t_eval=[*BREAKS, END], reduce=reduce, **accuracy)
    gaps = [acceleration_of(run, k) - slope[-len(acceleration_of(run, k)):] for k, slope in enumerate(slopes)]
    return np.abs(state_of(run, -1) - ys[-1]).max(), max(np.abs(gap).max() for gap in gaps), run.stats


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("reduce", [None, "off"])
@pytest.mark.parametrize("method", FIXED)
def test_order_across_breaks(method, reduce, case):
    order = lieeuler.METHODS[method].order
    h = STEPS[order]
    (coarse, _, _), (fine, acceleration, _) = (error(case, method, reduce, step=each) for each in (h, h / 2))
    assert np.log2(coarse / fine) > order - 0.4 or fine < 1e-12
    assert acceleration < 10 * coarse  # at jumps by 5 to 50


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("reduce", [None, "off"])
@pytest.mark.parametrize("method", FREE)
def test_a_jump_at_the_end_of_a_step_is_no_error_of_it(method, reduce, case):
    """With what holds after the jump in their last stage, steps shrink towards it: 20 were refused."""
    state, acceleration, stats = error(case, method, reduce, rtol=1e-9)
    assert state < 1e-7
    assert acceleration < 1e-6
    assert stats.rejected_steps <= 6
