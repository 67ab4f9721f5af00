"""The data for the figures of the report: packed curves of truth and of runs, and the geometry of a scene."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

from crosscheck.compare.errors import Error, up_to
from crosscheck.document import LEVELS, extended
from crosscheck.document.curves import (
    PACKED_MISSING,
    PACKED_STEPS,
    Curve,
    Drawing,
    DrawnBody,
    DrawnJoint,
    Motion,
    Packed,
    Reaction,
    RunCurves,
    SceneCurves,
)
from crosscheck.references.base import Reference
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.model import GROUND, Scene

MANY = 150
"""Logarithmic curves with more values keep every second time, with the larger one of two values. Such curves vary by
decades within the width of a dot, and only their height matters."""
DIGITS = 4
"""Significant digits of the geometry, enough for a drawing."""
DENSE_BODIES = 16
"""Up to this number of bodies, true reactions are drawn, whose cost is cubic in the bodies, and poses of runs are
packed as exact differences from truth, so that a picture can magnify errors. Else pages would be too large."""


def pack(values: np.ndarray, log: bool = False, truth: np.ndarray | None = None, over: bool = False) -> Curve:
    """One packed curve (T,), or the word "truth" if it looks the same as `truth` (T,).

    With `over`, the differences from `truth` are packed.
    """
    values = np.asarray(values, dtype=float)
    over = over and truth is not None and truth.shape == values.shape
    if truth is not None and over:
        values = values - truth
    elif truth is not None and truth.shape == values.shape:
        known = np.isfinite(truth)
        span = float(np.ptp(truth[known])) if known.any() else 0.0
        if np.array_equal(np.isfinite(values), known) and np.abs(values - truth)[known].max(
                initial=0.0) <= 2 * span / PACKED_STEPS:
            return "truth"
    good = np.isfinite(values) & ((values > 0) | (not log))
    scaled = np.log10(values, out=np.zeros_like(values), where=good) if log else np.where(good, values, 0.0)
    if not good.any():
        lo = hi = 0.0
    else:
        lo, hi = (float(f"{value:.9g}") for value in (scaled[good].min(), scaled[good].max()))
    if not log and good.all() and lo == hi:
        return Packed(lo, hi, n=len(values), over=over)
    codes = np.full(len(values), PACKED_MISSING, dtype="<u2")
    # In logarithmic curves the integer 0 stands for zero.
    codes[good] = np.rint((scaled[good] - lo) / (hi - lo or 1.0) * (PACKED_STEPS - 1)).clip(0, PACKED_STEPS - 1) + 1
    if log:
        codes[values == 0] = 0
    return Packed(lo, hi, base64.b64encode(codes.tobytes()).decode("ascii"), log=log, over=over)


def scene_curves(scene: Scene, reference: Reference | None) -> SceneCurves:
    """Output times, geometry, and the true motion if there is truth."""
    motion = Motion() if reference is None else _packed(_true_motion(scene, reference))
    return extended(SceneCurves, motion, t=[float(f"{time:.6g}") for time in scene.t],
                    drawing=drawing(scene, reference))


def run_curves(scene: Scene, traj: Trajectory, errors: Mapping[str, Error], reference: Reference | None) -> RunCurves:
    """Curves of one run at the scene's output times. Long curves of errors are thinned, see `MANY`."""
    true = None if reference is None else _true_motion(scene, reference)
    own = _motion(scene, traj, traj.reactions, true)
    with np.errstate(over="ignore", invalid="ignore"):  # a diverged run has such values; they become gaps
        # Compare with the true energy and momentum, as loads and dampers change them; without truth with the start.
        total, momentum, kinetic = ((true or own)[name] for name in ("total", "momentum", "kinetic"))
        if true is None:
            total, momentum = total[:1], momentum[:1]
        levels = {f"constraint_{level}": None if values is None else _log(values) for level in LEVELS
                  for values in [getattr(traj, f"constraint_{level}")]}
        return extended(
            RunCurves, _packed(own if reference is None else _until(own, reference), true),
            errors={name: _log(error.series) for name, error in errors.items()},
            energy=_log(np.abs(traj.energy - total) / (np.nanmax(kinetic) or 1.0)),
            momentum_error=_log(np.abs(traj.momentum_vertical - momentum)),
            orthogonality=_log(traj.orthogonality), **levels)


def _log(values: np.ndarray) -> Curve:
    if len(values) > MANY and len(values) % 2:
        values = np.concatenate([values[:1], np.maximum(values[1::2], values[2::2])])
    return pack(values, log=True)


