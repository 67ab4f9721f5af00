"""Truth across events: closed forms, agreement of both formulations, ends of the truth."""

import math

import numpy as np
import pytest

import crosscheck
from crosscheck.errors import Unsupported
from crosscheck.references import TruthError, compute, dense
from crosscheck.references.dense_output import Truth
from crosscheck.references.maximal import Maximal
from crosscheck.references.pieces import first_crossing
from crosscheck.references.taylor import Taylor
from crosscheck.scene.file import load_scene
from crosscheck.scene.laws import DryFriction, Limits
from tests.references.law_scenes import INERTIA, arm, hinge, pendulum, scene, servo, slide, with_laws

EXACT = 1e-12  # (14.2) of docs/theory.md: what a formulation reaches on a well-conditioned scene


def times(reference):
    return np.array([event[0] for event in reference.events])


def words(reference):
    return [event[2] for event in reference.events]


def test_a_mass_on_a_spring_with_dry_friction(tmp_path):
    """Half waves of the free period about +-c / k; each extreme is 2 c / k nearer; at rest within c / k."""
    k, c = 4.0, 0.6
    reference = compute(slide(tmp_path, {"position": 1.0, "dry_friction": c, "stiffness": k}, duration=5.5,
                              samples=31))
    np.testing.assert_allclose(times(reference), np.pi / 2 * np.arange(1, 4), rtol=0, atol=EXACT)
    assert words(reference) == ["reverses"] * 2 + ["sticks"]
    t = reference.t
    half = np.minimum(np.floor(t / (np.pi / 2)), 3).astype(int)
    extreme = (-1.0) ** half * (1.0 - 2 * c / k * half)
    middle = (-1.0) ** half * c / k
    exact = np.where(half < 3, middle + (extreme - middle) * np.cos(2.0 * (t - np.pi / 2 * half)), extreme)
    np.testing.assert_allclose(reference.states.x[:, 0, 0], exact, rtol=0, atol=EXACT)


def test_a_braked_block(tmp_path):
    """It stops after v m / c at v^2 m / (2 c), and stays there."""
    m, v, c = 2.0, 1.5, 4.0
    reference = compute(slide(tmp_path, {"velocity": v, "dry_friction": c}, m, duration=2.0, samples=9))
    t = np.minimum(reference.t, v * m / c)
    np.testing.assert_allclose(times(reference), [v * m / c], rtol=0, atol=EXACT)
    np.testing.assert_allclose(reference.states.x[:, 0, 0], v * t - c / m * t**2 / 2, rtol=0, atol=EXACT)
    assert words(reference) == ["sticks"]
    assert not reference.states.v[-1].any()  # rest is rest


@pytest.mark.parametrize(("joint", "level"), [
    ({"dry_friction": {"sliding": 0.2, "static": 0.25}}, 0.25), ({"limits": {"lower": 0.0}, "position": 0.0}, 0.0)])
def test_what_holds_lets_go_when_a_slow_force_reaches_it(tmp_path, joint, level):
    """.5 sin(.1 t) - .2: to rounding, however slowly it grows."""
    force = {"type": "joint_force", "joint": "s", "force": {"type": "sine", "terms": [[0.5, 0.1, 0.0]], "offset": -0.2}}
    reference = compute(slide(tmp_path, joint, forces=[force], duration=20.0, samples=5))
    np.testing.assert_allclose(times(reference)[:1], [10.0 * np.arcsin((level + 0.2) / 0.5)], rtol=2e-15)


def test_a_bouncing_hinge_without_weight(tmp_path):
    """Between two stops the rate is constant; each impact halves it."""
    reference = compute(pendulum(tmp_path, {"velocity": 4.0, "limits": {"lower": -0.3, "upper": 0.5,
                                                                       "restitution": 0.5}},
                                 duration=1.5).replace(gravity=[0, 0, 0]))
    np.testing.assert_allclose(times(reference), np.array([0.5, 0.5 + 0.8 * 2, 0.5 + 0.8 * 6]) / 4, rtol=0, atol=EXACT)
    assert words(reference) == ["hits_upper", "hits_lower", "hits_upper"]
    np.testing.assert_allclose(reference.states.w[-1, 0, 1], -0.5, rtol=0, atol=EXACT)


