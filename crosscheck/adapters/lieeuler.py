"""Adapter of lieeuler; crosscheck treats it like any other engine."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np

import lieeuler
from crosscheck.adapters.base import Engine, RawRun, RunSpec, Stats, steps_per_sample
from crosscheck.adapters.common.held import highest_order
from crosscheck.errors import ArgumentError, CrosscheckError, Unsupported
from crosscheck.scene.basics import row_vectors
from crosscheck.scene.coordinates import (
    at_start,
    followed,
    hinge_angles,
    offset_from_half_turn,
    starting,
    zero_attitude,
)
from crosscheck.scene.functions import TimeFunction, Value
from crosscheck.scene.model import ELEMENTS, GROUND, Force, Joint, Scene
from crosscheck.scene.states import States


def build_problem(scene: Scene) -> lieeuler.Problem:
    """The scene as a `lieeuler.Problem`, with joints in file order, so that rows of lam are those of the scene."""
    bodies = tuple(lieeuler.Body(body.mass, body.inertia) for body in scene.bodies)
    joints = tuple(_joint(scene, joint) for joint in scene.joints)
    forces = tuple(_force(scene, force) for force in scene.loads if not force.law.has_modes)
    return lieeuler.Problem(bodies, joints, scene.gravity, scene.x0, scene.R0, scene.v0, scene.w0, forces,
                            laws=laws(scene))


def laws(scene: Scene) -> tuple[lieeuler.Law, ...]:
    """The laws of the joints: one for each coordinate that has dry friction, limits or a servo."""
    servos: dict[str, list[lieeuler.Servo]] = {}
    for name, servo in scene.servos.values():
        lower, upper = servo.effort_limit or (-math.inf, math.inf)
        servos.setdefault(name, []).append(lieeuler.Servo(
            servo.proportional, servo.derivative, _value(servo.target), _value(servo.target_velocity),
            _value(servo.feedforward), lower, upper, servo.no_load_speed, servo.period, servo.delay, servo.phase,
            servo.held))
    begin, made = at_start(scene), []
    for index, joint in enumerate(scene.joints):
        for k, word in enumerate(joint.kind.coordinates):
            friction = joint.dry_friction[k] if joint.dry_friction else None
            limits = joint.limits[k] if joint.limits else None
            own = tuple(servos.get(joint.name, ())) if k == 0 else ()
            if friction is None and limits is None and not own:
                continue
            coordinate = lieeuler.Coordinate(joint.parent_axis, joint.child_axis,
                                             zero_attitude(joint).T if word == "turn" else None)
            sliding, static = (0.0, 0.0) if friction is None else (friction.sliding, friction.static)
            stops = None if limits is None else lieeuler.Stops(limits.lower, limits.upper, limits.restitution,
                                                               limits.stiffness, limits.damping)
            made.append(lieeuler.Law(index, coordinate, float(begin[joint.name][0][k]), own, sliding, static, stops))
    return tuple(made)


_KEPT: OrderedDict[object, tuple[Scene, lieeuler.Problem]] = OrderedDict()
MOST_KEPT = 8


def kept_problem(scene: Scene) -> lieeuler.Problem:
    """That of `build_problem`, made once for the scenes of the same bodies, joints and forces: those that differ in
    samples or duration alone share the plans of their runs."""
    key = id(scene.bodies), id(scene.joints), id(scene.forces), scene.gravity.tobytes()
    if key not in _KEPT:  # a kept scene keeps its parts alive, so that no others get their identity
        _KEPT[key] = scene, build_problem(scene)
        if len(_KEPT) > MOST_KEPT:
            _KEPT.popitem(last=False)
    return _KEPT[key][1]


def motion(scene: Scene, method: str, step: float, t: np.ndarray) -> States:
    """States at any increasing times (s), of which the first is that of the scene's start, by steps of a fixed size.

    Raises `ArgumentError` if the run ends early.
    """
    try:
        solution = lieeuler.integrate(build_problem(scene), method, step, t, monitor=False)
    except (lieeuler.IntegrationError, lieeuler.LieEulerError) as error:
        raise ArgumentError(str(error)) from error
    states = States(*(np.asarray(getattr(solution, name)) for name in ("t", "x", "R", "v", "w", "a", "alpha", "lam")))
    states.hinges = _turned(scene, step, states, lambda t: lieeuler.integrate(build_problem(scene), method, step, t,
                                                                              monitor=False))
    return states


def start(problem: lieeuler.Problem, step: float = 1e-6) -> lieeuler.Solution:
    """A run of one step (s), whose first row is the initial state with the kernel's index-1 accelerations and lam."""
    return lieeuler.integrate(problem, "INDEX1_LE", step, np.array([0.0, step]), monitor=False)


