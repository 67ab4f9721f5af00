"""Sampled servos in fixed steps: evaluated at the steps on their sample times and held in between."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from crosscheck.scene.laws import Servo
from crosscheck.scene.model import Scene

Measure = Callable[[str], tuple[float, float]]
"""The coordinate and the rate of a joint at the present state."""


class Held:
    """What the sampled servos of a scene give over a run of steps h, which divide their periods.

    `efforts` maps the index of a servo among the forces to what it gives now. `update` is called at the start and after
    every step, or at least at those for which `due` says so.
    """

    def __init__(self, scene: Scene, h: float) -> None:
        self._servos: dict[int, tuple[str, Servo, int, int]] = {}
        self._pipes: dict[int, list[float]] = {}
        for index, (joint, servo) in scene.servos.items():
            if servo.period is not None:
                self._servos[index] = joint, servo, round(servo.period / h), round(servo.phase / h)
                self._pipes[index] = list(servo.held or (0.0,) * (servo.delay + 1))
        self.h, self._step = h, -1
        self._times: list[float] = []
        self._history: list[list[float]] = []
        self.efforts: dict[int, float] = {index: pipe[0] for index, pipe in self._pipes.items()}

    def __bool__(self) -> bool:
        return bool(self._servos)

    def next_due(self, step: int) -> int:
        """The first step after this one at which a servo is evaluated; far away if there is none."""
        return min((step + every - (step - first) % every for _, _, every, first in self._servos.values()),
                   default=2**62)

    def update(self, step: int, measure: Measure) -> bool:
        """Evaluate the servos that are due at this step; whether one was."""
        if step <= self._step:
            return False
        self._step, any_due = step, False
        for index, (joint, servo, every, first) in self._servos.items():
            if (step - first) % every == 0 and step >= first:
                pipe, any_due = self._pipes[index], True
                pipe.append(float(servo.effort(step * self.h, *measure(joint))))
                del pipe[0]
                self.efforts[index] = pipe[0]
        if any_due or not self._times:
            self._times.append((step - 0.5) * self.h)
            self._history.append([*self.efforts.values()])
        return any_due

    def at(self, t: float) -> Mapping[int, float]:
        """What the servos gave at a time that has been; at a sample time the new value."""
        if not self:
            return {}
        row = int(np.searchsorted(self._times, t + 0.25 * self.h, side="right")) - 1
        return dict(zip(self.efforts, self._history[max(row, 0)], strict=True))


def highest_order(scene: Scene) -> int | None:
    """The highest order of a one-step method under the force laws of a scene without event location; None: its own.

    Positions are of order 1 where a force jumps inside steps and of order 2 where its slope does. Sampled servos jump
    between steps.
    """
    limits = [each for joint in scene.joints for each in joint.limits if each is not None]
    if (any(any(joint.dry_friction) for joint in scene.joints) or any(each.rigid or each.damping for each in limits)
            or any(function.jumps for function in scene.functions)):
        return 1
    cut = any(servo.effort_limit is not None and servo.period is None for _, servo in scene.servos.values())
    return 2 if limits or cut else None