def test_a_stop_without_damping_gives_back_what_it_took(tmp_path):
    """Half a wave of the spring, whose force ends where the range begins; from there the block goes on at its speed."""
    k, end = 100.0, 0.5
    reference = compute(slide(tmp_path, {"velocity": 1.0, "limits": {"upper": end, "stiffness": k}}, duration=2.0,
                              samples=21))
    leaves = end + np.pi / math.sqrt(k)
    np.testing.assert_allclose(times(reference), [end, leaves], rtol=0, atol=EXACT)
    assert words(reference) == ["hits_upper", "leaves_upper"]
    t = reference.t
    inside = end + np.sin(math.sqrt(k) * (t - end)) / math.sqrt(k)
    exact = np.where(t < end, t, np.where(t < leaves, inside, end - (t - leaves)))
    np.testing.assert_allclose(reference.states.x[:, 0, 0], exact, rtol=0, atol=EXACT)


def test_a_saturated_double_integrator(tmp_path):
    """Full force, then the servo's own harmonic motion from the state where it comes off its limit, then braking."""
    k, limit = 30.0, 2.0
    reference = compute(slide(tmp_path, forces=[{"type": "servo", "joint": "s", "target": 2.0, "proportional": k,
                                                 "effort_limit": limit}], duration=2.6, samples=14))
    off = math.sqrt(2.0 * (2.0 - limit / k) / limit)
    rate, width = limit * off, limit / k
    w = math.sqrt(k)
    # between x = 2 - width and 2 + width: from -width with the rate, to +width, where the speed is the same again
    inside = (math.pi - 2 * math.atan2(w * width, rate) - (math.pi - 4 * math.atan2(w * width, rate))) / w
    np.testing.assert_allclose(times(reference)[:2], [off, off + inside], rtol=0, atol=EXACT)
    assert words(reference)[:2] == ["unsaturates", "saturates"]
    t = reference.t
    after = t - off - inside
    exact = np.where(t < off, limit * t**2 / 2,
                     np.where(after < 0, 2.0 - width * np.cos(w * (t - off)) + rate / w * np.sin(w * (t - off)),
                              2.0 + width + rate * after - limit * after**2 / 2))
    np.testing.assert_allclose(reference.states.x[:, 0, 0], exact, rtol=0, atol=EXACT)


@pytest.mark.parametrize("delay", [0, 2])
def test_sampled_control(tmp_path, delay):
    """A held force on a mass: exact from sample to sample."""
    h, kp, kd = 0.05, 30.0, 3.0
    reference = compute(slide(tmp_path, {"velocity": 1.0}, forces=[servo("s", period=h, delay=delay)], duration=1.0,
                              samples=21))
    x, v, waiting, exact = 0.0, 1.0, [0.0] * delay, [0.0]
    for _ in range(20):
        waiting.append(kp * (1.0 - x) + kd * (0.0 - v))
        force = waiting.pop(0)
        x, v = x + h * v + h**2 / 2 * force, v + h * force
        exact.append(x)
    np.testing.assert_allclose(reference.states.x[:, 0, 0], exact, rtol=0, atol=EXACT * max(1.0, np.abs(exact).max()))
    assert reference.events == ()


def test_the_braked_pendulum(tmp_path):
    reference = compute(pendulum(tmp_path, {"position": 1.2, "dry_friction": 0.5}, duration=2.5, samples=5))
    np.testing.assert_allclose(times(reference), [0.7976058331, 1.5708796875, 2.3278585004],
                               rtol=0, atol=6e-11)  # digits of another integration, with events, at 1e-12
    assert words(reference) == ["reverses"] * 3


