"""Truth without heyoka: the same motion, derivatives and conditioning as with it, and a seeded mistake is caught."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from crosscheck import references
from crosscheck.references import maximal
from crosscheck.references.dense_output import Truth


@pytest.mark.parametrize(("scene", "duration"), [("single_pendulum", 0.5), ("hinge_pendulum", 0.5),
                                                 ("slider_crank", 0.1)])
def test_it_agrees_with_compiled_series(scene, duration):
    loaded = crosscheck.load_scene(scene).replace(duration=duration, samples=6)
    own = Truth(loaded, portable=True).reference(loaded)
    other = references.compute(loaded)
    np.testing.assert_allclose(own.states.x, other.states.x, rtol=0, atol=1e-12)  # the bound of each
    np.testing.assert_allclose(own.states.R, other.states.R, rtol=0, atol=1e-12)
    assert own.horizon == other.horizon
    # Random directions miss the worst one by a small factor.
    assert 0.2 < own.amplification / other.amplification < 5.0
    # Maxima over two different grids of points: the k-th derivative may change by k / 4 of itself between two points of
    # a grid, and by the square of a half of that about its maximum, 0.1 at k = 5.
    np.testing.assert_allclose(own.position_derivatives[:6], other.position_derivatives[:6], rtol=0.1)
    np.testing.assert_allclose(own.attitude_derivatives[:6], other.attitude_derivatives[:6], rtol=0.1)


def test_a_mistake_in_one_formulation_is_caught(monkeypatch):
    loaded = crosscheck.load_scene("single_pendulum").replace(duration=0.5, samples=6)
    monkeypatch.setattr(maximal, "weight", lambda masses, gravity: np.outer(masses, 1.01 * gravity))
    with pytest.raises(references.TruthError, match="disagree"):
        Truth(loaded, portable=True).reference(loaded)


def test_it_is_prolonged_as_if_at_once():
    loaded = crosscheck.load_scene("hinge_pendulum").replace(duration=0.5, samples=6)
    at_once, twice = Truth(loaded, portable=True), Truth(loaded, portable=True)
    twice.prolong(0.2)
    one, other = at_once.reference(loaded), twice.reference(loaded)
    np.testing.assert_array_equal(one.states.x, other.states.x)
    np.testing.assert_array_equal(one.states.alpha, other.states.alpha)
    assert one.disagreement == other.disagreement
