"""Sixty-odd mistakes that engines make, each with the names that are right for it and the scenes that show it."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
from scipy.spatial.transform import Rotation

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.diagnosis import explain, of_output
from crosscheck.diagnosis.observe import scale_of
from crosscheck.references.maximal import Maximal
from tests.diagnosis import misbuilt
from tests.diagnosis.wrong_models import (
    Behind,
    Limited,
    altered,
    armed,
    attachment,
    claiming,
    exchanged,
    flawed,
    gravity_scaled,
    joints,
    near,
    one_moment,
    products,
    rotorless,
    scaled,
    shifted,
    some,
    tilted,
    turned,
)
from tests.diagnosis.wrong_output import (
    at_joint,
    between,
    dropped,
    each,
    early,
    elsewhere,
    filtered,
    finite,
    gravity_off,
    jumped,
    kicked,
    later,
    mirrored,
    retimed,
    shifted_later,
    spoilt,
    straight,
    stuck,
    told,
    turned_attitude,
    unrepeatable,
    with_states,
)
from tests.engines.stepper import Misbuilt, Stepper

ONE, TWO, SPRUNG, DRIVEN = "single_pendulum", "double_pendulum", "spring_pendulum", "driven_double_pendulum"


@dataclasses.dataclass(frozen=True)
class Mistake:
    """One way to be wrong; `build(rng, scene)` makes the engine."""

    key: str
    names: tuple[str, ...]
    build: object
    scenes: tuple[str, ...] = (ONE, TWO)


def method_of(engine, scene):
    """The method of order 4 of an engine of this suite: lieeuler's that takes the scene, or that of our own stepper."""
    return next(name for name in ("rkmk4", "rattle4", "RK4") if name in engine.methods and
                engine.unsupported(scene, RunSpec(name, 1e-3)) is None)


