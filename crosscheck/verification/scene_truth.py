"""Prepare a scene: compute the truth that its cells need, choose its plan, and describe it for the report."""

from __future__ import annotations

from msgspec.structs import replace

from crosscheck import document, references
from crosscheck.compare.sizes import sizes
from crosscheck.document import AS_PLANNED, Asked, Plan, Truth
from crosscheck.errors import Unsupported, said
from crosscheck.judge.rounding import rounding_of
from crosscheck.judge.segments import end_of_truth
from crosscheck.references import TruthError
from crosscheck.references.base import ending
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.models import lasts_by_default
from crosscheck.verification.cell import MANY
from crosscheck.verification.curves import scene_curves
from crosscheck.verification.plan import outputs, plan_of
from crosscheck.verification.task import load


def prepare_truth(task: tuple[str, float | None, int], asked: Asked = AS_PLANNED) -> document.Scene:
    """Compute the truth that a scene's cells need, or find it in the cache, and choose the plan.

    `task` is the name or path, the longest duration (s) of runs or None, and their largest number of steps (see
    `plan_of`). If the scene has no truth, `no_truth` says why, and `disputed` whether two formulations disagree.
    """
    name, most_seconds, most_steps = task
    given = load_scene(name)

    def planned(motion: references.Reference | None, most: float | None) -> Plan:
        return plan_of(given, None if motion is None else motion.states, most_steps, most, asked)

    def described(scene: Scene, plan: Plan) -> document.Scene:
        return document.Scene(name=name, title=scene.name, description=scene.description, source=scene.source,
                          hash=scene.hash, bodies=[body.name for body in scene.bodies], duration=scene.duration,
                          plan=plan, truth=None, sizes=None, trust="", recommended=None)

    first = load(name, planned(None, most_seconds))
    try:
        reference = ends = None
        try:
            reference = references.truth(first)
        except references.Chaotic:  # before the first output time, where a monitor fires
            if asked.duration is not None:
                raise
        dense = references.dense(first)
        if (end := end_of_truth(dense)) <= first.duration * (1 + 1e-12):
            ends = end, dense.horizon_cause
        if reference is None or (ends is not None and asked.duration is None):
            most_seconds = dense.horizon  # outputs beyond the end of a claim show nothing
            reference = references.truth(load(name, planned(None, most_seconds)))
    except (Unsupported, TruthError) as error:
        plan = planned(None, most_seconds)
        return replace(described(given, plan), no_truth=said(error), curves=scene_curves(load(name, plan), None),
                       disputed=not isinstance(error, Unsupported))
    plan = planned(reference, most_seconds)
    scene = load(name, plan)
    known = Truth(source=reference.source, second_source=reference.second_source,
                  disagreement=reference.disagreement, allowed=reference.allowed,
                  amplification=reference.amplification, error=reference.error,
                  horizon=reference.horizon,
                  events=reference.events[:MOST_EVENTS],
                  ended=ends[1] if ends else "")
    if ends is not None and asked.duration is None and not lasts_by_default(given):
        plan = replace(plan, covered=scene.duration / first.duration, ends=ends)
    own = sizes(scene, reference.states)
    return replace(described(scene, plan), truth=known, sizes=own, rounding=rounding_of(scene, reference, own),
                   curves=scene_curves(scene, reference))


def until_its_end(scene: Scene, step: float | None = None) -> tuple[Scene, str]:
    """The scene of a model file up to where a monitor ends its truth, and why, if nobody gave its duration.

    A fixed `step` (s) is kept.
    """
    if not lasts_by_default(scene) or scene.n > MANY:
        return scene, ""
    try:
        dense = references.dense(scene)
    except (Unsupported, TruthError):
        return scene, ""
    if (end := end_of_truth(dense)) >= scene.duration:
        return scene, ""
    samples, last = (scene.samples, end) if step is None else outputs(step, end, scene.samples, True)
    return scene.replace(duration=last, samples=samples), ending(end, dense.horizon_cause)


MOST_EVENTS = 200
"""Events of a motion that a report lists."""
