"""The alterations of a model: what may be wrong with a scene on its way into an engine, each with numbers to fit."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.scene.altered import Model, levers
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.laws import FORCE_TYPES
from crosscheck.scene.model import Force, Joint, Scene

Say = Callable[[np.ndarray], str]
Special = Callable[[np.ndarray], Sequence[tuple[float, ...]]]

FAILS = (ArithmeticError, ValueError, LookupError, TypeError, CrosscheckError)
"""What an alteration may raise that makes no sense of a scene: it is left out."""

MASSLESS = 1e-3
"""Part of the scene's mass below which a mass counts as none."""

GONE = 1e-6
"""Part of a scale below which a value, such as a stiffness or a distance, or a change counts as none."""

PARALLEL = 1e-9
"""One minus the cosine of the angle between a fitted gravity and the scene's, below which it is rounding of the fit."""

TURNED = (("R J R^T: body components taken as components in world axes", lambda R, J: R @ J @ R.T),
          ("R^T J R: components turned the wrong way", lambda R, J: R.T @ J @ R))

DIAGONAL = np.eye(3, dtype=bool)

BODIES = "all bodies"


class Quantity(NamedTuple):
    """A number of a model, of its inputs or encoders, that a log of its motion may show to be another one."""

    what: str
    of: Literal["body", "joint", ""]  # "": the whole model
    unit: str  # of its alteration, at a joint that of a hinge; "%": relative
    said: str = ""  # with {} for the owner; "": "what of owner"
    positive: bool = False  # whether a relative alteration stays above -1
    share: bool = False  # whether its uncertainty is a share of what the model has

    def unit_along(self, slides: bool) -> str:
        """Its unit at a joint that slides, or at another."""
        return {"N m s": "N s/m", "N m": "N", "kg m^2": "kg", "rad": "m"}.get(self.unit, self.unit) if (
            slides and self.of == "joint") else self.unit

    def of_owner(self, owner: str) -> str:
        """Its name."""
        return (self.said or self.what + " of {}").format(owner)


QUANTITIES = (
    Quantity("mass", "body", "%", positive=True), Quantity("inertia", "body", "%", positive=True),
    *(Quantity(f"centre of mass {axis}", "body", "m") for axis in "xyz"),  # body axes
    Quantity("mass and inertia", "body", "%", positive=True), Quantity("damping", "joint", "N m s", share=True),
    Quantity("friction", "joint", "N m", "dry friction of {}", share=True),
    Quantity("armature", "joint", "kg m^2", share=True), Quantity("torque gain", "joint", "%"),
    Quantity("torque offset", "joint", "N m"), Quantity("zero", "joint", "rad", "zero of {}'s encoder"),
    Quantity("stiffness", "joint", "%", "stiffness of {}'s servo", positive=True),
    Quantity("derivative gain", "joint", "%", "derivative gain of {}'s servo", positive=True),
    Quantity("largest torque", "joint", "%", "the largest torque of {}", positive=True),  # below that of the inputs
    Quantity("delay", "", "s", "delay of the inputs"),
    *(Quantity(f"tilt {axis}", "", "rad", f"the base turned about {axis}") for axis in "xy"),  # of the world
    Quantity("gravity", "", "%", "gravity"), Quantity("between", "", ""))
"""What is altered to explain a log; "between": the part of straight lines in inputs that the log does not tell from
held ones."""


