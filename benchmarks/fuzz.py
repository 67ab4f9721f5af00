"""Many odd inputs against the scene loader, the kernel's entry points, or the kernel with random mechanisms.

    python -m benchmarks.fuzz scenes --count 1000000 [--seed 0] [--seconds 180]
    python -m benchmarks.fuzz kernel --count 100000        # good problems, a few arguments changed
    python -m benchmarks.fuzz mechanisms --count 100000    # random trees and loops, all joints, absurd steps and masses

A scene file must be a scene or one `crosscheck.SceneError`. A call of the kernel must be refused by an
`lieeuler.ArgumentError`, end with a named status, finish, or be interrupted, and give finite numbers alone; what ends
in success must be closed. Prints how many of each; the first input that breaks the rule is named by its number, and the
run ends with status 1.
"""

from __future__ import annotations

import argparse
import faulthandler
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random

PATIENCE = 0.2
"""s, for one call of the kernel."""


def fuzz(answer: Callable[[Random], str], count: int, seed: int, seconds: float) -> tuple[Counter[str], int | None]:
    """How many of each answer there were, and the first input with any other answer; None if there was none."""
    answers: Counter[str] = Counter()
    end = time.monotonic() + seconds
    for number in range(seed, seed + count):
        try:
            answers[answer(Random(number))] += 1
        except BaseException:  # any exception is a finding
            traceback.print_exc()
            return answers, number
        if time.monotonic() > end:
            break
    return answers, None


def scene_answer(folder: Path) -> Callable[[Random], str]:
    """What the loader answers to a file."""
    from tests.scene_mutations import judged, scene_file

    def answer(random: Random) -> str:
        return "refused" if judged(folder, *scene_file(random)) is None else "loaded"

    return answer


def kernel_answer() -> Callable[[Random], str]:
    """What the kernel answers to a call."""
    from tests.kernel_mutations import case, judged

    def answer(random: Random) -> str:
        make, options = case(random)
        solution = judged(make, **options)
        return "refused" if solution is None else solution.status.value

    return answer


def patiently(answer: Callable[[Random], str]) -> Callable[[Random], str]:
    """The answer, or that it took too long to wait for."""
    from tests.kernel_mutations import patience

    def asked(random: Random) -> str:
        with patience(PATIENCE):
            return answer(random)
        return "interrupted"

    return asked


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=("scenes", "kernel", "mechanisms"))
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="of the first input; the next has the next number")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end earlier")
    options = parser.parse_args()
    faulthandler.enable()
    warnings.simplefilter("error", RuntimeWarning)
    with tempfile.TemporaryDirectory() as folder:
        if options.target == "scenes":
            answer = scene_answer(Path(folder))
        elif options.target == "kernel":
            answer = patiently(kernel_answer())
        else:
            from tests.random_mechanisms import answer as mechanism_answer
            answer = patiently(mechanism_answer)
        answers, found = fuzz(answer, options.count, options.seed, options.seconds)
    print(f"{options.target}, inputs {options.seed} to {options.seed + answers.total() - 1}: "
          f"{', '.join(f'{count} {name}' for name, count in sorted(answers.items()))}; "
          f"{'no finding' if found is None else f'finding at {found}'}", flush=True)
    return 0 if found is None else 1


if __name__ == "__main__":
    sys.exit(main())
