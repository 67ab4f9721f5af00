"""Differences of the model: of the start of an engine, of what it reports, and of its accelerations."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from crosscheck.diagnosis import fit, misreadings, of_joints, of_output, of_run, variants
from crosscheck.diagnosis.alterations import alterations
from crosscheck.diagnosis.models import Accelerations, Model, of_scene
from crosscheck.diagnosis.observe import REACH, Observation, Scale, Silent, Subject, observe, rates, window
from crosscheck.diagnosis.result import Evidence, NamedCause
from crosscheck.diagnosis.shown import AMPLIFIED, FAITHFUL, Shown, data, points_of, undone
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

CONSTANT = 1e-14
"""Share of the largest number by which one that is constant may vary in a limit: runs are added with weights."""

COPIES = 2
"""Number of further starts that are observed, for each joint structure."""

ALTERNATIVES = 4
"""Largest number of equally simple explanations that are named together. More of them name nothing."""


@dataclasses.dataclass
class ModelFinding:
    """The result of the diagnosis of the model."""

    causes: list[NamedCause] = dataclasses.field(default_factory=list)
    candidates: list[str] = dataclasses.field(default_factory=list)
    evidence: list[Evidence] = dataclasses.field(default_factory=list)
    unexplained: list[str] = dataclasses.field(default_factory=list)
    model: Model | None = None  # of the engine, as fitted to the scene itself
    start: tuple[misreadings.Misreading | None, misreadings.Misreading | None, str] | None = None
    tried: int = 0
    reported: misreadings.Report | None = None
    soft: bool = False
    absent: int | None = None  # number of a body that the engine does not have
    told: bool = False  # whether a hypothesis reproduces the whole motion, so that no model is fitted


def diagnose(subject: Subject, first: Observation, alone: bool = False) -> ModelFinding:
    """Name what makes the limit `first` of an engine another motion than the scene's.

    `alone`: no copies of the scene are observed, since they do not show what begins later.
    """
    scene, scale = first.scene, first.scale
    result = ModelFinding()
    R = first.states.R
    off = float(np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max())
    if off > FAITHFUL + fit.EXPLAINED * first.noise:
        result.causes.append(NamedCause("attitudes off the group", f"R^T R - I reaches {off:.2g} at vanishing steps",
                                        "report rotations: check what attitudes are converted from"))
        result.told = True
        return result
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
    told, evidence = of_output.diagnose([each for each, _ in observations])
    result.evidence += evidence
    result.tried += len(list(of_output.hypotheses(first)))
    if told:  # equivalent hypotheses are named together
        result.causes.append(NamedCause(" or ".join(sorted({each.name for each in told})),
                                        ", or equally ".join(each.detail for each in told), told[0].mend))
        result.told = True
        return result
    if stuck := of_run.clamped(first.states, rounding=CONSTANT):
        result.causes.append(NamedCause("clamp", f"{stuck} in the first {scene.duration:.3g} s", of_run.UNCLAMPED))
        result.told = True
        return result
    report = _reports([each for each, _ in observations], result)
    shown = [undone(each, forces, report) for each, forces in observations]
    coupled = of_joints.mimics(shown)
    if coupled is not None:
        result.tried += 1
        result.evidence.append(coupled[1])
        if coupled[1].holds:
            result.causes += coupled[0]
            result.told = True
            return result
    elsewhere = of_joints.elsewhere(shown)
    result.tried += bool(scene.joints)
    if elsewhere is not None:
        result.causes += elsewhere[0]
        result.evidence.append(elsewhere[1])
        result.told = True
        return result
    _frozen(shown, result)
    _starts(shown, result)
    result.soft = of_joints.gives_way(shown[0], result.absent)
    _accelerations(shown, result)
    return result


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


def _reports(observations: list[Observation], result: ModelFinding) -> misreadings.Report | None:
    """The misreport without which velocities are the derivatives of poses, if they are not as reported."""
    def worst(report: misreadings.Report | None) -> tuple[float, float]:
        pairs = []
        for each in observations:
            states = each.states if report is None else report.undo(each.states)
            interval = each.scene.duration / (each.scene.samples - 1)
            gap, error = mismatch(states, interval, each.scale)
            pairs.append((gap, error + AMPLIFIED * each.noise / (interval * each.scale.rate)))
        return max(pairs, key=lambda pair: pair[0] - fit.EXPLAINED * pair[1])

    gap, noise = worst(None)
    limit = max(fit.EXPLAINED * noise, FAITHFUL)
    if gap <= limit:
        return None
    fitting = []
    for report in misreadings.REPORTS:
        after, noise = worst(report)
        good = after <= max(fit.EXPLAINED * noise, FAITHFUL)
        result.evidence.append(Evidence(f"{report.cause}: {report.detail}", "report", gap, after,
                                        "velocities against derivatives of poses, over W", holds=good))
        result.tried += 1
        fitting += [report] if good else []
    if len(fitting) == 1:
        report = fitting[0]
        result.reported = report
        result.causes.append(NamedCause(report.cause, report.detail, "report states in the common convention: x, v in "
                                        "world axes, R from body to world, w in body axes"))
        return report
    result.unexplained.append("velocities are not the derivatives of the poses")
    return None


def _frozen(shown: list[Shown], result: ModelFinding) -> None:
    """Name a body that always stays at rest as missing in the engine's model."""
    moves = np.max([np.abs(each.observation.y - each.observation.y[0]).max(axis=(0, 2)) for each in shown], axis=0)
    still = [int(k) for k in np.flatnonzero(moves <= FAITHFUL)]
    scene = shown[0].observation.scene
    expected = Accelerations(points_of(shown[0]))(of_scene(scene))
    moving = [k for k in still if scene.v0[k].any() or scene.w0[k].any() or np.abs(expected[:, k]).max() > FAITHFUL]
    if len(moving) == 1 and scene.n > 1 and all(joint.parent != moving[0] for joint in scene.joints):
        result.absent = moving[0]
        body = scene.bodies[result.absent]
        result.causes.append(NamedCause("missing body", f"body {body.name!r} never moves", f"check that body "
                                        f"{body.name!r} reaches the engine"))
        result.evidence.append(Evidence("missing body", "model", None, float(moves[moving[0]]), "largest change of the "
                                        "body's normalised state", f"body {body.name!r}", True))


