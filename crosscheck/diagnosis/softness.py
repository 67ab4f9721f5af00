"""Soft joints: whether they open, and by forces that follow a law of the opening."""

from __future__ import annotations

import numpy as np

from crosscheck.diagnosis import fit
from crosscheck.diagnosis.observe import REACH
from crosscheck.diagnosis.physics import Terms, of_scene
from crosscheck.diagnosis.shown import FAITHFUL, Shown, points_of
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints

LAWFUL = 0.95
"""Least part of constraint forces or accelerations that a linear law of the opening has to reproduce."""


def gives_way(shown: Shown, absent: int | None) -> bool:
    """Whether joints are closed at the start and open in the limit of small steps, as if springs held them."""
    scene, scale, states = shown.observation.scene, shown.observation.scale, shown.states
    constraints = Constraints(scene)
    rows = constraints.rows_without(absent)
    if not rows.size:
        return False
    gaps = np.abs(constraints.position(states.x, states.R)[:, rows]) / scale.length
    limit = FAITHFUL + fit.EXPLAINED * shown.observation.noise
    opening = float(gaps.max())
    return bool(gaps[0].max() <= limit < opening)


def lawful(shown: list[Shown], absent: int | None) -> bool:
    """Whether constraint forces, or accelerations, are linear in Phi and G u, with constants of their own per row."""
    columns: list[list[np.ndarray]] = [[], [], [], []]
    for each in shown:
        scene, scale = each.observation.scene, each.observation.scale
        constraints = Constraints(scene)
        if constraints.m != Constraints(shown[0].observation.scene).m:
            continue
        inner = slice(REACH, len(each.states.t) - REACH)
        x, R, v, w = (getattr(each.states, name)[inner] for name in ("x", "R", "v", "w"))
        a, alpha = each.accelerations[:, :, :3], each.accelerations[:, :, 3:]
        points, _ = points_of([(0, each)], 1)
        physics = of_scene(scene)
        effort = Terms(scene, points, each.forces).forces(physics).reshape(len(x), -1)
        mass = np.linalg.inv(mechanics.inverse_mass(scene))
        G = constraints.jacobian(x, R)
        left = effort - np.concatenate([a, alpha], axis=2).reshape(len(x), -1) @ mass
        lam = np.array([np.linalg.lstsq(one.T, row, rcond=1e-9)[0] for one, row in zip(G, left, strict=True)])
        rows = constraints.rows_without(absent)
        for column, values in zip(columns, (constraints.position(x, R) / scale.length, constraints.velocity(
                x, R, v, w) / (scale.length * scale.rate), lam, constraints.acceleration(x, R, v, w, a, alpha)),
                strict=True):
            column.append(values[:, rows])
    gaps, speeds, lam, accelerations = (np.concatenate(column) for column in columns)
    return max(_linear(gaps, speeds, lam), _linear(gaps, speeds, accelerations)) >= LAWFUL


def _linear(gaps: np.ndarray, speeds: np.ndarray, answers: np.ndarray) -> float:
    """Part of the answers (P, m) that is linear in gaps and speeds of the same row."""
    left = 0.0
    for row in range(answers.shape[1]):
        design = np.column_stack([gaps[:, row], speeds[:, row]])
        factors = np.linalg.lstsq(design, answers[:, row], rcond=None)[0]
        left += float(np.sum((answers[:, row] - design @ factors) ** 2))
    return 1.0 - left / max(float(np.sum(answers**2)), 1e-300)


def opening(shown: Shown, absent: int | None) -> str:
    """The largest opening of joints, in words."""
    scene, states, constraints = shown.observation.scene, shown.states, Constraints(shown.observation.scene)
    gaps = np.abs(constraints.position(states.x, states.R)[:, constraints.rows_without(absent)])
    return f"joints open to {gaps.max():.3g} m within {scene.duration:.3g} s at vanishing steps"
