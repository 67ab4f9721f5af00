"""Members that share registers: each is the run that it would be by itself, to the last bit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler import Status, _kernel, ensemble
from tests.lieeuler import systems
from tests.lieeuler.test_ensemble import FIELDS, member, spun

SETS = [name for name in _kernel.lane_sets() if name != "none"]
WIDTHS = {"avx2": 4, "avx512": 8}
T = np.array([0.0, 0.013, 0.2, 0.21, 0.9, 1.5])  # several within a step, and steps without one
pytestmark = pytest.mark.skipif(not SETS, reason="this processor has no registers for several members")


def skew(rng):
    """An inertia without a principal axis along a body axis."""
    R = Rotation.random(random_state=int(rng.integers(1000))).as_matrix()
    J = R @ systems.INERTIA @ R.T
    return 0.5 * (J + J.T)


def crooked_chain(n):
    rng = np.random.default_rng(n)
    anchors = [(np.array([0.1, 0.05, -0.9]) if k else np.array([0.3, 0.2, 0.1]), np.array([0.05, -0.1, 1.0]))
               for k in range(n)]
    attitudes = [(systems.TILT_X, systems.TILT_Y)[k % 2] for k in range(n)]
    return systems.chain(1.0 + 0.2 * np.arange(n), [skew(rng) for _ in range(n)], anchors, attitudes,
                         rng.standard_normal((n, 3)))


def flying_branches():
    """A body in free fall that carries two others, one of which is named before it."""
    rng = np.random.default_rng(5)
    joints = [lieeuler.spherical_joint(1, 0, [0.3, 0.1, 0.2], [0.0, 0.4, -0.1]),
              lieeuler.spherical_joint(1, 2, [-0.2, 0.2, 0.1], [0.1, 0.0, 0.5])]
    bodies = [lieeuler.Body(mass, skew(rng)) for mass in (0.7, 1.5, 1.1)]
    x = np.array([[0.3, -0.3, 0.3], [0.0, 0.0, 0.0], [-0.3, 0.2, -0.4]])
    return lieeuler.Problem(bodies, joints, [0.5, 0.0, -9.0], x, np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 3)),
                            np.zeros((3, 3)))


def flying_chain():
    """Three bodies in free fall one below the other, named in another order."""
    branches = flying_branches()
    joints = [lieeuler.spherical_joint(0, 1, [0.0, 0.4, -0.1], [0.3, 0.1, 0.2]), branches.joints[1]]
    return dataclasses.replace(branches, joints=joints)


def flying_states(problem, count):
    """States of three bodies with parallel axes, whose joints fix their velocities relative to each other."""
    rng = np.random.default_rng(2)
    w, v = rng.standard_normal((2, count, 3, 3))
    for joint in problem.joints:
        at = np.cross(w[:, joint.parent], joint.parent_anchor) - np.cross(w[:, joint.child], joint.child_anchor)
        v[:, joint.child] = v[:, joint.parent] + at
    return {"v": v, "w": w}


SYSTEMS = {**systems.SYSTEMS, "crooked_2": lambda: crooked_chain(2), "crooked_3": lambda: crooked_chain(3),
           "crooked_4": lambda: crooked_chain(4)}


CONTROLS = {"taylor": {"rtol": 1e-9}, "rkmk4": {"step": 2e-3}, "rkmk853": {"step": 2e-3}}
METHODS = pytest.mark.parametrize("method", ["taylor", "rkmk4"])


@pytest.fixture
def ensembles(monkeypatch):
    """`integrate_ensemble` by a set of instructions."""
    def run(lanes, problem, method="taylor", *, t_eval=T, **arguments):
        monkeypatch.setattr(ensemble, "LANES", lanes)
        return lieeuler.integrate_ensemble(problem, method, t_eval=t_eval, **CONTROLS[method] | arguments)
    return run


def same(one, other):
    for name in (*FIELDS, "status", "t_end", "steps", "rejected_steps"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize(("method", "controls"), [
    ("taylor", {"rtol": 1e-2}), ("taylor", {"rtol": 1e-12}), ("rkmk4", {}), ("rkmk853", {})])
@pytest.mark.parametrize("lanes", SETS)
@pytest.mark.parametrize("make", SYSTEMS.values(), ids=SYSTEMS)
def test_lanes_change_no_bit(ensembles, make, lanes, method, controls):
    problem = make()
    for count in (1, 3, 4, 5, 17):
        states = spun(problem, count, size=0.5)
        alone = ensembles("none", problem, method, threads=1, spin_free=False, **states, **controls)
        many = ensembles(lanes, problem, method, threads=2, spin_free=False, **states, **controls)
        same(many, alone)
        assert (alone.lanes == 1).all()
        assert (many.lanes == WIDTHS[lanes]).all()


@pytest.mark.parametrize("lanes", SETS)
@pytest.mark.parametrize(("make", "method", "shared"), [
    (flying_branches, "taylor", True), (flying_branches, "rkmk4", False), (flying_chain, "rkmk4", True)])
def test_a_tree_that_flies(ensembles, make, method, shared, lanes):
    """Lanes of explicit methods know chains, but no branches."""
    problem = make()
    states = flying_states(problem, 9)
    many = ensembles(lanes, problem, method, **states)
    same(many, ensembles("none", problem, method, **states))
    assert many.success.all()
    assert (many.lanes == (WIDTHS[lanes] if shared else 1)).all()


@METHODS
@pytest.mark.parametrize("lanes", SETS)
def test_members_with_their_own_bodies_and_spins(ensembles, method, lanes):
    problem = systems.heavy_top()
    states = spun(problem, 6)
    parameters = {"bodies.0.mass": np.linspace(14.0, 16.0, 6), "gravity.2": -np.linspace(9.0, 10.0, 6)}
    many = ensembles(lanes, problem, method, parameters=parameters, **states)
    same(many, ensembles("none", problem, method, parameters=parameters, **states))
    assert (many.lanes == WIDTHS[lanes]).all()
    assert len(np.unique(many.x[:, -1], axis=0)) == 6


@METHODS
@pytest.mark.parametrize("lanes", SETS)
def test_the_place_of_a_member_does_not_matter(ensembles, method, lanes):
    problem = systems.double_pendulum()
    states = spun(problem, 37)
    order = np.random.default_rng(4).permutation(37)
    straight = ensembles(lanes, problem, method, threads=1, **states)
    for threads in (1, 2, 4):
        mixed = ensembles(lanes, problem, method, threads=threads,
                          **{name: values[order] for name, values in states.items()})
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(mixed, name), getattr(straight, name)[order])


@pytest.mark.parametrize("lanes", SETS)
@pytest.mark.parametrize(("method", "speed", "status"), [
    ("taylor", 1e14, Status.STEP_TOO_SMALL), ("taylor", 1e99, None), ("rkmk4", 1e14, None), ("rkmk4", 1e99, None)])
def test_a_member_that_fails_harms_no_other(ensembles, lanes, method, speed, status):
    """It ends as it does by itself, and its neighbours as they do without it."""
    problem = systems.double_pendulum()
    states = spun(problem, 11)
    wild = spun(problem, 11, seed=3, size=speed)
    for name in states:
        states[name][6] = wild[name][6]
    many = ensembles(lanes, problem, method, **states)
    same(many, ensembles("none", problem, method, **states))
    others = np.arange(11) != 6
    assert many.status[6] != Status.SUCCESS
    assert status is None or many.status[6] == status
    assert many.lanes[6] == 1
    assert (many.status[others] == Status.SUCCESS).all()
    assert (many.lanes[others] > 1).all()
    assert np.isnan(many.x[6, 1:]).all()
    calm = ensembles(lanes, problem, method, **{name: values[others] for name, values in states.items()})
    np.testing.assert_array_equal(many.x[others], calm.x)


@pytest.mark.parametrize("lanes", SETS)
def test_a_member_that_turns_far_in_a_step_runs_by_itself(ensembles, lanes):
    """More than half a radian needs trigonometric functions, which lanes do not have."""
    problem = systems.single_pendulum()
    states = spun(problem, 9)
    states["w"][4] = [0.0, 0.0, 60.0]
    states["v"][4] = 0.0
    many = ensembles(lanes, problem, "rkmk4", step=0.01, **states)
    same(many, ensembles("none", problem, "rkmk4", step=0.01, **states))
    assert many.success.all()
    assert many.lanes.tolist() == [1 if k == 4 else WIDTHS[lanes] for k in range(9)]


@pytest.mark.parametrize("lanes", SETS)
def test_light_bodies_that_carry_heavy_ones_are_refined_by_themselves(ensembles, lanes):
    """Pivots below 1e-3 need a second solve, which lanes do not have."""
    problem = systems.double_pendulum()
    bodies = (lieeuler.Body(1e-3, 1e-4 * systems.INERTIA), lieeuler.Body(10.0, 10.0 * systems.INERTIA))
    problem = dataclasses.replace(problem, bodies=bodies)
    states = spun(problem, 5, size=0.01)
    many = ensembles(lanes, problem, t_eval=[0.0, 0.1], **states)
    same(many, ensembles("none", problem, t_eval=[0.0, 0.1], **states))
    assert (many.lanes == 1).all()


def test_systems_that_lanes_do_not_know_run_by_themselves():
    problem = systems.spring_chain(2)
    many = lieeuler.integrate_ensemble(problem, "taylor", rtol=1e-9, t_eval=T, parameters={"bodies.0.mass": [1.0, 1.1]})
    assert (many.lanes == 1).all()
    alone = lieeuler.integrate(member(problem, {}, 0), "taylor", rtol=1e-9, t_eval=T)
    np.testing.assert_array_equal(many.x[0], alone.x)
