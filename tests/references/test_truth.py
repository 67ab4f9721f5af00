"""`truth`: the built-in scenes, seeded defects, conditioning, and errors that say what went wrong."""

import dataclasses

import numpy as np
import pytest

from crosscheck.references import Chaotic, TruthError, articulated, compute, conditioning, dense_output, truth
from crosscheck.references.taylor import Taylor, safe_step
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import GROUND, Body, Joint, Scene


@pytest.mark.parametrize(("name", "source"), [
    ("single_pendulum", "Taylor"), ("double_pendulum", "Taylor"), ("heavy_top", "Taylor"),
    ("triple_pendulum", "Taylor"),
])
def test_built_in_scenes(name, source):
    scene = load_scene(name)
    reference = truth(scene)  # from the cache if a test before this one has asked for it
    assert reference.source.startswith(source)
    assert reference.disagreement <= reference.allowed == max(1e-12, 1e-14 * reference.amplification)
    assert reference.horizon == scene.duration
    assert reference.states.a.shape == reference.states.alpha.shape == (scene.samples, scene.n, 3)
    if name == "triple_pendulum":
        assert reference.amplification < 100  # SCENES asks for it


def test_a_small_defect_is_the_error_that_is_stated(double, monkeypatch):
    """A relative error of 1e-9 in one term is far below any engine's error, and far above the truth's."""
    original = articulated.weight
    right = compute(double)
    monkeypatch.setattr(articulated, "weight", lambda mass, gravity: original((1 + 1e-9) * mass, gravity))
    found = compute(double)
    off = np.abs(found.states.x - right.states.x).max()
    assert found.allowed < 1e-10 < off <= found.disagreement == found.error < 100 * off
    monkeypatch.setattr(articulated, "weight", lambda mass, gravity: original((1 + 1e-3) * mass, gravity))
    with pytest.raises(TruthError, match=r"disagree by .*, most at t = [01]\S* s"):
        compute(double)


def level(**options):
    """A bar on a hinge, released at rest exactly level: its angle is a series in t^2, t^6, t^10 and so on."""
    bar = Body("bar", 1.0, np.diag([0.1, 0.1, 0.02]), [1, 0, 0, 0], [0, 0, 0], [0.5, 0, 0], [0, 0, 0])
    hinge = Joint("hinge", "revolute", GROUND, 0, [0, 0, 0], [-0.5, 0, 0], [0, 1, 0], [0, 1, 0])
    return Scene("level", (bar,), (hinge,), (), [0, 0, -9.81], **({"duration": 5.0, "samples": 51} | options))


def test_coefficients_that_symmetry_nulls_are_not_trusted():
    reference = compute(level())
    assert reference.error == 1e-12
    # Half a period of any start at rest: the bar is level again, on the other side.
    assert np.abs(np.diff(np.sign(reference.states.v[1:, 0, 0]))).sum() > 0


def test_a_step_is_measured_by_the_last_coefficients_that_are_not_nulled():
    tc = np.zeros((2, 21))
    tc[0, 2::4], tc[1, 1::4] = 2.0 ** np.arange(2, 21, 4), 2.0 ** np.arange(1, 21, 4)  # 19 and 20 are zero
    assert safe_step(tc) == pytest.approx(0.5 * np.exp(-2 - 0.7 / 19))
    assert safe_step(np.zeros((2, 21))) == np.inf


def test_a_chain_in_free_flight(build):
    """Without a joint to the ground the reference equations contain the free root."""
    body = (1.0, np.diag([0.1, 0.2, 0.15]), [0.9, 0.1, 0.4, 0.0], [1.0, -0.6, 0.4])
    reference = compute(build([body, body], [(0, 1, [0, 0, -1], [0, 0.2, 0.6])]))
    assert reference.disagreement <= reference.allowed
    assert reference.disagreement > 0  # formulations that agree to the last bit are the same


def test_growth_of_a_resting_body(build):
    """An isotropic body at rest without gravity: the angle grows as d_angle + T d_rate, the rest is geometry."""
    duration = 3.0
    scene = build([(1.0, np.eye(3), [1, 0, 0, 0], [0, 0, 0])], [(GROUND, 0, [0, 0, 0], [0, 0, 0])],
                  gravity=(0, 0, 0), duration=duration)
    measured = conditioning.measure(Taylor(scene))
    # |dR|_F = sqrt(2) |angle|; central differences of 1e-8 keep 1e-8 of rounding
    assert measured.amplification == pytest.approx(np.sqrt(2) * np.hypot(1, duration), rel=1e-6)
    assert measured.horizon == duration


