"""Welded bodies that are integrated as one move like the bodies and their welds: random trees and known motions."""

import dataclasses
from random import Random

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler.welded import welded_for
from tests.lieeuler.accuracy import largest_difference
from tests.random_mechanisms import axes, joint, vector

Z = np.array([0.0, 0.0, 1.0])
MOVING = ("universal", "revolute", "cylindrical", "prismatic", "planar", "spherical", "distance", "point_on_line",
          "point_on_plane")


def both(problem, method="taylor", end=0.5, word="welded", samples=6, **options):
    """The runs with the welds and with the composites."""
    return [lieeuler.integrate(problem, method, t_eval=np.linspace(0, end, samples), reduce=each, **options)
            for each in ("off", word)]


def rigid_body(random):
    rods = np.array([random.uniform(0.1, 0.6) for _ in range(3)])
    turn = axes(random)
    inertia = turn @ np.diag(rods.sum() - rods) @ turn.T
    return lieeuler.Body(random.uniform(0.5, 2.0), (inertia + inertia.T) / 2)


def problem_of(random, pairs, kinds, free=False):
    """Bodies in any attitude that turn about the origin as one at the start, on joints between `pairs`."""
    n = 1 + max(max(pair) for pair in pairs)
    x, R = np.array([vector(random, 0.6) for _ in range(n)]), np.array([axes(random) for _ in range(n)])
    joints = [joint(random, kind, *pair, x, R, 0.4) for pair, kind in zip(pairs, kinds, strict=True)]
    if not free:
        root = random.randrange(n)
        joints.insert(random.randrange(len(joints) + 1),
                      lieeuler.spherical_joint(-1, root, np.zeros(3), -R[root].T @ x[root]))
    turning = vector(random, 1.5)
    return lieeuler.Problem([rigid_body(random) for _ in range(n)], joints, vector(random, 6.0), x, R,
                            np.cross(turning, x), np.swapaxes(R, 1, 2) @ turning)


def angle_between(problem, parent, child, axis, angle):
    """The angle of a hinge about a world direction, which is `angle` at the start."""
    at = problem.R[parent] if parent >= 0 else np.eye(3)
    begun = Rotation.from_rotvec(angle * axis).as_matrix()
    return lieeuler.Coordinate(at.T @ axis, problem.R[child].T @ axis, problem.R[child].T @ begun @ at)


def turns_of(solution, parent, child, axis):
    """How many turns a hinge makes about a world direction of the start, on its widest way; 101 samples or so."""
    R, spin = solution.R, np.einsum("tbij,tbj->tbi", solution.R, solution.w)
    relative = spin[:, child] - (spin[:, parent] if parent >= 0 else 0)
    along = axis if parent < 0 else R[:, parent] @ R[0, parent].T @ axis
    angle = np.r_[0, np.cumsum((relative * along).sum(axis=1))] * (solution.t[1] - solution.t[0])
    return np.ptp(angle) / (2 * np.pi)


def hinge(problem, parent, child, axis, point):
    """A hinge that is closed at the start, through a point of the world."""
    at, origin = (problem.R[parent], problem.x[parent]) if parent >= 0 else (np.eye(3), np.zeros(3))
    return lieeuler.revolute_joint(parent, child, at.T @ (point - origin),
                                   problem.R[child].T @ (point - problem.x[child]), at.T @ axis,
                                   problem.R[child].T @ axis)


def loaded(random, problem):
    """With loads in both frames, some driven, and springs between bodies that no welds tie together."""
    composite = welded_for(problem).body
    gust = lieeuler.TimeFunction(terms=[(1.0, 3.0, 0.4)])
    forces = [lieeuler.ConstantLoad(b, vector(random), vector(random, 0.3), vector(random, 0.5), frame,
                                    random.choice((None, gust)))
              for b in range(problem.n) for frame in ("world", "body")]
    forces += [lieeuler.LinearSpring(p, c, vector(random, 0.3), vector(random, 0.3), 8.0, 0.4, 0.3)
               for c in range(problem.n) for p in (-1, (c + 2) % problem.n) if p < 0 or composite[p] != composite[c]]
    return dataclasses.replace(problem, forces=tuple(forces))


