"""The alterations of the force laws of joints, and the search for one in an engine's motion.

Events make accelerations useless here. So the whole motion is compared with that of each altered scene, by lieeuler's
Taylor series with events located, and a number that is unknown is fitted to it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from crosscheck.diagnosis.fit import CLEAR, EXPLAINED, Case, altered, search, simplest
from crosscheck.diagnosis.observe import Subject
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.running.run import run
from crosscheck.scene.alterations import Alteration, numbered
from crosscheck.scene.altered import Model, of_scene
from crosscheck.scene.coordinates import histories
from crosscheck.scene.laws import DryFriction, Limits
from crosscheck.scene.model import Force, Joint, Scene
from crosscheck.scene.states import Motion

STEPS, RTOLS, ACCURATE = 2000, (1e-8, 1e-10), 1e-10
"""Steps of the coarser of two runs of an engine over a scene, or their tolerances; that of altered scenes."""

LEFT, SEEN = 0.3, 1e-7
"""Part of the difference of the two runs that their limit may be off by; the least difference (rad or m) looked into.
"""

FAR = 1e3
"""Difference (rad or m) that counts where an altered scene cannot run."""

MEND = "compare this law in the engine's model with the scene's"


class Coordinates(Case):
    """The joint coordinates (T, k) that an engine shows, beside those of a scene with altered laws."""

    dear = True

    def __init__(self, scene: Scene, observed: np.ndarray, noise: float) -> None:
        self.right, self.observed, self.noise = of_scene(scene), observed, noise

    def residual(self, causes: Sequence[Alteration], theta: Sequence[np.ndarray]) -> np.ndarray:
        """Of a run by lieeuler's Taylor series; the noise counts as `EXPLAINED`."""
        scene = altered(self.right, causes, theta).scene
        moved = run(scene, "lieeuler", "taylor", rtol=ACCURATE, reduce="off", monitor=False)
        return np.ravel(_coordinates(scene, moved) - self.observed) / self.noise * EXPLAINED


def diagnose(subject: Subject, scene: Scene, answer: Explanation) -> bool:
    """Whether altered laws reproduce an engine's motion, which are named; not if it is the scene's, or none does."""
    order = subject.order(scene)
    sizes = [{"rtol": rtol} for rtol in RTOLS] if order is None else [
        {"step": scene.duration / steps} for steps in (STEPS, 2 * STEPS)]
    coarse, fine = (_coordinates(scene, subject.run(scene, **size).states) for size in sizes)
    observed = fine + (fine - coarse) / (2.0 ** (order or 60) - 1.0)
    noise = max(SEEN, LEFT * float(np.abs(observed - coarse).max()))
    case = Coordinates(scene, observed, noise)
    before = case.before * noise / EXPLAINED
    if not noise < CLEAR * before < CLEAR * FAR:
        return False
    holding, others = search(case, list(alternatives(scene)), pairing=False)
    answer.tried += len(others)
    answer.evidence += [Evidence(" and ".join(each.names), "law", before, each.left * noise / EXPLAINED,
                                 "joint coordinates, rad or m", each.words, each.explains)
                        for each in others if each.left < CLEAR * case.before]
    if not holding:
        return False
    holding = simplest(holding)
    least = min(each.left for each in holding)
    named = [each for each in holding if each.left <= max(5.0 * least, 0.1 * EXPLAINED)]
    answer.deviation, answer.noise, answer.explained = before, noise, least * noise / EXPLAINED
    answer.causes.append(NamedCause(" or ".join(sorted({" and ".join(each.names) for each in named})),
                                    ", or equally ".join(each.words for each in named), MEND))
    return True


def _coordinates(scene: Scene, states: Motion) -> np.ndarray:
    """(T, coordinates) of all joints."""
    count, joints = len(states.t), histories(scene, states).values()
    return np.asarray(np.hstack([each.position.reshape(count, -1) for each in joints]))