AGREE = {
    "two joints stick and slip": lambda f: arm(f, {"position": 1.0, "dry_friction": 1.2},
                                               {"position": -0.5, "velocity": 2.0, "dry_friction": 0.6}, duration=2.0),
    "servo saturates on an arm": lambda f: arm(f, forces=[servo("j1", effort_limit=8.0), servo("j2", effort_limit=[
        -2.0, 3.0])]),
    "motor line on an arm": lambda f: arm(f, forces=[servo("j1", effort_limit=8.0, no_load_speed=3.0),
                                                     servo("j2", effort_limit=3.0, no_load_speed=2.0)]),
    **{f"sampled, delay {d}": lambda f, d=d: arm(f, forces=[servo("j1", period=0.02, delay=d, effort_limit=8.0)],
                                                 duration=0.3) for d in (0, 1, 2)},
    "sampled with friction": lambda f: arm(f, {"dry_friction": 0.5}, {"dry_friction": 0.2},
                                           forces=[servo("j1", period=0.05, effort_limit=8.0)], duration=0.5),
    "stop that bounces": lambda f: arm(f, {"position": 1.0}, {"limits": {"lower": -0.3, "upper": 0.4,
                                                                         "restitution": 0.5}}),
    "stop that does not": lambda f: arm(f, {"position": 1.0}, {"limits": {"lower": -0.3, "upper": 0.4}}, duration=1.5),
    "two stops that do not": lambda f: arm(f, {"position": 1.0, "limits": {"lower": -0.2}},
                                           {"limits": {"lower": -0.3, "upper": 0.4}}),
    "static above sliding": lambda f: arm(f, {"position": 1.0, "dry_friction": {"sliding": 0.5, "static": 0.9}},
                                          {"dry_friction": {"sliding": 0.3, "static": 0.5}}, duration=1.5),
    "stop kicks a resting joint": lambda f: arm(f, {"position": 1.0, "limits": {"lower": 0.5, "restitution": 0.3}},
                                                {"position": -1.0, "dry_friction": 4.0}, duration=0.38),
    "soft stop with friction": lambda f: pendulum(f, {"position": 1.2, "dry_friction": 0.2, "limits": {
        "lower": -0.5, "upper": 2.0, "stiffness": 300.0, "damping": 2.0}}, duration=2.0),
    "soft stop of an arm": lambda f: arm(f, {"position": 1.0}, {"limits": {"lower": -0.3, "upper": 0.4,
                                                                           "stiffness": 50.0, "damping": 0.3}}),
    "servo drags friction": lambda f: slide(f, {"dry_friction": {"sliding": 0.5, "static": 0.7}}, forces=[servo(
        "s", target={"type": "sine", "terms": [[0.15, 3.0, 0.0]]}, proportional=10.0)], duration=2.0),
    "force that jumps": lambda f: slide(f, {"dry_friction": 0.5}, forces=[{
        "type": "joint_force", "joint": "s", "force": {"type": "hold", "times": [0.0, 0.5, 1.0, 1.7],
                                                       "values": [0.3, 1.0, 0.2, -2.0]}}], duration=2.0),
    "target in lines": lambda f: pendulum(f, {"dry_friction": 0.5}, forces=[servo("h", effort_limit=6.0, target={
        "type": "linear", "times": [0.0, 0.3, 0.6], "values": [0.0, 1.0, 0.2]})]),
    "friction in a loop": lambda f: with_laws("four_bar", "crank pivot", 1.2, dry_friction=(DryFriction(2.0, 2.0),)),
    "stop in a loop": lambda f: with_laws("slider_crank", "guide", 0.1, limits=(Limits(-10.0, 10.0),)),
    "both of a cylinder": lambda f: with_laws("cylindrical_pendulum", "shaft", 1.0, dry_friction=(
        DryFriction(0.3, 0.3), DryFriction(2.0, 2.0)), limits=(None, Limits(-0.1, 0.2, 0.5))),
    "friction before a gear": lambda f: with_laws("geared_arm", "shoulder", 0.5, dry_friction=(DryFriction(0.5, 0.5),)),
    "a chain of three laws": lambda f: arm(f, {"position": 0.8, "dry_friction": 0.4, "limits": {"lower": -0.6}},
                                           {"dry_friction": 0.1}, forces=[servo("j2", effort_limit=1.0)]),
}
EVENTS = {"two joints stick and slip": {"sticks", "slips"}, "servo saturates on an arm": {"saturates", "unsaturates"},
          "stop that bounces": {"hits_upper"}, "two stops that do not": {"hits_upper", "hits_lower", "leaves_lower"},
          "static above sliding": {"slips", "reverses", "sticks"},
          "stop kicks a resting joint": {"hits_lower", "slips"},
          "soft stop with friction": {"hits_lower", "leaves_lower", "reverses"}, "force that jumps": {"slips"},
          "friction in a loop": {"reverses"}, "both of a cylinder": {"hits_upper", "reverses"}}


