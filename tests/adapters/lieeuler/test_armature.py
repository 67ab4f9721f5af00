"""Rotor inertia of joints, and with it mimics: dense algebra."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene import mechanics
from lieeuler import reference
from tests import geared_oracle
from tests.lieeuler.accuracy import EPS

AGREEMENT = 1e-12  # both solve the same equations to rounding, and the steps accumulate little of it
FIRST_ORDER = [name for name, method in lieeuler.METHODS.items() if method.order == 1]


def geared_arm(factor=1.0, sprung=True):
    """The scene of the library for a second, its rotors heavier by a factor; `sprung`: with its springs and dampers."""
    scene = crosscheck.load_scene("geared_arm").replace(duration=1.0, samples=5)
    none = {} if sprung else {"damping": (), "stiffness": (), "rest_position": ()}
    joints = (dataclasses.replace(joint, armature=tuple(factor * value for value in joint.armature), **none)
              for joint in scene.joints)
    return scene.replace(joints=tuple(joints))


def end_of(solution):
    return solution.x[-1], solution.R[-1], np.hstack([solution.v[-1], solution.w[-1]])


def compared(scene, method, h, steps, **options):
    solution = lieeuler.integrate(build_problem(scene), method, h, [0, steps * h], **options)
    system, record = geared_oracle.Geared(scene), lieeuler.METHODS[method]
    start = (scene.x0, scene.R0), np.hstack([scene.v0, scene.w0]).ravel(), h, steps
    if record.formulation == "hamilton" or method == "rattle2":
        (x, R), u = geared_oracle.integrate(system, record, *start, **options)
    else:
        own = reference.steps(system, record(step=h, **options), *start[:2])
        (x, R), u, *_ = next(itertools.islice(own, steps - 1, None))
    for mine, other in zip(end_of(solution), (x, R, u.reshape(-1, 6)), strict=True):
        assert np.abs(mine - other).max() < AGREEMENT * max(1.0, np.abs(other).max())


def coupled_arm(**changes):
    """The scene of the library for a second, two of whose coordinates follow others."""
    return crosscheck.load_scene("coupled_arm").replace(**{"duration": 1.0, "samples": 5} | changes)


SCENES = {"rotors": lambda: geared_arm(sprung=False), "mimics": coupled_arm}


@pytest.mark.parametrize("method", ["DAE2L_LSE", "DAE2H_LE", "rattle2", "generalized_alpha"])
@pytest.mark.parametrize("what", SCENES)
def test_kernel_agrees_with_dense_algebra(what, method):
    compared(SCENES[what](), method, 2e-2, 2)


@pytest.mark.parametrize("method", [*FIRST_ORDER, "rattle2", "generalized_alpha"])
@pytest.mark.parametrize("what", SCENES)
def test_kernel_agrees_with_dense_algebra_in_every_method(what, method):
    compared(SCENES[what](), method, 1e-2, 5)


@pytest.mark.parametrize("method", ["DAE2L_LSE", "DAE2H_LE", "DAE1H_LSE"])
@pytest.mark.parametrize("coordinate_map", ["cayley", "ccsk"])
def test_other_maps_agree_with_dense_algebra(method, coordinate_map):
    compared(geared_arm(sprung=False), method, 1e-2, 3, map=coordinate_map)


def assert_index1(scene, share):
    """The first accelerations of a run against the dense equations, to a share of their size; the run."""
    run = lieeuler.integrate(build_problem(scene), "INDEX1_LE", 1e-6, [0, 1e-6])
    a, alpha, lam = mechanics.index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    bound = share * max(np.abs(a).max(), np.abs(alpha).max())
    assert max(np.abs(run.a[0] - a[0]).max(), np.abs(run.alpha[0] - alpha[0]).max()) < bound
    if not run.stats.redundant_rows:
        assert run.lam.shape == (2, build_problem(scene).rows)
        assert np.abs(run.lam[0] - lam[0]).max() < 1e-12 * np.abs(lam).max()
    return run


@pytest.mark.parametrize("factor", [1e-4, 1.0, 1e4])
def test_accelerations_are_those_of_the_dense_equations(factor):
    """Rotors far lighter and far heavier than the bodies; reactions then cancel by the ratio of inertias."""
    scene = geared_arm(factor)
    ratio = max(max(joint.armature) for joint in scene.joints) / np.linalg.eigvalsh(scene.inertias).min()
    assert_index1(scene, 50 * EPS * max(1.0, ratio))


def test_accelerations_of_mimics_are_those_of_the_dense_equations():
    assert_index1(coupled_arm(), 200 * EPS)


@pytest.mark.parametrize("method", ["taylor", "rkmk853", "rkmk54", "seulex"])
@pytest.mark.parametrize("make", [geared_arm, coupled_arm])
def test_adaptive_methods_end_at_the_truth(make, method):
    scene = make()
    truth = crosscheck.truth(scene).states
    run = lieeuler.integrate(build_problem(scene), method, None, scene.t, rtol=1e-12)
    bound = 1e-9 if method == "seulex" else 1e-11  # the table of seulex magnifies rounding by some 1e6
    assert max(np.abs(getattr(run, name) - getattr(truth, name)).max() for name in "xRvw") < bound


def test_energy_counts_the_rotors():
    scene = geared_arm(sprung=False)
    run = crosscheck.run(scene, engine="lieeuler", method="rkmk853", rtol=1e-13)
    assert run.stats["energy_error"] < 1e-12
    assert np.abs(run.energy - run.energy[0]).max() < 1e-12 * np.abs(run.energy).max()


def test_a_symmetric_body_with_a_rotor_keeps_its_spin():
    """A spin-free frame would remove the spin from the rotor's rate."""
    scene = geared_arm(sprung=False)
    body = dataclasses.replace(scene.bodies[0], inertia=np.diag([0.1, 0.1, 0.15]))
    problem = build_problem(scene.replace(bodies=(body, *scene.bodies[1:])))
    assert lieeuler.integrate(problem, "taylor", None, [0, 0.1], rtol=1e-10, spin_free=True).stats.spin_free == ()


