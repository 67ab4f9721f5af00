"""Prints as JSON how often a run of some steps allocates memory, and one of four times as many, method by method.

For a process of its own, with the library of `tests/core/count_allocations.cpp` in LD_PRELOAD.
"""

from __future__ import annotations

import ctypes
import json

import lieeuler
from tests.lieeuler.systems import SYSTEMS, hung_by_both_ends, spring_chain

COUNTER = ctypes.CDLL(None).allocations
COUNTER.restype = ctypes.c_long
PROBLEMS = {**{name: make() for name, make in SYSTEMS.items()}, "spring_chain_20": spring_chain(20),
            "both_ends_4": hung_by_both_ends(4)}


def counted(name: str, method: str, lengths: int) -> tuple[int, int]:
    """(allocations, steps) of a run over so many lengths."""
    if "step" in lieeuler.METHODS[method].controls:
        control = {"step": 2e-5 if name == "heavy_top" else 1e-3}
        length = 50 * control["step"]
    else:  # long enough for seulex, which needs some steps until it has allocated everything
        control, length = {"rtol": 1e-8}, 0.5 if name in ("heavy_top", "spring_chain_20") else 2.0
    times = [0.0, lengths * length]
    before = COUNTER()
    solution = lieeuler.integrate(PROBLEMS[name], method, t_eval=times, **control)
    return COUNTER() - before, solution.stats.steps


def main() -> None:
    found = {}
    for name in PROBLEMS:
        for method in lieeuler.METHODS:
            counted(name, method, 1)  # Python's own memory grows at first
            found[f"{name} {method}"] = [min(counted(name, method, lengths) for _ in range(2)) for lengths in (1, 4)]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
