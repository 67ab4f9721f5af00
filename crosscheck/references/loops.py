"""Joints that close loops of a tree: constraint rows on its accelerations, solved by multipliers, over any number type.

A row is n . (a_j - a_i) + t . (alpha_j - alpha_i) + rest = 0, with world accelerations of the points of child j and
parent i at the child's anchor (the parent is thought extended to there). Its multiplier is a force along n and a torque
along t at that point on the child, and the opposite ones on the parent.

Contacts with a plane of the ground: the velocity where a body touches it vanishes. Let r lead from the point of a
blade, or the centre of a disk or sphere, to the point of contact, and u be the velocity of where it starts. All rows
follow from

    d/dt (u + w x r) = u' + w' x r + w x r'

along the normal of the plane, whose row is also that of the height, and along the directions of slip.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from crosscheck.references.generic import (
    ByBody,
    Number,
    add,
    apply,
    apply_transposed,
    cross,
    dot,
    factor_symmetric,
    scale,
    solve_factored,
    square_root,
)
from crosscheck.references.joint_motion import ZERO, Tree
from crosscheck.references.tree import FREE
from crosscheck.references.tree_loads import Loads
from crosscheck.scene.model import GROUND, Joint, Scene

ROLLING = ("knife_edge", "rolling_disk", "rolling_sphere")


def _directions(joint: Joint) -> list[np.ndarray | None]:
    """Directions of the rows, world: the normal first; None stands for the one across the blade."""
    normal = joint.parent_axis
    if joint.type == "knife_edge":
        return [normal, None]
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return [normal, first, np.cross(normal, first)]


def _contact_terms(joint: Joint, direction: list[Number] | None, is_height: bool, loads: Loads
          ) -> tuple[list[Number], list[Number], list[Number], Number, Number, Number]:
    """(place, n, t, rest, value, rate) of a row, as `crosscheck.references.loops.Row` has them."""
    normal = joint.parent_axis.tolist()
    place, velocity = loads.point(joint.child, joint.child_anchor.tolist())
    R = loads.placed[joint.child][0]
    w = apply(R, loads.frames[joint.child].w)
    reach, moving, height = ZERO, ZERO, 0.0
    if joint.type == "rolling_sphere":
        reach, height = scale(-joint.radius, normal), joint.radius
    if joint.type == "rolling_disk":  # r = -radius h / |h|, h = a x (n x a)
        a = apply(R, joint.child_axis.tolist())
        turning = cross(w, a)
        h = cross(a, cross(normal, a))
        rising = add(cross(turning, cross(normal, a)), cross(a, cross(normal, turning)))
        inverse = 1.0 / square_root(dot(h, h))
        e = scale(inverse, h)
        reach = scale(-joint.radius, e)
        moving = scale(-joint.radius * inverse, add(rising, scale(-1.0 * dot(e, rising), e)))
        height = joint.radius * dot(normal, e)
    carried = add(velocity, cross(w, reach))
    if direction is None:  # across the blade, which turns
        a = apply(R, joint.child_axis.tolist())
        n, rest = cross(normal, a), dot(cross(normal, cross(w, a)), carried)
    else:
        n, rest = direction, dot(direction, cross(w, moving))
    gap = dot(normal, add(place, (-joint.parent_anchor).tolist())) - height if is_height else 0.0
    return place, n, cross(reach, n), rest, gap, dot(n, carried)


DEPENDENT = 1e-9  # eigenvalues below this part of the largest belong to dependent rows
SHIFT, REPETITIONS = 1e-6, 4  # shift relative to the mean eigenvalue; gives 1e-16 for eigenvalues of 1e-2 of the mean
TRIALS = 6
ONE_POINT = ("spherical", "universal", "revolute", "fixed")


@dataclasses.dataclass(frozen=True)
class Cut:
    """One row of a joint: d . direction = 0, two perpendicular directions, or the length of a rod.

    `direction` is fixed in the parent; `other`, of a pair, in the child. A rod has neither. Rows that `slips` hold only
    velocities.
    """

    joint: Joint
    direction: list[Number] | None = None
    other: list[Number] | None = None
    slips: bool = False


@dataclasses.dataclass
class Row:
    """A row at one state: joint, point, n, t, `rest`, its value and its rate of change."""

    joint: Joint
    place: list[Number]
    n: list[Number]
    t: list[Number]
    rest: Number
    value: Number
    rate: Number


def cuts(scene: Scene, joints: tuple[Joint, ...]) -> list[Cut]:
    """All rows of the joints, dependent ones included."""
    listed = []
    for joint in joints:
        if joint.type in ROLLING:
            listed += [Cut(joint, None if way is None else way.tolist(), slips=k > 0)
                      for k, way in enumerate(_directions(joint))]
            continue
        frames = [np.eye(3) if body == GROUND else scene.R0[body] for body in (joint.parent, joint.child)]
        for vectors in _vectors(joint, frames[1].T @ frames[0]):
            direction, other = (None if vector is None else np.asarray(vector).tolist() for vector in vectors)
            listed.append(Cut(joint, direction, other))
    return listed


def _vectors(joint: Joint, relative: np.ndarray) -> list[tuple[Number, ...]]:
    """(direction, other) of the rows of a joint; `relative` takes parent to child axes at the start."""
    if joint.type == "distance":
        return [(None, None)]
    across = list(np.eye(3)) if joint.type in ONE_POINT else []
    pairs: list[tuple[Number, ...]] = []
    if joint.type == "fixed":
        pairs = [(np.eye(3)[k], relative[:, k - 1]) for k in range(3)]
    elif joint.type == "universal":
        pairs = [(joint.parent_axis, joint.child_axis)]
    elif joint.type != "spherical":
        first = np.cross(joint.parent_axis, np.eye(3)[np.argmin(np.abs(joint.parent_axis))])
        first = first / np.linalg.norm(first)
        second = np.cross(joint.parent_axis, first)
        if not joint.type.startswith("point_on"):
            pairs = [(first, joint.child_axis), (second, joint.child_axis)]
        if joint.type == "prismatic":
            pairs.append((second, relative @ first))
        if joint.type in ("planar", "point_on_plane"):
            across = [joint.parent_axis]
        elif joint.type != "revolute":
            across = [first, second]
    return [(direction, None) for direction in across] + pairs


def row(cut: Cut, loads: Loads) -> Row:
    """A cut's row at the state of `loads`."""
    joint = cut.joint
    if joint.type in ROLLING:
        return Row(joint, *_contact_terms(joint, cut.direction, not cut.slips, loads))
    i, j = joint.parent, joint.child
    place, velocity = loads.point(j, joint.child_anchor.tolist())
    anchor, _ = loads.point(i, joint.parent_anchor.tolist())
    R_i, reference, carried = loads.placed[i]
    w_i, w_j = (apply(loads.placed[body][0], loads.frames[body].w) for body in (i, j))
    spin = add(w_j, scale(-1.0, w_i))
    d = add(place, scale(-1.0, anchor))
    swept = cross(w_i, add(place, scale(-1.0, reference)))
    slip = add(velocity, scale(-1.0, add(carried, swept)))  # velocity of the child's point relative to the parent
    if cut.direction is not None and cut.other is not None:
        p, b = apply(R_i, cut.direction), apply(loads.placed[j][0], cut.other)
        t = cross(b, p)
        rest = dot(p, cross(spin, cross(spin, b))) - dot(t, cross(w_i, spin))
        return Row(joint, place, ZERO, t, rest, dot(p, b), dot(t, spin))
    if cut.direction is not None:
        n = apply(R_i, cut.direction)
        return Row(joint, place, n, ZERO, -2.0 * dot(n, cross(w_i, slip)), dot(n, d), dot(n, slip))
    n, turning = scale(1.0 / joint.length, d), cross(w_i, d)
    rate = add(slip, turning)
    rest = (dot(rate, rate) - dot(turning, turning)) * (1.0 / joint.length)
    value = 0.5 * (dot(d, n) - joint.length)
    return Row(joint, place, n, ZERO, rest, value, dot(n, slip))


