"""Truth at any time: the same as at the output times, between the times of comparison, and prolonged."""

import numpy as np
import pytest

from crosscheck.references import compute, dense, truth
from crosscheck.references.dense_output import Truth
from crosscheck.references.maximal import Maximal
from crosscheck.references.taylor import Taylor, safe_step
from crosscheck.scene.file import load_scene

STATES = ("x", "R", "v", "w", "a", "alpha")
SCENES = ["double_pendulum", "four_bar", "planar_slider", "rolling_disk"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CROSSCHECK_CACHE", str(tmp_path))


@pytest.mark.parametrize("name", SCENES)
def test_times_between_those_of_comparison_are_covered(name):
    """The other formulation at random times: no more apart than the claim, which has a few grid points of a piece."""
    scene = load_scene(name).replace(duration=1.0, samples=3)
    known = dense(scene)
    t = np.sort(np.random.default_rng(4).uniform(0.0, 1.0, 25))
    between = Maximal(scene).run(np.concatenate([[0.0], t]))
    states = known.at(t)
    length = 1.0 + np.abs(scene.x0).max()
    assert np.abs(states.x - between.x[1:]).max() <= known.error * length
    assert np.abs(states.R - between.R[1:]).max() <= known.error
    for name in STATES:  # accelerations and rates too, in units of the rates of these scenes, 10 / s and its square
        np.testing.assert_allclose(getattr(states, name), getattr(between, name)[1:], rtol=0, atol=1e-9)


def test_the_same_at_output_times_and_however_it_was_asked():
    scene = load_scene("double_pendulum").replace(duration=2.0, samples=21)
    at_once, asked = compute(scene), dense(scene.replace(duration=0.3))
    asked.at([0.7])
    for name in STATES:
        np.testing.assert_array_equal(getattr(asked.at(scene.t), name), getattr(at_once.states, name))
        np.testing.assert_array_equal(getattr(truth(scene).states, name), getattr(at_once.states, name))
    reference = truth(scene)
    assert reference.amplification == pytest.approx(at_once.amplification, rel=1e-12)


def test_pieces_do_not_depend_on_what_was_asked():
    scene = load_scene("double_pendulum")
    series = Taylor(scene)
    short, end = series.advance(series.begin, 0.5)
    more, _ = series.advance(end, 1.0)
    whole, _ = series.advance(series.begin, 1.0)
    assert short[-1].start < 0.5 < short[-1].start + short[-1].length
    for one, other in zip([*short, *more], whole, strict=True):
        np.testing.assert_array_equal(one.coefficients, other.coefficients)
        assert one.length <= 1.02 * safe_step(one.coefficients)


def test_growth_and_error_are_those_of_the_time_asked_for():
    """A swing: over its first tenth they are smaller, and those of a computation of its own."""
    scene = load_scene("single_pendulum").replace(duration=1.0, samples=3)
    short = scene.replace(duration=0.1)
    known = dense(scene)
    for one, other in ((known.reference(short), compute(short)), (known.reference(scene), compute(scene))):
        assert one.disagreement == pytest.approx(other.disagreement, rel=0.5)  # a piece that ends later counts whole
        assert one.amplification == pytest.approx(other.amplification, rel=1e-6)
    assert known.reference(short).amplification < 0.99 * known.reference(scene).amplification


@pytest.mark.parametrize("times", [[-1.0], [0.2, 0.1], [np.nan]])
def test_times_have_to_increase(times):
    with pytest.raises(ValueError, match="increase from 0"):
        Truth(load_scene("single_pendulum")).at(times)
