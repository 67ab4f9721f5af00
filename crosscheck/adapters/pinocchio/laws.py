"""Dry friction and rigid limits as Pinocchio's constraint models of joints, solved for once a step.

The impulses J^T p over a step h change its velocities: of friction within c h, of a limit not below 0 and so that the
next position is in the range. `PGSConstraintSolver` finds them.
"""

from __future__ import annotations

import itertools

import numpy as np

from crosscheck.adapters.common import tree
from crosscheck.adapters.pinocchio.dynamics import Dynamics
from crosscheck.errors import EngineError

MOST, TOLERANCE = 10000, 1e-14
"""Most iterations of the solver, and the absolute error of velocities and impulses at which it ends."""


class Rows:
    """Called with positions and velocities before the impulses of a step h, s, it returns velocities after them."""

    def __init__(self, dynamics: Dynamics, h: float) -> None:
        import pinocchio

        self._pin, self._dynamics, self._h, model = pinocchio, dynamics, h, dynamics.model
        places, bounds = [pinocchio.StdVec_Index() for _ in range(2)], []
        low, high = -np.full(model.model.nq, np.inf), np.full(model.model.nq, np.inf)
        joints = {joint.name: joint for joint in model.scene.joints}
        for link, (at_q, _) in zip(model.links, model.slots, strict=True):
            joint = joints.get(link.joint)
            if joint is None or not joint.kind.has_one:
                continue
            for friction in filter(None, joint.dry_friction):
                places[0].append(model.frames[link.body][0])
                bounds.append(friction.sliding)
            for limits in (each for each in joint.limits if each is not None and each.rigid):
                places[1].append(model.frames[link.body][0])
                low[at_q], high[at_q] = tree.ends(limits, *tree.coordinate(model.scene, link)[1:])
        self._models, self._data = pinocchio.StdVec_ConstraintModel(), pinocchio.StdVec_ConstraintData()
        if bounds:
            most = np.array(bounds)
            rubbing = pinocchio.JointFrictionConstraintModel(model.model, places[0], -most, most)
            rubbing.setTimeStep(h)
            self._models.append(pinocchio.ConstraintModel(rubbing))
        if len(places[1]):
            ranges = pinocchio.JointLimitConstraintModel(model.model, places[1], low, high, np.zeros(model.model.nq))
            ranges.makeSelectionMaximal()
            self._models.append(pinocchio.ConstraintModel(ranges))
        for each in self._models:
            self._data.append(each.createData())
        self._settings, self._result = pinocchio.PGSSolverSettings(), pinocchio.PGSSolverResult()
        self._settings.max_iterations = MOST
        for kind, word in itertools.product(("absolute", "relative"), ("feasibility", "complementarity")):
            setattr(self._settings, f"{kind}_{word}_tol", TOLERANCE if kind == "absolute" else 0.0)

    def __call__(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Raises `EngineError` if the solver does not converge."""
        pin, model, data = self._pin, self._dynamics.model.model, self._dynamics.data
        inverse = np.linalg.inv(self._dynamics.mass_matrix(q))
        data.q_in = q  # that is where limits look, and no algorithm above sets it
        rows, rates = [], []
        for each, own in zip(self._models, self._data, strict=True):
            each.calc(model, data, own)
            rows.append(np.array(each.jacobian(model, data, own)).reshape(-1, model.nv))
            gap = getattr(own.extract(), "constraint_residual", 0.0)
            rates.append(rows[-1] @ v + np.asarray(gap) / self._h)
        J, g = np.concatenate(rows), np.concatenate(rates)
        self._result.resize(len(g))
        if not pin.PGSConstraintSolver(len(g)).solve(pin.DelassusOperatorDense(J @ inverse @ J.T), g, self._models,
                                                     self._data, self._settings, self._result):
            raise EngineError(f"PGSConstraintSolver does not converge within {MOST} iterations")
        return np.asarray(v + inverse @ J.T @ self._result.retrieveConstraintImpulses())
