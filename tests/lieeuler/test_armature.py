"""Rotor inertia of joints in an equivalent system."""

from __future__ import annotations

import numpy as np

import lieeuler


def test_a_hinge_on_the_ground_turns_as_one_of_more_inertia():
    """Its axis is a principal one of the body: there I adds to the moment of inertia, and nothing else differs."""
    body = lieeuler.Body(2.0, np.diag([0.3, 0.2, 0.4]))
    heavier = lieeuler.Body(2.0, np.diag([0.3, 0.2, 0.4]) + np.diag([0.0, 0.25, 0.0]))
    hinge = lieeuler.revolute_joint(-1, 0, np.zeros(3), [0, 0, 1.0], [0, 1.0, 0], [0, 1.0, 0])
    state = ([9.81, 0, 0], [[0, 0, -1.0]], np.eye(3)[None], [[-3.0, 0, 0]], [[0, 3.0, 0]])
    runs = [lieeuler.integrate(lieeuler.Problem([b], [j], *state), "taylor", None, [0, 0.5, 1], rtol=1e-14)
            for b, j in ((body, hinge.geared(lieeuler.Rotor(0.25, [0, 1.0, 0], [0, 1.0, 0]))), (heavier, hinge))]
    for name in ("x", "R", "v", "w", "lam"):
        assert np.abs(getattr(runs[0], name) - getattr(runs[1], name)).max() < 1e-12, name
