"""The initial state: open positions and velocities from the joints, and every joint closed to rounding level.

Positions and velocities change by the least amount in the metric of the mass matrix, attitudes on SO(3).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.scene import joint_options, starts
from crosscheck.scene.checks import Draft
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.mechanics import RANK_TOLERANCE
from crosscheck.scene.model import GROUND, Scene, quaternion_from_turn, quaternion_product
from crosscheck.scene.schema import EntryError
from crosscheck.scene.spanning import Branch, spanning_tree
from crosscheck.scene.sparse import block_diagonal, least_norm
from crosscheck.scene.starts import ALLOWED_VIOLATION, Configuration, anchor_length, bodies_at
from crosscheck.scene.vectors import cross

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_LARGE = 100  # bodies from which the algebra is sparse; dense, its time grows as their number cubed
_ITERATIONS = 400
_DIFFERENCE = 1e-5  # in the weighted displacement: a Hessian to about 1e-10, it only has to guide Newton's method
_STRAIGHT = 1e-4  # of the scene's length, and rad: for less displacement the curvature cannot be felt
_LEAST_CURVATURE = 0.1  # of the distance itself, which has 1
_SETTLED = 1e-12  # of the scene's length, and rad: far below the allowed violation, well above rounding
_BEFORE_DAMPING = 25  # iterations: most guesses settle within a dozen
_DAMPINGS = 4  # then full steps again: a search that has crept along a saddle until now settles with them
_NEAR = 0.05  # of the scene's length, and rad: full steps of this size contract
_LARGEST_TURN = 0.5  # rad in one correction: the chart of a rotation is far from flat beyond it


def completed(draft: Draft) -> Scene:
    """The scene with its whole initial state, joints closed to rounding level in position and velocity.

    Raises
    ------
    EntryError
        A position that nothing determines, a given state that violates the joints, or joints that cannot close; it
        names the joint with the largest gap. Or axes that point opposite ways.
    """
    scene = draft.scene
    state = Configuration(scene.x0, np.array([body.attitude for body in scene.bodies]), scene.v0, scene.w0)
    state, shifts = starts.attitudes(draft, state)
    scene = scene.replace(bodies=bodies_at(scene, state))  # from here on prismatic and fixed joints keep this attitude
    draft = dataclasses.replace(draft, scene=scene)
    # taken before any correction: prismatic and fixed joints keep the relative attitude of the file
    constraints = Constraints(scene)
    state = _tree_positions(draft, state, shifts)
    if not draft.assemble:
        phi = constraints.position(state.x[None], state.R[None])[0]
        _check_level(constraints, phi, 1.0, "position", "attitude")
    state = _close_positions(constraints, state)
    state, speeds = starts.spins(draft, state)
    state = _tree_velocities(draft, state, speeds)
    if not draft.assemble:
        rates = constraints.velocity(state.x[None], state.R[None], state.v[None], state.w[None])[0]
        spin = max(1.0, float(np.linalg.norm(state.w, axis=1).max()))
        _check_level(constraints, rates, spin, "velocity", "angular_velocity")
    state = _close_velocities(constraints, state)
    R = np.concatenate([state.R, np.eye(3)[None]])
    for index, joint in enumerate(scene.joints):
        # Opposite axes close the rows of a joint too, yet its angle then turns the other way for the child.
        if JOINT_TYPES[joint.type].axes == "parallel" and (
                (R[joint.parent] @ joint.parent_axis) @ (R[joint.child] @ joint.child_axis) < 0):
            raise EntryError(f'joints[{index}] "{joint.name}": child_axis',
                             "points opposite to parent_axis in the world", "reverse one of the two, or correct the "
                             f'attitude of "{scene.bodies[joint.child].name}"')
    done = scene.replace(bodies=bodies_at(scene, state))
    if not draft.assemble:
        starts.check(draft, done)
    return joint_options.with_forces(done)


def projected(scene: Scene, moved: Scene) -> Scene:
    """`moved`, whose bodies have other states than those of `scene`, with the joints of `scene` closed.

    Positions and velocities of bodies on joints with coincident anchors follow from attitudes and angular velocities,
    outwards from the ground; what stays open then is closed by the least mass-weighted change.

    Raises
    ------
    EntryError
        The joints cannot be closed from there.
    """
    hung = {joint.child for joint in scene.joints if JOINT_TYPES[joint.type].anchors_coincide}
    given = tuple(k not in hung for k in range(scene.n))
    state = Configuration(moved.x0, np.array([body.attitude for body in moved.bodies]), moved.v0, moved.w0)
    constraints = Constraints(scene)  # prismatic and fixed joints keep the relative attitude of the scene
    draft = Draft(moved, given, given, assemble=True)
    if any(branch.joint is None for branch in _tree(scene, given)):  # it floats: where it does is given
        draft = dataclasses.replace(draft, given_positions=(True,) * scene.n, given_velocities=(True,) * scene.n)
    state = _close_positions(constraints, _tree_positions(draft, state, {}))
    state = _close_velocities(constraints, _tree_velocities(draft, state, {}))
    return scene.replace(bodies=bodies_at(scene, state))


# --- open positions and velocities -----------------------------------------------------------------------------------


def _tree(scene: Scene, given: Sequence[bool]) -> list[Branch]:
    """The bodies whose state is not given, each with the joint that places it from a body that has one already.

    Joints whose anchors coincide come first, the others only where none of these leads on.
    """
    roots = [body for body in range(scene.n) if given[body]]
    return spanning_tree(scene, lambda joint: int(JOINT_TYPES[joint.type].anchors_coincide), roots)[0]


def _tree_positions(draft: Draft, state: Configuration, shifts: Mapping[str, np.ndarray]) -> Configuration:
    """Place the bodies without a position, outwards from the ground and from bodies that have one.

    Where the joint leaves the anchors free they coincide as well, which is the least distance it allows; on a distance
    joint the child's anchor hangs below the parent's, along gravity (along -z without gravity).
    """
    scene = draft.scene
    x, R = np.vstack([state.x, np.zeros(3)]), np.concatenate([state.R, np.eye(3)[None]])
    size = np.linalg.norm(scene.gravity)
    down = scene.gravity / size if size > 0 else np.array([0.0, 0.0, -1.0])
    for branch in _tree(scene, draft.given_positions):
        body, joint = branch.body, branch.joint
        if joint is None:
            raise EntryError(f'bodies[{body}] "{scene.bodies[body].name}": position',
                             "missing, and no chain of joints leads to it",
                             "add position = three numbers in m, the centre of mass in the world")
        gap = R[joint.parent] @ joint.parent_anchor - R[joint.child] @ joint.child_anchor
        if joint.length is not None:
            gap = gap + joint.length * down
        if joint.name in shifts:
            gap = gap + R[joint.parent] @ shifts[joint.name]
        x[body] = x[joint.parent] + gap if body == joint.child else x[joint.child] - gap
    return dataclasses.replace(state, x=x[:-1])


def _tree_velocities(draft: Draft, state: Configuration, speeds: Mapping[str, np.ndarray]) -> Configuration:
    """Velocities of the bodies without one: anchors do not move relative to each other, seen from the parent.

    In a group of bodies that no joint ties to the ground or to a given velocity, the first is at rest.
    """
    scene = draft.scene
    given = draft.given_velocities
    x, R = np.vstack([state.x, np.zeros(3)]), np.concatenate([state.R, np.eye(3)[None]])
    v, spin = np.vstack([np.where(np.array(given)[:, None], state.v, 0.0), np.zeros(3)]), np.zeros((len(x), 3))
    spin[:-1] = np.einsum("nij,nj->ni", state.R, state.w)
    for branch in _tree(scene, given):
        body, joint = branch.body, branch.joint
        if joint is None:
            continue
        arm = R[joint.child] @ joint.child_anchor
        carried = x[joint.child] + arm - x[joint.parent]
        change = cross(spin[joint.parent], carried) - cross(spin[joint.child], arm)
        if joint.name in speeds:
            change = change + R[joint.parent] @ speeds[joint.name]
        v[body] = v[joint.parent] + change if body == joint.child else v[joint.child] - change
    return dataclasses.replace(state, v=v[:-1])


# --- the check of a given state --------------------------------------------------------------------------------------


def _check_level(constraints: Constraints, rows: np.ndarray, spin: float, linear: str, angular: str) -> None:
    L = anchor_length(constraints.scene)
    if constraints.m == 0:
        return
    index, gap, unit = _largest_gap(constraints, rows, L)
    allowed = ALLOWED_VIOLATION * spin * (L if unit else 1.0)
    if abs(gap) <= allowed:
        return
    joint = constraints.scene.joints[index]
    names = [f'"{constraints.scene.bodies[k].name}"' for k in (joint.parent, joint.child) if k != GROUND]
    per_second = "/s" if linear == "velocity" else ""
    raise EntryError(f'joints[{index}] "{joint.name}"', f"the given state violates it in {linear} by {abs(gap):.3g}"
                     f"{unit}{per_second} (allowed {allowed:.3g})",
                     f"correct {linear} or {angular} of {' or '.join(names)}, or leave {linear} out and the joints "
                     f"determine it, or write assemble = true at the top and the state is corrected")


def _largest_gap(constraints: Constraints, rows: np.ndarray, L: float) -> tuple[int, float, str]:
    """(joint index, row value, unit) of the largest row, lengths counted in units of L."""
    row = int(np.argmax(np.abs(rows) / np.where(constraints.dimensionless, 1.0, L)))
    index = next(k for k, joint in enumerate(constraints.scene.joints) if row < constraints.rows[joint.name].stop)
    return index, float(rows[row]), "" if constraints.dimensionless[row] else " m"


# --- closing the joints ----------------------------------------------------------------------------------------------


def _close_positions(constraints: Constraints, guess: Configuration) -> Configuration:
    """The state nearest to `guess` with Phi = 0: min |z|^2 / 2 with z the mass-weighted displacement.

    The displacement of a body is (x - x_guess, theta) with R = R_guess exp(hat(theta)). Newton's method on the
    conditions of the minimum, in the least-norm sense where rows are redundant; the curvature of the joints enters by
    differences, and where it is negative by its size, so that the search leaves saddles. In large scenes it stays out:
    the iteration ends in the same conditions, if it ends, from guesses that lie near.
    """
    scene = constraints.scene
    size = _length_scale(scene, guess)
    if _at_rounding(constraints, constraints.position(guess.x[None], guess.R[None])[0], size):
        return guess
    large = scene.n > _LARGE
    unweighted = _inverse_root_mass(scene) if large else _inverse_root_mass(scene).toarray()
    units = np.tile([size] * 3 + [1.0] * 3, scene.n)
    z = np.zeros(6 * scene.n)
    for iteration in range(_ITERATIONS):
        if large:
            phi, W = _sparsely_linearised(constraints, guess, unweighted, z)
            step = least_norm(W, W @ z - phi) - z
        else:
            phi, W = (values[0] for values in _linearised(constraints, guess, unweighted, z[None]))
            curved = np.abs(unweighted @ z / units).max() > _STRAIGHT
            step = _newton_step(constraints, guess, unweighted, z, phi, W, curved)
        closed = _at_rounding(constraints, phi, size)
        largest = float(np.abs(unweighted @ step / units).max())
        if closed and largest < _SETTLED:
            return _moved(guess, (unweighted @ z).reshape(-1, 6))
        # From far away full steps may alternate between two places for ever.
        damping = 0.5 ** (iteration // _BEFORE_DAMPING % _DAMPINGS) if largest > _NEAR else 1.0
        z = z + step * (damping * _LARGEST_TURN / max(largest, _LARGEST_TURN))
        if not large:
            z = _shorter_way_round(unweighted, z)
    if closed:  # the joints close, though the search for the least change did not settle
        return _moved(guess, (unweighted @ z).reshape(-1, 6))
    index, gap, unit = _largest_gap(constraints, phi, anchor_length(scene))
    joint = scene.joints[index]
    raise EntryError(f'joints[{index}] "{joint.name}"', f"the joints cannot be closed together, this one keeps the "
                     f"largest gap, {abs(gap):.3g}{unit}", "check its anchors, axes and length against those of the "
                     "other joints, or give attitudes and positions nearer to a closed state")


def _shorter_way_round(unweighted: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The same attitudes by rotations of half a turn at most: beyond it the nearest place is no longer one."""
    turns = (unweighted @ z).reshape(-1, 6)
    turns[:, :3] = 0.0
    angles = np.linalg.norm(turns, axis=1, keepdims=True)
    if angles.max() <= np.pi:
        return z
    back = np.where(angles > np.pi, -2 * np.pi / np.maximum(angles, np.pi), 0.0) * turns
    return np.asarray(z + np.linalg.solve(unweighted, back.ravel()))


