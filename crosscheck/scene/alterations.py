"""The alterations of a model: what may be wrong with a scene on its way into an engine, each with numbers to fit."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.scene.altered import Model, levers
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.model import Body, Force, Joint, Scene

Say = Callable[[np.ndarray], str]
Special = Callable[[np.ndarray], Sequence[tuple[float, ...]]]

FAILS = (ArithmeticError, ValueError, LookupError, TypeError, CrosscheckError)
"""What an alteration may raise that makes no sense of a scene: it is left out."""

MASSLESS = 1e-3
"""Part of the scene's mass below which a mass counts as none."""

GONE = 1e-6
"""Part of the scene's value below which a stiffness, a damping or a gravity counts as none."""

PARALLEL = 1e-9
"""One minus the cosine of the angle between a fitted gravity and the scene's, below which it is rounding of the fit."""

TURNED = (("R J R^T: body components taken as components in world axes", lambda R, J: R @ J @ R.T),
          ("R^T J R: components turned the wrong way", lambda R, J: R.T @ J @ R))

DIAGONAL = np.eye(3, dtype=bool)


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
    """A hypothesis: `apply` alters what its `kind` says by the magnitudes theta, whose fit begins at `starts`.

    `title` names the cause by its magnitudes if one name is not enough. `special` lists magnitudes near fitted ones
    that have a name of their own, the simplest first.
    """

    cause: str
    apply: Callable[..., Any]  # (what is altered, theta) -> the same, altered
    starts: tuple[tuple[float, ...], ...]  # ((),): nothing to fit
    words: Say
    mend: str
    title: Say | None = None
    special: Special = lambda theta: ()
    mistakes: Callable[[np.ndarray], int] = lambda theta: 1
    """Number of mistakes that lead to these magnitudes. Of equal explanations that with the fewest is named."""
    target: str = ""
    """The part of the model that it alters. Two alterations of one cause make a pair if these differ."""
    alone: bool = False
    """Whether it is never part of a pair."""
    last: bool = False
    """Whether it is tried only if no pair explains: with its many magnitudes it would stand for several others."""
    kind: Literal["scene", "motion", "output", "clock"] = "scene"
    """What it alters: a `Model`; `States`, given their scene; values (T, ...) of one output; times (T,) in s."""

    def name(self, theta: np.ndarray) -> str:
        """The cause in a few words."""
        return self.cause if self.title is None else self.title(theta)

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
    scopes: list[tuple[str, tuple[int, ...]]] = [("all bodies", tuple(range(scene.n)))]
    if scene.n > 1:
        scopes += [(f"body {body.name!r}", (k,)) for k, body in enumerate(scene.bodies)]
    named = [_gravity(scene)]
    if scene.gravity.any():  # on a hinge, gravity of another size is one of many gravities with the same motion
        named.append(dataclasses.replace(named[0], apply=lambda m, t: m.altered(gravity=t[0] * scene.gravity), starts=(
            (1.0,),), words=lambda t: named[0].words(t[0] * scene.gravity), title=lambda t: named[0].name(
                t[0] * scene.gravity), special=lambda t: [(0.0,), (-1.0,)], mistakes=lambda t: 1, alone=True))
    named += [cause for where, bodies in scopes for cause in _inertias(scene, where, bodies, as_given)]
    named += [cause for k in range(scene.n) for cause in _masses(scene, k)]
    named += [cause for where, bodies in scopes for cause in _sizes(scene, where, bodies)]
    named += list(_exchanged(scene))
    named += [cause for k in range(len(scene.loads)) for cause in _force(scene, k)]
    constant = [force.type not in ("servo", *RESTS) and not force.functions for force in scene.loads]
    if sum(constant) > 1:
        named.append(Alteration("load", lambda m, t: m.with_force(None, lambda force: _scaled(force, t[0]) if (
            force.type not in RESTS and not force.functions) else {}), ((1.0,),), lambda t: (
                f"all constant loads times {t[0]:.6g}"), "check the loads on their way into the engine", None, _none))
    if any(force.is_spring for force in scene.loads):
        named += list(_every_spring(scene))
    if len(scene.functions) > 1:
        named.append(Alteration("drive delay", lambda m, t: m.replace(scene=m.scene.delayed(float(t[0]))), (
            (1e-2,), (-1e-2,)), lambda t: f"all functions of time come {t[0]:.6g} s late", "evaluate what depends on "
            "time at its time", lambda t: "delay of a drive"))
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

    if any(s[k].any() for k in bodies):
        yield Alteration("inertia point", _inertia(moved, bodies), ((0.2,), (1.0,), (-0.2,)),
                         lambda t: f"{where}: inertia off by {t[0]:+.6g} times mass (s^2 I - s s^T), s from the centre "
                                   "of mass to the joint; +1 would be the inertia about the joint",
                         "give the inertia about the point the engine expects: the centre of mass, or the joint")
    for given, (text, turn) in itertools.product((False, True) if as_given else (False,), TURNED):
        def reframed(m: Model, _: np.ndarray, given: bool = given, turn: Any = turn) -> Model:
            R = m.scene.R0 if given else m.starts
            return m.with_bodies(lambda k, body: {"inertia": turn(R[k], body.inertia)}, bodies)

        yield Alteration("inertia frame", reframed, ((),), lambda t, text=text: f"{where}: {text}",  # type: ignore[misc]
                         axes)
    yield Alteration("inertia frame", _inertia(rotated, bodies),
                     ((0.1, 0.1, 0.1), (0.7, -0.5, 0.3), (-0.5, 0.8, -0.9)), angle, axes)


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


