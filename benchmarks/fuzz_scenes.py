"""Many broken scene files against the loader: each must be a scene or one crosscheck.SceneError.

    python -m benchmarks.fuzz_scenes --count 1000000 [--seed 0] [--seconds 180]

Prints how many loaded and how many were refused. The first file that breaks the rule is kept in the working directory,
named with its seed, and the run ends with status 1.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from random import Random

from crosscheck.errors import SceneError
from crosscheck.scene_file import load_scene
from tests.scene_mutations import scene_file


def fuzz(count: int, seed: int, seconds: float, folder: Path) -> tuple[Counter[str], Path | None]:
    """Numbers of files loaded and refused; and the first that was answered by anything else."""
    answers: Counter[str] = Counter()
    end = time.monotonic() + seconds
    for number in range(seed, seed + count):
        suffix, content = scene_file(Random(number))
        path = folder / f"scene{suffix}"
        path.write_bytes(content)
        try:
            answers[_answer(path)] += 1
        except BaseException:  # the finding itself, whatever it is
            traceback.print_exc()
            found = Path(f"fuzzed_{number}{suffix}")
            found.write_bytes(content)
            return answers, found
        if time.monotonic() > end:
            break
    return answers, None


def _answer(path: Path) -> str:
    try:
        load_scene(path)
    except SceneError as error:
        str(error).encode()  # else it could not be printed
        return "refused"
    return "loaded"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="of the first file; the next has the next number")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end earlier")
    options = parser.parse_args()
    warnings.simplefilter("error", RuntimeWarning)
    with tempfile.TemporaryDirectory() as folder:
        answers, found = fuzz(options.count, options.seed, options.seconds, Path(folder))
    print(f"{answers.total()} files: {answers['loaded']} scenes, {answers['refused']} refused with a SceneError, "
          f"{'one finding, ' + str(found) if found else 'no finding'}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
