"""Differences of the model: of the start of an engine, of what it reports, and of its accelerations."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from crosscheck.diagnosis import fit, misreadings, of_joints, of_output, of_run, variants
from crosscheck.diagnosis.copies import AMPLIFIED, ObservedCopy, data, points_of, undone
from crosscheck.diagnosis.observe import REACH, Observation, Scale, Silent, Subject, observe, rates, window
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.scene.alterations import alterations
from crosscheck.scene.altered import Accelerations, Model, of_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import ALLOWED_VIOLATION
from crosscheck.scene.states import States

CONSTANT = 1e-14
"""Share of the largest number by which one that is constant may vary in a limit: runs are added with weights."""

COPIES = 2
"""Number of further starts that are observed, for each joint structure."""


@dataclasses.dataclass(frozen=True)
class Known:
    """What was found about an engine's model before its stepping is tested."""

    model: Model
    start: tuple[np.ndarray, np.ndarray]  # attitudes and angular velocities
    soft: bool = False  # whether its joints give way by an unknown law: no plain method can be compared with it
    undo: Callable[[States], States] | None = None  # corrects a misreport
    absent: int | None = None  # number of a body that the engine does not have
    altered: bool = False  # whether the model differs from the scene's

    @classmethod
    def of(cls, scene: Scene) -> Known:
        """The scene as it is."""
        return cls(of_scene(scene), (scene.R0, scene.w0))


def diagnose(subject: Subject, first: Observation, answer: Explanation, alone: bool = False) -> Known | None:
    """Name what makes the limit `first` of an engine another motion than the scene's.

    Returns the engine's model; None if a hypothesis reproduces the whole motion, so that no model is fitted. `alone`:
    no copies of the scene are observed, since they do not show what begins later.
    """
    scene, scale = first.scene, first.scale
    R = first.states.R
    off = float(np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max())
    if off > ALLOWED_VIOLATION + fit.EXPLAINED * first.noise:
        answer.causes.append(NamedCause("attitudes off the group", f"R^T R - I reaches {off:.2g} at vanishing steps",
                                        "report rotations: check what attitudes are converted from"))
        return None
    observations = [(first, tuple(range(len(scene.loads))))]
    balls = None if alone else variants.on_balls(scene)
    for seed in range(0 if alone else COPIES if balls is None else 1):
        _add(subject, variants.moved(scene, scale, seed), scale, observations, None)
    if balls is not None:
        for seed in range(COPIES):
            _add(subject, variants.moved(balls[0], scale, seed), scale, observations, balls[1])
    more = None if alone else variants.sprung(scene, scale)
    if more is not None:
        _add(subject, variants.moved(more, scale, COPIES), scale, observations, tuple(range(len(more.loads))))
    if of_output.diagnose([each for each, _ in observations], answer):
        return None
    if stuck := of_run.clamped(first.states, rounding=CONSTANT):
        answer.causes.append(NamedCause("clamp", f"{stuck} in the first {scene.duration:.3g} s", of_run.UNCLAMPED))
        return None
    report = _reports([each for each, _ in observations], answer)
    copies = [undone(each, forces, report) for each, forces in observations]
    if answer.ask(of_joints.mimics, copies, answer) or answer.ask(of_joints.elsewhere, copies, answer):
        return None
    absent = _frozen(copies, answer)
    start = answer.ask(_starts, copies, absent, answer, otherwise=(scene.R0, scene.w0))
    model, soft = answer.ask(_accelerations, copies, absent, answer, otherwise=(None, False))
    return Known(model or of_scene(scene, absent=absent), start, soft, report.undo if report else None, absent,
                 bool(answer.causes))


def _add(subject: Subject, scene: Scene | None, scale: Scale,
         observations: list[tuple[Observation, tuple[int, ...]]], forces: tuple[int, ...] | None) -> None:
    """Observe one more copy, if there is one that the engine can run."""
    if scene is None or subject.unsupported(scene, 1e-3 if subject.order(scene) else None) is not None:
        return
    try:
        seen = observe(subject, window(scene, scale), scale)
    except Silent:  # the copies that run are enough
        return
    observations.append((seen, forces if forces is not None else tuple(range(len(scene.loads)))))


# --- what is reported -------------------------------------------------------------------------------------------------


