"""Drift of Pinocchio's maximal form without Baumgarte: the double pendulum, RKMK4, h = 1 ms, 10 s.

The engine notes give one digit for each level; within a factor of 3, because drift depends on how the free bodies are
parametrized.
"""

import crosscheck


def test_drift_of_the_double_pendulum() -> None:
    scene = crosscheck.load_scene("double_pendulum")
    run = crosscheck.run(scene, "pinocchio", "RKMK4", step=1e-3, form="maximal")
    for level, figure in (("position", 4e-8), ("velocity", 6e-9), ("acceleration", 7e-14)):
        assert figure / 3 < run.stats[f"constraint_{level}"] < 3 * figure, level
    assert run.stats["forward_dynamics"] == "constraintDynamics"
