"""What a call costs around the kernel, microseconds: planning, `integrate`, a prepared run, one from another state.

    python -m benchmarks.call_cost

All in one process, in turns; the least of all turns, since whatever else runs on the machine only adds to it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem

SCENES = ("single_pendulum", "chain_8", "hinge_pendulum")
METHODS = (("DAE1L_LSE", {"step": 1e-2}), ("rattle2", {"step": 1e-2}), ("rkmk853", {"rtol": 1e-6}),
           ("taylor", {"rtol": 1e-6}))
TURNS, CALLS = 60, 20


def cost(call: Callable[[], object]) -> float:
    """Microseconds of one of `CALLS` calls."""
    begin = time.perf_counter()
    for _ in range(CALLS):
        call()
    return 1e6 * (time.perf_counter() - begin) / CALLS


def row(scene: str, method: str, control: dict[str, float]) -> list[float]:
    """The kernel, and the four calls."""
    p, t = build_problem(crosscheck.load_scene(scene)), np.array([0.0, 1e-2])
    run = lieeuler.prepare(p, method, t_eval=t, monitor=False, **control)
    calls = (lambda: lieeuler.prepare(p, method, t_eval=t, monitor=False, **control),
             lambda: lieeuler.integrate(p, method, t_eval=t, monitor=False, **control), run,
             lambda: run(x=p.x, R=p.R, v=p.v, w=p.w))
    turns = [[1e6 * min(run().stats.wall_time for _ in range(CALLS)), *map(cost, calls)] for _ in range(TURNS)]
    return list(np.min(turns, axis=0))


def main() -> None:
    """Measure and print."""
    print(f"{'us of one step of 10 ms':32}{'kernel':>10}{'plan':>10}{'integrate':>12}{'run()':>10}{'run(x=...)':>12}"
          f"{'around':>10}")
    for scene in SCENES:
        for method, control in METHODS:
            kernel, plan, whole, prepared, given = row(scene, method, control)
            print(f"{scene:18}{method:14}{kernel:10.1f}{plan:10.1f}{whole:12.1f}{prepared:10.1f}{given:12.1f}"
                  f"{prepared - kernel:10.1f}", flush=True)


if __name__ == "__main__":
    main()
