"""Constraint rows of the kernel and their derivatives against central differences in the group."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieeuler import Dot, Joint, Rotor, _kernel

STEP = 1e-5


def kernel_system(joint):
    system = _kernel.System([1.0, 1.0], [np.eye(3), np.eye(3)], np.zeros(3))
    joint.add_to(system)
    joint.add_rotors_to(system, 0)
    return _kernel.Plan(system)


def joint_of(kind, rng, parent):
    anchors = rng.standard_normal((2, 3))
    a, b = rng.standard_normal((2, 3))
    dots = {
        "spherical": (),
        "dot-1": (Dot("parent", "child", a, b, constant=0.3),),
        "dot-2": (Dot("parent", "difference", a, np.zeros(3), constant=0.1),),
        "rotor": (Dot("parent", "difference", a),),
        "distance": (Dot("difference", "difference", constant=0.4, scale=0.7),),
        "revolute": (Dot("parent", "child", a, b), Dot("parent", "child", b, a)),
        "cylindrical": (Dot("parent", "child", a, b), Dot("parent", "child", b, b),
                        Dot("parent", "difference", a), Dot("parent", "difference", b)),
    }[kind]
    rotors = (Rotor(0.3, b, a, turns=False),) if kind == "rotor" else ()
    return Joint(parent, 1, *anchors, spherical=kind in ("spherical", "revolute"), dots=dots, rotors=rotors)


def moved(x, R, du, step):
    du = step * du.reshape(-1, 6)
    return x + du[:, :3], R @ Rotation.from_rotvec(du[:, 3:]).as_matrix()


def assert_derivatives(plan, x, R, u, d, lam, bound, positions=slice(None)):
    """Of the rows of a state along d by central differences; `positions`: the rows that Phi has.

    bound(values): of the differences, STEP^2 = 1e-10 and eps / STEP = 2e-11, times third derivatives.
    """
    def values(x, R, u):
        u = u.reshape(-1, 6)
        return _kernel.constraints(plan, x, R, np.ascontiguousarray(u[:, :3]), np.ascontiguousarray(u[:, 3:]), lam)

    def slope(function, direction):
        return (function(*moved(x, R, direction, STEP)) - function(*moved(x, R, direction, -STEP))) / (2 * STEP)

    here = values(x, R, u)
    most = bound(here)
    assert np.abs((slope(lambda x, R: values(x, R, u)["phi"], d) - here["G"] @ d)[positions]).max() < most
    assert not np.delete(here["phi"], positions).any()
    assert np.abs(slope(lambda x, R: values(x, R, u)["G"] @ u, d) - here["velocity_slope"] @ d).max() < most
    assert np.abs(slope(lambda x, R: values(x, R, u)["G"] @ u, u) - here["gamma"]).max() < most
    assert np.abs(slope(lambda x, R: values(x, R, u)["G"].T @ lam, d) - here["geometric_stiffness"] @ d).max() < most
    by_velocity = (values(x, R, u + STEP * d)["gamma"] - values(x, R, u - STEP * d)["gamma"]) / (2 * STEP)
    assert np.abs(by_velocity - here["gamma_velocity_slope"] @ d).max() < most


@pytest.mark.parametrize("kind", ["spherical", "dot-1", "dot-2", "distance", "revolute", "cylindrical",
                                  "rotor"])
@pytest.mark.parametrize("parent", [-1, 0])
@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_all_derivatives(kind, parent, seed):
    rng = np.random.default_rng(seed)
    joint = joint_of(kind, rng, parent)
    system = kernel_system(joint)
    x, R = rng.standard_normal((2, 3)), Rotation.random(2, random_state=rng).as_matrix()
    u, d = rng.standard_normal((2, 12))
    lam = rng.standard_normal(joint.rows + len(joint.rotors))

    def bound(here):
        return 1e-7 * (1 + sum(np.abs(here[name]).max() for name in ("gamma", "G", "geometric_stiffness")))

    assert_derivatives(system, x, R, u, d, lam, bound)
