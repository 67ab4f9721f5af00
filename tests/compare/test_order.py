"""Formulas of solution verification on sequences whose limit is known."""

import numpy as np
import pytest

from crosscheck.compare.order import (
    cancelling,
    differ,
    index,
    limit,
    observed_order,
    spread_of_tolerances,
)

H = (1 / 12, 1 / 7, 1 / 4)
RNG = np.random.default_rng(5)
C, D = RNG.standard_normal((2, 5, 2, 3))


def answers(order, error=0.0, more=1.0, h=H):
    """Answers less truth of a method of this order whose limit is off by `error`."""
    return [error + C * step**order + more * D * step**(order + 1) for step in h]


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6, 8])
def test_weights_have_the_sum_one_and_cancel_two_powers(order):
    weights = cancelling(np.array(H), order)
    assert weights.sum() == pytest.approx(1.0)
    for power in (order, order + 1):
        assert abs(weights @ np.array(H) ** power) < 1e-14
    assert abs(weights @ np.array(H) ** (order + 2)) > 1e-12


def test_weights_of_halves_are_those_of_romberg():
    assert cancelling(np.array([1.0, 2.0]), 2) == pytest.approx([4 / 3, -1 / 3])


@pytest.mark.parametrize("order", [1, 2, 4, 5])
@pytest.mark.parametrize("h", [H, (1.0, 2.0, 4.0), (0.1, 0.31, 0.37)])
def test_the_order_is_read_from_any_three_steps(order, h):
    assert observed_order(h, answers(order, more=0.0, h=h)) == pytest.approx(order, abs=0.01)
    assert observed_order(h, answers(order, error=7.0, more=0.0, h=h)) == pytest.approx(order, abs=0.01)


def test_an_order_of_nothing_is_infinite_and_of_what_is_not_finite_none():
    same = [C, C, C]
    assert observed_order(H, same) == np.inf
    assert observed_order(H, [C, C, C * np.nan]) == -np.inf


@pytest.mark.parametrize("order", [1, 2, 4])
def test_what_two_powers_explain_is_no_error(order):
    found = limit(H, answers(order), order, [0.0] * 3)
    assert found.by == "order"
    assert found.size < 1e-12
    assert found.uncertainty >= found.size


@pytest.mark.parametrize("order", [1, 2, 4])
def test_an_error_of_the_model_stays_in_the_limit(order):
    error = 20.0 * (H[2] ** (order + 1))
    found = limit(H, answers(order, error=error), order, [0.0] * 3)
    assert found.size == pytest.approx(error * np.sqrt(3), rel=1e-6)


def test_a_limit_is_trusted_no_further_than_it_moved_at_the_last_refinement():
    """With random parts of steps, errors have no one constant: T3 is near T2 by chance and off nevertheless."""
    h = (1 / 25, *H)
    values = answers(2, more=0.0, h=h)
    values[0] = values[0] + 1e-3
    values[1] = values[1] + 1e-3 * h[1]**2 / h[0]**2
    alone, beside = limit(h[:3], values[:3], 2, [0.0] * 3), limit(h, values, 2, [0.0] * 4)
    assert np.array_equal(beside.value, alone.value)
    before = limit(h[1:], values[1:], 2, [0.0] * 3)
    moved = np.linalg.norm(alone.value - before.value, axis=-1).max()
    assert beside.uncertainty == pytest.approx(max(3 * moved, alone.uncertainty))
    assert beside.uncertainty > 2 * alone.uncertainty


@pytest.mark.parametrize("rounding", [[0.0] * 3, [10.0] * 3])
def test_a_limit_that_a_far_smaller_step_does_not_confirm_is_within_its_uncertainty(rounding):
    """Where all three steps damp an oscillation away, their answers agree on a limit without it."""
    damped, far = answers(1, error=20.0), (H[0] / 100, answers(1, h=[H[0] / 100])[0])
    alone, beside = limit(H, damped, 1, rounding), limit(H, damped, 1, rounding, far=far)
    assert np.array_equal(alone.value, beside.value)
    assert alone.uncertainty < alone.size + sum(rounding)
    assert beside.parts["extrapolation"] > beside.size