@dataclasses.dataclass(frozen=True)
class Alteration:
    """A hypothesis: `apply` alters a model by the magnitudes theta, whose fit begins at `starts`.

    `title` names the cause by its magnitudes if one name is not enough. `special` lists magnitudes near fitted ones
    that have a name of their own, the simplest first.
    """

    cause: str
    apply: Callable[[Model, np.ndarray], Model]
    starts: tuple[tuple[float, ...], ...]  # ((),): nothing to fit
    words: Say
    mend: str
    title: Say | None = None
    special: Special = lambda theta: ()
    mistakes: Callable[[np.ndarray], int] = lambda theta: 1
    """Number of mistakes that lead to these magnitudes. Of equal explanations that with the fewest is named."""
    target: str = ""
    """The part of the model that it alters, if not all. Two alterations of one cause make a pair if these differ."""
    alone: bool = False
    """Whether it is never part of a pair."""
    last: bool = False
    """Whether it is tried only if no pair explains: with its many magnitudes it would stand for several others."""

    def name(self, theta: np.ndarray) -> str:
        """The cause in a few words."""
        return self.cause if self.title is None else self.title(theta)

    def overlaps(self, other: Alteration) -> bool:
        """Whether both alter the same body, joint or force."""
        targets = {self.target, other.target}
        return "" not in targets and (len(targets) == 1 or (BODIES in targets and all(
            each.startswith(("body ", BODIES)) for each in targets)))

    @property
    def free(self) -> int:
        """Number of magnitudes."""
        return len(self.starts[0])

    def magnitudes(self, theta: np.ndarray) -> int:
        """Number of fitted numbers. Special magnitudes do not count, but one of several does as a size."""
        special = any(np.array_equal(theta, value) for value in self.special(theta))
        return self.free if not special else int(self.free > 1 and self.name(theta) == "gravity size")


def alterations(scene: Scene, as_given: bool = False) -> list[Alteration]:
    """All of the model that make sense for a scene.

    `as_given`: also those of an inertia that is turned by the scene's attitude, where the engine shows another one.
    """
    scopes: list[tuple[str, tuple[int, ...]]] = [(BODIES, tuple(range(scene.n)))]
    bodies = np.flatnonzero(~scene.frames).tolist()  # of a frame nothing can be wrong
    if len(bodies) > 1:
        scopes += [(f"body {scene.bodies[k].name!r}", (k,)) for k in bodies]
    named = [_gravity(scene)]
    if scene.gravity.any():  # on a hinge, gravity of another size is one of many gravities with the same motion
        named.append(dataclasses.replace(named[0], apply=lambda m, t: m.altered(gravity=t[0] * scene.gravity), starts=(
            (1.0,),), words=lambda t: named[0].words(t[0] * scene.gravity), title=lambda t: named[0].name(
                t[0] * scene.gravity), special=lambda t: [(0.0,), (-1.0,)], mistakes=lambda t: 1, alone=True))
    named += [cause for where, those in scopes for cause in _inertias(scene, where, those, as_given)]
    named += [cause for k in bodies for cause in _masses(scene, k)]
    named += [cause for where, those in scopes for cause in _sizes(scene, where, those)]
    named += list(_exchanged(scene))
    named += [cause for k in range(len(scene.loads)) for cause in _force(scene, k)]
    constant = [not (force.is_spring or force.law.has_modes or force.functions) for force in scene.loads]
    if sum(constant) > 1:
        named.append(numbered("load", "all constant loads times {}", lambda m, t: m.with_force(
            None, lambda force: _scaled(force, t) if not force.is_spring and not force.functions else {}), 1.0,
            mend="check the loads on their way into the engine", none="load"))
    if any(force.is_spring for force in scene.loads):
        named += list(_every_spring(scene))
    if len(scene.functions) > 1:
        named.append(numbered("drive delay", "all functions of time come {} s late", lambda m, t: m.replace(
            scene=m.scene.delayed(t)), 1e-2, -1e-2, mend="evaluate what depends on time at its time",
            title=lambda t: "delay of a drive"))
    return [*named, *_rotors(scene), *_slowed(scene), *_terms(scene)]


def _gravity(scene: Scene) -> Alteration:
    g, size = scene.gravity, float(np.linalg.norm(scene.gravity))

    def title(theta: np.ndarray) -> str:
        new = float(np.linalg.norm(theta))
        if size == 0 or new <= GONE * size:
            return "gravity size"
        along = float(theta @ g) / (size * new)
        if abs(along) < 1 - PARALLEL:
            return "gravity axis"
        return "gravity sign" if along < 0 and abs(new - size) <= GONE * size else "gravity size"

    def special(theta: np.ndarray) -> list[tuple[float, ...]]:
        if size == 0:
            return []
        new = float(np.linalg.norm(theta))
        near = [0.0 * g, -g, float(theta @ g) / size**2 * g, *([size / new * theta] if new else [])]
        return [tuple(vector.tolist()) for vector in near]

    def mistakes(theta: np.ndarray) -> int:
        new = float(np.linalg.norm(theta))
        turned = float(theta @ g) < (1 - PARALLEL) * size * new
        return 2 if turned and abs(new - size) > GONE * size else 1

    start = g if size else np.array([0.0, 0.0, -9.81])
    return Alteration("gravity", lambda m, t: m.altered(gravity=np.array(t)), (tuple(start.tolist()),),
                      lambda t: f"gravity {_vector(t)} m/s^2 instead of {_vector(g)}",
                      "check sign, size and axis of the gravity the engine is given", title, special, mistakes)