# --- where it starts --------------------------------------------------------------------------------------------------


def _starts(shown: list[Shown], result: ModelFinding) -> None:
    """Name the misreading that leads to the engine's starts, if they are not the scene's."""
    observations = [each.observation for each in shown]
    limit = FAITHFUL + max(fit.EXPLAINED * each.noise for each in observations)

    def worst(attitude: misreadings.Misreading | None, spin: misreadings.Misreading | None, mode: str) -> float:
        return max(misreadings.gap(each, *misreadings.misread(each.scene, attitude, spin, mode), result.absent)
                   for each in observations)

    before = worst(None, None, "bodies")
    if before <= limit:
        return
    fitting = []
    for attitude, spin in list(itertools.product((None, *misreadings.ATTITUDES), (None, *misreadings.SPINS)))[1:]:
        chosen = [each for each in (attitude, spin) if each is not None]
        after, mode = min((worst(attitude, spin, mode), mode) for mode in misreadings.MODES)
        result.tried += 1
        if after <= limit or len(chosen) == 1:
            text = " and ".join(f"{each.cause}: {each.detail}" for each in chosen)
            result.evidence.append(Evidence(text, "start", before, after, "start against the scene's, normalised",
                                            holds=after <= limit))
        if after <= limit:
            fitting.append((attitude, spin, mode, chosen))
    fewest = min((len(each[3]) for each in fitting), default=0)
    fitting = [each for each in fitting if len(each[3]) == fewest]
    names = {tuple(each.cause for each in chosen) for *_, chosen in fitting}
    if len(names) != 1:
        result.unexplained.append("the start is not the scene's")
        result.candidates += sorted(" and ".join(each) for each in names)
        return
    attitude, spin, mode, chosen = fitting[0]
    result.start = attitude, spin, mode
    result.causes += [NamedCause(each.cause, each.detail, "convert the initial state to the engine's convention")
                      for each in chosen]


# --- how it moves -----------------------------------------------------------------------------------------------------


