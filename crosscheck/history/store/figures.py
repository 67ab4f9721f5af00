"""The figures of a run as rows: which ones are kept, their units, and what in them is rounding."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

UNITS = {"position": "m", "attitude": "rad", "velocity": "m/s", "angular velocity": "rad/s"}
LEVELS = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}

SPEED = "speed ratio"
"""Name of the figure that compares speeds: time per step over the time of the calibration kernel beside it."""


class Figure(NamedTuple):
    """One figure of one result. `rounding`: how far rounding may move it; None: changes of it are no findings."""

    name: str
    unit: str
    value: float
    deviation: float | None = None
    repeats: int | None = None
    rounding: float | None = None


def figures(record: dict[str, Any], scene: dict[str, Any]) -> list[Figure]:
    """The finite figures of a record, as it stands in the document of its run, on its scene, as it stands there."""
    steps = record["steps"] or 1
    rounding = _rounding(scene, steps)
    found: list[Figure] = []
    for quantity, unit in UNITS.items():
        error = record["errors"].get(quantity, {})
        level = None if _says_nothing(error.get("max"), quantity, scene) else rounding.get(quantity)
        found += [Figure(f"{quantity} {name}", unit, error[key], rounding=level)
                  for key, name in (("max", "error"), ("end", "end error"), ("judged", "judged error"))
                  if error.get(key) is not None]
        order = record["orders"].get(quantity, {}).get("observed")
        if order is not None:
            found.append(Figure(f"{quantity} order", "1", order, rounding=_order_rounding(record, quantity, scene)))
    if record["energy_error"] is not None:
        level = rounding.get("energy") if record["energy_error"] < 1.0 else None
        found.append(Figure("energy error", "1", record["energy_error"], rounding=level))
    if record["momentum_error"] is not None:
        found.append(Figure("momentum error", "kg m^2/s", record["momentum_error"], rounding=rounding.get("momentum")))
    found += _levels(record)
    found += _costs(record)
    # A coarse run is judged by its energy alone, and the motions it shows magnify rounding without bound.
    free = record["practical"]
    return [figure._replace(value=float(figure.value), rounding=None if free else figure.rounding)
            for figure in found if math.isfinite(figure.value)]


def _rounding(scene: dict[str, Any], steps: int) -> dict[str, float]:
    """What rounding may do to each figure in so many steps, from the scene's truth; see `judge.tolerances`."""
    return {name: fixed + growing * steps**0.6 for name, (fixed, growing) in scene.get("rounding", {}).items()}


def _says_nothing(error: float | None, quantity: str, scene: dict[str, Any]) -> bool:
    """Whether the error is larger than the quantity itself: then its digits are those of another motion."""
    scales = scene.get("scales") or {}
    if error is None or not scales:
        return True
    size = {"position": max(scales["length"], scales["reach"]), "attitude": 1.0, "velocity": scales["speed"],
            "angular velocity": scales["rate"]}[quantity]
    return bool(error > size)


def _order_rounding(record: dict[str, Any], quantity: str, scene: dict[str, Any]) -> float | None:
    """How far rounding in the errors of the order study moves the slope through them."""
    if record.get("ladder_cut"):  # where it was cut is a matter of time
        return None
    share = 0.0
    for rung in record["ladder"]:
        error = rung["errors"].get(quantity)
        level = _rounding(scene, rung["steps"] or 1).get(quantity)
        if not error or level is None:
            return None
        share = max(share, level / error)
    # The slope is that of log error over log step, and neighbouring steps differ by about two.
    return 2.0 * share / math.log(2.0) if share < 0.1 else None


def _levels(record: dict[str, Any]) -> list[Figure]:
    """Constraint levels and orthogonality; where they are held by construction, up to their bound is rounding."""
    found = []
    bounds = {finding["kind"]: finding["bound"] for finding in record["findings"]}
    for level, unit in LEVELS.items():
        seen = record["levels"].get(level, {})
        if seen.get("max") is not None:
            rounding = bounds.get(f"level {level}") if seen["held"] else None
            found.append(Figure(f"constraint {level}", unit, seen["max"], rounding=rounding))
    if record["orthogonality"] is not None:
        found.append(Figure("orthogonality", "1", record["orthogonality"], rounding=bounds.get("orthogonality")))
    return found


def _costs(record: dict[str, Any]) -> list[Figure]:
    found = [Figure(name, unit, record[key]) for name, unit, key in (
        ("steps", "1", "steps"), ("us per step", "us", "us_per_step"),
        ("seconds per second", "1", "seconds_per_second")) if record[key] is not None]
    speed = record.get("speed") or {}
    if speed.get("ratio") is not None:
        found.append(Figure(SPEED, "1", speed["ratio"], speed["deviation"], speed["repeats"]))
    return found
