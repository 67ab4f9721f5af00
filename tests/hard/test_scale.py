"""Chains of hundreds of bodies: as stable as short ones, and each body costs as much as in a chain of 64."""

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.model import GROUND, Body, Joint
from tests.scene_making import make_scene

EPS = np.finfo(float).eps
LINK = 0.05  # m; of all chains, so that longer ones have the same links and no slower motions


def chain(count, **options):
    """A chain of links on ball joints, let go from a straight line 60 degrees off the vertical, out of the plane."""
    half, inertia = np.array([0.0, 0.0, LINK / 2]), np.diag([1e-4, 1.1e-4, 2e-5])
    attitude = np.array([np.cos(np.pi / 6), 0.0, np.sin(np.pi / 6), 0.0])
    R = crosscheck.scene.model.rotation_from_quaternion(attitude)
    w = np.array([0.3, 0.2, 1.0])
    rate = R @ np.cross(w, -half)  # of a link's middle by its own turning; its end moves at twice that
    bodies = [Body(f"link {k}", 0.1, inertia, attitude, w, (2 * k + 1) * (R @ -half), (2 * k + 1) * rate)
              for k in range(count)]
    joints = [Joint(f"joint {k}", "spherical", k - 1 if k else GROUND, k, -half if k else np.zeros(3), half)
              for k in range(count)]
    return make_scene(bodies, joints, duration=0.1, samples=3, **options)


@pytest.mark.parametrize("method", ["DAE3L_LE", "DAE2L_LSE", "DAE1H_LSE", "rattle2", "rattle4", "rkmk4"])
@pytest.mark.parametrize("count", [256, 1024])
def test_long_chains_stay_closed_and_keep_their_energy(count, method):
    scene = chain(count)
    step = 5e-4
    traj = crosscheck.run(scene, "lieeuler", method, step=step)
    length = count * LINK
    assert traj.status == "success"
    # positions along a chain of that length, each step anew; Runge-Kutta steps project once
    assert traj.stats["constraint_position"] <= 50 * EPS * length
    kinetic = 0.5 * np.sum(scene.masses[:, None] * traj.v[-1] ** 2)
    error = np.abs(traj.energy - traj.energy[0]).max() / kinetic
    # first order loses or gains its share of w h a radian; the links turn by up to w T ~ 1 rad; others are far below
    assert error < {True: 20 * step, False: 0.1 * step}[method.startswith("DAE")]


@pytest.mark.parametrize("method", ["DAE2L_LSE", "DAE1H_LSE", "rattle2"])
def test_iterations_of_a_step_do_not_grow_with_the_chain(method):
    """Cost is iterations by bodies, for elimination from the leaves costs as much for each."""
    per_step = []
    for count in (64, 256, 1024):
        traj = crosscheck.run(chain(count), "lieeuler", method, step=5e-4)
        per_step.append(traj.stats["newton_iterations"] / traj.steps)
    assert max(per_step) <= per_step[0] + 1
