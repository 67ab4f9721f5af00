"""The mechanical problem: bodies, joints, forces, gravity. Frozen and validated."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import SMALLEST, Frozen, Number, Positive, Vector, array
from lieeuler.errors import ArgumentError
from lieeuler.forces import CustomForce, Force
from lieeuler.joint_parts import Dot
from lieeuler.joints import Joint
from lieeuler.laws import Law
from lieeuler.solution import Status
from lieeuler.types import GROUND, ArrayLike, State

Found = TypeVar("Found")
CLOSED = 1e-8
"""How far joints may be open at the start, as a part of the system's length and speed."""
ROUNDING = 1e-12
"""The same where constraints are left out, as those of welds are; relative size below which an angle between
directions, or a velocity out of a plane, is rounding."""
KEPT = 20
"""How many reductions and planned runs a problem keeps."""
MOST_PASSES = 10
"""Of a projection, twelve iterations each; from further off they wander."""
DEPENDENT = 1e-6
"""Sine of the angle below which two directions of one joint count as one."""


@dataclasses.dataclass(frozen=True)
class Body(Frozen):
    """A rigid body.

    Parameters
    ----------
    mass : float
        kg, > 0.
    inertia : (3, 3)
        About the centre of mass in body axes, kg m^2; symmetric, positive definite.
    """

    mass: Positive
    inertia: np.ndarray

    def __post_init__(self) -> None:
        super().__post_init__()
        inertia = array("inertia", self.inertia, (3, 3))
        if np.abs(inertia - inertia.T).max() > 1e-12 * np.abs(inertia).max():
            raise ArgumentError("inertia must be symmetric")
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] <= 0:
            raise ArgumentError("inertia must be positive definite")
        if moments[0] < SMALLEST:
            raise ArgumentError(f"principal moments {moments} are out of range; take an inertia above {SMALLEST:g}")
        if moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise ArgumentError(f"principal moments {moments} break the triangle inequality: no body has them")
        object.__setattr__(self, "inertia", inertia)


