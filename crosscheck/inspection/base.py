"""What an engine says about a scene without any stepping, and how far that is from the truth.

An adapter may have a method `probe(scene, states, form=None) -> Probe`. Those of the built-in engines are in this
package, in one module each. Like `run`, a probe builds the engine's own model and asks the engine. It never computes
the answer itself: where the engine has none, the field is None and a note says why. It raises `Unsupported` if the
engine cannot model the scene in this form, and `EngineError` if the engine fails.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from crosscheck.adapters.common.probe import Probe as Probe
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

QUANTITIES = ("mass", "inertia", "position", "attitude", "velocity", "angular velocity", "total mass",
              "centre of mass", "kinetic energy", "potential energy", "mass matrix", "gravity force", "applied force",
              "acceleration", "angular acceleration")
"""The compared quantities. Causes come before effects, so that the first wrong quantity shows where to look."""

TOLERANCE = 1e-10
"""Bound on a deviation, relative to the size of the quantity's terms. Data rounded to six digits differ by 1e-6."""

ROUNDINGS = 10
"""Solving for accelerations multiplies rounding by the condition number of the mass matrix in the engine's coordinates.
For joint angles of a chain of 64 bodies it is 2e7. If ROUNDINGS times eps times this number is larger than TOLERANCE,
it is the bound."""

LOOSEST = 1e-8
"""The largest bound that conditioning may give. A larger one might let wrong data pass."""


BY_STATE = ("x", "R", "v", "w", "com", "kinetic", "potential", "jacobian", "closing", "mass_matrix", "gravity_force",
            "applied_force", "a", "alpha")
"""Fields of a probe that have one entry per state."""


def stacked(probes: Sequence[Probe]) -> Probe:
    """Join probes of one engine, each of one state, to one probe of all states. Other fields are those of the first."""
    whole = dataclasses.replace(probes[0])
    for name in BY_STATE:
        parts = [getattr(one, name) for one in probes]
        setattr(whole, name, None if any(part is None for part in parts) else np.concatenate(parts))
    return whole


@dataclasses.dataclass(frozen=True)
class Deviation:
    """The largest deviation of one engine from the truth in one quantity."""

    engine: str
    form: str
    quantity: str
    relative: float  # gap / scale
    gap: float  # SI unit of the quantity
    scale: float
    place: str  # name of the body with the largest deviation; "" if the quantity is of the whole system
    state: int  # 0 is the start
    bound: float = TOLERANCE  # on `relative`

    def __str__(self) -> str:
        where = f" of {self.place!r}" if self.place else ""
        when = "at t = 0" if self.state == 0 else f"at random state {self.state}"
        return f"{self.engine} {self.form}: {self.quantity}{where} {when} is off by {self.relative:.1e} of its scale"


@dataclasses.dataclass(frozen=True)
class Inspection:
    """The result of a static cross-check.

    `deviations` has one entry per engine, form and quantity for which the engine has an answer: engines in the order
    asked for, quantities in that of `QUANTITIES`. `skipped` says why an engine was not probed in a form.
    """

    scene: Scene
    states: States
    truth: Probe
    probes: tuple[Probe, ...]
    deviations: tuple[Deviation, ...]
    skipped: dict[str, str]

    @property
    def offenders(self) -> tuple[Deviation, ...]:
        """Deviations that exceed their bounds or are not finite, causes before effects."""
        beyond = [d for d in self.deviations if not d.relative <= d.bound]
        return tuple(sorted(beyond, key=lambda d: QUANTITIES.index(d.quantity)))

    @property
    def agree(self) -> bool:
        """Whether no engine exceeds a bound."""
        return not self.offenders

    def of(self, engine: str, form: str | None = None) -> tuple[Deviation, ...]:
        """The deviations of one engine, in one form or in all."""
        return tuple(d for d in self.deviations if d.engine == engine and form in (None, d.form))
