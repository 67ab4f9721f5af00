"""Runs that somebody else made, judged by their files: `judge_recording`.

A recording is compared with truth at its own times. What it does not contain is not judged, and the verdict says so.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from crosscheck.compare.apart import largest, spread
from crosscheck.compare.order import MARGIN, SAFETY, Limit, cancelling, differ, floor_of, limit, observed_order
from crosscheck.compare.sizes import at_rest
from crosscheck.diagnosis.fit import ALTERNATIVES, CLEAR
from crosscheck.document.outcomes import EXIT_CODES, KINDS, Outcome
from crosscheck.errors import ArgumentError, CrosscheckError, Unsupported, counted, unknown
from crosscheck.files import finite
from crosscheck.judge.rules import RESOLVED
from crosscheck.recordings import causes as find_causes
from crosscheck.recordings import comparing, validation
from crosscheck.recordings.columns import Row, assigned, clock
from crosscheck.recordings.comparing import (
    UNITS,
    Differences,
    Outputs,
    compare,
    gaps,
    norms,
    part_of,
    rated,
)
from crosscheck.recordings.deciding import Reading, decided, read_as, recorded_start
from crosscheck.recordings.page import write_all as write_all
from crosscheck.recordings.page import write_page as write_page
from crosscheck.recordings.readers import opened
from crosscheck.recordings.reading import Recording, read
from crosscheck.recordings.tables import Progress
from crosscheck.references import dense
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import ALLOWED_VIOLATION, restarted
from crosscheck.scene.vectors import exponential

if TYPE_CHECKING:
    import pandas as pd

JUMP, STANDING_OUT, ONCE = 0.3, 30.0, 0.8
"""A defect is a jump if it is this part of the largest change over one interval, and so many times the median defect
before it, and the next one is below this part of it."""

PARALLEL = 0.35
"""Errors at two steps tell an order if they are parallel up to this part."""

ASYMPTOTIC, FEWEST = 0.1, 8
"""Part of a quantity's range up to which errors show their order, and the fewest rows that do."""

EXACT = 10.0
"""Times what printed digits leave open below which an error has no cause."""

STARTS = ("scene", "recorded", "either")

BEYOND = 20.0
"""Times the scene's duration up to which truth is prolonged for a recording."""


@dataclasses.dataclass
class Verdict:
    """What `judge_recording` found; `str(verdict)` says it."""

    outcome: Outcome = "unresolved"  # pass, fail or unresolved
    errors: dict[str, float] = dataclasses.field(default_factory=dict)  # the largest per quantity
    defects: pd.DataFrame | None = None  # one row an interval: t, and each quantity; None where states are not known
    order: dict[str, float | None] | None = None  # observed, per quantity; None with one file
    limit_error: dict[str, float] | None = None  # distance from truth of the limit for vanishing steps
    cause: str | None = None
    limit_unsure: dict[str, float] | None = None  # what the limit leaves open
    floors: dict[str, float] = dataclasses.field(default_factory=dict)  # what printed digits leave open
    figures: dict[str, float] = dataclasses.field(default_factory=dict)  # energy, momentum, levels
    until: float = 0.0  # s, the end of what was compared
    share: float = 0.0  # of the recording's time that was compared
    reason: str = ""  # why it is unresolved, and what would mend that
    why: str = ""  # the outcome's reason in a sentence: what fails, what is not resolved, or the largest errors
    code: str = KINDS["unresolved"].code  # see `crosscheck.document.outcomes.KINDS`; "" for a pass
    missing: int = 0  # cells without a value
    suggested: dict[str, str] = dataclasses.field(default_factory=dict)  # foreign names, and what they were taken for
    lines: list[str] = dataclasses.field(default_factory=list)
    scene: Scene | None = None
    differences: Differences | None = None
    predicted: validation.Predicted | None = None  # of a log with inputs, by joint and horizon
    detectable: dict[str, float] = dataclasses.field(default_factory=dict)  # the smallest alterations

    def __str__(self) -> str:
        return "\n".join(self.lines)

    @property
    def exit_code(self) -> int:
        """0 pass, 1 fail, 3 unresolved."""
        return EXIT_CODES[self.outcome]

    def plain(self) -> dict[str, Any]:
        """As values that JSON knows."""
        kept = ("outcome", "errors", "order", "limit_error", "limit_unsure", "cause", "floors", "figures", "until",
                "share", "reason", "code", "missing", "suggested")
        defects = None if self.defects is None else {
            name: float(self.defects[name].max()) for name in self.defects if name != "t"}
        seen, joints = self.predicted, () if self.scene is None else self.scene.joints
        predicted = seen and {joint.name: {"horizon": list(seen.horizons)} | {
            name: getattr(seen, name)[k].tolist() for name in ("error", "u", "u_D", "u_input", "u_num", "ratio")}
            for k, joint in enumerate(joints)}
        return dict(finite({name: getattr(self, name) for name in kept}
                           | {"largest_defects": defects, "text": str(self), "exit_code": self.exit_code}
                           | ({"predicted": predicted, "detectable": self.detectable} if seen else {})))


