"""Judge sensors: readings against those of truth, and what an engine reads itself against its own states.

A reading is an output like a position, and its bound follows from those of the states, in its own unit: they times its
derivative along the true motion, in the directions that the joints allow. Accelerations and multipliers may besides be
those of a time within a step. What an engine reads itself has to be the reading of its own states.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from msgspec.structs import replace

from crosscheck.compare.errors import Error, up_to
from crosscheck.document import Finding
from crosscheck.judge import tolerances
from crosscheck.judge.accelerations import SETTLED, WITHIN, by_equations, calm_ends, within_steps
from crosscheck.judge.claim import Claim, Trace
from crosscheck.judge.defects import RATES, Defects
from crosscheck.judge.tolerances import Tol
from crosscheck.references.base import Reference
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.mechanics import RANK_TOLERANCE
from crosscheck.scene.model import Scene, Sensor
from crosscheck.scene.sensors import OWN, SENSOR_TYPES, Misreads, Reader, Readings, gap, readings, unit
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


OF_STATE = " of its state"  # ends the kind of a finding on what an engine reads itself, against its own states


@dataclasses.dataclass(frozen=True)
class _Run:
    """What all sensors of a run are judged by."""

    scene: Scene
    traj: Trace
    truth: Reference
    keep: np.ndarray  # (T,) the output times up to which bounds hold
    itself: list[States]  # its states with the accelerations of the equations and, if it gives them, with its own
    own: list[Readings]  # of these
    rounding: np.ndarray  # (T,) of a reading of its own states, over its size
    vacuous: bool

    def judged(self, kind: str, error: np.ndarray, bound: np.ndarray, size: float, si: str, why: str) -> Finding:
        """The finding on the time at which an error is largest over its bound."""
        over = np.where(np.isfinite(error), error, np.inf) / bound
        at = int(np.argmax(np.where(self.keep, over, -1.0)))
        value, most = float(error[at]), float(bound[at])
        name = kind.removeprefix("sensor ").removesuffix(OF_STATE)
        where = f"{self.traj.sensors.source[name]}, t = {self.traj.t[at]:.4g} s"
        if not kind.endswith(OF_STATE) and (self.vacuous or most > size):
            return Finding(kind, "unresolved", value, None, si, f"at this step the bound, {most:.2g}, exceeds the size "
                           "of the reading itself", where)
        return Finding(kind, "ok" if value <= most else "fail", value, most, si, why, where)


def judge_sensors(scene: Scene, traj: Trace, truth: Reference, until: float, states: dict[str, Tol], claim: Claim,
                  vacuous: bool = False, run: Defects | None = None, misreads: Misreads | None = None
                  ) -> tuple[list[Finding], dict[str, Error]]:
    """Findings on all sensors up to the time `until` (s), and their errors over the whole run.

    `states` are bounds of the states; with `vacuous` they bound nothing, and what an engine reads itself is judged by
    its own states alone. `run` has the laws of joints along the run, `misreads` what the engine is known to read
    instead of a sensor: that is known as long as it shows.
    """
    if not scene.sensors:
        return [], {}
    exact, keep = readings(scene, truth.states), up_to(truth.t, until)
    bare = States(traj.t, traj.x, traj.R, traj.v, traj.w)
    itself = [bare, *([] if traj.a is None else [dataclasses.replace(bare, a=traj.a, alpha=traj.alpha)])]
    rounding = (ALIKE + OPENED * traj.constraint_position / tolerances.scales(scene, truth).length
                + 16 * tolerances.grading(scene) * claim.eps)
    case = _Run(scene, traj, truth, keep, itself, [readings(scene, each) for each in itself], rounding, vacuous)
    poses, rates, changes, within = _allowed(scene, traj, truth, keep, states, claim)
    lawful = _by_laws(scene, traj, run) if scene.has_laws and run is not None and traj.a is not None else None
    findings, errors = [], {}
    for sensor in scene.sensors:
        name, kind = sensor.name, f"sensor {sensor.name}"
        given, true, source = traj.sensors[name], exact[name], traj.sensors.source[name]
        si = "rad" if true.shape[1:] == (4,) else unit(scene, sensor)
        if not np.isfinite(true[keep]).any():
            findings.append(Finding(kind, "unresolved", None, None, si, "redundant joints share this load in no unique "
                                    "way, so that it has no true value", source))
            continue
        error = gap(given, true)
        errors[kind] = Error(si, truth.t, error, source)
        size = max(1e-9, float(np.nanmax(np.abs(true[keep])))) if si != "rad" else 1.0
        if scene.has_laws and SENSOR_TYPES[sensor.type].dynamic:
            findings.append(_between_events(case, name, lawful, changes[name], size, si))
            continue
        late = gap(case.own[-1][name], case.own[0][name])  # no more than its accelerations are off
        bound = poses[name] + rates[name] + np.minimum(changes[name] * within, late) + (ALIKE + truth.error) * size
        by_state, known = [each[name] for each in case.own], ""
        if source == OWN and (misread := (misreads or {}).get((sensor.type, sensor.frame))):
            true, by_state, known, gone = _misread(case, sensor, misread, given, true, by_state, bound)
            findings += gone
        judged = case.judged(kind, gap(given, true), bound, size, si, "what the bounds of the states allow (times its "
                             "derivative in the directions that joints allow), and what changes within a step")
        findings.append(judged if not known or judged.status != "ok" else
                        replace(judged, status="known", value=float(error[keep].max()), detail=known))
        if source == OWN:
            apart = np.min([gap(given, each) for each in by_state], axis=0)
            findings.append(dataclasses.replace(case, keep=np.ones(len(keep), bool)).judged(
                kind + OF_STATE, apart, size * rounding, size, si, "the engine's own reading against that of its own "
                "states: rounding, and what open joints leave"))
    return findings, errors


def _misread(case: _Run, sensor: Sensor, misread: tuple[Any, str], given: np.ndarray, true: np.ndarray,
             by_state: list[np.ndarray], bound: np.ndarray
             ) -> tuple[np.ndarray, list[np.ndarray], str, list[Finding]]:
    """What to compare readings with, in truth and in the run's own states, why, and that a known defect has vanished.

    Where the engine would read the same, nothing is known about it.
    """
    read_as, reason = misread
    other = read_as(Reader(case.scene, case.truth.states), sensor)
    if not (gap(other, true) > 2 * bound)[case.keep].any():
        return true, by_state, "", []
    if gap(given, other)[case.keep].max() > gap(given, true)[case.keep].max():
        return true, by_state, "", [Finding("vanished", "fail", None, None, "", f"a known defect no longer shows: "
                                            f"{reason}", "if the engine was mended, remove the entry")]
    return other, [read_as(Reader(case.scene, each), sensor) for each in case.itself], reason, []


def _by_laws(scene: Scene, traj: Trace, run: Defects) -> tuple[np.ndarray, Readings, np.ndarray]:
    """Numbers of output times next to which no law jumps; readings of the run's own states, right at those; and by how
    much accelerations may differ there, over the scene's length."""
    calm, at = calm_ends([run]), run.flow.index[run.flow.solvable] + 1
    a, alpha = np.array(traj.a), np.array(traj.alpha)
    a[at], alpha[at], _ = by_equations(scene, traj, at, run.flow.crossed)
    read = readings(scene, States(traj.t, traj.x, traj.R, traj.v, traj.w, a, alpha))
    return at[calm], read, within_steps(scene, run)[calm] / run.scale.length


