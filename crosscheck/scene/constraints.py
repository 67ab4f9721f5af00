"""The joints of a scene as constraints, evaluated over whole trajectories at once.

This gives Phi, G u and G du/dt + gamma the same measure for every engine. Conventions, with i the parent, j the child,
points s and axes a in body axes, d = x_j + R_j s_j - x_i - R_i s_i:

- a joint with an axis uses two unit vectors n1, n2 of the parent normal to its axis a: n1 is the coordinate direction
  along which a has its smallest component (the first of equal ones), made normal to a; n2 = a x n1;
- parallel axes are the two dot-1 rows n1 . child_axis, n2 . child_axis, which are never singular where the axes
  coincide; offsets across an axis are the dot-2 rows of n1, then n2; the offset from a plane is the dot-2 row of a;
- prismatic adds the dot-1 row n1 . b, with b fixed in the child: n2 at the start, made normal to child_axis;
- fixed takes f, fixed in the child, as the parent's coordinate axes e at the start: rows e1.f2, e2.f3, e3.f1;
- distance is (d . d - c^2) / (2 c);
- a drive adds coordinate - function of time, last: the angle of a hinge, or axis . d of a slide;
- a mimic adds coordinate - ratio (coordinate of the other joint) - offset, last;
- contacts with a plane, whose rows of slip hold velocities alone, are those of `crosscheck.scene.contacts`.

Rows: joints in file order, and within a joint positions before dot-1 for spherical, universal, revolute and fixed
(3 + 0, 1, 2, 3 rows); dot-1 before dot-2 for cylindrical (2 + 2) and planar (2 + 1); prismatic is cylindrical + dot-1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.scene.basics import AnyBasic, basics, coordinate, stacked
from crosscheck.scene.contacts import KnifeEdge
from crosscheck.scene.coordinates import history
from crosscheck.scene.model import Joint, Mimic, Scene
from crosscheck.scene.states import Motion
from crosscheck.scene.vectors import cross

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_ZERO = np.zeros(3)
_AT_ONCE = 200_000
"""Rows times states evaluated at once; more would need more memory without being faster."""


@dataclasses.dataclass(frozen=True)
class Follower:
    """Row `row` is a coordinate that follows the one in row `leader`, which is none of the scene's."""

    row: int
    leader: int
    turns: bool
    mimic: Mimic
    joint: Joint  # the leader's


