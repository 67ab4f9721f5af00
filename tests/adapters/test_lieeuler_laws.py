"""Scenes with friction, stops and servos by lieeuler: against Coulomb's law, Pinocchio, and its own other methods."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from crosscheck.document import Record, Way, extended
from crosscheck.references import compute
from crosscheck.verification.cell import judge_run
from tests.adapters.test_laws import SERVO, arm, coulomb, pendulum
from tests.law_mistakes import SCENES
from tests.references.law_scenes import arm as swinging
from tests.references.law_scenes import pendulum as hanging
from tests.references.law_scenes import servo
from tests.references.test_pieces import slides

SAMPLED = {"type": "servo", "joint": "elbow", "target": 0.1, "proportional": 30.0, "derivative": 1.0, "period": 0.025,
           "delay": 1}
ELBOW = {"type": "servo", "joint": "elbow", "target": 1.5, "proportional": 30.0, "derivative": 1.0}
ARMS = {
    "friction": {"upper": {"dry_friction": 0.6}, "lower": {"dry_friction": {"sliding": 0.3, "static": 0.5}}},
    "bounces": {"upper": {"limits": {"lower": -0.2, "upper": 0.5, "restitution": 0.5}}},
    "stop": {"lower": {"limits": {"lower": -0.1, "upper": 0.6}}},
    "soft stops": {"lower": {"limits": {"lower": -0.1, "upper": 0.5, "stiffness": 300.0, "damping": 2.0}}},
    "cut": {"forces": (SERVO | {"effort_limit": 5.0}, ELBOW | {"effort_limit": [-2.0, 3.0], "no_load_speed": 6.0})},
    "all": {"forces": (ELBOW | {"effort_limit": 3.0},), "upper": {"dry_friction": 0.4, "armature": 0.02},
            "lower": {"dry_friction": 0.2, "limits": {"lower": -0.1, "upper": 0.6}}},
}


def test_friction_pendulum_is_coulombs():
    scene = pendulum(dry_friction=0.5)
    angles, turns = coulomb(scene, 0.5)
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-12)
    assert np.abs(traj.joints["hinge"].position - angles).max() < 1e-11
    assert [what for *_, what in traj.events] == ["reverses"] * (len(turns) - 1) + ["sticks"]
    assert np.abs(np.array([t for t, *_ in traj.events]) - turns).max() < 1e-11
    assert {joint for _, joint, _ in traj.events} == {"hinge"}


@pytest.mark.parametrize(("forces", "near"), [((SERVO,), 1e-9), ((SERVO, SAMPLED), 1e-6)])
def test_servos_are_those_of_pinocchio(forces, near):
    """RKMK4 at 1 ms, of order 4, over joint accelerations that share nothing with ours."""
    scene = arm(forces, samples=41)
    ours = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-12)
    theirs = crosscheck.run(scene, "pinocchio", "RKMK4", step=1e-3)
    assert np.abs(ours.x - theirs.x).max() < near


@pytest.mark.parametrize("name", ARMS)
def test_methods_agree_on_motion_and_events(name):
    """Taylor series, Runge-Kutta and a composition in Hamilton-Pontryagin form: the same modes at the same times."""
    scene = arm(**ARMS[name])
    runs = [crosscheck.run(scene, "lieeuler", method, **size) for method, size in (
        ("taylor", {"rtol": 1e-12}), ("rkmk853", {"rtol": 1e-11}), ("rattle8", {"step": 1e-2}))]
    assert runs[0].events
    for other in runs[1:]:
        assert np.abs(other.x - runs[0].x).max() < 1e-7
        assert [event[1:] for event in other.events] == [event[1:] for event in runs[0].events]
        assert np.abs(np.array([e[0] for e in other.events]) - [e[0] for e in runs[0].events]).max() < 1e-7
    through = crosscheck.run(scene, "lieeuler", "rkmk4", step=1e-3, events=False)
    lost = np.abs(through.x - runs[0].x).max()
    assert lost < 1e-9 if name in ("bounces", "stop") else 1e-9 < lost < 1e-2  # hits of stops are located all the same


@pytest.mark.parametrize("seeded", [{"dry_friction": 0.63}, {"dry_friction": 0.6, "armature": 0.001}])
def test_a_changed_law_moves_otherwise(seeded):
    right = crosscheck.run(arm(upper={"dry_friction": 0.6}), "lieeuler", "taylor", rtol=1e-10)
    wrong = crosscheck.run(arm(upper=seeded), "lieeuler", "taylor", rtol=1e-10)
    assert np.abs(right.x - wrong.x).max() > 1e-4


EVENTFUL = {
    "two": SCENES["two"],
    "more at the elbow": lambda folder: swinging(folder, {"position": 1.0, "dry_friction": 0.2},
                                                 {"position": 0.5, "dry_friction": 0.3}, samples=11),
    "sampled": lambda folder: hanging(folder, forces=[servo("h", effort_limit=[-2.0, 3.0], period=0.02, delay=1)],
                                      duration=1.0, samples=11),
}


@pytest.mark.parametrize("name", EVENTFUL)
def test_events_are_those_of_truth(tmp_path, name):
    """Two joints that stick and slip; a sampled servo is cut, and free again, at samples."""
    scene = EVENTFUL[name](tmp_path)
    exact = compute(scene).events
    assert len(exact) > 1
    for method, size, near in (("taylor", {"rtol": 1e-12}, 1e-8), ("DAE1L_LSE", {"step": 5e-4}, 10 * 5e-4)):
        found = crosscheck.run(scene, "lieeuler", method, **size).events
        assert [event[1:] for event in found] == [event[1:] for event in exact]
        assert np.abs(np.array([event[0] for event in found]) - [event[0] for event in exact]).max() < near


def test_a_motion_that_ends_is_refused_by_name(tmp_path):
    """A carriage that is pressed on its stop carries another one that bounces: truth ends there as well."""
    scene = slides(tmp_path, {"position": 0.5, "limits": {"upper": 0.5}},
                   {"limits": {"upper": 0.5, "restitution": 0.5}}, gravity=(1.0, 0, 0), duration=1.9)
    with pytest.raises(crosscheck.Unsupported, match=r"joint 'jb' is hit at 1 s .*a shorter duration"):
        crosscheck.run(scene, "lieeuler", "rkmk4", step=0.1)
    assert crosscheck.run(scene, "lieeuler", "rkmk4", step=0.1, duration=0.9).events == ()


def test_a_bounce_at_an_output_time_is_one_bounce(tmp_path):
    """The run's state there is that before the impact, and its interval before ends with that impact, too."""
    scene = slides(tmp_path, {"limits": {"lower": 0.0}},
                   {"position": 0.5, "limits": {"lower": 0.0, "restitution": 0.5}}, rides=False,
                   gravity=(-1.0, 0, 0), duration=1.9, samples=20)
    traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-9)
    record = extended(Record, Way("lieeuler", "taylor", rtol=1e-9), scene="laws", version="1")
    assert judge_run(record, scene, traj, frozenset()).outcome == "pass"
