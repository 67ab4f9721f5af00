"""What an engine says about a scene before any stepping, and how far that is from the truth.

An adapter may have a method `probe(scene, states, form=None) -> Probe`; the engines built in have theirs here, one
module each. Like `run`, it builds the engine's own model and asks the engine; it never computes what the engine should
have said, and leaves None, with a note, where the engine has no answer. It raises `Unsupported` where the engine cannot
model the scene in this form, `EngineError` where it fails.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

QUANTITIES = ("mass", "inertia", "position", "attitude", "velocity", "angular velocity", "total mass",
              "centre of mass", "kinetic energy", "potential energy", "mass matrix", "gravity force", "applied force",
              "acceleration", "angular acceleration", "reaction force", "reaction torque")
"""What is compared, causes before effects: the first that is off is the one to look at."""

TOLERANCE = 1e-10
"""Relative to the size of a quantity's terms in the scene; a wrong datum of six digits shows at 1e-6."""

ROUNDINGS = 10
"""Solving for accelerations multiplies rounding by the conditioning of the mass matrix in the engine's coordinates,
2e7 for joint angles of a chain of 64 bodies. Where that, times so many eps, is above TOLERANCE, it takes its place."""

LOOSEST = 1e-8
"""The loosest such bound: beyond it a wrong datum could pass."""


@dataclasses.dataclass
class Probe:
    """An engine's model of a scene of n bodies, evaluated at K states; SI units, frames as in `States`.

    `x, R, v, w` are where the engine's own kinematics put the bodies once it has been given the states. Its velocities,
    nv of them, may be any: `jacobian` takes them to (v, w) of the bodies in turn, and the mass matrix and the forces
    belong to them. Reactions are the force and torque on a joint's child, world axes, at the child's anchor.
    """

    engine: str
    form: str
    masses: np.ndarray | None = None  # (n,)
    inertias: np.ndarray | None = None  # (n, 3, 3) about the centres of mass, body axes
    x: np.ndarray | None = None  # (K, n, 3)
    R: np.ndarray | None = None  # (K, n, 3, 3)
    v: np.ndarray | None = None  # (K, n, 3)
    w: np.ndarray | None = None  # (K, n, 3)
    total_mass: float | None = None  # kg; left None, the sum of `masses`
    com: np.ndarray | None = None  # (K, 3) of the whole system; left None, from `masses` and `x`
    kinetic: np.ndarray | None = None  # (K,) J
    potential: np.ndarray | None = None  # (K,) J, gravity -m g.x and all springs
    jacobian: np.ndarray | None = None  # (K, 6n, nv)
    closing: np.ndarray | None = None  # (K, r, nv) Jacobian of the engine's own constraints, where it has any
    mass_matrix: np.ndarray | None = None  # (K, nv, nv)
    gravity_force: np.ndarray | None = None  # (K, nv)
    applied_force: np.ndarray | None = None  # (K, nv) all but constraints, -w x Jw with it; form maximal only
    a: np.ndarray | None = None  # (K, n, 3)
    alpha: np.ndarray | None = None  # (K, n, 3)
    reactions: dict[str, tuple[np.ndarray, np.ndarray]] | None = None  # by joint, (K, 3) each
    notes: dict[str, str] = dataclasses.field(default_factory=dict)  # by quantity: why the engine does not tell

    @property
    def label(self) -> str:
        """Engine and form."""
        return f"{self.engine} {self.form}"


BY_STATE = ("x", "R", "v", "w", "com", "kinetic", "potential", "jacobian", "closing", "mass_matrix", "gravity_force",
            "applied_force", "a", "alpha")
"""Fields of a probe with one entry a state."""


def stacked(probes: Sequence[Probe]) -> Probe:
    """Probes of one engine, of one state each, as one of all states; the rest is that of the first."""
    found = dataclasses.replace(probes[0])
    for name in BY_STATE:
        parts = [getattr(one, name) for one in probes]
        setattr(found, name, None if any(part is None for part in parts) else np.concatenate(parts))
    if found.reactions is not None:
        wrenches = [one.reactions for one in probes if one.reactions is not None]
        found.reactions = {joint: (np.concatenate([each[joint][0] for each in wrenches]),
                                   np.concatenate([each[joint][1] for each in wrenches])) for joint in found.reactions}
    return found


@dataclasses.dataclass(frozen=True)
class Deviation:
    """How far one engine is from the truth in one quantity, at its worst."""

    engine: str
    form: str
    quantity: str
    relative: float  # gap over scale
    gap: float  # SI unit of the quantity
    scale: float
    place: str  # name of the worst body or joint; "" where the quantity belongs to the whole system
    state: int  # 0 is the start
    bound: float = TOLERANCE  # on `relative`

    def __str__(self) -> str:
        where = f" of {self.place!r}" if self.place else ""
        when = "at t = 0" if self.state == 0 else f"at random state {self.state}"
        return f"{self.engine} {self.form}: {self.quantity}{where} {when} is off by {self.relative:.1e} of its scale"


@dataclasses.dataclass(frozen=True)
class Inspection:
    """A static cross-check: data only.

    `deviations` holds one entry per engine, form and quantity the engine tells, engines in the order asked, quantities
    as in `QUANTITIES`; `skipped` says why an engine, in a form, was not probed.
    """

    scene: Scene
    states: States
    truth: Probe
    probes: tuple[Probe, ...]
    deviations: tuple[Deviation, ...]
    skipped: dict[str, str]

    @property
    def offenders(self) -> tuple[Deviation, ...]:
        """Deviations beyond their bounds, causes before effects; what is not finite is beyond."""
        beyond = [d for d in self.deviations if not d.relative <= d.bound]
        return tuple(sorted(beyond, key=lambda d: QUANTITIES.index(d.quantity)))

    @property
    def agree(self) -> bool:
        """Whether every engine is within the bounds in everything it tells."""
        return not self.offenders

    def of(self, engine: str, form: str | None = None) -> tuple[Deviation, ...]:
        """The deviations of one engine, in one form or in all."""
        return tuple(d for d in self.deviations if d.engine == engine and form in (None, d.form))
