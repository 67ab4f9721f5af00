"""The initial state: computes open positions and velocities from the joints, and closes every joint to rounding level.

The correction is the smallest one in the metric of the mass matrix, with attitudes on SO(3).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.scene import starts
from crosscheck.scene.checks import Draft
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.mechanics import RANK_TOLERANCE, loose_frame, weights
from crosscheck.scene.model import GROUND, Scene, quaternion_from_turn, quaternion_product
from crosscheck.scene.schema import EntryError
from crosscheck.scene.spanning import Branch, spanning_tree
from crosscheck.scene.sparse import block_diagonal, least_norm
from crosscheck.scene.starts import ALLOWED_VIOLATION, Configuration, anchor_length, bodies_at
from crosscheck.scene.vectors import cross

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_UPRIGHT = 1 - 1e-9  # of the axis against the normal: 4e-5 rad, where derivatives of the lowest point are 1e5
_LARGE = 100  # bodies from which the algebra is sparse; dense, its time grows as their number cubed
_ITERATIONS = 400
_DIFFERENCE = 1e-5  # step in the weighted displacement: gives the Hessian to about 1e-10, enough to guide Newton
_STRAIGHT = 1e-4  # parts of the scene's length, and rad: curvature does not matter for smaller displacements
_LEAST_CURVATURE = 0.1  # relative to the curvature of the squared distance, which is 1
_SETTLED = 1e-12  # parts of the scene's length, and rad: far below the allowed violation, well above rounding
_BEFORE_DAMPING = 25  # iterations with full steps; most guesses converge within a dozen
_DAMPINGS = 4  # number of damping levels before full steps again, with which a search that left a saddle converges
_NEAR = 0.05  # parts of the scene's length, and rad: steps smaller than this converge without damping
_LARGEST_TURN = 0.5  # rad in one correction: for larger ones the chart of a rotation is far from linear


def completed(draft: Draft, keeping: Scene | None = None) -> Scene:
    """The scene with its whole initial state, joints closed to rounding level in position and velocity.

    Prismatic and fixed joints keep the relative attitudes of the scene `keeping`, by default those given.

    Raises
    ------
    EntryError
        Nothing determines a position, a given state violates the joints, the joints cannot close (the error names the
        one with the largest gap), or the two axes of a joint point in opposite directions.
    """
    scene = draft.scene
    state = Configuration(scene.x0, np.array([body.attitude for body in scene.bodies]), scene.v0, scene.w0)
    state, shifts = starts.attitudes(draft, state)
    scene = scene.replace(bodies=bodies_at(scene, state))
    draft = dataclasses.replace(draft, scene=scene)
    for index, joint in enumerate(scene.joints):
        if joint.radius is not None and joint.child_axis is not None and abs(
                joint.parent_axis @ scene.R0[joint.child] @ joint.child_axis) > _UPRIGHT:
            raise EntryError(f'joints[{index}] "{joint.name}"', "the disk lies flat on its plane, so that no point of "
                             "its rim is the lowest", f'tilt the attitude of "{scene.bodies[joint.child].name}"')
    constraints = Constraints(keeping or scene)  # before any correction
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
        # Opposite axes satisfy the rows of a joint too, but its angle then has the opposite sense for the child.
        if joint.kind.axes == "parallel" and (
                (R[joint.parent] @ joint.parent_axis) @ (R[joint.child] @ joint.child_axis) < 0):
            raise EntryError(f'joints[{index}] "{joint.name}": child_axis',
                             "points opposite to parent_axis in the world", "reverse one of the two, or correct the "
                             f'attitude of "{scene.bodies[joint.child].name}"')
    done = scene.replace(bodies=bodies_at(scene, state))
    if (loose := loose_frame(done)) is not None:
        raise EntryError(f'bodies[{loose}] "{scene.bodies[loose].name}": mass', "is 0, and here this frame can move "
                         "while all other bodies rest", "turn the axes of its joints apart, or give it a mass and an "
                         "inertia, or a joint of it an armature")
    if not draft.assemble:
        starts.check(draft, done)
    return done


def closed(scene: Scene, keeping: Scene | None = None) -> Scene | None:
    """The scene with its joints closed by the least change of its state; None if that fails.

    `keeping`: the scene whose relative attitudes prismatic and fixed joints keep, where this one has drifted from it.
    """
    given = (True,) * scene.n
    try:
        return completed(Draft(scene, given, given, assemble=True), keeping)
    except EntryError:
        return None


def projected(scene: Scene, moved: Scene) -> Scene:
    """`moved`, whose bodies have other states than those of `scene`, with the joints of `scene` closed.

    Positions and velocities of bodies on joints with coincident anchors follow from attitudes and angular velocities,
    outwards from the ground. The least mass-weighted change closes the remaining gaps.

    Raises
    ------
    EntryError
        The joints cannot be closed from there.
    """
    hung = {joint.child for joint in scene.joints if joint.kind.anchors_coincide}
    given = tuple(k not in hung for k in range(scene.n))
    state = Configuration(moved.x0, np.array([body.attitude for body in moved.bodies]), moved.v0, moved.w0)
    constraints = Constraints(scene)  # prismatic and fixed joints keep the relative attitude of the scene
    draft = Draft(moved, given, given, assemble=True)
    if any(branch.joint is None for branch in _tree(scene, given)):  # bodies that float keep their given positions
        draft = dataclasses.replace(draft, given_positions=(True,) * scene.n, given_velocities=(True,) * scene.n)
    state = _close_positions(constraints, _tree_positions(draft, state, {}))
    state = _close_velocities(constraints, _tree_velocities(draft, state, {}))
    return scene.replace(bodies=bodies_at(scene, state))


# --- open positions and velocities -----------------------------------------------------------------------------------


def _tree(scene: Scene, given: Sequence[bool]) -> list[Branch]:
    """The bodies whose state is not given, each with the joint that places it from a body that is placed already.

    Joints whose anchors coincide are used first, the others only if none of these reaches a further body.
    """
    roots = [body for body in range(scene.n) if given[body]]
    return spanning_tree(scene, lambda joint: int(joint.kind.anchors_coincide), roots)[0]


def _tree_positions(draft: Draft, state: Configuration, shifts: Mapping[str, np.ndarray]) -> Configuration:
    """Place the bodies without a position, outwards from the ground and from bodies that have one.

    If the joint does not fix the anchors to each other they are placed together too, which is the least distance it
    allows. On a distance joint the child's anchor hangs below the parent's, along gravity (along -z without gravity);
    the centre of a rolling disk or sphere is above its plane.
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
        if joint.radius is not None:
            across = 1.0 if joint.child_axis is None else np.linalg.norm(np.cross(R[joint.child] @ joint.child_axis,
                                                                                  joint.parent_axis))
            gap = gap + joint.radius * across * joint.parent_axis
        if joint.name in shifts:
            gap = gap + R[joint.parent] @ shifts[joint.name]
        x[body] = x[joint.parent] + gap if body == joint.child else x[joint.child] - gap
    return dataclasses.replace(state, x=x[:-1])


