"""Accelerations of a tree in minimal coordinates by block elimination, leaves first, over any number type.

Accelerations a = (alpha, A) of a body, angular and of its reference point, and wrenches (N, F), torque and force at
that point, are 6-vectors in the body's axes. To give a body, with everything attached on its outer side, the
acceleration a takes the wrench H a + p. For the body alone, with lever r to the centre of mass and r^ = hat(r),

    H = (J - m r^ r^, m r^; -m r^, m),    p = (w x J w - torque + r x f, f),    f = m (w x (w x r) - g) - force.

With P = (1, l^; 0, 1) for a joint at arm l and T the rotation (R, R) into the inner body's axes, an outer body moves
with T^T P^T a + c + S du: what it is carried along with, its acceleration at constant speeds, its joint's motions. It
adds P T H T^T P^T and P T p. A joint transmits no power along its motions: S^T (H a + p) is the effort along them,
which gives du and reduces H to H - H S (S^T H S)^-1 S^T H. The angular acceleration of a free turn does not depend on
the inner body, so that its T is (0, R) and du is that acceleration itself.

Wrenches come in columns: the first is the actual one; each further one belongs to a unit multiplier of a loop, without
velocities and weight.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from crosscheck.references.generic import (
    ByBody,
    Matrix,
    Number,
    Vector,
    add,
    apply,
    apply_transposed,
    cross,
    factor_symmetric,
    hat,
    rotation,
    scale,
    solve_factored,
)
from crosscheck.references.joint_motion import Frame, Tree
from crosscheck.references.tree import FREE, Link
from crosscheck.scene.model import GROUND

ANGULAR, LINEAR = np.split(np.eye(6), 2, axis=1)

Elimination = tuple[np.ndarray, np.ndarray, np.ndarray]
"""The elimination of motions S (6, k): du = rest - gain a for a carried along, gain (k, 6) and rest (k, columns)."""


def gyroscopic(inertia: Matrix, w: Vector) -> Vector:
    """w x J w, body axes.

    Computed as w x (J - s) w, with s the middle entry on the diagonal: two equal moments then cancel exactly. Their
    rounding error would spin up a needle, whose third moment is a millionth of theirs. Symbols have no order, and s is
    the first.
    """
    diagonal = [inertia[k][k] for k in range(3)]
    middle = sorted(diagonal)[1] if all(isinstance(entry, float) for entry in diagonal) else diagonal[0]
    return cross(w, apply([[entry - middle if i == j else entry for j, entry in enumerate(row)]
                           for i, row in enumerate(inertia)], w))


def centripetal(w: Vector, lever: Vector) -> Vector:
    """w x (w x lever), body axes."""
    return cross(w, cross(w, lever))


def weight(mass: float, gravity: Vector) -> Vector:
    """m g in the axes of `gravity`."""
    return scale(mass, gravity)


def accelerations(tree: Tree, frames: dict[int, Frame], wrenches: ByBody, efforts: ByBody | None = None,
                  driven: dict[int, Number] | None = None) -> tuple[ByBody, ByBody, ByBody]:
    """alpha, A and derivatives of speeds; each maps bodies to a list over columns.

    `wrenches` maps bodies, without the ground, to columns of (force, torque about the centre of mass) in own axes;
    `efforts` maps them to columns of generalized forces along each angle and displacement of their joint; `driven` maps
    them to the second derivative of the joint's coordinate, if that is prescribed.
    """
    gravity, driven = _gravity(tree, frames), driven or {}
    resisting = {link.body: _own(link, frames[link.body], gravity[link.body], wrenches[link.body])
                 for link in tree.links}
    joints: dict[int, tuple[np.ndarray, Elimination]] = {}
    for link in reversed(tree.links):
        body, frame, (H, p) = link.body, frames[link.body], resisting[link.body]
        bias, S = _bias(link, frame, frames[link.parent]), _motions(link, frame)
        if body in driven:
            bias, S = bias + S @ _table([[driven[body]]])[0], S[:, :0]
        p = _with_first(p, H @ bias)
        elimination, H, p = _eliminated(link, H, p, S, None if efforts is None else efforts[body])
        joints[body] = bias, elimination
        if link.parent != GROUND:
            H, p = _carried(frame, H, p)
            inner = resisting[link.parent]
            resisting[link.parent] = inner[0] + H, inner[1] + p
    return _outwards(tree, frames, joints, driven, p.shape[1] if joints else 0)


def _outwards(tree: Tree, frames: dict[int, Frame], joints: dict[int, tuple[np.ndarray, Elimination]],
              driven: dict[int, Number], columns: int) -> tuple[ByBody, ByBody, ByBody]:
    """alpha, A and derivatives of speeds, from the ground outwards."""
    a = {GROUND: np.zeros((6, columns), object)}
    rates: ByBody = {}
    for link in tree.links:
        frame, (bias, (S, gain, rest)) = frames[link.body], joints[link.body]
        R, (alpha, A) = _table(frame.turn).T, np.split(a[link.parent], 2)
        A = R @ (A - _table(hat(frame.arm)) @ alpha)
        now = np.concatenate([0.0 * alpha if link.turn == FREE else R @ alpha, A])
        du = rest - gain @ now
        a[link.body] = _with_first(now + S @ du if len(du) else now, bias)
        if link.shift == "free":  # its speed is that in the world
            du[3:] = R.T @ du[3:]
        if link.body in driven:
            du = _with_first(np.zeros((1, columns), object), [driven[link.body]])
        rates[link.body] = [[*column] for column in du.T]
    turning, moving = ({body: [list(part) for part in values[rows].T] for body, values in a.items()}
                       for rows in (slice(3), slice(3, 6)))
    return turning, moving, rates


def _table(rows: Sequence[Sequence[Number]]) -> np.ndarray:
    """A matrix of numbers of any type, arrays over time among them."""
    made = np.empty((len(rows), len(rows[0])), object)
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            made[i, j] = entry
    return made


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    """The matrix with its upper half mirrored, which keeps symbolic results small."""
    for i, j in zip(*np.tril_indices(len(matrix), -1), strict=True):
        matrix[i, j] = matrix[j, i]
    return matrix


def _with_first(columns: np.ndarray, more: Iterable[Number]) -> np.ndarray:
    """The columns with something added to the actual one."""
    columns = columns.copy()
    for row, entry in enumerate(more):
        columns[row, 0] = columns[row, 0] + entry
    return columns


def _gravity(tree: Tree, frames: dict[int, Frame]) -> ByBody:
    """Gravity in the axes of every body."""
    gravity = {GROUND: tree.scene.gravity.tolist()}
    for link in tree.links:
        frame = frames[link.body]
        if link.turn == FREE:  # from the body's own quaternion; products along a chain would accumulate rounding
            gravity[link.body] = apply_transposed(rotation(frame.q), gravity[GROUND])
        else:
            gravity[link.body] = apply_transposed(frame.turn, gravity[link.parent])
    return gravity


def _own(link: Link, frame: Frame, gravity: Vector, wrenches: Vector) -> tuple[np.ndarray, np.ndarray]:
    """H and the columns of p, (6, columns), of the body alone."""
    r, columns = _table(hat(frame.lever)), []
    for k, (force, torque) in enumerate(wrenches):
        f, tau = scale(-1.0, force), scale(-1.0, torque)
        if k == 0:
            f = add(f, scale(link.mass, centripetal(frame.w, frame.lever)), scale(-1.0, weight(link.mass, gravity)))
            tau = add(tau, gyroscopic(link.inertia, frame.w))
        columns.append([*add(tau, cross(frame.lever, f)), *f])
    inertia = _symmetric(_table(link.inertia) - link.mass * (r @ r))
    H = np.block([[inertia, link.mass * r], [-link.mass * r, link.mass * np.eye(3)]])
    return H.astype(object), _table(columns).T


def _motions(link: Link, frame: Frame) -> np.ndarray:
    """S (6, k): the accelerations by unit derivatives of the joint's speeds."""
    columns = [*ANGULAR.T] if link.turn == FREE else []
    columns += [[*turn, *shift] for turn, shift in frame.columns]
    columns += [*LINEAR.T] if link.shift == "free" else []
    return _table(columns).T if columns else np.zeros((6, 0), object)