DAMPING = ("extra damping",)
MISTAKES = [
    Mistake("gravity size", ("gravity size",), altered(gravity_scaled)),
    Mistake("gravity sign", ("gravity sign",), altered(lambda r, s: misbuilt.gravity(lambda g: -g))),
    Mistake("gravity none", ("gravity size",), altered(lambda r, s: misbuilt.gravity(lambda g: 0 * g))),
    Mistake("gravity axis", ("gravity axis",), altered(lambda r, s: misbuilt.gravity(lambda g: np.roll(g, 1)))),
    Mistake("mass alone", ("mass", "inertia size"), altered(scaled(-1, mass=1))),
    Mistake("mass and inertia", ("mass",), altered(scaled(-1, mass=1, inertia=1)), (TWO,)),
    Mistake("all masses", ("mass", "inertia size"), altered(scaled(None, mass=1)), (TWO,)),
    Mistake("inertias", ("inertia size", "mass"), altered(scaled(None, inertia=1))),
    Mistake("inertia of one", ("inertia size",), altered(scaled(0, inertia=1)), (TWO,)),
    Mistake("one moment", ("inertia entries",), altered(one_moment)),
    Mistake("masses swapped", ("masses swapped",), altered(exchanged("mass")), ("uneven",)),
    Mistake("inertias swapped", ("inertias swapped",), altered(exchanged("inertia")), ("uneven",)),
    Mistake("bodies swapped", ("masses and inertias swapped",), altered(exchanged("mass", "inertia")), ("uneven",)),
    Mistake("products dropped", ("products of inertia",), altered(products(0.0)), ("uneven",)),
    Mistake("products negated", ("products of inertia",), altered(products(-1.0)), ("uneven",)),
    Mistake("products of one", ("products of inertia",), altered(products(-1.0, -1)), ("uneven",)),
    Mistake("inertia world", ("inertia frame",), altered(lambda r, s: misbuilt.inertia(
        lambda g, k: g.R0[k] @ g.inertias[k] @ g.R0[k].T))),
    Mistake("inertia turned", ("inertia frame",), altered(turned)),
    Mistake("inertia at joint", ("inertia point",), altered(lambda r, s: misbuilt.inertia(misbuilt.steiner(1.0)))),
    Mistake("part of Steiner", ("inertia point",), altered(lambda r, s: misbuilt.inertia(misbuilt.steiner(some(.05,
        .6)(r))))),
    Mistake("anchors swapped", ("anchors",), altered(joints(lambda k, j: dataclasses.replace(
        j, parent_anchor=j.child_anchor, child_anchor=j.parent_anchor) if k == 1 else j)), ("uneven",)),
    Mistake("anchor sign", ("anchors",), altered(joints(lambda k, j: dataclasses.replace(j,
        child_anchor=-j.child_anchor)))),
    Mistake("parent anchor sign", ("anchors",), altered(joints(lambda k, j: dataclasses.replace(
        j, parent_anchor=-j.parent_anchor))), (TWO,)),
    Mistake("anchor left out", ("anchors",), altered(joints(lambda k, j: dataclasses.replace(
        j, parent_anchor=0 * j.parent_anchor) if k else j)), (TWO,)),
    Mistake("child anchor moved", ("anchors",), altered(shifted("child_anchor"))),
    Mistake("parent anchor moved", ("anchors",), altered(shifted("parent_anchor")), (TWO,)),
    Mistake("anchor moved, start kept", ("anchors",), lambda rng, scene: Misbuilt(Stepper(), (
        shifted("child_anchor", placed=False)(rng, scene),))),
    Mistake("first anchor of two moved", ("anchors",), altered(shifted("child_anchor", 0)), (TWO,)),
    Mistake("masses a little", ("mass", "inertia size"), altered(lambda r, s: lambda g: misbuilt._bodies(
        g, lambda k, body: dataclasses.replace(body, mass=1.0001 * body.mass)))),
    Mistake("drive a step late", ("delay of a drive",), lambda rng, scene: Behind(1.0), (DRIVEN,)),
    Mistake("drive half a step late", ("delay of a drive",), lambda rng, scene: Behind(0.5), (DRIVEN,)),
    Mistake("attachment of a spring", ("point of a force",), altered(attachment), (SPRUNG,)),
    Mistake("rounded times", ("rounded times",), retimed(lambda s: np.round(s.t, 3))),
    Mistake("stiffness", ("spring stiffness",), altered(lambda r, s: misbuilt.spring(s.forces[0], stiffness=near(.01,
        .4)(r))), (SPRUNG,)),
    Mistake("free length", ("spring free length",), altered(lambda r, s: misbuilt.spring(s.forces[0], rest=some(.01,
        .2)(r))), (SPRUNG,)),
    Mistake("no spring", ("missing spring",), altered(lambda r, s: misbuilt.without_spring(s.forces[0])), (SPRUNG,)),
    Mistake("no moment of a spring", ("moment of a force",), flawed(moments=False), (SPRUNG,)),
    Mistake("joint damping", DAMPING, flawed(joint_damping=some(.003, .3))),
    Mistake("drag", DAMPING, flawed(drag=some(.003, .3))),
    Mistake("angular drag", DAMPING, flawed(spin_drag=some(.01, .3))),
    Mistake("linear drag", DAMPING, flawed(linear_drag=some(.01, .3))),
    Mistake("quadratic drag", ("quadratic drag",), flawed(quadratic=some(.003, .3))),
    Mistake("Coulomb friction", ("Coulomb friction",), flawed(coulomb=some(.003, .1))),
    Mistake("no gyroscopic term", ("gyroscopic term",), flawed(gyroscopic=0.0)),
    Mistake("gyroscopic factor", ("gyroscopic term",), flawed(gyroscopic=near(.02, .5))),
    Mistake("gyroscopic sign", ("gyroscopic term",), flawed(gyroscopic=-1.0)),
    Mistake("gyroscopic of one", ("gyroscopic term",), flawed(gyroscopic=lambda r, s: [0.0] + [1.0] * (s.n - 1)),
        (TWO,)),
    Mistake("no centripetal term", ("centripetal term",), flawed(centripetal=0.0)),
    Mistake("centripetal factor", ("centripetal term",), flawed(centripetal=near(.02, .5))),
    Mistake("centripetal sign", ("centripetal term",), flawed(centripetal=-1.0)),
    Mistake("soft", ("soft constraint",), flawed(softness=lambda r, s: (some(2e3, 2e4)(r), r.uniform(5, 50)))),
    Mistake("gain", ("stabilisation gain",), flawed(gain=lambda r, s: (r.uniform(1, 20),) * 2)),
    Mistake("naive group", ("group update",), flawed(naive=True)),
    Mistake("two sub-steps", ("hidden sub-steps",), flawed(substeps=2)),
    Mistake("more sub-steps", ("hidden sub-steps",), flawed(substeps=lambda r, s: int(r.integers(3, 6)))),
    Mistake("order one", ("order of the step",), flawed(euler=True)),
    Mistake("w in world axes", ("velocity frame",), told(lambda r, s, t: with_states(t, w=np.einsum("tnij,tnj->tni",
        t.R, t.w)))),
    Mistake("v in body axes", ("velocity frame",), told(lambda r, s, t: with_states(t, v=np.einsum("tnji,tnj->tni",
        t.R, t.v)))),
    Mistake("R inverted", ("quaternion conjugated",), told(lambda r, s, t: with_states(t, R=np.swapaxes(t.R, -1, -2)))),
    Mistake("x at the joint", ("position of the joint",), told(at_joint(False))),
    Mistake("x and v at the joint", ("position of the joint",), told(at_joint(True))),
    Mistake("x at another point", ("position of another point",), told(elsewhere)),
    Mistake("another origin", ("origin of positions",), told(lambda r, s, t: with_states(t, x=t.x + r.uniform(
        -0.1, 0.1, 3)))),
    Mistake("R not orthogonal", ("attitudes off the group",), told(lambda r, s, t: with_states(
        t, R=misbuilt.factor(r, 1e-5, 1e-3) * t.R))),
    Mistake("wrapped angle", ("wrapped angle",), flawed(wrapped=True), ("torsion_wheel",)),
    Mistake("other order", ("order of bodies",), told(lambda r, s, t: of_output.picked(t, list(range(s.n))[::-1])),
        (TWO, "uneven")),
    Mistake("start time", ("time offset",), retimed(lambda s: s.t + 0.013)),
    Mistake("fast clock", ("time scale",), retimed(lambda s: 1.004 * s.t)),
    Mistake("slow clock", ("time scale",), retimed(lambda s: 0.99 * s.t)),
    Mistake("late", ("time offset",), retimed(lambda s: np.maximum(s.t - 0.002, 0.0))),
    Mistake("float32 states", ("precision floor",), told(each(lambda r, v: v.astype(np.float32).astype(float)))),
    Mistake("six decimals", ("rounded output",), told(each(lambda r, v: np.round(v, 6)))),
    Mistake("noise", ("noise",), told(each(lambda r, v: v + 1e-9 * r.normal(size=v.shape)))),
    Mistake("random", ("noise",), unrepeatable),
    Mistake("single arithmetic", ("precision floor", "noise"), flawed(single=True)),
    Mistake("filtered", ("filtered velocity",), told(filtered("v", "w")), (ONE, "heavy_top")),
    Mistake("w filtered", ("filtered velocity",), told(filtered("w")), (TWO,)),
    Mistake("one body turned", ("turned attitude",), told(turned_attitude), (ONE, "four_bar")),
    Mistake("mirrored", ("mirrored attitude",), told(mirrored), (TWO, "universal_pendulum")),
    Mistake("a sample dropped", ("dropped sample",), told(dropped), (ONE, "heavy_top")),
    Mistake("straight lines", ("interpolated output",), told(straight), (ONE, "triple_pendulum")),
    Mistake("other frame of loads", ("frame of a load",), altered(lambda r, s: misbuilt.reframed),
            ("loaded_pendulum",)),
    Mistake("late by more than is looked at", ("time offset",), retimed(lambda s: np.maximum(s.t - 0.2, 0.0))),
    Mistake("clamped early", ("clamp",), flawed(stuck=early)),
    Mistake("clamped in steps", ("clamp",), flawed(stuck=lambda r, s: r.uniform(0.97, 0.99) * float(
        np.abs(Maximal(s).run().w).max())), (ONE,)),
    Mistake("positions projected", ("open velocity level",), claiming(projected="positions")),
    Mistake("nothing projected", ("open position level", "open velocity level"), claiming()),
    Mistake("one step late", ("late output",), finite(lambda s, raw: of_output.at_times(
        s, np.maximum(s.t - raw.step, 0.0)))),
    Mistake("half a step early", ("early output",), finite(lambda s, raw: of_output.at_times(s, s.t + 0.5 * raw.step))),
    Mistake("interpolated", ("interpolated output",), finite(between)),
    Mistake("a without g", ("reported accelerations",), spoilt(a=lambda s, t: t.a - s.gravity)),
    Mistake("alpha in world axes", ("reported accelerations",), spoilt(alpha=lambda s, t: np.einsum(
        "tnij,tnj->tni", t.R, t.alpha))),
    Mistake("armature left out", ("missing armature",), rotorless, ("armed hinge_pendulum", "armed driven_cart")),
    Mistake("armature that is not there", ("extra armature",), altered(lambda r, s: armed), ("torsion_wheel",)),
    Mistake("damping of 1e-4", DAMPING, flawed(joint_damping=1e-4), ("triple_pendulum", "heavy_top")),
    Mistake("wind", ("wind",), flawed(drag=0.1, wind=(2.0, -1.0, 0.0)),
        (ONE, "heavy_top")),
    Mistake("wind on large bodies", ("wind",), flawed(quadratic=0.05, wind=(2.0, -1.0, 0.0)), ("triple_pendulum",)),
    Mistake("a tilted axis", ("joint axis",), altered(tilted), ("torsion_wheel", "cylindrical_pendulum")),
    Mistake("tilted axes of a cross", ("joint axis",), altered(tilted), ("chrono_universal",)),
    Mistake("a limit of steps", ("step limit",), lambda rng, scene: Limited(most=90), ("triple_pendulum", SPRUNG)),
    Mistake("no small steps", ("step limit",), lambda rng, scene: Limited(least=0.05), (TWO, SPRUNG)),
    Mistake("time lost", ("time lost",), finite(lambda s, raw: of_output.at_times(s, s.t - 1e-3 * (s.t > 1.1)) if
        s.duration > 1.1 else raw.states), ("triple_pendulum", SPRUNG)),
    Mistake("clamped from the start", ("clamp",), flawed(stuck=lambda r, s: 0.7 * float(np.abs(s.w0).max())), (TWO,)),
    Mistake("gravity later", ("gravity size", "mass"), later(gravity_off)),
    Mistake("clamp", ("clamp",), later(stuck)),
    Mistake("lost sign", ("jump of attitude",), later(jumped)),
    Mistake("positions later", ("jump of position",), later(shifted_later)),
    Mistake("quaternion order", ("quaternion order",), altered(lambda r, s: lambda g: misbuilt._relative(g,
        attitude=misbuilt.quaternion_order))),
    Mistake("quaternion inverse", ("quaternion conjugated",), altered(lambda r, s: lambda g: misbuilt._relative(g,
        attitude=lambda R: R.T))),
    Mistake("a kick", ("jump of velocity",), later(kicked)),
]


