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
    assert own.amplification == pytest.approx(other.amplification, rel=0.01)  # at other points of the motion
    assert "one formulation" in own.second_source


def test_where_the_rows_lose_rank_there_is_no_truth():
    """A parallelogram that stretches out goes on as one or as two crossed bars: what rounding chooses is not said."""
    loaded = crosscheck.load_scene("parallelogram").replace(duration=0.6, samples=4)
    with pytest.raises(references.TruthError, match=r"disagree by|no step is short enough"):
        Truth(loaded, portable=True).reference(loaded)


def test_a_motion_that_is_not_settled_is_caught(monkeypatch):
    """A piece of ten times the tolerated length is no solution at other nodes."""
    loaded = crosscheck.load_scene("double_pendulum").replace(duration=0.5, samples=6)
    monkeypatch.setattr(maximal, "TAIL", 1e-6)
    found = Truth(loaded, portable=True).reference(loaded)
    assert found.disagreement > 100 * found.allowed


def test_it_is_prolonged_as_if_at_once():
    loaded = crosscheck.load_scene("hinge_pendulum").replace(duration=0.5, samples=6)
    at_once, twice = Truth(loaded, portable=True), Truth(loaded, portable=True)
    twice.prolong(0.2)
    one, other = at_once.reference(loaded), twice.reference(loaded)
    np.testing.assert_array_equal(one.states.x, other.states.x)
    np.testing.assert_allclose(one.states.alpha, other.states.alpha, rtol=0, atol=1e-14)  # sums in another order
    assert one.disagreement == pytest.approx(other.disagreement, rel=0.1)
