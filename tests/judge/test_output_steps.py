"""An adaptive method whose outputs make its steps answers the same at every tolerance, and is right."""

import crosscheck
from crosscheck import adapters
from crosscheck.verification.cell import judge_alone
from tests.engines.right import Adaptive


def test_answers_that_are_the_same_at_three_tolerances_accuse_nobody():
    """83 outputs in a second: errors of 1e-11 at a tolerance of 1e-6, and of 1e-5 and 1e-4."""
    scene = crosscheck.load_scene("single_pendulum").replace(duration=1.0, samples=84)
    with adapters.lent(Adaptive()) as name:
        traj = crosscheck.run(scene, name, "DP5", rtol=1e-6)
        assert traj.steps < 90
        assert judge_alone(scene.name, traj, name, rtol=1e-6).outcome == "pass"