def judge_recording(scene: Scene | str | os.PathLike[str], recording: object, columns: object = None,
                    start: str = "scene", tolerance: Mapping[str, float] | None = None,
                    steps: Sequence[float] | None = None, order: int | None = None, progress: Progress | None = None,
                    period: float | None = None, need: float = 1.0, uncertain: Mapping[str, float] | None = None,
                    model: Scene | str | os.PathLike[str] | None = None, resolution: float | None = None,
                    import_at: Callable[..., Scene] | None = None) -> Verdict:
    """Judge a run by its file, whatever made it.

    A log that has efforts or set points of joints is judged by predictions from its own states, see
    `crosscheck.recordings.validation`; `tolerance` of joint_position is then one of these, over half a second.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    recording : path of a .csv, .npz or .parquet file, a data frame, or a mapping of arrays; or a list of them, which
        are the same run at other steps
    columns : names and units of the columns, as a TOML file or a dict; None: the headers say it
    start : "scene"; "recorded": truth starts from the first recorded state; or "either": where the recording begins
        elsewhere than the scene, which is said, from the first recorded state
    tolerance : the largest allowed error (SI) per quantity
    steps : s, of each file
    order : the order that is claimed
    period : s between two rows, where the files have no times
    need : share of the recording's time that has to be judged for a pass
    uncertain : standard deviations of what is uncertain in the model: "mass", "inertia", "friction", "damping",
        "armature", "torque gain", "stiffness" and "derivative gain" of servos (relative), "torque offset", "zero",
        "delay" (SI)
    model : another model of the same robot, whose predictions are compared
    resolution : twice u_val over half a second, over the travel of a joint, above which nothing passes; default: one
        percent, as of every verdict
    import_at : reads the model with other `qpos`: shapes that touch at its own start are watched from a recorded one

    Raises
    ------
    ArgumentError
        A file or an argument is wrong; the message names file, row and column.
    SceneError, Unsupported, TruthError
        As in `crosscheck.truth`.
    """
    loaded = scene_file.as_scene(scene)
    if not 0 <= need <= 1:
        raise ArgumentError(f"need: a share from 0 to 1 is wanted, not {need!r}")
    given = [read(each, loaded, columns, progress, period) for each in (
        recording if isinstance(recording, list | tuple) else [recording])]
    if progress is not None:
        progress(0, None, f"judging {given[0].name}: truth, errors, causes")
    if start not in STARTS:
        raise ArgumentError(f"start: {unknown('start', start, STARTS)}")
    allowed = tolerances([sensor.name for sensor in loaded.sensors], tolerance)
    if len(given) > 1:
        if steps is None or len(set(steps)) != len(given) or min(steps) <= 0:
            raise ArgumentError(f"steps: the step of each of the {len(given)} files is wanted, in their order: "
                                f"different ones > 0, not {steps}")
        given = [one for _, one in sorted(zip(steps, given, strict=True), key=lambda pair: pair[0])]
        steps = sorted(steps)
    if given[0].inputs or uncertain or model is not None:
        if len(given) > 1 or order is not None:
            raise ArgumentError(f"{given[0].name} is a log with inputs, which is judged from its own states, one file "
                                "at a time; leave steps and order out")
        return _driven(loaded, given[0], allowed, need, uncertain or {}, model,
                       RESOLVED if resolution is None else resolution)
    return _judge(loaded, given, start, allowed, list(steps or []), order, need, import_at)


def tolerances(sensors: Sequence[str], tolerance: Mapping[str, float] | None) -> dict[str, float]:
    """The tolerances, if each is of a quantity that is known or of one of these sensors; raises `ArgumentError`."""
    known = (*UNITS, "joint_position", "joint_velocity", *sensors)
    for key, value in (tolerance or {}).items():
        if key not in known:
            raise ArgumentError(f"tolerance: {unknown('quantity', key, known)}")
        if not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise ArgumentError(f"tolerance: {key}: a number >= 0 is wanted, not {value!r}")
    return dict(tolerance or {})


