"""The limit for vanishing steps, which distinguishes a wrong model from a coarse step."""

import dataclasses

import numpy as np
import pytest

from crosscheck.document import Order, Plan, Way
from crosscheck.judge import known
from crosscheck.judge.plan import halved
from crosscheck.judge.richardson import extrapolated, extrapolation_order, judge_limit
from crosscheck.scene.file import load_scene
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.fake_engine import FakeEngine, install


def fitted(observed, used):
    return Order(observed=observed, documented=2, used=used, pairs=())


ORDERS = dict.fromkeys(("position", "attitude", "velocity", "angular velocity"), fitted(2.0, 4))


@pytest.fixture(scope="module")
def scene():
    return load_scene("single_pendulum").replace(duration=0.5, samples=6)


def off(truth, size):
    """Truth pushed by `size` t metres."""
    push = size * truth.t[:, None, None] * np.array([1.0, 0.0, 0.0])
    return dataclasses.replace(truth.states, x=truth.states.x + push)


def found(scene, truth, size, order=2, orders=ORDERS, failing=frozenset()):
    runs = [(h, off(truth, size(h))) for h in (4e-3, 2e-3)]
    return {finding.kind: finding for finding in judge_limit(scene, runs, truth, order, orders, failing)}


@pytest.mark.parametrize("order", [1, 2, 4, 8])
def test_extrapolation_removes_the_leading_error_and_nothing_else(truth, order):
    coarse, fine = (off(truth, 10 * h**order) for h in (0.2, 0.1))
    left = extrapolated(coarse, fine, 2.0, order).x - truth.states.x
    assert np.abs(left).max() < 1e-13 * 10  # roundings of numbers of size one


def test_a_coarse_step_has_the_right_limit_and_a_wrong_model_has_not(scene, truth):
    coarse = found(scene, truth, lambda h: 100 * h**2)["limit position"]
    assert coarse.status == "ok"
    assert coarse.value < 1e-12
    wrong = found(scene, truth, lambda h: 100 * h**2 + 0.01)["limit position"]
    assert wrong.status == "fail"
    assert wrong.value == pytest.approx(0.01 * 0.5, rel=1e-9)
    assert "the model differs" in wrong.detail


def test_a_lower_order_alone_does_not_look_like_a_wrong_model(scene, truth):
    low = {**ORDERS, "position": fitted(1.0, 4)}
    assert found(scene, truth, lambda h: 0.5 * h, 4, low)["limit position"].value > 1e-5
    assert found(scene, truth, lambda h: 0.5 * h, 4, low, frozenset({"position"}))["limit position"].status == "ok"


def test_a_limit_of_errors_that_rise_as_steps_shrink_says_so_and_blames_no_model(scene, truth):
    rising = {**ORDERS, "position": fitted(-1.0, 4)}
    finding = found(scene, truth, lambda h: 1e-4 / h, 1, rising, frozenset({"position"}))["limit position"]
    assert finding.status == "fail"
    assert known.RISES in finding.detail
    assert "the model differs" not in finding.detail


def test_the_order_of_extrapolation_is_the_documented_one_unless_another_is_seen():
    assert extrapolation_order(4, fitted(2.02, 4), failed=True) == 2
    assert extrapolation_order(4, fitted(4.4, 4), failed=False) == 4
    assert extrapolation_order(4, fitted(0.1, 4), failed=True) == 4  # errors that do not fall have no order
    assert extrapolation_order(4, fitted(None, 2), failed=True) == 4
    # a coarse run that nearly failed makes the order over all steps far too high
    assert extrapolation_order(2, fitted(11.6, 4), failed=True) == 2


def test_one_run_has_no_limit(scene, truth):
    findings = judge_limit(scene, [(1e-3, truth.states)], truth, 2, ORDERS, frozenset())
    assert {finding.status for finding in findings} == {"unresolved"}


def test_every_order_study_judges_the_limit(monkeypatch):
    install(monkeypatch, FakeEngine())
    record = run_cell(Cell("single_pendulum", Way("fake", "Plain"), Plan(0.5, {1: 1e-3}, {1: halved(4e-3)},
                                                                               samples=26)))
    limits = [finding for finding in record.findings if finding.kind.startswith("limit")]
    assert len(limits) == 4
    assert {finding.status for finding in limits} == {"ok"}
