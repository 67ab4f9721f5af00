"""Drift: verdicts on errors of known kind, and a short real run."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from crosscheck.cli.app import app
from crosscheck.studies import drift
from crosscheck.studies.drift import EPS, DriftAsk, DriftStudy, growth, judge
from crosscheck.studies.study import conduct

T = np.linspace(0.0, 1000.0, 10_001)
STEPS = 1_000_000


def walk(seed, size):
    return size * np.cumsum(np.random.default_rng(seed).standard_normal(len(T)))


def test_a_band_has_no_trend():
    band, slope, trend, exponent, verdict = judge(T, 1e-6 * np.sin(3.1 * T) ** 2, STEPS)
    assert band == pytest.approx(1e-6, rel=1e-3)
    assert abs(slope) * 1000 < 1e-8
    assert trend < 0.05
    assert exponent < 0.3
    assert verdict == "bounded, without trend"


@pytest.mark.parametrize("band", [0.0, 1e-11])
def test_a_line_drifts_also_below_a_band(band):
    errors = -1e-13 * T + band * np.sin(7.3 * T)
    _, slope, _, exponent, verdict = judge(T, errors, STEPS)
    assert slope == pytest.approx(-1e-13, rel=1e-2)
    assert exponent > 0.85
    assert verdict == "drifts"


def test_random_walks_grow_as_the_root_of_n():
    exponents = [growth(walk(seed, 1e-15)) for seed in range(40)]
    # that of one walk scatters by 0.07, the mean of forty by 0.011: three of these
    assert np.mean(exponents) == pytest.approx(0.5, abs=0.035)


def test_a_small_walk_is_round_off_and_a_large_one_is_not():
    seed = next(seed for seed in range(40) if judge(T, walk(seed, 1e-16), STEPS)[2] > 0.05
                and growth(walk(seed, 1.0)) < 0.6)
    assert judge(T, walk(seed, 1e-16), STEPS)[4] == "round-off"
    assert judge(T, walk(seed, 1e-16 / EPS), STEPS)[4] == "drifts"


def test_an_error_that_is_exactly_nothing():
    assert judge(T, np.zeros_like(T), STEPS) == (0.0, 0.0, 0.0, 0.0, "bounded, without trend")


def test_the_command_tells_a_band_from_a_drift(tmp_path):
    done = CliRunner().invoke(app, ["study", "drift", "single_pendulum", "--engine", "lieeuler", "--engine", "mujoco",
                                    "--method", "rattle2", "--method", "RK4", "--steps", "20000", "--step", "0.01",
                                    "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    rows = {row["method"]: row for row in csv.DictReader((tmp_path / "drift.csv").open())}
    assert rows["rattle2"]["energy_verdict"] == "bounded, without trend"
    assert rows["RK4"]["energy_verdict"] == "drifts"
    assert float(rows["RK4"]["energy_slope"]) < 0
    assert float(rows["rattle2"]["constraint_position"]) < 1e-14  # lengths of 1 m, 50 roundings
    assert len(json.loads((tmp_path / "drift.json").read_text())["runs"]) == 2


def test_a_run_beyond_the_limit_and_a_failing_one_are_rows(tmp_path):
    done = CliRunner().invoke(app, ["study", "drift", "single_pendulum", "--engine", "lieeuler", "--method", "rattle2",
                                    "--steps", "100000000", "--time-limit", "0.01", "--out", str(tmp_path / "long")])
    assert done.exit_code == 3, done.output
    assert "skipped" in done.output
    done = CliRunner().invoke(app, ["study", "drift", "single_pendulum", "--engine", "lieeuler", "--method", "rattle2",
                                    "--steps", "100", "--step", "5", "--out", str(tmp_path / "coarse")])
    assert done.exit_code == 1, done.output
    (row,) = json.loads((tmp_path / "coarse" / "drift.json").read_text())["runs"]
    assert row["status"] == "failed"
    assert "smaller step" in row["reason"]


def test_a_killed_study_goes_on_where_it_was(tmp_path, monkeypatch):
    """The study is interrupted in its second run; the next study makes that one alone, and one after it all anew."""
    ask = DriftAsk(("single_pendulum",), ("lieeuler",), ("rattle2", "rattle4"), step=0.01, steps=100)
    made, real = [], drift.long_run

    def watched(row, scene, limit):
        made.append(row.method)
        if len(made) == 2:
            raise KeyboardInterrupt
        return real(row, scene, limit)

    monkeypatch.setattr(drift, "long_run", watched)
    with pytest.raises(KeyboardInterrupt):
        conduct(DriftStudy(), ask, tmp_path, lambda *_: None)
    document = conduct(DriftStudy(), ask, tmp_path, lambda *_: None)
    assert made == ["rattle2", "rattle4", "rattle4"]
    assert [row.method for row in document.runs] == ["rattle2", "rattle4"]
    conduct(DriftStudy(), ask, tmp_path, lambda *_: None)
    assert made[3:] == ["rattle2", "rattle4"]