def numbered(cause: str, text: str, apply: Callable[[Model, float], Model], *starts: float, mend: str, none: str = "",
             printed: Callable[[float], float] = float, **more: Any) -> Alteration:
    """One with a number, which `text` says as `printed`, fitted from `starts`; without these there is none.

    `none` is its name where that number is 0, which is tried for itself.
    """
    if none:
        more = {"title": lambda t: none if abs(t[0]) < GONE * (abs(starts[0]) or 1.0) else cause,
                "special": lambda t: [(0.0,)]} | more
    return Alteration(cause, lambda m, t: apply(m, float(t[0]) if len(t) else 0.0), tuple((start,) for start in starts)
                      or ((),), lambda t: text.format(*(f"{printed(float(value)):.6g}" for value in t)), mend, **more)


def _vector(values: np.ndarray) -> str:
    """Three numbers without the noise of the fit."""
    size = float(np.abs(values).max())
    return f"({', '.join(f'{0.0 if abs(value) <= 1e-6 * size else value:.6g}' for value in values)})"


def _inertias(scene: Scene, where: str, bodies: tuple[int, ...], as_given: bool) -> Iterator[Alteration]:
    s, masses = levers(scene), scene.masses
    axes = "give the inertia in the axes the engine expects: those of the body"

    def moved(J: np.ndarray, k: int, t: np.ndarray) -> np.ndarray:
        return np.asarray(J + t[0] * masses[k] * (s[k] @ s[k] * np.eye(3) - np.outer(s[k], s[k])))

    def rotated(J: np.ndarray, k: int, t: np.ndarray) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        Q = Rotation.from_rotvec(t).as_matrix()
        return np.asarray(Q @ J @ Q.T)

    def angle(t: np.ndarray) -> str:
        if len(bodies) == 1:
            t = least_turn(t, scene.inertias[bodies[0]])
        size = float(np.linalg.norm(t))
        return (f"{where}: inertia turned by {np.degrees(size):.5g} deg about {_vector(t / max(size, 1e-300))}, body "
                "axes")

    def reframed(turn: Any, given: bool) -> Callable[[Model, float], Model]:
        return lambda m, _: m.with_bodies(lambda k, body: {
            "inertia": turn((m.scene.R0 if given else m.starts)[k], body.inertia)}, bodies)

    if any(s[k].any() for k in bodies):
        yield Alteration("inertia point", _inertia(moved, bodies), ((0.2,), (1.0,), (-0.2,)),
                         lambda t: f"{where}: inertia off by {t[0]:+.6g} times mass (s^2 I - s s^T), s from the centre "
                                   "of mass to the joint; +1 would be the inertia about the joint",
                         "give the inertia about the point the engine expects: the centre of mass, or the joint",
                         target=where)
    for given, (text, turn) in itertools.product((False, True) if as_given else (False,), TURNED):
        yield numbered("inertia frame", f"{where}: {text}", reframed(turn, given), mend=axes, target=where)
    yield Alteration("inertia frame", _inertia(rotated, bodies),
                     ((0.1, 0.1, 0.1), (0.7, -0.5, 0.3), (-0.5, 0.8, -0.9)), angle, axes, target=where)


def least_turn(theta: np.ndarray, J: np.ndarray) -> np.ndarray:
    """The smallest rotation vector that turns an inertia J into the same as theta does: half turns about the principal
    axes change nothing."""
    from scipy.spatial.transform import Rotation

    halves = [np.zeros(3), *(np.pi * axis for axis in np.linalg.eigh(J)[1].T)]
    turns = [(Rotation.from_rotvec(theta) * Rotation.from_rotvec(half)).as_rotvec() for half in halves]
    return min(turns, key=lambda turn: float(np.linalg.norm(turn)))


