"""Energy, momentum, forces and index-1 accelerations of a scene over whole trajectories at once.

Arrays have a leading time axis: x, v (T, n, 3) world, R (T, n, 3, 3) body to world, w (T, n, 3) body axes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.scene.armature import rotors
from crosscheck.scene.constraints import Constraints, with_ground
from crosscheck.scene.coordinates import history, rates
from crosscheck.scene.laws import power_series
from crosscheck.scene.model import Force, Joint, Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.sparse import block_diagonal
from crosscheck.scene.states import Motion, States
from crosscheck.scene.vectors import cross

if TYPE_CHECKING:
    from scipy.sparse import csr_array

RANK_TOLERANCE = 1e-9
"""Singular values of G M^-1/2 below this fraction of the largest count as redundant rows. Rounding leaves those near
1e-16; the singular values of independent rows in realistic mechanisms are far above."""

MISSED, NEXT = 1e-13, 1e-4
"""Share of the size of G M^-1 G^T by which vectors of its null space may miss it; share of its least eigenvalue that
redundant rows may reach where joints are open, by which steps towards that space converge."""

FEW_BODIES = 16
"""Up to here dense index-1 systems take less time than sparse ones."""

AT_ONCE = 2000
"""Bodies of all states whose sparse systems are solved as one."""


Efforts = Sequence[tuple[Joint, bool, np.ndarray]]
"""What laws of joints give, with what holds coordinates: the joint, whether its slide is meant, and (T,) N m or N."""


def kinetic_energy(scene: Scene, states: Motion) -> np.ndarray:
    """Kinetic energy, (T,) in J."""
    translation = np.einsum("n,tnk,tnk->t", scene.masses, states.v, states.v)
    rotation = np.einsum("tnj,njk,tnk->t", states.w, scene.inertias, states.w)
    u = np.concatenate([states.v, states.w], axis=-1).reshape(len(states.v), -1)
    for inertia, S, _ in rotors(scene, states.x, states.R, states.v, states.w):
        rotation = rotation + inertia * np.einsum("tk,tk->t", S, u) ** 2
    return np.asarray(0.5 * (translation + rotation))


def potential_energy(scene: Scene, states: Motion) -> np.ndarray:
    """Minus the sum of m g . x, plus the energy of every spring, (T,) in J."""
    angles = torsion_angles(scene, states)
    energy, states = -np.einsum("n,k,tnk->t", scene.masses, scene.gravity, states.x), _grounded(states)
    for force in scene.loads:
        if force.law.stores:
            p = force.at(states.t)
            u = _measured(scene, force, states, angles)[0] - p[force.law.rest]
            energy = energy + power_series(force.law.potential(p), u)
    for joint in scene.joints:
        for k, limits in enumerate(joint.limits):
            if limits is not None and not limits.rigid:
                energy = energy + limits.energy(_position(scene, joint, k, states, angles))
    return np.asarray(energy)


def energy(scene: Scene, states: Motion) -> np.ndarray:
    """Kinetic energy - sum of m g . x + spring energies, (T,) in J."""
    return np.asarray(kinetic_energy(scene, states) + potential_energy(scene, states))


def momentum_vertical(scene: Scene, states: Motion) -> np.ndarray:
    """Angular momentum about the upward vertical (-gravity; z without gravity) through the origin, (T,), kg m^2/s."""
    size = np.linalg.norm(scene.gravity)
    up = -scene.gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])
    orbital = np.einsum("n,tnk->tk", scene.masses, cross(states.x, states.v))
    spin = np.einsum("tnij,njk,tnk->ti", states.R, scene.inertias, states.w)
    return np.asarray((orbital + spin) @ up)


def orthogonality(R: np.ndarray) -> np.ndarray:
    """Largest entry of |R^T R - I| over all bodies, (T,)."""
    gap = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3))
    return np.asarray(gap.reshape(len(R), -1).max(axis=1, initial=0.0))


def torsion_angles(scene: Scene, states: Motion) -> dict[str, np.ndarray]:
    """Angles that torsional springs count, (T,) in rad, of joints that carry one, limits or a servo.

    They have the whole turns of the states; where these are not known, they are NaN.
    """
    angles = {}
    sprung = {force.joint for force in scene.loads}
    sprung |= {joint.name for joint in scene.joints if any(joint.limits)}
    for joint in (joint for joint in scene.joints if joint.name in sprung and joint.kind.has_angle):
        values = history(scene, joint, states).position
        turn = values if values.ndim == 1 else values[:, joint.kind.coordinates.index("turn")]
        angles[joint.name] = turn + joint.zero_angle
    return angles


def applied_forces(scene: Scene, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                   angles: dict[str, np.ndarray] | None = None, t: np.ndarray | float = 0.0,
                   efforts: Efforts | None = None) -> np.ndarray:
    """f(q, u, t) of M du/dt = f - G^T lam, (T, 6n): per body the force (world) and the torque - w x J w (body axes).

    Dry friction counts where a joint moves, soft limits do, rigid stops do not; of sampled servos nothing is known.

    `angles` as from `torsion_angles`; by default they are those of the start, or of times that lie close together. `t`:
    the times. `efforts` take the place of all laws of joints.
    """
    f = np.zeros((len(x), scene.n + 1, 6))
    f[:, :-1, :3] = scene.masses[:, None] * scene.gravity
    f[:, :-1, 3:] = -gyroscopic(scene.inertias, w)
    states = _grounded(States(np.broadcast_to(t, len(x)), x, R, v, w))
    R = states.R
    if angles is None:
        angles = torsion_angles(scene, states)
    for force in scene.loads:
        if efforts is None or not force.law.has_modes:
            _add_of_force(f, scene, force, states, angles)
    for joint, slides, size in efforts or ():
        _add_along(f, R, joint, slides, size)
    for joint in scene.joints if efforts is None else ():
        for k, (friction, limits) in enumerate(itertools.zip_longest(joint.dry_friction, joint.limits)):
            if friction is not None:
                _add_along(f, R, joint, joint.kind.coordinates[k] == "slide", friction.force(_rate(joint, k, states)))
            if limits is not None and not limits.rigid:
                q = _position(scene, joint, k, states, angles)
                _add_along(f, R, joint, joint.kind.coordinates[k] == "slide", limits.force(q, _rate(joint, k, states)))
    return f[:, :-1].reshape(len(x), 6 * scene.n)


def gyroscopic(inertias: np.ndarray, w: np.ndarray) -> np.ndarray:
    """w x J w in body axes, N m, of inertias (..., n, 3, 3) and angular velocities w (..., n, 3).

    Computed as w x (J - s I) w with s the middle entry on the diagonal: equal moments cancel in the matrix, exactly,
    where their products would leave a rounding error that spins up a needle.
    """
    middle = np.sort(np.diagonal(inertias, axis1=-2, axis2=-1), axis=-1)[..., 1]
    spread = inertias - middle[..., None, None] * np.eye(3)
    return cross(w, (spread @ w[..., None])[..., 0])


def force_on_bodies(scene: Scene, force: Force, states: Motion, angles: dict[str, np.ndarray]) -> np.ndarray:
    """The force (world) and the torque (body axes) of one force of the scene on every body, (T, n, 6)."""
    f = np.zeros((len(states.t), scene.n + 1, 6))
    _add_of_force(f, scene, force, _grounded(states), angles)
    return f[:, :-1]


def _add_of_force(f: np.ndarray, scene: Scene, force: Force, states: Motion, angles: dict[str, np.ndarray]) -> None:
    """Add one force to f, (T, n + 1, 6), from states with the ground."""
    R, law, p = states.R, force.law, force.at(states.t)
    if law.effort is None:
        size = np.broadcast_to(p.get("factor", 1.0), len(R))[:, None]
        push = size * _in_world(p[law.measure], p["frame"], R[:, force.child])
        _act(f, R, force.child, push, p.get("child_point"))
        return
    value, rate, along = _measured(scene, force, states, angles)
    size = law.effort(p, value - p.get(law.rest, 0.0), rate)
    if law.on_joint:
        joint = scene.joint(force.joint)
        _add_along(f, R, joint, law.measure == "slide" or (law.measure == "coordinate" and joint.kind.slides), size)
        return
    _act(f, R, force.child, size[:, None] * along, p["child_point"])
    _act(f, R, force.parent, -size[:, None] * along, p["parent_point"])


def _measured(scene: Scene, force: Force, states: Motion, angles: dict[str, np.ndarray]
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The measure of a force and its rate, (T,), and of a distance its direction in the world, (T, 3)."""
    if force.law.on_joint:
        joint = scene.joint(force.joint)
        k = joint.kind.number(force.law.measure)
        value = _position(scene, joint, k, states, angles)
        zero = joint.zero_angle if force.law.measure == "angle" else 0.0
        return value + zero, _rate(joint, k, states), np.zeros(3)
    child, parent = ((body, force.parameters[point]) for body, point in (
        (force.child, "child_point"), (force.parent, "parent_point")))
    d = _point(states, *child) - _point(states, *parent)
    length = np.linalg.norm(d, axis=-1)
    direction = d / np.where(length > 0, length, 1.0)[:, None]  # zero at zero length
    rate = np.einsum("tk,tk->t", direction, _point_velocity(states, *child) - _point_velocity(states, *parent))
    return length, rate, direction


