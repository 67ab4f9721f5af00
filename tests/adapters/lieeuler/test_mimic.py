"""Coordinates that follow others: loops, whole turns; test_armature.py has their algebra."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.model import Mimic
from tests.adapters.lieeuler.test_armature import coupled_arm


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
