"""Bounds of intervals in which a joint sticks, hits a stop or saturates: of the order that such an event allows.

An error of the state moves the time of an event, and what jumps there makes an error of that: of an error e the jump J
over the slope of the surface. A method of order one that does not look for events takes one at the end of a step, so
that its force, or its velocity, is that of the other side for up to a step. A method that documents a higher order than
this allows has to find the time. No bound reaches over an impact that may have been on either side of an output time.
"""

from __future__ import annotations

import numpy as np

from crosscheck.document import QUANTITIES
from crosscheck.errors import Unsupported
from crosscheck.judge import tolerances
from crosscheck.judge.claim import Trace
from crosscheck.references.base import Reference
from crosscheck.references.modes import Mode, laws_of
from crosscheck.references.restarts import Begin, Event, restarts_of
from crosscheck.scene.coordinates import histories
from crosscheck.scene.mechanics import Efforts
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import Motion, States

STEPS = 2.0
"""Steps by which an event may be late that a method of order one does not look for."""

JUMPS = 1e-9
"""Share of the largest acceleration below which one does not jump."""


class Crossed:
    """Intervals of one run, for `crosscheck.judge.flow`.

    Parameters
    ----------
    index : the samples at which they begin, in order
    ahead : s, how long beyond the end of an interval an event counts
    begins : by sample, where they begin instead, and the memory there
    """

    def __init__(self, scene: Scene, traj: Trace, index: np.ndarray, ahead: float, length: float,
                 begins: dict[int, tuple[States, Mode | None]]) -> None:
        self.scene, self.traj, self.index = scene, traj, index
        self.restarts = restarts_of(scene, length)
        self.intervals, self.modes = self.restarts.follow(
            (self._begin(k, *begins.get(k, (None, None))) for k in index.tolist()),
            (traj.t[index + 1] - traj.t[index]).tolist(), ahead)

    def _begin(self, k: int, own: Motion | None = None, mode: Mode | None = None) -> Begin:
        here, at = (self.traj, k) if own is None else (own, 0)
        return Begin(float(self.traj.t[k]), restarted(self.scene, here, at, 1.0), mode)

    @property
    def end(self) -> States:
        """The states at the ends."""
        parts = [[getattr(each.end, name)[0] for each in self.intervals] for name in "xRvw"]
        return States(self.traj.t[self.index + 1], *(np.array(part) for part in parts))

    def sizes(self, degree: int) -> np.ndarray:
        """(degree + 3, I) the largest derivatives of y in each; beyond those that are known, by their last ratio."""
        sizes = [*np.array([each.derivatives for each in self.intervals]).T]
        while len(sizes) < degree + 3:
            sizes.append(np.where(sizes[-2] > 0.0, sizes[-1] ** 2 / np.where(sizes[-2] > 0.0, sizes[-2], 1.0), 0.0))
        return np.array(sizes[:degree + 3])

    def unknown(self, k: int, mode: Mode | None, missed: np.ndarray, rate: float) -> float:
        """What errors `missed`, (I,) in y, of intervals change from sample k on by what a sampled servo holds there.

        It is computed from the motion without those errors. A velocity counts in units of `rate` (1/s).
        """
        spans = [servo.period * (servo.delay + 1) for _, servo in self.scene.servos.values() if servo.period]
        within = sampled_within(self.scene, self.traj.t, k, mode)
        slope = self.restarts.decay + self.intervals[k].stiff ** 2 / rate
        return slope * max(spans, default=0.0) * float(max(missed[within], default=0.0))

    def efforts(self) -> Efforts:
        """What the laws give at the ends of the intervals, in the run's own states."""
        given = self.restarts.efforts(self._begin(k, None, mode) for k, mode in zip(
            (self.index + 1).tolist(), self.modes[1:], strict=True))
        return [(law.joint, not law.turns, given[:, i]) for i, law in enumerate(self.restarts.series.laws)]


