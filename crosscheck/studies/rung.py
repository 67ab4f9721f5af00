"""One run of a way on its ladder, and its errors against truth."""

from __future__ import annotations

import dataclasses
from typing import Any

from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.verification.ladder import Way, thinned


@dataclasses.dataclass
class Rung:
    """One run of a way. Lengths in m, angles in rad, largest over the bodies; times are of stepping alone.

    `setup_ms` is everything else: the engine's model and the conversion of its two samples.
    """

    scene: str
    engine: str
    method: str
    form: str | None
    label: str
    step: float | None  # s
    rtol: float | None
    status: str = "success"  # or "error", "skipped"
    reason: str = ""
    coordinate_map: str | None = None
    steps: int | None = None
    rejected_steps: int | None = None
    force_evaluations: int | None = None  # where the engine counts them
    end_position: float | None = None
    end_attitude: float | None = None
    max_position: float | None = None  # over the samples that the steps meet
    max_attitude: float | None = None
    samples: int | None = None  # those of the largest errors
    wall_ms: float | None = None  # median over the repeats
    wall_deviation_ms: float | None = None  # their median absolute deviation
    setup_ms: float | None = None
    repeats: int = 0

    @classmethod
    def of(cls, scene: Scene, way: Way, value: float | None, status: str = "success", reason: str = "") -> Rung:
        """The rung of a way at a step (s) or, where it is adaptive, a tolerance."""
        return cls(scene.name, way.engine, way.method, way.form, way.label, None if way.adaptive else value,
                   value if way.adaptive else None, status, reason, way.coordinate_map)


def errors_into(rung: Rung, scene: Scene, run: Any, truth: Reference, intervals: int) -> None:
    """Fill in the errors of a run at `intervals` + 1 even times against the truth at more of them."""
    from crosscheck.judge.metrics import errors

    found = errors(scene, run, thinned(truth.states, intervals))
    rung.samples = intervals + 1
    for quantity in ("position", "attitude"):
        setattr(rung, f"end_{quantity}", found[quantity].end)
        setattr(rung, f"max_{quantity}", found[quantity].max)