@pytest.mark.parametrize("case", AGREE)
def test_both_formulations_agree(tmp_path, case):
    """Laws of the state alone against the modes of the series."""
    reference = compute(AGREE[case](tmp_path))
    assert reference.disagreement <= reference.error <= 1e-11
    assert EVENTS.get(case, set()) <= set(words(reference))
    assert reference.horizon == reference.t[-1]


def test_accelerations_agree_in_every_mode(tmp_path):
    """Accelerations of a held joint are those of what holds it."""
    made = AGREE["two joints stick and slip"](tmp_path).replace(samples=21)
    known = Truth(made)
    reference = known.reference(made)
    assert reference.disagreement <= reference.error <= 1e-11
    assert EVENTS["two joints stick and slip"] <= set(words(reference))
    t = made.t[1:]  # at rest at the start, friction has no direction yet
    states, held = known.at(t), known._values.modes_at(t)[:, ::5] > 0.5
    a, alpha, _ = Maximal(made).accelerations(states, held)
    for name, found, scale in (("a", a, 10.0), ("alpha", alpha, 100.0)):
        np.testing.assert_allclose(getattr(states, name), found, rtol=0, atol=1e-12 * scale)


def test_a_bounce_that_piles_up_ends_the_truth(tmp_path):
    """Flights of 2 sqrt(2 h / g) e^k: all of them end at 3 sqrt(2) s for e = 1/2."""
    reference = compute(slide(tmp_path, {"position": 1.0, "limits": {"lower": 0.0, "restitution": 0.5}},
                              gravity=(-1.0, 0, 0), duration=6.0))
    assert reference.horizon == pytest.approx(3 * math.sqrt(2), abs=2e-4)  # the last flights take that together
    assert reference.horizon < 3 * math.sqrt(2)
    assert "'s' pile up" in reference.horizon_cause


def test_a_graze_ends_the_truth(tmp_path):
    """Thrown up to exactly the stop."""
    stop = {"upper": 0.5}
    reference = compute(slide(tmp_path, {"velocity": 1.0, "limits": stop}, gravity=(-1.0, 0, 0), duration=2.0))
    assert reference.horizon == pytest.approx(1.0, abs=1e-6)
    assert "'s' grazes" in reference.horizon_cause
    missed = compute(slide(tmp_path, {"velocity": 0.999, "limits": stop}, gravity=(-1.0, 0, 0), duration=2.0))
    assert missed.horizon == 2.0
    assert missed.events == ()


def slides(folder, first, second, rides=True, masses=(1.0, 2.0), **keys):
    """Two slides along x, the second one on the first or on the ground."""
    bodies = [{"name": name, "mass": mass, "inertia": INERTIA} for name, mass in zip("ab", masses, strict=True)]
    guide = {"type": "prismatic", "child_anchor": [0, 0, 0], "parent_axis": [1, 0, 0], "child_axis": [1, 0, 0],
             "position": 0.0, "velocity": 0.0}
    joints = [{**guide, "name": "ja", "parent": "ground", "child": "a", "parent_anchor": [0, 0, 0], **first},
              {**guide, "name": "jb", "parent": "a" if rides else "ground", "child": "b", "parent_anchor": [0, 1, 0],
               **second}]
    return scene(folder, bodies, joints, **keys)


