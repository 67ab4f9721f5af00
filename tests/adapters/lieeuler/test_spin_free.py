"""The spin-free frame: used if a problem allows it, exact, and not used if something depends on the spin."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck import references
from crosscheck.adapters.lieeuler import build_problem
from lieeuler.spin_free import spin_free_frames
from tests.scene.test_dalembert import slope


def top(**changes):
    return dataclasses.replace(build_problem(crosscheck.load_scene("heavy_top")), **changes)


def with_inertia(inertia):
    problem = top()
    return dataclasses.replace(problem, bodies=(dataclasses.replace(problem.bodies[0], inertia=inertia),))


def test_the_top_is_found_with_its_spin():
    frames = spin_free_frames(top())
    np.testing.assert_array_equal(frames.spins, [[0, 150.0, 0]])
    np.testing.assert_array_equal(frames.problem.w, [[0, 0, -4.61538]])


def symmetric(matrix):
    return 0.5 * (matrix + matrix.T)


TURN = np.linalg.qr(np.array([[1.0, 2, 3], [0, 1, 4], [5, 6, 0]]))[0]


@pytest.mark.parametrize("problem", [
    with_inertia(np.diag([0.234375, 0.46875, 0.2349])),  # not symmetric
    with_inertia(np.diag([0.234375, 0.234375, 0.46875])),  # symmetric about another axis than the anchor's
    top(w=np.zeros((1, 3)), v=np.zeros((1, 3))),  # does not spin
    top(forces=[lieeuler.LinearSpring(-1, 0, [1.0, 0, 0], [0.1, 0.5, 0], 10.0, 0.5)]),
    top(forces=[lieeuler.ConstantLoad(0, force=[1.0, 0, 0], point=[0, 1.0, 0], frame="body")]),
    top(forces=[lieeuler.ConstantLoad(0, torque=[0, 0, 0.1])]),
])
def test_nothing_is_found_where_the_spin_matters(problem):
    assert spin_free_frames(problem) is None


def test_a_hinge_across_the_axis_ends_it():
    scene = crosscheck.load_scene("torsion_wheel")
    assert spin_free_frames(build_problem(scene)) is None


@pytest.mark.parametrize("forces", [
    (),
    (lieeuler.LinearSpring(-1, 0, [1.0, 0.2, -0.5], [0, 0.4, 0], 500.0, 0.8, 2.0),),
    (lieeuler.ConstantLoad(0, force=[3.0, -2, 1], point=[0, 0.7, 0]),),
    (lieeuler.ConstantLoad(0, force=[0, 20.0, 0], point=[0, -0.7, 0], frame="body"),),
])
@pytest.mark.parametrize("method", ["taylor", "rkmk853"])
def test_both_frames_give_the_same_motion(method, forces):
    problem, t = top(forces=forces), np.linspace(0, 0.3, 13)
    plain = lieeuler.integrate(problem, method, t_eval=t, rtol=1e-12, spin_free=False)
    free = lieeuler.integrate(problem, method, t_eval=t, rtol=1e-12, spin_free=True)
    assert (free.stats.spin_free, plain.stats.spin_free) == ((0,), ())
    assert 1.5 * free.stats.steps < plain.stats.steps
    for name, size in (("x", 1), ("R", 1), ("v", 5), ("w", 150), ("a", 25), ("alpha", 150**2), ("lam", 400)):
        # both runs are within 100 rtol of the truth: the body turns by 45 rad
        np.testing.assert_allclose(getattr(free, name), getattr(plain, name), rtol=0, atol=200e-12 * size * 10,
                                   err_msg=name)


def test_a_disk_that_is_welded_on_the_top_spins_with_it():
    """Both are one body, whose spin is left out; both are named, and come back as without all this."""
    problem, y = top(), np.array([0.0, 0.3, 0.0])
    weld = lieeuler.fixed_joint(0, 1, y, np.zeros(3), np.eye(3))
    x, v = problem.x[0] + problem.R[0] @ y, problem.v[0] + problem.R[0] @ np.cross(problem.w[0], y)
    both = lieeuler.Problem(problem.bodies * 2, (*problem.joints, weld), problem.gravity, [*problem.x, x],
                            np.repeat(problem.R, 2, axis=0), [*problem.v, v], np.repeat(problem.w, 2, axis=0))
    free, plain = (lieeuler.integrate(both, "taylor", t_eval=np.linspace(0, 0.2, 5), rtol=1e-12, **options)
                   for options in ({}, {"spin_free": False, "reduce": "off"}))
    assert (free.stats.spin_free, free.stats.reduce) == ((0, 1), "welded")
    for name, size in (("x", 1), ("R", 1), ("v", 5), ("w", 150), ("a", 25), ("alpha", 150**2), ("lam", 2000)):
        np.testing.assert_allclose(getattr(free, name), getattr(plain, name), rtol=0, atol=2e-9 * size, err_msg=name)


@pytest.mark.parametrize("turn", [np.eye(3), TURN * np.linalg.det(TURN)])
def test_any_axis_and_a_sphere(turn):
    """The top with its body axes turned, and a sphere, whose axis is that of its anchor."""
    problem, t = top(), [0.0, 0.1, 0.2]
    joint = problem.joints[0]
    for inertia in (problem.bodies[0].inertia, np.eye(3) * 0.3):
        turned = dataclasses.replace(
            problem, bodies=(dataclasses.replace(problem.bodies[0], inertia=symmetric(turn @ inertia @ turn.T)),),
            joints=(dataclasses.replace(joint, child_anchor=turn @ joint.child_anchor),), R=problem.R @ turn.T,
            w=problem.w @ turn.T)
        free = lieeuler.integrate(turned, "taylor", t_eval=t, rtol=1e-12)
        plain = lieeuler.integrate(turned, "taylor", t_eval=t, rtol=1e-12, spin_free=False)
        assert free.stats.spin_free == (0,)
        np.testing.assert_allclose(free.R, plain.R, rtol=0, atol=1e-9)  # 1000 rtol over 30 rad
        np.testing.assert_allclose(free.w, plain.w, rtol=0, atol=150e-9)


@pytest.mark.parametrize("method", ["rattle2", "DAE1H_LSE", "DAE2H_LE", "DAE1L_LSE", "DAE2L_LE", "DAE3L_LE", "rkmk4"])
def test_every_kind_of_method_keeps_its_order(method):
    scene = crosscheck.load_scene("heavy_top").replace(duration=0.2, samples=11)
    truth = references.truth(scene).states
    order = lieeuler.METHODS[method].order
    steps = np.array([4e-3, 2e-3, 1e-3]) if order > 1 else np.array([4e-4, 2e-4, 1e-4])
    for name in ("x", "R", "w"):
        errors = [np.abs(getattr(crosscheck.run(scene, "lieeuler", method, step=h, spin_free=True), name)
                         - getattr(truth, name)).max() for h in steps]
        assert slope(steps, errors) == pytest.approx(order, abs=0.2), (name, errors)


def test_energy_and_levels_are_those_of_the_body():
    scene = crosscheck.load_scene("heavy_top")
    traj = crosscheck.run(scene, "lieeuler", "rattle2", step=1e-3, spin_free=True)
    own = np.abs(traj.energy - traj.energy[0]).max() / traj.energy.max()
    assert own <= traj.stats["energy_error"] * 1.05 + 1e-12  # errors at every step against those at the samples
    assert traj.stats["energy_error"] < 1e-5
    assert traj.stats["spin_free"] == ("top",)


def test_defaults():
    """On for the methods of higher order, off for the Euler methods unless asked."""
    problem = top()
    for method, on in (("rattle2", True), ("DAE1H_LSE", False)):
        run = lieeuler.integrate(problem, method, 1e-4, [0, 1e-3])
        assert bool(run.stats.spin_free) is on
        assert bool(lieeuler.integrate(problem, method, 1e-4, [0, 1e-3], spin_free=not on).stats.spin_free) is not on