def _add_along(f: np.ndarray, R: np.ndarray, joint: Joint, slides: bool, size: np.ndarray) -> None:
    """Add a force along a joint's axis or a torque about it, (T,): on the child, the opposite on the parent."""
    push = size[:, None] * (R[:, joint.parent] @ joint.parent_axis)
    _act(f, R, joint.child, push, joint.child_anchor if slides else None)
    _act(f, R, joint.parent, -push, joint.parent_anchor if slides else None)


def _position(scene: Scene, joint: Joint, k: int, states: Motion, angles: dict[str, np.ndarray]) -> np.ndarray:
    """Coordinate k of a joint with a law, (T,); `angles` as from `torsion_angles`."""
    if joint.kind.coordinates[k] != "slide":
        return np.asarray(angles[joint.name] - joint.zero_angle)
    values = history(scene, joint, states).position
    return values if values.ndim == 1 else values[:, k]


def _rate(joint: Joint, k: int, states: Motion) -> np.ndarray:
    """The rate of coordinate k of a joint, (T,)."""
    values = rates(joint, states)
    return values if values.ndim == 1 else values[:, k]


def mass_matrix(scene: Scene) -> np.ndarray:
    """M, (6n, 6n), block diagonal in the order (v, w) of each body."""
    M = np.zeros((6 * scene.n, 6 * scene.n))
    for k, (mass, inertia) in enumerate(zip(scene.masses, scene.inertias, strict=True)):
        M[6 * k:6 * k + 3, 6 * k:6 * k + 3] = mass * np.eye(3)
        M[6 * k + 3:6 * k + 6, 6 * k + 3:6 * k + 6] = inertia
    return M