def test_stops_that_do_not_act_on_each_other_have_impacts_of_their_own(tmp_path):
    """A weight that falls half a metre leaves its stop at half its speed, while another one rests on its own."""
    reference = compute(slides(tmp_path, {"limits": {"lower": 0.0, "restitution": 0.0}}, {
        "position": 0.5, "limits": {"lower": 0.0, "restitution": 0.5}}, rides=False, gravity=(-1.0, 0, 0), duration=1.9,
        samples=20))
    u = np.maximum(reference.t - 1.0, 0.0)
    exact = np.where(u > 0, 0.5 * u - 0.5 * u**2, 0.5 - 0.5 * reference.t**2)
    assert reference.horizon == 1.9
    np.testing.assert_allclose(reference.states.x[:, 1, 0], exact, rtol=0, atol=EXACT)
    assert not reference.states.x[:, 0].any()


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_two_stops_at_once_that_do_not_act_on_each_other(tmp_path, restitution):
    """Without weight two hinges of their own turn at the same rate and reach their stops together."""
    keys = {"velocity": 1.0, "limits": {"upper": 0.2, "restitution": restitution}}
    bodies = [{"name": name, "mass": 1.0, "inertia": INERTIA} for name in "ab"]
    joints = [hinge(name, "ground", name, [0, 2.0 * k, 0], [0, 0, 0.3], **keys) for k, name in enumerate("ab")]
    reference = compute(scene(tmp_path, bodies, joints))
    assert [event[1:] for event in reference.events] == [("a", "hits_upper"), ("b", "hits_upper")]
    assert reference.horizon == 1.0
    np.testing.assert_allclose(reference.states.w[-1, :, 1], -restitution, rtol=0, atol=EXACT)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_two_stops_at_once_that_act_on_each_other_end_it_unless_neither_bounces(tmp_path, restitution):
    keys = {"position": 0.5, "velocity": -1.0, "limits": {"lower": 0.0, "restitution": restitution}}
    reference = compute(slides(tmp_path, keys, keys))
    assert [event[1:] for event in reference.events] == [("ja", "hits_lower"), ("jb", "hits_lower")]
    if restitution:
        assert reference.horizon == pytest.approx(0.5, abs=1e-12)
        assert "'ja' and 'jb' act at one instant" in reference.horizon_cause
    else:
        assert reference.horizon == 1.0
        assert not reference.states.v[-1].any()


def test_a_bounce_on_a_stop_that_carries_ends_it(tmp_path):
    reference = compute(slides(tmp_path, {"position": 0.5, "limits": {"upper": 0.5, "restitution": 0.0}}, {
        "limits": {"upper": 0.5, "restitution": 0.5}}, gravity=(1.0, 0, 0), duration=1.9))
    assert reference.horizon == pytest.approx(1.0, abs=1e-12)
    assert "'ja' and 'jb' act at one instant" in reference.horizon_cause


def test_an_impact_kicks_off_what_rests_on_its_stop(tmp_path):
    """The second slide meets its upper stop at sqrt(8) m/s and takes the first along at two thirds of that."""
    reference = compute(slides(tmp_path, {"limits": {"lower": 0.0}}, {"velocity": 3.0, "limits": {"upper": 0.5}},
                               gravity=(-1.0, 0, 0), duration=4.2, samples=43))
    v, u = 2 / 3 * math.sqrt(8.0), reference.t - 3.0 + math.sqrt(8.0)
    after = u - 2 * v
    flight = np.where((u > 0) & (after < 0), v * u - 0.5 * u**2, 0.0)
    rider = np.select([u < 0, after < 0], [3.0 * reference.t - 0.5 * reference.t**2, 0.5 + flight],
                      0.5 - v * after - 0.5 * after**2)
    np.testing.assert_allclose(reference.states.x[:, :, 0], np.stack([flight, rider], axis=1), rtol=0, atol=5 * EXACT)
    assert [event[1:] for event in reference.events] == [
        ("jb", "hits_upper"), ("ja", "leaves_lower"), ("ja", "hits_lower"), ("jb", "leaves_upper")]
    assert reference.horizon == 4.2


