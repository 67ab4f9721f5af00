"""Truth of many members of one structure: scenes that differ in their initial state share one compiled integrator."""

from __future__ import annotations

import functools

import numpy as np

from crosscheck.references import compute, conditioning
from crosscheck.references.base import End, Series, TruthError, scene_length
from crosscheck.references.defects import defects
from crosscheck.references.dense_output import ROUNDOFF, USABLE
from crosscheck.references.maximal import Maximal
from crosscheck.references.taylor import Taylor
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

SAME_START = 1e-12
"""How far a member's state may differ from its coordinates, relative to the scene's length, and in attitudes."""


class Members:
    """Taylor series of one structure, for any initial state near its own.

    Parameters
    ----------
    scene : the structure with an initial state of its own

    Raises
    ------
    Unsupported, TruthError
        As `crosscheck.references.truth`.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        if not scene.has_laws:  # their truths are computed one by one: a mode belongs to its own start
            self._taylor  # noqa: B018  compiled here, so that a structure that cannot be is refused here

    @functools.cached_property
    def _taylor(self) -> Taylor:
        return Taylor(self.scene)

    def states(self, member: Scene) -> States:
        """Truth of a member at its output times, which are those of the structure.

        Raises
        ------
        TruthError
            The integration ended early.
        """
        if self.scene.has_laws:
            return compute(member).states
        state = self._state(member)
        if state is None:
            own = Taylor(member)
            return own.states(own.run())
        return self._taylor.states(self._taylor.run(state))

    def check(self, member: Scene, states: States) -> float:
        """The error of these states: how far they are from its series, and what the defects of that make.

        Raises
        ------
        TruthError
            They leave no usable digits.
        """
        if self.scene.has_laws:
            return compute(member).disagreement
        conditions = self._conditions
        if np.count_nonzero(member.t <= conditions.horizon * (1 + 1e-12)) < 2:
            raise TruthError(f"{member.name!r}: a perturbation of 1e-15 grows to 1e-10 before the first output time")
        state, series = self._state(member), self._taylor
        if state is None:
            series = Taylor(member)
            state = series.initial
        until = min(conditions.horizon, member.duration)
        pieces, _ = series.advance(End(state), until)
        sizes, _ = defects(Maximal(member), series, pieces)
        known = states.at(np.flatnonzero(states.t <= until))
        own = series.dense_states(known.t, Series(pieces)(known.t))
        apart = max(float(np.abs(own.x - known.x).max()) / scene_length(member), float(np.abs(own.R - known.R).max()))
        error = apart + conditions.within_horizon * float(np.linalg.norm(sizes))
        if not error <= max(USABLE, ROUNDOFF * conditions.within_horizon):
            raise TruthError(f"{member.name!r}: the formulations disagree by {error:.2e}")
        return error

    @functools.cached_property
    def _conditions(self) -> conditioning.Conditioning:
        return conditioning.measure(self._taylor)

    def _state(self, member: Scene) -> np.ndarray | None:
        """The member's start in the coordinates of the structure, None if they cannot express it."""
        state = self._taylor.state_of(member)
        if not len(state):
            return None
        x, R = self._taylor.pose(state[None])
        gap = max(np.abs(x[0] - member.x0).max() / scene_length(member), np.abs(R[0] - member.R0).max())
        return state if gap < SAME_START else None