def scene_of(name):
    """A built-in scene of a few seconds, or the double pendulum with unequal bodies and products of inertia."""
    from crosscheck.scene.file import load_scene

    scene = load_scene(TWO if name == "uneven" else name.removeprefix("armed "))
    if name.startswith("armed"):
        scene = armed(scene).replace(name=name.replace(" ", "_"))
    if name == "uneven":
        rng = np.random.default_rng(8)
        Q = [Rotation.from_rotvec(rng.normal(size=3)).as_matrix() for _ in scene.bodies]
        scene = scene.replace(name="uneven", bodies=tuple(dataclasses.replace(
            body, mass=(1.0 + 0.6 * k) * body.mass, inertia=(1.0 + 0.5 * k) * Q[k] @ body.inertia @ Q[k].T)
            for k, body in enumerate(scene.bodies)))
        joint = scene.joints[1]
        made = misbuilt.replaced(scene, (scene.joints[0], dataclasses.replace(
            joint, parent_anchor=np.array([0.2, 0.1, -0.8]), child_anchor=np.array([0.0, -0.1, 0.6]))))
        scene = scene if made is None else made
    return scene.replace(duration=min(scene.duration, 3.0), samples=31)


def made(mistake, name, seed):
    """(scene, engine) of a mistake on a scene."""
    scene = scene_of(name)
    return scene, mistake.build(np.random.default_rng([seed, MISTAKES.index(mistake)]), scene)


