"""What laws of joints do in each interval between two outputs of a run: events, and what states lack for a restart."""

from __future__ import annotations

import numpy as np

from crosscheck.compare.apart import ROUNDED
from crosscheck.references.base import Reference
from crosscheck.references.restarts import Event, follow
from crosscheck.scene.coordinates import histories
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import Motion, States

STEPS = 2.0
"""Steps by which an event may be late that a method of order one does not look for."""


class Crossed:
    """The true motion in intervals of a run, each from the run's own state.

    Parameters
    ----------
    index : the samples at which they begin, in order
    length : m, of the scene
    """

    def __init__(self, scene: Scene, traj: Motion, index: np.ndarray, length: float) -> None:
        self.t, self.index = traj.t, index
        self.intervals, self.modes = follow(
            scene, length, ((float(traj.t[k]), restarted(scene, traj, k, 1.0)) for k in index.tolist()),
            (traj.t[index + 1] - traj.t[index]).tolist())

    @property
    def end(self) -> States:
        """The states at the ends."""
        parts = [[getattr(each.end, name)[0] for each in self.intervals] for name in "xRvw"]
        return States(self.t[self.index + 1], *(np.array(part) for part in parts))


def near_impacts(scene: Scene, truth: Reference, position: float, step: float) -> np.ndarray:
    """(T,) output times at which an error `position` (m) or so many seconds, `step`, may have an impact on either side.

    There a velocity may be that before the impact or that after it.
    """
    near = np.zeros(len(truth.t), bool)
    rigid = {joint.name: 1.0 if joint.kind.slides else min(max(np.linalg.norm(joint.child_anchor), 1e-3), 1.0)
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


def corrected_at_impacts(scene: Scene, run: Motion, truth: Reference, step: float, position: float = 0.0) -> States:
    """The run with the true velocities at output times near an impact, see `near_impacts`: there two are right."""
    near = near_impacts(scene, truth, position, max(step, ROUNDED * float(truth.t[-1])))
    near &= not near.all()
    v, w = (np.where(near[:, None, None], getattr(truth.states, name), getattr(run, name)) for name in "vw")
    return States(run.t, run.x, run.R, v, w, hinges=run.hinges)


def across(events: tuple[Event, ...], pose: float, rate: float, tau: float, acceleration: float) -> tuple[float, float]:
    """Bounds of the errors of y and dy/dt over an interval of length tau with events, from those without.

    An error of the state moves the time of an event, and what jumps there makes an error of that: of an error e the
    jump over the slope of the surface. `acceleration`: the largest of y in the interval.
    """
    for event in events:
        late = event.by_pose * pose + event.by_rate * rate
        if event.after > tau + late:
            continue
        change = event.acceleration + (2.0 * acceleration if event.velocity else 0.0)
        pose += late * (event.velocity + change * tau)
        rate += late * change
        if abs(event.after - tau) <= late:
            rate += event.velocity
    return pose, rate
