"""Loops and rods, which have no coordinates here: what follows from the states at an instant."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from tests.oracle_values.cases import close, content, mechanism, scene
from tests.oracle_values.mechanics import Pose


def ran(name, samples=None):
    options = {} if samples is None else {"samples": samples}
    return crosscheck.run(scene(name), engine="lieeuler", method="rkmk853", rtol=1e-11, **options)


def grounded(values, last):
    """With the ground as the last body."""
    return np.concatenate([values, np.broadcast_to(last, (len(values), 1, *np.shape(last)))], axis=1)


def test_turns_in_a_loop():
    """Angles of every hinge by its axes, counted over outputs so near that none is missed."""
    name, fine = "crank_rocker", ran("crank_rocker", 301)
    few, R = ran(name), grounded(fine.R, np.eye(3))
    every = (len(fine.t) - 1) // (len(few.t) - 1)
    for joint in content(name)["joints"]:
        i, j = mechanism(name).index(joint["parent"]), mechanism(name).index(joint["child"])
        Q = np.swapaxes(R[:, i], 1, 2) @ R[:, j]  # all axes are y
        angle = np.unwrap(np.arctan2(Q[:, 0, 2], Q[:, 0, 0]))
        assert np.abs(np.diff(angle)).max() < 1.0
        close(few.joints[joint["name"]].position, angle[::every], joint["name"], 1e-7)


@pytest.mark.parametrize("name", ["bead_and_plate"])
def test_momentum_of_every_body_is_balanced(name):
    """Newton and Euler from the readings of forces and torques, at the site."""
    mech, run = mechanism(name), ran(name)
    site = next(site for site in mech.data["sites"])
    body = mech.index(site["body"])
    n = mech.n
    for k in range(len(run.t)):
        w = np.einsum("nij,nj->ni", run.R[k], run.w[k])
        pose = Pose(*(np.concatenate([part, last]) for part, last in (
            (run.R[k], np.eye(3)[None]), (run.x[k], np.zeros((1, 3))), (run.v[k], np.zeros((1, 3))),
            (w, np.zeros((1, 3))))), a=np.zeros((1, n + 1, 3)), alpha=np.zeros((1, n + 1, 3)),
            anchors=np.zeros((0, 3)), lines=[])
        F, T, _, _ = mech.applied(pose, run.t[k])
        point = run.x[k, body] + run.R[k, body] @ site["position"]
        for joint in mech.data["joints"]:
            force, torque = (run.sensors[f"{kind} world {joint['name']}"][k] for kind in ("force", "torque"))
            for end, sign in (("child", 1.0), ("parent", -1.0)):
                at = mech.index(joint[end])
                F[at] += sign * force
                T[at] += sign * (torque + np.cross(point - pose.x[at], force))
        for at in range(n):
            J = run.R[k, at] @ mech.J[at] @ run.R[k, at].T
            close(run.a[k, at], mech.g + F[at] / mech.mass[at], f"force on {mech.names[at]}", 1e-8)
            close(J @ run.R[k, at] @ run.alpha[k, at] + np.cross(w[at], J @ w[at]), T[at],
                  f"torque on {mech.names[at]}", 1e-8)