def _linearised(constraints: Constraints, guess: Configuration, unweighted: np.ndarray,
                z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phi (K, m) and its derivative by z (K, m, 6n) at K weighted displacements z (K, 6n) from the guess."""
    n = constraints.scene.n
    displacements = (z @ unweighted.T).reshape(-1, n, 6)
    moved = _moved(guess, displacements)
    x, R = moved.x, moved.R
    G = constraints.jacobian(x, R).reshape(len(z), -1, n, 6)
    G[..., 3:] = np.einsum("kmni,knij->kmnj", G[..., 3:], _right_tangents(displacements[..., 3:]))
    return constraints.position(x, R), G.reshape(len(z), -1, 6 * n) @ unweighted


def _sparsely_linearised(constraints: Constraints, guess: Configuration, unweighted: csr_array,
                         z: np.ndarray) -> tuple[np.ndarray, csr_array]:
    """Phi (m,) and its derivative by z, sparse, at one weighted displacement z (6n,)."""
    displacements = (unweighted @ z).reshape(-1, 6)
    moved = _moved(guess, displacements)
    tangents = np.zeros((len(displacements), 6, 6))
    tangents[:, :3, :3] = np.eye(3)
    tangents[:, 3:, 3:] = _right_tangents(displacements[:, 3:])
    G = constraints.sparse_jacobian(moved.x, moved.R)
    return constraints.position(moved.x[None], moved.R[None])[0], G @ block_diagonal(tangents) @ unweighted


def _newton_step(constraints: Constraints, guess: Configuration, unweighted: np.ndarray, z: np.ndarray, phi: np.ndarray,
                 W: np.ndarray, curved: bool) -> np.ndarray:
    """Step (6n,) to z + W^T lam = 0, Phi = 0: least-norm across the rows, Newton along their null space."""
    U, sigma, Vt = np.linalg.svd(W)
    rank = int(np.count_nonzero(sigma > RANK_TOLERANCE * sigma[0]))
    U, sigma, across, along = U[:, :rank], sigma[:rank], Vt[:rank], Vt[rank:]
    closing = -across.T @ (U.T @ phi / sigma)
    hessian = np.eye(len(z))
    if curved:
        lam = -U @ (across @ z / sigma)
        for first in range(0, len(z), 6):  # body by body: all at once would hold (6n)^2 m numbers
            shifts = _DIFFERENCE * np.eye(len(z))[first:first + 6]
            _, displaced = _linearised(constraints, guess, unweighted, np.concatenate([z + shifts, z - shifts]))
            bent = np.einsum("kmi,m->ki", displaced, lam)
            hessian[first:first + 6] += (bent[:6] - bent[6:]) / (2 * _DIFFERENCE)
    curvatures, directions = np.linalg.eigh(along @ (hessian + hessian.T) @ along.T / 2)
    slope = directions.T @ along @ (z + hessian @ closing)
    found: np.ndarray = closing - along.T @ (directions @ (slope / np.maximum(np.abs(curvatures), _LEAST_CURVATURE)))
    return found


def _inverse_root_mass(scene: Scene) -> csr_array:
    """B, (6n, 6n) block diagonal, with B^T M B = I."""
    blocks = np.zeros((scene.n, 6, 6))
    blocks[:, :3, :3] = np.eye(3) / np.sqrt(scene.masses)[:, None, None]
    blocks[:, 3:, 3:] = np.linalg.inv(np.linalg.cholesky(scene.inertias)).swapaxes(1, 2)
    return block_diagonal(blocks)


def _close_velocities(constraints: Constraints, state: Configuration) -> Configuration:
    """The velocities nearest to the given ones, mass-weighted, with G u = 0."""
    scene = constraints.scene
    size = _length_scale(scene, state) * float(np.abs(state.w).max()) + float(np.abs(state.v).max())
    unweighted = _inverse_root_mass(scene)
    for _ in range(3):  # one solve closes it; further ones only remove the rounding of the first
        rates = constraints.velocity(state.x[None], state.R[None], state.v[None], state.w[None])[0]
        if _at_rounding(constraints, rates, size, float(np.abs(state.w).max())):
            break
        scaled = constraints.sparse_jacobian(state.x, state.R) @ unweighted
        nearest = (least_norm(scaled, -rates) if scene.n > _LARGE
                   else np.linalg.lstsq(scaled.toarray(), -rates, rcond=RANK_TOLERANCE)[0])
        change = (unweighted @ nearest).reshape(-1, 6)
        state = dataclasses.replace(state, v=state.v + change[:, :3], w=state.w + change[:, 3:])
    return state


def _at_rounding(constraints: Constraints, rows: np.ndarray, length: float, number: float = 1.0) -> bool:
    """Whether all rows lie within 50 eps of the size of their terms."""
    sizes = np.where(constraints.dimensionless, number, length)
    return bool(np.all(np.abs(rows) <= 50 * np.finfo(float).eps * sizes))


def _length_scale(scene: Scene, state: Configuration) -> float:
    rods = [joint.length for joint in scene.joints if joint.length is not None]
    found: float = max(anchor_length(scene), float(np.abs(state.x).max()), *rods)
    return found


def _moved(state: Configuration, steps: np.ndarray) -> Configuration:
    """The state after translations in the world and rotations in body axes, (..., n, 6)."""
    q = quaternion_product(state.q, quaternion_from_turn(steps[..., 3:]))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    return dataclasses.replace(state, x=state.x + steps[..., :3], q=q)


def _right_tangents(theta: np.ndarray) -> np.ndarray:
    """J (..., 3, 3) with exp(hat(theta + d)) = exp(hat(theta)) exp(hat(J d)) to first order in d, theta (..., 3)."""
    hat = cross(theta[..., None, :], np.eye(3)).swapaxes(-1, -2)
    angle = np.linalg.norm(theta, axis=-1)[..., None, None]
    small = angle < 0.1  # the closed forms cancel; the series are right to 1e-10, in an iteration that corrects itself
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1 / 2 - angle**2 / 24 + angle**4 / 720, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle**2 / 120 + angle**4 / 5040, (safe - np.sin(safe)) / safe**3)
    found: np.ndarray = np.eye(3) - first * hat + second * hat @ hat
    return found
