"""How often the advice of `crosscheck.advise` meets the error, and whether it is the cheapest way.

    python -m benchmarks.advice [--scene NAME ...] [--engine NAME ...] [--limit SECONDS]

For every scene, engine and error, makes the advised run and measures its error. Brute force then tries every method of
the engine at numbers of steps that grow by a fifth, and at tolerances a quarter power of ten apart, while a run costs
no more than the advised one. The cheapest that meet the error take turns with the advised run, and the medians are
compared. The ratio is one where the cheapest is the advised run itself. Cells whose advised run takes longer than the
limit are only checked for their error.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Iterator

import numpy as np

import crosscheck
from crosscheck.document import Advice
from crosscheck.errors import CrosscheckError
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.verification.ladder import Way, ways

ERRORS = (1e-2, 1e-4, 1e-6)
WITHIN = 1.5
ROUNDS, AT_MOST, SPAN = 5, 25, 3.0
"""Turns at least and at most; beyond the least, as many as begin within so many s: a busy machine needs more."""


def error_of(scene: Scene, traj: Trajectory) -> float:
    """Largest |component of x - truth| (m) at the samples where truth is comparable."""
    truth = crosscheck.truth(scene)
    keep = truth.t <= truth.horizon * (1 + 1e-12)
    return float(np.abs(traj.x[keep] - truth.states.x[keep]).max())


def sizes(scene: Scene, way: Way) -> Iterator[dict[str, float]]:
    """Arguments of ever finer runs."""
    if way.adaptive:
        yield from ({"rtol": 10.0 ** (-quarter / 4)} for quarter in range(4, 57))
        return
    interval, count = scene.duration / (scene.samples - 1), 1.0
    while True:
        yield {"step": interval / round(count)}
        count = max(count + 1, 1.2 * count)


def rivals(scene: Scene, engine: str, found: Advice) -> list[tuple[str, dict[str, float], float]]:
    """(method, step or rtol, s) of runs no dearer than the advised one that meet its error."""
    better = []
    for way in ways(scene, [engine], default_form=True)[0]:
        dear = failed = 0
        for size in sizes(scene, way):
            try:
                traj = crosscheck.run(scene, engine, way.method, monitor=False, **size)
            except Exception:  # a run that fails meets no error
                failed += 1
                if failed > 25:
                    break
                continue
            if error_of(scene, traj) <= found.wanted:
                better.append((way.method, size, traj.wall_time))
                break
            dear += traj.wall_time > (found.cost or 0.0)
            if dear > 1:
                break
    return sorted(better, key=lambda each: each[2])[:3]


def ratio(scene: Scene, engine: str, found: Advice) -> float:
    """Cost of the advised run over that of the cheapest of brute force, medians of turns."""
    mine = {"step": found.step} if found.step else {"rtol": found.rtol}
    # A rival that is the advised run itself would show only the noise of the clock.
    runs = [(found.method, mine), *((method, size) for method, size, _ in rivals(scene, engine, found)
                                    if method != found.method or not math.isclose(*size.values(), *mine.values()))]
    if len(runs) == 1:
        return 1.0
    times: list[list[float]] = [[] for _ in runs]
    began = time.perf_counter()
    for turn in range(AT_MOST):
        if turn >= ROUNDS and time.perf_counter() > began + SPAN:
            break
        for own, (method, size) in zip(times, runs, strict=True):
            own.append(min(crosscheck.run(scene, engine, method, monitor=False, **size).wall_time for _ in range(3)))
    medians = [statistics.median(own) for own in times]
    return medians[0] / min(medians)


def main() -> None:
    """Print a line a cell and the shares."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scene", action="append")
    parser.add_argument("--engine", action="append")
    parser.add_argument("--limit", type=float, default=1.0, help="s of the advised run")
    given = parser.parse_args()
    met, told, cheap, timed, none = 0, 0, 0, 0, 0
    for name in given.scene or crosscheck.scenes():
        scene = crosscheck.load_scene(name)
        for engine in given.engine or crosscheck.engines():
            for error in ERRORS:
                try:
                    found = crosscheck.advise(scene, engine=engine, error=error)
                except CrosscheckError as reason:
                    print(f"{name} {engine}: {' '.join(str(reason).split())[:100]}", flush=True)
                    break
                if found.method is None:
                    none += 1
                    print(f"{name} {engine} {error:.0e}: no method, least {found.least}", flush=True)
                    continue
                traj = crosscheck.run(scene, engine, found.method, step=found.step, rtol=found.rtol)
                told, met = told + 1, met + (error_of(scene, traj) <= error)
                text = f"{name} {engine} {error:.0e}: {found.method} {found.step or found.rtol:.3g}, error " \
                       f"{error_of(scene, traj):.1e}"
                if (found.cost or 0.0) <= given.limit:
                    over = ratio(scene, engine, found)
                    timed, cheap = timed + 1, cheap + (over <= WITHIN)
                    text += f", {over:.2f} of the cheapest"
                print(text, flush=True)
    print(f"error met: {met} of {told} advised; cost within {WITHIN} of the cheapest: {cheap} of {timed} timed; "
          f"no method: {none}")


if __name__ == "__main__":
    main()
