"""Every bound by its formula, written once more with loops over bodies and times, for a made-up truth."""

import dataclasses
import math

import numpy as np
import pytest

from crosscheck.document import QUANTITIES, Scales
from crosscheck.judge import tolerances
from crosscheck.judge.tolerances import EPS, Tol
from crosscheck.scene.file import load_scene
from tests.judge.made_up import truth_of

SAME = {"rel": 1e-12, "abs": 0.0}  # sums of a few terms, in another order


@pytest.fixture(scope="module")
def scene():
    return load_scene("double_pendulum").replace(duration=2.0, samples=5)


@pytest.fixture(scope="module")
def truth(scene):
    return truth_of(scene)


def lengths(vectors):
    return [[math.hypot(*body) for body in bodies] for bodies in vectors]


def kinetic(scene, states, k):
    return sum(0.5 * m * (v @ v) + 0.5 * w @ (J @ w) for m, J, v, w in zip(
        scene.masses, scene.inertias, states.v[k], states.w[k], strict=True))


@pytest.mark.parametrize("fast", [1e-3, 1.0, 30.0])
def test_sizes_of_a_scene(scene, fast):
    truth = truth_of(scene, fast)
    states, found = truth.states, tolerances.scales(scene, truth)
    length = max(math.hypot(*anchor) for joint in scene.joints
                 for anchor, body in ((joint.child_anchor, joint.child), (joint.parent_anchor, joint.parent))
                 if body != "ground")
    fall = math.sqrt(math.hypot(*scene.gravity) / length)
    rates, speed = lengths(states.w), max(map(max, lengths(states.v)))
    reach, fastest = max(map(max, lengths(states.x))), max(map(max, rates))
    thickest = sum(max(np.linalg.eigvalsh(J)) for J in scene.inertias)
    assert found.length == pytest.approx(length, **SAME)
    assert found.speed == pytest.approx(speed, **SAME)
    assert found.rate == pytest.approx(max(fastest, fall), **SAME)
    assert found.unit_rate == pytest.approx(max(*rates[0], fall), **SAME)
    assert found.reach == pytest.approx(reach, **SAME)
    assert found.kinetic == pytest.approx(max(kinetic(scene, states, k) for k in range(scene.samples)), **SAME)
    assert found.momentum == pytest.approx(sum(scene.masses) * reach * speed + thickest * fastest, **SAME)


@pytest.mark.parametrize("gravity", [9.81, 0.0])
def test_sizes_where_nothing_moves_are_those_of_falling(scene, gravity):
    still = scene.replace(gravity=(0.0, 0.0, -gravity))
    found = tolerances.scales(still, truth_of(still, 0.0))
    rate = math.sqrt(gravity / found.length) or 1.0
    assert found.rate == found.unit_rate == pytest.approx(rate, **SAME)
    assert found.speed == pytest.approx(found.length * rate, **SAME)
    assert found.kinetic == pytest.approx(sum(scene.masses) * found.speed**2, **SAME)


def test_a_free_body_has_the_length_of_its_radius_of_gyration():
    free = load_scene("axis_flip").replace(duration=1.0, samples=3)
    assert not free.joints
    book, = free.bodies
    wide = dataclasses.replace(book, name="wide", mass=3.0, inertia=90.0 * book.inertia)
    for bodies in ((book, wide), (wide, book)):
        both = free.replace(bodies=bodies)
        assert tolerances.scales(both, truth_of(both)).length == pytest.approx(
            math.sqrt(np.trace(wide.inertia) / 6.0), **SAME)


def state_derivative(truth, order, scale):
    x, R = truth.position_derivatives, truth.attitude_derivatives
    return max(x[order] / scale.length, R[order] / math.sqrt(2), x[order + 1] / scale.length / scale.unit_rate,
               R[order + 1] / math.sqrt(2) / scale.unit_rate)


@pytest.mark.parametrize("turns", [0.01, 100.0])
@pytest.mark.parametrize("fast", [1.0, 300.0])
@pytest.mark.parametrize("order", [1, 4, 8])
def test_derivatives_of_the_state(scene, order, turns, fast):
    truth = truth_of(scene, fast, turns)
    scale = tolerances.scales(scene, truth)
    assert tolerances.derivative(truth, order, scale) == pytest.approx(state_derivative(truth, order, scale), **SAME)


def rounded(scene, truth, size, steps, eps=EPS):
    graded = max(50.0, sum(scene.masses) / min(scene.masses),
                 *(max(np.linalg.eigvalsh(J)) / min(np.linalg.eigvalsh(J)) for J in scene.inertias))
    return (max(truth.allowed, truth.disagreement) * max(1.0, size)
            + graded * eps * size * truth.amplification * max(1, steps) ** 0.6)


