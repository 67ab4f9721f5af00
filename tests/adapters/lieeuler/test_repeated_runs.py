"""Runs of scenes repeated from other starts, and with other things asked for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import lieeuler
from tests.adapters.lieeuler.against_truth import library
from tests.lieeuler.accuracy import FIELDS
from tests.lieeuler.test_repeated_runs import TAYLOR

STATES = ("x", "R", "v", "w")


@pytest.mark.parametrize("name", ["bricard", "four_bar"])
def test_rows_chosen_at_one_start_are_not_those_of_another(name):
    """A plan keeps what it finds of loops where a run starts. A run from there again, from a start whose last bits
    differ and from one far away have the bits of runs of problems made anew, multipliers included."""
    given = library(name)
    asked = lieeuler.prepare(given, TAYLOR, t_eval=[0.0, 0.1], reduce="off", spin_free=False)
    later = lieeuler.integrate(given, TAYLOR, t_eval=[0.0, 0.2], rtol=1e-12, reduce="off")
    there = {each: getattr(later, each)[-1].copy() for each in STATES}
    here = {each: getattr(given, each).copy() for each in STATES}
    beside = here | {"R": np.nextafter(here["R"], 2)}
    for start in (here, here, beside, there, here, beside):
        anew = lieeuler.integrate(dataclasses.replace(given, **start), TAYLOR, t_eval=[0.0, 0.1], reduce="off",
                                  spin_free=False)
        shared = asked(**start)
        assert all(np.array_equal(getattr(anew, each), getattr(shared, each)) for each in FIELDS)


@pytest.mark.parametrize("reduce", [None, "off"])
@pytest.mark.parametrize("name", ["bricard", "four_bar", "slider_crank"])
def test_accelerations_are_the_same_whether_asked_for_at_every_step_or_not(name, reduce):
    """Monitoring asks for them at every step, a run without it at its samples alone."""
    problem = library(name)
    runs = [lieeuler.integrate(problem, TAYLOR, t_eval=[0.0, 0.3], monitor=monitor, reduce=reduce)
            for monitor in (True, False, True)]
    for other in runs[1:]:
        assert all(np.array_equal(getattr(runs[0], each), getattr(other, each)) for each in FIELDS)