def random_tree(seed):
    """Five to eight bodies, a third or so of their joints welds, all joints among the others, loads and springs."""
    random = Random(seed)
    n = random.randint(5, 8)
    pairs = [random.choice([(a, b), (b, a)]) for b in range(1, n) for a in [random.randrange(b)]]
    kinds = [random.choice(("fixed", random.choice(MOVING))) for _ in pairs]
    kinds[random.randrange(len(kinds))] = "fixed"
    return loaded(random, problem_of(random, pairs, kinds, free=seed % 3 == 0))


@pytest.mark.parametrize("seed", range(12))
def test_random_trees_move_alike(seed):
    """All joints on composites of two to several bodies, on either side; free or hung on a ball joint."""
    problem = random_tree(seed)
    off, on = both(problem, end=0.3, rtol=1e-13)
    assert welded_for(problem).problem.n < problem.n
    assert largest_difference(off, on) < 1e-11
    assert largest_difference(off, lieeuler.integrate(problem, "taylor", t_eval=off.t, rtol=1e-13)) < 1e-11


@pytest.mark.parametrize("kind", MOVING)
def test_every_joint_hangs_on_a_welded_body(kind):
    """Between two composites, from and to bodies that are not the first of theirs."""
    random = Random(kind)
    problem = loaded(random, problem_of(random, [(3, 1), (1, 2), (0, 2)], ["fixed", kind, "fixed"]))
    assert welded_for(problem).body.tolist() == [0, 1, 0, 1]
    off, on = both(problem, end=0.3, rtol=1e-13)
    assert largest_difference(off, on) < 1e-11


@pytest.mark.parametrize("seed", range(4))
def test_turning_springs_keep_their_turns(seed):
    """The axes of the spring lie on welded bodies, which stand at any angle to each other, and it is wound up; beside
    it a hinge with a motor whose rest angle moves."""
    random = Random(seed)
    problem = problem_of(random, [(0, 1), (2, 3), (4, 3)], ["fixed", "fixed", "fixed"], free=True)
    axis, other = axes(random)[:2]
    joints = (*problem.joints, hinge(problem, 1, 3, axis, np.array([0.1, 0.2, 0.3])),
              hinge(problem, -1, 1, other, np.zeros(3)))
    w = problem.R.swapaxes(1, 2) @ other
    problem = dataclasses.replace(problem, joints=joints, v=np.cross(other, problem.x), w=w)
    forces = []
    for parent, child, way, rest in ((1, 3, axis, 14.0), (3, 1, axis, -0.5), (-1, 1, other, 0.0)):
        at = problem.R[parent] if parent >= 0 else np.eye(3)
        moving = lieeuler.TimeFunction(terms=[(rest, 2.0, 1.0)]) if rest < 0 else rest
        forces.append(lieeuler.TorsionalSpring(parent, child, at.T @ way, problem.R[child].T @ way, 20.0, moving, 0.1))
    problem = dataclasses.replace(problem, forces=tuple(forces))
    off, on = both(problem, end=1.0, samples=101, rtol=1e-13)
    assert largest_difference(off, on) < 1e-11
    assert turns_of(off, 1, 3, axis) > 1.2


def test_rotors_drives_and_mimics():
    """A geared hinge that turns over, a driven one and one that follows the first, all between welded bodies."""
    random = Random(5)
    problem = problem_of(random, [(0, 1), (2, 3), (5, 4), (6, 7)], ["fixed"] * 4, free=True)
    p = [vector(random, 0.4) for _ in range(3)]
    a = [axes(random)[0] for _ in range(3)]
    angles = [angle_between(problem, *pair, axis, begun)
              for pair, axis, begun in zip([(-1, 1), (1, 3), (3, 5)], a, (0.5, 0.4, 0.3), strict=True)]
    speeding = lieeuler.TimeFunction([[0.4, 0.0, 3.0]])
    geared = hinge(problem, -1, 1, a[0], p[0]).geared(lieeuler.Rotor(0.4, angles[0].parent_axis, angles[0].child_axis))
    driven = hinge(problem, 1, 3, a[1], p[1]).driven(lieeuler.Drive(speeding, angles[1]))
    follower = hinge(problem, 3, 5, a[2], p[2]).following(lieeuler.Mimic(4, angles[2], angles[0], 0.7, -0.05))
    slider = joint(random, "prismatic", -1, 7, problem.x, problem.R, 0.3)
    pulled = lieeuler.SlideForce(-1, 7, slider.parent_anchor, slider.child_anchor, slider.dots[2].a_axis, 2.0)
    motor = lieeuler.TorsionalSpring(-1, 1, a[0], angles[0].child_axis, 0.0, 0.0, torque=400.0)
    rest = np.zeros_like(problem.x)
    problem = dataclasses.replace(problem, joints=(*problem.joints, geared, driven, follower, slider), v=rest, w=rest,
                                  forces=(pulled, motor))
    off, on = both(problem, end=1.0, samples=101, rtol=1e-13)
    assert len(welded_for(problem).problem.joints) == 4
    assert turns_of(off, -1, 1, a[0]) > 1
    assert largest_difference(off, on) < 1e-11


