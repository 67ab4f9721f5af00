"""The last test if nothing was found: the run of `crosscheck verify`, and its verdict."""

from __future__ import annotations

import contextlib

import numpy as np
from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.compare.apart import STATE
from crosscheck.diagnosis.fit import CLEAR
from crosscheck.diagnosis.observe import FINER, Subject, scale_of, window
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.document import Finding, Record, extended
from crosscheck.errors import Unsupported
from crosscheck.judge.segments import reactions_of
from crosscheck.judge.verdict import word, worst
from crosscheck.references import TruthError, truth
from crosscheck.running.attempt import Ran, Refused, attempt
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.verification.cell import judge_run
from crosscheck.verification.plan import PROFILES, plan_of


def judged(subject: Subject, scene: Scene, step: float | None) -> Record:
    """The verdict of `crosscheck verify` on a method and a scene, at this step (s); None: that of the plan."""
    own = subject.engine.name in adapters.names() and (
        adapters.get(subject.engine.name) is subject.engine)
    with contextlib.nullcontext(subject.engine.name) if own else adapters.lent(subject.engine) as name:
        return _judged(subject, scene, step, name)


def _judged(subject: Subject, scene: Scene, step: float | None, name: str) -> Record:
    most = PROFILES["full"].most_steps
    plan = plan_of(scene, None, most)
    whole = scene.replace(duration=min(plan.duration or scene.duration, scene.duration), samples=plan.samples)
    with contextlib.suppress(TruthError, Unsupported):
        plan = plan_of(scene, truth(whole).states, most)
    order = subject.order(scene)
    size = None if order is None else step or plan.step(order)
    way = replace(subject.way, engine=name, step=size, rtol=plan.rtol if order is None else None)
    run = extended(Record, way, scene=scene.name, version=subject.engine.version(), documented_order=order)
    outcome = attempt(whole, way)
    if not isinstance(outcome, Ran):
        reason = outcome.why.replace(name, subject.engine.name)
        return replace(run, outcome="unsupported" if isinstance(outcome, Refused) else "fail", message=reason,
                       findings=[Finding.ended_early(reason)])
    return judge_run(run, whole, outcome.trajectory, subject.held(scene))


def add(subject: Subject, scene: Scene, step: float | None, answer: Explanation) -> None:
    """Add the verdict to an answer that has found nothing, and what fails in it."""
    verdict = judged(subject, scene, step)
    reasons = dict.fromkeys(finding.why for finding in verdict.findings if finding.status == "known")
    answer.verdict = "; ".join([word(verdict), *reasons])
    failing = [finding for finding in verdict.findings if finding.status == "fail"]
    answer.evidence += [Evidence(f"verdict: {finding.kind}", "report", finding.value, finding.bound,
                                 f"the finding of crosscheck verify ({finding.unit}), and its bound", finding.detail)
                        for finding in failing]
    answer.causes += [REVERSED if cause.name == MULTIPLIERS and _reversed(subject, scene, verdict) else cause
                      for cause in _causes({finding.kind: finding for finding in failing})]
    first = worst(failing)
    if first is not None and not answer.causes:
        figures = "" if first.value is None or first.bound is None else (
            f" {first.value:.2g} {first.unit}, bound {first.bound:.2g}")
        answer.unexplained.append(f"crosscheck verify rejects it: {first.kind}{figures}; "
                                  f"{first.detail or verdict.message}")


MULTIPLIERS = "reported multipliers"
REVERSED = NamedCause("reversed multipliers", "the multipliers reported are those of M du/dt = f + G^T lam: all have "
                      "the other sign", "report the multipliers of f = M du/dt + G^T lam")


def _reversed(subject: Subject, scene: Scene, verdict: Record) -> bool:
    """Whether the multipliers are those of the reported states with the other sign."""
    brief = window(scene, scale_of(scene))
    step = None if verdict.step is None else brief.interval / FINER
    states = subject.run(brief, step, verdict.rtol).states
    assert states.lam is not None  # they were judged
    right = mechanics.index1(scene, states.x, states.R, states.v, states.w, mechanics.torsion_angles(scene, states),
                             states.t)[2]
    told, exact = (np.concatenate(reactions_of(scene, states, lam), axis=2)[1:] for lam in (states.lam, right))
    return bool(np.abs(told + exact).max() <= CLEAR * np.abs(told - exact).max())


CLAIMS = (
    ("open {level} level", ("promise level position", "promise level velocity", "promise level acceleration"),
     "the engine claims to hold its constraints at this level, and they are open by {value:.2g} {unit}",
     "project or solve at this level too, or do not claim it"),
    ("reported accelerations", ("promise acceleration", "promise angular acceleration"),
     "{row} off by {value:.2g} {unit} from that of the reported state ({detail})",
     "report the accelerations that belong to the states, in the common convention"),
    (MULTIPLIERS, ("limit reaction force", "limit reaction torque"),
     "{row} off by {value:.2g} {unit} while the motion is right ({detail})",
     "report the multipliers of f = M du/dt + G^T lam that belong to the states, rows as in the scene"),
    ("loose tolerance", ("promise position", "promise attitude", "promise velocity", "promise angular velocity"),
     "{row} is off by {value:.2g} {unit}, more than its steps at the tolerance allow ({detail})",
     "keep to the rtol that is asked for, over the whole step and relative to the size of the states"),
    ("attitudes off the group", ("promise orthogonality",), "R^T R - I reaches {value:.2g}",
     "move attitudes by rotations, or normalise them"),
)
"""(name, kinds of findings, text, mend) of findings about claims and reports, which name their cause by themselves."""


def _causes(failing: dict[str, Finding]) -> list[NamedCause]:
    """The causes that failing findings name, if all of them are about claims and reports."""
    reported = {finding.row for finding in failing.values() if finding.about == "promise"} - {*STATE}
    failing = {kind: finding for kind, finding in failing.items()  # what is reported wrongly has a wrong limit, too
               if finding.about == "promise" or finding.row.removeprefix("limit ") not in reported}
    if not failing.keys() <= {kind for _, kinds, _, _ in CLAIMS for kind in kinds}:
        return []
    if failing.keys() & {"promise acceleration", "promise angular acceleration"}:  # wrong ones violate the constraints
        failing = {kind: finding for kind, finding in failing.items() if kind != "promise level acceleration"}
    named = {name.format(level=finding.row.removeprefix("level ")): (text, mend, finding)
             for name, kinds, text, mend in CLAIMS for kind, finding in failing.items() if kind in kinds}
    return [NamedCause(name, text.format(row=finding.row.removeprefix("limit "), value=finding.value, unit=finding.unit,
                                         detail=finding.detail), mend) for name, (text, mend, finding) in named.items()]
