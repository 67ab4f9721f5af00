"""Prepare a scene: compute the truths that its cells need, choose its plan, and describe it for the report."""

from __future__ import annotations

from msgspec.structs import replace

from crosscheck.document import AS_PLANNED, Asked, Plan, SceneTruth, Truth
from crosscheck.errors import Unsupported, said
from crosscheck.judge import tolerances
from crosscheck.judge.plan import PLANS, plan_without_truth
from crosscheck.scene.model import Scene
from crosscheck.verification.curves import scene_curves
from crosscheck.verification.task import load


def prepare_truth(task: tuple[str, bool, int], asked: Asked = AS_PLANNED) -> SceneTruth:
    """Compute the truths that a scene's cells need, or find them in the cache, and choose its plan.

    `task` is the name or path, whether main runs cover the whole scene, and their largest number of steps (see
    `crosscheck.verification.budget`). If the scene has no truth, `no_truth` says why, and `disputed` whether two
    formulations disagree.
    """
    from crosscheck.references import TruthError, truth
    from crosscheck.scene.file import load_scene
    from crosscheck.verification.budget import plan_within

    name, whole, most_steps = task
    given = load_scene(name)

    def described(scene: Scene, plan: Plan) -> SceneTruth:
        return SceneTruth(name=name, title=scene.name, description=scene.description, source=scene.source,
                          hash=scene.hash, bodies=[body.name for body in scene.bodies], duration=scene.duration,
                          plan=plan, truth=None, scales=None)

    try:
        plan = _as_asked(plan_within(given, name, most_steps), asked)
        scene = load(name, plan, whole)
        reference = truth(scene)
    except (Unsupported, TruthError) as error:
        plan = _as_asked(PLANS.get(name) or plan_without_truth(given), asked)
        return replace(described(given, plan), no_truth=said(error),
                       curves=scene_curves(load(name, plan, whole), None), disputed=not isinstance(error, Unsupported))
    known = Truth(source=reference.source, second_source=reference.second_source,
                  disagreement=reference.disagreement, allowed=reference.allowed,
                  amplification=reference.amplification, error=reference.error,
                  horizon=reference.horizon, outvoted=reference.outvoted)
    return replace(described(scene, plan), truth=known, scales=tolerances.scales(scene, reference),
                   rounding=tolerances.rounding_levels(scene, reference), curves=scene_curves(scene, reference))


def _as_asked(plan: Plan, asked: Asked) -> Plan:
    """The plan with the step and the duration of main runs that the user asked for."""
    if asked.step is not None:
        plan = replace(plan, steps={1: asked.step}, practical=None, budgeted=True)
    return plan if asked.duration is None else replace(plan, duration=asked.duration)
