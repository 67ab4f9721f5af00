"""Prepare a scene: compute the truths that its cells need, choose its plan, and describe it for the report.

Scenes without a plan in `crosscheck.judge.plan` get one within a budget of steps: `plan_from_truth` chooses steps for a
bound of a hundredth of the scene's size, which may take millions of steps of a first-order method. Within a budget the
bound may be wider. If it would be too wide, the motion is judged over a shorter time.
"""

from __future__ import annotations

import math

from msgspec.structs import replace

from crosscheck import references
from crosscheck.document import AS_PLANNED, Asked, Plan, SceneTruth, Truth
from crosscheck.errors import Unsupported, said
from crosscheck.judge import tolerances
from crosscheck.judge.plan import PLANS, SHARE, STUDY_SAMPLES, halved, parts, plan_from_truth, plan_without_truth
from crosscheck.references import TruthError
from crosscheck.references.base import GROWN
from crosscheck.references.maximal import fastest
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification.curves import scene_curves
from crosscheck.verification.task import load, windowed


def prepare_truth(task: tuple[str, bool, int], asked: Asked = AS_PLANNED) -> SceneTruth:
    """Compute the truths that a scene's cells need, or find them in the cache, and choose its plan.

    `task` is the name or path, whether main runs cover the whole scene, and their largest number of steps (see
    `plan_within`). If the scene has no truth, `no_truth` says why, and `disputed` whether two
    formulations disagree.
    """
    name, whole, most_steps = task
    given = load_scene(name)

    def described(scene: Scene, plan: Plan) -> SceneTruth:
        return SceneTruth(name=name, title=scene.name, description=scene.description, source=scene.source,
                          hash=scene.hash, bodies=[body.name for body in scene.bodies], duration=scene.duration,
                          plan=plan, truth=None, scales=None)

    def prepared(extent: Extent | None = None) -> tuple[Plan, Scene, references.Reference]:
        try:
            plan = _as_asked(plan_within(given, name, most_steps, extent), asked)
            scene = load(name, plan, whole)
            return plan, scene, references.truth(scene)
        except references.Chaotic as early:  # before the first output time, where a monitor fires
            if extent is not None or asked.duration is not None:
                raise
            return prepared((early.horizon, early.horizon))

    try:
        plan, scene, reference = prepared()
    except (Unsupported, TruthError) as error:
        plan = _as_asked(PLANS.get(name) or plan_without_truth(given), asked)
        return replace(described(given, plan), no_truth=said(error),
                       curves=scene_curves(load(name, plan, whole), None), disputed=not isinstance(error, Unsupported))
    dense = references.dense(scene)  # which may know more than the duration
    ends = dense.horizon <= scene.duration * (1 + 1e-12) and dense.horizon_cause != GROWN
    known = Truth(source=reference.source, second_source=reference.second_source,
                  disagreement=reference.disagreement, allowed=reference.allowed,
                  amplification=reference.amplification, error=reference.error,
                  horizon=reference.horizon, outvoted=reference.outvoted,
                  events=reference.events[:MOST_EVENTS],
                  ended=dense.horizon_cause if ends else "")
    return replace(described(scene, plan), truth=known, scales=tolerances.scales(scene, reference),
                   rounding=tolerances.rounding_levels(scene, reference), curves=scene_curves(scene, reference))


def _as_asked(plan: Plan, asked: Asked) -> Plan:
    """The plan with the step and the duration of main runs that the user asked for."""
    if asked.step is not None:
        plan = replace(plan, steps={1: asked.step}, budgeted=True)
    return plan if asked.duration is None else replace(plan, duration=asked.duration)


MOST_EVENTS = 200
"""Events of a motion that a report lists."""

WINDOWS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
"""Lengths (s) of the judged beginning. They are tried from the longest on."""

WIDEST = 0.5
"""Largest bound as a share of the scene's size. A bound beyond the whole size would judge nothing."""

Extent = tuple[float, float | None]
"""First window to try and duration of the main runs or None for the scene's, s."""

