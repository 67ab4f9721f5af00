"""Coordinates that follow others: accelerations, orders against truth, loops; test_armature.py has their algebra."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.model import Mimic
from tests.adapters.lieeuler.against_truth import observed_orders
from tests.adapters.lieeuler.test_armature import FIRST_ORDER, LADDERS, coupled_arm
from tests.lieeuler.accuracy import agrees_with_order


def orders_of(method, steps, **changes):
    scene = coupled_arm(**changes)
    return observed_orders(scene, method, steps, crosscheck.truth(scene).states)


@pytest.mark.parametrize(("method", "steps"), [("DAE2L_LE", (4e-3, 2e-3, 1e-3)), ("rattle4", (2e-2, 1e-2, 5e-3))])
def test_order(method, steps):
    assert agrees_with_order(orders_of(method, steps), method)


# The arm turns 2.5 times as fast as its motor, up to 12 rad/s, so that orders show at smaller steps than elsewhere:
# slopes of rattle8 are 13 to 17 above 1/32 s, 1.7 to 7.6 at 1/40 s and 8.0 from 1/64 s on, those of rkmk4 3.1 to 4.3
# above 1/160 s and 3.98 at 1/2560 s. For a second rkmk853 falls from 12 to 9.4 and ends in rounding at 1/128 s; where
# the motion is slow, in the first .3 s, its slopes rise from 6.9 to 8.
STEPS = {"rattle4": (1 / 80, 1 / 160, 1 / 320), "rattle6": (1 / 40, 1 / 60, 1 / 80),
         "rkmk4": (1 / 320, 1 / 640, 1 / 1280, 1 / 2560), "rattle8": (1 / 64, 1 / 80, 1 / 96, 1 / 128),
         "rkmk853": (0.3 / 20, 0.3 / 24, 0.3 / 28, 0.3 / 32)}


@pytest.mark.parametrize("method", [*FIRST_ORDER, "rattle2", "generalized_alpha", "rkmk54", *STEPS])
def test_order_of_other_methods(method):
    steps = STEPS.get(method) or LADDERS[lieeuler.METHODS[method].order]
    found = orders_of(method, steps, duration=0.3 if method == "rkmk853" else 1.0)
    assert agrees_with_order(found, method), found


def followed(scene, follower, leader, ratio):
    """The scene at rest with a mimic that holds at its start."""
    still = [dataclasses.replace(body, velocity=np.zeros(3), angular_velocity=np.zeros(3)) for body in scene.bodies]
    scene = scene.replace(bodies=tuple(still))
    here = {name: float(position[0]) for name, (position, _) in at_start(scene).items()}
    mimic = Mimic(leader, ratio, here[follower] - ratio * here[leader])
    return scene.replace(joints=tuple(dataclasses.replace(joint, mimic=mimic) if joint.name == follower else joint
                                      for joint in scene.joints))


@pytest.mark.parametrize("method", ["DAE1L_LSE", "DAE2H_LSE", "rattle2", "taylor"])
def test_a_row_that_a_loop_holds_already_changes_nothing(method):
    """Opposite hinges of a parallelogram turn alike: the mimic's row depends on the loop's."""
    loop = crosscheck.load_scene("parallelogram")
    alone = followed(loop, loop.joints[1].name, loop.joints[0].name, -1.0).replace(duration=0.5, samples=3)
    plain = alone.replace(joints=tuple(dataclasses.replace(joint, mimic=None) for joint in alone.joints))
    control = {"rtol": 1e-12} if method == "taylor" else {"step": 1e-2}
    runs = [crosscheck.run(scene, engine="lieeuler", method=method, **control) for scene in (alone, plain)]
    assert np.abs(runs[0].x - runs[1].x).max() < 1e-12
    assert runs[0].stats["redundant_rows"] == runs[1].stats["redundant_rows"] + 1


def test_many_turns_of_the_leader_are_counted():
    """For any ratio: if the leader's angle were read up to whole turns, the follower would jump."""
    whole = coupled_arm(gravity=np.zeros(3), duration=20.0, samples=81)
    scene = whole.replace(bodies=whole.bodies[:2], joints=whole.joints[:2])  # one degree of freedom, undamped
    run = crosscheck.run(scene, engine="lieeuler", method="taylor", rtol=1e-10)
    base, elbow = (run.joints[name].position for name in ("base", "elbow"))
    assert np.ptp(base) > 4 * np.pi
    assert np.abs(elbow + 2.5 * base - 0.4).max() < 1e-11
    assert run.stats["constraint_position"] < 1e-12


@pytest.mark.parametrize(("change", "words"), [
    ({"joint": 7}, "no joint 7"), ({"ratio": float("nan")}, "ratio"), ({"leader": 1}, "leader")])
def test_a_wrong_mimic_is_named(change, words):
    problem = build_problem(coupled_arm())

    def changed():
        mimic = dataclasses.replace(problem.joints[1].mimic, **change)
        follower = problem.joints[1].following(mimic)
        return dataclasses.replace(problem, joints=(problem.joints[0], follower, *problem.joints[2:]))

    with pytest.raises(lieeuler.ArgumentError, match=words):
        changed()
