"""Times of runs on a machine that others use: undisturbed tries, turns, and a calibration kernel.

A busy or slow machine slows down a fixed piece of work as much as a run. A try is repeated if the process had to wait
for the processor, and what is compared takes turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import TypeVar

from crosscheck.errors import CrosscheckError

CALIBRATION = "40 times the LU solutions of 20 dense systems of 6 equations (numpy.linalg.solve)"
"""The calibration kernel: compiled loops over small matrices, as in a multibody step, without any engine's code. The
few matrices stay in the innermost cache, as the data of a step does. With 800 matrices at once, the ratio of a method
varied twice as much between processes on a loaded machine."""

TRIES, PATIENCE = 3, 12
"""The fastest of TRIES undisturbed tries counts, out of at most PATIENCE tries."""

LONG = 0.01
"""After this time (s, with the building of models) one undisturbed try is enough, as long runs average noise out."""

WAITED = 0.03
"""Largest share of waiting in an undisturbed try."""

Key = TypeVar("Key", bound=Hashable)
Found = TypeVar("Found")


def undisturbed(once: Callable[[], float], most: int = PATIENCE, long: float = LONG) -> tuple[float, float]:
    """The seconds that `once` returns and the other seconds that it took, in the fastest undisturbed try.

    Ends after TRIES undisturbed tries, after `most` tries in all, or after an undisturbed one when `long` (s) is over.
    """
    clean: list[tuple[float, float]] = []
    others: list[tuple[float, float]] = []
    began = time.perf_counter()
    while len(clean) < TRIES and len(clean) + len(others) < most:
        if clean and time.perf_counter() - began > long:
            break
        start, worked = time.perf_counter(), time.process_time()
        seconds = once()
        took = time.perf_counter() - start
        waited = took - (time.process_time() - worked)
        (clean if waited <= WAITED * seconds + 1e-5 else others).append((seconds, took - seconds))
    return min(clean or others)


def take_turns(runs: Mapping[Key, Callable[[], Found]], rounds: int) -> Iterator[tuple[Key, Found | CrosscheckError]]:
    """The key of a run and what it gives, in turns; one that fails gives its error once."""
    left = dict(runs)
    for _ in range(rounds):
        for key, run in list(left.items()):
            try:
                found = run()
            except CrosscheckError as error:
                del left[key]
                yield key, error
                continue
            yield key, found


def calibration_kernel() -> Callable[[], float]:
    """A function that does the fixed work and returns its time (s) in an undisturbed try."""
    import numpy as np

    generator = np.random.default_rng(6)
    # Diagonally dominant matrices, so that pivoting is the same on all machines.
    matrices = generator.uniform(-1.0, 1.0, (20, 6, 6)) + 6.0 * np.eye(6)
    right = generator.uniform(-1.0, 1.0, (20, 6, 1))

    def once() -> float:
        start = time.perf_counter()
        for _ in range(40):
            np.linalg.solve(matrices, right)
        return time.perf_counter() - start

    return lambda: undisturbed(once)[0]