def drawing(scene: Scene, reference: Reference | None = None) -> Drawing:
    """Geometry for a picture, in the frames of the scene file."""
    w = scene.w0[None] if reference is None else reference.states.w
    spacing = scene.duration / max(1, scene.samples - 1)
    joints = [DrawnJoint(joint.name, joint.type, joint.parent, joint.child, _rounded(joint.parent_anchor),
                         _rounded(joint.child_anchor), _rounded(joint.parent_axis), _rounded(joint.child_axis))
              for joint in scene.joints]
    forces = [{"type": force.type, "parent": force.parent, "child": force.child, "joint": force.joint,
               **{key: _rounded(value) if isinstance(value, tuple | list) else
                  "a function of time," if isinstance(value, TimeFunction) else value
                  for key, value in force.parameters.items()}} for force in scene.loads]
    bodies = []
    for body in scene.bodies:  # as boxes of uniform density; bit k of a corner's index tells its side of axis k
        moments, axes = np.linalg.eigh(body.inertia)
        edges = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / (body.mass or 1.0), 0.0))
        signs = np.array([[1.0 if corner >> axis & 1 else -1.0 for axis in range(3)] for corner in range(8)])
        bodies.append(DrawnBody(body.name, body.mass, [_rounded(axes @ (sign * edges / 2)) for sign in signs]))
    return Drawing(_rounded(scene.gravity), joints, forces, GROUND, bodies,
                   float(f"{np.linalg.norm(w, axis=-1).max() * spacing:.{DIGITS}g}"))


def _motion(scene: Scene, states: Any, reactions: Mapping[str, tuple[np.ndarray, np.ndarray]] | None,
            true: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Curves before packing: x (n, 3, T), q (n, 4, T), energies and momentum (T,); of joints force, torque (3, T).

    Signs of quaternions are those of the true ones.
    """
    kinetic, total = mechanics.kinetic_energy(scene, states), mechanics.energy(scene, states)
    # A torque below 1e-12 of the force is rounding: the joint carries none.
    carried = {joint: {"force": force.T} | ({"torque": torque.T} if np.abs(torque).max(initial=0.0) > 1e-12
                                             * np.abs(force).max(initial=0.0) else {})
               for joint, (force, torque) in (reactions or {}).items()}
    return {"x": np.moveaxis(states.x, 0, -1), "q": quaternions(states.R, None if true is None else true["q"]),
            "kinetic": kinetic, "potential": total - kinetic, "total": total,
            "momentum": mechanics.momentum_vertical(scene, states), "reactions": carried}


def _until(values: Any, reference: Reference) -> Any:
    """The curves with NaN after the horizon of truth, where nothing is known, nor compared."""
    if isinstance(values, dict):
        return {name: _until(each, reference) for name, each in values.items()}
    return np.where(up_to(reference.t, reference.horizon), values, np.nan)


def _packed(curves: Mapping[str, Any], true: Mapping[str, Any] | None = None) -> Motion:
    """All curves packed, relative to those of truth if there are any."""
    few = len(curves["x"]) <= DENSE_BODIES
    made = {name: _nested(values, (true or {}).get(name), few and name in ("x", "q"))
            for name, values in curves.items()}
    return Motion(**made | {"reactions": {
        joint: Reaction(**own) for joint, own in made["reactions"].items()} or None})


def _nested(values: Any, truth: Any = None, over: bool = False) -> Any:
    """A packed curve, or lists and dictionaries of packed curves."""
    if isinstance(values, dict):
        return {name: _nested(each, (truth or {}).get(name)) for name, each in values.items()}
    if values.ndim == 1:
        return pack(values, truth=truth, over=over)
    return [_nested(row, None if truth is None else truth[index], over) for index, row in enumerate(values)]


def _true_motion(scene: Scene, reference: Reference) -> dict[str, Any]:
    constraints, s = Constraints(scene), reference.states
    reactions = None
    if constraints.m and scene.n <= DENSE_BODIES:
        lam = mechanics.index1(scene, s.x, s.R, s.v, s.w, mechanics.torsion_angles(scene, s), s.t)[2]
        reactions = constraints.reactions(s.x, s.R, lam)
    known: dict[str, Any] = _until(_motion(scene, s, reactions), reference)
    return known


def quaternions(R: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
    """Quaternions w, x, y, z, (n, 4, T), of attitudes (T, n, 3, 3), with signs such that they do not jump.

    `near` (n, 4, T) are the quaternions of truth. They determine the signs at the start.
    """
    from scipy.spatial.transform import Rotation

    shape = R.shape[:2]
    flat = R.reshape(-1, 3, 3)
    good = np.isfinite(flat).all(axis=(1, 2))
    good[good] = np.linalg.det(flat[good]) > 0  # other matrices have no quaternion
    result = np.full((len(flat), 4), np.nan)
    if good.any():
        result[good] = Rotation.from_matrix(flat[good]).as_quat(scalar_first=True)
    result = np.moveaxis(result.reshape(*shape, 4), 0, -1)
    steps = np.einsum("nkt,nkt->nt", result[:, :, 1:], result[:, :, :-1])
    start = np.sign(result[:, 0, :1]) if near is None else np.sign(np.einsum("nk,nk->n", result[:, :, 0],
                                                                            near[:, :, 0]))[:, None]
    signs = np.concatenate([np.where(start < 0, -1.0, 1.0), np.where(steps < 0, -1.0, 1.0)], axis=1)
    return result * np.cumprod(signs, axis=1)[:, None, :]


def _rounded(vector: Any) -> Any:
    return None if vector is None else [float(f"{value:.{DIGITS}g}") for value in vector]
