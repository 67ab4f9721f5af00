"""The frontier read from made-up ladders, whose times are known by formulas."""

import pytest
from msgspec.structs import replace

from crosscheck.studies.work_precision import Curve, Rung, confirmed, cost_at, curves, frontier


def ladder(order, constant, price, counts=(10, 20, 40, 80, 160)):
    """Errors and costs of a method with error constant * n^-order and cost price * n."""
    return tuple(constant * n**-order for n in counts), tuple(price * n for n in counts)


def test_power_laws_are_met_exactly_between_rungs():
    errors, costs = ladder(4, 1.0, 0.5)
    for level in (1e-5, 3e-6, 1e-7, 2e-9):
        assert cost_at(errors, costs, level) == pytest.approx(0.5 * level ** (-1 / 4), rel=1e-12)


def test_nothing_is_extrapolated():
    errors, costs = ladder(2, 1.0, 1.0)
    assert cost_at(errors, costs, 0.9 * errors[-1]) is None
    assert cost_at(errors, costs, errors[-1]) == costs[-1]
    # at a looser level than any rung the cheapest rung counts
    assert cost_at(errors, costs, 1e3) == costs[0]
    assert cost_at((), (), 1e-3) is None


def test_a_chance_zero_of_the_error_wins_nothing():
    assert confirmed([1e-2, 1e-9, 1e-4, 1e-6]) == [1e-2, 1e-4, 1e-4, 1e-6]
    assert cost_at([1e-2, 1e-9, 1e-4, 1e-6], [1.0, 2.0, 4.0, 8.0], 1e-8) is None
    assert cost_at([1e-2, 1e-9, 1e-4, 1e-6], [1.0, 2.0, 4.0, 8.0], 1e-5) == pytest.approx(32**0.5)


def test_an_exact_rung_counts_by_itself_and_not_in_logarithms():
    assert cost_at([1e-3, 0.0], [1.0, 2.0], 1e-6) == 2.0


def test_who_leads_and_by_how_much():
    own = Curve("lieeuler", "lieeuler fast", *ladder(8, 1e3, 2.0))
    cheap = Curve("mujoco", "mujoco RK4", *ladder(4, 1.0, 1.0))
    slow = Curve("exudyn", "exudyn RK44", *ladder(4, 1.0, 3.0))
    bound = Curve("heyoka", "bound: heyoka", *ladder(8, 1e3, 0.5))
    loose, tight, beyond = frontier([own, cheap, slow, bound], [1e-3, 1e-7, 1e-30])
    assert (loose.winner, loose.other) == ("mujoco RK4", "mujoco RK4")
    assert loose.factor == pytest.approx(10 / 20)  # both by their coarsest rung
    assert tight.winner == tight.own == "lieeuler fast"
    assert tight.factor == pytest.approx(1e-7 ** (-1 / 4) / (2.0 * (1e-7 / 1e3) ** (-1 / 8)))
    assert tight.to_bound == pytest.approx(4.0)
    assert list(tight.costs) == ["bound: heyoka", "lieeuler fast", "mujoco RK4", "exudyn RK44"]
    assert beyond.winner is beyond.own is beyond.factor is beyond.to_bound is None


def test_curves_leave_out_what_has_no_figures():
    row = Rung("e", "m", 0.1, scene="scene", label="e m", end_position=1e-3, wall_ms=2.0)
    rows = [row, replace(row, end_position=None), replace(row, end_position=float("inf")), replace(row, wall_ms=None)]
    assert curves(rows) == [Curve("e", "e m", (1e-3,), (2.0,))]