def visible(mistake, name, seed):
    """Whether the states of a mistake are others than those of the engine without it, at one step, by 1e-6."""
    try:
        scene, engine = made(mistake, name, seed)
        right = adapters.get("lieeuler") if "rkmk4" in engine.methods else Stepper()
        one, two = (each.run(scene, RunSpec(method_of(engine, scene), 5e-3)).states for each in (engine, right))
    except Exception:  # what the mistake makes of a scene that it does not suit
        return False
    scale = scale_of(scene)
    return bool(np.abs(scale.flat(one) - scale.flat(two)).max() > 1e-6)


def scored(mistake, name, seed):
    """(score, answer): "named", "equally" (with others that it says are as good), "unknown", "wrong",
    "acquitted".

    The first of a mistake's names has to be there; others only beside it.
    """
    scene, engine = made(mistake, name, seed)
    answer = explain(scene, engine, method_of(engine, scene))
    if answer.outcome != "fail":
        return {"pass": "acquitted"}.get(answer.outcome, "unknown"), answer
    options = [set(cause.split(" or ")) for cause in answer.names]
    right = all(each & set(mistake.names) for each in options) and any(mistake.names[0] in each for each in options)
    equally = any(len(each) > 1 for each in options)
    return ("equally" if right and equally else "named" if right else "wrong"), answer