def _judge(scene: Scene, given: list[Recording], start: str, allowed: dict[str, float], steps: list[float],
           order: int | None, need: float, import_at: Callable[..., Scene] | None = None) -> Verdict:
    unread, truth = given, dense(scene)
    truth.at(np.array([min(given[0].t[-1], BEYOND * scene.duration)]))  # prolonged, so that its horizon is known
    readings = decided(scene, given[0], truth, start == "recorded")
    given = [read_as(each, readings) for each in given]
    fine, watched = given[0], list[str]()
    if import_at is not None and start == "recorded":
        scene, watched = _watched(scene, fine, import_at)
        truth = dense(scene)
    start_as, truth, since, begun = _truth(scene, fine, truth, start)
    if start == "either" and (begun or fine.t[0] > truth.horizon):
        with contextlib.suppress(ArgumentError):  # its first row does not determine a start
            found = _judge(scene, unread, "recorded", allowed, steps, order, need, import_at)
            found.lines[1:1] = [f"{each.partition('; ')[0]}: judged from its first row" for each in begun]
            return found
    system, notes = start_as(scene), _columns(scene, fine, readings) + watched
    verdict, lines = Verdict(scene=scene, missing=fine.missing, suggested=fine.suggested), list[str]()
    (lines if start == "scene" else notes).extend(begun)  # where it starts elsewhere, all that follows is doubtful
    table = min((function.end for function in scene.functions), default=math.inf)
    most = min(truth.horizon, BEYOND * scene.duration, table - since) * (1 + 1e-12)
    kept = [part_of(each, (each.t >= since) & (each.t - since <= most)) for each in given]
    if any(len(each.t) == 0 for each in kept):
        verdict.reason = f"truth ends at {truth.horizon:g} s, before the first row" + (
            f": {truth.horizon_cause}" if truth.horizon_cause else "") + "; --start recorded begins with that row"
        return _concluded(verdict, fine, "unresolved", [*lines, *notes])
    seen = compare(system, kept[0], truth, since)
    verdict.differences, verdict.until, verdict.errors = seen, float(kept[0].t[-1]), seen.errors
    verdict.floors = {key: float(seen.floor[k][at]) for key in fine.keys for k, at in [seen.worst(key)]}
    begin = max(since, float(fine.t[0]))
    verdict.share = (verdict.until - begin) / (float(fine.t[-1]) - begin) if fine.t[-1] > begin else 1.0
    if verdict.until < fine.t[-1]:
        ended = f"the table of a spline ends at {table:g} s" if fine.t[-1] > table >= verdict.until else ""
        notes.append(f"judged up to {verdict.until:g} s, {100 * verdict.share:.3g} % of the recording: " + (
            ended or truth.horizon_cause or "there truth ends"))
    parts = {"tolerance": _sizes(seen, allowed, lines), "promise": _kinds(seen, notes),
             "gap": _defects(system, seen, since, allowed, verdict, notes)}
    failed = [each for part in parts.values() for each in part]
    figures = comparing.invariants(system, kept[0], truth, since)
    verdict.figures = figures or {}
    notes.append("not judged: energy, momentum, constraint levels; they need the state of every body in the log"
                 if figures is None else "largest errors: " + ", ".join(
                     f"{name} {value:.1e}" for name, value in figures.items()) + " (energy over the largest kinetic "
                 "energy)")
    limit = None
    if len(given) > 1:
        limit, bad = _orders([seen, *(compare(system, each, truth, since) for each in kept[1:])], steps, order,
                             verdict, lines)
        failed += bad
    elif order is not None:
        notes.append("an order shows in two files at different steps; one was given")
    verdict.reason = _unresolved(verdict, allowed, order, need) or _untested(system, fine, truth, start)
    verdict.outcome = ("unresolved" if not allowed and order is None else "fail" if failed else
                       "unresolved" if verdict.reason else "pass")
    about = next((name for name, part in parts.items() if part),
                 "order" if any(each.startswith("order") for each in failed) else "limit")
    beyond = any(verdict.errors[key] > EXACT * verdict.floors[key] + 1e-9 for key in fine.keys)
    order_alone = bool(failed) and all(each.startswith("order") for each in failed)
    if beyond and (failed or not allowed) and not order_alone and (len(given) == 1 or limit is not None):
        verdict.cause, said = _cause(scene, start_as, limit or seen, verdict.until, limit is not None, parts["gap"])
        lines += said
    verdict.cause = verdict.cause or next((each.partition(":")[0] for each in failed if each.startswith((
        "order", "wrong limit"))), None)
    return _concluded(verdict, fine, about, [*lines, *(f"✗ {each}" for each in failed), *notes])


def _concluded(verdict: Verdict, recording: Recording, about: str, lines: Sequence[str]) -> Verdict:
    """The verdict with its code and its lines; `about`: what a failed one fails at, see `KINDS`."""
    verdict.code = "" if verdict.outcome == "pass" else KINDS[about if verdict.outcome == "fail" else "unresolved"].code
    mark = {"pass": "✓", "fail": "✗", "unresolved": "?"}[verdict.outcome]
    failed = next((line.removeprefix("✗ ") for line in lines if line.startswith("✗ ")), "")
    sizes = ", ".join(f"{key.replace('_', ' ')} off by up to {size:.3g}" for key, size in verdict.errors.items())
    verdict.why = failed or verdict.reason or sizes
    verdict.lines = [f"{mark} {verdict.outcome}: {verdict.why}" + (f" ({verdict.code})" if verdict.code else ""),
                     f"{verdict.scene.name if verdict.scene else ''}: {recording.name}, {len(recording.t)} rows from "
                     f"{recording.t[0]:g} to {recording.t[-1]:g} s", *(line for line in lines if line != f"✗ {failed}")]
    return verdict


