"""How often the advice of `crosscheck.advise` meets the error, and whether it is the cheapest way.

    python -m benchmarks.advice [--scene NAME ...] [--engine NAME ...] [--limit SECONDS] [--keep FILE]

For every scene, engine and error, makes the advised run and measures its error. Brute force then tries every method of
the engine at numbers of steps that grow by a fifth, and at tolerances a quarter power of ten apart, while a run costs
no more than the advised one. The cheapest that meet the error take turns with the advised run, and the medians are
compared. The ratio is one where the cheapest is the advised run itself. Cells whose advised run takes longer than the
limit are only checked for their error.

`--keep` appends a line of JSON a cell to a file; what the file has is not measured again, and counts in the shares.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

import crosscheck
from crosscheck.document import Advice
from crosscheck.errors import CrosscheckError
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.verification.ladder import GradedWay, ways

ERRORS = (1e-2, 1e-4, 1e-6)
WITHIN, CLEAR = 1.5, 1.2
"""Bound of the ratio of costs, and a ratio at which five turns are enough to know that it is within the bound."""
ROUNDS, AT_MOST, SPAN = 5, 25, 3.0
"""Turns at least and at most; beyond the least, as many as begin within so many s: a busy machine needs more."""


class Cell(msgspec.Struct, frozen=True):
    """The advice for one scene, engine and error (m); all but these is None where the engine has none."""

    scene: str
    engine: str
    wanted: float
    refused: str = ""  # why the engine has no advice at all
    least: float | None = None  # m, the least error of any run
    method: str | None = None
    size: float | None = None  # step (s) or rtol
    error: float | None = None  # m, of the advised run made once more
    ratio: float | None = None  # of its cost to the cheapest's; None if it was not timed

    def __str__(self) -> str:
        head = f"{self.scene} {self.engine} {self.wanted:.0e}: "
        if self.method is None:
            return head + (self.refused or f"no method, least {self.least}")
        over = "not timed" if self.ratio is None else f"{self.ratio:.2f} of the cheapest"
        return head + f"{self.method} {self.size:.3g}, error {self.error:.1e}, {over}"


def error_of(scene: Scene, traj: Trajectory) -> float:
    """Largest |component of x - truth| (m) at the samples where truth is comparable."""
    truth = crosscheck.truth(scene)
    keep = truth.t <= truth.horizon * (1 + 1e-12)
    return float(np.abs(traj.x[keep] - truth.states.x[keep]).max())


def sizes(scene: Scene, way: GradedWay) -> Iterator[dict[str, float]]:
    """Arguments of ever finer runs."""
    if way.adaptive:
        yield from ({"rtol": 10.0 ** (-quarter / 4)} for quarter in range(4, 57))
        return
    interval, count = scene.duration / (scene.samples - 1), 1.0
    while True:
        yield {"step": interval / round(count)}
        count = max(count + 1, 1.2 * count)


def rivals(scene: Scene, engine: str, found: Sequence[Advice]) -> list[list[tuple[str, dict[str, float], float]]]:
    """(method, step or rtol, s) of runs no dearer than the advised one that meet its error, for every advice."""
    better: list[list[tuple[str, dict[str, float], float]]] = [[] for _ in found]
    for way in ways(scene, [engine], default_form=True)[0]:
        failed, dear = 0, [0] * len(found)
        for size in sizes(scene, way):
            try:
                traj = crosscheck.run(scene, engine, way.method, monitor=False, **size)
            except Exception:  # a run that fails meets no error
                failed += 1
                if failed > 25:
                    break
                continue
            error = error_of(scene, traj)
            for k, advice in enumerate(found):
                if dear[k] < 2 and error <= advice.wanted:
                    better[k].append((way.method, size, traj.wall_time))
                    dear[k] = 2  # finer runs of this method cost more
                dear[k] += traj.wall_time > (advice.cost or 0.0)
            if min(dear) > 1:
                break
    return [sorted(each, key=lambda one: one[2])[:3] for each in better]


def ratio(scene: Scene, found: Advice, others: Sequence[tuple[str, dict[str, float], float]]) -> float:
    """Cost of the advised run over that of the cheapest of brute force, medians of turns."""
    assert found.method is not None
    mine = {"step": found.step} if found.step else {"rtol": found.rtol}
    # A rival that is the advised run itself would show only the noise of the clock.
    runs = [(found.method, mine), *((method, size) for method, size, _ in others
                                    if method != found.method or not math.isclose(*size.values(), *mine.values()))]
    if len(runs) == 1:
        return 1.0
    times: list[list[float]] = [[] for _ in runs]
    began, over = time.perf_counter(), math.inf
    for turn in range(AT_MOST):
        if turn >= ROUNDS and (over < CLEAR or time.perf_counter() > began + SPAN):
            break
        for own, (method, size) in zip(times, runs, strict=True):
            own.append(min(crosscheck.run(scene, found.engine, method, monitor=False, **size).wall_time
                           for _ in range(3)))
        medians = [statistics.median(own) for own in times]
        over = medians[0] / min(medians)
    return over


def cells(name: str, engine: str, limit: float) -> Iterator[Cell]:
    """One scene and engine at every error."""
    scene, advised = crosscheck.load_scene(name), []
    for wanted in ERRORS:
        try:
            found = crosscheck.advise(scene, engine=engine, error=wanted)
        except CrosscheckError as reason:
            yield Cell(name, engine, wanted, refused=" ".join(str(reason).split())[:100])
            continue
        if found.method is None:
            yield Cell(name, engine, wanted, least=found.least)
        else:
            advised.append(found)
    timed = [found for found in advised if (found.cost or 0.0) <= limit]
    others = rivals(scene, engine, timed) if timed else []
    for found in advised:
        assert found.method is not None
        traj = crosscheck.run(scene, engine, found.method, step=found.step, rtol=found.rtol)
        over = next((ratio(scene, found, own) for one, own in zip(timed, others, strict=True) if one is found), None)
        yield Cell(name, engine, found.wanted, "", found.least, found.method, found.step or found.rtol,
                   error_of(scene, traj), over)


def main() -> None:
    """Print a line a cell and the shares."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scene", action="append")
    parser.add_argument("--engine", action="append")
    parser.add_argument("--limit", type=float, default=1.0, help="s of the advised run")
    parser.add_argument("--keep", type=Path, help="file of the cells, a line of JSON each")
    given = parser.parse_args()
    kept = given.keep.read_bytes().splitlines() if given.keep and given.keep.exists() else ()
    found = [msgspec.json.decode(line, type=Cell) for line in kept]
    had = {(cell.scene, cell.engine) for cell in found}
    for name in given.scene or crosscheck.scenes():
        for engine in given.engine or crosscheck.engines():
            if (name, engine) in had:
                continue
            made = list(cells(name, engine, given.limit))
            found += made
            print(*made, sep="\n", flush=True)
            if given.keep:
                with given.keep.open("ab") as out:
                    out.writelines(msgspec.json.encode(cell) + b"\n" for cell in made)
    told = [cell for cell in found if cell.method is not None]
    timed = [cell for cell in told if cell.ratio is not None]
    print(f"error met: {sum((cell.error or math.inf) <= cell.wanted for cell in told)} of {len(told)} advised; "
          f"cost within {WITHIN} of the cheapest: {sum((cell.ratio or 0.0) <= WITHIN for cell in timed)} of "
          f"{len(timed)} timed; no method: {sum(not cell.refused for cell in found) - len(told)}; "
          f"refused: {sum(bool(cell.refused) for cell in found)}")


if __name__ == "__main__":
    main()
