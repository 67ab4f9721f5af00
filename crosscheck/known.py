"""Known defects of engines, each with its reason. They show as "known" and pass; one that vanishes fails.

An entry is written only after the cause is understood or documented by the engine, never to silence a finding.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Container

STATE = ("position", "attitude", "velocity", "angular velocity")


@dataclasses.dataclass(frozen=True)
class Known:
    """A defect: where it shows, in which findings it may show, and why it is there."""

    engine: str
    methods: tuple[str, ...]
    scenes: Container[str] | None  # names or paths; None: any scene
    forms: tuple[str, ...] | None  # None: any form
    kinds: tuple[str, ...]  # kinds of findings it explains, as in `crosscheck.verdict`
    reason: str
    practical: bool = False  # shows at the plan's practical step, and is not looked for elsewhere

    def covers(self, engine: str, method: str, scene: str, form: str | None, practical: bool) -> bool:
        """Whether the entry is about this run."""
        return (self.practical == practical and self.engine == engine and method in self.methods
                and (self.scenes is None or scene in self.scenes) and (self.forms is None or form in self.forms))


GYROSCOPIC = ("the gyroscopic torque is taken at the start of the step, which multiplies the wobble of a body "
              "spinning at rate w by about sqrt(1 + (w h)^2) a step; here w h = 0.15, and the run explodes within the "
              "second; at the speeds it reaches rounding alone exceeds the bounds of the constraint levels")
EXPLODED = ("energy", "level velocity", "level acceleration")
UNSTABILIZED = ("nothing holds the positions: at this step the body leaves its joint, by decimetres with DAE2H_LE and "
                "by metres with INDEX1_LE within the second, and its weight does work on the way")

NAIVE = ("summing the joint velocities of the stages and integrating once is second order where a joint turns on "
         "SO(3): velocities at different attitudes do not add there; order 4 is what such code is written for")
ORDERS = tuple(f"order {quantity}" for quantity in STATE)


class _BallJoints:
    """The scenes with a spherical joint, as a container of names and paths."""

    def __contains__(self, scene: object) -> bool:
        from crosscheck.errors import ArgumentError, SceneError
        from crosscheck.scene_file import as_scene

        try:
            return any(joint.type == "spherical" for joint in as_scene(scene).joints)  # type: ignore[arg-type]
        except (ArgumentError, SceneError):  # no scene at all, so that nothing is known about it
            return False


KNOWN: tuple[Known, ...] = (
    # which of the bounds of states it exceeds depends on the step; that some order is missed does not
    Known("pinocchio", ("RK4naive",), _BallJoints(), None, (*ORDERS, *STATE, "energy", "momentum"), NAIVE),
    Known("mujoco", ("Euler", "implicitfast", "discrete"), ("heavy_top",), None, EXPLODED, GYROSCOPIC, True),
    Known("pinocchio", ("SymplecticEuler",), ("heavy_top",), None, EXPLODED, GYROSCOPIC, True),
    Known("lieeuler", ("DAE2H_LE", "INDEX1_LE"), ("heavy_top",), None, ("energy",), UNSTABILIZED, True),
)


def entries(engine: str, method: str, scene: str, form: str | None, practical: bool = False) -> tuple[Known, ...]:
    """The known defects that are about this run."""
    return tuple(entry for entry in KNOWN if entry.covers(engine, method, scene, form, practical))