def sampled_within(scene: Scene, t: np.ndarray, k: int, mode: Mode | None) -> list[int]:
    """The intervals of output times t, (T,), within which servos sampled what they hold at t_k; none for one at them.

    `mode`: the one that comes to t_k; None if nothing was sampled before.
    """
    intervals = []
    for law, part in zip(laws_of(scene), mode or (), strict=False):
        servo = law.servo
        if servo is None or servo.period is None:
            continue
        tiny = 1e-9 * servo.period
        due = servo.phase + part.sample * servo.period <= t[k] + tiny
        times = servo.phase + servo.period * np.arange(max(0, part.sample - servo.delay - (not due)), part.sample)
        within = np.searchsorted(t, times + tiny) - 1
        intervals += within[times - t[within] > tiny].tolist()
    return intervals


def memories(scene: Scene, traj: Trace) -> list[Mode | None]:
    """What the states of a run lack, by sample."""
    return Crossed(scene, traj, np.arange(len(traj.t) - 1), 0.0, 1.0, {}).modes


def near_impacts(scene: Scene, truth: Reference, position: float, step: float) -> np.ndarray:
    """(T,) output times at which an error `position` (m) or so many seconds, `step`, may have an impact on either side.

    There a velocity may be that before the impact or that after it.
    """
    near = np.zeros(len(truth.t), bool)
    rigid = {joint.name: 1.0 if joint.type == "prismatic" else min(max(np.linalg.norm(joint.child_anchor), 1e-3), 1.0)
             for joint in scene.joints if any(each is not None and each.rigid for each in joint.limits)}
    hits = [(t, name) for t, name, what in truth.events if name in rigid and what.startswith("hits")]
    if not hits:
        return near
    rates = {name: np.abs(each.velocity.reshape(len(truth.t), -1)).max(axis=1)
             for name, each in histories(scene, truth.states).items() if name in rigid}
    for t, name in hits:
        after = min(int(np.searchsorted(truth.t, t)), len(near) - 1)
        speed = rates[name][max(after - 1, 0):after + 1].max() * rigid[name]
        near |= np.abs(truth.t - t) <= STEPS * (step + position / speed if speed else np.inf)
    return near


def late(scene: Scene, truth: Reference, step: float) -> dict[str, float]:
    """What events alone may put a method of order one off by at this step (s), by quantity; {} without any in truth.

    Steps of a ladder that divide each other may all meet an event at the same distance: such an error shows no order.
    """
    scale, until = tolerances.scales(scene, truth), min(float(truth.t[-1]), truth.horizon)
    try:
        restarts = restarts_of(scene, scale.length) if truth.events else None
    except Unsupported:  # then it is not known
        restarts = None
    if restarts is None:
        return {}
    begin = Begin(0.0, scene)
    interval = restarts.follow([begin], [until], 0.0)[0][0]
    pose, rate = across(interval.events, 0.0, 0.0, until, interval.derivatives, (1, step))
    rate += sum(each.velocity for each in interval.events if np.abs(truth.t - each.after).min() <= STEPS * step)
    return {name: truth.amplification * unit * (rate if "velocity" in name else pose)
            for name, unit in zip(QUANTITIES, (scale.length, 1.0, scale.length, 1.0), strict=True)}


def across(events: tuple[Event, ...], pose: float, rate: float, tau: float, sizes: np.ndarray,
           claim: tuple[int, float] | None) -> tuple[float, float]:
    """Bounds of the errors of y and dy/dt over an interval of length tau with events, from those without.

    `sizes`: its largest derivatives of y; `claim`: the order and the step of a method, None for one that finds events.
    """
    order, step = claim or (0, 0.0)
    for event in events:
        late = (STEPS * step if order == 1 else 0.0) + event.by_pose * pose + event.by_rate * rate
        if event.after > tau + late:
            continue
        if order == 2 and event.acceleration <= JUMPS * sizes[2]:  # a slope jumps
            rate += STEPS * step**2 * sizes[3]
        change = event.acceleration + (2.0 * sizes[2] if event.velocity else 0.0)
        pose += late * (event.velocity + change * tau)
        rate += late * change
        if abs(event.after - tau) <= late:
            rate += event.velocity
    return pose, rate
