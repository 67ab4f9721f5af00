"""Judge sensors: readings against those of truth, and what an engine reads itself against its own states.

A reading is an output like a position, and its bound follows from those of the states, in its own unit: they times its
derivative along the true motion, in the directions that the joints allow. Accelerations and multipliers may besides be
those of a time within a step. What an engine reads itself has to be the reading of its own states.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from crosscheck.document import Finding
from crosscheck.judge import tolerances
from crosscheck.judge.accelerations import SETTLED, WITHIN
from crosscheck.judge.claim import Claim
from crosscheck.judge.defects import RATES
from crosscheck.judge.metrics import Error
from crosscheck.judge.tolerances import Tol
from crosscheck.references.base import Reference
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.mechanics import RANK_TOLERANCE
from crosscheck.scene.model import Scene
from crosscheck.scene.sensors import OWN, SENSOR_TYPES, gap, readings, unit
from crosscheck.scene.states import States
from crosscheck.scene.vectors import exponential

NUDGE = 1e-6
"""Largest change of a normalised state by which derivatives are taken: joints then open by its square, 1e-12."""

ALIKE = 1e-9
"""Relative difference of a reading from that of the same states by another formula: roundings, and the condition of
the equations for multipliers."""

OPENED = 20.0
"""Times the opening of joints, over the length, by which readings of the same states may differ: formulas take anchors
of one body or of the other."""


def judge_sensors(scene: Scene, traj: Any, truth: Reference, until: float, states: dict[str, Tol], claim: Claim,
                  vacuous: bool = False) -> tuple[list[Finding], dict[str, Error]]:
    """Findings on all sensors up to the time `until` (s), and their errors over the whole run.

    `states` are bounds of the states; with `vacuous` they bound nothing, and what an engine reads itself is judged by
    its own states alone.
    """
    if not scene.sensors:
        return [], {}
    length, rounding = tolerances.scales(scene, truth).length, 16 * tolerances.grading(scene) * claim.eps
    exact, keep = readings(scene, truth.states), truth.t <= until * (1 + 1e-12)
    bare = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    itself = [readings(scene, bare)]  # of the run's own states: with the accelerations of the equations, then with its
    itself += [] if traj.a is None else [readings(scene, dataclasses.replace(bare, a=traj.a, alpha=traj.alpha))]
    allowed = _allowed(scene, traj, truth, keep, states, claim)
    findings, errors = [], {}
    for sensor in scene.sensors:
        kind, given, true = f"sensor {sensor.name}", traj.sensors[sensor.name], exact[sensor.name]
        source = traj.sensors.source[sensor.name]
        si = "rad" if true.shape[1:] == (4,) else unit(scene, sensor)
        if not np.isfinite(true[keep]).any():
            findings.append(Finding(kind, "unjudged", None, None, si, "redundant joints share this load in no unique "
                                    "way, so that it has no true value", source))
            continue
        error = gap(given, true)
        errors[kind] = Error(si, truth.t, error, source)
        size = max(1e-9, float(np.nanmax(np.abs(true[keep])))) if si != "rad" else 1.0
        if scene.has_laws and SENSOR_TYPES[sensor.type].dynamic:
            findings.append(Finding(kind, "unjudged", float(error[keep].max()), None, si, "forces may jump with the "
                                    "state, and the reading with them", source))
            continue
        by_states, within = allowed[sensor.name]
        late = gap(itself[-1][sensor.name], itself[0][sensor.name])  # no more than its accelerations are off
        bound = by_states + np.minimum(within, late) + (ALIKE + truth.error) * size
        findings.append(_judged(kind, error, bound, keep, size, si, vacuous, "what the bounds of the states allow "
                                "(times its derivative in the directions that joints allow), and what changes within "
                                "a step", source, traj.t))
        if source == OWN:
            apart = np.min([gap(given, each[sensor.name]) for each in itself], axis=0)
            most = size * (ALIKE + OPENED * traj.constraint_position / length + rounding)
            findings.append(_judged(f"{kind} of its state", apart, most, np.ones(len(keep), bool), size, si, False,
                                    "the engine's own reading against that of its own states: rounding, and what open "
                                    "joints leave", source, traj.t))
    return findings, errors


def _judged(kind: str, error: np.ndarray, bound: np.ndarray, keep: np.ndarray, size: float, si: str, vacuous: bool,
            why: str, source: str, t: np.ndarray) -> Finding:
    """The finding on the time at which an error is largest over its bound."""
    at = int(np.argmax(np.where(keep, np.where(np.isfinite(error), error, np.inf) / bound, 0.0)))
    value, most, where = float(error[at]), float(bound[at]), f"{source}, t = {t[at]:.4g} s"
    if vacuous or most > size:
        return Finding(kind, "unjudged", value, None, si, f"at this step the bound, {most:.2g}, exceeds the size of "
                       "the reading itself", where)
    return Finding(kind, "ok" if value <= most else "fail", value, most, si, why, where)


def _allowed(scene: Scene, traj: Any, truth: Reference, keep: np.ndarray, states: dict[str, Tol], claim: Claim
             ) -> dict[str, tuple[float, np.ndarray]]:
    """By sensor, what the bounds of the states allow, and (T,) what accelerations of a time within a step may add."""
    scale = tolerances.scales(scene, truth)
    x, r, v, w = (states[name].value for name in ("position", "attitude", "velocity", "angular velocity"))
    t = traj.t
    if claim.fixed is None:
        later = RATES * traj.steps * (claim.rtol or 0.0) * (tolerances.derivative(truth, 2, scale) + scale.rate**2)
        within = np.full(len(t), later)
    else:
        order, step = claim.fixed
        first, second = (WITHIN * step**k * tolerances.derivative(truth, 2 + k, scale) for k in (1, 2))
        within = np.where((order == 1) | (t < SETTLED * step), max(first, second), second)
    poses, rates, changes = (_derivatives(scene, truth, keep, *each) for each in (
        ("pose", x, r), ("rate", v, w), ("acceleration", scale.length, 1.0)))
    return {name: (poses[name] + rates[name], changes[name] * within) for name in poses}


def _derivatives(scene: Scene, truth: Reference, keep: np.ndarray, what: str, linear: float, angular: float
                 ) -> dict[str, float]:
    """By sensor, the largest change of its reading for changes of poses, rates or accelerations of all bodies.

    Each body changes by `linear` and `angular`; of these changes joints allow a subspace at each time. Where force laws
    jump, readings that depend on accelerations are left out.
    """
    s = truth.states
    at = States(s.t[keep], *(getattr(s, name)[keep] for name in ("x", "R", "v", "w")))
    if scene.has_laws or what == "acceleration":
        assert s.a is not None
        assert s.alpha is not None
        at = dataclasses.replace(at, a=s.a[keep], alpha=s.alpha[keep])
    D = np.tile([linear] * 3 + [angular] * 3, scene.n)
    scaled = Constraints(scene).jacobian(at.x, at.R) * D
    free = np.broadcast_to(np.eye(len(D)), (len(at.t), len(D), len(D)))
    if scaled.shape[1]:
        _, sizes, Vt = np.linalg.svd(scaled)
        free = np.swapaxes(Vt[:, int(np.count_nonzero(sizes[0] > RANK_TOLERANCE * sizes[0, 0])):], 1, 2)
    scale = tolerances.scales(scene, truth)
    rate = {"pose": 1.0, "rate": scale.rate, "acceleration": scale.rate**2}[what]
    nudge = NUDGE / max(linear / (scale.length * rate), angular / rate)
    before = readings(scene, at)
    columns: dict[str, list[np.ndarray]] = {name: [] for name in before}
    for k in range(free.shape[2]):
        after = readings(scene, _moved(at, what, (nudge * free[:, :, k] * D).reshape(-1, scene.n, 6)))
        for name, values in after.items():
            change = (values - before[name]).reshape(len(values), -1) / nudge
            columns[name].append(2 * change if values.shape[1:] == (4,) else change)  # half the angle in a quaternion
    largest = {name: np.linalg.norm(np.nan_to_num(np.stack(each, axis=2)), 2, axis=(1, 2)).max() if each else 0.0
               for name, each in columns.items()}
    return {name: float(np.sqrt(2 * scene.n) * size) for name, size in largest.items()}


def _moved(at: States, what: str, change: np.ndarray) -> States:
    """The states with all poses, rates or accelerations changed, (T, n, 6)."""
    if what == "pose":
        return dataclasses.replace(at, x=at.x + change[..., :3], R=at.R @ exponential(change[..., 3:]))
    if what == "rate":
        return dataclasses.replace(at, v=at.v + change[..., :3], w=at.w + change[..., 3:])
    assert at.a is not None
    assert at.alpha is not None
    return dataclasses.replace(at, a=at.a + change[..., :3], alpha=at.alpha + change[..., 3:])
