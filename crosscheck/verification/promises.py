"""What a run promises and was asked for, which no limit can tell: levels, rotations, its end, start and steps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from crosscheck.compare.order import SAFETY
from crosscheck.document import ENDED, LEVELS, Finding, Record
from crosscheck.judge.rounding import EPS, USUAL, grading
from crosscheck.judge.rules import RESOLVED
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene


def judge_promises(scene: Scene, traj: Trajectory, held: frozenset[str], sizes: Mapping[str, float], eps: float,
                   iteration: float, on_group: bool) -> list[Finding]:
    """Levels that the method satisfies by construction, and rotation matrices if it does, at every step at rounding.

    Parameters
    ----------
    sizes : of quantities along the motion
    eps : spacing of the engine's numbers
    iteration : m, what its iteration leaves of a constraint, as the adapter of an engine that is built in states it
    on_group : whether the engine declares that its attitudes stay on SO(3) by construction
    """
    findings, opened, rate = [], 0.0, sizes["angular velocity"]
    reach = float(np.abs(traj.x).max(initial=0.0))
    below = {"velocity": "position", "acceleration": "velocity"}
    for level, unit in LEVELS.items():
        series, below_it = getattr(traj, f"constraint_{level}"), rate * opened
        # An engine may not know its accelerations at the start, which is NaN; in a segment NaN fails as a limit.
        most = 0.0 if series is None else max(float(np.nanmax(series, initial=0.0)), traj.maxima.get(
            f"constraint_{level}", 0.0))
        opened = most + below_it
        if level not in held or series is None:
            continue
        size = sizes[level] + reach if level == "position" else sizes[level]
        # No mass enters the correction of positions; rates are differences of the level below over a step.
        roundings = USUAL if level == "position" else grading(scene)
        if level != "position":
            size += sizes[below[level]] * traj.steps / float(traj.t[-1])
        left = SAFETY * iteration * (sizes["velocity"] / sizes["position"]) ** list(LEVELS).index(level)
        # Where joints are open below a level, its rows in another form differ by the turn of an opening.
        bound = roundings * max(EPS, eps) * size + left + SAFETY * below_it
        findings.append(Finding(
            f"promise level {level}", "ok" if most <= bound else "fail", most, bound, unit, "held by construction, at "
            f"every step: {roundings:.3g} eps times {size:.3g} {unit}" + (
                f", and {left:.2g} that its iteration leaves, as declared" if left else "") + (
                f", and {SAFETY * below_it:.2g} by openings below" if below_it else ""), size=size))
    if on_group:  # of all others the limit of R^T R - I is judged, as that of any quantity
        drift = max(float(traj.orthogonality.max()), traj.maxima.get("orthogonality", 0.0))
        bound = USUAL * max(EPS, eps)
        findings.append(Finding("promise orthogonality", "ok" if drift <= bound else "fail", drift, bound, "1",
                                "R^T R - I at every step: attitudes stay on the group by construction", size=1.0))
    return findings


def judge_asked(run: Record, scene: Scene, traj: Trajectory, per: int, step: float) -> list[Finding]:
    """Whether a run came to its end, in the steps that were asked for: `per` of `step` (s) between two outputs."""
    end = Finding("asked end", "ok", None, None, "", ENDED) if traj.status == "success" else (
        Finding.ended_early(f"it says of itself: {traj.status}"))
    if run.step is None:
        return [end]
    wanted, stated = per * (len(traj.t) - 1), traj.stats.get("step") or step
    more = 0.0 if scene.has_laws else traj.steps / wanted  # an event may divide a step
    value, most = max(wanted / max(1, traj.steps), stated / step, more), 1.0 + RESOLVED
    return [end, Finding("asked steps", "ok" if value <= most else "fail", float(value), most, "1", "steps asked for "
                         "over those that the run says it made, or the reverse, or its step over the one asked for: "
                         "speeds and errors are compared at one step",
                         f"{wanted} steps of {step:.6g} s asked for, {traj.steps} of {stated:.6g} s told")]
