"""Which integrator the maximal formulation takes, and that the implicit one agrees with the Taylor series."""

import numpy as np
import pytest
from scipy.integrate import DOP853, Radau

from crosscheck.references import compute, maximal
from crosscheck.references.maximal import RTOL, Maximal
from crosscheck.scene.file import load_scene


def test_eigenvalues_are_those_of_the_equations():
    A = np.array([[0.0, 1.0], [-25.0, -6.0]])  # -3 +- 4i
    values = maximal.eigenvalues(lambda t, y: A @ y, np.array([0.7, -0.2]))
    assert sorted(values, key=lambda value: value.imag) == pytest.approx([-3 - 4j, -3 + 4j], rel=1e-7)


@pytest.mark.parametrize(("values", "integrator", "rtol"), [
    ([50j, -50j, -1.0], DOP853, RTOL), ([1000j, -1000j], DOP853, 10 * RTOL), ([-2e4, -50.0], Radau, 1e-12),
    ([2e4, -1.0], DOP853, 200 * RTOL)])
def test_fast_decay_asks_for_the_implicit_method_and_fast_oscillation_for_a_looser_one(values, integrator, rtol):
    found = maximal.integrator_for(np.array(values), RTOL)
    assert found[0] is integrator
    assert found[1] == pytest.approx(rtol)


def test_scenes_without_springs_are_integrated_as_tightly_as_ever():
    assert Maximal(load_scene("fast_top_1500")).integrator == (DOP853, RTOL)


def test_the_implicit_method_agrees_with_the_series():
    """1e-12 relative, the bound of every truth; the decay of 2e4/s lasts for 600 time constants."""
    reference = compute(load_scene("stiff_damped").replace(duration=0.03, samples=4))
    assert reference.second_source == "Radau (SciPy), maximal coordinates"
    assert reference.disagreement <= reference.allowed == 1e-12
