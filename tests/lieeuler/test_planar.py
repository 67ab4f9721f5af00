"""Random mechanisms reduced to their plane move like the whole systems, to rounding."""

import dataclasses
import re
from random import Random

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from tests import random_mechanisms
from tests.lieeuler.accuracy import largest_difference


def turned(problem, Q):
    """The problem in a world turned by Q (3, 3), its bodies' axes turned at random; forces are linear springs."""
    P = Rotation.random(problem.n, random_state=3).as_matrix()

    def item(thing):
        ends = {"parent": Q if thing.parent == -1 else P[thing.parent], "child": P[thing.child]}
        changed = {}
        for field in dataclasses.fields(thing):
            value = getattr(thing, field.name)
            if isinstance(value, np.ndarray) and value.shape == (3,):
                changed[field.name] = ends["parent" if field.name.startswith("parent") else "child"] @ value
        if isinstance(thing, lieeuler.Joint):
            changed["dots"] = tuple(dataclasses.replace(
                dot, a_axis=ends.get(dot.a, np.eye(3)) @ dot.a_axis, b_axis=ends.get(dot.b, np.eye(3)) @ dot.b_axis)
                for dot in thing.dots)
        return dataclasses.replace(thing, **changed)

    bodies = [lieeuler.Body(b.mass, (T @ b.inertia @ T.T + (T @ b.inertia @ T.T).T) / 2)
              for b, T in zip(problem.bodies, P, strict=True)]
    R = Q @ problem.R @ np.swapaxes(P, 1, 2)
    return lieeuler.Problem(bodies, [item(j) for j in problem.joints], Q @ problem.gravity, problem.x @ Q.T, R,
                            problem.v @ Q.T, np.einsum("bij,bj->bi", P, problem.w), [item(f) for f in problem.forces])


@pytest.mark.parametrize("seed", range(24))
def test_random_mechanisms_move_alike_in_their_plane(seed):
    """All flat joints, graded masses, loads in any direction; some are rigid, some have no hinge or odd springs."""
    problem = random_mechanisms.mechanism(Random(seed), flat=True)
    size = np.abs(problem.x).max()
    rate = problem.kernel.natural_rate(problem.kernel.length)
    for method in ("rattle2", "DAE1H_LSE"):
        try:
            off, on = (lieeuler.integrate(problem, method, 1e-3 / rate, [0.0, 5e-2 / rate], reduce=word)
                       for word in ("off", "planar"))
        except lieeuler.IntegrationError as ended:
            if ended.status in (lieeuler.Status.SINGULAR_MATRIX, lieeuler.Status.NEWTON_FAILED):
                continue
            raise
        except lieeuler.ArgumentError as refused:
            if re.search("pulls out of the plane|no joint turns", str(refused)):
                continue
            raise
        assert np.abs(off.x - on.x).max() < 1e-8 * size
        assert np.abs(off.R - on.R).max() < 1e-8


@pytest.mark.parametrize(("reduce", "word"), [("planar", "planar"), (None, "welded, planar")])
def test_multipliers_are_right_where_rows_have_lost_a_rank(reduce, word):
    """G^T lam = f - M a, by the dense blocks of the kernel."""
    assert random_mechanisms.answer(Random(8002679)) == "success"
    random = Random(8002679)
    make, options = random_mechanisms.case(random, flat=random.random() < 0.2)
    problem = make()
    solution = lieeuler.integrate(problem, **options, reduce=reduce)
    assert solution.stats.reduce == word
    for k in range(len(solution.t)):
        state = [np.ascontiguousarray(getattr(solution, name)[k]) for name in ("x", "R", "v", "w")]
        lam = np.ascontiguousarray(solution.lam[k])
        G = lieeuler._kernel.constraints(problem.kernel, *state, lam)["G"]
        applied = lieeuler._kernel.forces(problem.kernel, *state)["f"]
        inertia = np.ravel([np.r_[body.mass * a, body.inertia @ alpha + np.cross(w, body.inertia @ w)]
                            for body, a, alpha, w in zip(problem.bodies, solution.a[k], solution.alpha[k],
                                                         solution.w[k], strict=True)])
        assert np.abs(G.T @ lam - (applied - inertia)).max() < 1e-10 * np.abs(applied).max()


def test_a_run_in_its_plane_ends_where_the_whole_system_has_no_multipliers():
    """The inertia of this body is all but singular; no part of it acts in the plane."""
    assert random_mechanisms.answer(Random(8604665)) == "singular_matrix"


def test_springs_keep_their_turns():
    """A wheel that has turned five times: rest angle, unwrapped angle and multipliers are those of the whole system."""
    z = [0.0, 0.0, 1.0]
    hinge = lieeuler.revolute_joint(-1, 0, [0, 0, 0], [0, 0, 0], z, z)
    R = Rotation.from_rotvec([0, 0, 3.0]).as_matrix()
    wheel = lieeuler.Problem([lieeuler.Body(1.0, np.diag([1.0, 1.0, 1.5]))], [hinge], [0.0, -3.0, -9.81], [[0, 0, 0]],
                             [R], [[0, 0, 0]], [[0, 0, 20.0]], [lieeuler.TorsionalSpring(-1, 0, z, z, 2.0, 0.4, 0.1)])
    off, on = (lieeuler.integrate(wheel, "taylor", t_eval=np.linspace(0, 2, 9), rtol=1e-13, reduce=word)
               for word in ("off", "axis"))
    assert largest_difference(off, on) < 1e-12
    assert on.alpha[:, 0, 2].min() < -20  # a spring of 2 N m/rad on 1.5 kg m^2, wound up by five turns


def pinned_bodies(random):
    """Up to three unlike bodies on parallel pins, tied by springs that wind up, under loads fixed in world and body."""
    n, z = random.integers(1, 4), np.array([0.0, 0.0, 1.0])
    moments = random.uniform(0.2, 1.0, (n, 3))
    bodies = [lieeuler.Body(m, np.diag([a + b, b + c, c + a]))
              for m, (a, b, c) in zip(random.uniform(0.5, 3.0, n), moments, strict=True)]
    arms, pins = random.normal(size=(n, 3)), random.normal(size=(n, 3))
    w = np.outer(random.normal(scale=6.0, size=n), z)
    forces = [lieeuler.TorsionalSpring(b - 1, b, z, z, *random.uniform(0.1, 5.0, 2), random.uniform(0, 0.2))
              for b in range(n)]
    forces += [lieeuler.ConstantLoad(b, force=random.normal(size=3), torque=random.normal(size=3),
                                     point=random.normal(size=3), frame=frame)
               for b in range(n) for frame in ("world", "body")]
    R = Rotation.from_rotvec(np.outer(random.uniform(-3, 3, n), z)).as_matrix()
    joints = [lieeuler.revolute_joint(-1, b, pins[b], arms[b], z, z) for b in range(n)]
    reach = -np.einsum("bij,bj->bi", R, arms)
    return lieeuler.Problem(bodies, joints, random.normal(scale=9.0, size=3), pins + reach, R, np.cross(w, reach), w,
                            forces)


@pytest.mark.parametrize("seed", range(8))
def test_bodies_on_pins_are_angles(seed):
    """The series of the angles are those of the attitudes, with multipliers and accelerations, over several turns."""
    problem = pinned_bodies(np.random.default_rng(seed))
    off, on = (lieeuler.integrate(problem, "taylor", t_eval=np.linspace(0, 2, 9), rtol=1e-13, reduce=word)
               for word in ("off", "axis"))
    assert largest_difference(off, on) < 2e-11
    assert on.stats.steps < 0.8 * off.stats.steps
