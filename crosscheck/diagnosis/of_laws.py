"""Differences of the force laws of joints: the engine's motion against those of scenes with one altered law.

Events make accelerations useless here. So the whole motion is compared with that of each altered scene, by lieeuler's
Taylor series with events located, and a number that is unknown is fitted to it.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crosscheck.diagnosis.observe import Silent, Subject
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.errors import CrosscheckError
from crosscheck.running.run import run
from crosscheck.scene.coordinates import histories
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.model import Force, Joint, Scene
from crosscheck.scene.states import Motion

STEPS, RTOLS, ACCURATE = 2000, (1e-8, 1e-10), 1e-10
"""Steps of the coarser of two runs of an engine over a scene, or their tolerances; that of altered scenes."""

LEFT, SEEN, CLEAR = 0.3, 1e-7, 0.1
"""Part of the difference of the two runs that their limit may be off by; the least difference (rad or m) that is
looked into; and what an explanation may leave of it."""

EVALUATIONS = 8
"""Most motions for the fit of a number from one start."""


@dataclasses.dataclass(frozen=True)
class Altered:
    """A scene with an altered law; where `starts` has values, one number of it is fitted from these."""

    name: str
    what: str  # with {} for the number
    alter: Callable[[float], Scene]
    starts: tuple[float, ...] = ()


def diagnose(subject: Subject, scene: Scene) -> Explanation | None:
    """The altered laws that reproduce an engine's motion; None if it is the scene's, or none does."""
    order = subject.order(scene)
    sizes = [{"rtol": rtol} for rtol in RTOLS] if order is None else [
        {"step": scene.duration / steps} for steps in (STEPS, 2 * STEPS)]
    try:
        coarse, fine = (_coordinates(scene, subject.run(scene, **size).states) for size in sizes)
    except Silent:
        return None
    seen = fine + (fine - coarse) / (2.0 ** (order or 60) - 1.0)
    noise = max(SEEN, LEFT * float(np.abs(seen - coarse).max()))

    def gap(altered: Scene) -> np.ndarray:
        try:
            moved = run(altered, "lieeuler", "taylor", rtol=ACCURATE, reduce="off", monitor=False)
        except CrosscheckError:
            return np.full(seen.size, np.inf)
        return np.ravel(_coordinates(scene, moved) - seen)

    before = float(np.abs(gap(scene)).max())
    if not noise < CLEAR * before < np.inf:
        return None
    tried = [(each, *_fitted(each, gap, before)) for each in alternatives(scene)]
    evidence = [Evidence(each.name, "law", before, left, "joint coordinates, rad or m",
                         each.what.format(f"{theta:.4g}"), left <= noise) for each, theta, left in tried
                if left < CLEAR * before]
    holding = [(bool(each.starts), left, each, theta) for each, theta, left in tried
               if left <= min(noise, CLEAR * before)]
    if not holding:
        return None
    simplest = [case for case in holding if case[0] == min(free for free, *_ in holding)]
    least = min(left for _, left, *_ in simplest)
    named = [(each, theta) for _, left, each, theta in simplest if left <= max(5.0 * least, 0.1 * noise)]
    answer = Explanation(scene.name, subject.engine.name, subject.way.method, subject.way.form, "fail", "", [], [],
                         evidence, scene.duration, before, noise, least, order, tried=len(tried))
    answer.causes.append(NamedCause(
        " or ".join(sorted({each.name for each, _ in named})),
        ", or equally ".join(each.what.format(f"{theta:.4g}") for each, theta in named),
        "compare this law in the engine's model with the scene's"))
    return answer.conclude([])


def _coordinates(scene: Scene, states: Motion) -> np.ndarray:
    """(T, coordinates) of all joints."""
    count, joints = len(states.t), histories(scene, states).values()
    return np.asarray(np.hstack([each.position.reshape(count, -1) for each in joints]))


def _fitted(each: Altered, gap: Callable[[Scene], np.ndarray], before: float) -> tuple[float, float]:
    """The number of an altered law, and the largest difference that it leaves. It is fitted where a start helps."""
    def left(theta: float) -> float:
        return float(np.abs(gap(each.alter(theta))).max())

    if not each.starts:
        return 0.0, left(0.0)
    least, start = min((left(theta), theta) for theta in each.starts)
    if not SEEN < least < before:
        return start, least

    def residual(theta: np.ndarray) -> np.ndarray:
        return np.asarray(np.nan_to_num(gap(each.alter(float(theta[0]))), posinf=1e3))

    from scipy.optimize import least_squares

    solution = least_squares(residual, [start], x_scale=abs(start) or 0.1, diff_step=1e-5, max_nfev=EVALUATIONS,
                          xtol=1e-12, ftol=1e-14)
    left_over = float(np.abs(solution.fun).max())
    return (float(solution.x[0]), left_over) if left_over < least else (start, least)


def alternatives(scene: Scene) -> Iterator[Altered]:
    """The scenes with one altered law."""
    for joint in scene.joints:
        if joint.kind.coordinates in (("turn",), ("slide",)):
            for friction in filter(None, joint.dry_friction):
                yield from _of_friction(scene, joint, friction)
            for limits in filter(None, joint.limits):
                yield from _of_limits(scene, joint, limits)
    rubbing = [joint for joint in scene.joints if any(joint.dry_friction)]
    for one, other in itertools.combinations(rubbing, 2):
        yield Altered("friction on the wrong joints", f"that of {one.name} and {other.name} exchanged",
                      functools.partial(_exchanged, scene, one, other))
    for index, force in enumerate(scene.forces):
        if force.type == "servo":
            yield from _of_servo(scene, index, force)


def _exchanged(scene: Scene, one: Joint, other: Joint, _: float) -> Scene:
    return _joint(_joint(scene, one, dry_friction=other.dry_friction), other, dry_friction=one.dry_friction)


def _of_friction(scene: Scene, joint: Joint, law: DryFriction) -> Iterator[Altered]:
    def given(sliding: float, static: float) -> Scene:
        return _joint(scene, joint, dry_friction=(DryFriction(sliding, max(sliding, static)),))

    def instead(**keys: object) -> Scene:
        return _joint(scene, joint, dry_friction=()).replace(
            forces=(*scene.forces, Force("servo", None, None, joint.name, keys)))

    c, s, at = law.sliding, law.static, f"joint {joint.name}"
    yield Altered("no friction", at, lambda _: _joint(scene, joint, dry_friction=()))
    yield Altered("friction", f"{at}: {{}} times", lambda k: given(k * c, k * s), (0.5, 0.95, 0.99, 1.01, 1.05, 2.0))
    yield Altered("viscous friction", f"{at}: {{}} times the rate", lambda k: instead(derivative=k), (0.5 * c, 2 * c))
    yield Altered("smooth friction", f"{at}: in proportion to the rate below {{}}", lambda k: instead(
        derivative=c / max(abs(k), 1e-3), effort_limit=(-c, c)), (0.3, 0.1, 0.01))
    yield Altered("friction as a torque", f"{at}: {{}} in one direction", lambda k: instead(feedforward=k), (c, -c))
    if s > c:
        yield Altered("static friction", f"{at}: {{}} times", lambda k: given(c, k * s), (c / s, 0.9, 1.1, 2.0))
        yield Altered("sliding friction", f"{at}: {{}} times", lambda k: given(k * c, s), (0.9, 1.1, s / c))


def _of_limits(scene: Scene, joint: Joint, law: Limits) -> Iterator[Altered]:
    def given(key: str, value: float) -> Scene:
        return _joint(scene, joint, limits=(dataclasses.replace(law, **{key: value}),))

    at = f"joint {joint.name}"
    yield Altered("no limits", at, lambda _: _joint(scene, joint, limits=()))
    for side in ("lower", "upper"):
        if np.isfinite(end := getattr(law, side)):
            yield Altered("limits", f"{at}: {side} at {{}}", functools.partial(given, side),
                          (end - 0.02, end - 0.005, end + 0.005, end + 0.02, 0.5 * end))
    if law.rigid:
        yield Altered("restitution", f"{at}: {{}}", lambda k: given("restitution", min(max(k, 0.0), 1.0)),
                      (0.0, 1.0, *(law.restitution + by for by in (-0.2, -0.05, -0.01, 0.01, 0.05, 0.2))))
        return
    yield Altered("rigid limits", at, lambda _: _joint(scene, joint, limits=(Limits(law.lower, law.upper),)))
    stiffness, damping = law.stiffness or 0.0, law.damping
    yield Altered("stiffness of limits", f"{at}: {{}} times", lambda k: given("stiffness", abs(k) * stiffness),
                  (0.5, 0.95, 1.05, 2.0))
    yield Altered("damping of limits", f"{at}: {{}} times", lambda k: given("damping", abs(k) * damping),
                  (0.0, 0.5, 0.95, 1.05, 2.0))


def _of_servo(scene: Scene, index: int, force: Force) -> Iterator[Altered]:
    p, at = force.parameters, f"servo of joint {force.joint}"

    def given(**keys: object) -> Scene:
        altered = dataclasses.replace(force, parameters={**p, **keys})
        return scene.replace(forces=(*scene.forces[:index], altered, *scene.forces[index + 1:]))

    def scaled(*keys: str) -> Callable[[float], Scene]:
        return lambda k: given(**{key: k * p[key] for key in keys if isinstance(p.get(key), float | int)})

    if p.get("effort_limit") is not None:
        low, high = p["effort_limit"]
        yield Altered("no saturation", at, lambda _: given(effort_limit=None, no_load_speed=None))
        for what, alter in (("limits", lambda k: (k * low, k * high)), ("lower limit", lambda k: (k * low, high)),
                            ("upper limit", lambda k: (low, k * high))):
            yield Altered("saturation", f"{at}: {what} {{}} times", functools.partial(
                lambda cut, k: given(effort_limit=cut(k)), alter), (0.5, 0.9, 0.98, 1.02, 1.1, 2.0))
    if p.get("no_load_speed") is not None:
        yield Altered("no motor line", at, lambda _: given(no_load_speed=None))
        yield Altered("motor line", f"{at}: no-load speed {{}} times", scaled("no_load_speed"), (0.9, 0.98, 1.02, 1.1))
    yield Altered("gear", f"{at}: gains {{}} times", scaled("proportional", "derivative", "feedforward"),
                  (0.5, 2.0, 4.0))
    for key, name in (("proportional", "gain"), ("derivative", "servo damping"), ("feedforward", "feedforward")):
        if isinstance(p.get(key), float | int) and p[key]:
            yield Altered(name, f"{at}: {{}} times", scaled(key), (0.0, -1.0, 0.9, 0.98, 1.02, 1.1, 2.0))
    if isinstance(p.get("target"), float | int):
        yield Altered("target", f"{at}: {{}}", lambda k: given(target=k),
                      tuple(p["target"] + by for by in (-0.05, -0.01, 0.01, 0.05)))
    if p.get("target_velocity"):
        yield Altered("no target velocity", at, lambda _: given(target_velocity=0.0))
    if p.get("period") is None:
        yield Altered("sampling", f"{at}: every {{}} s", lambda k: given(period=abs(k)), (0.05, 0.025, 0.01, 0.005))
        return
    yield Altered("no sampling", f"{at}: continuous", lambda _: given(period=None, delay=0))
    yield Altered("sampling", f"{at}: {{}} of the period", lambda k: given(period=abs(k) * p["period"]), (0.5, 2.0))
    for delay in {0, 1, 2, 3} - {p.get("delay", 0)}:
        yield Altered("delay", f"{at}: {delay} periods", functools.partial(lambda delay, _: given(delay=delay), delay))


def _joint(scene: Scene, joint: Joint, **changes: Any) -> Scene:
    """The scene with keys of one joint changed."""
    return scene.replace(joints=tuple(dataclasses.replace(each, **changes) if each.name == joint.name else each
                                      for each in scene.joints))