def _driven(scene: Scene, recording: Recording, allowed: Mapping[str, float], need: float,
            uncertain: Mapping[str, float], model: Any, resolution: float) -> Verdict:
    """The verdict on a log with inputs."""
    verdict = Verdict(scene=scene, missing=recording.missing, suggested=recording.suggested)
    notes = _columns(scene, recording, [])
    if apart := [group.label for group in recording.groups if group.key not in ("joint_position", "joint_velocity")]:
        notes.append(f"not judged: {', '.join(apart)}; a log with inputs is judged by its joints")
    try:
        log = validation.Log(scene, recording)
        system, said = validation.chosen(scene, log, recording)
        found = validation.answer(log, system, uncertain)
    except Unsupported as error:
        verdict.reason = str(error)
        return _concluded(verdict, recording, "unresolved", notes)
    seen, names = found.predicted, [joint.name for joint in scene.joints]
    half = max(k for k, h in enumerate(seen.horizons) if h <= validation.HALF or k == 0)
    verdict.predicted, verdict.detectable, verdict.share = seen, found.detectable, log.share
    verdict.until = float(recording.t[-1])
    verdict.errors = {"joint_position": float(seen.error[:, half].max())}
    verdict.floors = {"joint_position": float(seen.u[:, half].max())}
    lines, failed = list[str](), list[str]()
    if found.fails:
        k, h = np.unravel_index(int(np.nanargmax(seen.ratio)), seen.ratio.shape)
        size = max(float(seen.ratio[k, h]), found.worst)
        failed.append(f"the model does not explain the recording: {names[k]}" + (
            "" if seen.since is None else f" from {seen.since:.4g} s") + f", {size:.3g} times the noise")
        if found.causes:
            left = found.causes[0].left
            part = "" if found.explained > 1 - CLEAR and left < validation.COVER else ", in part"
            several = "one of these, which make the same motion here: " if len(found.causes) > 1 else ""
            verdict.cause = " or ".join(cause.name for cause in found.causes)
            lines.append(f"cause{part}: {several}{'; or '.join(cause.said for cause in found.causes)} (explains "
                         f"{100 * found.explained:.3g} % of what is beyond the noise; {left:.3g} times the noise are "
                         "left)")
        else:
            lines.append("cause: no single alteration explains half of what is beyond the noise")
        if found.skipped:
            notes.append(f"{validation.PATIENCE:g} s of processor time are over: {found.skipped} more that might "
                         "explain it as well are not fitted")
    if (most := allowed.get("joint_position", math.inf)) < verdict.errors["joint_position"]:
        failed.append(f"predictions are off by {verdict.errors['joint_position']:.3g} after {seen.horizons[half]:g} s; "
                      f"{most:g} is allowed")
    absent = [key.replace("_", " ") for key in allowed if key != "joint_position"]
    wide = [(2 * float(seen.u[k, half]) / float(log.moved[k] or 1e-300), name) for k, name in enumerate(names)]
    if max(wide)[0] > resolution:
        verdict.reason = (f"u_val leaves open {100 * max(wide)[0]:.2g} % of the travel of {max(wide)[1]} after "
                          f"{seen.horizons[half]:g} s, and the resolution is {100 * resolution:g} %; less noise, a "
                          "higher rate or more motion would mend that")
    elif absent:
        verdict.reason = (f"a log with inputs is judged by predictions of joint position, not of {', '.join(absent)}; "
                          "leave that tolerance out")
    elif not failed and seen.beyond is not None:
        joint, after = seen.beyond
        verdict.reason = (
            f"predictions of {names[joint]} are off by {seen.error[joint, after] / seen.u[joint, after]:.3g} times "
            f"u_val after {seen.horizons[after]:g} s, where {seen.allowed:.3g} times are allowed, though from fitted "
            "states the model leaves no more than the noise: states at starts of segments are less certain than u_D "
            "says; less noise or smoother inputs would mend that")
    elif log.share < need:
        rest = "; ".join(f"{name} take {size:.3g} s" for name, size in log.left_out.items())
        verdict.reason = _short(log.share, need) + (f" ({rest})" if rest else "")
    verdict.outcome = "fail" if failed else "unresolved" if verdict.reason else "pass"
    lines += [validation.row(joint, seen, k) for k, joint in enumerate(scene.joints)]
    if not failed:
        lines.append("the smallest that would have shown, 95 times of 100: " + ", ".join(
            validation.sized(system, found.detectable)))
    notes += [*said, "noise: " + ", ".join(f"{name} {each.said}" for name, each in zip(names, log.noise, strict=True)),
              *(["recorded rates: " + "; ".join(log.said)] if log.said else []),
              f"{len(log.starts)} segments of {log.span:.3g} s, {100 * log.share:.3g} % of the recording; each starts "
              "from a local polynomial in time, without a model"]
    if verdict.outcome == "pass":
        lines.insert(0, "the model explains the recording to within its noise")
    if model is not None:
        notes += _two(scene, scene_file.as_scene(model), recording, log, seen)
    return _concluded(verdict, recording, "tolerance", [*(f"✗ {each}" for each in failed), *lines, *notes])