def inverse_mass(scene: Scene) -> np.ndarray:
    """M^-1, (6n, 6n), block diagonal in the order (v, w) of each body; of frames see `weights`."""
    masses, inertias = weights(scene)
    inverse = np.zeros((6 * scene.n, 6 * scene.n))
    for k, (mass, inertia) in enumerate(zip(masses, inertias, strict=True)):
        inverse[6 * k:6 * k + 3, 6 * k:6 * k + 3] = np.eye(3) / mass
        inverse[6 * k + 3:6 * k + 6, 6 * k + 3:6 * k + 6] = np.linalg.inv(inertia)
    return inverse


def weights(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Masses (n,) and inertias (n, 3, 3) of a metric of motions, in which ranks, gaps and errors are measured.

    They are those of the bodies; a frame, which has none and moves as its neighbours let it, counts as the mean body.
    No acceleration depends on that.
    """
    if not scene.frames.any():
        return scene.masses, scene.inertias
    bodies, masses, inertias = ~scene.frames, scene.masses.copy(), scene.inertias.copy()
    masses[scene.frames] = masses[bodies].mean()
    inertias[scene.frames] = np.trace(inertias[bodies], axis1=1, axis2=2).mean() / 3 * np.eye(3)
    return masses, inertias


def index1(scene: Scene, *state: Any, **more: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Accelerations and multipliers at given states; the arguments are those of a call of `Index1`."""
    return Index1(scene)(*state, **more)


class Index1:
    """The accelerations and multipliers of a scene that satisfy G du/dt + gamma = 0."""

    def __init__(self, scene: Scene, constraints: Constraints | None = None) -> None:
        self.scene, self.constraints = scene, constraints or Constraints(scene)
        self.closing = bool(spanning_tree(scene)[1])
        self.turning = any(any(joint.armature) for joint in scene.joints)
        self.frames = np.repeat(scene.frames, 6)
        self.sparse = (scene.n > FEW_BODIES and self.constraints.m and not self.closing and not self.turning
                       and not scene.frames.any())
        self.inverse = np.empty(0) if self.sparse else inverse_mass(scene)[None]
        if self.turning:  # a rotor is one more body, and its row: its own rate is that of its joint
            geared = rotors(scene, *(part[None] for part in (scene.x0, scene.R0, scene.v0, scene.w0)))
            inverse = np.diag([*[0.0] * 6 * scene.n, *(1 / inertia for inertia, *_ in geared)])
            inverse[:6 * scene.n, :6 * scene.n] = self.inverse[0]
            self.inverse = inverse[None]
            self.frames = np.append(self.frames, np.zeros(inverse.shape[0] - 6 * scene.n, bool))
        if self.frames.any():
            self.inverse = self.inverse[:, ~self.frames][:, :, ~self.frames]

    def __call__(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray,
                 angles: dict[str, np.ndarray] | None = None, t: np.ndarray | float = 0.0,
                 efforts: Efforts | None = None, combined: np.ndarray | None = None
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """a (T, n, 3) world, alpha (T, n, 3) body axes, lam (T, m) at states (T, ...) and times.

        If rows are redundant lam has least norm, with the rank found at the first state, or is of the rows `combined`,
        from `independent`. By dense algebra; open trees of more than `FEW_BODIES` without rotors by sparse.
        """
        scene, constraints = self.scene, self.constraints
        forces = applied_forces(scene, x, R, v, w, angles, t, efforts)
        gamma = constraints.gamma(x, R, v, w, t)
        if self.sparse:
            parts = np.array_split(np.arange(len(x)), math.ceil(len(x) * scene.n / AT_ONCE))
            solved = [_sparse_index1(scene, constraints.sparse_jacobian(x[k], R[k]), forces[k], gamma[k])
                      for k in parts]
            rates, lam = (np.concatenate(each) for each in zip(*solved, strict=True))
            a, alpha = np.split(rates.reshape(len(x), scene.n, 6), 2, axis=-1)
            return a, alpha, lam
        G, bias = self.rows(x, R, v, w, combined)
        if combined is not None:
            gamma = (combined @ gamma[:, :, None])[:, :, 0]
        rows, gamma = gamma.shape[1], np.concatenate([gamma, bias], axis=1)
        # An open tree has no redundant rows.
        rates, more = self.solver(G, independent=not self.closing or combined is not None)(forces, gamma)
        lam = more[:, :rows] if combined is None else (more[:, None, :rows] @ combined)[:, 0]
        a, alpha = np.split(rates.reshape(len(x), scene.n, 6), 2, axis=-1)
        return a, alpha, lam

    def rows(self, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, combined: np.ndarray | None = None
             ) -> tuple[np.ndarray, np.ndarray]:
        """G, or `combined` G, with a row and a column of each rotor; the drift (T, k) of the rates of rotors."""
        G = self.constraints.jacobian(x, R)
        if combined is not None:
            G = combined @ G
        if not self.turning:
            return G, np.zeros((len(x), 0))
        _, S, bias = zip(*rotors(self.scene, x, R, v, w), strict=True)
        own = np.vstack([np.zeros((G.shape[1], len(S))), -np.eye(len(S))])
        return np.concatenate([np.concatenate([G, np.stack(S, axis=1)], axis=1),
                               np.broadcast_to(own, (len(x), *own.shape))], axis=2), np.stack(bias, axis=1)

    def solver(self, G: np.ndarray, independent: bool) -> Callable[[np.ndarray, np.ndarray],
                                                                   tuple[np.ndarray, np.ndarray]]:
        """du/dt (T, 6n) and lam (T, m), as functions of f (T, 6n) and gamma (T, m), of the equations

            M du/dt + G^T lam = f,    G du/dt + gamma = 0,    G as from `rows`, or with more rows.

        Of frames, the columns F of G without mass, these are F^T lam = f_F. With F = Q T, N orthonormal and N^T Q = 0,
        lam = N mu + Q T^-T f_F, where mu is that of the other columns B with the rows N^T B and forces f_B - B^T Q
        T^-T f_F; then T du_F/dt = -Q^T (B du_B/dt + gamma).

        `independent`: whether no row is redundant.
        """
        frames, size = self.frames, 6 * self.scene.n
        if not frames.any():
            bound = self._bound(G, independent)
        else:
            B = G[:, :, ~frames]
            Q, T = np.linalg.qr(G[:, :, frames], mode="complete")
            N, Q, T = Q[:, :, T.shape[2]:], Q[:, :, :T.shape[2]], T[:, :T.shape[2]]
            of_bodies = self._bound(np.swapaxes(N, 1, 2) @ B, independent)

            def bound(f: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                lam = (Q @ np.linalg.solve(np.swapaxes(T, 1, 2), f[:, frames, None]))[:, :, 0]
                found, mu = of_bodies(f[:, ~frames] - (lam[:, None] @ B)[:, 0], (gamma[:, None] @ N)[:, 0])
                left = ((gamma + (B @ found[:, :, None])[:, :, 0])[:, None] @ Q)[:, 0]
                rates = np.zeros(f.shape)
                rates[:, ~frames] = found
                rates[:, frames] = -np.linalg.solve(T, left[:, :, None])[:, :, 0]
                return rates, lam + (N @ mu[:, :, None])[:, :, 0]

        def solve(forces: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            turning = np.zeros((len(forces), len(frames) - size))
            rates, lam = bound(np.concatenate([forces, turning], axis=1), gamma)
            return rates[:, :size], lam

        return solve

    def _bound(self, G: np.ndarray, independent: bool) -> Callable[[np.ndarray, np.ndarray],
                                                                   tuple[np.ndarray, np.ndarray]]:
        """The same of columns with mass alone."""
        solve = _schur_solver(G, self.inverse, independent)

        def bound(f: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            rates, lam = np.asarray((f[:, None] @ self.inverse)[:, 0]), np.zeros_like(gamma)
            # The second pass restores the digits that G M^-1 G^T loses when a light body carries a heavy one.
            for _ in range(2 if G.shape[1] else 0):
                more = solve((G @ rates[:, :, None])[:, :, 0] + gamma)
                rates = rates - ((more[:, None] @ G) @ self.inverse)[:, 0]
                lam += more
            return rates, lam

        return bound

    def independent(self, x: np.ndarray, R: np.ndarray) -> np.ndarray | None:
        """Combinations (T, r, m) of the rows that say the same as all of them at these states and near them.

        None if no row is redundant. Their number is that of the scene's own state: where positions are a little off,
        all rows seem independent. To solve for these takes half as long as to leave out a null space that turns.
        """
        if not self.closing or not (redundant := redundant_rows(self.scene)):
            return None
        scaled = self.constraints.jacobian(x, R) @ np.linalg.cholesky(inverse_mass(self.scene))
        U = np.linalg.svd(scaled, full_matrices=False)[0][..., :scaled.shape[1] - redundant]
        return np.ascontiguousarray(np.swapaxes(U, 1, 2))


def _sparse_index1(scene: Scene, G: csr_array, force: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """du/dt (T, 6n) and lam (T, m) of an open tree, at a cost proportional to the number of bodies."""
    from scipy.sparse.linalg import splu

    blocks = np.zeros((scene.n, 2, 3, 3))
    blocks[:, 0] = np.eye(3) / scene.masses[:, None, None]
    blocks[:, 1] = np.linalg.inv(scene.inertias)
    inverse = block_diagonal(np.tile(blocks.reshape(-1, 3, 3), (len(force), 1, 1)))
    S = splu((G @ inverse @ G.T).tocsc())
    rates, lam = inverse @ force.ravel(), np.zeros(gamma.size)
    for _ in range(2):  # as in the dense algebra
        more = S.solve(G @ rates + gamma.ravel())
        rates = rates - inverse @ (G.T @ more)
        lam += more
    return rates.reshape(force.shape), lam.reshape(gamma.shape)


def _schur_solver(G: np.ndarray, inverse: np.ndarray, independent: bool) -> Callable[[np.ndarray], np.ndarray]:
    """lam of G M^-1 G^T lam = rhs, (T, m), as a function of rhs, with least norm if rows are redundant.

    `independent` skips the search for the rank, which takes as long as a hundred solutions.
    """
    scaled = G @ np.linalg.cholesky(inverse)
    S = scaled @ np.swapaxes(scaled, 1, 2)
    redundant = np.empty((G.shape[1], 0)) if independent else _redundant(scaled[0])
    if not redundant.shape[1]:
        return lambda rhs: np.linalg.solve(S, rhs[:, :, None])[:, :, 0]
    A, bad, root = _pseudo_inverse(scaled, S, redundant)

    def solve(rhs: np.ndarray) -> np.ndarray:
        lam = A @ rhs[:, :, None]
        lam = lam + A @ (rhs[:, :, None] - S @ lam)
        lam[bad] = root @ (np.swapaxes(root, 1, 2) @ rhs[bad][:, :, None])  # rounding stays along the weakest row
        return np.asarray(lam)[:, :, 0]

    return solve


def _pseudo_inverse(scaled: np.ndarray, S: np.ndarray, redundant: np.ndarray
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The inverse (T, m, m) of S = `scaled` `scaled`^T without its k least eigenvalues, to half the digits at least.

    Newton's method leads from their vectors at the first state, `redundant` (m, k), to those N of each, with
    B = (S + s N0 N0^T)^-1, which acts as S^-1 across N. Singular values take longer: they are taken where it misses, or
    where the null space has turned too far. Of these states, which the second array (T,) marks, the third is a root
    (., m, m - k) of the inverse.
    """
    size = np.trace(S, axis1=1, axis2=2) / S.shape[1]
    try:
        B = np.linalg.inv(S + size[:, None, None] * (redundant @ redundant.T))
    except np.linalg.LinAlgError:  # at one state
        B = np.full_like(S, np.nan)
    large = np.abs(B).max(axis=(1, 2))
    N = np.linalg.qr(B @ redundant)[0]
    for steps in range(3):
        own = np.swapaxes(N, 1, 2) @ S @ N
        missed = S @ N - N @ own
        bad = ~((np.abs(missed).max(axis=(1, 2)) <= MISSED * size) & (large * size <= MISSED**-0.5)
                & (np.abs(own).max(axis=(1, 2)) * large <= NEXT))
        if steps == 2 or not bad.any():
            break
        N = np.linalg.qr(N - B @ missed)[0]
    B -= N @ (np.swapaxes(N, 1, 2) @ B)
    B -= (B @ N) @ np.swapaxes(N, 1, 2)
    B[bad] = 0.0
    U, sigma, _ = (part[..., :S.shape[1] - redundant.shape[1]] for part in np.linalg.svd(scaled[bad]))
    return B, bad, U / sigma[:, None]


def loose_frame(scene: Scene) -> int | None:
    """A frame that can move at the start while all bodies with mass and all rotors rest, or None."""
    if not scene.frames.any():
        return None
    system = Index1(scene)
    F = system.rows(*(part[None] for part in (scene.x0, scene.R0, scene.v0, scene.w0)))[0][0][:, system.frames]
    _, sizes, V = np.linalg.svd(F)
    if len(sizes) == F.shape[1] and sizes[-1] > RANK_TOLERANCE * sizes[0]:
        return None
    return int(np.flatnonzero(scene.frames)[np.abs(V[-1]).argmax() // 6])


def redundant_rows(scene: Scene) -> int:
    """Number of constraint rows of the scene that depend on the others in the initial position."""
    G = Constraints(scene).jacobian(scene.x0[None], scene.R0[None])[0]
    return _redundant(G @ np.linalg.cholesky(inverse_mass(scene))).shape[1] if len(G) else 0


def _redundant(scaled: np.ndarray) -> np.ndarray:
    """Combinations (m, k) of the rows of G M^-1/2 that vanish to `RANK_TOLERANCE`."""
    U, sizes, _ = np.linalg.svd(scaled)
    return np.asarray(U[:, np.count_nonzero(sizes > RANK_TOLERANCE * sizes[0]):])


def _grounded(states: Motion) -> States:
    """The states with the ground as one more body at the end, where its index -1 finds it."""
    x, v, w = (with_ground(part) for part in (states.x, states.v, states.w))
    return States(states.t, x, with_ground(states.R, np.eye(3)), v, w, hinges=states.hinges)


def _point(states: Motion, body: int, s: tuple[float, ...]) -> np.ndarray:
    """World position (T, 3) of a point fixed in a body."""
    return np.asarray(states.x[:, body] + states.R[:, body] @ np.array(s))


def _point_velocity(states: Motion, body: int, s: tuple[float, ...]) -> np.ndarray:
    turning = cross(states.w[:, body], np.array(s))
    return np.asarray(states.v[:, body] + np.einsum("tij,tj->ti", states.R[:, body], turning))


def _in_world(vector: tuple[float, ...], frame: str, R: np.ndarray) -> np.ndarray:
    return R @ np.array(vector) if frame == "body" else np.broadcast_to(np.array(vector), (len(R), 3))


def _act(f: np.ndarray, R: np.ndarray, body: int, push: np.ndarray, point: Any) -> None:
    """Add a force (T, 3), world axes, at a point of a body, its own axes, or a torque where the point is None."""
    own = np.einsum("tji,tj->ti", R[:, body], push)
    if point is not None:
        f[:, body, :3] += push
    f[:, body, 3:] += own if point is None else cross(np.array(point), own)