LIKE = {
    "dropped sample": "straight lines", "filtered velocity": "late", "frame of a load": "gravity axis",
    "mirrored attitude": "R inverted", "turned attitude": "inertia turned",
    "Coulomb friction": "joint damping", "anchors": "x at another point", "attitudes off the group": "R inverted",
    "centripetal term": "soft",
    "clamp": "lost sign", "delay of a drive": "order one", "early output": "one step late",
    "extra damping": "quadratic drag", "gravity axis": "gravity size", "gravity sign": "gravity none",
    "gravity size": "all masses", "group update": "order one", "gyroscopic term": "products negated",
    "hidden sub-steps": "half a step early", "inertia entries": "part of Steiner", "inertia frame": "products negated",
    "inertia point": "inertias", "inertia size": "one moment", "inertias swapped": "masses swapped",
    "interpolated output": "noise", "jump of attitude": "clamp", "jump of position": "gravity later",
    "jump of velocity": "gravity later",
    "late output": "late", "mass": "masses swapped", "masses and inertias swapped": "inertias swapped",
    "masses swapped": "bodies swapped", "missing body": "gyroscopic of one", "missing spring": "stiffness",
    "moment of a force": "attachment of a spring", "noise": "float32 states",
    "open position level": "positions projected",
    "open velocity level": "soft", "order of bodies": "bodies swapped",
    "order of the step": "interpolated", "origin of positions": "x at the joint", "point of a force":
    "no moment of a spring", "position of another point": "x and v at the joint", "position of the joint":
    "another origin", "precision floor": "six decimals", "products of inertia": "inertia turned",
    "quadratic drag": "linear drag", "quaternion conjugated": "quaternion order", "quaternion order":
    "quaternion inverse", "reported accelerations": "gravity none", "rounded output": "noise", "rounded times":
    "six decimals", "soft constraint": "centripetal factor", "spring free length": "stiffness",
    "spring stiffness": "free length", "stabilisation gain": "no centripetal term", "step too coarse": "order one",
    "time offset": "another origin", "time scale": "start time", "velocity frame": "gyroscopic sign",
    "wrapped angle": "free length",
    "armature": "one moment", "missing armature": "one moment", "extra armature": "wrapped angle", "wind": "drag",
    "joint axis": "child anchor moved", "step limit": "clamp", "time lost": "slow clock",
}
"""For each cause a mistake that looks like it and is not: it must not be named."""


def main(part, parts):
    """Print the answer of every `parts`-th case from number `part` on, a look-alike's with the causes it is for."""
    cases = [(mistake, name) for mistake in MISTAKES for name in mistake.scenes]
    for mistake, name in cases[part::parts]:
        score, answer = scored(mistake, name, 41)
        given = {option for cause in answer.names for option in cause.split(" or ")}
        like = [cause for cause, key in LIKE.items() if key == mistake.key and name == mistake.scenes[0]]
        print(score, mistake.key, name, "; ".join(answer.names) or answer.sentence, f"look-alike of {', '.join(like)}",
              "MISTAKEN" if given & set(like) else "left alone", sep=" | ", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