@pytest.mark.parametrize("order", [1, 2, 4])
def test_an_error_of_the_model_stays_beside_a_coarser_answer(order):
    h, error = (1 / 25, *H), 1e-3
    found = limit(h, answers(order, error=error, h=h), order, [0.0] * 4)
    assert found.size == pytest.approx(error * np.sqrt(3), rel=1e-6)
    assert found.by == "order"


def test_the_uncertainty_is_the_sum_of_its_parts():
    found = limit(H, answers(2), 2, [1e-9, 2e-9, 4e-9], noise=1e-8)
    weights = np.abs(cancelling(np.array(H), 2))
    two, three = cancelling(np.array(H[:2]), 2), cancelling(np.array(H), 2)
    values = answers(2)
    step = sum(w * v for w, v in zip(three, values, strict=True)) - two[0] * values[0] - two[1] * values[1]
    assert found.parts["extrapolation"] == pytest.approx(3 * np.linalg.norm(step, axis=-1).max())
    assert found.parts["rounding"] == pytest.approx(weights @ [1e-9, 2e-9, 4e-9])
    assert found.parts["noise"] == pytest.approx(weights.sum() * 3e-8)
    assert found.uncertainty == pytest.approx(sum(found.parts.values()))


def test_answers_within_rounding_are_asked_no_order():
    values = [1e-13 * C, 2e-13 * D, 3e-13 * C]
    assert not differ(values, [1e-12] * 3, 0.0)
    found = limit(H, values, 4, [1e-12] * 3, observed=-3.0)
    assert found.by == "rounding"
    assert found.uncertainty >= found.size


def test_a_difference_that_does_not_fall_is_seen_through_rounding():
    """A wrong model is constant: no floor of rounding excuses it."""
    values = [1e-6 + 1e-13 * C, 1e-6 + 1e-13 * D, 1e-6 + 2e-13 * C]
    found = limit(H, values, 4, [1e-12] * 3)
    assert found.size > 1000 * found.uncertainty


def test_below_its_order_nothing_is_extrapolated():
    values = answers(1)
    found = limit(H, values, 2, [0.0] * 3, observed=1.1)
    assert found.by == "no order"
    assert np.array_equal(found.value, values[0])
    assert limit(H, values, 2, [0.0] * 3, observed=1.6).by == "order"


def test_the_index_of_order_one_covers_a_sawtooth():
    """An event is late by up to a step: errors within C h, without an order."""
    for late in RNG.random((200, 3)):
        values = [np.full((1, 1, 3), share * step) for share, step in zip(late, H, strict=True)]
        jump = np.sqrt(3) * H[0]
        found = index(H, values, 1, 0.0, jump=jump)
        assert found.size <= found.uncertainty


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_index_is_three_times_the_error_of_a_method_of_its_order(order):
    found = index(H, answers(order, more=0.0), order, 0.0)
    assert found.uncertainty == pytest.approx(3 * found.size)


def test_events_that_are_late_are_beyond_the_index_of_a_higher_order():
    found = [index(H, [np.full((1, 1, 3), share * step) for share, step in zip(late, H, strict=True)], 4, 0.0)
             for late in RNG.random((200, 3))]
    assert np.mean([each.size > each.uncertainty for each in found]) > 0.5


def test_the_spread_of_tolerances():
    values = [0.0 * C, C, 4 * C]
    found = spread_of_tolerances(values, 1.0, 2.0)
    assert found.uncertainty == pytest.approx(12 * np.linalg.norm(C, axis=-1).max() + 7.0)


def test_answers_that_do_not_differ_at_two_tolerances_are_as_sure_as_the_finest():
    assert spread_of_tolerances([C, C, C], 1e-9, kept=1.0).uncertainty == pytest.approx(1.0)
    assert spread_of_tolerances([C, 1.1 * C, C], 1e-9, kept=1e9).uncertainty < 1e3


def test_what_is_not_finite_has_no_limit():
    assert limit(H, [C, C, C * np.inf], 2, [0.0] * 3).uncertainty == np.inf