def _inertia(change: Callable[[np.ndarray, int, np.ndarray], np.ndarray], bodies: tuple[int, ...]
             ) -> Callable[[Model, np.ndarray], Model]:
    """What alters the inertias of some bodies by `change` (J, number of the body, theta) -> J."""
    return lambda m, t: m.with_bodies(lambda k, body: {"inertia": change(body.inertia, k, t)}, bodies)


def _heavier(text: str, mend: str, starts: Sequence[float], inertia: bool, bodies: tuple[int, ...] | None = None,
             **more: Any) -> Alteration:
    """Masses, and inertias with them, times the exponential of the number."""
    def apply(m: Model, t: float) -> Model:
        return m.with_bodies(lambda _, body: {"mass": math.exp(t) * body.mass} | (
            {"inertia": math.exp(t) * body.inertia} if inertia else {}), bodies)

    return numbered("mass", text, apply, *starts, mend=mend, printed=math.exp, **more)


def _masses(scene: Scene, k: int) -> Iterator[Alteration]:
    where = f"body {scene.bodies[k].name!r}"
    mend = f"check that {where} and its mass reach the engine"
    yield _heavier(f"mass and inertia of {where} times {{}}", mend, (0.1, -1.0, -5.0), True, (k,), target=where,
                   title=lambda t: "missing body" if np.exp(t[0]) < MASSLESS else "mass")
    yield _heavier(f"mass of {where} times {{}}, inertia as it is", mend, (0.1, -1.0), False, (k,), target=where)


def _scaled(force: Force, factor: float) -> dict[str, Any]:
    """The parameters of a load, or the function of time of any force, times a factor."""
    if force.functions:
        return {key: value.times(factor) for key, value in force.parameters.items() if isinstance(value, TimeFunction)}
    return {key: tuple(factor * np.array(value)) if isinstance(value, tuple) else factor * value
            for key, value in force.parameters.items() if key in ("force", "torque")}


def _force(scene: Scene, k: int) -> Iterator[Alteration]:
    """Alterations of one spring or load."""
    force, own = scene.loads[k], k - len(scene.loads) + len(scene.forces)
    where, p = f"{f'joint {force.joint!r}' if own < 0 else f'forces[{own}]'} ({force.type})", force.parameters
    mend = f"check {where} on its way into the engine"

    def entry(kind: str, key: str, value: float, text: str | None = None, **more: Any) -> Alteration:
        return numbered(kind, f"{where}: {text or key} {{}} instead of {value:.6g}",
                        lambda m, t: m.with_force(k, lambda _: {key: t}), value, mend=mend, target=where, **more)

    if force.law.measure in ("length", "force"):
        yield numbered("moment of a force", f"{where}: its moments about the centres of mass times {{}}",
                       lambda m, t: m.replace(levers={**m.levers, k: t}), 1.0, none="moment of a force", target=where,
                       mend="apply the force at its point: it has a moment about the centre of mass")
        yield Alteration("point of a force", lambda m, t: m.with_force(k, lambda each: {
            "child_point": tuple(each.parameters["child_point"] + t)}), ((0.0,) * 3,), lambda t: f"{where}: its point "
                         f"on body {scene.bodies[force.child].name!r} off by {_vector(t)} m", mend, target=where,
                         alone=True)
    if force.law.effort is None:
        other = "world" if p["frame"] == "body" else "body"
        yield numbered("frame of a load", f"{where}: its components are those of {p['frame']} axes and are taken in "
                       "the other ones", lambda m, _: m.with_force(k, lambda _: {"frame": other}), mend=mend,
                       target=where)
    if force.functions:
        yield from _drive(scene, k, where, mend)
    elif not force.is_spring and not force.law.has_modes:
        yield numbered("load", f"{where}: factor of the load {{}} instead of 1",
                       lambda m, t: m.with_force(k, lambda each: _scaled(each, t)), 1.0, mend=mend, none="load",
                       target=where)
    if not force.is_spring:
        return
    rest = force.law.rest
    unit, value = "rad" if force.law.measure == "angle" else "m", p[rest]
    stiffness, damping = p["stiffness"], p["damping"]
    if stiffness:
        yield entry("spring stiffness", "stiffness", stiffness, none="missing spring")
        if not force.functions:
            yield entry("spring free length", rest, value, f"{rest} ({unit})", none="spring free length",
                        title=lambda t: "wrapped angle" if unit == "rad" and round(
                            abs(t[0] - value) / math.tau, 6) in (1, 2, 3) else "spring free length")
        yield numbered("missing spring", f"{where} is not there", lambda m, _: m.with_force(k, lambda _: {
            "stiffness": 0.0, "damping": 0.0}), mend=mend)
    named: dict[str, Any] = {} if damping else {"title": lambda t: "extra damping"}
    yield entry("damping", "damping", damping, none="missing damper", **named)


