"""Worker processes: results in order, crashes recorded, nothing lost."""

from crosscheck.jobs.drive import Crash, run_tasks
from tests.engines.faults import chatter, square_or_die


def test_results_come_in_order_and_progress_counts_every_task():
    seen = []
    assert run_tasks(square_or_die, range(5), 2, lambda index, result: seen.append((index, result))) == [0, 1, 4, 9, 16]
    assert sorted(seen) == [(0, 0), (1, 1), (2, 4), (3, 9), (4, 16)]


def test_a_dying_worker_costs_only_its_own_task():
    results = run_tasks(square_or_die, [1, -1, 2, 3, -1, 4], 2)
    assert [results[index] for index in (0, 2, 3, 5)] == [1, 4, 9, 16]
    assert all(isinstance(results[index], Crash) and "died" in results[index].message for index in (1, 4))


def test_an_exception_is_recorded_with_its_words():
    good, bad = run_tasks(square_or_die, [3, -2], 1)
    assert good == 9
    assert bad.message == "ValueError: minus two is not liked"
    assert "square_or_die" in bad.details


def test_engine_chatter_does_not_reach_the_output(capfd):
    assert run_tasks(chatter, [7], 1) == [7]
    assert "chatter" not in capfd.readouterr().out