def _heavier(factor: float, body: Body, inertia: bool) -> dict[str, Any]:
    return {"mass": factor * body.mass} | ({"inertia": factor * body.inertia} if inertia else {})


def _masses(scene: Scene, k: int) -> Iterator[Alteration]:
    name = scene.bodies[k].name
    for inertia, text, starts in ((True, "mass and inertia of body {!r} times {:.6g}", ((0.1,), (-1.0,), (-5.0,))),
                                  (False, "mass of body {!r} times {:.6g}, inertia as it is", ((0.1,), (-1.0,)))):
        yield Alteration(
            "mass", lambda m, t, inertia=inertia: m.with_bodies(
                lambda _, body: _heavier(np.exp(t[0]), body, inertia), (k,)),
            starts, lambda t, text=text: text.format(name, np.exp(t[0])),  # type: ignore[misc]
            f"check that body {name!r} and its mass reach the engine",
            lambda t, inertia=inertia: "missing body" if inertia and np.exp(t[0]) < MASSLESS  # type: ignore[misc]
            else "mass", target=name)


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

    def entry(kind: str, key: str, value: float, text: str, title: Say | None = None) -> Alteration:
        return Alteration(kind, lambda m, t: m.with_force(k, lambda _: {key: float(t[0])}), ((value,),),
                          lambda t: f"{where}: {text} {t[0]:.6g} instead of {value:.6g}", mend, title, _none,
                          target=where)

    if force.type in ("linear_spring", "constant_force"):
        yield Alteration("moment of a force", lambda m, t: m.replace(levers={**m.levers, k: t[0]}), ((1.0,),),
                         lambda t: f"{where}: its moments about the centres of mass times {t[0]:.6g}",
                         "apply the force at its point: it has a moment about the centre of mass", None, _none,
                         target=where)
        yield Alteration("point of a force", lambda m, t: m.with_force(k, lambda each: {
            "child_point": tuple(each.parameters["child_point"] + t)}), ((0.0,) * 3,), lambda t: f"{where}: its point "
                         f"on body {scene.bodies[force.child].name!r} off by {_vector(t)} m", mend, target=where,
                         alone=True)
    if force.type in ("constant_force", "constant_torque"):
        other = "world" if p["frame"] == "body" else "body"
        yield Alteration("frame of a load", lambda m, t: m.with_force(k, lambda _: {"frame": other}), ((),),
                         lambda t: f"{where}: its components are those of {p['frame']} axes and are taken in the other "
                         "ones", mend, target=where)
    if force.functions:
        yield from _drive(scene, k, where, mend)
    elif not force.is_spring and force.type != "servo":
        yield Alteration("load", lambda m, t: m.with_force(k, lambda each: _scaled(each, t[0])), ((1.0,),),
                         lambda t: f"{where}: factor of the load {t[0]:.6g} instead of 1", mend, None, _none,
                         target=where)
    if not force.is_spring:
        return
    rest = RESTS[force.type]
    unit, value = "rad" if force.type == "torsional_spring" else "m", p[rest]
    stiffness, damping = p["stiffness"], p["damping"]
    if stiffness:
        yield entry("spring stiffness", "stiffness", stiffness, "stiffness",
                    lambda t: "missing spring" if abs(t[0]) < GONE * stiffness else "spring stiffness")
        if not force.functions:
            yield entry("spring free length", rest, value, f"{rest} ({unit})", lambda t: "wrapped angle" if
                        unit == "rad" and round(abs(t[0] - value) / math.tau, 6) in (1, 2, 3) else "spring free length")
        yield Alteration("missing spring", lambda m, t: m.with_force(k, lambda _: {"stiffness": 0.0, "damping": 0.0}),
                         ((),), lambda t: f"{where} is not there", mend)
    yield entry("damping", "damping", damping, "damping",
                lambda t: "extra damping" if not damping else "missing damper" if abs(t[0]) < GONE * damping
                else "damping")


