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


SEEDS = {"coefficient": wrong_coefficient, "version": other_version, "slower": slower}

for _name in filter(None, os.environ.get("CROSSCHECK_TEST_SEED", "").split(",")):
    SEEDS[_name]()
