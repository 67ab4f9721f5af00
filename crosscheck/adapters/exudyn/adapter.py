"""Exudyn: implicit solvers with constraints, explicit ones at a pivot or on an open kinematic tree.

Source: Gerstmayr, Multibody System Dynamics 2023, doi:10.1007/s11044-023-09937-1. With `monitor` on, sensors record
every step within the measured time, so speed is measured with it off; explicit methods then return no accelerations.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec, Stats
from crosscheck.adapters.common import open_tree, stepping, tree
from crosscheck.adapters.common.held import highest_order
from crosscheck.adapters.common.own_law import OwnLaw
from crosscheck.adapters.exudyn import kinematic_tree, laws, models, solving
from crosscheck.adapters.exudyn.solving import IMPLICIT, NEWTON_TOLERANCES, load, solve
from crosscheck.errors import EngineError
from crosscheck.scene.events import Event, events
from crosscheck.scene.mechanics import redundant_rows
from crosscheck.scene.model import GROUND, Force, Joint, Scene
from crosscheck.scene.states import States

__all__ = ["CLEARANCE", "IMPLICIT", "NEWTON_TOLERANCES", "ORDERS", "Exudyn", "cardan_order", "load"]

ORDERS = MappingProxyType({"GeneralizedAlpha": 2, "TrapezoidalIndex2": 2, "RK44": 4, "RK67": 6, "DOPRI5": 5})
"""As in Exudyn's documentation."""

PREFERRED_ORDER = "XYZ"
CLEARANCE = 0.25
"""If |cos| of the middle Cardan angle is below this, another order is used: stiffness grows as its inverse square."""

SCOUT_STEPS, SCOUT_TURN = 2000, 0.02
"""Most steps of the preliminary run that looks for gimbal lock, and the angle (rad) in one of them as the scene begins.
"""


