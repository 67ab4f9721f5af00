"""Applied forces besides gravity: springs with dampers, loads.

With a damper the Hamiltonian methods are no longer symplectic, but keep their order. Loads have no potential energy.
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import Frozen, Index, NonNegative, Number, Unit, Vector, normals, one_of, real
from lieeuler.errors import ArgumentError
from lieeuler.functions import TimeFunction, Value
from lieeuler.types import GROUND


@dataclasses.dataclass(frozen=True)
class LinearSpring(Frozen):
    """A spring that pulls two points at distance L together with the force stiffness (L - free_length) + damping dL/dt.

    Parameters
    ----------
    parent, child : int
        Body indices; the parent may be the ground (-1).
    parent_point, child_point : (3,)
        From the centre of mass, in the body's frame; in world coordinates for the ground.
    stiffness : float
        N/m.
    free_length : float
        m. A spring whose points coincide exerts no force: it has no direction.
    damping : float
        N s/m.
    """

    parent: Index
    child: Index
    parent_point: Vector
    child_point: Vector
    stiffness: NonNegative
    free_length: NonNegative
    damping: NonNegative = 0.0

    def add_to(self, system: _kernel.System) -> None:
        """Add this force to the compiled system."""
        system.add_linear_spring(self.parent, self.child, self.parent_point, self.child_point, self.stiffness,
                                 self.free_length, self.damping)


@dataclasses.dataclass(frozen=True)
class TorsionalSpring(Frozen):
    """Torque -(stiffness (theta - rest_angle) + damping dtheta/dt) + torque on the child, about a hinge's axis.

    The opposite torque acts on the parent. The angle theta is defined by R_parent^T R_child = exp(theta
    hat(parent_axis)) Q0, where Q0 is the shortest rotation that takes child_axis to parent_axis (for opposite axes the
    half turn about the first normal of `lieeuler.checks.normals`). It lies in (-pi, pi] at the start and is continuous
    over full turns.

    Parameters
    ----------
    parent, child : int
        Body indices; the parent may be the ground (-1).
    parent_axis, child_axis : (3,)
        The joint's axes, each in its body's frame.
    stiffness : float
        N m/rad.
    rest_angle : float or TimeFunction
        rad.
    damping : float
        N m s/rad.
    torque : float or TimeFunction
        N m; with zero stiffness and damping this is a motor. Only one of torque and rest_angle may depend on time.
    """

    parent: Index
    child: Index
    parent_axis: Unit
    child_axis: Unit
    stiffness: NonNegative
    rest_angle: Value
    damping: NonNegative = 0.0
    torque: Value = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.rest_angle, TimeFunction) and isinstance(self.torque, TimeFunction):
            raise ArgumentError("only one of rest_angle and torque may depend on time; use two springs")

    @property
    def pointer(self) -> np.ndarray:
        """(3,) the direction, in the child's frame, that lies on the first normal of parent_axis when theta is 0."""
        pointer: np.ndarray = shortest_rotation(self.child_axis, self.parent_axis).T @ normals(self.parent_axis)[0]
        return pointer

    def start_angle(self, R: np.ndarray) -> np.ndarray:
        """theta, rad in (-pi, pi], (...), where the bodies have the attitudes R (..., n, 3, 3)."""
        pointer = R[..., self.child, :, :] @ self.pointer
        if self.parent != GROUND:
            pointer = np.einsum("...ji,...j->...i", R[..., self.parent, :, :], pointer)
        n1, n2 = normals(self.parent_axis)
        return np.asarray(np.arctan2(pointer @ n2, pointer @ n1))

    def counted_from(self, angle: float | np.ndarray) -> TorsionalSpring:
        """The same spring for an angle theta that is smaller by `angle`, rad."""
        rest = self.rest_angle
        return dataclasses.replace(self, rest_angle=rest.scaled(1.0, offset=-float(angle))
                                   if isinstance(rest, TimeFunction) else rest - float(angle))

    def add_to(self, system: _kernel.System) -> None:
        """Add this force to the compiled system."""
        n1, n2 = normals(self.parent_axis)
        constant = 0.0 if isinstance(self.torque, TimeFunction) else self.torque
        drive = self.torque if isinstance(self.torque, TimeFunction) else TimeFunction([[constant]])
        rest = self.rest_angle
        if isinstance(rest, TimeFunction):  # it acts like a torque of stiffness times its value
            drive, rest = rest.scaled(self.stiffness, offset=constant), 0.0
        system.add_torsional_spring(self.parent, self.child, self.parent_axis, n1, n2, self.pointer, self.stiffness,
                                    rest, self.damping, None if drive == TimeFunction() else drive.kernel)


@dataclasses.dataclass(frozen=True)
class ConstantLoad(Frozen):
    """A force at a point of a body and a torque on it, constant in the world or in the body, times a common factor.

    Parameters
    ----------
    child : int
        Body index.
    force, torque : (3,)
        N, N m.
    point : (3,)
        Where the force acts, from the centre of mass, in the body's frame.
    frame : "world" | "body"
        The frame in which force and torque are given and constant.
    factor : TimeFunction, optional
        Multiplies force and torque.
    """

    child: Index
    force: Vector = dataclasses.field(default_factory=lambda: np.zeros(3))
    torque: Vector = dataclasses.field(default_factory=lambda: np.zeros(3))
    point: Vector = dataclasses.field(default_factory=lambda: np.zeros(3))
    frame: Annotated[str, one_of("world", "body")] = "world"
    factor: TimeFunction | None = None

    @property
    def parent(self) -> int:
        """A load acts against the ground."""
        return GROUND

    def add_to(self, system: _kernel.System) -> None:
        """Add this force to the compiled system."""
        system.add_load(self.child, self.point, self.force, self.torque, self.frame == "world",
                        None if self.factor is None else self.factor.kernel)


