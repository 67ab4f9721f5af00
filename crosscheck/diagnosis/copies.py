"""From observed copies of a scene to data of a fit: corrected states and their accelerations."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.diagnosis import fit, misreadings
from crosscheck.diagnosis.observe import REACH, Observation, rates
from crosscheck.scene import mechanics
from crosscheck.scene.altered import Accelerations, Points, of_scene
from crosscheck.scene.states import States

AMPLIFIED = 2.2
"""Sum of the absolute coefficients of the nine-point difference: the largest factor of independent errors."""

LEAST_NOISE = 1e-9
"""Least noise of normalised accelerations. Rounding of states over 0.05 rad makes about 1e-11 of it."""


@dataclasses.dataclass
class ObservedCopy:
    """One observed copy: its states after misreports are corrected, and their accelerations."""

    observation: Observation
    states: States
    accelerations: np.ndarray  # (T - 8, n, 6), world and body axes
    noise: float  # of normalised accelerations
    forces: tuple[int, ...]  # numbers of the scene's forces that it has


def undone(observation: Observation, forces: tuple[int, ...], report: misreadings.Report | None) -> ObservedCopy:
    """The observation of a copy with these forces of the scene, after a misreport is corrected."""
    scale = observation.scale
    states = observation.states if report is None else report.undo(observation.states)
    if report is not None:
        observation = dataclasses.replace(observation, y=scale.flat(states))
    slopes, noise = accelerations(observation)
    slopes[:, :, :3] *= scale.length * scale.rate
    slopes[:, :, 3:] *= scale.rate
    return ObservedCopy(observation, states, slopes, noise, forces)


def accelerations(observation: Observation) -> tuple[np.ndarray, float]:
    """Time derivatives of the velocities in y (1/s), (T - 8, n, 6), and their noise in units of 1 / W."""
    interval = observation.scene.interval
    slopes, error = rates(observation.y[:, :, 12:], interval)
    noise = (error + AMPLIFIED * observation.noise / interval) / observation.scale.rate
    return slopes, max(noise, LEAST_NOISE)


def data(copies: list[ObservedCopy], absent: int | None = None, soft: bool = False) -> fit.Data:
    """Residuals of all copies."""
    parts = []
    for each in copies:
        scene, scale = each.observation.scene, each.observation.scale
        parts.append(fit.Copy(of_scene(scene, each.forces, each.states.R[0], absent), Accelerations(
            points_of(each)), each.noise, np.repeat([scale.length * scale.rate**2, scale.rate**2], 3)))
    return fit.Data(parts, absent, soft)


def points_of(each: ObservedCopy) -> Points:
    """The instants of a copy at which its accelerations are known."""
    inner, states = slice(REACH, len(each.states.t) - REACH), each.states
    angles = mechanics.torsion_angles(each.observation.scene, states)
    return Points(states.x[inner], states.R[inner], states.v[inner], states.w[inner], each.accelerations,
                  {joint: values[inner] for joint, values in angles.items()}, states.t[inner])