def _joint(scene: Scene, joint: Joint) -> lieeuler.Joint:
    """The joint, from the rows of its type."""
    kind, dots, contact = joint.kind, list[lieeuler.Dot](), None
    if kind.slips:
        word = "sphere" if joint.child_axis is None else "disk" if joint.radius else "edge"
        contact = lieeuler.Contact(word, joint.parent_axis, joint.parent_axis if joint.child_axis is None else (
            joint.child_axis), joint.radius or 0.0)
    else:
        inner, outer = row_vectors(joint, scene.R0[joint.child].T @ (
            np.eye(3) if joint.parent == GROUND else scene.R0[joint.parent]))
        for row in kind.rows:
            match row.kind:
                case "dot1":
                    dots.append(lieeuler.Dot("parent", "child", inner[row.parent], outer[row.child]))
                case "dot2":
                    dots.append(lieeuler.Dot("parent", "difference", inner[row.parent]))
                case "point":
                    pass
                case _:  # a rod
                    dots.append(lieeuler.Dot("difference", "difference", constant=0.5 * joint.length,
                                             scale=0.5 / joint.length))
    made = lieeuler.Joint(joint.parent, joint.child, joint.parent_anchor, joint.child_anchor,
                          kind.anchors_coincide, tuple(dots), contact=contact)
    made = made.geared(*(lieeuler.Rotor(inertia, joint.parent_axis, joint.child_axis, word == "turn")
                         for inertia, word in zip(joint.armature, kind.coordinates, strict=False) if inertia))
    if joint.drive is not None:
        return made.driven(lieeuler.Drive(_value(joint.drive), _coordinate(joint)))
    if joint.mimic is None:
        return made
    names = [each.name for each in scene.joints]
    leader = names.index(joint.mimic.joint)
    return made.following(lieeuler.Mimic(leader, _coordinate(joint), _coordinate(scene.joints[leader]),
                                         joint.mimic.ratio, offset_from_half_turn(scene, joint)))


def _coordinate(joint: Joint) -> lieeuler.Coordinate:
    return lieeuler.Coordinate(joint.parent_axis, joint.child_axis,
                               zero_attitude(joint).T if joint.kind.turns else None)


def _force(scene: Scene, force: Force) -> lieeuler.forces.Force:
    p, measure = {key: _value(value) for key, value in force.parameters.items()}, force.law.measure
    if measure == "length":
        return lieeuler.LinearSpring(force.parent, force.child, p["parent_point"], p["child_point"], p["stiffness"],
                                     p["free_length"], p["damping"])
    if measure in ("force", "torque"):
        return lieeuler.ConstantLoad(force.child, **{measure: p[measure]}, point=p.get("child_point", np.zeros(3)),
                                     frame=p["frame"], factor=p.get("factor"))
    joint, rest = scene.joint(force.joint), p.get(force.law.rest, 0.0)
    if measure == "slide":
        return lieeuler.SlideForce(joint.parent, joint.child, joint.parent_anchor, joint.child_anchor,
                                   joint.parent_axis, p.get("force", 0.0), p.get("stiffness", 0.0), rest,
                                   p.get("damping", 0.0))
    made = lieeuler.TorsionalSpring(joint.parent, joint.child, joint.parent_axis, joint.child_axis,
                                    p.get("stiffness", 0.0), rest, p.get("damping", 0.0), p.get("torque", 0.0))
    if not p.get("stiffness"):
        return made
    begin = at_start(scene)[joint.name][0][joint.kind.number(measure)] + joint.zero_angle
    return made.counted_from(2.0 * math.pi * round((begin - made.start_angle(scene.R0)) / (2.0 * math.pi)))


def _value(value: Value) -> Any:
    """A number, or a function of time as lieeuler's type."""
    if not isinstance(value, TimeFunction):
        return value
    return lieeuler.TimeFunction(value.pieces, value.terms, value.breaks)


MOST_PARTS = 512
"""Of an interval between outputs, at the ends of which a run that chooses its steps is asked how far hinges turned."""


def _turned(scene: Scene, step: float | None, states: States, solve: Callable[[np.ndarray], lieeuler.Solution]
            ) -> np.ndarray:
    """(T, h) rad: the angles of hinges at the output times, with their turns.

    Where these times are too far apart to tell the turns, the same run is asked for more of them, up to every step.
    """
    known, parts, intervals = hinge_angles(scene, states), 1, len(states.t) - 1
    most = MOST_PARTS if step is None else math.ceil(float(np.diff(states.t).max()) / step * (1 - 1e-12))
    while np.isnan(known).any() and parts < most:
        parts = min(8 * parts, most)
        try:
            found = solve(np.interp(np.arange(parts * intervals + 1) / parts, np.arange(intervals + 1), states.t))
        except lieeuler.LieEulerError:
            break
        between = States(*(np.asarray(getattr(found, name)) for name in "txRvw"))
        if parts == most and step is not None:
            before = starting(scene)
            before.hinges = hinge_angles(scene, before)
            between.hinges = followed(scene, between, before)
        known = hinge_angles(scene, between)[::parts]
    return known