@pytest.mark.parametrize("eps", [EPS, 6e-8])
@pytest.mark.parametrize("size", [0.2, 30.0])
@pytest.mark.parametrize("steps", [0, 1, 20_000])
def test_rounding(scene, truth, size, steps, eps):
    assert tolerances.rounding(scene, truth, size, steps, eps) == pytest.approx(
        rounded(scene, truth, size, steps, eps), **SAME)


@pytest.mark.parametrize(("changes", "expected"), [
    ({"inertia": np.diag([1.0, 1.0, 1e-3])}, 1e3), ({"mass": 1e-3}, 1001.0), ({}, 50.0)])
def test_one_thin_or_light_body_grades_a_scene(scene, changes, expected):
    whole = dataclasses.replace(scene.bodies[0], mass=1.0)
    bodies = whole, dataclasses.replace(whole, name="other", **changes)
    assert tolerances.grading(scene.replace(bodies=bodies)) == pytest.approx(expected, **SAME)


@pytest.mark.parametrize(("disagreement", "size", "eps"), [(3e-13, 0.2, EPS), (3e-13, 30.0, EPS), (1e-20, 2.0, 1e-8)])
def test_the_plateau_of_rounding(scene, disagreement, size, eps):
    truth = truth_of(scene, disagreement=disagreement)
    found = tolerances.plateau(scene, truth, size, 4, eps)
    assert found.floor == pytest.approx(max(disagreement, eps * 17.0) * max(1.0, size), **SAME)
    assert (found.ceiling, found.order) == (pytest.approx(math.sqrt(eps) * size, **SAME), 4)
    heavy = load_scene("light_heavy").replace(duration=1.0, samples=3)
    graded = tolerances.plateau(heavy, truth_of(heavy), 1.0, 4)
    assert graded.floor == pytest.approx(tolerances.grading(heavy) / 50 * EPS * 17.0, **SAME)


def units(scale):
    return {"position": scale.length, "attitude": 1.0, "velocity": scale.length * scale.rate,
            "angular velocity": scale.rate}


def sizes(scale):
    return {"position": max(scale.length, scale.reach), "attitude": 1.0, "velocity": scale.speed,
            "angular velocity": scale.rate}


def fixed(scene, truth, order, step, growth):
    scale = tolerances.scales(scene, truth)
    bound = growth * scene.duration * step**order * state_derivative(truth, order + 1, scale)
    steps = round(scene.duration / step)
    return {name: unit * bound + rounded(scene, truth, sizes(scale)[name], steps)
            for name, unit in units(scale).items()}


@pytest.mark.parametrize("growth", [None, 1.0])
@pytest.mark.parametrize(("order", "step"), [(1, 1e-3), (4, 0.03)])
def test_bounds_of_a_fixed_step(scene, truth, order, step, growth):
    found = tolerances.fixed_step(scene, truth, order, step, growth)
    expected = fixed(scene, truth, order, step, growth or 17.0)
    assert {name: bound.value for name, bound in found.items()} == pytest.approx(expected, **SAME)


@pytest.mark.parametrize("order", [1, 3, 4, 8, 11])
def test_bounds_of_the_limit(scene, truth, order):
    step = 0.02
    scale = tolerances.scales(scene, truth)
    share = 17.0 * scene.duration * step**order / 4
    # Derivatives are known up to the tenth, and that of y takes the one after its own. An observed order may be any.
    upon = (share**2 * state_derivative(truth, 2 * order + 2, scale) if 2 * order + 3 <= 10 else
            (share * state_derivative(truth, min(order + 1, 9), scale)) ** 2)
    expected = {name: value + upon * units(scale)[name]
                for name, value in fixed(scene, truth, min(order + 1, 8), step, 17.0).items()}
    found = tolerances.limit(scene, truth, order, step)
    assert {name: bound.value for name, bound in found.items()} == pytest.approx(expected, **SAME)


@pytest.mark.parametrize("fast", [1e-3, 30.0])
@pytest.mark.parametrize("growth", [None, 1.0])
def test_bounds_of_an_adaptive_method(scene, growth, fast):
    truth = truth_of(scene, fast)
    scale = tolerances.scales(scene, truth)
    size = sizes(scale)
    size["velocity"] = max(size["velocity"], scale.length * scale.rate)
    expected = {name: (growth or 17.0) * 300 * 1e-9 * size[name] + rounded(scene, truth, size[name], 300)
                for name in QUANTITIES}
    found = tolerances.adaptive(scene, truth, 1e-9, 300, growth)
    assert {name: bound.value for name, bound in found.items()} == pytest.approx(expected, **SAME)


