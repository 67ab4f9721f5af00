"""Accelerations of a Pinocchio model under the scene's springs and loads.

Linear springs and loads are external forces in the joints' frames, torsional springs are joint torques; both are
evaluated at every stage. `constraintDynamics` takes no external forces, so there they become joint torques by the
Jacobians.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.adapters.common import tree
from crosscheck.adapters.pinocchio import redundant
from crosscheck.adapters.pinocchio.models import Model, closure
from crosscheck.scene.functions import at as value_at
from crosscheck.scene.laws import Limits, Servo
from crosscheck.scene.model import GROUND, Force, Joint

if TYPE_CHECKING:
    import pinocchio

ABA_RESIDUAL = 1e-13
"""Largest residual of the joint torques at the start, relative to their size. Above it the articulated-body algorithm
loses digits: on a chain of balls its error grows by a third with every body (none lost at 16 bodies, 1e-11 at 32, all
at 64). The mass matrix is then factorized, whose residual grows like its size (4e-13 at 64 bodies)."""


class Dynamics:
    """Joint accelerations of `model` by aba (Convention.LOCAL), or by constraintDynamics if joints are cut.

    `factorizes`: crba and a Cholesky factorization are used instead of aba; see `ABA_RESIDUAL`.
    """

    def __init__(self, model: Model, alpha: float = 0.0, beta: float = 0.0) -> None:
        import pinocchio

        self._pin = pinocchio
        self.model, self._model, self.data = model, model.model, model.model.createData()
        scene = model.scene
        self._forces = [force for force in scene.loads if not force.law.on_joint]
        self._along = [(force, joint.rest(force) if force.law.rest else 0.0,
                        *self.coordinate(joint, joint.kind.number(force.law.measure)))
                       for force, joint in ((force, scene.joint(force.joint)) for force in scene.loads
                                            if force.law.on_joint and not force.law.has_modes)]
        self.held: Mapping[int, float] = {}
        """What sampled servos give now, by their indices among the forces."""
        self._laws: list[tuple[int, Servo | Limits, int, int, float, float]] = [
            (index, servo, *self.coordinate(scene.joint(name))) for index, (name, servo) in scene.servos.items()]
        self._laws += [(-1, limits, *self.coordinate(joint, k)) for joint in scene.joints
                       for k, limits in enumerate(joint.limits) if limits is not None]
        self.closure = closure(model, self.data, alpha, beta) if model.cut or model.parts else None
        self.factorizes = model.mimics is not None
        if self.closure is None and not self.factorizes:  # check what aba finds by inverse dynamics
            q, v = model.initial_state()
            torque, _ = self._applied(0.0, q, v)
            free = pinocchio.aba(self._model, self.data, q, v, torque).copy()
            terms = [pinocchio.rnea(self._model, self.data, q, v, a).copy() for a in (free, 0 * free)]
            size = max(np.abs(terms[1]).max(initial=0.0), np.abs(torque).max(initial=0.0))
            self.factorizes = bool(np.abs(terms[0] - torque).max(initial=0.0) > ABA_RESIDUAL * size)
        if self.closure is not None:
            pinocchio.initConstraintDynamics(self._model, self.data, self.closure.models, self.closure.workspaces)

    @property
    def algorithm(self) -> str:
        """The algorithm in use, by Pinocchio's name."""
        if self.closure is not None:
            return "least norm" if self.closure.redundant else "constraintDynamics"
        if self.model.mimics is not None:
            return "crba of mimic joints"
        return "crba, Cholesky" if self.factorizes else "aba"

    def coordinate(self, joint: Joint, k: int = 0) -> tuple[int, int, float, float]:
        """(index in q, index in v, sign, value at zero of its q) of coordinate k of a hinge or slide in the tree."""
        link, (at_q, at_v) = next(pair for pair in zip(self.model.links, self.model.slots, strict=True)
                                  if pair[0].joint == joint.name)
        whole = dataclasses.replace(link, body=self.model.parts.get(link.body, link.body))
        part, sign, zero = tree.coordinate(self.model.scene, whole, k)
        return at_q.start + part, at_v.start + part, sign, zero

    def __call__(self, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> np.ndarray:
        """Joint accelerations, as a copy, because Pinocchio overwrites its array in the next call."""
        pin = self._pin
        torque, wrenches = self._applied(t, q, v)
        acceleration: np.ndarray
        if self.closure is None:
            external = () if wrenches is None else (wrenches,)
            if not self.factorizes:
                acceleration = pin.aba(self._model, self.data, q, v, torque, *external).copy()
                return acceleration
            bias = pin.rnea(self._model, self.data, q, v, np.zeros(self._model.nv), *external).copy()
            if self.model.mimics is not None:
                return np.linalg.solve(self.mass_matrix(q), torque - bias)
            pin.crba(self._model, self.data, q)
            pin.cholesky.decompose(self._model, self.data)
            acceleration = pin.cholesky.solve(self._model, self.data, torque - bias)
            return acceleration
        if wrenches is not None:
            pin.computeJointJacobians(self._model, self.data, q)
            for joint in range(1, self._model.njoints):
                J = pin.getJointJacobian(self._model, self.data, joint, pin.ReferenceFrame.LOCAL)
                torque += J.T @ wrenches[joint].vector
        c = self.closure
        if c.redundant:
            return redundant.accelerations(self._model, self.data, c, q, v, torque)
        acceleration = pin.constraintDynamics(self._model, self.data, q, v, torque, c.models, c.workspaces, c.settings)
        acceleration = acceleration.copy()
        return acceleration

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """(nv, nv). Where joints follow others crba of Pinocchio 4.1 adds to what its workspace has from the last call,
        so that it gets a new one."""
        data = self.data if self.model.mimics is None else self._model.createData()
        upper = np.triu(self._pin.crba(self._model, data, q))
        return np.asarray(upper + np.triu(upper, 1).T)

    def applied(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Generalized force (nv,) of gravity, springs, loads and velocities at time 0.

        It equals the mass matrix times the accelerations without constraints.
        """
        torque, wrenches = self._applied(0.0, q, v)
        still = np.zeros(self._model.nv)
        external = () if wrenches is None else (wrenches,)
        effort: np.ndarray = torque - self._pin.rnea(self._model, self.data, q, v, still, *external)
        return effort

    def _applied(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, pinocchio.StdVec_Force | None]:
        """(joint torques, external forces on all joints in their frames or None if there are none)."""
        positions, rates = self.model.positions(q), self.model.rates(v)
        torque = np.zeros(len(rates))
        for force, rest, at_q, at_v, sign, zero in self._along:
            torque[at_v] += sign * force.law.effort(
                force.at(t), sign * positions[at_q] + zero - value_at(rest, t), sign * rates[at_v])
        for index, law, at_q, at_v, sign, zero in self._laws:
            if index in self.held:
                torque[at_v] += sign * self.held[index]
                continue
            position, rate = sign * positions[at_q] + zero, sign * rates[at_v]
            torque[at_v] += sign * (law.effort(t, position, rate) if isinstance(law, Servo) else
                                    law.force(position, rate))
        if self.model.mimics is not None:
            torque = torque @ self.model.mimics.V
        if not self._forces:
            return torque, None
        self._pin.forwardKinematics(self._model, self.data, q, v)
        wrenches = self._rest()
        for force in self._forces:
            self._load(t, wrenches, force)
        return torque, wrenches

    def _rest(self) -> pinocchio.StdVec_Force:
        """Zero external forces for all joints."""
        wrenches = self._pin.StdVec_Force()
        for _ in range(self._model.njoints):
            wrenches.append(self._pin.Force.Zero())
        return wrenches

    def _load(self, t: float, wrenches: pinocchio.StdVec_Force, force: Force) -> None:
        """Add a force between two points, or a load on a body."""
        p, law = force.at(t), force.law
        if law.effort is not None:
            ends = [(force.parent, np.array(p["parent_point"])), (force.child, np.array(p["child_point"]))]
            (start, start_rate), (end, end_rate) = (self._point(*point) for point in ends)
            d = end - start
            length = float(np.linalg.norm(d))
            direction = d / length if length > 0 else np.zeros(3)
            rate = direction @ (end_rate - start_rate)
            push = law.effort(p, length - p[law.rest], rate) * direction
            self._push(wrenches, *ends[0], -push)
            self._push(wrenches, *ends[1], push)
            return
        joint, frame = self.model.frames[force.child]
        load = p.get("factor", 1.0) * np.array(p[law.measure])
        if p["frame"] == "body":
            load = (self.data.oMi[joint] * frame).rotation @ load
        if law.measure == "force":
            self._push(wrenches, force.child, np.array(p["child_point"]), load)
        else:
            wrenches[joint] += self._pin.Force(np.zeros(3), self.data.oMi[joint].rotation.T @ load)

    def _point(self, body: int, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World position and velocity of a point given in the body's frame."""
        joint, frame = self.model.frames[body]
        local, carrier = frame.act(point), self.data.oMi[joint]
        if body == GROUND:
            return local, np.zeros(3)
        twist = self.data.v[joint]
        return carrier.act(local), carrier.rotation @ (twist.linear + self._pin.skew(twist.angular) @ local)

    def _push(self, wrenches: pinocchio.StdVec_Force, body: int, point: np.ndarray, push: np.ndarray) -> None:
        """Add a force, world axes, at a point given in the body's frame."""
        joint, frame = self.model.frames[body]
        local = self.data.oMi[joint].rotation.T @ push
        wrenches[joint] += self._pin.Force(local, self._pin.skew(frame.act(point)) @ local)