class IntegrationError(CrosscheckError, lieeuler.IntegrationError):
    """A run of lieeuler ended early: the error as one of crosscheck, with `status`, `advice` and `solution`."""


class LieEuler(Engine):
    """The methods of `lieeuler.METHODS`, in maximal coordinates with multipliers."""

    name = "lieeuler"
    methods = tuple(lieeuler.METHODS)
    forms = ("maximal",)
    adaptive_methods = tuple(name for name, method in lieeuler.METHODS.items() if "rtol" in method.controls)
    fixed_step_methods = tuple(name for name, method in lieeuler.METHODS.items() if "step" in method.controls)
    options = frozenset({"form", "coordinate_map", "events", "spin_free", "reduce", "polish", "alpha", "beta",
                         "spectral_radius", "correction", "conserve"})
    on_group = True
    pace = 1
    package = "lieeuler-crosscheck"

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """Order from the method's record, as far as events are located; None for adaptive runs."""
        order = lieeuler.METHODS[spec.method].order
        if spec.step is None or order is None:
            return None
        return min(order, highest_order(scene) or order) if spec.events is False else order

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """Levels from the method's record."""
        return frozenset(lieeuler.METHODS[spec.method].held)

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """All joints and forces are modelled, redundant constraints included."""
        if reason := scene.beyond(set(ELEMENTS) - {"frame"}):
            return reason
        if spec.form not in (None, *self.forms):
            return f"lieeuler works in maximal coordinates, form={spec.form!r} does not exist"
        controls = lieeuler.METHODS[spec.method].controls
        if spec.rtol is not None and "rtol" not in controls:
            return f"{spec.method} takes a fixed step, not rtol"
        if spec.step is not None and "step" not in controls:
            return f"{spec.method} chooses its steps by rtol, it takes no step"
        return self.refused_map(spec)

    def refused_map(self, spec: RunSpec) -> str | None:
        """Why the method does not work with the coordinate map of a request, or None if it does."""
        return lieeuler.METHODS[spec.method].refused_map(spec.coordinate_map or "exp")

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate with a fixed step (s) or a relative tolerance; maxima over every step come from the kernel.

        Raises
        ------
        IntegrationError
            The run ended early.
        Unsupported
            The motion has no unique continuation.
        ArgumentError
            An argument is wrong; the message is that of lieeuler.
        """
        step = spec.step
        if step and any(servo.period for _, servo in scene.servos.values()):
            with contextlib.suppress(ArgumentError):  # it finds the samples within steps, others have to meet them
                step = steps_per_sample(scene, step)[1]

        names = ("rtol", "alpha", "beta", "spectral_radius", "correction", "conserve", "polish")
        options = {name: value for name in names if (value := getattr(spec, name)) is not None}
        if "map" in lieeuler.METHODS[spec.method].options():
            options["map"] = spec.coordinate_map

        def solved(t: np.ndarray, monitor: bool) -> lieeuler.Solution:
            return lieeuler.integrate(kept_problem(scene), spec.method, step, t, spin_free=spec.spin_free,
                                      reduce=spec.reduce, monitor=monitor, events=spec.events, **options)

        try:
            solution = solved(scene.t, spec.monitor)
        except lieeuler.IntegrationError as ended:
            if ended.status is lieeuler.Status.NOT_UNIQUE:  # no method can go on there, and truth ends there
                when, joint, _ = ended.solution.events[-1]
                raise Unsupported(f"lieeuler {spec.method} on scene {scene.name!r}: the stop of joint "
                                  f"{scene.joints[joint].name!r} is hit at {when:.6g} s while one that acts on it is, "
                                  "or carries, and one of them bounces: no motion follows from that; ask for a shorter "
                                  "duration") from ended
            raise IntegrationError(ended.status, ended.advice, ended.solution) from ended
        except lieeuler.LieEulerError as error:
            raise ArgumentError(str(error)) from error
        fields = [field.name for field in dataclasses.fields(States) if not field.kw_only]
        stats = solution.stats
        counters = Stats(
            rejected_steps=stats.rejected_steps, force_evaluations=stats.force_evaluations,
            newton_iterations=stats.newton_iterations, factorizations=stats.factorizations,
            most_iterations=stats.most_iterations, redundant_rows=stats.redundant_rows,
            reduce=stats.reduce, spin_free=tuple(scene.bodies[body].name for body in stats.spin_free))
        maxima = {"kinetic_energy" if key == "kinetic" else key: value for key, value in stats.maxima.items()}
        states = States(*(np.asarray(getattr(solution, field)) for field in fields))
        states.hinges = _turned(scene, spec.step, states, lambda t: solved(t, False))
        return RawRun(
            states=states, wall_time=stats.wall_time, steps=stats.steps, step=stats.step, status=solution.status.value,
            stats=counters, maxima=maxima or None, form="maximal",
            events=tuple((t, scene.joints[joint].name, what) for t, joint, what in solution.events))
