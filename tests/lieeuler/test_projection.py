"""The projection onto the constraints: closed to rounding, by the least change, and its statuses where it fails."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler import _kernel
from tests.lieeuler.accuracy import EPS, mass_matrix
from tests.lieeuler.systems import SYSTEMS, hung_by_both_ends
from tests.lieeuler.test_redundant import FOUR_BAR, linkage

PROBLEMS = {
    "double pendulum": SYSTEMS["double_pendulum"],  # a tree
    "heavy top": SYSTEMS["heavy_top"],
    "hung by both ends": lambda: hung_by_both_ends(3),  # a loop without redundant rows
    "four-bar": lambda: linkage(FOUR_BAR),  # a loop with three
}


def moved(problem, x, turn):
    """Positions and attitudes off the problem's own by `x` m and by `turn` rad, both (n, 3)."""
    return problem.x + x, problem.R @ Rotation.from_rotvec(turn).as_matrix()


def project(problem, x, R, v=None, w=None):
    v, w = problem.v if v is None else v, problem.w if w is None else w
    state = [np.ascontiguousarray(a, float) for a in (x, R, v, w)]
    return dict(zip(("status", *"xRvw"), _kernel.project(problem.kernel, problem.time, problem.x, problem.R, *state),
                    strict=True))


def rows(problem, x, R, v, w):
    return _kernel.constraints(problem.kernel, x, R, v, w, np.zeros(problem.rows))


def gap(problem, found):
    return np.abs(rows(problem, found["x"], found["R"], found["v"], found["w"])["phi"]).max()


def share_outside(vector, G):
    """The share of a force (6n,) outside the range of G^T."""
    mu = np.linalg.lstsq(G.T, vector, rcond=1e-10)[0]
    return np.linalg.norm(vector - G.T @ mu) / np.linalg.norm(vector)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("size", [1e-2, 1e-5, 1e-8])
def test_a_state_off_the_constraints_is_closed_to_rounding(name, size):
    problem = PROBLEMS[name]()
    random = np.random.default_rng(1)
    shape = problem.x.shape
    x, R = moved(problem, size * random.normal(size=shape), size * random.normal(size=shape))
    v, w = problem.v + random.normal(size=shape), problem.w + random.normal(size=shape)
    found = project(problem, x, R, v, w)
    assert found["status"] == "success"
    after = rows(problem, found["x"], found["R"], found["v"], found["w"])
    assert np.abs(after["phi"]).max() < 50 * EPS * max(1.0, np.abs(problem.x).max())
    assert np.abs(np.swapaxes(found["R"], -1, -2) @ found["R"] - np.eye(3)).max() < 10 * EPS
    velocities = np.concatenate([found["v"], found["w"]], axis=1).reshape(-1)
    speeds = np.abs(after["G"]) @ np.abs(velocities)  # the terms of G u
    assert np.abs(after["G"] @ velocities).max() < 50 * EPS * speeds.max()


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_change_is_the_least_in_the_metric_of_the_masses(name):
    """M d = -G^T mu: of all ways to close the joints, the one of least kinetic energy were it done in one second."""
    problem = PROBLEMS[name]()
    random = np.random.default_rng(2)
    shape, size = problem.x.shape, 1e-4
    x, R = moved(problem, size * random.normal(size=shape), size * random.normal(size=shape))
    v, w = problem.v + random.normal(size=shape), problem.w + random.normal(size=shape)
    found = project(problem, x, R, v, w)
    M = mass_matrix(problem)
    turn = Rotation.from_matrix(np.swapaxes(R, -1, -2) @ found["R"]).as_rotvec()
    change = np.concatenate([found["x"] - x, turn], axis=1).reshape(-1)
    # G of the start, which the iteration keeps; to first order in the size of the change
    assert share_outside(M @ change, rows(problem, x, R, v, w)["G"]) < 100 * size
    jump = np.concatenate([found["v"] - v, found["w"] - w], axis=1).reshape(-1)
    G = rows(problem, found["x"], found["R"], found["v"], found["w"])["G"]
    assert share_outside(M @ jump, G) < 1e3 * EPS * np.linalg.cond(M)


def test_a_state_too_far_off_ends_with_a_name_and_never_with_open_joints():
    """From gaps of a few metres and attitudes turned by radians the iteration may or may not converge."""
    ends = set()
    for name, make in PROBLEMS.items():
        problem = make()
        for seed in range(20):
            random = np.random.default_rng(seed)
            x, R = moved(problem, random.normal(size=problem.x.shape), random.normal(size=problem.x.shape))
            found = project(problem, x, R)
            ends.add(found["status"])
            if found["status"] == "success":
                assert gap(problem, found) < 50 * EPS * max(1.0, np.abs(found["x"]).max()), (name, seed)
    assert "newton_failed" in ends
    assert ends <= {"success", "newton_failed", "singular_matrix"}


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_no_number_has_a_name(value):
    problem = SYSTEMS["double_pendulum"]()
    x = np.array(problem.x)
    x[1, 2] = value
    assert project(problem, x, problem.R)["status"] == "non_finite"


