"""The pages of the history: one value over the nights, or all outcomes and sparklines of the values of every run."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import sqlalchemy as sql

from crosscheck.errors import ArgumentError
from crosscheck.history.changes import change_points, heights, scaled, spans_decades
from crosscheck.history.figures import SPEED, Figure
from crosscheck.history.runs import EMPTY, CellKey, StoredRun, load, recent
from crosscheck.report.overview import SEVERITY
from crosscheck.report.standalone import one_file, page_of

WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 900, 360, 80, 30, 320
"""Size of the plot and position of its axes in SVG units."""


def write_trend(path: Path, series: Sequence[tuple[StoredRun, Figure]], scene: str, engine: str, label: str) -> None:
    """Write the page of a series, which must not be empty. `label` is engine and method. An old file is replaced."""
    figures = [figure for _, figure in series]
    values = [figure.value for figure in figures]
    logarithmic = spans_decades(values)
    shown = [scaled(value, logarithmic) for value in values]
    margin = 0.1 * (max(shown) - min(shown)) or 0.1 * abs(max(shown)) or 1.0
    low, high = min(shown) - margin, max(shown) + margin

    def y(value: float) -> float:
        share = (scaled(value, logarithmic) - low) / (high - low)
        return round(BOTTOM - (BOTTOM - TOP) * min(1.0, max(0.0, share)), 1)

    changed = set(change_points(figures))
    points = []
    for index, (run, figure) in enumerate(series):
        spread = figure.deviation
        points.append({
            "x": round(LEFT + 10 + (WIDTH - LEFT - 30) * (index / max(1, len(series) - 1)), 1), "y": y(figure.value),
            "low": None if spread is None else y(figure.value - spread),
            "high": None if spread is None else y(figure.value + spread), "changed": index in changed,
            "name": run.name, "started": run.started, "commit": run.environment.commit,
            "version": run.versions["engine"].get(engine), "text": f"{figure.value:.4g}",
            "deviation": "" if spread is None else f"{spread:.2g}"})
    levels = [low + (high - low) * share / 4 for share in range(5)]
    ticks = [{"y": round(BOTTOM - (BOTTOM - TOP) * share / 4, 1),
              "text": f"{10**level if logarithmic else level:.3g}"} for share, level in enumerate(levels)]
    try:
        one_file(
            path, "trend.html.j2", metric=figures[0].name, unit=figures[0].unit, scene=scene, engine=engine,
            label=label, points=points, changes=[point for point in points if point["changed"]], ticks=ticks,
            width=WIDTH, height=HEIGHT, left=LEFT, logarithmic=logarithmic,
            has_spread=any(figure.deviation is not None for figure in figures),
            judged=figures[0].name == SPEED or any(figure.rounding is not None for figure in figures))
    except OSError as error:
        raise ArgumentError(f"--page {path}: {error.strerror or error}; choose another place") from None


COLUMNS = ("position error", "energy error", SPEED)
"""Values that the page draws for every run."""

NIGHTS = 60
"""Number of nights on the page."""

ACROSS, TALL = 120, 24
"""Size of a sparkline in SVG units."""


@dataclasses.dataclass(frozen=True)
class CellHistory:
    """One cell over the runs. An entry is None if that run lacks the cell or the value."""

    label: str
    outcomes: list[str | None]
    figures: dict[str, list[Figure | None]]


def histories(store: sql.Engine, metrics: Sequence[str], limit: int
              ) -> tuple[list[StoredRun], dict[CellKey, CellHistory]]:
    """The last runs with the profile of the newest one, the oldest first, and the history of every cell."""
    everything = recent(store, 10 * limit)
    names = [run.name for run in everything if run.profile == everything[0].profile][:limit]
    runs = [load(store, name) for name in reversed(names)]
    by_cell: dict[CellKey, CellHistory] = {}
    for index, run in enumerate(runs):
        for key, result in run.results.items():
            cell = by_cell.setdefault(key, CellHistory(result.label, [None] * len(runs),
                                                       {name: [None] * len(runs) for name in metrics}))
            cell.outcomes[index] = result.outcome
            for name in metrics:
                cell.figures[name][index] = result.figures.get(name)
    return runs, by_cell


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
    at = [(round((ACROSS - 8) * index / max(1, len(figures) - 1) + 4, 1), round(TALL - 3 - (TALL - 6) * share, 1))
          for (index, _), share in zip(known, heights([figure.value for figure in series]), strict=True)]
    marks = [at[index] for index in change_points(series)]
    unit = "" if series[0].unit == "1" else f" {series[0].unit}"
    words = f"{series[0].value:.3g} to {series[-1].value:.3g}{unit}"
    if marks:
        words += f", {len(marks)} change{'s' if len(marks) > 1 else ''}"
    return Spark(" ".join(f"{x:g},{y:g}" for x, y in at), marks, series[-1].value, words)


def bars(names: Sequence[str], outcomes: Sequence[Sequence[str | None]]) -> list[Bar]:
    """A bar for each night in which a scene and engine were run. `outcomes` has a list over the nights per cell."""
    drawn = []
    for index, name in enumerate(names):
        count = Counter(each[index] for each in outcomes)
        made = [outcome for outcome in SEVERITY if count[outcome]]
        if made:
            words = ", ".join(f"{count[outcome]} {outcome}" for outcome in made)
            drawn.append(Bar(round(ACROSS * index / len(names), 1), made[0], f"{name[:10]}: {words}"))
    return drawn


def write_history(folder: Path, store: sql.Engine) -> Path:
    """Write the page of the history and the files that it needs into a folder, and return the path of the page.

    Raises `ArgumentError` if the store is empty or the folder cannot be written.
    """
    runs, cells = histories(store, COLUMNS, NIGHTS)
    if not runs:
        raise ArgumentError(EMPTY)
    groups: dict[tuple[str, str], list[list[str | None]]] = {}
    for key, cell in cells.items():
        groups.setdefault(key[:2], []).append(cell.outcomes)
    names = [run.name for run in runs]
    rows = [(key[0], cell.label, next((each for each in reversed(cell.outcomes) if each), ""),
             [spark(cell.figures[name]) for name in COLUMNS]) for key, cell in sorted(cells.items())]
    return page_of(
        folder, "history.html.j2", plots=False, runs=runs, scenes=sorted({scene for scene, _ in groups}),
        engines=runs[-1].versions["engine"], metrics=COLUMNS, rows=rows, width=ACROSS, height=TALL,
        bar=ACROSS / len(runs), cells={pair: bars(names, outcomes) for pair, outcomes in groups.items()})