def test_a_stiff_spring_enlarges_the_velocities_of_an_adaptive_method():
    sprung = load_scene("stiff_damped").replace(duration=1.0, samples=3)
    truth = truth_of(sprung, 1e-3)
    fast = tolerances.fastest(sprung)
    length = tolerances.scales(sprung, truth).length
    found = tolerances.adaptive(sprung, truth, 1e-6, 10)
    for name, size in (("velocity", length * fast), ("angular velocity", fast)):
        assert found[name].value == pytest.approx(17.0 * 10 * 1e-6 * size + rounded(sprung, truth, size, 10), **SAME)


WRONG = {"position": 1e-3, "attitude": 0.03, "velocity": 0.5, "angular velocity": 2.0}
BOUNDS = {name: Tol(value, "given") for name, value in WRONG.items()}


def test_bounds_of_energy_and_momentum(scene, truth):
    scale, (x, r, v, w) = tolerances.scales(scene, truth), WRONG.values()
    mass, inertia = sum(scene.masses), sum(math.hypot(*J.ravel()) for J in scene.inertias)
    energy = mass * 9.81 * x + mass * (scale.speed * v + v * v / 2) + inertia * (scale.rate * w + w * w / 2)
    momentum = mass * (scale.reach * v + x * v + scale.speed * x) + inertia * (w + scale.rate * r + w * r)
    assert tolerances.energy(scene, truth, BOUNDS).value == pytest.approx(energy / scale.kinetic, **SAME)
    assert tolerances.momentum(scene, truth, BOUNDS).value == pytest.approx(momentum, **SAME)


@pytest.mark.parametrize("length", [0.25, 40.0])
def test_bounds_of_levels_that_nothing_holds(scene, truth, monkeypatch, length):
    scale = Scales(length=length, speed=3.0, rate=7.0, unit_rate=5.0, reach=2.0, kinetic=11.0, momentum=13.0)
    monkeypatch.setattr(tolerances, "scales", lambda scene, truth: scale)
    (x, r, v, w), lever = WRONG.values(), max(1.0, length)
    found = {level: tolerances.free_level(scene, truth, level, BOUNDS) for level in ("position", "velocity")}
    assert found["position"].value == pytest.approx(2 * (x + lever * r), **SAME)
    assert found["velocity"].value == pytest.approx(2 * (v + lever * w + lever * 7.0 * r), **SAME)


@pytest.mark.parametrize("size", [1e-3, 1e3])
@pytest.mark.parametrize("level", ["position", "velocity", "acceleration"])
def test_bounds_of_levels_that_a_method_holds(monkeypatch, level, size):
    heavy = load_scene("light_heavy").replace(duration=1.0, samples=3)
    scale = Scales(length=2 * size, speed=3 * size, rate=5.0, unit_rate=1.0, reach=7 * size, kinetic=1.0, momentum=1.0)
    monkeypatch.setattr(tolerances, "scales", lambda scene, truth: scale)
    terms = {"position": 9 * size, "velocity": 13 * size, "acceleration": (9 / 2 + 100) * size}[level]
    least = {"position": 1e-12, "velocity": 1e-11, "acceleration": 1e-9}[level]
    roundings = 50 if level == "position" else tolerances.grading(heavy)
    value = max(least, roundings * EPS * terms)
    truth = truth_of(heavy)
    assert tolerances.held_level(heavy, truth, level).value == pytest.approx(value, **SAME)
    assert tolerances.held_level(heavy, truth, level, eps=4 * EPS).value == pytest.approx(
        max(4 * least, 4 * roundings * EPS * terms), **SAME)
    assert tolerances.held_level(heavy, None, level, eps=4 * EPS).value == pytest.approx(4 * least, **SAME)
    for newton in (0.01 * value, 0.09 * value, 0.11 * value):
        left = tolerances.held_level(heavy, truth, level, newton)
        assert left.value == pytest.approx(max(value, 10 * newton), **SAME)


def test_how_far_the_levers_of_a_scene_reach(scene):
    levers = sum(math.hypot(*joint.child_anchor) + math.hypot(*joint.parent_anchor) for joint in scene.joints)
    assert tolerances.reach(scene) == pytest.approx(levers, **SAME)
    free = load_scene("axis_flip")
    thrown = free.replace(bodies=(dataclasses.replace(free.bodies[0], position=(3.0, 4.0, 0.0)),))
    assert tolerances.reach(thrown) == pytest.approx(5.0, **SAME)


