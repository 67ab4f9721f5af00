"""How soon Ctrl-C ends a long run, which carries its trajectory so far.

    python -m benchmarks.interruption [--method seulex] [--bodies 1024] [--closed] [--interval 0.01] [--repeats 5]

Prints for each method the least and the most seconds from the signal to the exception, and the seconds of computing in
the longest repeat: other work on the machine adds to the former alone. Tests read only the samples: times belong to the
machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import signal
import sys
import threading
import time
from random import Random

import numpy as np

import lieeuler

DELAY = (0.3, 0.8)
"""s, from the start of the run to the signal: it may fall anywhere in a step."""


@dataclasses.dataclass
class Ending:
    """Seconds from the signal to the exception, of the clock and of computing, and the solution it carries."""

    seconds: float
    computing: float
    solution: lieeuler.Solution


def long_run(method: str, bodies: int, closed: bool, interval: float) -> tuple[lieeuler.Problem, dict[str, object]]:
    """A chain on a spring, or with both ends on joints, neither of which comes to rest, and a run that takes hours.

    `interval`: s between samples.
    """
    from tests.lieeuler.systems import hung_by_both_ends, spring_chain

    control = {"step": 1e-5} if "step" in lieeuler.METHODS[method].controls else {}
    problem = hung_by_both_ends(bodies) if closed else spring_chain(bodies, damping=0.0)
    return problem, {"method": method, "t_eval": interval * np.arange(10_001), "spin_free": False, **control}


def interrupted(problem: lieeuler.Problem, arguments: dict[str, object], delay: float) -> Ending:
    """A run that the signal reaches after `delay` s."""
    sent = []

    def send() -> None:
        sent.append((time.perf_counter(), time.process_time()))
        os.kill(os.getpid(), signal.SIGINT)

    threading.Timer(delay, send).start()
    try:
        lieeuler.integrate(problem, **arguments)  # type: ignore[arg-type]
    except lieeuler.Interrupted as ended:
        (clock, computing), = sent
        return Ending(time.perf_counter() - clock, time.process_time() - computing, ended.solution)
    raise RuntimeError("the run ended before the signal")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", choices=sorted(lieeuler.METHODS), help="default: all methods")
    parser.add_argument("--bodies", type=int, default=1)
    parser.add_argument("--closed", action="store_true", help="both ends of the chain on joints")
    parser.add_argument("--interval", type=float, default=1000.0, help="s between samples")
    parser.add_argument("--repeats", type=int, default=1)
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts background jobs with it ignored
    random = Random(0)
    for method in [options.method] if options.method else lieeuler.METHODS:
        run = long_run(method, options.bodies, options.closed, options.interval)
        endings = [interrupted(*run, random.uniform(*DELAY)) for _ in range(options.repeats)]
        longest = max(endings, key=lambda ending: ending.seconds)
        solution = longest.solution
        print(f"{method}, {options.bodies} bodies: {min(ending.seconds for ending in endings):.3f} to "
              f"{longest.seconds:.3f} s after the signal, {longest.computing:.3f} s of computing, {len(solution.t)} "
              f"samples, run to {solution.t_end:.6g} s: {solution.status.value}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