RESTS = {"linear_spring": "free_length", "slide_spring": "rest_position", "torsional_spring": "rest_angle"}
"""What a spring of each type calls where it rests."""

UNITS = ((0.0, "missing drive"), (-1.0, "sign of a drive"), (math.degrees(1.0), "unit of a drive"),
         (math.radians(1.0), "unit of a drive"))
"""Factors of functions of time that have a name: none, the wrong sign, degrees for radians and the reverse."""


def _drive(scene: Scene, k: int, where: str, mend: str) -> Iterator[Alteration]:
    """Alterations of the function of time in a force: its size, its delay and its phase."""
    def shifted(change: Callable[[TimeFunction, float], TimeFunction]) -> Callable[[Model, np.ndarray], Model]:
        return lambda m, t: m.with_force(k, lambda force: {
            key: change(value, float(t[0])) for key, value in force.parameters.items() if value in force.functions})

    def named(t: np.ndarray) -> str:
        return next((name for factor, name in UNITS if abs(t[0] - factor) <= GONE * max(1.0, abs(factor))),
                    "amplitude of a drive")

    yield Alteration("drive", lambda m, t: m.with_force(k, lambda force: _scaled(force, t[0])), ((1.0,), (-1.0,)),
                     lambda t: f"{where}: its function of time times {t[0]:.6g}", mend, named,
                     lambda t: [(factor,) for factor, _ in UNITS], target=where)
    terms = scene.loads[k].functions[0].terms
    alike = f", which is a phase of {{:.6g}} rad at {terms[0][1]:g} rad/s" if len(terms) == 1 else ""
    yield Alteration("drive delay", shifted(lambda function, by: function.delayed(by)), ((1e-2,), (-1e-2,)),
                     lambda t: f"{where}: its function of time comes {t[0]:.6g} s late"
                     + (alike.format(-terms[0][1] * t[0]) if alike else ""), mend,
                     lambda t: "phase or delay of a drive" if alike else "delay of a drive", target=where)
    if len(terms) > 1:
        yield Alteration("drive phase", shifted(lambda function, by: dataclasses.replace(function, terms=tuple(
            (a, w, phase + by) for a, w, phase in function.terms))), ((0.1,), (-0.1,)),
                         lambda t: f"{where}: {t[0]:.6g} rad added to the phases of its sines", mend,
                         lambda t: "phase of a drive", target=where)


def _every_spring(scene: Scene) -> Iterator[Alteration]:
    """The same mistake in every spring, also in those that copies of the scene have."""
    for kind, keys, text, none in (
            ("spring stiffness", ("stiffness",), "stiffness", "missing spring"),
            ("spring free length", tuple(RESTS.values()), "free length or rest angle", "spring free length"),
            ("damping", ("damping",), "damping", "missing damper")):
        def times(m: Model, t: np.ndarray, keys: tuple[str, ...] = keys) -> Model:
            return m.with_force(None, lambda each: {key: t[0] * value for key, value in each.parameters.items() if
                                                    each.is_spring and key in keys and isinstance(value, int | float)})

        if any(force.parameters.get(key) for force in scene.loads for key in keys if force.is_spring):
            yield Alteration(kind, times, ((1.0,),),
                             lambda t, text=text: f"{text} of every spring times {t[0]:.6g}",  # type: ignore[misc]
                             EVERY, lambda t, kind=kind, none=none: none if abs(t[0]) < GONE  # type: ignore[misc]
                             else kind, _none)
    if any(force.type == "linear_spring" and force.parameters["damping"] for force in scene.loads):
        yield Alteration("spring stiffness", lambda m, t: m.with_force(None, lambda force: {
            key: t[0] * force.parameters[key] for key in ("stiffness", "damping")} if (
                force.type == "linear_spring") else {}), ((1.0,),), lambda t: (
                    f"stiffness and damping of all linear springs times {t[0]:.6g}"), EVERY, lambda t: (
                        "missing spring" if abs(t[0]) < GONE else "spring stiffness"), _none, alone=True)
    if any(force.type == "linear_spring" for force in scene.loads):
        yield Alteration("moment of a force", lambda m, t: m.replace(levers=dict.fromkeys(m.numbers, t[0])), ((1.0,),),
                         lambda t: f"moments about the centres of mass of every spring times {t[0]:.6g}", EVERY, None,
                         _none)


