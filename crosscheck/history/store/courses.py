"""Outcomes and values of every cell over the last runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from crosscheck.history.store.figures import Figure
from crosscheck.history.store.runs import CellKey, StoredRun, recent
from crosscheck.history.store.schema import tables

if TYPE_CHECKING:
    from sqlalchemy import Engine


@dataclasses.dataclass(frozen=True)
class Course:
    """One cell over the runs. An entry is None if that run lacks the cell or the value."""

    label: str
    outcomes: list[str | None]
    figures: dict[str, list[Figure | None]]


def courses(store: Engine, metrics: Sequence[str], limit: int) -> tuple[list[StoredRun], dict[CellKey, Course]]:
    """The last runs with the profile of the newest one, the oldest first, and the course of every cell."""
    import sqlalchemy

    t = tables()
    everything = recent(store, 10 * limit)
    runs = [run for run in everything if run.profile == everything[0].profile][:limit][::-1]
    place = {run.name: index for index, run in enumerate(runs)}
    among = t.runs.c.name.in_(place)
    found: dict[CellKey, Course] = {}
    with store.connect() as connection:
        cells: dict[int, tuple[CellKey, int]] = {}
        for row in connection.execute(sqlalchemy.select(t.results, t.runs.c.name.label("run"))
                                      .select_from(t.results.join(t.runs))
                                      .where(among).order_by(t.runs.c.started, t.results.c.id)):
            key = (row.scene, row.engine, row.method, row.form, bool(row.practical))
            course = found.setdefault(key, Course(row.label, [None] * len(runs),
                                                  {name: [None] * len(runs) for name in metrics}))
            course.outcomes[place[row.run]] = row.outcome
            cells[row.id] = key, place[row.run]
        for row in connection.execute(sqlalchemy.select(t.metrics).select_from(t.metrics.join(t.results).join(t.runs))
                                      .where(among, t.metrics.c.name.in_(metrics))):
            key, index = cells[row.result_id]
            found[key].figures[row.name][index] = Figure(row.name, row.unit, row.value, row.deviation, row.repeats,
                                                         row.rounding)
    return runs, found