def geared_four_bar():
    """The planar linkage, which has redundant rows, with a rotor on every hinge, that of the loop too."""
    scene = crosscheck.load_scene("four_bar").replace(duration=0.5, samples=3)
    return scene.replace(joints=tuple(dataclasses.replace(joint, armature=(0.02 * (k + 1),))
                                      for k, joint in enumerate(scene.joints)))


def test_rotors_of_a_loop_with_redundant_rows():
    assert assert_index1(geared_four_bar(), 1e-12).stats.redundant_rows == 3


@pytest.mark.parametrize("method", ["taylor", "rkmk853"])
def test_rotors_in_the_plane_of_a_mechanism(method):
    """Whole and reduced, at a tolerance where neither errs by more than rounding and the loop's condition of it."""
    runs = [lieeuler.integrate(build_problem(geared_four_bar()), method, None, [0, 0.25, 0.5], rtol=1e-13, reduce=word)
            for word in ("off", "planar")]
    assert [run.stats.reduce for run in runs] == ["off", "planar"]
    for name in ("x", "R", "v", "w", "a", "alpha", "lam"):
        one, other = (getattr(run, name) for run in runs)
        assert one.shape == other.shape
        assert np.abs(one - other).max() < 1e-10 * max(1.0, np.abs(one).max()), name
    assert max(run.stats.maxima["energy_error"] for run in runs) < 1e-11


@pytest.mark.parametrize("method", ["taylor", "rkmk853"])
def test_rotors_pull_as_newton_and_euler_say(method):
    """d'Alembert: along the free coordinate of a joint all that lies beyond it is moved by -I d(rate)/dt alone."""
    scene = geared_arm(sprung=False).replace(duration=0.04, samples=41)
    traj = crosscheck.run(scene, "lieeuler", method, rtol=1e-13)
    mid = 20
    x, R, w, a, alpha = (getattr(traj, name)[mid] for name in ("x", "R", "w", "a", "alpha"))
    force = scene.masses[:, None] * (a - scene.gravity)
    torque = np.array([turn @ (J @ rate + np.cross(spin, J @ spin))
                       for turn, J, rate, spin in zip(R, scene.inertias, alpha, w, strict=True)])
    for k, joint in enumerate(scene.joints):  # a chain: the bodies from k on lie beyond joint k
        axis, anchor = R[k] @ joint.child_axis, x[k] + R[k] @ joint.child_anchor
        moment = (torque[k:] + np.cross(x[k:] - anchor, force[k:])).sum(axis=0)
        needed = {"revolute": [axis @ moment], "prismatic": [axis @ force[k:].sum(axis=0)],
                  "cylindrical": [axis @ moment, axis @ force[k:].sum(axis=0)]}[joint.type]
        v = traj.joints[joint.name].velocity.reshape(41, -1)
        rate = (8 * (v[mid + 1] - v[mid - 1]) - (v[mid + 2] - v[mid - 2])) / (12 * scene.t[1])
        # differences of values to 1e-13 over a millisecond; their truncation is h^4 / 30 of rates of some 1e3 / s^5
        assert np.abs(needed + np.array(joint.armature) * rate).max() < 1e-9, joint.name
