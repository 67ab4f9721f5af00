"""Extrapolated DAE1L_LSE: expansion of a step."""

from __future__ import annotations

import numpy as np
import pytest

import lieeuler
from tests.lieeuler.systems import SYSTEMS


def test_a_step_has_an_expansion_in_powers_of_its_length():
    """Rows n of the table lose one power of H a column: differences of neighbours in a row go as H^n."""
    problem = SYSTEMS["double_pendulum"]()

    def differences(h):
        rows = []
        for n in range(1, 5):
            end = lieeuler.integrate(problem, "DAE1L_LSE", h / n, [0.0, h])
            row = [np.concatenate([end.x[-1], end.v[-1], end.w[-1]], axis=None)]
            for k in range(1, n):
                row.append(row[-1] + (row[-1] - rows[-1][k - 1]) * (n - k) / k)
            rows.append(row)
        return [np.abs(row[-1] - row[-2]).max() for row in rows[1:]]

    coarse, fine = differences(1e-2), differences(2.5e-3)
    for power, (a, b) in enumerate(zip(coarse, fine, strict=True), start=2):
        assert np.log(a / b) / np.log(4) == pytest.approx(power, abs=0.3)
