"""The lieeuler adapter: its joints and forces against the common ones, its motion against dense index-1 equations."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.compare.errors import errors
from crosscheck.references import tree, truth
from crosscheck.running.support import minimal_scenes
from crosscheck.scene import joints, mechanics
from crosscheck.scene.assembly import completed
from crosscheck.scene.checks import Draft
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import GROUND
from lieeuler import _kernel
from tests.adapters import pairs
from tests.scene.test_mechanics import aligned_pair, driven, springs
from tests.scene_making import JOINT_TYPES, drawn, jointed_pair, make_scene, moved, random_body, random_joint, unit

seeds = st.integers(0, 2**31)
EPS = np.finfo(float).eps


def batch(scene):
    return scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]


@pytest.mark.parametrize("kind", JOINT_TYPES)
@pytest.mark.parametrize("ground", [True, False])
@settings(max_examples=15)
@given(seed=seeds)
def test_rows_of_every_joint_are_the_common_ones(kind, ground, seed):
    rng = np.random.default_rng(seed)
    scene = jointed_pair(rng, kind)
    if ground:
        scene = make_scene(list(scene.bodies[1:]), [random_joint(rng, kind, GROUND, 0)])
    common = Constraints(scene)
    system = _kernel.System(list(scene.masses), list(scene.inertias), scene.gravity)
    for joint in build_joints(scene):
        joint.add_to(system)
    state = batch(scene)
    kernel = _kernel.constraints(_kernel.Plan(system), scene.x0, scene.R0, scene.v0, scene.w0, np.zeros(common.m))
    size = 1 + np.abs(kernel["gamma"]).max() + np.abs(kernel["phi"]).max()
    assert np.abs(kernel["phi"] - common.position(*state[:2])[0]).max() < 50 * EPS * size
    assert np.abs(kernel["G"] - common.jacobian(*state[:2])[0]).max() < 50 * EPS * size
    assert np.abs(kernel["gamma"] - common.gamma(*state)[0]).max() < 50 * EPS * size


def build_joints(scene):
    """Joints alone: random states do not satisfy them, so that no Problem can be built."""
    from crosscheck.adapters.lieeuler import _joint

    return [_joint(scene, joint) for joint in scene.joints]


@pytest.mark.parametrize("parent", [GROUND, 0])
@settings(max_examples=25)
@given(seed=seeds)
def test_forces_are_the_common_ones_and_their_derivatives_hold(parent, seed):
    from crosscheck.adapters.lieeuler import _force

    rng = np.random.default_rng(seed)
    aligned = aligned_pair(rng, parent)  # the angle of a torsional spring is defined for axes that coincide
    scene = make_scene(list(aligned.bodies), list(aligned.joints), [
        *springs(rng, parent, damping=0.7, loads=True), *driven(rng)])
    system = _kernel.System(list(scene.masses), list(scene.inertias), scene.gravity)
    for force in scene.forces:
        _force(scene, force).add_to(system)
    kernel, x, R, u = _kernel.Plan(system), scene.x0, scene.R0, np.hstack([scene.v0, scene.w0])

    def values(x, R, u):
        return _kernel.forces(kernel, x, R, np.ascontiguousarray(u[:, :3]), np.ascontiguousarray(u[:, 3:]))

    here = values(x, R, u)
    common = mechanics.applied_forces(scene, *batch(scene))[0].reshape(-1, 6)
    common[:, 3:] += np.cross(scene.w0, np.einsum("nij,nj->ni", scene.inertias, scene.w0))
    size = 1 + np.abs(common).max()
    assert np.abs(here["f"].reshape(-1, 6) - common).max() < 100 * EPS * size
    d, step = rng.normal(size=u.shape), 1e-5
    by_q = (values(*moved(x, R, step * d), u)["f"] - values(*moved(x, R, -step * d), u)["f"]) / (2 * step)
    by_u = (values(x, R, u + step * d)["f"] - values(x, R, u - step * d)["f"]) / (2 * step)
    slope = 1 + np.abs(here["by_q"]).max() + np.abs(here["by_u"]).max()
    # differences: truncation step^2 times third derivatives, which grow as the spring is short; rounding eps / step
    assert np.abs(by_q - here["by_q"] @ d.ravel()).max() < 1e-6 * slope
    assert np.abs(by_u - here["by_u"] @ d.ravel()).max() < 1e-8 * slope


def exact(scene, duration):
    """x, R of the scene after `duration` by DOP853 on the dense index-1 equations, without projection."""
    n = scene.n

    def rate(_, y):
        x, R, v, w = unpack(y)
        a, alpha, _ = mechanics.index1(scene, x[None], R[None], v[None], w[None])
        spin = R @ np.cross(w[:, None, :], np.eye(3)).swapaxes(1, 2)
        return np.concatenate([v.ravel(), spin.ravel(), a.ravel(), alpha.ravel()])

    def unpack(y):
        return (y[:3 * n].reshape(n, 3), y[3 * n:12 * n].reshape(n, 3, 3), y[12 * n:15 * n].reshape(n, 3),
                y[15 * n:].reshape(n, 3))

    start = np.concatenate([scene.x0.ravel(), scene.R0.ravel(), scene.v0.ravel(), scene.w0.ravel()])
    return unpack(solve_ivp(rate, (0, duration), start, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1])


CASES = [(kind, method) for kind in JOINT_TYPES for method, record in lieeuler.METHODS.items() if record.order == 1]


@functools.cache
def moving(kind):
    """A closed scene for a joint type, with springs, dampers and loads on it, and its state after 0.2 s."""
    rng = np.random.default_rng(100 + JOINT_TYPES.index(kind))
    forces = [*pairs.loads(), *([pairs.torsion()] if kind in pairs.SPRUNG else [])]
    scene = drawn(lambda: jointed_pair(rng, kind, forces))
    return scene, exact(scene, 0.2)


@pytest.mark.parametrize(("kind", "method"), CASES)
def test_every_method_is_first_order_on_every_joint_and_force(kind, method):
    scene, (x, R, _, _) = moving(kind)
    problem, steps = build_problem(scene), (2e-3, 1e-3, 5e-4, 2.5e-4)
    errors = []
    for h in steps:
        run = lieeuler.integrate(problem, method, h, [0, 0.2])
        errors.append(np.hypot(np.abs(run.x[-1] - x).max(), np.abs(run.R[-1] - R).max()))
        held = lieeuler.METHODS[method].held
        size = 1 + np.abs(run.v).max() + np.abs(run.w).max()
        if "position" in held:
            assert run.stats.maxima["constraint_position"] < 200 * EPS * size
        if "velocity" in held:
            assert run.stats.maxima["constraint_velocity"] < 200 * EPS * size
        if "acceleration" in held and method != "INDEX1_LE":
            assert run.stats.maxima["constraint_acceleration"] < 1e4 * EPS * size**2
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_start_accelerations_and_multipliers_are_index_1(kind):
    scene = moving(kind)[0]
    run = lieeuler.integrate(build_problem(scene), "DAE3L_LE", 1e-3, [0, 1e-3])
    a, alpha, lam = (values[0] for values in mechanics.index1(scene, *batch(scene)))
    size = 1 + max(np.abs(a).max(), np.abs(alpha).max(), np.abs(lam).max())
    for mine, common in ((run.a[0], a), (run.alpha[0], alpha), (run.lam[0], lam)):
        assert np.abs(mine - common).max() < 1e4 * EPS * size  # condition number of G M^-1 G^T


def test_torsional_spring_counts_full_turns():
    """A wheel on a hinge against a torsional spring turns many times before it comes back: a plain oscillator."""
    rng = np.random.default_rng(5)
    axis = unit(rng)
    body = random_body(rng, "wheel")
    inertia, stiffness, speed = 0.5, 0.02, 6.0
    wheel = lieeuler.Body(body.mass, inertia * np.eye(3))
    hinge = lieeuler.revolute_joint(-1, 0, np.zeros(3), np.zeros(3), axis, axis)
    spring = lieeuler.TorsionalSpring(-1, 0, axis, axis, stiffness, 0.0)
    problem = lieeuler.Problem([wheel], [hinge], np.zeros(3), np.zeros((1, 3)), [np.eye(3)], np.zeros((1, 3)),
                               [speed * axis], [spring])
    rate = np.sqrt(stiffness / inertia)
    assert speed / rate > 4 * np.pi  # the amplitude: several turns
    h = 1e-4
    run = lieeuler.integrate(problem, "DAE1H_LSE", h, [0, 20.0])
    angle = speed / rate * np.sin(rate * 20.0)
    # symplectic Euler on an oscillator: phase error h rate / 2 relative to the amplitude
    expected = Rotation.from_rotvec(angle * axis).as_matrix()
    assert np.abs(run.R[-1, 0] - expected).max() < h * speed
    assert abs(run.stats.maxima["energy_error"]) < h * rate


@pytest.mark.parametrize("minimal", [each for each in minimal_scenes() if each.kind.startswith("joint")],
                         ids=lambda each: f"{each.item} {each.kind}")
def test_joints_from_rows_are_those_of_lieeulers_own_functions(minimal):
    scene, joint = minimal.scene, minimal.scene.joints[-1]
    given = [getattr(joint, key) for key, needed in joint.kind.needs.items() if needed]
    if joint.kind.keeps_attitude:
        given.append(scene.R0[joint.child].T @ (np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]))
    wanted = getattr(lieeuler, f"{joint.type}_joint")(
        joint.parent, joint.child, joint.parent_anchor, joint.child_anchor, *given)
    made = build_problem(scene).joints[-1]
    assert (made.spherical, made.rows, made.contact is None) == (wanted.spherical, wanted.rows, wanted.contact is None)
    assert [(dot.a, dot.b) for dot in made.dots] == [(dot.a, dot.b) for dot in wanted.dots]
    parts = [*zip(made.dots, wanted.dots, strict=True), *([(made.contact, wanted.contact)] if made.contact else [])]
    for one, other in parts:
        for field in dataclasses.fields(one):
            value = getattr(one, field.name)
            assert value == getattr(other, field.name) if isinstance(value, str) else np.allclose(
                value, getattr(other, field.name), rtol=0, atol=1e-15)


def test_one_more_joint_of_known_words_is_an_entry_in_each_of_two_tables(monkeypatch):
    """A gantry slides along two directions and does not turn: rows here, motions there, and truth and engines run."""
    slide, plane = (joints.JOINT_TYPES[name] for name in ("prismatic", "planar"))
    monkeypatch.setitem(joints.JOINT_TYPES, "gantry", joints.JointType(
        (*slide.rows[:2], slide.rows[-1], plane.rows[-1]), plane.motion[:2], plane.motion[:2], "parallel", "start"))
    monkeypatch.setitem(tree.TURNS, "gantry", 0)
    monkeypatch.setitem(tree.SHIFTS, "gantry", "plane")
    made = next(each.scene for each in minimal_scenes() if (each.kind, each.item) == ("joint between bodies", "planar"))
    made = made.replace(name="gantry", duration=0.5, samples=11, joints=(
        made.joints[0], dataclasses.replace(made.joints[1], type="gantry")))
    scene = completed(Draft(made, (True, True), (True, True), assemble=True))
    exact = truth(scene)
    for engine, method in (("lieeuler", "rkmk4"), ("mujoco", "RK4"), ("pinocchio", "RKMK4"), ("exudyn", "RK44")):
        missed = errors(scene, crosscheck.run(scene, engine=engine, method=method, step=1e-3), exact.states)
        assert max(missed["position"].max, missed["attitude"].max) < 1e-9, engine
