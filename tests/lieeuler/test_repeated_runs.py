"""Runs repeated, side by side and interrupted: the same bits, the same memory, the trajectory so far."""

from __future__ import annotations

import concurrent.futures
import gc
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import lieeuler
from tests import ROOT
from tests.lieeuler.accuracy import FIELDS
from tests.lieeuler.systems import SYSTEMS, spring_chain

EULER, RATTLE, RKMK, SEULEX, TAYLOR = "DAE1L_LSE", "rattle4", "rkmk853", "seulex", "taylor"


def run(problem, method, t_end=0.2):
    control = {"step": 1e-3} if "step" in lieeuler.METHODS[method].controls else {}
    return lieeuler.integrate(problem, method, t_eval=np.linspace(0, t_end, 5), **control)


@pytest.mark.parametrize("method", sorted(lieeuler.METHODS))
def test_one_problem_in_four_threads_gives_the_bits_of_one(method):
    problem = SYSTEMS["double_pendulum"]()
    alone = run(problem, method)
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda _: run(problem, method), range(8)))
    for solution in together:
        assert all(np.array_equal(getattr(solution, name), getattr(alone, name)) for name in FIELDS)
        assert solution.stats.maxima == alone.stats.maxima


@pytest.mark.parametrize("method", [EULER, RATTLE, RKMK, TAYLOR])
def test_springs_and_spin_free_frames_share_nothing(method):
    problems = [SYSTEMS["heavy_top"](), spring_chain(3)]
    alone = [run(problem, method, 0.02) for problem in problems]
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda k: run(problems[k % 2], method, 0.02), range(8)))
    for k, solution in enumerate(together):
        assert all(np.array_equal(getattr(solution, name), getattr(alone[k % 2], name)) for name in FIELDS)


def resident() -> int:
    """Bytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def grown(runs: int) -> int:
    """Bytes by which memory grows over so many short runs, failed ones and refused ones among them."""
    methods = sorted(lieeuler.METHODS)

    def one(k: int) -> None:
        problem = SYSTEMS[("single_pendulum", "double_pendulum")[k % 2]]()
        run(problem, methods[k % len(methods)], 4e-3)
        if k % 10 == 0:
            with pytest.raises(lieeuler.IntegrationError):
                lieeuler.integrate(SYSTEMS["heavy_top"](), "DAE1L_LSE", 0.1, [0, 1.0])
            with pytest.raises(lieeuler.ArgumentError):
                lieeuler.integrate(problem, "DAE1L_LSE", -1.0, [0, 1.0])

    for k in range(5 * len(methods)):
        one(k)
    gc.collect()
    before = resident()
    for k in range(runs):
        one(k)
    gc.collect()
    return resident() - before


# A run here samples five states of two bodies: 1.4 kB, and its stepper holds ten times that. If one in ten runs lost
# its samples or anything larger, 1e4 runs would grow by more than a megabyte; an allocator's own pools grow by less
# than the bound, and no further.
POOLS = 1_000_000


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")
@pytest.mark.parametrize("runs", [1000, 10_000])
def test_memory_does_not_grow(runs):
    assert grown(runs) < POOLS


SINGLE, LARGE, CLOSED = ("--bodies=1",), ("--bodies=200",), ("--bodies=40", "--closed")


@pytest.mark.parametrize(("method", "system"), [
    (EULER, SINGLE), (RATTLE, LARGE), (RKMK, SINGLE), (SEULEX, LARGE), (TAYLOR, LARGE), (EULER, CLOSED),
], ids=str)
def test_ctrl_c_carries_the_trajectory_so_far(method, system):
    watchdog = 120  # s; a run that ignored the interruption would take hours
    done = subprocess.run([sys.executable, "-m", "benchmarks.interruption", f"--method={method}", *system],
                          capture_output=True, text=True, timeout=watchdog, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert int(re.search(r"(\d+) samples", done.stdout)[1]) >= 1
    assert done.stdout.endswith("interrupted\n")


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="needs SIGALRM")
def test_what_a_handler_of_the_users_own_raises_comes_through():
    class Late(Exception):
        pass

    def ring(*_):
        raise Late

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, 0.3)
    try:
        with pytest.raises(Late):
            lieeuler.integrate(SYSTEMS["double_pendulum"](), EULER, 1e-6, np.linspace(0, 1000, 1001))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("method", sorted(name for name, m in lieeuler.METHODS.items() if "step" in m.controls))
def test_a_run_that_overflows_ends_long_before_its_next_sample(method):
    body, spring = lieeuler.Body(1.0, np.eye(3)), lieeuler.LinearSpring(-1, 0, np.zeros(3), np.zeros(3), 1e90, 0.0)
    pulled = lieeuler.Problem([body], [], np.zeros(3), [[1.0, 0, 0]], [np.eye(3)], np.zeros((1, 3)), np.zeros((1, 3)),
                              (spring,))
    with pytest.raises(lieeuler.IntegrationError) as ended:
        lieeuler.integrate(pulled, method, 0.1, [0, 1e9])  # 1e10 steps
    assert len(ended.value.solution.t) == 1
    assert ended.value.solution.stats.steps < 10_000


def test_more_steps_between_two_samples_than_a_32_bit_number_holds():
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(lieeuler.Interrupted):
        lieeuler.integrate(SYSTEMS["single_pendulum"](), EULER, 1e-9, [0, 10.0])  # 1e10 steps