def test_friction_at_a_dead_centre_changes_sign(tmp_path):
    """The slider of a straight crank rests for an instant: nothing holds it, and its acceleration takes it back."""
    reference = compute(with_laws("slider_crank", "guide", 0.5, dry_friction=(DryFriction(0.05, 0.05),)))
    assert reference.horizon == 0.5
    assert reference.events
    assert {event[1:] for event in reference.events} == {("guide", "reverses")}
    crank, slider = (reference.states.x[:, k] for k in (0, -1))
    assert np.isfinite(crank).all()
    assert np.ptp(slider[:, 0]) > 0.1


def test_a_truth_is_nothing_after_its_horizon(tmp_path):
    """A carriage that is pressed on its stop carries another one that bounces after a second."""
    pressed = slides(tmp_path, {"position": 0.5, "limits": {"upper": 0.5}},
                     {"limits": {"upper": 0.5, "restitution": 0.5}}, gravity=(1.0, 0, 0), duration=1.9,
                     samples=20, sensors=[{"name": "place", "type": "joint_position", "joint": "jb"}])
    reference = crosscheck.truth(pressed)
    known = reference.t <= 1.0
    for values in (reference.states.x, reference.states.a, reference.sensors["place"]):
        assert np.isfinite(values[known]).all()
        assert np.isnan(values[~known]).all()
    assert np.isnan(dense(pressed).at([1.0, 1.5]).x[:, 0, 0]).tolist() == [False, True]


BALL = {"bodies": [{"name": "b", "mass": 1.0, "inertia": [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]],
                    "position": [0, 0, 1.0], "velocity": [0.3, 0, 0], "angular_velocity": [1, 2, 0.5]}], "joints": []}


def test_a_touch_ends_the_claim(tmp_path):
    falling = scene(tmp_path, **BALL, gravity=(0.0, 0.0, -9.81), shapes=[
        {"name": "foot", "body": "b", "type": "sphere", "size": [0.1]},
        {"name": "floor", "body": "ground", "type": "plane", "position": [0, 0, 0.2]}],
        monitors=[{"type": "touch", "shapes": ["foot", "floor"], "margin": 0.01}])
    reference = compute(falling)
    exact = math.sqrt(2 * (1.0 - 0.2 - 0.1 - 0.01) / 9.81)
    assert reference.horizon == pytest.approx(exact, abs=1e-9)
    assert reference.horizon_cause == f"foot touches floor at {exact:.4f} s".replace(" 0.", " .")
    assert reference.events == ((reference.horizon, "foot and floor", "touches"),)


def test_a_distance_that_stays_is_not_searched_for_a_touch(tmp_path, monkeypatch):
    monkeypatch.setattr("scipy.optimize.minimize_scalar", None)
    flying = scene(tmp_path, **BALL, shapes=[
        {"name": "foot", "body": "b", "type": "sphere", "size": [0.1]},
        {"name": "floor", "body": "ground", "type": "plane", "position": [0, 0, 0.2]}],
        monitors=[{"type": "touch", "shapes": ["foot", "floor"]}])
    assert compute(flying).horizon == flying.duration


