"""Seeded regressions: put this folder on PYTHONPATH and name them in CROSSCHECK_TEST_SEED, separated by commas.

Worker processes load it like every Python does, so that a seed reaches the engine wherever it runs.
"""

import dataclasses
import importlib.metadata
import os
import time


def wrong_coefficient():
    """rattle4 with a digit of Suzuki's weight misread, 0.4154 for 0.4145; the middle weight follows as published."""
    import lieeuler

    weight = 0.4154
    lieeuler.METHODS["rattle4"].composition = (weight, weight, 1 - 4 * weight, weight, weight)


def other_version():
    """lieeuler says that it is another version."""
    real = importlib.metadata.version
    importlib.metadata.version = lambda name: "0.1.1" if name == "lieeuler-crosscheck" else real(name)


def slower():
    """Every run of lieeuler takes 30 % longer: it waits busily for as long, in its own time."""
    import lieeuler

    real = lieeuler.integrate

    def integrate(*words, **options):
        solution = real(*words, **options)
        more = 0.3 * solution.stats.wall_time
        end = time.perf_counter() + more
        while time.perf_counter() < end:
            pass
        stats = dataclasses.replace(solution.stats, wall_time=solution.stats.wall_time + more)
        return dataclasses.replace(solution, stats=stats)

    lieeuler.integrate = integrate


def clock():
    """Times are drawn: each step of a method takes the same time, on a machine whose pace and load vary by process.

    A process is twice as fast as another, a run varies by 3 %, and every third waits for the processor for half its
    time. The clocks of the measurement advance by these times alone, so that nothing depends on the machine.
    """
    import types
    from pathlib import Path

    import numpy as np

    import lieeuler
    from crosscheck.verification import speed

    real, clocks = lieeuler.integrate, [0.0, 0.0]  # of the wall and of the processor, s
    state = {"rng": np.random.default_rng(0), "pace": 1.0}

    def work(seconds):
        """Passes so many seconds of an even machine, and returns those of this one."""
        taken = seconds * state["pace"] * (1.0 + 0.03 * state["rng"].standard_normal())
        waited = taken * 0.5 * (state["rng"].random() < 1 / 3)
        clocks[0] += taken + waited
        clocks[1] += taken
        return taken + waited

    def kernel():
        """The calibration kernel of a process, which has a pace of its own."""
        counter = Path(os.environ["CROSSCHECK_TEST_PROCESSES"])
        with counter.open("ab") as file:
            file.write(b".")
        state["rng"] = np.random.default_rng(counter.stat().st_size)
        state["pace"] = state["rng"].uniform(1.0, 2.0)
        return lambda: speed.undisturbed(lambda: work(1e-3))[0]

    def integrate(problem, method, *words, **options):
        solution = real(problem, method, *words, **options)
        wall = work((1e-6 + 1e-7 * (sum(map(ord, str(method))) % 7)) * solution.stats.steps)
        return dataclasses.replace(solution, stats=dataclasses.replace(solution.stats, wall_time=wall))

    lieeuler.integrate, speed.calibration_kernel = integrate, kernel
    speed.time = types.SimpleNamespace(perf_counter=lambda: clocks[0], process_time=lambda: clocks[1])


SEEDS = {"clock": clock, "coefficient": wrong_coefficient, "version": other_version, "slower": slower}

for _name in filter(None, os.environ.get("CROSSCHECK_TEST_SEED", "").split(",")):
    SEEDS[_name]()
