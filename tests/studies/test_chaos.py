"""Statistical agreement: the test on series of known law, what it finds in wrong models, and a real study."""

import csv
import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

from crosscheck import load_scene
from crosscheck.cli import app
from crosscheck.studies import chaos
from crosscheck.studies.chaos import Comparison, compare, effective, inefficiency, judge


def correlated(seed, count=4000, memory=0.9):
    """A series of standard normal numbers, each `memory` times the one before and fresh noise (AR(1))."""
    from scipy.signal import lfilter

    noise = np.random.default_rng(seed).normal(size=count + 200) * np.sqrt(1 - memory**2)
    return lfilter([1.0], [1.0, -memory], noise)[200:]


def test_the_inefficiency_of_a_series_with_memory():
    """(1 + m) / (1 - m) samples count as one, a textbook's result for AR(1)."""
    for memory in (0.0, 0.5, 0.9):
        found = np.mean([inefficiency(correlated(seed, 10_000, memory)) for seed in range(10)])
        # the window cuts e^-5 of the sum off; ten series of five hundred independent samples leave a few percent
        assert found == pytest.approx((1 + memory) / (1 - memory), rel=0.1)


def test_false_alarms_are_as_rare_as_the_threshold_says():
    """At p < 0.05 five of a hundred pairs of one law: binomial, three deviations above are 11."""
    alarms = sum(compare(correlated(seed), correlated(1000 + seed))[2] < 0.05 for seed in range(100))
    assert alarms <= 11


def test_samples_that_follow_from_each_other_do_not_count_as_many():
    """Without that the same pairs would raise far more alarms than one in twenty."""
    from scipy.stats import ks_2samp

    naive = sum(ks_2samp(correlated(seed), correlated(1000 + seed)).pvalue < 0.05 for seed in range(40))
    assert naive > 11
    assert effective(correlated(0)) < 4000 / 5


@pytest.mark.parametrize("change", [lambda series: series + 0.5, lambda series: 3.0 * series], ids=["shift", "spread"])
def test_another_law_is_found(change):
    truth = {"height": correlated(1)}
    found = Comparison("scene", "engine", "method", "label", 0.1, 1.0, 1.0)
    judge(found, truth, {"height": change(correlated(2))}, comparisons=10)
    assert found.verdict == "differs"
    judge(found, truth, {"height": correlated(2)}, comparisons=10)
    assert found.verdict == "agrees"


def test_a_series_too_short_to_tell_is_undecided():
    found = Comparison("scene", "engine", "method", "label", 0.1, 1.0, 1.0)
    judge(found, {"height": correlated(1, 300)}, {"height": correlated(2, 300)}, comparisons=10)
    assert found.verdict == "undecided"


@pytest.mark.slow
def test_the_study_tells_right_engines_from_wrong_models(tmp_path, monkeypatch):
    """In-house and MuJoCo agree with the reference past the horizon; under half as much gravity again they do not."""
    words = ["study", "chaos", "thrown_double", "--engine", "lieeuler", "--engine", "mujoco", "--method", "rattle4",
             "--method", "RK4", "--time-limit", "600"]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "right")])
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader((tmp_path / "right" / "chaos.csv").open()))
    assert {row["verdict"] for row in rows} == {"agrees"}
    assert all(float(row["horizon"]) < 50 < float(row["duration"]) for row in rows)
    real = chaos._run_into

    def heavier(found, way, long, *more):
        real(found, way, dataclasses.replace(long, gravity=1.5 * long.gravity), *more)

    monkeypatch.setattr(chaos, "_run_into", heavier)
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "wrong")])
    assert done.exit_code == 1, done.output


def test_long_scenes_have_samples_at_even_times():
    long = chaos.long_scene(load_scene("thrown_double"), 100.0)
    assert long.samples == 401
    assert long.t[1] == chaos.SPACING