def _accelerations(shown: list[Shown], result: ModelFinding) -> None:
    """Fit altered models to the accelerations."""
    scene, absent = shown[0].observation.scene, result.absent
    full, thin = (data(shown, absent, result.soft, stride) for stride in (1, fit.THIN))
    hard = full if not result.soft else data(shown, absent, False, 1)
    wrong, remaining = hard.before, full.before
    quantity = "accelerations, largest difference over its noise"
    if wrong <= fit.SEEN and not result.soft:
        if wrong > fit.EXPLAINED:
            result.unexplained.append("accelerations differ by little more than their noise")
        return
    # An inertia may be converted before attitudes are misread.
    candidates = alterations(scene, any(np.abs(each.states.R[0] - each.observation.scene.R0).max() > FAITHFUL
                                        for each in shown))
    if result.soft:
        fits, _ = fit.search(hard, data(shown, absent, False, fit.THIN), candidates, pairing=False)
        result.tried += len(candidates)
        if fits:
            result.soft = False
            result.evidence += [_evidence(each, wrong, quantity) for each in fits]
            _name(fits, full, result)
            return
        if not of_joints.lawful(shown, result.absent):
            result.soft = False
            result.unexplained.append("joints open, but not as forces of their opening and its rate would let them")
            return
        opening = of_joints.opening(shown[0], result.absent)
        result.evidence.append(Evidence("soft constraint", "constraint", wrong, remaining, quantity, opening,
                                        remaining <= fit.EXPLAINED, "with constraint forces of any law"))
        result.causes.append(NamedCause("soft constraint", opening, "tighten the joints, or use coordinates or "
                                        "multipliers that enforce them"))
        result.tried += 1
        if remaining <= fit.EXPLAINED:
            return
    fits, singles = fit.search(full, thin, candidates)
    result.tried += len(candidates)
    if failed := sum(not np.isfinite(each.left) for each in singles):
        result.evidence.append(Evidence("left out", "model", None, None, quantity,
                                        f"{failed} of {len(singles)} alterations, of which the scene makes no sense"))
    for each in sorted(singles, key=lambda each: each.left)[:8]:
        result.evidence.append(_evidence(each, remaining, quantity))
    if not fits:
        result.unexplained.append("accelerations differ from the model's")
        return
    if len(fits[0].causes) > 1:
        result.evidence += [_evidence(each, remaining, quantity) for each in fits]
    _name(fits, full, result)


def _evidence(tried: fit.Fit, before: float, quantity: str) -> Evidence:
    pairs = list(zip(tried.causes, tried.theta, strict=True))
    return Evidence(" and ".join(cause.name(theta) for cause, theta in pairs), "model", before, tried.left, quantity,
                    "; ".join(cause.words(theta) for cause, theta in pairs), tried.explains)


def _name(fits: list[fit.Fit], data: fit.Data, result: ModelFinding) -> None:
    fits = [each for each in fits if each.mistakes == min(other.mistakes for other in fits)]
    fits = [each for each in fits if _magnitudes(each) == min(_magnitudes(other) for other in fits)]
    names = sorted({each.names for each in fits})
    best = min(fits, key=lambda each: each.left)
    if len(names) > ALTERNATIVES:
        result.unexplained.append("more than one cause explains the accelerations")
        result.candidates += [" and ".join(each) for each in names]
        return
    if len(names) > 1:
        said = [" and ".join(cause.words(theta) for cause, theta in zip(each.causes, each.theta, strict=True))
                for each in fits]
        result.causes.append(NamedCause(" or ".join(" and ".join(each) for each in names),
                                        ", or equally ".join(dict.fromkeys(said)), best.causes[0].mend))
    else:
        result.causes += [NamedCause(cause.name(theta), cause.words(theta), cause.mend)
                          for cause, theta in zip(best.causes, best.theta, strict=True)]
    result.model = data.right[0]
    for cause, theta in zip(best.causes, best.theta, strict=True):
        result.model = cause.apply(result.model, theta)


def _magnitudes(tried: fit.Fit) -> int:
    """Number of fitted numbers of a combination of causes. Special magnitudes do not count."""
    count = 0
    for cause, theta in zip(tried.causes, tried.theta, strict=True):
        special = any(np.array_equal(theta, value) for value in cause.special(theta))
        count += (1 if special and cause.free > 1 and cause.name(theta) == "gravity size" else 0 if special
                  else cause.free)
    return count
