"""What the report draws: curves of truth and of runs, packed for a page, and the geometry of a scene.

A packed curve is a dictionary. "lo", "hi" and "q": little-endian 16-bit integers in base64, of which 1 to
`PACKED_STEPS` stand for equally spaced values from lo to hi; with "log" true, lo and hi are decimal logarithms and 0
stands for zero. `PACKED_MISSING` stands for a value that is not finite. A curve whose values are all equal has "n" (how
many) in place of "q". The word "truth" in place of a curve says: the true one, to within two such spaces.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

from crosscheck.document import PACKED_MISSING, PACKED_STEPS, Curves
from crosscheck.judge.metrics import Error
from crosscheck.references.base import Reference
from crosscheck.scene import mechanics
from crosscheck.scene.model import GROUND, Scene

MANY = 150
"""Curves on a logarithmic scale with more values keep every second time, with the larger of its value and the one
before: they wander over decades within a dot's width, and what matters is how high they rise."""
DIGITS = 4
"""Significant digits of the geometry: a drawing shows no more."""
DENSE_BODIES = 16
"""Up to so many bodies the true reactions are drawn too: they come from dense algebra, cubic in the bodies."""

Packed = dict[str, Any] | str | None


def pack(values: np.ndarray, log: bool = False, truth: np.ndarray | None = None) -> Packed:
    """One curve (T,) in the form of this module; the word "truth" where it cannot be told from `truth` (T,)."""
    values = np.asarray(values, dtype=float)
    if truth is not None and truth.shape == values.shape:
        span = float(np.ptp(truth))
        if np.isfinite(values).all() and np.abs(values - truth).max(initial=0.0) <= 2 * span / PACKED_STEPS:
            return "truth"
    good = np.isfinite(values) & ((values > 0) | (not log))
    scaled = np.log10(values, out=np.zeros_like(values), where=good) if log else np.where(good, values, 0.0)
    if not good.any():
        lo = hi = 0.0
    else:
        lo, hi = (float(f"{value:.9g}") for value in (scaled[good].min(), scaled[good].max()))
    if not log and good.all() and lo == hi:
        return {"lo": lo, "hi": hi, "n": len(values)}
    codes = np.full(len(values), PACKED_MISSING, dtype="<u2")
    # Logarithmic curves keep the integer 0 for zero itself.
    codes[good] = np.rint((scaled[good] - lo) / (hi - lo or 1.0) * (PACKED_STEPS - 1)).clip(0, PACKED_STEPS - 1) + 1
    if log:
        codes[values == 0] = 0
    packed = {"lo": lo, "hi": hi, "q": base64.b64encode(codes.tobytes()).decode("ascii")}
    return packed | {"log": True} if log else packed


def scene_curves(scene: Scene, reference: Reference | None) -> Curves:
    """Output times (s), geometry and, where there is truth, its motion, energies (J), momentum and reactions."""
    times = [float(f"{time:.6g}") for time in scene.t]
    found: dict[str, Any] = {"t": times, "drawing": drawing(scene, reference)}
    if reference is None:
        return found
    series = _series(scene, reference.states, _true_reactions(scene, reference))
    return found | {key: _packed(values) for key, values in series.items()}


def run_curves(scene: Scene, traj: Any, errors: Mapping[str, Error], reference: Reference | None) -> Curves:
    """Curves of one run at the scene's output times.

    Keys as in `scene_curves`, and on a logarithmic scale, see `MANY`, "errors" per quantity, "energy" (the error over
    the largest kinetic energy), "momentum error" (kg m^2/s), "orthogonality" and "constraint" with each level.
    """
    exact = traj if reference is None else reference.states
    true = {} if reference is None else _series(scene, exact, _true_reactions(scene, reference))
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged has such values, and shows them as gaps
        return _run_curves(scene, traj, errors, reference, exact, true)


def _run_curves(scene: Scene, traj: Any, errors: Mapping[str, Error], reference: Reference | None, exact: Any,
                true: dict[str, Any]) -> Curves:
    series = _series(scene, traj, traj.reactions, true.get("q"))
    # Against the true energy and momentum, which loads and dampers change; without truth against those of the start.
    energy = traj.energy[:1] if reference is None else mechanics.energy(scene, exact)
    momentum = traj.momentum_vertical[:1] if reference is None else true["momentum"]
    found = {key: _packed(values, true.get(key)) for key, values in series.items()}
    found["errors"] = {name: _log(error.series) for name, error in errors.items()}
    found["energy"] = _log(np.abs(traj.energy - energy) / (mechanics.kinetic_energy(scene, exact).max() or 1.0))
    found["momentum error"] = _log(np.abs(traj.momentum_vertical - momentum))
    found["orthogonality"] = _log(traj.orthogonality)
    for level in ("position", "velocity", "acceleration"):
        values = getattr(traj, f"constraint_{level}")
        found[f"constraint {level}"] = None if values is None else _log(values)
    return found