@dataclasses.dataclass(frozen=True)
class Problem(Frozen):
    """A rigid multibody system with its initial state.

    Parameters
    ----------
    bodies : sequence of Body
    joints : sequence of Joint
    gravity : (3,)
        m/s^2, world axes.
    x, R, v, w : (n, 3), (n, 3, 3), (n, 3), (n, 3)
        Initial state in the conventions of `lieeuler.types`. It must satisfy the joints and their velocity constraints
        to rounding level, those of drives at `time`; the integrators do not correct it.
    forces : sequence of forces from `lieeuler.forces`, optional
    time : float, optional
        That of the initial state, s. With drives `integrate` must start there.
    laws : sequence of Law, optional
        Servos, dry friction and stops, see `lieeuler.laws`.
    custom : sequence of CustomForce, optional
        Forces of one's own.

    Raises
    ------
    ArgumentError
        A value has the wrong shape or is not physical, a joint names a body that does not exist, or the state violates
        a joint by more than 1e-8 of the size of the system.
    """

    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    gravity: Vector
    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    forces: tuple[Force, ...] = ()
    time: Number = 0.0
    laws: tuple[Law, ...] = ()
    custom: tuple[CustomForce, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        n = len(self.bodies)
        if n == 0:
            raise ArgumentError("a problem needs at least one body")
        for name, value in zip("xRvw", _state(n, (self.x, self.R, self.v, self.w)), strict=True):
            object.__setattr__(self, name, value)
        for group in ("joints", "forces"):
            for k, item in enumerate(getattr(self, group)):
                if not (0 <= item.child < n and GROUND <= item.parent < n and item.parent != item.child):
                    raise ArgumentError(f"{group}[{k}]: parent {item.parent} and child {item.child} must be two of the "
                                        f"bodies 0 .. {n - 1}, the parent may be the ground ({GROUND})")
        for k, joint in enumerate(self.joints):
            if joint.mimic is not None and not 0 <= joint.mimic.joint < len(self.joints):
                raise ArgumentError(f"joints[{k}]: there is no joint {joint.mimic.joint} to follow")
        for force in self.custom:
            if callable(force.function):
                force.value(self.time, self.x, self.R, self.v, self.w)
        if self.joints:
            self.check_closed(self.time)

    def check_closed(self, t: float) -> None:
        """Raise `ArgumentError` if the initial state violates a joint, or a drive at time t (s)."""
        levels = _kernel.constraint_levels(self.kernel, self.x, self.R, self.v, self.w, t, 0.0)[0]
        for name, size, gap in zip(("joints", "velocity constraints"), ("length", "speed"), levels, strict=True):
            if not gap <= CLOSED:
                when = "" if t == self.time else f" at t = {t:g} s, where the run begins, not at Problem.time"
                raise ArgumentError(f"the initial state violates the {name} by {gap:.3g} of the system's {size}{when}; "
                                    f"the bound is {CLOSED:g}; from a nearby problem lieeuler.project closes it")

    @classmethod
    def unchecked(cls, problem: Problem, **changes: object) -> Problem:
        """The problem with other fields, which are taken as they are: the state is one that an integration reached."""
        changed = object.__new__(cls)
        for field in dataclasses.fields(cls):
            object.__setattr__(changed, field.name, changes.get(field.name, getattr(problem, field.name)))
        return changed

    @functools.cached_property
    def kept(self) -> dict[object, Any]:
        """The last reductions and planned runs."""
        return {}

    def keep(self, key: object, made: Found) -> Found:
        """What is made for this key, kept."""
        if len(self.kept) >= KEPT:
            self.kept.pop(next(iter(self.kept)))
        self.kept[key] = made
        return made

    @functools.cached_property
    def opening(self) -> float:
        """How far the initial state opens joints and their rates, as a part of the system's length and speed."""
        return float(_kernel.constraint_levels(self.kernel, self.x, self.R, self.v, self.w, self.time, 0.0).max())

    def __repr__(self) -> str:
        return f"Problem({self.n} bodies, {len(self.joints)} joints of {self.rows} rows, {len(self.forces)} forces)"

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.bodies)

    @property
    def rows(self) -> int:
        """Number of constraint rows m."""
        return sum(joint.rows for joint in self.joints)

    def attitude(self, body: int) -> np.ndarray:
        """R of a body at the start, or of the ground."""
        return np.eye(3) if body == GROUND else self.R[body]

    def held_turns(self, joint: Joint, rows: Sequence[Dot]) -> np.ndarray:
        """(k, 3) world directions about which rows of normal axes keep the bodies from turning at the start."""
        return np.reshape([dot.scale * np.cross(self.R[joint.child] @ dot.b_axis,
                                                self.attitude(joint.parent) @ dot.a_axis) for dot in rows], (-1, 3))

    @functools.cached_property
    def kernel(self) -> _kernel.Plan:
        """The compiled system, with the plan of its factorizations, made once for all runs."""
        return _kernel.Plan(self.new_system())

    def new_system(self) -> _kernel.System:
        """A compiled system that can still be changed."""
        system = _kernel.System([body.mass for body in self.bodies], [body.inertia for body in self.bodies],
                                self.gravity)
        for item in (*self.joints, *self.forces, *self.custom):
            item.add_to(system)
        # Multipliers of leaders and rotors come after those of all constraints.
        mimics = [joint.mimic for joint in self.joints if joint.mimic is not None]
        for place, mimic in enumerate(mimics):
            system.add_leader(place, mimic.joint, mimic.leader.measured)
        for index, joint in enumerate(self.joints):
            joint.add_rotors_to(system, index)
        return system


def once(find: Callable[..., Found]) -> Callable[..., Found]:
    """The function of a problem, whose results the problem keeps."""
    @functools.wraps(find)
    def found(problem: Problem, *arguments: object) -> Any:
        key = find, *arguments
        return problem.kept[key] if key in problem.kept else problem.keep(key, find(problem, *arguments))
    return found