EXTENTS: dict[str, Extent] = {
    # The rope magnifies a perturbation thirtyfold in its first 0.05 s, and 0.2 s of truth for 64 bodies take over a
    # minute.
    "chain_64": (0.02, 0.1),
    # Joint angles that whip: at first order only the beginning can be judged, and longer windows need not be tried.
    "chain_8": (0.2, None),
    "slider_crank": (0.1, None),
    "stiff_spring": (0.5, None),
    # The fast decay is over at once and the slow one in 0.1 s; what follows is a pendulum in steps of 5e-5 s.
    "stiff_damped": (0.1, 0.2),
    # At its own length the budget leaves steps too coarse for first order; next to its singular positions truth loses
    # digits, 1.7e-12 at 4.9 s.
    "double_four_bar": (1.0, 4.0),
    # 24 turns of the spin, of which first order can judge half a turn.
    "fast_top_1500": (0.02, 0.1),
}
"""Extents of scenes that would take too long."""


def plan_within(scene: Scene, name: str, most_steps: int, extent: Extent | None = None) -> Plan:
    """The plan of a scene whose main runs take at most `most_steps` / sqrt(bodies) steps, at any order.

    The root is a compromise: the cost of a step grows with the number of bodies, but a part of it is fixed. The truth
    of the chosen window is computed or read from the cache. A scene in `PLANS` keeps its plan.
    """
    if name in PLANS:
        return PLANS[name]
    first, duration = extent or EXTENTS.get(name, (WINDOWS[0], None))
    # The next larger step with one digit, or 1.5, times a power of ten.
    shortest = (duration or scene.duration) * math.sqrt(scene.n) / most_steps
    power = 10.0 ** math.floor(math.log10(shortest))
    digit = min(digit for digit in (1, 1.5, 2, 3, 5, 7, 10) if digit * power >= shortest * (1 - 1e-12))
    shortest = float(f"{digit * power:.2g}")
    longest = longest_step(scene)
    samples = max(26, 251 // max(1, scene.n // 2))
    affordable = most_steps / math.sqrt(scene.n)
    # Windows whose order studies would need too many steps are left out: ladders end at an eighth of `longest`.
    lengths = [length for length in WINDOWS if length <= first and 8 * length / longest <= affordable]
    for window in lengths or WINDOWS[-1:]:
        short = windowed(scene, window)
        wanted = plan_from_truth(short, references.truth(short))
        steps = {order: min(max(step, shortest), longest) for order, step in wanted.steps.items()}
        ladders = {order: _ladder(order, step, wanted.window / (STUDY_SAMPLES - 1), longest)
                   for order, step in steps.items()}
        plan = replace(wanted, steps=steps, ladders=ladders, samples=samples, duration=duration,
                                   budgeted=True)
        if plan.most_steps <= affordable and all(
                SHARE * (steps[order] / step) ** order <= WIDEST for order, step in wanted.steps.items()):
            break
    return plan


def longest_step(scene: Scene) -> float:
    """The inverse (s) of the fastest rate of decay or oscillation of a scene with springs, at its start.

    Explicit methods are unstable at much longer steps, and no method shows its order there.
    """
    rate = fastest(scene)
    # Two digits, because the step is written into commands.
    return float(f"{1.0 / rate:.1e}") if rate else math.inf


def _ladder(order: int, step: float, interval: float, longest: float) -> tuple[float, ...]:
    """Steps (s) of the order study, from the step of the main run. None exceeds `longest` or `interval`, the time (s)
    between two output times.

    From order 4 on, four times the step is too coarse for the asymptotic range: a Runge-Kutta method shows 3.5 there,
    then 3.8 and 3.9. From order 6 on, halving is too much: the fourth step would be in rounding.
    """
    if order < 4:
        return halved(min(4 * step, interval, longest))
    if order < 6:
        return halved(min(2 * step, interval, longest))
    count = max(1, math.ceil(interval / min(4 * step, longest) - 1e-9))
    counts = [count]
    for factor in (4 / 3, 5 / 3, 2):
        counts.append(max(counts[-1] + 1, round(factor * count)))
    return parts(interval, *counts)
