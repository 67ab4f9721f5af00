"""Inverse dynamics, derivatives of accelerations and of flows, against the equations of `mechanics`."""

from __future__ import annotations

import copy
import functools

import numpy as np
import pytest

import crosscheck
from tests.oracle_values.cases import OPEN, close, content, mechanism, scene
from tests.oracle_values.figures import apart, derivatives, inverse_dynamics, moved, slope
from tests.oracle_values.links import edited, number
from tests.oracle_values.mechanics import Mechanism
from tests.oracle_values.motion import Instant, motion, start

every = pytest.mark.parametrize("name", OPEN)
LAWS = ("braked_wheel", "two_stops", "soft_stop", "winding_servo", "sampled_servo")


def states(name, count):
    """Coordinates (dofs,), numbers that place the joints, rates and accelerations, drawn up to four turns away."""
    mech, rng = mechanism(name), np.random.default_rng(len(name))
    zero = np.zeros(mech.places)
    for link in mech.links:
        if link.kind in ("spherical", "free"):
            zero[link.place.stop - 4] = 1.0
    for _ in range(count):
        q = rng.uniform(-25, 25, mech.dofs)
        for link in mech.links:
            if link.kind in ("spherical", "free"):
                q[link.rates.stop - 3:link.rates.stop] *= 0.1
        yield q, moved(mech, zero, q), rng.normal(size=mech.dofs), rng.normal(size=mech.dofs)


@pytest.mark.parametrize("engine", ["truth", "pinocchio", "mujoco"])
@every
def test_inverse_dynamics(name, engine):
    mech, drawn = mechanism(name), list(states(name, 8))
    wanted = [inverse_dynamics(mech, p, u, du) for _, p, u, du in drawn]
    q, _, u, du = (np.array(part) for part in zip(*drawn, strict=True))
    try:
        value = crosscheck.inverse_dynamics(scene(name), q, u, du, engine=engine)
    except crosscheck.Unsupported as refused:
        pytest.skip(str(refused))
    close(value, wanted, name)


@every
def test_derivatives(name):
    mech = mechanism(name)
    q, p, u, _ = next(states(name, 1))
    mode = {k: int(np.sign(u[k])) for k in mech.friction}
    try:
        found = crosscheck.derivatives(scene(name), state=(q, u))
    except crosscheck.Unsupported as refused:
        pytest.skip(str(refused))
    for key, wanted in derivatives(mech, p, u, mode).items():
        close(getattr(found, key), wanted, key)


def flow(name, duration, **options):
    try:
        return crosscheck.flow_derivative(scene(name), duration, **options)
    except crosscheck.Unsupported as refused:
        pytest.skip(str(refused))


def flown(mech, state, duration):
    return motion(mech, np.array([0.0, duration]), state, 1e-12)[-1]


@pytest.mark.parametrize("name", [name for name in OPEN if name not in LAWS])
def test_flow_derivative(name):
    mech, duration, h = mechanism(name), 0.2, 5e-3
    found = flow(name, duration).matrix
    first = start(mech)
    end = flown(mech, first, duration)

    def after(step):
        n = mech.dofs
        at = Instant(0.0, moved(mech, first.p, step[:n]), first.u + step[n:], 0.0)
        last = flown(mech, at, duration)
        return np.array([*apart(mech, last.p, end.p), *(last.u - end.u)])

    wanted = np.stack([slope(lambda e, d=d: after(e * d), h) for d in np.eye(2 * mech.dofs)], axis=1)
    close(found, wanted, name, 1e-7)


PATHS = {"whirling_cross": ("joints.cross.parent_anchor.0", "gravity.2"),
         "sprung_slide": ("joints.rail.damping", "joints.rail.rest_position", "joints.rail.child_anchor.2",
                          "joints.rail.armature", "bodies.cart.inertia.1.2"),
         "long_slide": ("joints.rail.child_anchor.0", "joints.rail.parent_anchor.1", "joints.rail.stiffness"),
         "wound_wheel": ("joints.pin.stiffness", "joints.pin.damping", "joints.pin.child_anchor.0"),
         "ball_and_wheel": ("joints.axle.stiffness", "joints.axle.parent_anchor.0"),
         "spun_puck": ("joints.table.child_anchor.0", "forces.0.free_length", "forces.0.parent_point.0")}


@functools.cache
def by_numbers(name, duration):
    """Derivatives of the flow by all numbers of a scene, (2 dofs, paths): they are compiled together."""
    return flow(name, duration, parameters=PATHS[name]).parameters


@pytest.mark.parametrize(("name", "path"), [(name, path) for name, paths in PATHS.items() for path in paths])
def test_flow_by_a_number_of_the_file(name, path):
    duration, mech = 0.2, mechanism(name)
    found = by_numbers(name, duration)[:, PATHS[name].index(path)]
    end, value = flown(mech, start(mech), duration), number(content(name), path)

    def after(step):
        other = Mechanism(edited(copy.deepcopy(content(name)), path, value + step))
        last = flown(other, start(other), duration)
        return np.array([*apart(mech, last.p, end.p), *(last.u - end.u)])

    close(found, slope(after, 2e-3 * max(abs(value), 0.1)), path, 1e-7)