@dataclasses.dataclass(frozen=True)
class SlideForce(Frozen):
    """The force force - stiffness (s - rest_position) - damping ds/dt on the child along an axis of the parent.

    The opposite force acts on the parent; both act at anchors on the axis. The slide s is the child's anchor from the
    parent's, along the axis.

    Parameters
    ----------
    parent, child : int
        Body indices; the parent may be the ground (-1).
    parent_anchor, child_anchor : (3,)
        Those of the joint that keeps both anchors on the axis.
    parent_axis : (3,)
        In the parent's frame.
    force : float or TimeFunction
        N.
    stiffness : float
        N/m.
    rest_position : float
        m.
    damping : float
        N s/m.
    """

    parent: Index
    child: Index
    parent_anchor: Vector
    child_anchor: Vector
    parent_axis: Unit
    force: Value = 0.0
    stiffness: NonNegative = 0.0
    rest_position: Number = 0.0
    damping: NonNegative = 0.0

    def add_to(self, system: _kernel.System) -> None:
        """Add this force to the compiled system."""
        size = self.force if isinstance(self.force, TimeFunction) else TimeFunction([[self.force]])
        system.add_slide_force(self.parent, self.child, self.parent_anchor, self.child_anchor, self.parent_axis,
                               size.kernel, self.stiffness, self.rest_position, self.damping)


_FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_int, *[ctypes.c_void_p] * 6)


@dataclasses.dataclass(frozen=True)
class CustomForce(Frozen):
    """A force of one's own on all bodies, a function of time and state.

    Every method but taylor takes it, without reductions and spin-free frames. Where a step needs its derivative, that
    is by central differences. Its energy is not known, so that no error of the energy is given.

    Parameters
    ----------
    function : callable (t, x, R, v, w) -> (n, 6), or int
        Force (N, world axes) and torque about the centre of mass (N m, body axes) on each body, at a time (s), for the
        arrays of a state in the conventions of `lieeuler.types`. Or the address of a compiled function
        ``void f(double t, int n, const double* x, const double* R, const double* v, const double* w, double* out,
        void* user)``, which writes out (n, 6), and which several threads may call.
    user : int
        The last argument of a compiled function.
    """

    function: Callable[..., Any] | int
    user: Index = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.function, bool) or not (callable(self.function) or (
                isinstance(self.function, int) and self.function > 0)):
            raise ArgumentError(f"function must be callable, or the address of a compiled function, not "
                                f"{self.function!r}")

    @functools.cached_property
    def raised(self) -> list[BaseException]:
        """What the function raised in a run."""
        return []

    @functools.cached_property
    def _callback(self) -> Any:
        def call(t: float, n: int, x: int, R: int, v: int, w: int, out: int, _: int) -> None:
            to = np.ctypeslib.as_array((ctypes.c_double * (6 * n)).from_address(out))
            try:
                given = (np.ctypeslib.as_array((ctypes.c_double * (n * size)).from_address(at)).reshape(n, *shape)
                         for at, size, shape in ((x, 3, (3,)), (R, 9, (3, 3)), (v, 3, (3,)), (w, 3, (3,))))
                to[:] = self.value(t, *(each.copy() for each in given)).ravel()
            except BaseException as error:  # it cannot pass through the kernel: the run ends at what is no number
                self.raised.append(error)
                to[:] = np.nan

        return _FUNCTION(call)

    def value(self, t: float, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """(n, 6) the forces and torques of a callable.

        Raises
        ------
        ArgumentError
            They have another shape, or are no numbers.
        """
        assert callable(self.function)
        found = real(self.function(t, x, R, v, w))
        if found is None or found.shape != (len(x), 6):
            raise ArgumentError(f"the function of a CustomForce must return numbers of shape ({len(x)}, 6): force and "
                                "torque on each body")
        return found

    def add_to(self, system: _kernel.System) -> None:
        """Add this force to the compiled system, which must not outlive it."""
        address = ctypes.cast(self._callback, ctypes.c_void_p).value if callable(self.function) else self.function
        system.add_own_force(address or 0, self.user)


Force = LinearSpring | TorsionalSpring | ConstantLoad | SlideForce


def start_angles(forces: Sequence[Force], R: np.ndarray) -> np.ndarray:
    """Angles of torsional springs, rad in (-pi, pi]; zero for other forces."""
    return np.array([force.start_angle(R) if isinstance(force, TorsionalSpring) else 0.0 for force in forces])


def shortest_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The rotation by the smallest angle that takes the unit vector `start` to `end`."""
    cosine = start @ end
    if cosine < -1 + 1e-12:  # the cross product below would be rounding; half a turn about any normal is shortest
        n1, _ = normals(end)
        return 2 * np.outer(n1, n1) - np.eye(3)
    x, y, z = np.cross(start, end)
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: np.ndarray = np.eye(3) + hat + hat @ hat / (1 + cosine)
    return turn
