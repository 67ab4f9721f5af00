"""A rung: one run of a way at one step or tolerance of its ladder, with its errors against truth."""

from __future__ import annotations

import dataclasses
from typing import Any

from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.verification.ladder import Way, thinned


@dataclasses.dataclass
class Rung:
    """One run of a way. Errors are in m and rad, the largest over the bodies. Times are of stepping alone.

    `setup_ms` is the other time of a run: building the engine's model and converting its two samples.
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
    force_evaluations: int | None = None  # if the engine counts them
    end_position: float | None = None
    end_attitude: float | None = None
    max_position: float | None = None  # over the samples that lie on steps
    max_attitude: float | None = None
    samples: int | None = None  # number of the samples for max_position and max_attitude
    wall_ms: float | None = None  # median over the repeats
    wall_deviation_ms: float | None = None  # median absolute deviation of the repeats
    setup_ms: float | None = None
    repeats: int = 0

    @classmethod
    def of(cls, scene: Scene, way: Way, value: float | None, status: str = "success", reason: str = "") -> Rung:
        """The rung of a way at `value`: a step (s), or a tolerance if the way is adaptive."""
        return cls(scene.name, way.engine, way.method, way.form, way.label, None if way.adaptive else value,
                   value if way.adaptive else None, status, reason, way.coordinate_map)


def errors_into(rung: Rung, scene: Scene, run: Any, truth: Reference, intervals: int) -> None:
    """Fill in the errors of a run with `intervals` + 1 equally spaced samples. Truth may have more samples."""
    from crosscheck.judge.metrics import errors

    found = errors(scene, run, thinned(truth.states, intervals))
    rung.samples = intervals + 1
    for quantity in ("position", "attitude"):
        setattr(rung, f"end_{quantity}", found[quantity].end)
        setattr(rung, f"max_{quantity}", found[quantity].max)