EVERY = "check how springs are converted for the engine"


def _none(_theta: np.ndarray) -> list[tuple[float, ...]]:
    """The special magnitude of a term that may be missing."""
    return [(0.0,)]


WITHOUT_FRICTION = "switch off damping, friction and armature that the scene does not have"


def _slowed(scene: Scene) -> Iterator[Alteration]:
    """Damping and friction that the scene does not have."""
    for kind, text, *fields in (
            *((("extra damping", "{:.6g} N m s/rad at every joint", "joint_damping"),) if scene.joints else ()),
            ("extra damping", "velocities decay at {:.6g} 1/s", "drag", "spin_drag"),
            ("extra damping", "angular velocities decay at {:.6g} 1/s", "spin_drag"),
            ("extra damping", "velocities of the centres of mass decay at {:.6g} 1/s", "drag"),
            ("quadratic drag", "a force of {:.6g} 1/m times m |v| v against the velocity of every body", "quadratic"),
            *((("Coulomb friction", "a moment of {:.6g} N m against the turning at every joint", "coulomb"),)
              if scene.joints else ())):
        yield Alteration(kind, lambda m, t, fields=fields: m.replace(**dict.fromkeys(fields, t[0])),
                         ((0.0,),), lambda t, text=text: text.format(t[0]),  # type: ignore[misc]
                         WITHOUT_FRICTION)
    sprung = {force.joint for force in scene.loads if force.is_spring}
    for joint in scene.joints if len(scene.joints) > 1 else ():
        if (joint.kind.turns or joint.kind.is_ball) and joint.name not in sprung:
            def damped(m: Model, t: np.ndarray, joint: Joint = joint) -> Model:
                there = any((each.name, each.type) == (joint.name, joint.type) for each in m.scene.joints)
                return m.replace(damped={**m.damped, joint.name: t[0]}) if there else m

            yield Alteration("extra damping", damped, ((0.0,),), lambda t, name=joint.name: (  # type: ignore[misc]
                f"{t[0]:.6g} N m s/rad at joint {name!r}"), WITHOUT_FRICTION, target=joint.name)

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
        def apply(m: Model, t: np.ndarray) -> Model:
            for joint, k in keys:
                m = m.with_joint(joint.name, lambda each, k=k: dataclasses.replace(  # type: ignore[misc]
                    each, armature=tuple(abs(t[0]) * (value if len(keys) > 1 else 1.0) if at == k else value
                                         for at, value in enumerate(each.armature or (0.0,) * len(
                                             each.kind.coordinates)))) if each.kind.is_elastic else each)
            return m

        return Alteration("armature", apply, ((begin,),), lambda t: f"{where} {abs(t[0]):.6g} instead of {size:.6g}",
                          "check the armature that the engine is given", lambda t: "extra armature" if not size else
                          "missing armature" if abs(t[0]) < GONE * size else "armature", _none, target=where,
                          alone=not size)

    every = [(joint, k) for joint in scene.joints if joint.kind.is_elastic for k in range(len(joint.kind.coordinates))]
    given = [(joint, k) for joint, k in every if joint.armature and joint.armature[k]]
    if len(given) > 1:
        yield scaled(given, "armature of all joints, as a part of the scene's,", 1.0, 1.0)
    for joint, k in every:
        size = joint.armature[k] if joint.armature else 0.0
        yield scaled([(joint, k)], f"armature of joint {joint.name!r}", size, size)


