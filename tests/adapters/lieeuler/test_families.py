"""A few steps of every family of steppers on systems that reach every part of the kernel: for the sanitizers, too."""

from __future__ import annotations

import functools

import pytest

import lieeuler
from lieeuler import Status
from tests.adapters.lieeuler.against_truth import library

NAMES = ("single_pendulum", "chain_8", "parallelogram", "bricard", "sprung_pair", "stiff_damped", "branching_tree",
         "geared_arm", "coupled_arm", "rolling_disk", "driven_slider_crank", "torsion_wheel")
problem = functools.cache(library)


@pytest.mark.parametrize("method", lieeuler.METHODS)
@pytest.mark.parametrize("name", NAMES)
def test_no_fault_in_a_run(name, method):
    """Of two steps, whole and reduced."""
    fixed = "step" in lieeuler.METHODS[method].controls
    for reduce in ("off", None):
        run = lieeuler.integrate(problem(name), method, 1e-4 if fixed else None, [0.0, 4e-4, 6.5e-4], reduce=reduce)
        assert run.status in (Status.SUCCESS, Status.CONSTRAINTS_OPEN)