def leaning(angle):
    """A parallelogram of two cranks and a coupler, `angle` rad above its flat position."""
    c, s = np.cos(angle), np.sin(angle)
    return linkage([[0, 0, 0], [c, 0, s], [2 + c, 0, s], [2, 0, 0]])


@pytest.mark.parametrize("angle", [1e-2, 1e-3, 1e-4])
def test_near_a_singular_position_rounding_of_the_joints_is_no_failure(angle):
    """There a correction is rounding of Phi over the angle, which no iteration brings down: closed joints count."""
    problem = leaning(angle)
    found = project(problem, problem.x, problem.R)
    assert found["status"] == "success"
    assert gap(problem, found) < 50 * EPS * 3  # m, its length
    # the same place with a crank off by a tenth of its angle: open joints are no success
    turn = np.zeros((3, 3))
    turn[0, 1] = 0.1 * angle
    found = project(problem, *moved(problem, np.zeros((3, 3)), turn))
    if found["status"] == "success":
        assert gap(problem, found) < 50 * EPS * 3
    else:
        assert found["status"] in ("newton_failed", "singular_matrix")


def arm(angle, rate, at, body, **more):
    """An arm of a hinge about y on the ground, with what moves the hinge; its state is x, R, v, w."""
    R, axis, down = Rotation.from_euler("y", angle).as_matrix(), [0.0, 1.0, 0.0], np.array([0.0, 0.0, -1.0])
    hinge = dataclasses.replace(lieeuler.revolute_joint(-1, body, at, -down, axis, axis), **more)
    w = rate * np.array(axis)
    return hinge, (at + R @ down, R, R @ np.cross(w, down), w)


def system(arms, time=0.0):
    hinges, states = zip(*arms, strict=True)
    bodies = [lieeuler.Body(1.0, np.diag([0.02, 0.03, 0.04]))] * len(arms)
    return lieeuler.Problem(bodies, hinges, [0, 0, -9.81], *map(np.array, zip(*states, strict=True)), time=time)


ANGLE = lieeuler.Coordinate([0, 1, 0], [0, 1, 0], np.eye(3))


def driven():
    """A hinge whose angle is 0.3 + 0.8 t, at t = 1.5 s."""
    drive = lieeuler.Drive(lieeuler.TimeFunction([[0.3, 0.8]]), ANGLE)
    return system([arm(1.5, 0.8, np.zeros(3), 0, drive=drive)], time=1.5)


def geared():
    """Two hinges, of which the second turns twice as far as the first."""
    follows = lieeuler.Mimic(0, ANGLE, ANGLE, 2.0, 0.1)
    return system([arm(0.4, 0.5, np.zeros(3), 0), arm(0.9, 1.0, np.array([3.0, 0, 0]), 1, mimic=follows)])


@pytest.mark.parametrize("make", [*PROBLEMS.values(), driven, geared], ids=[*PROBLEMS, "driven", "geared"])
@pytest.mark.parametrize("size", [0.1, 1e-4])
def test_a_projected_state_starts_a_run(make, size):
    problem = make()
    random = np.random.default_rng(3)
    shape = problem.x.shape
    x, R = moved(problem, size * random.normal(size=shape), size * random.normal(size=shape))
    v, w = problem.v + size * random.normal(size=shape), problem.w + size * random.normal(size=shape)
    with pytest.raises(lieeuler.ArgumentError, match=r"lieeuler\.project"):
        dataclasses.replace(problem, x=x, R=R, v=v, w=w)
    closed = dict(zip("xRvw", lieeuler.project(problem, (x, R, v, w)), strict=True))
    start = dataclasses.replace(problem, **closed)
    assert start.opening < 1e-14
    assert np.abs(start.x - x).max() < 10 * size
    again = lieeuler.project(problem, (start.x, start.R, start.v, start.w))
    for before, after in zip((start.x, start.R, start.v, start.w), again, strict=True):
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-14 * np.abs(before).max())


@pytest.mark.parametrize(("change", "words"), [
    (lambda x, R, v, w: (x, R, v), "four arrays"), (lambda x, R, v, w: 1.0, "four arrays"),
    (lambda x, R, v, w: (x[:1], R, v, w), r"x must be finite and of shape \(2, 3\)"),
    (lambda x, R, v, w: (x, 2 * R, v, w), "rotation matrices"),
    (lambda x, R, v, w: (x, R, v * np.nan, w), "v must be finite"),
])
def test_a_state_that_cannot_be_projected_is_named(change, words):
    problem = SYSTEMS["double_pendulum"]()
    with pytest.raises(lieeuler.ArgumentError, match=words):
        lieeuler.project(problem, change(problem.x, problem.R, problem.v, problem.w))
    with pytest.raises(lieeuler.ArgumentError, match="must be a lieeuler"):
        lieeuler.project(problem.bodies, (problem.x, problem.R, problem.v, problem.w))


def test_a_state_too_far_off_is_refused():
    problem = PROBLEMS["four-bar"]()
    random = np.random.default_rng(0)
    x, R = moved(problem, 3 * random.normal(size=problem.x.shape), 3 * random.normal(size=problem.x.shape))
    with pytest.raises(lieeuler.ArgumentError, match="give a closer one"):
        lieeuler.project(problem, (x, R, problem.v, problem.w))