def _two(scene: Scene, other: Scene, recording: Recording, log: Any, predicted: validation.Predicted) -> list[str]:
    """Predictions of another model beside those of the first."""
    names = [joint.name for joint in scene.joints]
    if [joint.name for joint in other.joints] != names:
        raise ArgumentError(f"model: {other.name!r} has the joints {', '.join(joint.name for joint in other.joints)}, "
                            f"not {', '.join(names)}")
    system, _ = validation.chosen(other, log, recording)
    fit = validation.Fit(log, system)
    beside = fit.headline(np.zeros(len(system.names)), fit.numerical(predicted.horizons))
    made = [f"prediction errors of {scene.name} and {other.name}, rms:"]
    for k, name in enumerate(names):
        for h, horizon in enumerate(predicted.horizons):
            one, two, u = (float(each[k, h]) for each in (predicted.error, beside.error, predicted.u))
            word = "they differ by less than u_val" if abs(one - two) <= u else (
                f"{(scene if one < two else other).name} predicts better, by more than u_val")
            made.append(f"{name} after {horizon:g} s: {one:.3g} and {two:.3g}, u_val {u:.2g}: {word}")
    return made


def _columns(scene: Scene, recording: Recording, readings: Sequence[Reading]) -> list[str]:
    """What the columns were taken for, which of them were not, and what they lack."""
    given = {group.owner for group in recording.inputs}
    notes = [f"no column has the set point of the servo of {force.joint}: the model's own is taken"
             for force in scene.forces if force.law.has_modes and force.joint not in given]
    notes += [f"read as: {each.said}" for each in readings]
    if recording.suggested:
        pairs = [f"{name} as {what}" for name, what in recording.suggested.items()]
        more = f" and {len(pairs) - 12} more" if len(pairs) > 12 else ""
        notes.append(f"columns recognised by their names: {', '.join(pairs[:12])}{more}")
    notes += recording.notes
    if recording.missing:
        notes.append(f"{recording.missing} cells have no value and are not compared")
    if recording.merged:
        notes.append(f"{recording.merged} rows repeat the time of the row before and are one with it")
    if recording.ignored:
        more = f" and {len(recording.ignored) - 8} more" if len(recording.ignored) > 8 else ""
        notes.append(f"columns ignored: {', '.join(recording.ignored[:8])}{more}")
    return notes


def _unresolved(verdict: Verdict, allowed: Mapping[str, float], order: int | None, need: float) -> str:
    """Why a recording without a mistake is not passed, and what would mend that; "" if nothing is in the way."""
    if not allowed and order is None:
        return "no tolerance was asked; give one, such as --tol joint_position=1e-3"
    absent = [key.replace("_", " ") for key in allowed if key not in verdict.errors]
    if absent:
        return f"the file does not have {', '.join(absent)}; record it, or leave its tolerance out"
    if verdict.share < need:
        return _short(verdict.share, need) + ", a shorter recording needs no more"
    wide = [key for key, most in allowed.items() if verdict.floors[key] > most]
    if wide:
        return (f"printed digits leave open {verdict.floors[wide[0]]:.1e} of {wide[0].replace('_', ' ')}, more than "
                f"the tolerance {allowed[wide[0]]:g}; record more digits")
    return ""


def _untested(scene: Scene, recording: Recording, truth: Any, start: str) -> str:
    """Why a recording tests nothing: its rows are the start of truth, or nothing moves; "" where it does."""
    rates = any(group.key in comparing.RATES for group in recording.groups)
    if start == "recorded" and len(recording.t) <= (1 if rates else comparing.FIRST):
        return (f"truth starts from the recording's {counted(len(recording.t), 'row')}, and none is left to compare; "
                "record more, or judge it from the scene's start")
    if at_rest(scene, truth.at(np.minimum(recording.t - recording.t[0], truth.horizon))):
        return "nothing moves but rounding, which tests the equilibrium alone; record a motion"
    return ""


def _short(share: float, need: float) -> str:
    """That less of a recording was judged than is asked, and what accepts that."""
    return (f"{100 * share:.3g} % of the recording's time could be judged, {100 * need:.3g} % is asked; --need "
            f"{math.floor(100 * share) / 100:g} accepts that")