@pytest.mark.parametrize("axis", range(3))
def test_growth_counts_every_direction(build, axis):
    """At the start, lengths alone: arms 2 along one axis and 1 along the next move the end by sqrt(5) across both."""
    first, second = np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
    body = (1.0, np.eye(3), [1, 0, 0, 0], [0, 0, 0])
    chain = build([body, body], [(GROUND, 0, [0, 0, 0], -first), (0, 1, first, -second)], duration=1e-6)
    assert conditioning.measure(Taylor(chain)).amplification == pytest.approx(np.sqrt(5), rel=1e-5)


def test_growth_matches_a_direct_perturbation(double):
    """No single random perturbation outgrows the worst one, and the worst one is not far above them."""
    integrator = Taylor(double.replace(duration=3.0))
    measured = conditioning.measure(integrator)
    rng, size, seen = np.random.default_rng(5), 1e-8, []
    base = integrator.pose(integrator.run())[1]
    rate = np.sqrt(9.81)
    for _ in range(40):
        direction = rng.normal(size=6)
        direction /= np.linalg.norm(direction)
        moved = integrator.initial.copy()
        moved[8:] += size * rate * direction
        seen.append(np.max(np.linalg.norm(integrator.pose(integrator.run(moved))[1] - base, axis=(-2, -1))) / size)
    assert max(seen) <= measured.amplification * (1 + 1e-3)  # one-sided differences are off by size times curvature
    assert max(seen) >= measured.amplification / 10


def thrown(build, **options):
    """A double pendulum thrown hard enough to be chaotic."""
    J = np.diag([0.1, 0.2, 0.15])
    bodies = [(1.0, J, [0.5, 0.1, 0.8, 0.0], [0.5, 0.3, 1.0]), (1.0, J, [0.3, 0.9, 0.0, 0.2], [-0.3, 4.0, 0.2])]
    return build(bodies, [(GROUND, 0, [0, 0, 0], [0, 0, 1]), (0, 1, [0, 0, -1], [0, 0, 1])], **options)


@pytest.fixture(scope="module")
def chaotic(build):
    """A truth over half a second with its horizon, reach and cause, then prolonged beyond its horizon."""
    known = dense_output.Truth(thrown(build, duration=0.5))
    known.prolong(0.5)
    first = known.horizon, known.reach, known.horizon_cause
    known.prolong(10.0)
    return known, first


def test_the_end_of_a_truth_has_a_cause(chaotic):
    known, (horizon, reach, cause) = chaotic
    assert horizon == reach >= 0.5
    assert cause == ""
    assert 1.0 < known.horizon < 10.0
    assert "1e-10" in known.horizon_cause
    assert known.error <= 1e-9


def test_chaotic_scene_is_compared_up_to_its_horizon(build, chaotic):
    reference = chaotic[0].reference(thrown(build, duration=10.0, samples=61))
    assert 0 < reference.horizon < 10.0
    assert reference.amplification > 1e5
    assert reference.allowed <= 1e-9  # 1e-14 of the growth to 1e5 at the horizon, not of what follows
    assert reference.states.x.shape == (61, 2, 3)


def test_horizon_before_the_first_output_is_refused(build, chaotic):
    scene = thrown(build, duration=10.0, samples=2)
    with pytest.raises(Chaotic, match="ask for a shorter duration or more samples") as raised:
        chaotic[0].reference(scene)
    assert 1.0 < raised.value.horizon < 10.0


def test_the_floor_counts_roundings_in_the_middle_of_a_motion():
    """A body that turns over about its middle axis magnifies them by millions, those of its start by ten thousands."""
    scene = load_scene("axis_flip")
    book = dataclasses.replace(scene.bodies[0], inertia=np.diag([1.0, 2.0, 3.0]), velocity=np.zeros(3),
                               angular_velocity=np.array([0.001, 2.0, 0.001]))
    scene = scene.replace(bodies=(book,), duration=30.0)
    left, when = conditioning.floor(scene)
    from_start = conditioning.measure(Taylor(scene)).amplification
    eps = np.finfo(float).eps
    assert 0 < when < 30
    assert 1e3 < from_start < 1e5
    assert 1e6 < left / eps < 1e8
