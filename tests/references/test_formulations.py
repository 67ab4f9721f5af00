"""The two integrated formulations against exact solutions, conservation laws and each other."""

import dataclasses

import numpy as np
import pytest
from scipy.special import ellipj, ellipk, ellipkinc

from crosscheck.references import maximal
from crosscheck.references.taylor import Taylor
from crosscheck.scene.model import GROUND


def _series(scene):
    integrator = Taylor(scene)
    return integrator.states(integrator.run())


FORMULATIONS = {"taylor": _series, "maximal": lambda scene: maximal.Maximal(scene).run()}


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("rate", [0.0, 2.0, -9.0], ids=["released", "swinging", "over the top"])
def test_planar_pendulum(build, formulation, rate):
    """A body that swings about a principal axis is the mathematical pendulum of length I / (m l)."""
    mass, length, inertia, g, start = 1.2, 0.8, 0.2, 9.81, 1.0
    body = (mass, np.diag([0.1, inertia, 0.15]), [np.cos(start / 2), 0.0, np.sin(start / 2), 0.0], [0.0, rate, 0.0])
    scene = build([body], [(GROUND, 0, [0, 0, 0], [0, 0, length])], duration=3.0, samples=31)
    angle, angle_rate = pendulum(np.sqrt(mass * g * length / (inertia + mass * length**2)), start, rate, scene.t)
    states = FORMULATIONS[formulation](scene)
    exact = length * np.column_stack([-np.sin(angle), np.zeros_like(angle), -np.cos(angle)])
    # (14.2) of docs/theory.md: what a formulation reaches on a well-conditioned scene; angular rates are up to 10 times
    # larger
    np.testing.assert_allclose(states.x[:, 0], exact, rtol=0, atol=1e-12)
    np.testing.assert_allclose(states.w[:, 0, 1], angle_rate, rtol=0, atol=1e-11)


def pendulum(omega0, start, rate, t):
    """Angle and rate of theta'' = -omega0^2 sin(theta), by Jacobi elliptic functions."""
    m = np.sin(start / 2) ** 2 + (rate / (2 * omega0)) ** 2
    if m < 1:  # sin(theta / 2) = k sn
        k = np.sqrt(m)
        phase = ellipkinc(np.arcsin(min(1.0, np.sin(start / 2) / k)), m)
        sn, cn, _, _ = ellipj((phase if rate >= 0 else 2 * ellipk(m) - phase) + omega0 * t, m)
        return 2 * np.arcsin(k * sn), 2 * k * omega0 * cn
    sign, speed = np.sign(rate), omega0 * np.sqrt(m)  # theta / 2 = am
    _, _, dn, amplitude = ellipj(ellipkinc(sign * start / 2, 1 / m) + speed * t, 1 / m)
    return 2 * sign * amplitude, 2 * sign * speed * dn


@pytest.fixture(scope="session")
def motions(tree):
    """States of a tree by both formulations, integrated once."""
    return {name: run(tree) for name, run in FORMULATIONS.items()}


def test_agree_in_everything(motions):
    one, other = motions["taylor"], motions["maximal"]
    # (14.2) of docs/theory.md with the amplification of the top, 241, which is the largest. Velocities carry a factor
    # of the rates of the scene (150 / s in the top), accelerations its square.
    rate = max(1.0, np.max(np.abs(one.w)))
    for name, factor in (("x", 1.0), ("R", 1.0), ("v", rate), ("w", rate), ("a", rate**2), ("alpha", rate**2)):
        difference = np.max(np.abs(getattr(one, name) - getattr(other, name)))
        assert difference <= 241e-14 * factor, name


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_starts_at_the_scene(tree, motions, formulation):
    states = motions[formulation]
    for ours, given in ((states.x, tree.x0), (states.R, tree.R0), (states.v, tree.v0), (states.w, tree.w0)):
        # levers are summed along the tree in another order than in the scene: rounding of the sizes involved
        rounding = 50 * np.finfo(float).eps * max(1.0, np.max(np.abs(given)))
        np.testing.assert_allclose(ours[0], given, rtol=0, atol=rounding)


def mechanics(scene, states):
    """Kinetic energy, total energy, linear momentum and angular momentum about the origin, over time."""
    m, J, w = scene.masses, scene.inertias, states.w
    kinetic = (0.5 * np.einsum("i,tik,tik->t", m, states.v, states.v)
               + 0.5 * np.einsum("tij,ijk,tik->t", w, J, w))
    energy = kinetic - np.einsum("i,tik,k->t", m, states.x, scene.gravity)
    spin = np.einsum("tiab,ibc,tic->ta", states.R, J, w)
    orbital = np.einsum("i,tia->ta", m, np.cross(states.x, states.v))
    return kinetic, energy, np.einsum("i,tia->ta", m, states.v), spin + orbital


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_energy_and_momentum(tree, motions, formulation):
    states = motions[formulation]
    kinetic, energy, linear, angular = mechanics(tree, states)
    # issue 2: energy and momentum of the truth hold at 1e-12, relative to their largest terms
    assert np.ptp(energy) <= 1e-12 * np.max(kinetic)
    if all(joint.parent != GROUND for joint in tree.joints):
        fall = np.outer(tree.t, tree.gravity) * np.sum(tree.masses)
        np.testing.assert_allclose(linear, linear[0] + fall, rtol=0, atol=1e-12 * np.max(np.abs(fall)))
    if not any(np.any(joint.parent_anchor) for joint in tree.joints if joint.parent == GROUND):
        assert np.ptp(angular[:, 2]) <= 1e-12 * np.max(np.abs(angular))


def test_accelerations_are_derivatives_of_velocities(tree):
    """Five-point differences of w and v, whose error is h^4 d^5/30 and rounding / h: about 1e-9 of the scale."""
    h = 1e-3 / max(1.0, np.max(np.abs(tree.w0)))
    states = _series(tree.replace(duration=4 * h, samples=5))
    for value, rate in ((states.v, states.a), (states.w, states.alpha)):
        slope = (value[0] - 8 * value[1] + 8 * value[3] - value[4]) / (12 * h)
        np.testing.assert_allclose(slope, rate[2], rtol=0, atol=1e-9 * max(1.0, np.max(np.abs(value)) / h * 1e-3))


def test_joint_bodies_in_either_order(double):
    """A joint that names its bodies the other way round is the same joint."""
    elbow = double.joints[1]
    swapped = dataclasses.replace(elbow, parent=elbow.child, child=elbow.parent, parent_anchor=elbow.child_anchor,
                                  child_anchor=elbow.parent_anchor)
    same = double.replace(joints=(double.joints[0], swapped))
    np.testing.assert_allclose(_series(same).x, _series(double).x, rtol=0, atol=1e-13)  # another order of sums
    np.testing.assert_allclose(maximal.Maximal(same).run().x, maximal.Maximal(double).run().x, rtol=0, atol=1e-12)
