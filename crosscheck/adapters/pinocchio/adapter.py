"""Pinocchio: joint coordinates, free bodies and rigid constraints, with integrators of this package in Python.

Source: Carpentier et al., SII 2019, doi:10.1109/SII.2019.8700380; constraintDynamics: Carpentier, Budhiraja & Mansard,
RSS 2021, doi:10.15607/RSS.2021.XVII.040. `wall_time` includes the Python interpreter and is no measure of Pinocchio in
C++.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.adapters.common import lie_steppers, open_tree, stepping, tree
from crosscheck.adapters.common.held import Held, highest_order
from crosscheck.adapters.common.native import JointStates, Native
from crosscheck.adapters.pinocchio import laws, mimics, models
from crosscheck.adapters.pinocchio.dynamics import Dynamics
from crosscheck.scene.laws import FORCE_TYPES
from crosscheck.scene.model import Scene

ORDERS = MappingProxyType({"SymplecticEuler": 1, "RK4naive": 4, "RKMK4": 4, "RKMK8": 8})
"""Orders of the tableaus; for RK4naive its authors' claim, which a known defect corrects."""


class Pinocchio(Engine):
    """Adapter of Pinocchio, forms `tree` and `maximal`, under integrators on the configuration space."""

    name = "pinocchio"
    methods = tuple(ORDERS)
    forms = ("tree", "maximal")
    options = frozenset({"form", "alpha", "beta"})
    orders = ORDERS
    package = "pin"
    on_group = True
    reads = (".urdf", ".xml", ".mjcf")
    pace = 2

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """That of the tableau, as far as the forces are smooth: nothing locates events."""
        return min(ORDERS[spec.method], highest_order(scene) or ORDERS[spec.method])

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three in joint coordinates; with constraints on points only, the acceleration level without gains."""
        _, parts, cut = models.decompose(scene, spec.form or "tree")
        if not cut and not parts:
            return tree.LEVELS
        # rows of other joints depend on positions that have drifted
        points = not parts and all(joint.kind.is_ball for joint in cut)
        return frozenset({"acceleration"} if points and not spec.alpha and not spec.beta else ())

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why Pinocchio cannot run this, or None."""
        form = spec.form or "tree"
        in_tree: tuple[str, ...] = ("frame", "armature", "mimic", "servo", "sampled_servo", "effort_limit",
                                    "no_load_speed", "soft_limits")
        if spec.method == "SymplecticEuler":
            in_tree = (*in_tree, "dry_friction", "limits")
        elif open_tree.rowed(scene) and form == "tree":
            return ("of its methods SymplecticEuler alone has dry friction and rigid limits: they are solved over a "
                    "step, and the others evaluate forces at their stages")
        plain = (name for name, law in FORCE_TYPES.items() if not law.has_modes)
        if reason := scene.beyond(("joint_torque", "function", "hold", *plain, *(in_tree if form == "tree" else ())),
                                  in_tree):
            return reason
        if form not in self.forms:
            return f"form {form} is not built into this adapter; it has {', '.join(self.forms)}"
        closed = any(models.decompose(scene, form)[1:])
        if open_tree.rowed(scene) and (closed or any(joint.mimic for joint in scene.joints)):
            return "dry friction and rigid limits are built for trees without loops and mimics"
        if (bouncing := open_tree.bouncing(scene)) is not None:
            return bouncing
        if cut := {joint.name for joint in models.decompose(scene, form)[2]}:
            for joint in scene.joints:
                if joint.name in cut and (any(joint.limits) or joint.name in dict(scene.servos.values())):
                    return f"the servo or limits of joint {joint.name!r} need a joint coordinate; here it closes a loop"
        if reason := mimics.unsupported(scene, closed):
            return reason
        if (spec.alpha or spec.beta) and not closed:
            return "alpha, beta: joint coordinates hold every joint of this scene, there is nothing to stabilise"
        return None

    def turning(self, scene: Scene, form: str | None) -> list[int]:
        """Bodies on a ball joint, and free bodies."""
        links, parts, _ = models.decompose(scene, form or "tree")
        return [link.body for link in links if link.body not in parts and any(part.kind == "ball"
                                                                             for part in link.parts)]

    def native(self, path: str, states: JointStates) -> Native:
        """The model that Pinocchio makes of a model file by itself."""
        from crosscheck.adapters.pinocchio.native import load

        return load(path, states)

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` if the state becomes infinite or NaN."""
        form = spec.form or "tree"
        model = models.build(scene, form)
        dynamics = Dynamics(model, spec.alpha or 0.0, spec.beta or 0.0)
        h, start = stepping.fixed_step(scene, spec)[1], model.initial_state()
        rowed = open_tree.rowed(scene)
        state, done, held = [*start], 0, Held(scene, h)
        begun: dict[int, np.ndarray] = {}  # by the number of the step: the accelerations at its start

        def stage(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
            a = dynamics(q, v, t)
            begun.setdefault(done, a)
            return a

        step = _stepper(spec.method, h, model, stage if spec.monitor and not held else dynamics,
                        laws.Rows(dynamics, h) if rowed else None)
        on = {name: dynamics.coordinate(joint) for joint in scene.joints for name, _ in scene.servos.values()
              if name == joint.name}

        def evaluate(q: np.ndarray, v: np.ndarray) -> None:
            positions, rates = model.positions(q), model.rates(v)
            held.update(done, lambda name: (on[name][2] * positions[on[name][0]] + on[name][3],
                                            on[name][2] * rates[on[name][1]]))
            dynamics.held = held.efforts

        if held:
            evaluate(*start)

        def advance() -> None:
            nonlocal done
            state[:] = step(done * h, *state)
            done += 1
            if held:
                evaluate(*state)

        def accelerate(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            each = [begun.get(number) for number in np.rint(t / h).astype(int).tolist()]
            for row, known in enumerate(each):
                if known is None:
                    dynamics.held = held.at(t[row])
                    each[row] = dynamics(q[row], v[row], t[row])
            dynamics.held = held.efforts
            begun.clear()
            return np.array(each)

        rows = stepping.one_by_one(advance, lambda: (state[0], state[1]))
        convert = open_tree.without_accelerations(model.states) if rowed else model.states
        raw = stepping.march(scene, spec, start, rows, convert, accelerate)
        raw.form = form
        raw.stats["forward_dynamics"] = dynamics.algorithm
        if dynamics.closure is not None:
            raw.stats["constraint_models"] = len(dynamics.closure.joints)
            raw.stats["constraint_rank"] = dynamics.closure.rank
        return raw


def _stepper(method: str, h: float, model: models.Model, dynamics: lie_steppers.Dynamics,
             push: laws.Rows | None) -> lie_steppers.Step:
    import pinocchio

    def integrate(q: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        moved: np.ndarray = pinocchio.integrate(model.model, q, tangent)
        return moved

    if method == "SymplecticEuler":
        return lie_steppers.symplectic_euler(h, integrate, dynamics, push)
    if method == "RK4naive":
        return lie_steppers.naive_rk4(h, integrate, dynamics)
    tableau = lie_steppers.CLASSIC_4 if method == "RKMK4" else lie_steppers.dop853()
    return lie_steppers.munthe_kaas(h, integrate, dynamics, model.balls, tableau)