def mismatch(states: States, interval: float, scale: Scale) -> tuple[float, float]:
    """(largest normalised |dx/dt - v| and |dR/dt - R hat(w)|, error of the difference quotients)."""
    R = states.R.reshape(*states.x.shape[:2], 9)
    poses = np.concatenate([states.x / scale.length, R], axis=2)
    slopes, error = rates(poses, interval)
    inner = slice(REACH, len(states.t) - REACH)
    spin = np.cross(states.R[inner], states.w[inner][..., None, :]).reshape(*R[inner].shape)  # R hat(w), row by row
    wanted = np.concatenate([states.v[inner] / scale.length, spin], axis=2)
    return float(np.abs(slopes - wanted).max()) / scale.rate, error / scale.rate


def _reports(observations: list[Observation], answer: Explanation) -> misreadings.Report | None:
    """The misreport without which velocities are the derivatives of poses, if they are not as reported."""
    def worst(report: misreadings.Report | None) -> tuple[float, float]:
        pairs = []
        for each in observations:
            states = each.states if report is None else report.undo(each.states)
            interval = each.scene.interval
            gap, error = mismatch(states, interval, each.scale)
            pairs.append((gap, error + AMPLIFIED * each.noise / (interval * each.scale.rate)))
        return max(pairs, key=lambda pair: pair[0] - fit.EXPLAINED * pair[1])

    gap, noise = worst(None)
    limit = max(fit.EXPLAINED * noise, ALLOWED_VIOLATION)
    if gap <= limit:
        return None
    fitting = []
    for report in misreadings.REPORTS:
        after, noise = worst(report)
        good = after <= max(fit.EXPLAINED * noise, ALLOWED_VIOLATION)
        answer.evidence.append(Evidence(f"{report.cause}: {report.detail}", "report", gap, after,
                                        "velocities against derivatives of poses, over W", holds=good))
        answer.tried += 1
        fitting += [report] if good else []
    if len(fitting) != 1:
        answer.unexplained.append("velocities are not the derivatives of the poses")
        return None
    answer.causes.append(NamedCause(fitting[0].cause, fitting[0].detail, "report states in the common convention: x, v "
                                    "in world axes, R from body to world, w in body axes"))
    return fitting[0]


def _frozen(copies: list[ObservedCopy], answer: Explanation) -> int | None:
    """Name a body that always stays at rest as missing in the engine's model; its number."""
    moves = np.max([np.abs(each.observation.y - each.observation.y[0]).max(axis=(0, 2)) for each in copies], axis=0)
    still = [int(k) for k in np.flatnonzero(moves <= ALLOWED_VIOLATION)]
    scene = copies[0].observation.scene
    expected = Accelerations(points_of(copies[0]))(of_scene(scene))
    moving = [k for k in still if scene.v0[k].any() or scene.w0[k].any() or (
        np.abs(expected[:, k]).max() > ALLOWED_VIOLATION)]
    if len(moving) != 1 or scene.n == 1 or any(joint.parent == moving[0] for joint in scene.joints):
        return None
    name = scene.bodies[moving[0]].name
    answer.test(Evidence("missing body", "model", None, float(moves[moving[0]]), "largest change of the body's "
                         "normalised state", f"body {name!r} never moves", True),
                f"check that body {name!r} reaches the engine")
    return moving[0]


# --- where it starts --------------------------------------------------------------------------------------------------


def _starts(copies: list[ObservedCopy], absent: int | None, answer: Explanation) -> misreadings.Pose:
    """The engine's start on the scene. The misreading that leads to it is named, if it is not the scene's."""
    observations, scene = [each.observation for each in copies], copies[0].observation.scene
    limit = ALLOWED_VIOLATION + max(fit.EXPLAINED * each.noise for each in observations)

    def worst(attitude: misreadings.Misreading | None, spin: misreadings.Misreading | None, mode: str) -> float:
        return max(misreadings.gap(each, *misreadings.misread(each.scene, attitude, spin, mode), absent)
                   for each in observations)

    before = worst(None, None, "bodies")
    if before <= limit:
        return scene.R0, scene.w0
    fitting = []
    for attitude, spin in list(itertools.product((None, *misreadings.ATTITUDES), (None, *misreadings.SPINS)))[1:]:
        chosen = [each for each in (attitude, spin) if each is not None]
        after, mode = min((worst(attitude, spin, mode), mode) for mode in misreadings.MODES)
        answer.tried += 1
        if after <= limit or len(chosen) == 1:
            text = " and ".join(f"{each.cause}: {each.detail}" for each in chosen)
            answer.evidence.append(Evidence(text, "start", before, after, "start against the scene's, normalised",
                                            holds=after <= limit))
        if after <= limit:
            fitting.append((attitude, spin, mode, chosen))
    fewest = min((len(each[3]) for each in fitting), default=0)
    fitting = [each for each in fitting if len(each[3]) == fewest]
    names = {tuple(each.cause for each in chosen) for *_, chosen in fitting}
    if len(names) != 1:
        answer.unexplained.append("the start is not the scene's")
        answer.candidates += sorted(" and ".join(each) for each in names)
        return scene.R0, scene.w0
    attitude, spin, mode, chosen = fitting[0]
    answer.causes += [NamedCause(each.cause, each.detail, "convert the initial state to the engine's convention")
                      for each in chosen]
    return misreadings.misread(scene, attitude, spin, mode)


