"""Hypotheses about an engine's model. Each turns the right parameters into wrong ones by magnitudes that are fitted."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from crosscheck.diagnosis.physics import SPRINGS, Physics, levers
from crosscheck.scene.model import Scene

Apply = Callable[[Physics, np.ndarray], Physics]
Say = Callable[[np.ndarray], str]
Special = Callable[[np.ndarray], Sequence[tuple[float, ...]]]

MASSLESS = 1e-3
"""Part of the scene's mass below which a mass counts as none."""

GONE = 1e-6
"""Part of the scene's value below which a stiffness, a damping or a gravity counts as none."""

PARALLEL = 1e-9
"""One minus the cosine of the angle between a fitted gravity and the scene's, below which it is rounding of the fit."""

TURNED = (("R J R^T: body components taken as components in world axes", lambda R, J: R @ J @ np.swapaxes(R, 1, 2)),
          ("R^T J R: components turned the wrong way", lambda R, J: np.swapaxes(R, 1, 2) @ J @ R))

DIAGONAL = np.eye(3, dtype=bool)


@dataclasses.dataclass(frozen=True)
class Cause:
    """A hypothesis: `apply` alters parameters by magnitudes theta, and `starts` are where their fit begins.

    The causes of a pair are of different families. `title` names a cause by its magnitudes if the name of the family is
    not enough. `special` lists magnitudes near fitted ones that have a name of their own, the simplest first.
    """

    family: str
    apply: Apply
    starts: tuple[tuple[float, ...], ...]  # ((),): nothing to fit
    say: Say
    mend: str
    title: Say | None = None
    special: Special = lambda theta: ()
    mistakes: Callable[[np.ndarray], int] = lambda theta: 1
    """Number of mistakes that lead to these magnitudes. Of equal explanations that with the fewest is named."""
    target: str = ""
    """The part of the model that it alters. Two causes of one family make a pair if these differ."""
    alone: bool = False
    """Whether it is never part of a pair."""
    last: bool = False
    """Whether it is tried only if no pair explains: with its many magnitudes it would stand for several others."""

    def name(self, theta: np.ndarray) -> str:
        """The cause in a few words."""
        return self.family if self.title is None else self.title(theta)

    @property
    def free(self) -> int:
        """Number of magnitudes."""
        return len(self.starts[0])


@dataclasses.dataclass(frozen=True)
class Context:
    """The scene and its copies to which the hypotheses apply."""

    scene: Scene
    attitudes: tuple[np.ndarray, ...]
    """(E, n, 3, 3) at the start of each copy: those that the engine shows and, if they differ, those of the scene."""
    right: Physics  # the parameters as they should be


def causes(context: Context) -> list[Cause]:
    """All hypotheses about the model that make sense for a scene."""
    scene = context.scene
    scopes: list[tuple[str, tuple[int, ...]]] = [("all bodies", tuple(range(scene.n)))]
    if scene.n > 1:
        scopes += [(f"body {body.name!r}", (k,)) for k, body in enumerate(scene.bodies)]
    named = [_gravity(scene)]
    if scene.gravity.any():  # on a hinge, gravity of another size is one of many gravities with the same motion
        named.append(dataclasses.replace(named[0], apply=lambda p, t: p.replace(gravity=t[0] * scene.gravity), starts=(
            (1.0,),), say=lambda t: named[0].say(t[0] * scene.gravity), title=lambda t: named[0].name(
                t[0] * scene.gravity), special=lambda t: [(0.0,), (-1.0,)], mistakes=lambda t: 1, alone=True))
    named += [cause for where, bodies in scopes for cause in _inertias(context, where, bodies)]
    named += [cause for k in range(scene.n) for cause in _masses(scene, k)]
    named += [cause for where, bodies in scopes for cause in _sizes(context, where, bodies)]
    named += list(_exchanged(scene))
    named += [cause for k in range(len(scene.loads)) for cause in _force(scene, k)]
    if any(force.type in SPRINGS for force in scene.loads):
        named += list(_every_spring(context.right))
    return [*named, *_rotors(context.right, scene), *_slowed(scene), *_terms(scene)]


