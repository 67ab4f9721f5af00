"""First steps that fail, in every family of steppers: for the sanitizers, too."""

from __future__ import annotations

import pytest

import lieeuler
from tests.lieeuler.systems import SYSTEMS


@pytest.mark.parametrize("method", [name for name, each in lieeuler.METHODS.items() if "step" in each.controls])
def test_no_fault_where_the_first_step_fails(method):
    """Newton's iteration tries again from the start of the run: there is no step before to guess from."""
    with pytest.raises(lieeuler.IntegrationError):
        lieeuler.integrate(SYSTEMS["double_pendulum"](), method, 1e3, [0.0, 1e3])
