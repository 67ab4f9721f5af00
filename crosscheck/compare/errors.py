"""Errors of a run against truth, and how far its energy is off.

The error of a quantity is the norm of the difference of one body: positions (m) and velocities (m/s) in world axes,
angular velocities (rad/s) in body axes, attitudes by the angle (rad) of the rotation that takes one to the other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from crosscheck.compare.apart import state_apart
from crosscheck.document import QUANTITIES, Errors
from crosscheck.errors import ArgumentError
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.scene.sensors import Readings, gap, readings, unit
from crosscheck.scene.states import Motion, States


def up_to(t: np.ndarray, end: float) -> np.ndarray:
    """Which times (s) are no later than the end (s)."""
    return t <= end * (1 + 1e-12)  # both are sums, with roundings of their own


@dataclasses.dataclass(frozen=True)
class Error:
    """Error of one quantity against truth over a run, in the unit of the quantity."""

    unit: str
    times: np.ndarray  # (T,) s
    series: np.ndarray  # (T,) the largest of all bodies; NaN where there is no truth
    body: str  # the body with the largest error of all times

    @property
    def end(self) -> float:
        """The error at the last time for which there is truth."""
        return float(self.series[~np.isnan(self.series)][-1])

    @property
    def max(self) -> float:
        """The largest error."""
        return float(np.nanmax(self.series))

    @property
    def time(self) -> float:
        """Time (s) of the largest error."""
        return float(self.times[int(np.nanargmax(self.series))])

    @property
    def figures(self) -> Errors:
        """These figures as a part of the document."""
        return Errors(unit=self.unit, end=self.end, max=self.max, time=self.time, body=self.body)


def differences(one: Motion, other: Motion) -> dict[str, np.ndarray]:
    """Norm of the difference of two runs, (T, n) per quantity. Raises `ArgumentError` if their output times differ."""
    if one.t.shape != other.t.shape or not np.allclose(one.t, other.t, rtol=0, atol=1e-9 * max(1.0, one.t[-1])):
        raise ArgumentError(f"the runs have different output times ({len(one.t)} up to {one.t[-1]:g} s and "
                            f"{len(other.t)} up to {other.t[-1]:g} s): give both the same samples= and duration=")
    return {name: np.linalg.norm(each, axis=-1) for name, each in state_apart(one, other).items()}


def errors(scene: Scene, run: Motion, truth: Motion, until: float = np.inf) -> dict[str, Error]:
    """Errors of a run against truth, per quantity, over the samples up to the time `until` (s).

    The error is infinite at times at which the run is not finite, NaN where truth is not.
    """
    keep = up_to(truth.t, until)
    times, unknown = truth.t[keep], np.isnan(truth.x[keep, 0, 0])
    result = {}
    for quantity, values in differences(run, truth).items():
        values = np.where(np.isfinite(values[keep]), values[keep], np.inf)
        values[unknown] = np.nan
        body = int(np.unravel_index(int(np.nanargmax(values)), values.shape)[1])
        result[quantity] = Error(QUANTITIES[quantity], times, values.max(axis=1), scene.bodies[body].name)
    return result


def of_sensors(scene: Scene, own: Readings, truth: States, until: float = np.inf) -> dict[str, Error]:
    """Errors of the readings of a run's sensors, as "sensor NAME", like `errors`; none of one without a true value."""
    keep, exact = up_to(truth.t, until), readings(scene, truth) if scene.sensors else {}
    found = {}
    for sensor in scene.sensors:
        name, true = sensor.name, exact[sensor.name]
        if np.isfinite(true[keep]).any():
            found[f"sensor {name}"] = Error("rad" if true.shape[1:] == (4,) else unit(scene, sensor), truth.t[keep],
                                            gap(own[name], true)[keep], own.source[name])
    return found


def energy_gap(scene: Scene, run: Motion, truth: Motion | None, maxima: Mapping[str, float],
               work: Callable[[], np.ndarray]) -> float:
    """The largest |E(t) - E(0) - work| of a run, J: of every step, by the `maxima` over them, if nothing does work.

    Otherwise it is that of the samples. If there is truth, the work is that of the true motion, as far as that reaches;
    else that of the run, `work`, and NaN if that is not known.
    """
    energy = mechanics.energy(scene, run)
    if scene.worked_on:
        if truth is None:
            return float(np.abs(energy - energy[0] - work()).max())
        return float(np.nanmax(np.abs(energy - mechanics.energy(scene, truth))))
    kinetic = maxima.get("kinetic_energy", float(mechanics.kinetic_energy(scene, run).max(initial=0.0)) or 1.0)
    return max(float(np.abs(energy - energy[0]).max()), maxima.get("energy_error", 0.0) * kinetic)