def _gravity(scene: Scene) -> Cause:
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
    return Cause("gravity", lambda p, t: p.replace(gravity=np.array(t)), (tuple(start.tolist()),),
                 lambda t: f"gravity {_vector(t)} m/s^2 instead of {_vector(g)}",
                 "check sign, size and axis of the gravity the engine is given", title, special, mistakes)


def _vector(values: np.ndarray) -> str:
    """Three numbers without the noise of the fit."""
    size = float(np.abs(values).max())
    return f"({', '.join(f'{0.0 if abs(value) < 1e-6 * size else value:.6g}' for value in values)})"


def _inertias(context: Context, where: str, bodies: tuple[int, ...]) -> Iterator[Cause]:
    s = levers(context.scene)
    shifts = context.scene.masses[:, None, None] * (
        np.sum(s * s, axis=1)[:, None, None] * np.eye(3) - s[:, :, None] * s[:, None, :])
    axes = "give the inertia in the axes the engine expects: those of the body"

    def moved(p: Physics, t: np.ndarray) -> Physics:
        return _changed(p, bodies, lambda J, k: J + t[0] * shifts[k])

    def rotated(p: Physics, t: np.ndarray) -> Physics:
        from scipy.spatial.transform import Rotation

        Q = Rotation.from_rotvec(t).as_matrix()
        return _changed(p, bodies, lambda J, k: Q @ J @ Q.T)

    def reframed(attitudes: np.ndarray, text: str, turn: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Cause:
        return Cause("inertia frame", lambda p, t: _changed(p, bodies, lambda J, k: turn(attitudes[:, k], J)), ((),),
                     lambda t: f"{where}: {text}", axes)

    def angle(t: np.ndarray) -> str:
        if len(bodies) == 1:
            t = least_turn(t, context.right.inertias[0, bodies[0]])
        size = float(np.linalg.norm(t))
        return (f"{where}: inertia turned by {np.degrees(size):.5g} deg about {_vector(t / max(size, 1e-300))}, body "
                "axes")

    if any(shifts[k].any() for k in bodies):
        yield Cause("inertia point", moved, ((0.2,), (1.0,), (-0.2,)),
                    lambda t: f"{where}: inertia off by {t[0]:+.6g} times mass (s^2 I - s s^T), s from the centre of "
                              "mass to the joint; +1 would be the inertia about the joint",
                    "give the inertia about the point the engine expects: the centre of mass, or the joint")
    for attitudes, (text, turn) in itertools.product(context.attitudes, TURNED):
        yield reframed(attitudes, text, turn)
    yield Cause("inertia frame", rotated, ((0.1, 0.1, 0.1), (0.7, -0.5, 0.3), (-0.5, 0.8, -0.9)), angle, axes)


def least_turn(theta: np.ndarray, J: np.ndarray) -> np.ndarray:
    """The smallest rotation vector that turns an inertia J into the same as theta does: half turns about the principal
    axes change nothing."""
    from scipy.spatial.transform import Rotation

    halves = [np.zeros(3), *(np.pi * axis for axis in np.linalg.eigh(J)[1].T)]
    turns = [(Rotation.from_rotvec(theta) * Rotation.from_rotvec(half)).as_rotvec() for half in halves]
    return min(turns, key=lambda turn: float(np.linalg.norm(turn)))


def _changed(p: Physics, bodies: tuple[int, ...], change: Callable[[np.ndarray, int], np.ndarray]) -> Physics:
    """Parameters in which `change` alters the inertias (E, 3, 3) of some bodies."""
    inertias = p.inertias.copy()
    for k in bodies:
        inertias[:, k] = change(p.inertias[:, k], k)
    return p.replace(inertias=inertias)


def _masses(scene: Scene, k: int) -> Iterator[Cause]:
    name = scene.bodies[k].name
    mend = f"check that body {name!r} and its mass reach the engine"

    def mass_alone(p: Physics, t: np.ndarray) -> Physics:
        return p.replace(masses=_with(p.masses, k, p.masses[k] * np.exp(t[0])))

    def mass(p: Physics, t: np.ndarray) -> Physics:
        return _changed(mass_alone(p, t), (k,), lambda J, _: np.exp(t[0]) * J)

    yield Cause("mass", mass, ((0.1,), (-1.0,), (-5.0,)),
                lambda t: f"mass and inertia of body {name!r} times {np.exp(t[0]):.6g}", mend,
                lambda t: "missing body" if np.exp(t[0]) < MASSLESS else "mass", target=name)
    yield Cause("mass", mass_alone, ((0.1,), (-1.0,)),
                lambda t: f"mass of body {name!r} times {np.exp(t[0]):.6g}, inertia as it is", mend, target=name)


def _force(scene: Scene, k: int) -> Iterator[Cause]:
    """Hypotheses about one spring or load."""
    force, own = scene.loads[k], k - len(scene.loads) + len(scene.forces)
    where, p = f"{f'joint {force.joint!r}' if own < 0 else f'forces[{own}]'} ({force.type})", force.parameters
    mend = f"check {where} on its way into the engine"

    def entry(family: str, field: str, value: float, text: str, title: Say | None = None) -> Cause:
        return Cause(family, lambda q, t: q.replace(**{field: _with(getattr(q, field), k, t[0])}), ((value,),),
                     lambda t: f"{where}: {text} {t[0]:.6g} instead of {value:.6g}", mend, title, _none, target=where)

    if force.type in ("linear_spring", "constant_force"):
        yield Cause("moment of a force", lambda q, t: q.replace(lever=_with(_levers(q), k, t[0])), ((1.0,),),
                    lambda t: f"{where}: its moments about the centres of mass times {t[0]:.6g}",
                    "apply the force at its point: it has a moment about the centre of mass", None, _none, target=where)
        yield Cause("point of a force", lambda q, t: q.replace(point=(k, t)), ((0.0,) * 3,),
                    lambda t: f"{where}: its point on body {scene.bodies[force.child].name!r} off by {_vector(t)} m",
                    mend, target=where, alone=True)
    if force.type in ("constant_force", "constant_torque"):
        yield Cause("frame of a load", lambda q, t: q.replace(reframed=(*q.reframed, k)), ((),),
                    lambda t: f"{where}: its components are those of {p['frame']} axes and are taken in the other ones",
                    mend, target=where)
    if force.functions:
        yield from _drive(scene, k, where, mend)
    elif force.type not in SPRINGS:
        yield entry("load", "load", 1.0, "factor of the load")
    if force.type not in SPRINGS:
        return
    rest = {"linear_spring": "free_length", "slide_spring": "rest_position"}.get(force.type, "rest_angle")
    unit, value = "rad" if force.type == "torsional_spring" else "m", p[rest]
    stiffness, damping = p["stiffness"], p["damping"]
    if stiffness:
        yield entry("spring stiffness", "stiffness", stiffness, "stiffness",
                    lambda t: "missing spring" if abs(t[0]) < GONE * stiffness else "spring stiffness")
        if not force.functions:
            yield entry("spring free length", "rest", value, f"{rest} ({unit})", lambda t: "wrapped angle" if
                        unit == "rad" and round(abs(t[0] - value) / math.tau, 6) in (1, 2, 3) else "spring free length")
        yield Cause("missing spring", lambda q, t: q.replace(stiffness=_with(q.stiffness, k, 0.0),
                                                             damping=_with(q.damping, k, 0.0)), ((),),
                    lambda t: f"{where} is not there", mend)
    yield entry("damping", "damping", damping, "damping",
                lambda t: "extra damping" if not damping else "missing damper" if abs(t[0]) < GONE * damping
                else "damping")


UNITS = ((0.0, "missing drive"), (-1.0, "sign of a drive"), (math.degrees(1.0), "unit of a drive"),
         (math.radians(1.0), "unit of a drive"))
"""Factors of functions of time that have a name: none, the wrong sign, degrees for radians and the reverse."""


def _drive(scene: Scene, k: int, where: str, mend: str) -> Iterator[Cause]:
    """Hypotheses about the function of time in a force: its size and its delay."""
    none = np.zeros(len(scene.loads))

    def named(t: np.ndarray) -> str:
        return next((name for factor, name in UNITS if abs(t[0] - factor) <= GONE * max(1.0, abs(factor))),
                    "amplitude of a drive")

    yield Cause("drive", lambda q, t: q.replace(load=_with(q.load, k, t[0])), ((1.0,), (-1.0,)),
                lambda t: f"{where}: its function of time times {t[0]:.6g}", mend, named,
                lambda t: [(factor,) for factor, _ in UNITS], target=where)
    terms = scene.loads[k].functions[0].terms
    starts = ((1e-2,), (-1e-2,))
    alike = f", which is a phase of {{:.6g}} rad at {terms[0][1]:g} rad/s" if len(terms) == 1 else ""
    yield Cause("drive delay", lambda q, t: q.replace(delay=_with(none if q.delay is None else q.delay, k, t[0])),
                starts, lambda t: f"{where}: its function of time comes {t[0]:.6g} s late"
                + (alike.format(-terms[0][1] * t[0]) if alike else ""), mend,
                lambda t: "phase or delay of a drive" if alike else "delay of a drive", target=where)
    if len(terms) > 1:
        yield Cause("drive phase", lambda q, t: q.replace(phase=_with(none if q.phase is None else q.phase, k, t[0])),
                    ((0.1,), (-0.1,)), lambda t: f"{where}: {t[0]:.6g} rad added to the phases of its sines", mend,
                    lambda t: "phase of a drive", target=where)


def _with(values: np.ndarray, k: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[k] = value
    return changed


def _every_spring(right: Physics) -> Iterator[Cause]:
    """The same mistake in every spring, also in those that copies of the scene have."""
    def every(family: str, field: str, text: str, none: str) -> Cause:
        def apply(p: Physics, t: np.ndarray) -> Physics:
            return p.replace(**{field: t[0] * (_levers(p) if field == "lever" else getattr(p, field))})

        return Cause(family, apply, ((1.0,),), lambda t: f"{text} of every spring times {t[0]:.6g}",
                     "check how springs are converted for the engine", lambda t: none if abs(t[0]) < GONE else family,
                     _none)

    for family, field, text, none in (("spring stiffness", "stiffness", "stiffness", "missing spring"),
                                      ("spring free length", "rest", "free length or rest angle", "spring free length"),
                                      ("damping", "damping", "damping", "missing damper")):
        if np.any(getattr(right, field)):
            yield every(family, field, text, none)
    if len(right.stiffness) > 1:  # of a single spring `_force` says it
        yield every("moment of a force", "lever", "moments about the centres of mass", "moment of a force")


def _none(_theta: np.ndarray) -> list[tuple[float, ...]]:
    """The special magnitude of a term that may be missing."""
    return [(0.0,)]


def _slowed(scene: Scene) -> Iterator[Cause]:
    """Damping and friction that the scene does not have."""
    def slowed(family: str, text: str, *fields: str) -> Cause:
        return Cause(family, lambda p, t: p.replace(**dict.fromkeys(fields, t[0])), ((0.0,),),
                     lambda t: text.format(t[0]),
                     "switch off damping, friction and armature that the scene does not have")

    if scene.joints:
        yield slowed("extra damping", "{:.6g} N m s/rad at every joint", "joint_damping")
    yield slowed("extra damping", "velocities decay at {:.6g} 1/s", "drag", "spin_drag")
    yield slowed("extra damping", "angular velocities decay at {:.6g} 1/s", "spin_drag")
    yield slowed("extra damping", "velocities of the centres of mass decay at {:.6g} 1/s", "drag")
    yield slowed("quadratic drag", "a force of {:.6g} 1/m times m |v| v against the velocity of every body",
                 "quadratic")
    if scene.joints:
        yield slowed("Coulomb friction", "a moment of {:.6g} N m against the turning at every joint", "coulomb")


    across = np.linalg.svd(scene.gravity[None])[2][1:] if scene.gravity.any() else np.eye(3)  # no wind is vertical

    def blown(text: str, *fields: str) -> Cause:
        return Cause("wind", lambda p, t: p.replace(**dict.fromkeys(fields, t[0]), wind=t[1:] @ across),
                     ((0.01, *[1.0] * len(across)),), lambda t: text.format(t[0], _vector(t[1:] @ across)),
                     "switch off wind and the medium that the scene does not have", alone=True)

    yield blown("bodies are slowed at {:.6g} 1/s in air that moves at {} m/s", "drag")
    yield blown("bodies and their turning are slowed at {:.6g} 1/s in air that moves at {} m/s", "drag", "spin_drag")
    yield blown("a force of {:.6g} 1/m times m |v| v, v against air that moves at {} m/s", "quadratic")


def _rotors(right: Physics, scene: Scene) -> Iterator[Cause]:
    """Rotor inertias of joints: all of them, or one, also where the scene has none."""
    def scaled(keys: Sequence[tuple[str, int]], where: str, begin: float) -> Cause:
        size = right.rotors.get(keys[0], 0.0) if len(keys) == 1 else 1.0

        def apply(p: Physics, t: np.ndarray) -> Physics:
            return p.replace(rotors={**p.rotors, **{key: t[0] * (p.rotors[key] if len(keys) > 1 else 1.0)
                                                    for key in keys}})

        return Cause("armature", apply, ((begin,),), lambda t: f"{where} {t[0]:.6g} instead of {size:.6g}",
                     "check the armature that the engine is given", lambda t: "extra armature" if not size else
                     "missing armature" if abs(t[0]) < GONE * size else "armature", _none, target=where, alone=not size)

    given = [key for key, value in right.rotors.items() if value]
    if len(given) > 1:
        yield scaled(given, "armature of all joints, as a part of the scene's,", 1.0)
    for joint in scene.joints:
        for k in range(len(joint.kind.coordinates) if joint.kind.is_elastic else 0):
            key = joint.name, k
            yield scaled([key], f"armature of joint {joint.name!r}", right.rotors.get(key, 0.0))


def _terms(scene: Scene) -> Iterator[Cause]:
    """Terms of the equations of motion left out or scaled."""
    mend = "check the term w x J w of the rotational equations"

    def gyroscopic_of(k: int, name: str) -> Cause:
        return Cause("gyroscopic term", lambda p, t: p.replace(gyroscopic=_with(np.broadcast_to(
            p.gyroscopic, (scene.n,)), k, t[0])), ((1.0,),), lambda t: f"w x J w of body {name!r} times {t[0]:.6g}",
            mend, None, _none, target=name)

    yield Cause("gyroscopic term", lambda p, t: p.replace(gyroscopic=t[0]), ((1.0,),),
                lambda t: f"w x J w times {t[0]:.6g}", mend, None, _none)
    for k, body in enumerate(scene.bodies) if scene.n > 1 else ():
        yield gyroscopic_of(k, body.name)
    if scene.joints:
        yield Cause("centripetal term", lambda p, t: p.replace(centripetal=t[0]), ((1.0,),),
                    lambda t: f"gamma of G du/dt + gamma = 0 times {t[0]:.6g}",
                    "check the terms of the constraints' second derivative that are quadratic in the velocities", None,
                    _none)


def _levers(p: Physics) -> np.ndarray:
    return np.ones(len(p.stiffness)) if p.lever is None else p.lever


def _sizes(context: Context, where: str, bodies: tuple[int, ...]) -> Iterator[Cause]:
    """Masses of all bodies; sizes, products and entries of inertias, of all bodies or of one."""
    mend = f"check the inertia that the engine is given, {where}"
    whole = len(bodies) == context.scene.n

    def heavier(p: Physics, t: np.ndarray) -> Physics:
        return p.replace(masses=np.exp(t[0]) * p.masses)

    if whole and context.scene.n > 1:
        yield Cause("mass", heavier, ((0.1,),), lambda t: f"masses of all bodies times {np.exp(t[0]):.6g}, inertias as "
                    "they are", "check the unit of masses", target=where)
    if whole and context.scene.loads:
        yield Cause("mass", lambda p, t: _changed(heavier(p, t), bodies, lambda J, _: np.exp(t[0]) * J), ((0.1,),),
                    lambda t: f"masses and inertias of all bodies times {np.exp(t[0]):.6g}",
                    "check the units of masses, inertias and forces", target=where)
    yield Cause("inertia size", lambda p, t: _changed(p, bodies, lambda J, _: np.exp(t[0]) * J), ((0.1,), (-1.0,)),
                lambda t: f"{where}: inertia times {np.exp(t[0]):.6g}", mend, target=where)
    if np.any(context.right.inertias[:, bodies] * ~DIAGONAL):
        yield Cause("products of inertia", lambda p, t: _changed(p, bodies, lambda J, _: J * DIAGONAL), ((),),
                    lambda t: f"{where}: products of inertia left out", mend, target=where)
        yield Cause("products of inertia", lambda p, t: _changed(p, bodies, lambda J, _: np.where(DIAGONAL, J, -J)),
                    ((),), lambda t: f"{where}: products of inertia with the other sign", mend, target=where)
    if len(bodies) == 1:
        def entries(p: Physics, t: np.ndarray) -> Physics:
            added = np.array([[t[0], t[3], t[4]], [t[3], t[1], t[5]], [t[4], t[5], t[2]]])
            return _changed(p, bodies, lambda J, _: J + added)

        def text_of(t: np.ndarray) -> str:
            return f"{where}: Jxx, Jyy, Jzz, Jxy, Jxz, Jyz off by {', '.join(f'{value:+.4g}' for value in t)}"

        def one(name: str, unit: np.ndarray) -> Cause:
            return Cause("inertia entries", lambda p, t: entries(p, t[0] * unit), ((0.0,),),
                         lambda t: f"{where}: {name} off by {t[0]:+.6g} kg m^2", mend, target=where, alone=True)

        yield from map(one, ("Jxx", "Jyy", "Jzz", "Jxy", "Jxz", "Jyz"), np.eye(6))
        yield Cause("inertia entries", entries, ((0.0,) * 6,), text_of, mend, target=where, alone=True, last=True)


def _exchanged(scene: Scene) -> Iterator[Cause]:
    """Masses, inertias or both of two bodies exchanged."""
    def swapped(one: int, other: int, text: str, masses: bool, inertias: bool) -> Cause:
        order = list(range(scene.n))
        order[one], order[other] = other, one
        names = f"{scene.bodies[one].name!r} and {scene.bodies[other].name!r}"
        return Cause(text, lambda p, t: p.replace(masses=p.masses[order] if masses else p.masses,
                                                  inertias=p.inertias[:, order] if inertias else p.inertias),
                     ((),), lambda t: f"of bodies {names}", "check the order in which bodies reach the engine",
                     target=names, alone=True)

    for pair in itertools.combinations(range(scene.n), 2):
        yield swapped(*pair, "masses swapped", True, False)
        yield swapped(*pair, "inertias swapped", False, True)
        yield swapped(*pair, "masses and inertias swapped", True, True)
