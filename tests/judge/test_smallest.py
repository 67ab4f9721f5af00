"""An error of 1e-3 in gravity, mass or inertia from half time on fails at the first-order step of `verify`."""

import pytest

from benchmarks.altered import NUMBERS, Altered
from benchmarks.smallest_errors import AIM, caught
from crosscheck import adapters
from crosscheck.adapters.foreign.own import completed
from crosscheck.judge.plan import PLANS

METHOD, LATE = "DAE1L_LSE", 0.5
CASES = [(scene, number) for scene in PLANS for number in NUMBERS]


@pytest.mark.parametrize(("scene", "number"), CASES)
def test_a_thousandth_late_is_caught(scene, number):
    with adapters.lent(completed(Altered(), "altered", "1")) as engine:
        assert caught(engine, scene, METHOD, number, AIM, LATE)


@pytest.mark.parametrize("scene", PLANS)
def test_the_same_run_without_it_is_not(scene):
    with adapters.lent(completed(Altered(), "altered", "1")) as engine:
        assert not caught(engine, scene, METHOD, NUMBERS[0], 0.0, LATE)