@pytest.mark.parametrize("kind", [*QUANTITIES, "energy", "momentum", "level position", "level velocity"])
def test_a_bound_says_nothing_once_it_exceeds_the_size(scene, truth, kind, monkeypatch):
    scale = tolerances.scales(scene, truth)
    size = {**sizes(scale), "energy": 1.0, "momentum": scale.momentum, "level position": scale.length,
            "level velocity": scale.length * scale.rate}[kind]
    small = {name: Tol(1e-12, "") for name in QUANTITIES}

    def empty(value):
        given = {**small, **({kind: Tol(value, "")} if kind in small else {})}
        monkeypatch.setattr(tolerances, "energy", lambda *_: Tol(value if kind == "energy" else 0.0, ""))
        monkeypatch.setattr(tolerances, "momentum", lambda *_: Tol(value if kind == "momentum" else 0.0, ""))
        monkeypatch.setattr(tolerances, "free_level", lambda scene, truth, level, bounds: Tol(
            value if kind == f"level {level}" else 0.0, ""))
        return tolerances.vacuous(scene, truth, given)

    assert empty(size) == frozenset()
    assert empty(size * (1 + 1e-9)) == {kind}


@pytest.mark.parametrize(("name", "roundings"), [
    ("single_pendulum", 50.0), ("light_heavy", 1e6 + 1), ("needle", 1e6)])
def test_light_bodies_and_thin_ones_are_allowed_more_roundings(name, roundings):
    assert tolerances.grading(load_scene(name)) == pytest.approx(roundings, rel=1e-9)


def test_bounds_of_orthogonality():
    assert tolerances.orthogonality(True, 10**6).value == pytest.approx(1e-13, **SAME)
    assert tolerances.orthogonality(True, 10**6, 2 * EPS).value == pytest.approx(2e-13, **SAME)
    assert tolerances.orthogonality(False, 10).value == pytest.approx(1e-13, **SAME)
    assert tolerances.orthogonality(False, 10**6).value == pytest.approx(4e6 * EPS, **SAME)
    assert tolerances.orthogonality(False, 10, 2 * EPS).value == pytest.approx(2e-13, **SAME)


def test_margins_of_orders():
    assert [tolerances.order_margin(order) for order in (1, 2, 8)] == [0.1, 0.15, 0.15]


def test_levels_of_rounding(scene, truth):
    scale, steps = tolerances.scales(scene, truth), 10**6
    found = tolerances.rounding_levels(scene, truth)
    for name, size in sizes(scale).items():
        a, b = found[name]
        assert a + b * steps**0.6 == pytest.approx(rounded(scene, truth, size, steps), **SAME)
        assert a == pytest.approx(truth.error * max(1.0, size), **SAME)
    for name, rule in (("energy", tolerances.energy), ("momentum", tolerances.momentum)):
        expected = [rule(scene, truth, {each: Tol(found[each][part], "") for each in QUANTITIES}).value
                    for part in (0, 1)]
        assert found[name] == pytest.approx(tuple(expected), **SAME)


@pytest.mark.parametrize("gravity", [1e-3, 9.81])
@pytest.mark.parametrize("turns", [1.0, 1000.0])
def test_what_newton_leaves_is_believed_up_to_a_share_of_the_forces(scene, turns, gravity):
    scene = scene.replace(gravity=(0.0, 0.0, -gravity))
    truth = truth_of(scene, turns=turns)
    heaviest = max(max(np.linalg.eigvalsh(J)) for J in scene.inertias)
    weights = 10 * sum(scene.masses) * math.hypot(*scene.gravity)
    moving = max(weights, max(scene.masses) * 7.0, heaviest * turns * 7.0)
    for known, forces in ((truth, moving), (None, weights)):
        most = 1e-9 * (1 + forces)
        assert tolerances.newton_left(scene, known, 2 * most) == pytest.approx(most, **SAME)
        assert tolerances.newton_left(scene, known, 0.5 * most) == 0.5 * most
        assert tolerances.newton_left(scene, known, -1.0) == 0.0


def test_a_residual_is_believed_up_to_the_forces_that_turn_the_bulkiest_body(scene):
    first, second = scene.bodies
    bulky = scene.replace(bodies=(first, dataclasses.replace(second, inertia=1e4 * np.eye(3))))
    known = truth_of(bulky)
    assert tolerances.newton_left(bulky, known, 1.0) == pytest.approx(
        1e-9 * (1.0 + 1e4 * known.attitude_derivatives[2]), **SAME)