def _tree_velocities(draft: Draft, state: Configuration, speeds: Mapping[str, np.ndarray]) -> Configuration:
    """Velocities of the bodies without one: a joint's anchors do not move relative to each other in the parent's frame.

    In a group of bodies that no joint connects to the ground or to a given velocity, the first is at rest.
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

    The displacement of a body is (x - x_guess, theta) with R = R_guess exp(hat(theta)). Newton's method solves the
    conditions of the minimum, in the least-norm sense if rows are redundant. The curvature of the joints is computed by
    differences; a negative curvature enters with its absolute value, so that the search leaves saddles. Large scenes
    leave the curvature out: the iteration then converges to the same conditions, but only from nearby guesses.
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
        # From far away full steps may alternate between two states forever.
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
    """The same attitudes by rotations of half a turn at most; a longer turn is not the least displacement."""
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
    G[:, constraints.slips] = 0.0  # rows without positions
    return constraints.position(x, R), G.reshape(len(z), -1, 6 * n) @ unweighted


def _sparsely_linearised(constraints: Constraints, guess: Configuration, unweighted: csr_array,
                         z: np.ndarray) -> tuple[np.ndarray, csr_array]:
    """Phi (m,) and its derivative by z, sparse, at one weighted displacement z (6n,)."""
    displacements = (unweighted @ z).reshape(-1, 6)
    moved = _moved(guess, displacements)
    tangents = np.zeros((len(displacements), 6, 6))
    tangents[:, :3, :3] = np.eye(3)
    tangents[:, 3:, 3:] = _right_tangents(displacements[:, 3:])
    G = constraints.sparse_jacobian(moved.x[None], moved.R[None])
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
        for first in range(0, len(z), 6):  # body by body: all at once would need (6n)^2 m numbers
            shifts = _DIFFERENCE * np.eye(len(z))[first:first + 6]
            _, displaced = _linearised(constraints, guess, unweighted, np.concatenate([z + shifts, z - shifts]))
            bent = np.einsum("kmi,m->ki", displaced, lam)
            hessian[first:first + 6] += (bent[:6] - bent[6:]) / (2 * _DIFFERENCE)
    curvatures, directions = np.linalg.eigh(along @ (hessian + hessian.T) @ along.T / 2)
    slope = directions.T @ along @ (z + hessian @ closing)
    return np.asarray(closing - along.T @ (directions @ (slope / np.maximum(np.abs(curvatures), _LEAST_CURVATURE))))


def _inverse_root_mass(scene: Scene) -> csr_array:
    """B, (6n, 6n) block diagonal, with B^T M B = I."""
    masses, inertias = weights(scene)
    blocks = np.zeros((scene.n, 6, 6))
    blocks[:, :3, :3] = np.eye(3) / np.sqrt(masses)[:, None, None]
    blocks[:, 3:, 3:] = np.linalg.inv(np.linalg.cholesky(inertias)).swapaxes(1, 2)
    return block_diagonal(blocks)


def _close_velocities(constraints: Constraints, state: Configuration) -> Configuration:
    """The velocities nearest to the given ones, mass-weighted, with G u = 0."""
    scene = constraints.scene
    size = _length_scale(scene, state) * float(np.abs(state.w).max()) + float(np.abs(state.v).max())
    for _ in range(3):  # one solve closes the joints; the others remove its rounding errors
        rates = constraints.velocity(state.x[None], state.R[None], state.v[None], state.w[None])[0]
        if _at_rounding(constraints, rates, size, float(np.abs(state.w).max())):
            break
        unweighted = _inverse_root_mass(scene)
        scaled = constraints.sparse_jacobian(state.x[None], state.R[None]) @ unweighted
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
    length: float = max(anchor_length(scene), float(np.abs(state.x).max()), *rods)
    return length


def _moved(state: Configuration, steps: np.ndarray) -> Configuration:
    """The state after translations in the world and rotations in body axes, (..., n, 6)."""
    q = quaternion_product(state.q, quaternion_from_turn(steps[..., 3:]))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    return dataclasses.replace(state, x=state.x + steps[..., :3], q=q)


def _right_tangents(theta: np.ndarray) -> np.ndarray:
    """J (..., 3, 3) with exp(hat(theta + d)) = exp(hat(theta)) exp(hat(J d)) to first order in d, theta (..., 3)."""
    hat = cross(theta[..., None, :], np.eye(3)).swapaxes(-1, -2)
    angle = np.linalg.norm(theta, axis=-1)[..., None, None]
    small = angle < 0.1  # the closed forms cancel there; the series' error of 1e-10 is corrected by the iteration
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1 / 2 - angle**2 / 24 + angle**4 / 720, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle**2 / 120 + angle**4 / 5040, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) - first * hat + second * hat @ hat)
