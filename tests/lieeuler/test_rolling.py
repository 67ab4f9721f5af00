"""Knife edges, rolling disks and spheres: derivatives of their rows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import lieeuler
from lieeuler import _kernel
from tests.lieeuler.test_constraints import assert_derivatives


@pytest.mark.parametrize("kind", ["edge", "disk", "sphere"])
@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_derivatives_of_rows(kind, seed):
    """By central differences in the group; Phi has the row of the height alone, whose derivative is the first of G."""
    rng = np.random.default_rng(seed)
    normal, axis = rng.standard_normal((2, 3))
    joint = lieeuler.Joint(-1, 0, *rng.standard_normal((2, 3)), spherical=False,
                           contact=lieeuler.Contact(kind, normal, axis, 0.4))
    system = _kernel.System([1.0], [np.eye(3)], np.zeros(3))
    joint.add_to(system)
    plan = _kernel.Plan(system)
    x, R = rng.standard_normal((1, 3)), Rotation.random(1, random_state=rng).as_matrix()
    if kind == "disk":  # next to lying flat its derivatives have no bound
        R[0] = Rotation.align_vectors(rng.standard_normal(3) * 0.3 + np.cross(joint.contact.normal, [0.3, 0.5, 0.8]),
                                      joint.contact.axis)[0].as_matrix()
        if abs(joint.contact.normal @ R[0] @ joint.contact.axis) > 0.8:
            return
    (u, d), lam = rng.standard_normal((2, 6)), rng.standard_normal(joint.rows)

    def bound(here):
        names = ("gamma", "G", "geometric_stiffness", "velocity_slope")
        return 1e-7 * (1 + max(np.abs(here[name]).max() for name in names)) ** 2

    assert_derivatives(plan, x, R, u, d, lam, bound, positions=[0])