# --- how it moves -----------------------------------------------------------------------------------------------------


def _accelerations(copies: list[ObservedCopy], absent: int | None, answer: Explanation
                   ) -> tuple[Model | None, bool]:
    """(the model that is fitted to the accelerations, or None; whether joints give way by a law that is not known)."""
    scene, soft = copies[0].observation.scene, of_joints.gives_way(copies[0], absent)
    full = data(copies, absent, soft)
    hard = full if not soft else data(copies, absent)
    wrong, remaining = hard.before, full.before
    quantity = "accelerations, largest difference over its noise"
    if wrong <= fit.SEEN and not soft:
        if wrong > fit.EXPLAINED:
            answer.unexplained.append("accelerations differ by little more than their noise")
        return None, False
    # An inertia may be converted before attitudes are misread.
    candidates = alterations(scene, any(np.abs(each.states.R[0] - each.observation.scene.R0).max() > ALLOWED_VIOLATION
                                        for each in copies))
    if soft:
        fits, _ = fit.search(hard, candidates, pairing=False)
        answer.tried += len(candidates)
        if fits:
            answer.evidence += [_evidence(each, wrong, quantity) for each in fits]
            return _name(fits, full, answer), False
        if not of_joints.lawful(copies, absent):
            answer.unexplained.append("joints open, but not as forces of their opening and its rate would let them")
            return None, False
        opening = of_joints.opening(copies[0], absent)
        answer.evidence.append(Evidence("soft constraint", "constraint", wrong, remaining, quantity, opening,
                                        remaining <= fit.EXPLAINED, "with constraint forces of any law"))
        answer.causes.append(NamedCause("soft constraint", opening, "tighten the joints, or use coordinates or "
                                        "multipliers that enforce them"))
        answer.tried += 1
        if remaining <= fit.EXPLAINED:
            return None, True
    fits, others = fit.search(full, candidates)
    answer.tried += len(candidates)
    if failed := sum(not np.isfinite(each.left) for each in others):
        answer.evidence.append(Evidence("left out", "model", None, None, quantity,
                                        f"{failed} of {len(others)} alterations, of which the scene makes no sense"))
    for each in sorted(others, key=lambda each: each.left)[:8]:
        answer.evidence.append(_evidence(each, remaining, quantity))
    if fits:
        answer.evidence += [_evidence(each, remaining, quantity) for each in fits if len(each.causes) > 1]
        return _name(fits, full, answer), soft
    answer.unexplained.append("accelerations differ from the model's")
    best = min(others, key=lambda each: each.left, default=None)
    if best is not None and best.left <= fit.PART * remaining:
        answer.in_part.append(NamedCause(" and ".join(best.names), f"{best.words}; it leaves "
                                         f"{best.left / remaining:.1%} of the accelerations' difference",
                                         best.causes[0].mend))
    return None, soft


def _evidence(tried: fit.Fit, before: float, quantity: str) -> Evidence:
    return Evidence(" and ".join(tried.names), "model", before, tried.left, quantity, tried.words, tried.explains)


def _name(fits: list[fit.Fit], data: fit.Data, answer: Explanation) -> Model | None:
    """Name the simplest fits; the model of the best of them."""
    fits = fit.simplest(fits)
    names = sorted({each.names for each in fits})
    best = min(fits, key=lambda each: each.left)
    if len(names) > fit.ALTERNATIVES:
        answer.unexplained.append("more than one cause explains the accelerations")
        answer.candidates += [" and ".join(each) for each in names]
        return None
    if len(names) > 1:
        answer.causes.append(NamedCause(" or ".join(" and ".join(each) for each in names), ", or equally ".join(
            dict.fromkeys(each.words for each in fits)), best.causes[0].mend))
    else:
        answer.causes += [NamedCause(cause.name(theta), cause.words(theta), cause.mend)
                          for cause, theta in zip(best.causes, best.theta, strict=True)]
    return fit.altered(data.copies[0].right, best.causes, best.theta)