class Exudyn(Engine):
    """Adapter of Exudyn, forms `maximal`, `pivot` and `tree`, with Lie group or Euler parameter nodes."""

    name = "exudyn"
    methods = tuple(ORDERS)
    forms = ("maximal", "pivot", "tree")
    options = frozenset({"form", "node"})
    orders = ORDERS
    package = "exudyn"
    on_group = True
    pace = 1

    def documented_order(self, scene: Scene, spec: RunSpec) -> int:
        """That of the method, as far as the forces are smooth: nothing locates events.

        Implicit methods carry the acceleration of one step into the next, and so over the jump of a sampled servo.
        """
        jumps = spec.method in IMPLICIT and any(servo.period is not None for _, servo in scene.servos.values())
        return 1 if jumps else min(ORDERS[spec.method], highest_order(scene) or ORDERS[spec.method])

    def own_law(self, scene: Scene, spec: RunSpec) -> States | None:
        """That of limits that pull, where nothing else is as stiff as the step allows."""
        ranges = [each for joint in scene.joints for each in joint.limits if each]
        if any(any(joint.dry_friction) for joint in scene.joints) or not any(each.damping for each in ranges) or any(
                each.rigid for each in ranges):
            return None
        return OwnLaw(scene, laws.pulling, self.name).states()

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All levels in joint coordinates; with constraints, the level of the method's index. Rows of rolling disks are
        of velocity, the height's too, beside joints of index 3 no level is held by all."""
        if not scene.joints or not self._constrained(scene, self.form(scene, spec)):
            return tree.LEVELS
        rolling = _rolling(scene)
        if spec.method == "TrapezoidalIndex2" or len(rolling) == len(scene.joints):
            return frozenset({"velocity"})
        return frozenset({"position"}) if not rolling else frozenset()

    def form(self, scene: Scene, spec: RunSpec) -> str:
        """The form used: the requested one, else maximal for implicit methods or free bodies, else pivot or tree."""
        if spec.form is not None:
            return spec.form
        if _by_coordinates(scene):
            return "tree"
        if spec.method in IMPLICIT or not scene.joints:
            return "maximal"
        return "pivot" if _turns_about_ground(scene) and not any(map(_is_between, scene.forces)) else "tree"

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why Exudyn cannot run this, or None."""
        form = self.form(scene, spec)
        in_tree = ("armature", "mimic", "dry_friction", "static_friction", "limits", "soft_limits", "servo",
                   "sampled_servo", "effort_limit", "no_load_speed")
        known = ("slip", "joint_torque", "function", "hold", *(in_tree if form == "tree" else ()))
        if reason := scene.beyond(known, in_tree) or open_tree.bouncing(scene):
            return reason
        if form == "tree" and (closing := _by_coordinates(scene) & {
                joint.name for joint in kinematic_tree.spanned(scene)[1]}):
            return f"joint {min(closing)!r} closes a loop, and armature, mimics and laws need a coordinate of the tree"
        if any(force.is_spring and force.functions for force in scene.forces):
            return "a rest angle that moves: Exudyn's springs between markers have constant ones"
        if form not in self.forms:
            return f"form {form} is not built into this adapter; it has {', '.join(self.forms)}"
        if reason := _unrolled(scene, form):
            return reason
        if form == "pivot" and not _turns_about_ground(scene):
            return "form pivot is for one body on one spherical joint to the ground"
        if form == "tree" and not any(link.dofs for link in kinematic_tree.spanned(scene)[0]):
            return "nothing moves: a kinematic tree needs at least one coordinate; form maximal holds resting bodies"
        if form == "tree" and spec.node is not None:
            return f"node={spec.node!r} says what carries rigid bodies; form tree has none, its node holds coordinates"
        if spec.method in IMPLICIT:
            return None
        if spec.node == "euler_parameters":
            return f"{spec.method} is explicit, and Euler parameters bring a constraint of their own; node lie has none"
        if form == "pivot" and any(map(_is_between, scene.forces)):
            return ("Exudyn's explicit solvers hold the pivot at the end of a step only: a spring sees it move at the "
                    "stages, which leaves order 2, with damping order 1; form tree does not")
        if self._constrained(scene, form):
            return (f"{spec.method} is explicit and eliminates no joint constraints, which form {form} has here; "
                    "GeneralizedAlpha is implicit")
        return None

    def _constrained(self, scene: Scene, form: str) -> bool:
        """Whether joints of the scene are constraints of the model; a pivot is eliminated and does not count."""
        if form == "maximal":
            return bool(scene.joints)
        return form == "tree" and (bool(kinematic_tree.spanned(scene)[1])
                                   or any(joint.mimic is not None for joint in scene.joints))

    def linear_solver(self, scene: Scene, spec: RunSpec, form: str) -> str | None:
        """The linear solver for a model with constraints; None for Exudyn's default."""
        if spec.method not in IMPLICIT or not self._constrained(scene, form):
            return None
        return "EigenSparse" if scene.n >= solving.SPARSE_FROM and form == "maximal" else None

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` with Exudyn's message if it fails."""
        load()
        form = self.form(scene, spec)
        per, h = stepping.fixed_step(scene, spec)
        build: Callable[[], models.Model]
        stats: Stats = {}
        if form == "tree":
            order = PREFERRED_ORDER
            if kinematic_tree.balls(scene):
                order = stats["cardan_order"] = cardan_order(scene)
            build = functools.partial(kinematic_tree.kinematic_tree, scene, order, h)
        else:
            stats["node"] = spec.node or "lie"
            build = functools.partial(models.maximal if form == "maximal" else models.pivot, scene, stats["node"])
        every = 1 if spec.monitor else per
        linear = self.linear_solver(scene, spec, form)
        solved = solve(build, spec.method, scene.duration, per * (scene.samples - 1), every, linear)
        model, t, data = solved.model, solved.t, solved.data
        if "cardan_order" in stats:
            middle = kinematic_tree.middle_angles(scene)
            stats["gimbal_clearance"] = float(np.abs(np.cos(data[0][:, middle])).min())
        if spec.method in IMPLICIT:
            stats["newton_tolerance"] = solved.tolerance
            stats["newton_iterations"] = int(solved.solver.it.newtonStepsCount)
            stats["factorizations"] = int(solved.solver.it.newtonJacobiCount)
        picked = slice(None, None, per // every)
        states = model.convert(scene.t, [part[picked] for part in data])
        if spec.method in IMPLICIT:
            # the tolerance applies to the residual relative to its first value in a step, a sum of forces and torques
            a, alpha = np.asarray(states.a), np.asarray(states.alpha)
            forces = max(np.abs(scene.masses[:, None] * a).max(),
                         np.abs(np.einsum("ikl,til->tik", scene.inertias, alpha)).max())
            stats["newton_left"] = solved.tolerance * (1.0 + float(forces))
        else:
            _drop_unknown_accelerations(states, every)
        if states.a is not None and states.alpha is not None:  # those after a step are those before the sample
            for _, servo in scene.servos.values():
                at = servo.samples(scene.t) & (scene.t > 0.0)
                states.a[at] = states.alpha[at] = np.nan
        maxima, happened = None, tuple[Event, ...]()
        if spec.monitor:
            whole = model.convert(t, data)
            maxima = _maxima(scene, whole)
            states.hinges, happened = whole.at(picked).hinges, events(scene, whole)
        return RawRun(states, solved.wall_time, per * (scene.samples - 1), h, stats=stats, maxima=maxima, form=form,
                      events=happened)


def _drop_unknown_accelerations(states: States, every: int) -> None:
    """Remove accelerations that explicit solvers do not have: those at t = 0, and all unless every step is recorded."""
    if every > 1:
        states.a = states.alpha = None
        return
    for values in (states.a, states.alpha):
        if values is not None:
            values[0] = np.nan


def _maxima(scene: Scene, states: States) -> dict[str, float]:
    """Maxima over all steps; the start has no accelerations of its own (see `_drop_unknown_accelerations`).

    The states get the angles of hinges.
    """
    from crosscheck.scene.monitor import Monitor

    monitor = Monitor(scene)
    hinges = [monitor.update(scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])]
    for start in range(1, len(states.t), stepping.CHUNK):
        part = states.at(slice(start, start + stepping.CHUNK))
        stepping.watch(monitor, part)
        assert part.hinges is not None
        hinges.append(part.hinges)
    states.hinges = np.concatenate(hinges)
    return monitor.maxima()


def _is_between(force: Force) -> bool:
    return force.law.measure == "length"


def _rolling(scene: Scene) -> list[Joint]:
    return [joint for joint in scene.joints if joint.kind.slips]


def _unrolled(scene: Scene, form: str) -> str | None:
    """Why Exudyn has no such rows of slip, or None."""
    for joint in _rolling(scene):
        if joint.type != "rolling_disk":
            return f"joint {joint.name!r} is a {joint.type}: of what does not slip Exudyn has disks alone"
        if form != "maximal":
            return f"form {form} has no joints that roll; form maximal has disks"
        if redundant_rows(scene):
            return f"rows depend on others beside those of {joint.name!r}: this adapter picks no independent ones there"
    return None


def _by_coordinates(scene: Scene) -> set[str]:
    """Joints with armature or laws, that follow or that lead: rigid bodies on joints have no coordinates for it."""
    named = {joint.name for joint in scene.joints if any((*joint.armature, *joint.dry_friction, *joint.limits))
             or joint.mimic is not None} | {name for name, _ in scene.servos.values()}
    return named | {joint.mimic.joint for joint in scene.joints if joint.mimic is not None}


def _turns_about_ground(scene: Scene) -> bool:
    return (scene.n, len(scene.joints)) == (1, 1) and (
        scene.joints[0].kind.is_ball and GROUND in (scene.joints[0].parent, scene.joints[0].child))


_ORDERS: dict[str, str] = {}
"""Cardan orders by the hash of the scene, because studies run the same scene many times."""


def cardan_order(scene: Scene) -> str:
    """A Cardan order whose middle angle stays away from a quarter turn on this scene.

    A run in the maximal form, which has no gimbal lock, decides: XYZ if |cos| of every middle angle stays above
    `CLEARANCE`, else the order with the largest clearance.
    """
    from scipy.spatial.transform import Rotation

    if scene.hash in _ORDERS:
        return _ORDERS[scene.hash]
    order, build = PREFERRED_ORDER, functools.partial(models.maximal, scene)
    linear = Exudyn().linear_solver(scene, RunSpec("GeneralizedAlpha"), "maximal")
    lever = min((norm for joint in scene.joints if (norm := float(np.linalg.norm(joint.child_anchor)))), default=1.0)
    rate = math.sqrt(float(np.linalg.norm(scene.gravity)) / lever) + float(np.linalg.norm(scene.w0, axis=1).max())
    steps = min(SCOUT_STEPS, math.ceil(scene.duration * rate / SCOUT_TURN) + 1)
    # If this run fails because its step is too large, the preferred order is used; every run reports its clearance.
    with contextlib.suppress(EngineError):
        scout = solve(build, "GeneralizedAlpha", scene.duration, steps, 1, linear)
        states = scout.model.convert(scout.t, scout.data)
        relative = [open_tree.relative(states.R, link) for link in kinematic_tree.balls(scene)]
        clearance = open_tree.clearances(Rotation.from_matrix(np.concatenate(relative)))
        if not clearance[PREFERRED_ORDER] > CLEARANCE:
            order = max(clearance, key=clearance.__getitem__)
    _ORDERS[scene.hash] = order
    return order
