"""What the page of a sweep shows: distributions, worst cells, statistics as members come in; no raw cells."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.sweeps.cells import FIGURES

if TYPE_CHECKING:
    import pandas as pd

WORST = 25
POINTS = 24
"""Numbers of members at which running statistics are shown."""

WAY = ["engine", "method", "form", "step", "rtol"]


def document(frame: pd.DataFrame, parameters: list[str], report: dict[str, Any], meta: Mapping[str, Any],
             out: str) -> dict[str, Any]:
    """Everything the page draws, a few kilobytes a way whatever the number of cells."""
    groups = list(frame.groupby(["scene", *WAY], dropna=False, sort=False))
    ways = [_way(key, cells, parameters) for key, cells in groups]
    ranked = frame[frame["status"] == "success"].sort_values("position_error", ascending=False)
    failed = frame[frame["status"] != "success"]
    worst = [_line(row, parameters, out) for _, row in ranked.head(WORST).iterrows()]
    return {"study": "sweep", "meta": meta, "report": report, "parameters": parameters, "figures": list(FIGURES),
            "ways": ways, "worst": worst, "failed": [_line(row, parameters, out)
                                                     for _, row in failed.head(WORST).iterrows()],
            "statuses": {str(name): int(count) for name, count in frame["status"].value_counts().items()},
            "cells": len(frame), "scenes": list(dict.fromkeys(frame["scene"]))}


def label(engine: str, method: str, form: str, step: float, rtol: float) -> str:
    """A way in a few words."""
    control = f"h = {step:g} s" if np.isfinite(step) else f"rtol {rtol:g}"
    return f"{engine} {method}{f' ({form})' if form else ''}, {control}"


def _way(key: tuple[Any, ...], cells: pd.DataFrame, parameters: list[str]) -> dict[str, Any]:
    scene, *rest = key
    good = cells[cells["status"] == "success"]
    return {"scene": scene, "label": label(*rest), "engine": rest[0], "count": len(cells),
            "failed": len(cells) - len(good),
            "boxes": {name: _box(good[name].to_numpy()) for name in FIGURES},
            "running": _running(good["position_error"].to_numpy()),
            "map": _map(good, parameters)}


def _box(values: np.ndarray) -> list[float] | None:
    """Least, quartiles and largest of the finite values."""
    finite = values[np.isfinite(values)]
    return None if not len(finite) else [float(q) for q in np.quantile(finite, (0, 0.25, 0.5, 0.75, 1))]


def _running(values: np.ndarray) -> dict[str, list[float]]:
    """Median and mean of the position error over the first so many members: whether the count is enough."""
    finite = values[np.isfinite(values)]
    if len(finite) < 4:
        return {"count": [], "median": [], "mean": []}
    counts = np.unique(np.geomspace(2, len(finite), POINTS).astype(int))
    means = np.cumsum(finite) / np.arange(1, len(finite) + 1)
    return {"count": counts.tolist(), "median": [float(np.median(finite[:count])) for count in counts],
            "mean": [float(means[count - 1]) for count in counts]}


def _map(good: pd.DataFrame, parameters: list[str]) -> dict[str, Any] | None:
    """Median position error over the first two parameters that are numbers."""
    scalar = [name for name in parameters if np.ndim(good[name].iloc[0] if len(good) else 0) == 0][:2]
    if not scalar or not len(good):
        return None
    medians = good.groupby(scalar)["position_error"].median()
    if len(scalar) == 1:
        return {"x": [float(x) for x in medians.index], "z": [float(z) for z in medians]}
    table = medians.unstack()
    return {"x": [float(x) for x in table.columns], "y": [float(y) for y in table.index],
            "z": [[float(z) for z in row] for row in table.to_numpy()]}


def _line(row: Any, parameters: list[str], out: str) -> dict[str, Any]:
    return {"scene": row["scene"], "label": label(*(row[name] for name in WAY)), "member": int(row["member"]),
            "parameters": ", ".join(f"{name} = {row[name]}" for name in parameters), "status": row["status"],
            "position_error": float(row["position_error"]), "attitude_error": float(row["attitude_error"]),
            "energy_error": float(row["energy_error"]),
            "command": shlex.join(["crosscheck", "sweep", f"{out}/request.json", "--cell", row["cell"]])}