def alternatives(scene: Scene) -> Iterator[Alteration]:
    """The laws of a scene with one of them altered."""
    for joint in scene.joints:
        if joint.kind.coordinates in (("turn",), ("slide",)):
            for friction in filter(None, joint.dry_friction):
                yield from _of_friction(joint, friction)
            for limits in filter(None, joint.limits):
                yield from _of_limits(joint, limits)
    rubbing = [joint for joint in scene.joints if any(joint.dry_friction)]
    for one, other in itertools.combinations(rubbing, 2):
        yield _law("friction on the wrong joints", f"that of {one.name} and {other.name} exchanged",
                   lambda m, _, one=one, other=other: _with(  # type: ignore[misc]
                       _with(m, one, dry_friction=other.dry_friction), other, dry_friction=one.dry_friction))
    for number, force in enumerate(scene.loads):
        if force.type == "servo":
            yield from _of_servo(number, force)


def _law(kind: str, text: str, apply: Callable[[Model, float], Model], *starts: float, zero: str = "") -> Alteration:
    """As `numbered`, of one joint."""
    return numbered(kind, text, apply, *starts, mend=MEND, none=zero, target=text.partition(":")[0])


def _with(m: Model, joint: Joint, **changes: Any) -> Model:
    """The model with keys of one joint changed."""
    return m.with_joint(joint.name, lambda each: dataclasses.replace(each, **changes))


def _of_friction(joint: Joint, law: DryFriction) -> Iterator[Alteration]:
    def given(m: Model, sliding: float, static: float) -> Model:
        return _with(m, joint, dry_friction=(DryFriction(abs(sliding), max(abs(sliding), abs(static))),))

    def instead(m: Model, **keys: object) -> Model:
        return _with(m, joint, dry_friction=()).with_more(Force("servo", None, None, joint.name, keys))

    c, s, at = law.sliding, law.static, f"joint {joint.name}"
    yield _law("dry friction", f"{at}: {{}} times", lambda m, k: given(m, k * c, k * s), 0.5, 0.95, 0.99, 1.01, 1.05,
               2.0, zero="missing dry friction")
    yield _law("viscous friction", f"{at}: {{}} times the rate", lambda m, k: instead(m, derivative=abs(k)), 0.5 * c,
               2 * c)
    yield _law("smooth friction", f"{at}: in proportion to the rate below {{}}", lambda m, k: instead(
        m, derivative=c / max(abs(k), 1e-3), effort_limit=(-c, c)), 0.3, 0.1, 0.01)
    yield _law("friction as a torque", f"{at}: {{}} in one direction", lambda m, k: instead(m, feedforward=k), c, -c)
    yield _law("static friction", f"{at}: {{}} times", lambda m, k: given(m, c, k * s), c / s if s > c else 1.5, 1.1,
               2.0, *([0.9] if s > c else []))
    if s > c:
        yield _law("sliding friction", f"{at}: {{}} times", lambda m, k: given(m, k * c, s), 0.9, 1.1, s / c)


def _of_limits(joint: Joint, law: Limits) -> Iterator[Alteration]:
    def given(key: str) -> Callable[[Model, float], Model]:
        return lambda m, value: _with(m, joint, limits=(dataclasses.replace(law, **{key: value}),))

    def times(key: str) -> Callable[[Model, float], Model]:
        return lambda m, k: given(key)(m, abs(k) * getattr(law, key))

    at = f"joint {joint.name}"
    yield _law("no limits", at, lambda m, _: _with(m, joint, limits=()))
    for side in ("lower", "upper"):
        if np.isfinite(end := getattr(law, side)):
            yield _law(f"stop {side}", f"{at}: {side} at {{}}", given(side), end - 0.02, end - 0.005, end + 0.005,
                       end + 0.02, 0.5 * end)
    if law.rigid:
        yield Alteration("soft stop", lambda m, t: _with(m, joint, limits=(Limits(law.lower, law.upper, stiffness=abs(
            t[0]), damping=abs(t[1])),)), ((2e3, 40.0), (5e2, 5.0), (2e4, 100.0)), lambda t: (
                f"{at}: a spring of {abs(t[0]):.6g} and a damper of {abs(t[1]):.6g} for a rigid stop"), MEND, target=at)
        yield _law("stop restitution", f"{at}: {{}}", lambda m, k: given("restitution")(m, min(max(k, 0.0), 1.0)), 0.0,
                   1.0, *(law.restitution + by for by in (-0.2, -0.05, -0.01, 0.01, 0.05, 0.2)
                          if 0.0 < law.restitution + by < 1.0))
        return
    yield _law("rigid limits", f"{at}: restitution {{}}", lambda m, k: _with(m, joint, limits=(Limits(
        law.lower, law.upper, min(max(k, 0.0), 1.0)),)), 0.0, 0.5, 0.9, zero="rigid limits")
    for key in ("stiffness", "damping"):
        yield _law(f"stop {key}", f"{at}: {key} {{}} times", times(key), 0.5, 0.95, 1.05, 2.0,
                   zero="missing stop damping" if key == "damping" else "")