def _truth(scene: Scene, recording: Recording, truth: Any, start: str
           ) -> tuple[Callable[[Scene], Scene], Any, float, list[str]]:
    """(what starts a scene as the recording, truth, time of the recording at which it starts, what to say)."""
    notes: list[str] = []
    if recording.t[0] > truth.horizon and start == "scene":
        return lambda given: given, truth, 0.0, notes
    if start == "recorded":
        found = recorded_start(scene, recording, truth)
        if found is None:
            raise ArgumentError(f"{recording.name}: start: the first row does not determine the poses of all bodies; "
                                "record more, or judge it from the scene's start")
        states, first, mistake = found
        if mistake:
            notes.append(f"the first row makes sense with {mistake}, and truth starts from it so")
        moved = {group.key: norms(gaps(group, group.values, value, True))[0] for group, value in
                 zip(first.groups, Outputs(scene, first.groups).of(states), strict=True)}
        shifts = ", ".join(f"{key.replace('_', ' ')} changed by {size:.1e} to satisfy the joints"
                           for key, size in moved.items() if size > 1e-12)
        notes.append("truth starts from the first row" + (f", {shifts}" if shifts else ""))
        if first.t[0] > 0.0 and any(servo.period is not None for _, servo in scene.servos.values()):
            notes.append("sampled servos are taken to give nothing before their first sample")
        length = float(recording.t[-1] - first.t[0])

        def begun(given: Scene) -> Scene:
            return restarted(given, states, 0, min(max(length, 1e-9), BEYOND * scene.duration), scene.samples)

        return begun, dense(begun(scene)), float(first.t[0]), notes
    first = part_of(recording, slice(0, 1))
    seen = compare(scene, first, truth)
    away = [f"{group.label} by {sizes[0]:.3g} {group.unit}" for group, sizes, floor in zip(
        first.groups, seen.sizes, seen.floor, strict=True)
        if sizes[0] > 3 * floor[0] + ALLOWED_VIOLATION * max(1.0, float(np.abs(group.values[0]).max()))]
    if away:
        where = "where the scene starts" if recording.t[0] == 0 else f"where truth is at {recording.t[0]:g} s"
        notes.append(f"the recording does not start {where}: {', '.join(away)}; --start recorded judges from its first "
                     "row")
    return lambda given: given, truth, 0.0, notes


def _watched(scene: Scene, recording: Recording, import_at: Callable[..., Scene]) -> tuple[Scene, list[str]]:
    """The scene of a model at the recorded start, where shapes touch at its own and are not watched, and what is."""
    touching = [each for each in scene.left_out if each.value == "which touch at the start"]
    first = {group.owner: float(group.values[0, 0]) for group in recording.groups if group.key == "joint_position"}
    if not touching or scene.n != len(scene.joints) or {joint.name for joint in scene.joints} != first.keys():
        return scene, []
    there = import_at(qpos=[first[joint.name] for joint in scene.joints])
    return there, [f"at the recorded start they are apart, and watched: {each.where}" for each in touching
                   if each not in there.left_out]


def _sizes(diff: Differences, allowed: Mapping[str, float], lines: list[str]) -> list[str]:
    """Errors beyond their tolerances; all of them into `lines`."""
    failed = []
    for key in diff.recording.keys:
        which, at = diff.worst(key)
        group, sizes, floors, t = diff.recording.groups[which], diff.sizes[which], diff.floor[which], diff.recording.t
        error, floor = float(sizes[at]), float(floors[at])
        digits = f", of which printed digits leave open {floor:.1e}" if floor > 1e-3 * error and floor > 1e-12 else ""
        said = f"{group.label}: off by up to {error:.3g} {group.unit} (t = {t[at]:.6g} s){digits}"
        if key in allowed and error > allowed[key] + floor:
            since = float(t[int(np.argmax(sizes - floors > allowed[key]))])
            failed.append(f"{said}; {allowed[key]:g} is allowed, exceeded since t = {since:.6g} s")
        else:
            lines.append(said + (f"; {allowed[key]:g} is allowed" if key in allowed else ""))
    return failed


def _kinds(diff: Differences, notes: list[str]) -> list[str]:
    """Rates that are not the derivatives of what is recorded beside them, and attitudes that are no rotations."""
    failed, t = [], diff.recording.t
    tau = np.diff(t)
    for k, rate in rated(diff.recording) if len(t) >= 8 else ():
        pose, speed = diff.recording.groups[k], diff.recording.groups[rate]
        moved = np.diff(diff.gap[k], axis=0) / tau[:, None]
        mean = 0.5 * (diff.gap[rate][1:] + diff.gap[rate][:-1])
        if pose.key == "attitude":  # the rotation vector between them turns with the body
            w = 0.5 * (diff.values[rate][1:] + diff.values[rate][:-1])
            moved = moved + np.cross(w, 0.5 * (diff.gap[k][1:] + diff.gap[k][:-1]))
        off = norms(moved - mean)
        change = np.linalg.norm(np.diff(diff.values[rate], axis=0), axis=1)  # a rate of one interval later or before
        leave = change + 0.1 * norms(mean) + (diff.floor[k][1:] + diff.floor[k][:-1]) / tau + diff.floor[rate][1:]
        wild = off > 2 * leave + 1e-9 * np.abs(diff.values[rate]).max(initial=0.0)
        if wild.mean() > 0.3:
            at = int(np.argmax(off / (leave + 1e-300)))
            failed.append(f"{speed.label} is not the rate of {pose.label}: off by {off[at]:.3g} {speed.unit} at t = "
                          f"{t[at]:.6g} s, where one interval changes it by {change[at]:.2g}")
    for group in diff.recording.groups:
        if group.crooked > 1e-6 + 4 * float(group.floor.max()):
            notes.append(f"{group.label}: recorded attitudes are {group.crooked:.1e} from rotations")
    return failed


