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


def wait(seconds):
    """Takes so much time of the processor."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def slower():
    """Every run of lieeuler takes 30 % longer: it waits busily for as long, in its own time."""
    import lieeuler

    real = lieeuler.integrate

    def integrate(*words, **options):
        solution = real(*words, **options)
        more = 0.3 * solution.stats.wall_time
        wait(more)
        stats = dataclasses.replace(solution.stats, wall_time=solution.stats.wall_time + more)
        return dataclasses.replace(solution, stats=stats)

    lieeuler.integrate = integrate


def clock():
    """Times are drawn: each step of a method takes the same time, on a machine whose pace and load vary.

    Between two calibrations its pace changes by up to a factor 2; a run varies by 3 %, and every third waits for the
    processor for half its time. The clock of the measurement passes by these times alone. The engine of a user has a
    process of its own, so that what both have to know is in a file: its size is the number of calibrations so far.
    """
    import types
    from pathlib import Path

    import numpy as np

    import lieeuler
    from crosscheck.adapters.external import own
    from crosscheck.compare import timing
    from crosscheck.verification import speed

    real, counter = lieeuler.integrate, Path(os.environ["CROSSCHECK_TEST_CALIBRATIONS"])
    now = {"wall": 0.0, "processor": 0.0, "calibrations": -1}

    def work(seconds, who):
        """Passes so many seconds of an even machine, and returns those of this one."""
        calibrations = counter.stat().st_size if counter.exists() else 0
        if calibrations != now["calibrations"]:
            now["calibrations"], now["noise"] = calibrations, np.random.default_rng([calibrations, who])
        pace = np.random.default_rng(calibrations).uniform(1.0, 2.0)
        taken = seconds * pace * (1.0 + 0.03 * now["noise"].standard_normal())
        waited = 0.5 * taken * (now["noise"].random() < 1 / 3)
        now["wall"] += taken + waited
        now["processor"] += taken
        return taken + waited

    def passing(seconds):
        now["wall"] += seconds
        now["processor"] += seconds

    def kernel():
        """The calibration kernel of a process."""
        with counter.open("ab") as file:
            file.write(b".")
        return lambda: timing.undisturbed(lambda: work(1e-3, 0))[0]

    def integrate(problem, method, *words, **options):
        solution = real(problem, method, *words, **options)
        wall = work((1e-6 + 1e-7 * (sum(map(ord, str(method))) % 7)) * solution.stats.steps, 1)
        return dataclasses.replace(solution, stats=dataclasses.replace(solution.stats, wall_time=wall))

    lieeuler.integrate, speed.calibration_kernel = integrate, kernel
    globals()["wait"] = passing
    own.time = timing.time = speed.time = types.SimpleNamespace(perf_counter=lambda: now["wall"],
                                                  process_time=lambda: now["processor"])


SEEDS = {"clock": clock, "coefficient": wrong_coefficient, "version": other_version, "slower": slower}

for _name in filter(None, os.environ.get("CROSSCHECK_TEST_SEED", "").split(",")):
    SEEDS[_name]()