def _log(values: np.ndarray) -> Packed:
    if len(values) > MANY and len(values) % 2:
        values = np.concatenate([values[:1], np.maximum(values[1::2], values[2::2])])
    return pack(values, log=True)


def drawing(scene: Scene, reference: Reference | None = None) -> Curves:
    """Geometry for a picture: boxes, joints, springs and loads, in m; points and axes in the frames of the scene file.

    The box of a body is the one of uniform density that has its mass and inertia; "turn" is the largest angle (rad)
    that a body turns between two output times, pi and more of which no playback can show.
    """
    w = scene.w0[None] if reference is None else reference.states.w
    spacing = scene.duration / max(1, scene.samples - 1)
    joints = [{"name": joint.name, "type": joint.type, "parent": joint.parent, "child": joint.child,
               **{field: _rounded(getattr(joint, field))
                  for field in ("parent_anchor", "child_anchor", "parent_axis", "child_axis")}}
              for joint in scene.joints]
    forces = [{"type": force.type, "parent": force.parent, "child": force.child, "joint": force.joint,
               **{key: _rounded(value) if isinstance(value, tuple | list) else value
                  for key, value in force.parameters.items()}} for force in scene.forces]
    return {"gravity": _rounded(scene.gravity), "joints": joints, "forces": forces, "ground": GROUND,
            "bodies": [{"name": body.name, "mass": body.mass, "corners": _corners(body.mass, body.inertia)}
                       for body in scene.bodies],
            "turn": float(f"{np.linalg.norm(w, axis=-1).max() * spacing:.{DIGITS}g}")}


def _corners(mass: float, inertia: np.ndarray) -> list[Any]:
    """The eight corners (m, body axes) of the equivalent box; bit k of a corner's number tells its side of axis k."""
    moments, axes = np.linalg.eigh(inertia)
    edges = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / mass, 0.0))
    signs = np.array([[1.0 if corner >> axis & 1 else -1.0 for axis in range(3)] for corner in range(8)])
    return [_rounded(axes @ (sign * edges / 2)) for sign in signs]


def _series(scene: Scene, states: Any, reactions: Any, near: np.ndarray | None = None) -> Curves:
    """Curves before packing: x (n, 3, T), q (n, 4, T) quaternions w, x, y, z, energies, momentum, reactions."""
    kinetic, total = mechanics.kinetic_energy(scene, states), mechanics.energy(scene, states)
    found = {"x": np.moveaxis(states.x, 0, -1), "q": _quaternions(states.R, near), "kinetic": kinetic,
             "potential": total - kinetic, "total": total, "momentum": mechanics.momentum_vertical(scene, states)}
    if reactions:
        found["reactions"] = {joint: {"force": force.T, **({"torque": torque.T} if _carried(force, torque) else {})}
                              for joint, (force, torque) in reactions.items()}
    return found


def _carried(force: np.ndarray, torque: np.ndarray) -> bool:
    """Whether a joint carries torque, or only the rounding of a force times a lever: 1e-12 of it."""
    return bool(np.abs(torque).max(initial=0.0) > 1e-12 * np.abs(force).max(initial=0.0))


def _packed(values: Any, truth: Any = None) -> Any:
    """Every curve of nested arrays or dictionaries packed, next to that of truth where it has one."""
    if isinstance(values, dict):
        true = truth if isinstance(truth, dict) else {}
        return {key: _packed(each, true.get(key)) for key, each in values.items()}
    if values.ndim == 1:
        return pack(values, truth=truth)
    return [_packed(row, None if truth is None else truth[index]) for index, row in enumerate(values)]


def _true_reactions(scene: Scene, reference: Reference) -> Any:
    from crosscheck.scene.constraints import Constraints

    constraints, s = Constraints(scene), reference.states
    if constraints.m == 0 or scene.n > DENSE_BODIES:
        return None
    lam = mechanics.index1(scene, s.x, s.R, s.v, s.w, mechanics.torsion_angles(scene, s.R, s.w, s.t), s.t)[2]
    return constraints.reactions(s.x, s.R, lam)


def _quaternions(R: np.ndarray, near: np.ndarray | None = None) -> np.ndarray:
    """Quaternions w, x, y, z, (n, 4, T), of attitudes (T, n, 3, 3), their signs such that they do not jump.

    `near` (n, 4, T): quaternions of truth, which choose the sign at the start.
    """
    from scipy.spatial.transform import Rotation

    shape = R.shape[:2]
    flat = R.reshape(-1, 3, 3)
    good = np.isfinite(flat).all(axis=(1, 2))
    good[good] = np.linalg.det(flat[good]) > 0  # what has left the group altogether has no quaternion
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
