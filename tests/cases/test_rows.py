"""What strangers asked and were answered wrongly, one case a kind; the right answers are closed forms."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck.judge.crossings import corrected_at_impacts
from crosscheck.judge.segments import marks
from crosscheck.judge.world import World
from crosscheck.scene.coordinates import hinge_angles
from tests.cases.inputs import CART, body, gantry, joint, scene


def wound(samples=7):
    """Two wheels on springs, the second on a slide: 40 and -25 rad/s, nearly three turns either way."""
    return scene([body("wheel"), body("cart"), body("other")], [
        joint("pin", "revolute", "wheel", position=0.0, velocity=40.0, stiffness=0.5),
        joint("way", "prismatic", "cart", (1, 0, 0), place=(0, 2, 0), position=0.0, velocity=0.1),
        joint("hub", "revolute", "other", parent="cart", position=0.0, velocity=-25.0, stiffness=0.3)], 6.0, samples)


def test_the_energy_of_a_wound_wheel_is_judged_whatever_the_outputs():
    found = crosscheck.run(wound(), "lieeuler", "rkmk853", rtol=1e-10).verdict()
    assert found.outcome == "pass"
    assert found.shares["energy"] == 1.0


def test_turns_come_back_from_another_world():
    here = wound()
    world = World.drawn(here, 1.0)
    there = world.scene(here)
    assert [name for name, _ in there.hinges] != ["j0", "j1"]
    assert pytest.approx(np.eye(3)) == world.Q
    states = crosscheck.run(there, "lieeuler", "rkmk853", rtol=1e-10)
    back = hinge_angles(here, world.back(states, there))
    t = here.t[:, None]
    rate = np.sqrt([5.0, 3.0])
    assert back == pytest.approx(np.array([40.0, -25.0]) / rate * np.sin(rate * t), abs=1e-5)
    turned = dataclasses.replace(world, Q=np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert np.isnan(turned.back(states, there).hinges).any(axis=0).tolist() == [True, False]


@pytest.mark.parametrize(("method", "how"), [
    ("seulex", {"rtol": 1e-10}), ("taylor", {"rtol": 1e-9}), ("rkmk4", {"step": 1e-3})])
def test_an_output_at_an_impact_is_no_error(method, how):
    """It falls by .5 m at 1 m/s^2 and leaves at .5 m/s: at 1 s, an output, both velocities are right."""
    data = scene([body("weight")], [joint("fall", "prismatic", "weight", (1, 0, 0), position=0.5, velocity=0.0,
                                          limits={"lower": 0.0, "restitution": 0.5})], 1.9, 20, -1.0, axis=0)
    made = crosscheck.run(data, "lieeuler", method, **how)
    assert made.x[-1, 0, 0] == pytest.approx(0.045, abs=1e-7)
    found = made.verdict()
    assert found.outcome == "pass"
    assert found.errors["velocity"].max < 1e-6
    assert found.energy_error < 1e-6


def test_a_wrong_velocity_beside_an_impact_is_one():
    """The true velocity stands at the output of the impact alone."""
    data = scene([body("weight")], [joint("fall", "prismatic", "weight", (1, 0, 0), position=0.5, velocity=0.0,
                                          limits={"lower": 0.0, "restitution": 0.5})], 1.9, 20, -1.0, axis=0)
    made, reference = crosscheck.run(data, "lieeuler", "rkmk4", step=1e-3), crosscheck.truth(data)
    made.v[:] += 0.25
    own = corrected_at_impacts(data, made, reference, 1e-3)
    off = np.abs(own.v - reference.states.v)[:, 0, 0]
    assert off[10] == 0.0
    assert np.delete(off, 10) == pytest.approx(0.25, abs=1e-9)


def test_a_path_below_a_number_is_named():
    with pytest.raises(crosscheck.ArgumentError, match=r"there is nothing below 'joints.pin.stiffness'"):
        crosscheck.flow_derivative(wound(), 0.2, parameters=("joints.pin.stiffness.0",))


def test_events_beyond_the_end_of_truth_leave_what_is_before_it_to_be_judged():
    """A part that slips and sticks all the time is judged until two of its bodies touch, and no shorter."""
    for busy in ([*range(1, 100)], [*range(1, 100, 2)], [*range(10, 40)]):
        cuts = marks(np.zeros(101), busy, "made", 15)
        assert 15 in cuts
        assert len([each for each in cuts if each <= 15]) <= 17


@pytest.mark.parametrize("name", ["reversed.xml", "reversed.urdf"])
def test_a_lower_limit_above_the_upper_one_is_refused_and_listed(name, tmp_path):
    """MuJoCo takes such a range for none, and other engines for a range."""
    text = gantry().replace('lower="-2" upper="2"', 'lower="2" upper="-2"')
    if name.endswith("xml"):
        text = CART.format(damping=0.7).replace('type="slide"', 'type="slide" range="2 -2"')
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(crosscheck.SceneError, match="limits of joint"):
        crosscheck.import_model(path)
    listed = crosscheck.import_model(path, limits="drop").left_out
    assert [each.what for each in listed if each.what.startswith("limits of joint")]


def test_right_laws_are_no_lack_of_a_library():
    """No altered law is nearer than the scene's own: what else could differ is not looked for, and that is said."""
    weight = scene([body("weight")], [joint("way", "prismatic", "weight", position=0.0, velocity=0.4,
                                            dry_friction=0.3)], 0.5, gravity=-9.81)
    with pytest.raises(crosscheck.Unsupported, match="no altered law of scene 'made' is nearer"):
        crosscheck.explain(weight, "lieeuler", "rkmk4")