@pytest.mark.parametrize("kind", ["edge", "disk", "sphere"])
def test_a_welded_body_rolls(kind):
    random = Random(kind)
    x, R = np.array([[0.0, 0.0, 0.5], [0.3, -0.4, 0.9]]), np.array([axes(random), axes(random)])
    axis = np.array([0.6, 0.0, 0.8]) if kind == "disk" else np.array([1.0, 0.0, 0.0])
    point = R[1].T @ ([0.1, 0.2, 0.3] - x[1])
    ground = np.array([0.1, 0.2, 0.3]) * (1, 1, 0)
    if kind == "edge":
        contact = lieeuler.knife_edge_joint(-1, 1, [0, 0, 0.3], point, Z, R[1].T @ axis)
        turning = 1.3 * Z
        v = np.cross(turning, x - [0.1, 0.2, 0.3]) + 0.7 * axis
    else:
        radius = 0.3 / np.sqrt(1 - axis[2] ** 2) if kind == "disk" else 0.3
        contact = (lieeuler.rolling_disk_joint(-1, 1, np.zeros(3), point, Z, R[1].T @ axis, radius) if kind == "disk"
                   else lieeuler.rolling_sphere_joint(-1, 1, np.zeros(3), point, Z, radius))
        if kind == "disk":
            ground = np.array([0.1, 0.2, 0.3]) - radius * (Z - axis[2] * axis) / np.sqrt(1 - axis[2] ** 2)
        turning = np.array([1.0, -2.0, 0.7])
        v = np.cross(turning, x - ground)
    weld = joint(random, "fixed", 0, 1, x, R, 0.5)
    problem = lieeuler.Problem([rigid_body(random) for _ in range(2)], [contact, weld], [0, 0, -9.81], x, R, v,
                               np.swapaxes(R, 1, 2) @ turning)
    off, on = both(problem, end=0.2, rtol=1e-13)
    assert largest_difference(off, on) < 1e-11


def test_the_composite_is_the_body_that_moves():
    """Mass, centre and inertia against sums over points that stand for the bodies."""
    random = Random(3)
    problem = problem_of(random, [(2, 0), (2, 1), (3, 4)], ["fixed", "fixed", "fixed"], free=True)
    welded = welded_for(problem)
    assert welded.body.tolist() == [0, 0, 0, 1, 1]
    for base, parts in ((0, [0, 1, 2]), (1, [3, 4])):
        points, masses = [], []
        for b in parts:
            moments, turn = np.linalg.eigh(problem.bodies[b].inertia)
            reach = np.sqrt((moments.sum() / 2 - moments) / problem.bodies[b].mass * 3)
            for k in range(3):
                for sign in (-1, 1):
                    points.append(problem.x[b] + sign * problem.R[b] @ turn[:, k] * reach[k])
                    masses.append(problem.bodies[b].mass / 6)
        points, masses = np.array(points), np.array(masses)
        centre = masses @ points / masses.sum()
        R = welded.problem.R[base]
        local = (points - centre) @ R
        inertia = np.einsum("p,pi,pj->ij", masses, local, local)
        body = welded.problem.bodies[base]
        assert np.allclose(body.inertia, np.trace(inertia) * np.eye(3) - inertia, rtol=0, atol=1e-13)
        assert np.allclose(welded.problem.x[base], centre, rtol=0, atol=1e-14)
        assert body.mass == pytest.approx(masses.sum(), rel=1e-14)


def weld(problem, parent, child):
    return joint(Random(1), "fixed", parent, child, problem.x, problem.R, 0.3)