def _terms(scene: Scene) -> Iterator[Alteration]:
    """Terms of the equations of motion left out or scaled."""
    for k, body in enumerate([None, *(scene.bodies if scene.n > 1 else ())]):
        def turning(m: Model, t: np.ndarray, k: int = k) -> Model:
            factors = np.array(np.broadcast_to(m.gyroscopic, (scene.n,)), dtype=float)
            factors[slice(None) if k == 0 else k - 1] = t[0]
            return m.replace(gyroscopic=factors)

        of = "" if body is None else f" of body {body.name!r}"
        yield Alteration("gyroscopic term", turning, ((1.0,),),
                         lambda t, of=of: f"w x J w{of} times {t[0]:.6g}",  # type: ignore[misc]
                         "check the term w x J w of the rotational equations", None, _none,
                         target="" if body is None else body.name)
    if scene.joints:
        yield Alteration("centripetal term", lambda m, t: m.replace(centripetal=t[0]), ((1.0,),),
                         lambda t: f"gamma of G du/dt + gamma = 0 times {t[0]:.6g}", "check the terms of the "
                         "constraints' second derivative that are quadratic in the velocities", None, _none)


def _sizes(scene: Scene, where: str, bodies: tuple[int, ...]) -> Iterator[Alteration]:
    """Masses of all bodies; sizes, products and entries of inertias, of all bodies or of one."""
    mend = f"check the inertia that the engine is given, {where}"
    whole = len(bodies) == scene.n

    def heavier(inertia: bool, text: str, unit: str, **more: Any) -> Alteration:
        return Alteration("mass", lambda m, t: m.with_bodies(lambda _, body: _heavier(np.exp(t[0]), body, inertia)),
                          ((0.1,),), lambda t: text.format(np.exp(t[0])), f"check the unit{unit}", **more)

    if whole and scene.n > 1:
        yield heavier(False, "masses of all bodies times {:.6g}, inertias as they are", " of masses", target=where)
    if whole and scene.loads:
        yield heavier(True, "masses and inertias of all bodies times {:.6g}", "s of masses, inertias and forces")
    yield Alteration("inertia size", _inertia(lambda J, _, t: np.exp(t[0]) * J, bodies), ((0.1,), (-1.0,)),
                     lambda t: f"{where}: inertia times {np.exp(t[0]):.6g}", mend, target=where)
    for factor, text in ((0.0, "left out"), (-1.0, "with the other sign")) if np.any(
            scene.inertias[list(bodies)] * ~DIAGONAL) else ():
        yield Alteration("products of inertia", _inertia(
            lambda J, _, t, factor=factor: np.where(DIAGONAL, J, factor * J), bodies), ((),),  # type: ignore[misc]
            lambda t, text=text: f"{where}: products of inertia {text}", mend, target=where)  # type: ignore[misc]
    if len(bodies) == 1:
        def entries(J: np.ndarray, _: int, t: np.ndarray) -> np.ndarray:
            return np.asarray(J + np.array([[t[0], t[3], t[4]], [t[3], t[1], t[5]], [t[4], t[5], t[2]]]))

        for name, unit in zip(("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz"), np.eye(6), strict=True):
            yield Alteration("inertia entries", _inertia(
                lambda J, k, t, unit=unit: entries(J, k, t[0] * unit), bodies), ((0.0,),),  # type: ignore[misc]
                lambda t, name=name: f"{where}: {name} off by {t[0]:+.6g} kg m^2", mend,  # type: ignore[misc]
                target=where, alone=True)
        yield Alteration("inertia entries", _inertia(entries, bodies), ((0.0,) * 6,), lambda t: f"{where}: Jxx, Jyy, "
                         f"Jzz, Jxy, Jxz, Jyz off by {', '.join(f'{value:+.4g}' for value in t)}", mend, target=where,
                         alone=True, last=True)


def _exchanged(scene: Scene) -> Iterator[Alteration]:
    """Masses, inertias or both of two bodies exchanged."""
    for one, other in itertools.combinations(range(scene.n), 2):
        names = f"{scene.bodies[one].name!r} and {scene.bodies[other].name!r}"
        for keys, text in ((("mass",), "masses"), (("inertia",), "inertias"),
                           (("mass", "inertia"), "masses and inertias")):
            def swapped(m: Model, _: np.ndarray, pair: tuple[int, int] = (one, other), keys: tuple[str, ...] = keys
                        ) -> Model:
                return m.with_bodies(lambda k, body: {key: getattr(m.scene.bodies[sum(pair) - k], key) for key in keys},
                                     pair)

            yield Alteration(f"{text} swapped", swapped, ((),),
                             lambda t, names=names: f"of bodies {names}",  # type: ignore[misc]
                             "check the order in which bodies reach the engine", target=names, alone=True)