def test_a_touch_between_two_nodes_is_found(tmp_path):
    """A sphere of .1 m that flies past another one at 20 m/s, whose rims meet for a millisecond."""
    body = {**BALL["bodies"][0], "velocity": [20.0, 0, 0]}
    passing = scene(tmp_path, bodies=[body], joints=[], shapes=[
        {"name": "foot", "body": "b", "type": "sphere", "size": [0.1]},
        {"name": "post", "body": "ground", "type": "sphere", "size": [0.1], "position": [7.3, 0, 1.1995]}],
        monitors=[{"type": "touch", "shapes": ["foot", "post"]}])
    exact = (7.3 - math.sqrt(0.2**2 - 0.1995**2)) / 20.0
    assert compute(passing).horizon == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("monitor", [{"type": "range", "upper": 0.5}, {"type": "speed", "upper": 1.5},
                                     {"type": "effort", "upper": 2.25}], ids=lambda monitor: monitor["type"])
def test_monitors_of_a_joint(tmp_path, monitor):
    """A mass under the force 2 + 2 t: the ends of the ranges are reached at times that solve polynomials."""
    made = slide(tmp_path, {"velocity": 1.0 - 0.0625}, forces=[{"type": "joint_force", "joint": "s", "force": {
        "type": "polynomial", "coefficients": [2.0, 2.0]}}], monitors=[{**monitor, "joint": "s"}])
    reached = {"range": lambda t: (1 - 0.0625) * t + t**2 + t**3 / 3 - 0.5, "speed": lambda t: 1 - 0.0625 + 2 * t + t**2
               - 1.5, "effort": lambda t: 2.0 + 2.0 * t - 2.25}[monitor["type"]]
    found = compute(made)
    assert reached(found.horizon) == pytest.approx(0.0, abs=1e-12)
    whose = "s" if monitor["type"] == "range" else f"{monitor['type']} of s"
    assert found.horizon_cause.startswith(f"{whose} leaves its range at ")
    assert found.events == ()


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_a_joint_may_start_at_an_end_of_its_range_and_turn_inside(tmp_path, speed):
    def starting(velocity):
        return slide(tmp_path, {"velocity": velocity}, forces=[{"type": "joint_force", "joint": "s", "force": 2.0}],
                     monitors=[{"type": "range", "joint": "s", "lower": 0.0, "upper": 0.5}])

    reached = compute(starting(speed)).horizon
    assert speed * reached + reached**2 == pytest.approx(0.5, abs=1e-12)
    with pytest.raises(TruthError, match="already s leaves its range"):
        compute(starting(-0.5))


def test_what_is_not_unique_is_refused(tmp_path):
    """Two joints of one freedom share what holds them."""
    made = with_laws("four_bar", "crank pivot", 1.0, dry_friction=(DryFriction(1.0, 1.0),))
    both = made.replace(joints=tuple(with_laws("four_bar", "crank pin", 1.0, dry_friction=(DryFriction(
        1.0, 1.0),)).joints[k] if k == 1 else joint for k, joint in enumerate(made.joints)))
    with pytest.raises(Unsupported, match="depend on each other"):
        compute(both)
    with pytest.raises(Unsupported, match="need heyoka"):
        Truth(pendulum(tmp_path, {"dry_friction": 0.5}), portable=True).prolong(0.1)


def test_smooth_scenes_take_the_smooth_formulation():
    assert type(Truth(load_scene("hinge_pendulum")).series) is Taylor


@pytest.mark.parametrize(("begins", "crosses"), [(-1e-16, False), (-1e-12, True)], ids=["rounding", "behind"])
def test_a_short_step_that_begins_at_an_event(begins, crosses):
    """What a surface leaves within one digit of the time is rounding, however small the surface is in a short step."""
    length, instant = 1e-6, 2.0**-52
    found = first_crossing(lambda tau: {("stop", "side"): begins + 3.0 * tau}, length, instant)
    assert (found is not None and found.after == 0.0) == crosses


def test_a_step_that_begins_at_no_event_forgives_nothing():
    assert first_crossing(lambda tau: {("stop", "side"): -1e-16 + 3.0 * tau}, 1e-6).after == 0.0