def _defects(scene: Scene, diff: Differences, since: float, allowed: Mapping[str, float], verdict: Verdict,
             notes: list[str]) -> list[str]:
    """Intervals that miss the true motion from their own start; the frame of all into the verdict."""
    import pandas as pd

    missed = comparing.intervals(scene, diff, since)
    if missed is None:
        notes.append("not judged: single intervals" + (
            ", of fewer than four rows" if len(diff.recording.t) < 4 else
            ", because the columns do not determine the state of all bodies, or a sampled servo has one of its own"))
        return []
    t, defects = missed
    verdict.defects = pd.DataFrame({"t": t, **{key: defect.sizes for key, defect in defects.items()}})
    failed = []
    for key, defect in defects.items():
        beyond = np.maximum(defect.sizes - defect.floor, 0.0)
        at = int(np.argmax(beyond))
        size, usual, name = defect.sizes[at], float(np.median(defect.sizes[:at or None])), key.replace("_", " ")
        once = (beyond[at + 1:at + 2] < ONCE * beyond[at]).all()
        if once and beyond[at] > max(JUMP * defect.step, STANDING_OUT * usual):
            failed.append(f"{name} jumps by {size:.3g} after the row at {t[at]:.6g} s; before it is off by "
                          f"{usual:.1e}")
        elif key in allowed and beyond[at] > allowed[key]:
            failed.append(f"{name}: from the row at {t[at]:.6g} s to the next the motion is off by {size:.3g}; "
                          f"{allowed[key]:g} is allowed")
    return failed


def _orders(runs: list[Differences], steps: list[float], order: int | None, verdict: Verdict, lines: list[str]
            ) -> tuple[Differences | None, list[str]]:
    """(the limit for vanishing steps, where that is not truth; what is wrong); the finest run comes first."""
    fine = runs[0].recording
    layout = [(g.key, g.owner, g.parts) for g in fine.groups]
    if any([(g.key, g.owner, g.parts) for g in run.recording.groups] != layout for run in runs):
        raise ArgumentError("the files have different columns; the order of a quantity needs it in all of them")
    common = sorted(set.intersection(*(set(np.round(run.recording.t[run.recording.complete], 9)) for run in runs)))
    rows = [np.searchsorted(np.round(run.recording.t, 9), common) for run in runs]
    if len(common) < 2:
        raise ArgumentError("the files have less than two times in common; record them at the same times")
    far = np.max([run.sizes[k][at] / max(float(np.ptp(run.values[k], axis=0).max()), 1e-300)
                  for run, at in zip(runs, rows, strict=True) for k in range(len(layout))], axis=0) > ASYMPTOTIC
    early = int(np.argmax(far)) if far.any() else len(far)
    if early >= FEWEST:  # later errors are no powers of the step any more
        rows = [at[:early] for at in rows]
    ends = [[gap[at] for gap in run.gap] for run, at in zip(runs, rows, strict=True)]
    verdict.order, verdict.limit_error, verdict.limit_unsure = {}, {}, {}
    failed, limits, unsure = [], list(ends[0]), np.zeros(len(layout))
    for key in fine.keys:
        which = [k for k, each in enumerate(layout) if each[0] == key]
        floor = max(float(run.floor[k][at].max()) for k in which for run, at in zip(runs, rows, strict=True))
        seen, tends = _tends([_stacked([end[k] for k in which]) for end in ends[:3]], steps[:3], floor, order)
        for place, k in enumerate(which):
            limits[k] = tends.value[:, place, :limits[k].shape[1]]
            unsure[k] = tends.uncertainty / SAFETY  # causes have a factor of their own
        verdict.order[key], verdict.limit_error[key], verdict.limit_unsure[key] = seen, tends.size, tends.uncertainty
        name, unit = key.replace("_", " "), fine.groups[which[0]].unit
        told = (f"{seen:.2f}" if seen is not None else "none, exact" if tends.by == "rounding" else
                "not determined by these files")
        lines.append(f"{name}: observed order {told}; the limit for vanishing steps is {tends.size:.2g} {unit} from "
                     f"truth, known to {tends.uncertainty:.1g}")
        if tends.size > tends.uncertainty:
            failed.append(f"wrong limit: {name} converges to another motion, {tends.size:.3g} {unit} from the scene's, "
                          "whatever the step")
        elif order is not None and seen is not None and seen < order - MARGIN:
            failed.append(f"order: {name} falls with order {seen:.2f}, and --order is {order}")
    if not any(each.startswith("wrong limit") for each in failed):
        return None, failed
    kept, exact = part_of(fine, rows[0]), [value[rows[0]] for value in runs[0].values]
    kept.groups = [dataclasses.replace(g, values=true @ exponential(gap) if g.key == "attitude" else true + gap)
                   for g, true, gap in zip(kept.groups, exact, limits, strict=True)]
    floors = [floor[rows[0]] + more for floor, more in zip(runs[0].floor, unsure, strict=True)]
    return Differences(runs[0].outputs, kept, runs[0].truth, runs[0].t[rows[0]], exact, limits, floors), failed


def _stacked(parts: Sequence[np.ndarray]) -> np.ndarray:
    """(T, G, k) of G groups (T, up to k)."""
    most = max(part.shape[1] for part in parts)
    return np.stack([np.pad(part, ((0, 0), (0, most - part.shape[1]))) for part in parts], axis=1)


