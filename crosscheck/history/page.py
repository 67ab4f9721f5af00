"""The page of a trend: one value of one cell over the nights, with its change points, in a single file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from crosscheck.errors import ArgumentError
from crosscheck.history.changes import change_points
from crosscheck.history.store import StoredRun
from crosscheck.history.store.figures import SPEED, Figure

WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 900, 360, 80, 30, 320
"""Size of the plot and position of its axes in SVG units."""


def write_page(path: Path, series: Sequence[tuple[StoredRun, Figure]], scene: str, engine: str, label: str) -> None:
    """Write the page of a series, which must not be empty. `label` is engine and method. An old file is replaced."""
    from crosscheck.report.standalone import one_file

    figures = [figure for _, figure in series]
    values = [figure.value for figure in figures]
    logarithmic = _spans_decades(values)
    scaled = [_scaled(value, logarithmic) for value in values]
    margin = 0.1 * (max(scaled) - min(scaled)) or 0.1 * abs(max(scaled)) or 1.0
    low, high = min(scaled) - margin, max(scaled) + margin

    def y(value: float) -> float:
        share = (_scaled(value, logarithmic) - low) / (high - low)
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


def heights(values: Sequence[float]) -> list[float]:
    """Values scaled from 0 for the smallest to 1 for the largest; 0.5 if all are equal."""
    scaled = [_scaled(value, _spans_decades(values)) for value in values]
    low, high = min(scaled), max(scaled)
    return [(value - low) / (high - low) if high > low else 0.5 for value in scaled]


def _spans_decades(values: Sequence[float]) -> bool:
    return min(values) > 0 and max(values) > 10 * min(values)


def _scaled(value: float, logarithmic: bool) -> float:
    return math.log10(max(value, 1e-300)) if logarithmic else value
