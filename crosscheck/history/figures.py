"""The values (figures) of a record that are stored, with their units and the changes that rounding may cause."""

from __future__ import annotations

import math
from typing import NamedTuple

from crosscheck.document import LEVELS, QUANTITIES, Record, Scene

SPEED = "speed ratio"
"""Name of the value that compares speeds: time per step over the time of the calibration kernel."""


SHARE = "judged share"
"""Name of the value that says over which share of its time the motion of a run is resolved."""


ORDER = 0.05
"""Change of an observed order that rounding may cause: it shows where answers differ by more than twice that."""


class Figure(NamedTuple):
    """One value of one result. Changes up to `rounding` may come from rounding; None: no change of it is a finding."""

    name: str
    unit: str
    value: float
    deviation: float | None = None
    repeats: int | None = None
    rounding: float | None = None


def figures(record: Record, scene: Scene) -> list[Figure]:
    """The finite values of a record and its scene."""
    steps = record.steps or 1
    rounding = _rounding(scene, steps)
    listed: list[Figure] = []
    for quantity, unit in QUANTITIES.items():
        error = record.errors.get(quantity)
        if error is not None:
            # An error larger than the quantity itself says that the motion is another one. Its value means nothing.
            said = error.max is not None and error.size is not None and error.max <= error.size
            level = rounding.get(quantity) if said else None
            listed += [Figure(f"{quantity} {name}", unit, value, rounding=level)
                      for value, name in ((error.max, "error"), (error.end, "end error")) if value is not None]
    if record.order is not None:
        listed.append(Figure("order", "1", record.order.observed, rounding=ORDER))
    if record.energy_error is not None:
        level = rounding.get("energy") if record.energy_error < 1.0 else None
        listed.append(Figure("energy error", "1", record.energy_error, rounding=level))
    if record.momentum_error is not None:
        listed.append(Figure("momentum error", "kg m^2/s", record.momentum_error, rounding=rounding.get("momentum")))
    if record.share is not None:  # times of samples end it: what is lost of them is no rounding
        listed.append(Figure(SHARE, "1", record.share, rounding=1e-9))
    listed += _levels(record)
    listed += _costs(record)
    return [figure._replace(value=float(figure.value)) for figure in listed if math.isfinite(figure.value)]


def _rounding(scene: Scene, steps: int) -> dict[str, float]:
    """The change of each value that rounding may cause in `steps` steps."""
    return {name: fixed + growing * steps for name, (fixed, growing) in (scene.rounding or {}).items()}


def _levels(record: Record) -> list[Figure]:
    """Constraint levels and orthogonality. If the method satisfies a level, values up to its bound are rounding."""
    levels = []
    bounds = {finding.kind: finding.bound for finding in record.findings}
    for level, unit in LEVELS.items():
        seen = record.levels.get(level)
        if seen is not None and seen.max is not None:
            rounding = bounds.get(f"promise level {level}") if seen.held else None
            levels.append(Figure(f"constraint {level}", unit, seen.max, rounding=rounding))
    if record.orthogonality is not None:
        levels.append(Figure("orthogonality", "1", record.orthogonality, rounding=bounds.get("promise orthogonality")))
    return levels


def _costs(record: Record) -> list[Figure]:
    costs = [Figure(name, unit, value) for name, unit, value in (
        ("steps", "1", record.steps), ("us per step", "us", record.us_per_step),
        ("seconds per second", "1", record.seconds_per_second)) if value is not None]
    if record.speed is not None:
        costs.append(Figure(SPEED, "1", record.speed.ratio, record.speed.deviation, record.speed.repeats))
    return costs