class Constraints:
    """The constraint equations of a scene.

    All methods take arrays with a leading time axis: x, v, a (T, n, 3) world, R (T, n, 3, 3) body to world, w and
    alpha (T, n, 3) body axes, lam (T, m). Rows have the unit metre, or none for dot-1 rows.

    Attributes
    ----------
    m : number of rows.
    rows : the rows of each joint, by its name.
    dimensionless : (m,) true for the dot-1 rows.
    slips : (m,) true for the rows that hold velocities and no positions.
    drives : (row, function of time, whether it is an angle) of each prescribed coordinate.
    followers : those of mimics.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        attitudes = np.concatenate([scene.R0, np.eye(3)[None]])  # the ground is index -1, the last
        self.rows: dict[str, slice] = {}
        self.m = 0
        kinds: dict[Any, tuple[list[AnyBasic], list[int]]] = {}

        def place(basic: AnyBasic, row: int) -> int:
            alike, starts = kinds.setdefault((type(basic), type(basic.left), type(basic.right)), ([], []))
            alike.append(basic)
            starts.append(row)
            return row + basic.rows

        for joint in scene.joints:
            first = self.m
            for basic in basics(joint, attitudes[joint.parent], attitudes[joint.child]):
                self.m = place(basic, self.m)
            self.rows[joint.name] = slice(first, self.m)
        self.followers: list[Follower] = []
        for joint in scene.joints:
            if joint.mimic is not None:
                leader = scene.joint(joint.mimic.joint)
                self.followers.append(Follower(self.rows[joint.name].stop - 1, self.m + len(self.followers),
                                               not joint.kind.slides, joint.mimic, leader))
                place(coordinate(leader), self.followers[-1].leader)
        self.drives = [(rows.stop - 1, joint.drive, not joint.kind.slides) for joint, rows in
                        zip(scene.joints, self.rows.values(), strict=True) if joint.drive is not None]
        self._basics: list[tuple[np.ndarray, AnyBasic]] = [  # rows (K, rows of each)
            (np.array(starts)[:, None] + np.arange(alike[0].rows), stacked(alike)) for alike, starts in kinds.values()]
        dimensionless, slips = np.zeros((2, self._all_rows), dtype=bool)
        for rows, basic in self._basics:
            dimensionless[rows] = basic.dimensionless
            slips[rows[:, 1:]] = isinstance(basic, KnifeEdge)
        self.dimensionless, self.slips = dimensionless[:self.m], slips[:self.m]

    def rows_without(self, body: int | None) -> np.ndarray:
        """Indices of the rows of all joints except those at one body."""
        there = [np.arange(self.m)[self.rows[joint.name]] for joint in self.scene.joints
                 if body not in (joint.parent, joint.child)]
        return np.concatenate([*there, np.empty(0, dtype=int)])

    @property
    def _all_rows(self) -> int:
        """m, and the rows of leaders."""
        return self.m + len(self.followers)

    def position(self, x: np.ndarray, R: np.ndarray, t: np.ndarray | float = 0.0,
                 leaders: np.ndarray | None = None) -> np.ndarray:
        """Phi at times t, (T, m); `leaders` as from `leaders_at`, by default within half a turn of the start."""
        values = self._driven(self._evaluated("value", x, R), 0, t)
        if self.followers:
            values[:, self.m:] = self._leaders_near(values[:, self.m:]) if leaders is None else leaders
            values = self._folded(values)
            for follower in self.followers:
                values[:, follower.row] -= follower.mimic.offset
        for row, turns in (*((row, turns) for row, _, turns in self.drives),
                           *((follower.row, follower.turns) for follower in self.followers)):
            if turns:
                values[:, row] = np.remainder(values[:, row] + np.pi, 2 * np.pi) - np.pi
        return values

    def _leaders_near(self, values: np.ndarray) -> np.ndarray:
        """Coordinates of leaders in (-pi, pi], with the turns of their starts."""
        for k, follower in enumerate(self.followers):
            leader = follower.joint
            if not leader.kind.slides and leader.start is not None:
                values[:, k] += 2 * np.pi * np.round((leader.start[0] - values[:, k]) / (2 * np.pi))
        return values

    def leaders_at(self, states: Motion) -> np.ndarray:
        """Coordinates that others follow, (T, one a mimic), with the whole turns of the states."""
        return np.array([history(self.scene, follower.joint, states).position
                         for follower in self.followers]).reshape(-1, len(states.t)).T

    def _folded(self, values: np.ndarray) -> np.ndarray:
        """Rows (T, m, ...) of (T, m and leaders, ...)."""
        for follower in self.followers:
            values[:, follower.row] -= follower.mimic.ratio * values[:, follower.leader]
        return values[:, :self.m]

    def velocity(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                 t: np.ndarray | float = 0.0) -> np.ndarray:
        """dPhi/dt at times t, (T, m): G u minus the rates of drives."""
        return self._driven(self._folded(self._evaluated("rate", x, R, v, w)), 1, t)

    def gamma(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
              t: np.ndarray | float = 0.0) -> np.ndarray:
        """gamma = d2Phi/dt2 - G du/dt at times t, (T, m)."""
        return self._driven(self._folded(self._evaluated("gamma", x, R, v, w)), 2, t)

    def _driven(self, values: np.ndarray, derivative: int, t: np.ndarray | float) -> np.ndarray:
        """Subtract the drives, or their derivatives, from the rows, in place."""
        for row, drive, _ in self.drives:
            values[:, row] -= drive(t, derivative)
        return values

    def _evaluated(self, quantity: str, *state: np.ndarray) -> np.ndarray:
        values = np.empty((len(state[0]), self._all_rows))
        for part in self._parts(len(values)):
            x, R, *rates = (each[part] for each in state)
            full = with_ground(x), with_ground(R, np.eye(3)), *(with_ground(rate) for rate in rates)
            for rows, basic in self._basics:
                values[part, rows] = getattr(basic, quantity)(*full)
        return values

    def _parts(self, times: int) -> list[slice]:
        length = max(1, _AT_ONCE // max(1, self.m))
        return [slice(first, first + length) for first in range(0, times, length)]

    def acceleration(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, a: np.ndarray,
                     alpha: np.ndarray, t: np.ndarray | float = 0.0) -> np.ndarray:
        """G du/dt + gamma at times t, (T, m), with du/dt = (a world, alpha body axes)."""
        return np.asarray(self._folded(self._evaluated("rate", x, R, a, alpha)) + self.gamma(x, R, v, w, t))

    def jacobian(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """G, (T, m, 6n): per body in order three columns for v (world) and three for w (body axes)."""
        return self._folded(self._jacobian(x, R))

    def _jacobian(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """G with the rows of leaders."""
        n = self.scene.n
        G = np.zeros((len(x), self._all_rows, n + 1, 6))
        for part in self._parts(len(x)):
            for rows, body, linear, angular in self._blocks(x[part], R[part]):
                at = part, rows, body[:, None]
                if linear is not None:
                    G[(*at, slice(3))] += linear
                G[(*at, slice(3, 6))] += angular
        return G[:, :, :n].reshape(len(x), self._all_rows, 6 * n)

    def sparse_jacobian(self, x: np.ndarray, R: np.ndarray) -> csr_array:
        """G of all states as the blocks (m, 6n) on the diagonal of a `scipy.sparse.csr_array`."""
        from scipy.sparse import coo_array

        entries: list[tuple[np.ndarray, ...]] = [(np.empty(0), np.empty(0, int), np.empty(0, int))]
        state = np.arange(len(x))[:, None, None, None]
        for rows, body, linear, angular in self._blocks(x, R):
            own = rows[:, :, None]
            factors = np.ones(own.shape)
            for follower in self.followers:
                factors = np.where(own == follower.leader, -follower.mimic.ratio, factors)
                own = np.where(own == follower.leader, follower.row, own)
            for first, values in ((0, linear), (3, angular)):
                if values is not None:
                    columns = 6 * body[:, None, None] + first + np.arange(3)
                    there = np.broadcast_to(columns >= 0, (len(x), *values.shape[1:]))
                    entries.append(tuple(np.broadcast_to(each, there.shape)[there] for each in (
                        factors * values, self.m * state + own, 6 * self.scene.n * state + columns)))
        data, row, column = (np.concatenate(each) for each in zip(*entries, strict=True))
        return coo_array((data, (row, column)), shape=(self.m * len(x), 6 * self.scene.n * len(x))).tocsr()

    def _blocks(self, x: np.ndarray, R: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, Any, np.ndarray]]:
        """(rows (K, r), bodies (K,), the two parts of a `Block`) of all joints."""
        x, R = with_ground(x), with_ground(R, np.eye(3))
        for rows, basic in self._basics:
            for body, linear, angular in basic.blocks(x, R):
                yield rows, body, linear, angular

    def reactions(self, x: np.ndarray, R: np.ndarray, lam: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Force (T, 3) in N and torque (T, 3) in N m of each joint on its child, world axes, at the child's anchor."""
        lam = np.concatenate([lam, *(-follower.mimic.ratio * lam[:, follower.row, None]
                                     for follower in self.followers)], axis=1)
        joints, names = self.scene.joints, list(self.rows)
        owner = np.empty(self._all_rows, dtype=int)  # the joint whose rows they are
        for index, own in enumerate(self.rows.values()):
            owner[own] = index
        for follower in self.followers:
            owner[follower.leader] = names.index(follower.joint.name)
        children = np.array([joint.child for joint in joints], dtype=int)
        wrench = np.zeros((len(joints), len(x), 6))  # force, and torque about the centre of mass in body axes
        for part in self._parts(len(x)):
            for rows, body, linear, angular in self._blocks(x[part], R[part]):
                mine = children[owner[rows[:, 0]]] == body
                for first, block in ((0, linear), (3, angular)):
                    if block is not None and mine.any():
                        pull = np.einsum("tkri,tkr->tki", np.broadcast_to(
                            block, (len(x[part]), *block.shape[-3:]))[:, mine], lam[part][:, rows[mine]])
                        np.subtract.at(wrench[:, part, first:first + 3], owner[rows[mine, 0]], np.swapaxes(pull, 0, 1))
        attitude = R[:, children]
        force, about_com = np.swapaxes(wrench[:, :, :3], 0, 1), np.einsum("tkij,ktj->tki", attitude, wrench[:, :, 3:])
        arm = np.einsum("tkij,kj->tki", attitude, np.array([joint.child_anchor for joint in joints]).reshape(-1, 3))
        torque = about_com - cross(arm, force)
        return {name: (force[:, k], torque[:, k]) for k, name in enumerate(names)}


def with_ground(values: np.ndarray, ground: np.ndarray = _ZERO) -> np.ndarray:
    """`values` with the ground as one more body at the end, where its index -1 finds it."""
    return np.concatenate([values, np.broadcast_to(ground, (len(values), 1, *ground.shape))], axis=1)
