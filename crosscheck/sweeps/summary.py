"""The content of a sweep's page: distributions, worst cells and running statistics, but not all cells."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.document import Origin, Part
from crosscheck.sweeps.cells import FIGURES

if TYPE_CHECKING:
    import pandas as pd

WORST = 25
POINTS = 24
"""Running statistics are shown for this many counts of members."""

WAY = ["engine", "method", "form", "step", "rtol"]


class Report(Part, frozen=True, kw_only=True):
    """What a sweep did, and how long it took."""

    cells: int
    workers: int
    computed: int = 0
    seconds: float = 0.0
    truth_seconds: float = 0.0  # sum over all workers
    run_seconds: float = 0.0  # sum over all workers
    disagreements: tuple[float, ...] = ()  # between the two formulations, for the checked members
    trouble: tuple[str, ...] = ()  # why some members have no truth
    overhead: float = 0.0  # s of worker time per computed cell that neither truth nor runs took


class Running(Part, frozen=True):
    """Median and mean of the position error (m) over the first `count` members. They show if the members are enough."""

    count: list[int]
    median: list[float]
    mean: list[float]

    @classmethod
    def of(cls, values: np.ndarray) -> Running:
        """From the errors (cells,) in their order. With fewer than four errors all lists are empty."""
        if len(values) < 4:
            return cls([], [], [])
        counts = np.unique(np.geomspace(2, len(values), POINTS).astype(int))
        means = np.cumsum(values) / np.arange(1, len(values) + 1)
        return cls(counts.tolist(), [float(np.median(values[:count])) for count in counts], means[counts - 1].tolist())


class Map(Part, frozen=True):
    """Median position error (m): `z[x]` over the first scalar parameter, or `z[y][x]` over the first two."""

    x: list[float]
    z: list[float] | list[list[float]]
    y: list[float] | None = None

    @classmethod
    def of(cls, good: pd.DataFrame, parameters: list[str]) -> Map | None:
        """From the successful cells. None if there are none, or no scalar parameter."""
        scalar = [name for name in parameters if len(good) and np.ndim(good[name].iloc[0]) == 0][:2]
        if not scalar:
            return None
        medians = good.groupby(scalar)["position_error"].median()
        if len(scalar) == 1:
            return cls([float(x) for x in medians.index], [float(z) for z in medians])
        table = medians.unstack()
        return cls([float(x) for x in table.columns], table.to_numpy(dtype=float).tolist(),
                   [float(y) for y in table.index])


class WayCells(Part, frozen=True, kw_only=True):
    """The cells of one way on one scene."""

    scene: str
    label: str
    engine: str
    count: int
    failed: int
    boxes: dict[str, list[float] | None]  # for each quantity: smallest finite value, quartiles, largest finite value
    running: Running
    map: Map | None


class Line(Part, frozen=True, kw_only=True):
    """One cell in a table."""

    scene: str
    label: str
    member: int
    parameters: str
    status: str
    position_error: float  # m
    attitude_error: float  # rad
    energy_error: float
    command: str  # runs it again


class SweepDocument(Part, frozen=True, kw_only=True):
    """All that the page draws. Its size is a few kilobytes per way and does not grow with the number of cells."""

    study: str = "sweep"
    meta: Origin
    report: Report
    parameters: list[str]
    figures: tuple[str, ...] = FIGURES
    ways: list[WayCells]
    worst: list[Line]
    failed: list[Line]
    statuses: dict[str, int]
    cells: int
    scenes: list[str]


def document(frame: pd.DataFrame, parameters: list[str], report: Report, meta: Origin, out: str) -> SweepDocument:
    """The content of the page for a sweep with these cells, written to the folder `out`."""

    def line(row: Any) -> Line:
        return Line(
            scene=row["scene"], label=label(*(row[name] for name in WAY)), member=int(row["member"]),
            parameters=", ".join(f"{name} = {row[name]}" for name in parameters), status=row["status"],
            position_error=float(row["position_error"]), attitude_error=float(row["attitude_error"]),
            energy_error=float(row["energy_error"]),
            command=shlex.join(["crosscheck", "study", "sweep", f"{out}/request.json", "--cell", row["cell"]]))

    ways = []
    frame = frame.assign(form=frame["form"].fillna(""))  # engines with one form only have NaN here
    for (scene, *way), cells in frame.groupby(["scene", *WAY], dropna=False, sort=False):
        good = cells[cells["status"] == "success"]
        finite = {name: good[name].to_numpy()[np.isfinite(good[name].to_numpy())] for name in FIGURES}
        boxes = {name: np.quantile(values, (0, 0.25, 0.5, 0.75, 1)).tolist() if len(values) else None
                 for name, values in finite.items()}
        ways.append(WayCells(scene=scene, label=label(*way), engine=way[0], count=len(cells),
                             failed=len(cells) - len(good), boxes=boxes, running=Running.of(finite["position_error"]),
                             map=Map.of(good, parameters)))
    ranked = frame[frame["status"] == "success"].sort_values("position_error", ascending=False)
    failed = frame[frame["status"] != "success"]
    return SweepDocument(
        meta=meta, report=report, parameters=parameters, ways=ways,
        worst=[line(row) for _, row in ranked.head(WORST).iterrows()],
        failed=[line(row) for _, row in failed.head(WORST).iterrows()],
        statuses={str(name): int(count) for name, count in frame["status"].value_counts().items()},
        cells=len(frame), scenes=list(dict.fromkeys(frame["scene"])))


def label(engine: str, method: str, form: str, step: float, rtol: float) -> str:
    """A way in a few words, for tables and legends."""
    control = f"h = {step:g} s" if np.isfinite(step) else f"rtol {rtol:g}"
    return f"{engine} {method}{f' ({form})' if form else ''}, {control}"