RESTS = tuple(law.rest for law in FORCE_TYPES.values() if law.rest)
"""What springs call where they rest."""

UNITS = ((0.0, "missing drive"), (-1.0, "sign of a drive"), (math.degrees(1.0), "unit of a drive"),
         (math.radians(1.0), "unit of a drive"))
"""Factors of functions of time that have a name: none, the wrong sign, degrees for radians and the reverse."""


def _drive(scene: Scene, k: int, where: str, mend: str) -> Iterator[Alteration]:
    """Alterations of the function of time in a force: its size, its delay and its phase."""
    def shifted(change: Callable[[TimeFunction, float], TimeFunction]) -> Callable[[Model, float], Model]:
        return lambda m, t: m.with_force(k, lambda force: {
            key: change(value, t) for key, value in force.parameters.items() if value in force.functions})

    def named(t: np.ndarray) -> str:
        return next((name for factor, name in UNITS if abs(t[0] - factor) <= GONE * max(1.0, abs(factor))),
                    "amplitude of a drive")

    yield numbered("drive", f"{where}: its function of time times {{}}",
                   lambda m, t: m.with_force(k, lambda force: _scaled(force, t)), 1.0, -1.0, mend=mend, title=named,
                   special=lambda t: [(factor,) for factor, _ in UNITS], target=where)
    terms = scene.loads[k].functions[0].terms
    alike = f", which is a phase of {{:.6g}} rad at {terms[0][1]:g} rad/s" if len(terms) == 1 else ""
    yield Alteration("drive delay", lambda m, t: shifted(TimeFunction.delayed)(m, float(t[0])), ((1e-2,), (-1e-2,)),
                     lambda t: f"{where}: its function of time comes {t[0]:.6g} s late"
                     + (alike.format(-terms[0][1] * t[0]) if alike else ""), mend,
                     lambda t: "phase or delay of a drive" if alike else "delay of a drive", target=where)
    if len(terms) > 1:
        yield numbered("drive phase", f"{where}: {{}} rad added to the phases of its sines", shifted(
            lambda function, by: dataclasses.replace(function, terms=tuple(
                (a, w, phase + by) for a, w, phase in function.terms))), 0.1, -0.1, mend=mend,
            title=lambda t: "phase of a drive", target=where)


def _every_spring(scene: Scene) -> Iterator[Alteration]:
    """The same mistake in every spring, also in those that copies of the scene have."""
    def times(keys: tuple[str, ...], linear: bool = False) -> Callable[[Model, float], Model]:
        return lambda m, t: m.with_force(None, lambda each: {
            key: t * value for key, value in each.parameters.items() if key in keys and isinstance(value, int | float)
            and (each.type == "linear_spring" if linear else each.is_spring)})

    for kind, keys, text, none in (
            ("spring stiffness", ("stiffness",), "stiffness", "missing spring"),
            ("spring free length", RESTS, "free length or rest angle", "spring free length"),
            ("damping", ("damping",), "damping", "missing damper")):
        if any(force.parameters.get(key) for force in scene.loads for key in keys if force.is_spring):
            yield numbered(kind, f"{text} of every spring times {{}}", times(keys), 1.0, mend=EVERY, none=none)
    linear = [force for force in scene.loads if force.law.measure == "length"]
    if any(force.parameters["damping"] for force in linear):
        yield numbered("spring stiffness", "stiffness and damping of all linear springs times {}",
                       times(("stiffness", "damping"), True), 1.0, mend=EVERY, none="missing spring", alone=True)
    if linear:
        yield numbered("moment of a force", "moments about the centres of mass of every spring times {}",
                       lambda m, t: m.replace(levers=dict.fromkeys(m.numbers, t)), 1.0, mend=EVERY,
                       none="moment of a force")


