"""Statistical agreement: the test on series of known distribution, its findings on wrong models, and a real study."""

import csv
import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

from crosscheck import load_scene
from crosscheck.cli.app import app
from crosscheck.studies import chaos
from crosscheck.studies.chaos import RUNS, Comparison, Law, judged

COUNT = 2000
ROW = Comparison(scene="scene", engine="engine", method="method", form=None, label="label", step=0.1, duration=1.0,
                 horizon=1.0, comparisons=10)


def correlated(seed, runs=1, memory=0.9, count=COUNT):
    """Series (runs, count) of standard normal numbers, each `memory` times the one before and fresh noise (AR(1))."""
    from scipy.signal import lfilter

    noise = np.random.default_rng(seed).normal(size=runs * count + 200) * np.sqrt(1 - memory**2)
    return lfilter([1.0], [1.0, -memory], noise)[200:].reshape(runs, count)


def swinging(seed, runs=1, count=COUNT):
    """A swing of eight samples whose size drifts over hundreds: correlations change sign long before they are gone."""
    phase = 2 * np.pi * np.arange(runs * count) / 8
    size = np.exp(0.5 * correlated(seed, runs, memory=0.995, count=count).reshape(-1))
    return (size * np.sin(phase) + 0.3 * correlated(seed + 5000, runs, 0.5, count).reshape(-1)).reshape(runs, count)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.97])
def test_a_run_counts_as_many_samples_as_the_theory_of_its_law_says(memory):
    """The median scatters most: signs of Gaussian numbers of correlation r have that of 2 / pi arcsin r."""
    lags = np.arange(1, COUNT)
    wanted = COUNT / (1 + 2 * np.sum(2 / np.pi * np.arcsin(memory**lags)))
    # two hundred runs give the scatter of each decile to a tenth, and the worst of nine counts
    assert Law.of(correlated(0, 200, memory)).effective == pytest.approx(wanted, rel=0.25)


@pytest.mark.parametrize("law", [correlated, swinging])
def test_false_alarms_are_as_rare_as_the_threshold_says(law):
    """At p < 0.05 at most five of a hundred runs of one law: binomial, three deviations above are 11; at 0.001 two."""
    truth = [Law.of(law(seed, RUNS)) for seed in range(10)]
    found = np.array([truth[seed % 10].compare(law(1000 + seed)[0])[2] for seed in range(100)])
    assert (found < 0.05).sum() <= 11
    assert (found < 0.001).sum() <= 2


@pytest.mark.parametrize("law", [correlated, swinging])
def test_samples_that_follow_from_each_other_do_not_count_as_many(law):
    """Without that the same runs would raise far more alarms than one in twenty."""
    from scipy.stats import ks_2samp

    truth = Law.of(law(0, RUNS))
    naive = sum(ks_2samp(law(1000 + seed)[0], truth.values, method="asymp").pvalue < 0.05 for seed in range(40))
    assert naive > 11


@pytest.mark.parametrize("change", [lambda series: series + 0.5, lambda series: 3.0 * series], ids=["shift", "spread"])
def test_another_law_is_found(change):
    truth = {"height": Law.of(correlated(1, RUNS))}
    assert judged(ROW, truth, {"height": change(correlated(2)[0])}).verdict == "differs"
    assert judged(ROW, truth, {"height": correlated(2)[0]}).verdict == "agrees"


def test_a_series_too_short_to_tell_is_undecided():
    truth = {"height": Law.of(correlated(1, RUNS, count=300))}
    assert judged(ROW, truth, {"height": correlated(2, count=300)[0]}).verdict == "undecided"


def test_what_never_moves_agrees_with_itself():
    still = np.zeros((RUNS, 100))
    assert Law.of(still).compare(still[0])[0] == 0


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
    real = chaos.compared

    def heavier(row, long, **more):
        return real(row, dataclasses.replace(long, gravity=1.5 * long.gravity), **more)

    monkeypatch.setattr(chaos, "compared", heavier)
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "wrong")])
    assert done.exit_code == 1, done.output


def test_long_scenes_have_samples_at_even_times():
    long = chaos.long_scene(load_scene("thrown_double"), 100.0)
    assert long.samples == 401
    assert long.t[1] == chaos.SPACING
