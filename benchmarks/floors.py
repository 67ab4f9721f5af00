"""What rounding leaves of each scene, beside the errors of lieeuler's most accurate methods.

    python -m benchmarks.floors [SCENE ...]

The floor is eps times the growth of the worst small perturbation between any two times (`crosscheck truth --floor`).
Errors are those of x over the scene's length and of R, against truth, at the smallest rtol. Chaotic scenes are compared
only as far as truth reaches.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.references import Chaotic, conditioning
from crosscheck.references.base import scene_length
from crosscheck.scene.model import Scene

METHODS = ("taylor", "rkmk853")
RTOL = 1e-14


def row(scene: Scene) -> str:
    """A line of the table."""
    try:
        truth = crosscheck.truth(scene)
    except Chaotic as error:
        scene = scene.replace(duration=0.9 * error.horizon)
        truth = crosscheck.truth(scene)
    floor, when = conditioning.floor(scene)
    words = [f"{scene.name:22}{scene.duration:6.3g} s{floor:10.1e} at {when:<8.3g}"]
    for method in METHODS:
        try:
            run = lieeuler.integrate(build_problem(scene), method, None, scene.t, rtol=RTOL, monitor=False)
        except lieeuler.IntegrationError as error:
            words.append(f"{method} {error.status.value}")
            continue
        left = max(np.abs(run.x - truth.states.x).max() / scene_length(scene), np.abs(run.R - truth.states.R).max())
        words.append(f"{method}{left:10.1e} ={left / floor:6.1f} floors")
    return "  ".join(words)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    for name in (sys.argv[1:] if argv is None else argv) or crosscheck.scenes():
        print(row(crosscheck.load_scene(name)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