EVERY = "check how springs are converted for the engine"

WITHOUT_FRICTION = "switch off damping, friction and armature that the scene does not have"


def _slowed(scene: Scene) -> Iterator[Alteration]:
    """Damping and friction that the scene does not have."""
    def slowed(kind: str, text: str, *fields: str) -> Alteration:
        return numbered(kind, text, lambda m, t: m.replace(**dict.fromkeys(fields, t)), 0.0, mend=WITHOUT_FRICTION)

    def damped(where: str, joint: Joint | None = None) -> Alteration:
        def apply(m: Model, t: float) -> Model:
            there = [each.name for each in m.scene.joints if joint is None or (each.name, each.type) == (
                joint.name, joint.type)]
            return m.replace(damped={**m.damped, **{name: m.damped.get(name, 0.0) + t for name in there}})

        return numbered("extra damping", f"{{}} N m s/rad at {where}", apply, 0.0, mend=WITHOUT_FRICTION,
                        target="" if joint is None else joint.name)

    if scene.joints:
        yield damped("every joint")
    yield slowed("extra damping", "velocities decay at {} 1/s", "drag", "spin_drag")
    yield slowed("extra damping", "angular velocities decay at {} 1/s", "spin_drag")
    yield slowed("extra damping", "velocities of the centres of mass decay at {} 1/s", "drag")
    yield slowed("quadratic drag", "a force of {} 1/m times m |v| v against the velocity of every body", "quadratic")
    if scene.joints:
        yield slowed("Coulomb friction", "a moment of {} N m against the turning at every joint", "coulomb")
    sprung = {force.joint for force in scene.loads if force.is_spring}
    yield from (damped(f"joint {joint.name!r}", joint) for joint in scene.joints if len(scene.joints) > 1 and (
        joint.name not in sprung and (joint.kind.turns or joint.kind.is_ball)))

    # No wind is vertical.
    across = np.linalg.svd(scene.gravity[None])[2][1:] if scene.gravity.any() else np.eye(3)

    def blown(text: str, *fields: str) -> Alteration:
        return Alteration("wind", lambda m, t: m.replace(**dict.fromkeys(fields, t[0]), wind=t[1:] @ across),
                          ((0.01, *[1.0] * len(across)),), lambda t: text.format(t[0], _vector(t[1:] @ across)),
                          "switch off wind and the medium that the scene does not have", alone=True)

    yield blown("bodies are slowed at {:.6g} 1/s in air that moves at {} m/s", "drag")
    yield blown("bodies and their turning are slowed at {:.6g} 1/s in air that moves at {} m/s", "drag", "spin_drag")
    yield blown("a force of {:.6g} 1/m times m |v| v, v against air that moves at {} m/s", "quadratic")


def _rotors(scene: Scene) -> Iterator[Alteration]:
    """Rotor inertias of joints: all of them, or one, also where the scene has none."""
    def scaled(keys: Sequence[tuple[Joint, int]], where: str, size: float, begin: float) -> Alteration:
        def turned(each: Joint, k: int, t: float) -> Joint:
            given = list(each.armature or (0.0,) * len(each.kind.coordinates))
            given[k] = abs(t) * (given[k] if len(keys) > 1 else 1.0)
            return dataclasses.replace(each, armature=tuple(given)) if each.kind.is_elastic else each

        def apply(m: Model, t: float) -> Model:
            for joint, k in keys:
                m = m.with_joint(joint.name, functools.partial(turned, k=k, t=t))
            return m

        return numbered("armature", f"{where} {{}} instead of {size:.6g}", apply, begin, printed=abs, target=where,
                        mend="check the armature that the engine is given", alone=not size, none="missing armature",
                        **({} if size else {"title": lambda t: "extra armature"}))

    every = [(joint, k) for joint in scene.joints if joint.kind.is_elastic for k in range(len(joint.kind.coordinates))]
    given = [(joint, k) for joint, k in every if joint.armature and joint.armature[k]]
    if len(given) > 1:
        yield scaled(given, "armature of all joints, as a part of the scene's,", 1.0, 1.0)
    for joint, k in every:
        size = joint.armature[k] if joint.armature else 0.0
        yield scaled([(joint, k)], f"armature of joint {joint.name!r}", size, size)