def project(problem: Problem, state: Sequence[ArrayLike]) -> State:
    """A state that satisfies the joints and their velocity constraints to rounding, from one that does not.

    Positions and attitudes change by the least in the metric of the masses, to first order in the change, velocities
    then by the least kinetic energy, (10.2) of docs/theory.md. Drives are those at `problem.time`.

    Parameters
    ----------
    problem : Problem
        Redundant constraint rows are counted at its own state.
    state : x, R, v, w
        (n, 3), (n, 3, 3), (n, 3), (n, 3), in the conventions of `lieeuler.types`; open by a part of the system's size.

    Returns
    -------
    x, R, v, w
        As `dataclasses.replace(problem, x=x, R=R, v=v, w=w)` and prepared runs take them.

    Raises
    ------
    ArgumentError
        The state has other shapes or no rotations, or no closed state was found from there.
    """
    x, R, v, w = _arrays(problem, state)
    closed = 0
    for _ in range(MOST_PASSES):  # each with a matrix from where it begins
        status, x, R, v, w = _kernel.project(problem.kernel, problem.time, problem.x, problem.R, x, R, v, w)
        if status not in (Status.SUCCESS, Status.NEWTON_FAILED):
            break
        closed += status == Status.SUCCESS
        if closed == 2:  # the first ends near the joints, the second to rounding
            return x, R, v, w
    raise ArgumentError(f"no closed joints are found from this state ({status}); give a closer one")


@dataclasses.dataclass(frozen=True)
class Accelerations:
    """What the equations of motion give at one state, in the conventions of `lieeuler.types`.

    Attributes
    ----------
    a, alpha : (n, 3)
        m/s^2, world axes; rad/s^2, body axes.
    lam : (m,)
        Multipliers, those of least norm if rows are redundant.
    force, torque : (joints, 3)
        What each joint exerts on its child at the child's anchor, N and N m, world axes; its rotors included.
    redundant_rows : int
    """

    a: np.ndarray
    alpha: np.ndarray
    lam: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    redundant_rows: int


def accelerations(problem: Problem, state: Sequence[ArrayLike] | None = None) -> Accelerations:
    """Accelerations, multipliers and reactions of the index-1 system, equation (1.4) of docs/theory.md.

    Laws of joint coordinates do not act. Angles of springs lie in (-pi, pi], a rotation counts as none.

    Parameters
    ----------
    problem : Problem
        Its `time` is that of drives and loads.
    state : x, R, v, w, optional
        (n, 3), (n, 3, 3), (n, 3), (n, 3); by default the problem's own. Nothing closes joints that are open there.

    Raises
    ------
    ArgumentError
        The state has other shapes or no rotations, or the constraints are dependent at a singular position.
    """
    x, R, v, w = _arrays(problem, (problem.x, problem.R, problem.v, problem.w) if state is None else state)
    a, alpha, lam, exerted, redundant, end = _kernel.index1(
        problem.kernel, np.array([problem.time]), x, R, v, w, np.zeros((1, problem.kernel.angles)))
    raise_own(problem)
    if end == 0:
        raise ArgumentError(f"no accelerations at this state: {Status.SINGULAR_MATRIX.advice}")
    force, torque = np.zeros((2, len(problem.joints), 3))
    for k, joint in enumerate(problem.joints):
        attitude = R[joint.child]
        force[k] = exerted[0, k, :3]
        torque[k] = attitude @ exerted[0, k, 3:] - np.cross(attitude @ joint.child_anchor, force[k])
    return Accelerations(a[0], alpha[0], lam[0], force, torque, redundant)


def raise_own(problem: Problem) -> None:
    """Raise what a force of one's own raised."""
    for force in problem.custom:
        if force.raised:
            error = force.raised[0]
            force.raised.clear()
            raise error


def _arrays(problem: Problem, state: Sequence[ArrayLike]) -> State:
    if not isinstance(problem, Problem):
        raise ArgumentError(f"problem must be a lieeuler.Problem, not {problem!r}")
    if not isinstance(state, Sequence) or len(state) != 4:
        raise ArgumentError(f"state must be four arrays, x, R, v and w, not {state!r}")
    return _state(problem.n, state)


def _state(n: int, state: Sequence[ArrayLike]) -> State:
    """The arrays of a state of n bodies."""
    x, R, v, w = (array(name, value, shape) for name, value, shape in
                  zip("xRvw", state, ((n, 3), (n, 3, 3), (n, 3), (n, 3)), strict=True))
    if np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max() > 1e-10 or (np.linalg.det(R) < 0).any():
        raise ArgumentError("R must hold rotation matrices")
    return x, R, v, w