def _drag(link: Link, frame: Frame, inner: Frame) -> Vector:
    """Acceleration of the joint's point at constant speeds, beyond the one carried along; inner axes."""
    drag = centripetal(inner.w, frame.arm)
    if link.outward or link.shift == "none":
        return drag
    return add(drag, scale(2.0, cross(inner.w, frame.shifting)))


def _bias(link: Link, frame: Frame, inner: Frame) -> np.ndarray:
    """c (6,): the acceleration at constant speeds, beyond the one carried along, own axes."""
    spin = np.zeros(3) if link.turn == FREE else frame.spin_bias
    drag = np.zeros(3) if link.parent == GROUND else apply_transposed(frame.turn, _drag(link, frame, inner))
    return np.asarray(_table([[*spin, *add([*drag], frame.shift_bias)]])[0])


def _eliminated(link: Link, H: np.ndarray, p: np.ndarray, S: np.ndarray, efforts: Vector | None
                ) -> tuple[Elimination, np.ndarray, np.ndarray]:
    """That of the motions S under efforts along them and with the joint's rotors, and what is left of H and p."""
    if not S.shape[1]:
        return (S, np.zeros((0, 6), object), np.zeros((0, p.shape[1]), object)), H, p
    U = H @ S
    D, power = S.T @ U, -(S.T @ p)
    first = 3 if link.turn == FREE else 0  # the motions of angles and displacements come after a free turn
    for k, rotor in enumerate(() if link.joint is None else link.joint.armature):
        D[first + k, first + k] = D[first + k, first + k] + rotor
    if efforts is not None and link.scalars:
        power[first:] = power[first:] + _table(efforts).T
    factors = factor_symmetric(_symmetric(D).tolist())
    solved = _table([solve_factored(factors, [*column]) for column in np.concatenate([U.T, power], axis=1).T]).T
    gain, rest = solved[:, :6], solved[:, 6:]
    H, p = _symmetric(H - U @ gain), p + U @ rest
    if link.turn == FREE:  # it transmits no torque
        H[:3], H[:, :3], p[:3] = 0.0, 0.0, 0.0
    return (S, gain, rest), H, p


def _carried(frame: Frame, H: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """P T H T^T P^T and P T p."""
    R, arm = _table(frame.turn), _table(hat(frame.arm))
    inertia, coupling, mass = (R @ part @ R.T for part in (H[:3, :3], H[:3, 3:], H[3:, 3:]))
    twisted, moved, f = coupling @ arm, arm @ _symmetric(mass), R @ p[3:]
    carried = np.block([[inertia - moved @ arm - twisted - twisted.T, coupling + moved], [mass, mass]])
    return _symmetric(carried), np.concatenate([R @ p[:3] + arm @ f, f])