def _tends(errors: list[np.ndarray], h: Sequence[float], floor: float, order: int | None
           ) -> tuple[float | None, Limit]:
    """(observed order, where runs less truth go), of two or three, the finest first.

    There is no order where printed digits hide it, or where two errors are not parallel.
    """
    rounding, seen = [floor] * len(errors), None
    if not differ(errors, rounding, 0.0):
        return None, Limit(errors[0], {"spread": SAFETY * spread(errors), "digits": floor}, "rounding")
    near, far = errors[0].ravel(), errors[1].ravel()
    if len(errors) > 2:
        seen = observed_order(h, errors) if largest(errors[1] - errors[0]) > 2 * floor else None
    elif largest(errors[0]) > 2 * floor and np.linalg.norm(
            far - (far @ near) / (near @ near) * near) <= PARALLEL * np.linalg.norm(far):
        seen = math.log(np.linalg.norm(far) / np.linalg.norm(near)) / math.log(h[1] / h[0])
    meant = seen is None or order is None or seen >= order - MARGIN
    p = order if order is not None and meant else max(1, round(seen or 1.0))
    if len(errors) > 2:
        return seen, limit(h, errors, p, rounding)
    weights = cancelling(np.array(h), p)
    value, *others = (np.tensordot(each, errors, 1) for each in (weights, *(
        cancelling(np.array(h), p + change) for change in (MARGIN, -MARGIN))))
    return seen, Limit(value, {"order": SAFETY * max(largest(value - other) for other in others),
                               "digits": floor_of(rounding, 0.0, weights)}, "order")


def _cause(scene: Scene, begun: Callable[[Scene], Scene], diff: Differences, until: float, limit: bool,
           missed: Sequence[str]) -> tuple[str | None, list[str]]:
    """(the cause, what to say of it and of the others)."""
    smooth = not scene.has_laws and not scene.monitors
    jumps = [each for each in missed if smooth and " jumps by " in each]
    named, every = find_causes.find(begun(scene), diff, until, bool(jumps))
    if len(named) == 1:
        part = "" if named[0].left <= find_causes.CERTAIN else ", in part"
        return named[0].name, [
            f"cause{part}: {named[0]} (explains {100 * (1 - named[0].left):.3g} % of the difference)"]
    if named:
        alike = " or ".join(each.name for each in named) if len(named) <= ALTERNATIVES else None
        return alike, ["cause: one of these, which make the same motion here: " + "; or ".join(map(str, named[:6]))]
    if jumps:
        return "jump", [f"cause: a jump, which no model makes here: {jumps[0]}"]
    best = [each for each in every if each.left < 0.5][:1]
    more = f"; next to it: {best[0]}, which leaves {100 * best[0].left:.2g} %" if best else ""
    step = "" if limit else "; the error of too large a step is one as well, which a second file at another step shows"
    return None, [f"cause: none of {len(every)} hypotheses explains nine tenths of the difference{more}{step}"]


def suggest(data: object, scene: Scene, period: float | None = None) -> str:
    """A mapping, as the text of a TOML file, of the columns that are recognised; others as comments.

    What names leave open is what the data say, where truth is started from the recording.
    """
    source = opened(data, scene)
    made = assigned(scene, source, {})
    rows = {column.names[0]: column.row if column.key != "t" else clock(source, column.names[0], column.row.unit)
            for column in made.columns if len(column.names) == 1}
    try:
        recording = read(data, scene, period=period)
        recording = read_as(recording, decided(scene, recording, dense(scene), True))
    except CrosscheckError:  # a mapping is wanted because it cannot be read yet
        pass
    else:
        for group in recording.groups:
            for name in group.columns if group.open else ():
                more = {"frame": group.frame} if "frame" in group.open else {}
                degrees = "unit" in group.open and group.scale != 1.0
                rows[name] = msgspec.structs.replace(
                    rows[name], point=group.point, unit="deg" + "/s" * (group.unit == "rad/s") if degrees else
                    rows[name].unit, **more)
    return "[columns]\n" + "".join(
        f"{json.dumps(name, ensure_ascii=False)} = {_toml(rows[name])}\n" if name in rows else
        f'# {json.dumps(name, ensure_ascii=False)} = {{ is = "..." }}\n' for name in source.columns)


def _toml(row: Row) -> str:
    """A row of a mapping as an inline table."""
    given = msgspec.to_builtins(row)
    usual = msgspec.to_builtins(Row())
    return "{ " + ", ".join(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in given.items()
                            if value != usual[key]) + " }"


def assert_recording(scene: Scene | str | os.PathLike[str], recording: Any, tolerance: Mapping[str, float],
                     **options: Any) -> Verdict:
    """Raise `AssertionError` with the answer unless the recording is within its tolerances; arguments as
    `judge_recording`."""
    __tracebackhide__ = True
    verdict = judge_recording(scene, recording, tolerance=tolerance, **options)
    if verdict.outcome != "pass":
        raise AssertionError(str(verdict))
    return verdict