def unit_wrenches(row: Row, loads: Loads) -> dict[int, tuple[list[Number], list[Number]]]:
    """Wrenches of a unit multiplier of a row on all bodies, own axes."""
    alone = Loads(loads.tree, loads.frames, loads.placed)
    alone.push_at(row.joint.child, row.place, row.n, row.t)
    alone.push_at(row.joint.parent, row.place, scale(-1.0, row.n), scale(-1.0, row.t))
    return alone.wrenches


def acceleration(row: Row, loads: Loads, alpha: ByBody, A: ByBody, column: int) -> Number:
    """n . (a_j - a_i) + t . (alpha_j - alpha_i) of a row in one column of accelerations, own axes."""
    total = 0.0
    for body, sign in ((row.joint.child, 1.0), (row.joint.parent, -1.0)):
        R, reference, _ = loads.placed[body]
        arm = apply_transposed(R, add(row.place, scale(-1.0, reference)))
        a = add(A[body][column], cross(alpha[body][column], arm))
        if column == 0:
            w = loads.frames[body].w
            a = add(a, cross(w, cross(w, arm)))
        total = total + sign * (dot(row.n, apply(R, a)) + dot(row.t, apply(R, alpha[body][column])))
    return total


def response(rows: list[Row], loads: Loads, alpha: ByBody, A: ByBody) -> list[list[Number]]:
    """Acceleration along each row by a unit multiplier of each; the symmetric matrix from its upper half."""
    upper = {(r, k): acceleration(rows[r], loads, alpha, A, k + 1)
             for r in range(len(rows)) for k in range(r, len(rows))}
    return [[upper[min(r, k), max(r, k)] for k in range(len(rows))] for r in range(len(rows))]


