"""Small errors of gravity, mass or inertia from half time on fail, by order; the same run without them passes."""

import pytest

from benchmarks.altered import NUMBERS, ORDERS, Altered
from benchmarks.smallest_errors import AIM
from crosscheck import adapters
from crosscheck.adapters.external.own import completed
from crosscheck.document import Plan, Way
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell

STEPS, LATE = {"DAE1L_LSE": 1e-4, "rattle2": 1e-3, "rkmk4": 2e-3}, 0.5
SCENES = {"single_pendulum": 1.0, "double_pendulum": 1.0, "triple_pendulum": 1.0, "four_bar": 1.0, "heavy_top": 0.1}
"""With the durations of runs, s."""


def judged(scene, method, number, share):
    plan = Plan({1: STEPS[method] * (0.1 if scene == "heavy_top" else 1.0)}, samples=51, duration=SCENES[scene])
    with adapters.lent(completed(Altered(), "altered", "1")) as engine:
        return run_cell(Cell(scene, Way(engine, f"{method} {number} {share} {LATE}"), plan))


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("method", ORDERS)
@pytest.mark.parametrize("number", NUMBERS)
def test_a_small_error_from_half_time_on_fails(scene, method, number):
    assert judged(scene, method, number, 10 * AIM[ORDERS[method]]).outcome == "fail"


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("method", ORDERS)
def test_the_same_run_without_it_does_not(scene, method):
    run = judged(scene, method, NUMBERS[0], 0.0)
    assert run.outcome == "pass", run.message
