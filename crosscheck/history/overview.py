"""The page of the history: outcomes of every scene and engine over time, and sparklines of the values of every run."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from crosscheck.errors import ArgumentError
from crosscheck.history.changes import change_points
from crosscheck.history.page import heights
from crosscheck.history.store.courses import courses
from crosscheck.history.store.figures import SPEED, Figure
from crosscheck.history.store.runs import EMPTY
from crosscheck.report.overview import SEVERITY

if TYPE_CHECKING:
    from sqlalchemy import Engine

METRICS = ("position error", "energy error", SPEED)
"""Values that the page draws for every run."""

NIGHTS = 60
"""Number of nights on the page."""

WIDTH, HEIGHT = 120, 24
"""Size of a sparkline in SVG units."""


@dataclasses.dataclass(frozen=True)
class Spark:
    """One value of one cell over the nights."""

    points: str  # in the notation of SVG
    marks: list[tuple[float, float]]  # its change points
    last: float
    words: str


@dataclasses.dataclass(frozen=True)
class Bar:
    """The outcomes of a scene and engine in one night."""

    x: float
    worst: str
    words: str


def spark(figures: Sequence[Figure | None]) -> Spark | None:
    """The sparkline of a value; None if no night has it."""
    known = [(index, figure) for index, figure in enumerate(figures) if figure is not None]
    if not known:
        return None
    series = [figure for _, figure in known]
    at = [(round((WIDTH - 8) * index / max(1, len(figures) - 1) + 4, 1), round(HEIGHT - 3 - (HEIGHT - 6) * share, 1))
          for (index, _), share in zip(known, heights([figure.value for figure in series]), strict=True)]
    marks = [at[index] for index in change_points(series)]
    unit = "" if series[0].unit == "1" else f" {series[0].unit}"
    words = f"{series[0].value:.3g} to {series[-1].value:.3g}{unit}"
    if marks:
        words += f", {len(marks)} change{'s' if len(marks) > 1 else ''}"
    return Spark(" ".join(f"{x:g},{y:g}" for x, y in at), marks, series[-1].value, words)


def bars(names: Sequence[str], outcomes: Sequence[Sequence[str | None]]) -> list[Bar]:
    """A bar for each night in which a scene and engine were run. `outcomes` has a list over the nights per cell."""
    found = []
    for index, name in enumerate(names):
        count = Counter(each[index] for each in outcomes)
        made = [outcome for outcome in SEVERITY if count[outcome]]
        if made:
            words = ", ".join(f"{count[outcome]} {outcome}" for outcome in made)
            found.append(Bar(round(WIDTH * index / len(names), 1), made[0], f"{name[:10]}: {words}"))
    return found


def write_history(folder: Path, store: Engine) -> Path:
    """Write the page of the history and the files that it needs into a folder, and return the path of the page.

    Raises `ArgumentError` if the store is empty or the folder cannot be written.
    """
    from crosscheck.report.standalone import write_page

    runs, cells = courses(store, METRICS, NIGHTS)
    if not runs:
        raise ArgumentError(EMPTY)
    groups: dict[tuple[str, str], list[list[str | None]]] = {}
    for key, course in cells.items():
        groups.setdefault(key[:2], []).append(course.outcomes)
    names = [run.name for run in runs]
    rows = [(key[0], course.label, next((each for each in reversed(course.outcomes) if each), ""),
             [spark(course.figures[name]) for name in METRICS]) for key, course in sorted(cells.items())]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_page(
            folder, "history.html.j2", plots=False, runs=runs, scenes=sorted({scene for scene, _ in groups}),
            engines=runs[-1].versions["engine"], metrics=METRICS, rows=rows, width=WIDTH, height=HEIGHT,
            bar=WIDTH / len(runs), cells={pair: bars(names, outcomes) for pair, outcomes in groups.items()})
    except OSError as error:
        raise ArgumentError(f"--out {folder}: {error.strerror or error}; choose another folder") from None
    return folder / "index.html"
