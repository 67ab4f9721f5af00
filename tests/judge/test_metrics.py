"""Observed orders."""

import numpy as np
import pytest

from crosscheck.judge.metrics import Plateau, observed_order


def test_order_of_a_power_law_is_exact():
    steps = np.array([0.1, 0.05, 0.025, 0.0125])
    order = observed_order(steps, 3.0 * steps**4)
    assert order.observed == pytest.approx(4.0, abs=1e-12)  # logarithms of a few eps
    assert (order.used, len(order.pairs)) == (4, 3)
    assert observed_order([0.2, 0.1], [0.04, 0.01]).pairs == pytest.approx((2.0,), abs=1e-12)


def test_steps_on_the_rounding_plateau_do_not_count():
    steps = 0.1 / 2.0 ** np.arange(6)
    floor = 1e-13
    values = np.maximum(steps**4, floor)
    values[4:] = floor
    order = observed_order(steps, values, Plateau(floor))
    assert order.used == 4
    assert order.observed == pytest.approx(4.0, abs=1e-12)
    assert observed_order(steps[2:], values[2:], Plateau(floor)).observed is None


@pytest.mark.parametrize(("floors", "used"), [(8.5, 4), (7.5, 3)])
def test_an_error_counts_from_eight_floors_on(floors, used):
    steps = 0.1 / 2.0 ** np.arange(4)
    assert observed_order(steps, steps**2, Plateau(steps[-1]**2 / floors)).used == used


def falling(*slopes):
    """Steps that are halved, and errors of these orders between them."""
    steps = 0.1 / 2.0 ** np.arange(len(slopes) + 1)
    return steps, 1e-6 * 2.0 ** -np.cumsum([0.0, *slopes])


@pytest.mark.parametrize(("slopes", "documented", "observed"), [
    ((2.5, 3.2), 4, None), ((2.5, 3.2), 3, 2.85), ((3.0, 3.0), 4, 3.0), ((3.5, 3.7), 4, 3.6)])
def test_an_order_that_still_rises_where_rounding_sets_in_is_none_where_it_is_half_of_one_short(
        slopes, documented, observed):
    steps, values = falling(*slopes, 9.0)
    order = observed_order(steps, values, Plateau(values[-1], 0.0, documented))
    assert (order.used, order.exhausted) == (3, True)
    assert order.observed == (None if observed is None else pytest.approx(observed, abs=0.01))


@pytest.mark.parametrize(("slope", "used"), [(4.0, 4), (3.6, 4), (3.4, 3)])
def test_the_error_next_to_rounding_counts_unless_the_order_is_half_of_one_short(slope, used):
    steps, values = falling(slope, slope, slope, 1.0, 0.0, 0.0)
    assert observed_order(steps, values, Plateau(0.0, 1.0, 4)).used == used


@pytest.mark.parametrize(("slopes", "finest"), [((3.0, 3.2, 3.5), 3.5), ((3.0, 3.5, 3.2), None)])
def test_the_finest_order_is_told_where_all_rise(slopes, finest):
    order = observed_order(*falling(*slopes), Plateau(0.0, 0.0, 4))
    assert order.finest == (None if finest is None else pytest.approx(finest))


def test_two_errors_are_rounding_after_two_that_showed_the_order():
    steps, values = falling(4.0, 1.0, 0.2)
    assert observed_order(steps, values, Plateau(0.0, 1.0, 4)).observed is None


def test_two_errors_that_fall_too_slowly_are_not_both_rounding():
    """By 1.5 orders of 4: the second is, as the order was shown before it; of two, they would have to stop."""
    steps, values = falling(4.0, 4.0, 2.0, 1.5)
    assert observed_order(steps, values, Plateau(0.0, 2 * values[-2], 4)).used == 4


def test_finer_steps_show_an_order_that_the_next_term_hides():
    steps = [4e-3 / 2**k for k in range(8)]
    errors = [h * (1 - 200 * h) for h in steps]  # at 4 ms the next term takes 0.8 of the first one away
    coarse = observed_order(steps[:4], errors[:4])
    assert coarse.observed < 0.7
    assert not coarse.settled
    fine = observed_order(steps, errors, finest=4)
    assert fine.used == 4
    assert fine.observed == pytest.approx(1.0, abs=0.03)
    assert fine.settled


def test_an_order_settles_where_three_slopes_agree_and_is_exhausted_on_the_plateau():
    steps = [1e-2 / 2**k for k in range(5)]
    assert observed_order(steps[:4], [h**2 for h in steps[:4]]).settled
    assert not observed_order(steps[:3], [h**2 for h in steps[:3]]).settled
    assert not observed_order(steps, [h**2 for h in steps], Plateau(1e-9)).exhausted
    assert observed_order(steps, [h**2 for h in steps], Plateau(1e-6)).exhausted


def test_order_is_not_fitted_across_a_failed_step():
    assert observed_order([0.4, 0.2, 0.1, 0.05], [np.inf, 0.2, 0.1, 0.05]).used == 3
    assert observed_order([0.4, 0.2, 0.1, 0.05], [0.4, np.inf, 0.1, 0.05]).observed is None


def test_errors_that_vanish_are_no_slope():
    """A run that hits truth exactly at one step, and rounding at finer ones; no warning of a logarithm."""
    plateau = Plateau(0.0, 1e-8, 4)
    assert observed_order([0.4, 0.2, 0.1, 0.05], [1e-9, 0.0, 1e-15, 1e-15], plateau).observed is None
    assert observed_order([0.4, 0.2, 0.1, 0.05], [0.0, 0.0, 0.0, 0.0], plateau).observed is None


def test_what_rounding_of_positions_is_over_the_step_tells_no_order_of_velocities():
    """MuJoCo Warp's Euler in maximal form on the double pendulum; errors that stop falling above that are the method's.
    """
    steps = [4e-3 / 2**k for k in range(8)]
    values = np.array([1.23e-2, 3.51e-3, 3.19e-3, 2.07e-3, 8.61e-4, 7.39e-4, 1.97e-3, 1.41e-3])
    plateau = Plateau(1e-7, 2e-3, 1, rate=2.0**-23 * 4.0)
    assert observed_order(steps, values, Plateau(1e-7, 2e-3, 1), 4).observed < 0.9  # fails
    assert observed_order(steps, values, plateau, 4).observed is None
    assert observed_order(steps, values + 0.1, plateau, 4).observed < 0.1
    assert observed_order(steps, 1e3 * np.array(steps), plateau, 4).observed == pytest.approx(1.0)
