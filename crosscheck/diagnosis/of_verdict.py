"""The last test if nothing was found: the run and the order study of `crosscheck verify`, and their verdict."""

from __future__ import annotations

import contextlib

from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.diagnosis.observe import Subject
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.document import Finding, Record, extended
from crosscheck.errors import Unsupported
from crosscheck.judge.plan import PLANS, PROFILES, plan_without_truth
from crosscheck.judge.verdict import word, worst
from crosscheck.references import TruthError, truth
from crosscheck.running.attempt import Ran, Refused, attempt
from crosscheck.scene.file import load_scene, scene_names
from crosscheck.scene.model import Scene
from crosscheck.verification.cell import judge_run, settled
from crosscheck.verification.order_study import order_study
from crosscheck.verification.scene_truth import plan_within
from crosscheck.verification.task import Cell, windowed

MOST_SECONDS = 20.0
"""Limit of processor time (s) of the order study, as in the profile with every scene."""


def judged(subject: Subject, scene: Scene, step: float | None) -> Record:
    """The verdict of `crosscheck verify` on a method and a scene, at this step (s); None: that of the plan."""
    own = subject.engine.name in adapters.names() and (
        adapters.get(subject.engine.name) is subject.engine)
    with contextlib.nullcontext(subject.engine.name) if own else adapters.lent(subject.engine) as name:
        return _judged(subject, scene, step, name)


def _judged(subject: Subject, scene: Scene, step: float | None, name: str) -> Record:
    built_in = scene.name in scene_names() and load_scene(scene.name).hash == scene.hash
    try:
        plan, known = plan_within(scene, scene.name if built_in else "", PROFILES["default"].most_steps), True
    except (TruthError, Unsupported):  # the scene has no truth
        plan, known = PLANS.get(scene.name) or plan_without_truth(scene), False
    order = subject.order(scene)
    size = None if order is None else step or plan.step(order)
    rtol = plan.rtol if order is None else None
    way = replace(subject.way, engine=name, step=size, rtol=rtol)
    run = extended(Record, way, scene=scene.name, version=subject.engine.version(), documented_order=order)
    whole = scene.replace(duration=min(plan.duration or scene.duration, scene.duration), samples=plan.samples)
    outcome = attempt(whole, way)
    if not isinstance(outcome, Ran):
        reason = outcome.why.replace(name, subject.engine.name)
        return replace(run, outcome="unsupported" if isinstance(outcome, Refused) else "fail", message=reason,
                       findings=[Finding("run", "fail", None, None, "", "a run has to reach its end", reason)])
    main = judge_run(run, whole, outcome.trajectory, subject.held(scene), plan.window)
    if not known or main.outcome == "fail":
        return main
    cell = Cell(scene.name, way, plan, most_seconds=MOST_SECONDS)
    short = windowed(scene, plan.window)
    study = order_study(cell, order, short, truth(short), main.findings, False)
    orders = settled(main, study.findings)
    return orders if orders.outcome in ("fail", "known") else main


def add(subject: Subject, scene: Scene, step: float | None, answer: Explanation) -> None:
    """Add the verdict to an answer that has found nothing, and what fails in it."""
    verdict = judged(subject, scene, step)
    reasons = dict.fromkeys(finding.detail for finding in verdict.findings if finding.status == "known")
    answer.verdict = "; ".join([word(verdict), *reasons])
    failing = [finding for finding in verdict.findings if finding.status == "fail"]
    answer.evidence += [Evidence(f"verdict: {finding.kind}", "report", finding.value, finding.bound,
                                 f"the finding of crosscheck verify ({finding.unit}), and its bound", finding.detail)
                        for finding in failing]
    answer.causes += _causes({finding.kind: finding for finding in failing})
    first = worst(failing)
    unexplained = []
    if first is not None and not answer.causes:
        figures = "" if first.value is None or first.bound is None else (
            f" {first.value:.2g} {first.unit}, bound {first.bound:.2g}")
        unexplained = [f"crosscheck verify rejects it: {first.kind}{figures}; {first.detail or verdict.message}"]
    answer.conclude(unexplained)


CLAIMS = (
    ("open {0} level", ("level position", "level velocity", "level acceleration"),
     "the engine claims to hold its constraints at this level, and they are open by {value:.2g} {unit}",
     "project or solve at this level too, or do not claim it"),
    ("reported accelerations", ("acceleration", "angular acceleration"),
     "{kind} off by {value:.2g} {unit} from that of the reported state ({detail})",
     "report the accelerations that belong to the states, in the common convention"),
    ("reported multipliers", ("reaction", "reaction torque"),
     "{kind} off by {value:.2g} {unit} from that of the reported state ({detail})",
     "report the multipliers of f = M du/dt + G^T lam that belong to the states, rows as in the scene"),
    ("loose tolerance", ("rtol",), "errors are {value:.2g} times as large as the tolerance allows ({detail})",
     "keep to the rtol that is asked for, over the whole step and relative to the size of the states"),
    ("attitudes off the group", ("orthogonality",), "R^T R - I reaches {value:.2g}",
     "move attitudes by rotations, or normalise them"),
)
"""(name, kinds of findings, text, mend) of findings about claims and reports, which name their cause by themselves."""


def _causes(failing: dict[str, Finding]) -> list[NamedCause]:
    """The causes that failing findings name, if all of them are about claims and reports."""
    claimed = failing.keys() <= {kind for _, kinds, _, _ in CLAIMS for kind in kinds}
    if not claimed or any(finding.why.startswith("not enforced") for finding in failing.values()):
        return []
    if failing.keys() & {"acceleration", "angular acceleration"}:  # wrong ones violate the constraints, too
        failing = {kind: finding for kind, finding in failing.items() if kind != "level acceleration"}
    return [NamedCause(name.format(kind.removeprefix("level ")),
                       text.format(kind=kind, value=finding.value, unit=finding.unit, detail=finding.detail), mend)
            for name, kinds, text, mend in CLAIMS for kind, finding in failing.items() if kind in kinds]
