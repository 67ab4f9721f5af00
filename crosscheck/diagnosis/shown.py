"""From observed copies of a scene to data of a fit: corrected states and their accelerations."""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.diagnosis import fit, misreadings
from crosscheck.diagnosis.observe import REACH, Observation, rates
from crosscheck.diagnosis.physics import Physics, Points, Terms
from crosscheck.scene import mechanics
from crosscheck.scene.states import States

FAITHFUL = 1e-8
"""Normalised difference below which a start or a velocity is that of the scene: scene files are exact to 1e-8."""

AMPLIFIED = 2.2
"""Sum of the absolute coefficients of the nine-point difference: the largest factor of independent errors."""

LEAST_NOISE = 1e-9
"""Least noise of normalised accelerations. Rounding of states over 0.05 rad makes about 1e-11 of it."""


@dataclasses.dataclass
class Shown:
    """One observed copy: its states after misreports are corrected, and their accelerations."""

    observation: Observation
    states: States
    accelerations: np.ndarray  # (T - 8, n, 6), world and body axes
    noise: float  # of normalised accelerations
    forces: tuple[int, ...]  # numbers of the scene's forces that it has


def undone(observation: Observation, forces: tuple[int, ...], report: misreadings.Report | None) -> Shown:
    """The observation of a copy with these forces of the scene, after a misreport is corrected."""
    scale = observation.scale
    states = observation.states if report is None else report.undo(observation.states)
    if report is not None:
        observation = dataclasses.replace(observation, y=scale.flat(states))
    slopes, noise = accelerations(observation)
    slopes[:, :, :3] *= scale.length * scale.rate
    slopes[:, :, 3:] *= scale.rate
    return Shown(observation, states, slopes, noise, forces)


def accelerations(observation: Observation) -> tuple[np.ndarray, float]:
    """Time derivatives of the velocities in y (1/s), (T - 8, n, 6), and their noise in units of 1 / W."""
    interval = observation.scene.duration / (observation.scene.samples - 1)
    slopes, error = rates(observation.y[:, :, 12:], interval)
    noise = (error + AMPLIFIED * observation.noise / interval) / observation.scale.rate
    return slopes, max(noise, LEAST_NOISE)


def data(shown: list[Shown], right: Physics, soft: bool, stride: int) -> fit.Data:
    """Residuals of all copies, in groups of one joint structure."""
    groups = []
    def structure(each: Shown) -> tuple[object, ...]:
        axes = [axis.tobytes() for joint in each.observation.scene.joints
                for axis in (joint.parent_axis, joint.child_axis) if axis is not None]
        return tuple(joint.type for joint in each.observation.scene.joints), tuple(axes), each.forces

    for one in dict.fromkeys(structure(each) for each in shown):
        members = [(k, each) for k, each in enumerate(shown) if structure(each) == one]
        scene, scale = members[0][1].observation.scene, members[0][1].observation.scale
        points, noise = points_of(members, stride)
        units = np.repeat([scale.length * scale.rate**2, scale.rate**2], 3)
        groups.append(fit.Group(Terms(scene, points, members[0][1].forces), noise, units))
    return fit.Data(groups, right, soft, quick=stride > 1)


def points_of(members: list[tuple[int, Shown]], stride: int) -> tuple[Points, np.ndarray]:
    """Every `stride`-th instant of some copies, and the noise of the accelerations there, (P,)."""
    pieces: dict[str, list[np.ndarray]] = {name: [] for name in ("t", "x", "R", "v", "w", "rates", "copy", "noise")}
    angles: dict[str, list[np.ndarray]] = {}
    for k, each in members:
        inner = slice(REACH, len(each.states.t) - REACH, stride)
        for name in ("t", "x", "R", "v", "w"):
            pieces[name].append(getattr(each.states, name)[inner])
        pieces["rates"].append(each.accelerations[::stride])
        count = len(pieces["rates"][-1])
        pieces["copy"].append(np.full(count, k))
        pieces["noise"].append(np.full(count, each.noise))
        twists = mechanics.torsion_angles(each.observation.scene, each.states)
        for joint, values in twists.items():
            angles.setdefault(joint, []).append(values[inner])
    joined = {name: np.concatenate(parts) for name, parts in pieces.items()}
    noise = joined.pop("noise")
    return Points(**joined, angles={joint: np.concatenate(parts) for joint, parts in angles.items()}), noise