def _of_servo(number: int, force: Force) -> Iterator[Alteration]:
    p, at = force.parameters, f"servo of joint {force.joint}"

    def given(**keys: object) -> Callable[[Model, float], Model]:
        return lambda m, _: m.with_force(number, lambda force: keys)

    def scaled(*keys: str) -> Callable[[Model, float], Model]:
        return lambda m, k: m.with_force(number, lambda force: {
            key: k * p[key] for key in keys if isinstance(p.get(key), float | int)})

    if p.get("effort_limit") is not None:
        low, high = p["effort_limit"]
        yield _law("no saturation", at, given(effort_limit=None, no_load_speed=None))
        for what, cut in (("limits", (1, 1)), ("lower limit", (1, 0)), ("upper limit", (0, 1))):
            yield _law("servo effort limit", f"{at}: {what} {{}} times", lambda m, k, cut=cut: (  # type: ignore[misc]
                given(effort_limit=(k ** cut[0] * low, k ** cut[1] * high))(m, k)), 0.5, 0.9, 0.98, 1.02, 1.1, 2.0)
    if p.get("no_load_speed") is not None:
        yield _law("no motor line", at, given(no_load_speed=None))
        yield _law("motor line", f"{at}: no-load speed {{}} times", scaled("no_load_speed"), 0.9, 0.98, 1.02, 1.1)
    yield _law("gear", f"{at}: gains {{}} times", scaled("proportional", "derivative", "feedforward"), 0.5, 2.0, 4.0)
    for key in ("proportional", "derivative", "feedforward", "target_velocity"):
        if isinstance(p.get(key), float | int) and p[key]:
            yield _law(f"servo {key.replace('_', ' ')}", f"{at}: {key} {{}} times", scaled(key), -1.0, 0.9, 0.98, 1.02,
                       1.1, 2.0, zero=f"missing servo {key.replace('_', ' ')}")
    for key in ("target", "derivative", "feedforward"):
        value = p.get(key, 0.0)
        if isinstance(value, float | int) and (key == "target" or not value):
            yield _law(f"servo {key}", f"{at}: {key} {{}} in place of {value:g}",
                       lambda m, k, key=key: given(**{key: k})(m, k),  # type: ignore[misc]
                       *(value + by for by in (-0.05, -0.01, 0.01, 0.05)))
    if p.get("period") is None:
        yield _law("sampling", f"{at}: every {{}} s", lambda m, k: given(period=abs(k))(m, k), 0.05, 0.025, 0.01, 0.005)
        return
    yield _law("no sampling", f"{at}: continuous", given(period=None, delay=0))
    yield _law("sampling", f"{at}: {{}} of the period", lambda m, k: given(period=abs(k) * p["period"])(m, k), 0.5, 2.0)
    for delay in sorted({0, 1, 2, 3} - {p.get("delay", 0)}):
        yield _law("servo delay", f"{at}: {delay} in place of {p.get('delay', 0)} periods", given(delay=delay, held=()))
