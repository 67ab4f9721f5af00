"""How soon Ctrl-C ends a long run, which carries its trajectory so far.

    python -m benchmarks.interruption --method seulex --bodies 200 [--closed]

Prints the seconds from the signal to the exception, and the samples it carries. Tests read the second number only: the
first one belongs to the machine.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time

import numpy as np

import lieeuler

DELAY = 0.5
"""s, from the start of the run to the signal."""


def long_run(method: str, bodies: int, closed: bool) -> tuple[lieeuler.Problem, dict[str, object]]:
    """A chain on a spring, or with both ends on joints, neither of which comes to rest, and a run that takes hours."""
    from tests.lieeuler.systems import hung_by_both_ends, spring_chain

    control = {"step": 1e-5} if "step" in lieeuler.METHODS[method].controls else {}
    problem = hung_by_both_ends(bodies) if closed else spring_chain(bodies, damping=0.0)
    return problem, {"method": method, "t_eval": np.linspace(0, 1e7, 10_001), "spin_free": False, **control}


def interrupted(problem: lieeuler.Problem, arguments: dict[str, object]) -> tuple[float, lieeuler.Solution]:
    """Seconds from the signal to the exception, and the solution it carries."""
    sent = []

    def send() -> None:
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Timer(DELAY, send).start()
    try:
        lieeuler.integrate(problem, **arguments)  # type: ignore[arg-type]
    except lieeuler.Interrupted as ended:
        return time.perf_counter() - sent[0], ended.solution
    raise RuntimeError("the run ended before the signal")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", choices=sorted(lieeuler.METHODS), default="DAE1L_LSE")
    parser.add_argument("--bodies", type=int, default=1)
    parser.add_argument("--closed", action="store_true", help="both ends of the chain on joints")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts background jobs with it ignored
    seconds, solution = interrupted(*long_run(options.method, options.bodies, options.closed))
    print(f"{options.method}, {options.bodies} bodies: {seconds:.3f} s after the signal, {len(solution.t)} samples, "
          f"run to {solution.t_end:.6g} s: {solution.status.value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