def _terms(scene: Scene) -> Iterator[Alteration]:
    """Terms of the equations of motion left out or scaled."""
    def turning(k: int | slice) -> Callable[[Model, float], Model]:
        def apply(m: Model, t: float) -> Model:
            factors = np.array(np.broadcast_to(m.gyroscopic, (scene.n,)), dtype=float)
            factors[k] = t
            return m.replace(gyroscopic=factors)

        return apply

    one = [(k, body.name) for k, body in enumerate(scene.bodies)] if scene.n > 1 else []
    every: list[tuple[int | slice, str]] = [(slice(None), ""), *one]
    for k, name in every:
        of = f" of body {name!r}" if name else ""
        yield numbered("gyroscopic term", f"w x J w{of} times {{}}", turning(k), 1.0, none="gyroscopic term",
                       mend="check the term w x J w of the rotational equations", target=name)
    if scene.joints:
        yield numbered("centripetal term", "gamma of G du/dt + gamma = 0 times {}",
                       lambda m, t: m.replace(centripetal=t), 1.0, none="centripetal term", mend="check the terms of "
                       "the constraints' second derivative that are quadratic in the velocities")


def _sizes(scene: Scene, where: str, bodies: tuple[int, ...]) -> Iterator[Alteration]:
    """Masses of all bodies; sizes, products and entries of inertias, of all bodies or of one."""
    mend = f"check the inertia that the engine is given, {where}"
    whole = len(bodies) == scene.n
    if whole and scene.n > 1:
        yield _heavier("masses of all bodies times {}, inertias as they are", "check the unit of masses", (0.1,), False,
                       target=where)
    if whole and scene.loads:
        yield _heavier("masses and inertias of all bodies times {}", "check the units of masses, inertias and forces",
                       (0.1,), True)
    yield Alteration("inertia size", _inertia(lambda J, _, t: np.exp(t[0]) * J, bodies), ((0.1,), (-1.0,)),
                     lambda t: f"{where}: inertia times {np.exp(t[0]):.6g}", mend, target=where)

    def products(factor: float, text: str) -> Alteration:
        return Alteration("products of inertia", _inertia(lambda J, _, t: np.where(DIAGONAL, J, factor * J), bodies),
                          ((),), lambda t: f"{where}: products of inertia {text}", mend, target=where)

    if np.any(scene.inertias[list(bodies)] * ~DIAGONAL):
        yield from (products(0.0, "left out"), products(-1.0, "with the other sign"))

    def entries(basis: np.ndarray, names: str, form: str, last: bool) -> Alteration:
        def change(J: np.ndarray, _: int, t: np.ndarray) -> np.ndarray:
            xx, yy, zz, xy, xz, yz = t @ basis
            return np.asarray(J + np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

        return Alteration("inertia entries", _inertia(change, bodies), ((0.0,) * len(basis),), lambda t: (
            f"{where}: {names} off by {', '.join(format(value, form) for value in t)}" + " kg m^2" * (not last)), mend,
                          target=where, alone=True, last=last)

    if len(bodies) == 1:
        names, unit = ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz"), np.eye(6)
        yield from (entries(unit[k:k + 1], name, "+.6g", False) for k, name in enumerate(names))
        yield entries(unit, ", ".join(names), "+.4g", True)


def _exchanged(scene: Scene) -> Iterator[Alteration]:
    """Masses, inertias or both of two bodies exchanged."""
    def swapped(pair: tuple[int, int], keys: Sequence[str]) -> Callable[[Model, float], Model]:
        return lambda m, _: m.with_bodies(lambda k, body: {
            key: getattr(m.scene.bodies[sum(pair) - k], key) for key in keys}, pair)

    for one, other in itertools.combinations(np.flatnonzero(~scene.frames).tolist(), 2):
        names = f"{scene.bodies[one].name!r} and {scene.bodies[other].name!r}"
        for keys, text in ((("mass",), "masses"), (("inertia",), "inertias"),
                           (("mass", "inertia"), "masses and inertias")):
            yield numbered(f"{text} swapped", f"of bodies {names}", swapped((one, other), keys), mend="check the order "
                           "in which bodies reach the engine", target=names, alone=True)