def rank(S: np.ndarray) -> int:
    """Rank of a symmetric response matrix."""
    values = np.linalg.eigvalsh(S)
    return int(np.count_nonzero(values > DEPENDENT * values[-1]))


def multipliers(S: list[list[Number]], rhs: list[Number], shift: float) -> list[Number]:
    """Solution of S lam = rhs, with least norm if rows are dependent (shift > 0).

    (S + shift) is regular; each repetition reduces the residual by shift over the least nonzero eigenvalue of S. No
    independent rows are chosen: a choice that is good at the start may become singular although the mechanism is not.
    """
    factors = factor_symmetric([[entry + shift if r == k else entry for k, entry in enumerate(line)]
                                for r, line in enumerate(S)])
    lam = solve_factored(factors, rhs)
    for _ in range(REPETITIONS if shift else 0):
        left = [right - sum((entry * part for entry, part in zip(line[1:], lam[1:], strict=True)), line[0] * lam[0])
                for line, right in zip(S, rhs, strict=True)]
        lam = add(lam, solve_factored(factors, left))
    return lam


def linear_relations(tree: Tree, gaps: Callable[[np.ndarray], tuple[np.ndarray, ...]],
                     initial: np.ndarray) -> np.ndarray | None:
    """Orthonormal C (k, coordinates) with C (q - q0) = 0 whenever the loops are closed, None if there is no such C.

    Parallelograms have one: their angles keep fixed ratios, even through positions where the loop rows lose rank. To
    find out, coordinates move by order one along the directions that keep the rows closed to first order at the start.
    """
    if any(link.turn == FREE for link in tree.links):
        return None
    count = tree.size // 2
    still = np.concatenate([initial[:count], np.zeros(len(initial) - count)])
    rows = []
    for k in range(count):  # rates are linear in the speeds, so unit speeds give the derivatives of the values
        still[count:2 * count] = np.eye(count)[k]
        rows.append(gaps(still)[1])
    U, sigma, _ = np.linalg.svd(np.array(rows))
    free = U[:, int(np.count_nonzero(sigma > DEPENDENT * sigma[0])):]
    rng = np.random.default_rng(0)
    for _ in range(TRIALS):
        moved = initial.copy()
        moved[:count] += free @ rng.uniform(-2, 2, size=free.shape[1])
        if np.max(np.abs(gaps(moved)[0] - gaps(initial)[0])) > DEPENDENT:
            return None
    return U[:, :count - free.shape[1]].T