def _between_events(case: _Run, name: str, lawful: tuple[np.ndarray, Readings, np.ndarray] | None, change: float,
                    size: float, si: str) -> Finding:
    """Judge readings that depend on accelerations against those of the run's own states; `change` as of `_allowed`."""
    if lawful is None or not case.keep[lawful[0]].any():
        return Finding(f"sensor {name}", "unresolved", None, None, si, "forces jump next to every output time" if lawful
                       else "forces may jump with the state, and the engine gives no accelerations that would tell")
    at, read, within = lawful
    bound = size * (case.truth.error + case.rounding)
    bound[at] += np.minimum(change * within, gap(case.own[-1][name], read[name])[at])
    return dataclasses.replace(case, keep=case.keep & np.isin(np.arange(len(bound)), at)).judged(
        f"sensor {name}", gap(case.traj.sensors[name], read[name]), bound, size, si, "between events, against the "
        "reading of its own states under the laws of joints: rounding, and what its accelerations are off within a "
        "step")


def _allowed(scene: Scene, traj: Trace, truth: Reference, keep: np.ndarray, states: dict[str, Tol], claim: Claim
             ) -> tuple[dict[str, float], dict[str, float], dict[str, float], np.ndarray]:
    """By sensor, what the bounds of poses and those of rates allow, and its change with accelerations; and (T,) by what
    these may change within a step."""
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
    return poses, rates, changes, within


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
        after = readings(scene, moved(at, what, (nudge * free[:, :, k] * D).reshape(-1, scene.n, 6)))
        for name, values in after.items():
            change = (values - before[name]).reshape(len(values), -1) / nudge
            columns[name].append(2 * change if values.shape[1:] == (4,) else change)  # half the angle in a quaternion
    largest = {name: np.linalg.norm(np.nan_to_num(np.stack(each, axis=2)), 2, axis=(1, 2)).max() if each else 0.0
               for name, each in columns.items()}
    return {name: float(np.sqrt(2 * scene.n) * size) for name, size in largest.items()}


def moved(at: States, what: str, change: np.ndarray) -> States:
    """The states with all poses, rates or accelerations changed, (T, n, 6)."""
    if what == "pose":
        return dataclasses.replace(at, x=at.x + change[..., :3], R=at.R @ exponential(change[..., 3:]))
    names = ("v", "w") if what == "rate" else ("a", "alpha")
    return dataclasses.replace(at, **{name: getattr(at, name) + change[..., k:k + 3] for k, name in zip(
        (0, 3), names, strict=True)})
