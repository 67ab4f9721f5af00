"""Joints that hold elsewhere, follow another joint otherwise, or give way: fitted to the motion that an engine shows.

The point of a joint moves with both bodies: v + R (w x s) is the same on either side, and is linear in the anchors s.
Its axes keep the joint's own rows closed. Fitted anchors, axes and mimics are a cause only if the accelerations are
those of the scene with its joints so altered.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterable

import numpy as np

from crosscheck.diagnosis import fit
from crosscheck.diagnosis.copies import ObservedCopy, data, points_of
from crosscheck.diagnosis.observe import REACH
from crosscheck.diagnosis.result import Evidence, Explanation, NamedCause
from crosscheck.scene import mechanics
from crosscheck.scene.alterations import GONE
from crosscheck.scene.altered import Accelerations, of_scene
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import histories
from crosscheck.scene.model import GROUND, Joint, Mimic, Scene
from crosscheck.scene.starts import ALLOWED_VIOLATION
from crosscheck.scene.vectors import cross

SIDES = (("child_anchor",), ("parent_anchor",), ("child_anchor", "parent_anchor"))
AXES = (("child_axis",), ("parent_axis",), ("child_axis", "parent_axis"))

Moves = dict[str, np.ndarray]
"""Displacements (m) of the anchors of one joint and changes of its axes, in the axes of their bodies."""


def altered_joints(copies: list[ObservedCopy], scenes: Iterable[Scene]) -> float:
    """The largest difference of accelerations over its noise from those of other scenes."""
    return data([dataclasses.replace(each, observation=dataclasses.replace(each.observation, scene=scene))
                 for each, scene in zip(copies, scenes, strict=True)]).before


def elsewhere(copies: list[ObservedCopy], answer: Explanation) -> bool:
    """Whether the motion is that of joints at other points or about other axes, which is named."""
    answer.tried += bool(copies[0].observation.scene.joints)
    scene = copies[0].observation.scene
    worst, every = 0.0, [dict[int, Moves]() for _ in copies]
    for k, joint in enumerate(scene.joints):
        fits = [(every, fitted_anchors(copies, k))] if joint.kind.anchors_coincide else []
        if joint.kind.axes in ("parallel", "perpendicular"):  # an engine may take the axis in a body from its start
            fits += [([moves], fitted_axes(each, k)) for moves, each in zip(every, copies, strict=True)
                     if each.observation.scene.joints[k].type == joint.type]
        for places, (before, fields) in fits:
            worst = max(worst, before)
            if fields is None:
                return False
            for moves in places if fields else ():
                moves[k] = moves.get(k, {}) | fields
    if not any(every):
        return False
    left = altered_joints(copies, (moved(each.observation.scene, moves) for each, moves in zip(
        copies, every, strict=True)))
    said: dict[str, list[str]] = {}
    for k, fields in next(filter(None, every)).items():
        for field, d in fields.items():
            side, what = field.split("_")
            off = (f"off by ({', '.join(f'{value:.5g}' for value in d)}) m" if what == "anchor" else
                   f"turned by {np.degrees(2 * np.arcsin(0.5 * np.linalg.norm(d))):.5g} deg")
            said.setdefault({"anchor": "anchors", "axis": "joint axis"}[what], []).append(
                f"joint {scene.joints[k].name!r}: {side}'s {what} {off}")
    right = altered_joints(copies, (each.observation.scene for each in copies))
    holds = left <= min(fit.EXPLAINED, fit.CLEAR * right)
    answer.evidence.append(Evidence(
        " and ".join(said), "model", worst, left, "speed at which joints open, then accelerations with the fitted "
        "joints, over their noise", "; ".join(itertools.chain(*said.values())), holds))
    answer.causes += [NamedCause(name, "; ".join(texts), "check the anchors and axes that the engine is given, and the "
                                 "point of the body that it takes for the centre of mass")
                      for name, texts in said.items() if holds]
    return holds


def moved(scene: Scene, moves: dict[int, Moves]) -> Scene:
    """The scene with these anchors and axes moved, where a copy has them. Its bodies stay where they are."""
    joints: list[Joint] = list(scene.joints)
    for k, fields in moves.items():
        joints[k] = dataclasses.replace(joints[k], **{field: getattr(joints[k], field) + d for field, d in
                                                      fields.items() if getattr(joints[k], field) is not None})
    return scene.replace(joints=tuple(joints))


def fitted_axes(copy: ObservedCopy, k: int) -> tuple[float, Moves | None]:
    """(gap over its noise by which the k-th joint leaves its axes, the fewest moved axes that it keeps to, or None)."""
    scene, scale, s = copy.observation.scene, copy.observation.scale, copy.states
    joint = scene.joints[k]
    noise = (ALLOWED_VIOLATION + fit.EXPLAINED * copy.observation.noise) * max(1.0, scale.length)
    bases = {field: np.linalg.svd(getattr(joint, field)[None])[2][1:] for field in AXES[2]}

    def fields(sides: tuple[str, ...], theta: np.ndarray) -> Moves:
        tilted = {side: getattr(joint, side) + part @ bases[side] for side, part in zip(
            sides, np.split(theta, len(sides)), strict=True)}
        return {side: axis / np.linalg.norm(axis) - getattr(joint, side) for side, axis in tilted.items()}

    def leaving(sides: tuple[str, ...], theta: np.ndarray) -> np.ndarray:
        rows = Constraints(moved(scene, {k: fields(sides, theta)} if sides else {}))
        speeds, gaps = rows.velocity(s.x, s.R, s.v, s.w, s.t), rows.position(s.x, s.R, s.t)
        return np.concatenate([speeds / scale.rate, gaps])[:, rows.rows[joint.name]].ravel() / noise

    before = float(np.abs(leaving((), np.zeros(0))).max(initial=0.0))
    if before <= 1.0:
        return before, {}
    for sides in AXES:
        theta = fit.gauss_newton(functools.partial(leaving, sides), np.zeros(2 * len(sides)))
        if float(np.abs(leaving(sides, theta)).max()) <= min(1.0, fit.CLEAR * before):
            return before, fields(sides, theta)
    return before, None


def fitted_anchors(copies: list[ObservedCopy], k: int) -> tuple[float, Moves | None]:
    """(speed over its noise at which the k-th joint opens, the fewest moved anchors that keep it closed, or None).

    A joint may open at a constant speed of its own in every copy.
    """
    from scipy.linalg import block_diag

    rows: dict[str, list[np.ndarray]] = {"child_anchor": [], "parent_anchor": []}
    gaps, starts = [], []
    for each in copies:
        scene, scale, states = each.observation.scene, each.observation.scale, each.states
        joint, noise = scene.joints[k], ALLOWED_VIOLATION + fit.EXPLAINED * each.observation.noise
        gap = np.zeros((len(states.t), 3))
        for sign, body, side in ((1.0, joint.child, "child_anchor"), (-1.0, joint.parent, "parent_anchor")):
            if body == GROUND:
                continue
            turning = sign * cross(states.R[:, body], states.w[:, body, None])  # R hat(w), row by row
            gap += sign * states.v[:, body] + turning @ getattr(joint, side)
            rows[side].append(turning.reshape(-1, 3) / (noise * scale.length * scale.rate))
        gaps.append(gap.ravel() / (noise * scale.length * scale.rate))
        starts.append(np.tile(np.eye(3), (len(gap), 1)) / (noise * scale.length * scale.rate))
    opening = np.concatenate(gaps)
    before = float(np.abs(opening).max())
    if before <= 1.0:
        return before, {}
    constant = block_diag(*starts)
    for kept, sides in itertools.product((False, True), SIDES):
        if all(rows[side] for side in sides):
            columns = [np.concatenate(rows[side]) for side in sides] + ([constant] if kept else [])
            design = np.column_stack(columns)
            shifts = np.linalg.lstsq(design, -opening, rcond=1e-9)[0]
            if float(np.abs(opening + design @ shifts).max()) <= min(1.0, fit.CLEAR * before):
                return before, {side: shifts[3 * place:3 * place + 3] for place, side in enumerate(sides)}
    return before, None


# --- mimics -----------------------------------------------------------------------------------------------------------



def mimics(copies: list[ObservedCopy], answer: Explanation) -> bool:
    """Whether the motion is that of other mimics, which are named."""
    causes: list[NamedCause] = []
    altered: dict[str, Mimic | None] = {}
    worst = 0.0
    for joint in copies[0].observation.scene.joints:
        if joint.mimic is None:
            continue
        before, altered[joint.name] = fitted_mimic(copies, joint, joint.mimic)
        worst = max(worst, before)
        if before > 1.0:
            causes.append(_named_mimic(joint.name, joint.mimic, altered[joint.name]))
    if not causes:
        return False
    left = altered_joints(copies, (each.observation.scene.replace(joints=tuple(
        joint if joint.mimic is None else dataclasses.replace(joint, mimic=altered[joint.name])
        for joint in each.observation.scene.joints)) for each in copies))
    holds = left <= fit.EXPLAINED
    answer.tried += 1
    answer.evidence.append(Evidence(
        "mimic", "model", worst, left, "gap of the joints that follow others, then accelerations with their mimics so "
        "altered, over their noise", "; ".join(cause.magnitude for cause in causes), holds))
    answer.causes += causes if holds else []
    return holds


def fitted_mimic(copies: list[ObservedCopy], joint: Joint, mimic: Mimic) -> tuple[float, Mimic | None]:
    """(largest gap of the joint over its noise, the mimic that it shows). The mimic is None if no ratio fits."""
    gaps, rates, turns = [], [], []
    for each in copies:
        scene, scale = each.observation.scene, each.observation.scale
        if all(other.name != joint.name or other.mimic is None for other in scene.joints):
            continue
        moved = histories(scene, each.states)
        follower, leader = moved[joint.name], moved[mimic.joint]
        size = scale.length if joint.kind.slides else 1.0
        noise = size * (ALLOWED_VIOLATION + fit.EXPLAINED * each.observation.noise) * (1.0 + abs(mimic.ratio))
        gaps.append((follower.position - mimic.ratio * leader.position - mimic.offset) / noise)
        rates.append(np.column_stack([follower.velocity, leader.velocity]) / (noise * scale.rate))
        turns.append((follower.position, leader.position))
    speed, leading = np.concatenate(rates).T
    gap = max(float(np.abs(each).max()) for each in (*gaps, speed - mimic.ratio * leading))
    if gap <= 1.0:
        return gap, mimic
    ratio = float(speed @ leading / max(leading @ leading, 1e-300))
    ratio = next((value for value in (mimic.ratio, -mimic.ratio, 1 / mimic.ratio if mimic.ratio else 0.0)
                  if abs(ratio - value) <= GONE * abs(value)), ratio)
    if np.abs(speed - ratio * leading).max() > 1.0:
        return gap, None
    # If the ratio is another one, the offset is that of the start, whatever it is.
    offset = float(np.mean(turns[0][0] - ratio * turns[0][1]))
    return gap, dataclasses.replace(mimic, ratio=ratio, offset=offset)


def _named_mimic(name: str, mimic: Mimic, fitted: Mimic | None) -> NamedCause:
    mend = f"check the mimic of joint {name!r} that reaches the engine"
    if fitted is None:
        return NamedCause("missing mimic", f"joint {name!r} does not follow joint {mimic.joint!r}", mend)
    if fitted.ratio == mimic.ratio:
        return NamedCause("mimic offset", f"joint {name!r} follows joint {mimic.joint!r} with the offset "
                          f"{fitted.offset:.5g} in place of {mimic.offset:.5g}", mend)
    kind = {-mimic.ratio: "sign", 1 / mimic.ratio if mimic.ratio else 0.0: "direction"}.get(fitted.ratio, "ratio")
    return NamedCause(f"mimic {kind}", f"joint {name!r} follows joint {mimic.joint!r} with the ratio "
                      f"{fitted.ratio:.5g} in place of {mimic.ratio:.5g}", mend)


# --- softness ---------------------------------------------------------------------------------------------------------


LAWFUL = 0.95
"""Least part of constraint forces or accelerations that a linear law of the opening has to reproduce."""


def gives_way(copy: ObservedCopy, absent: int | None) -> bool:
    """Whether joints are closed at the start and open in the limit of small steps, as if springs held them."""
    scene, scale, states = copy.observation.scene, copy.observation.scale, copy.states
    constraints = Constraints(scene)
    rows = constraints.rows_without(absent)
    if not rows.size:
        return False
    gaps = np.abs(constraints.position(states.x, states.R)[:, rows]) / scale.length
    limit = ALLOWED_VIOLATION + fit.EXPLAINED * copy.observation.noise
    opening = float(gaps.max())
    return bool(gaps[0].max() <= limit < opening)


def lawful(copies: list[ObservedCopy], absent: int | None) -> bool:
    """Whether constraint forces, or accelerations, are linear in Phi and G u, with constants of their own per row."""
    columns: list[list[np.ndarray]] = [[], [], [], []]
    for each in copies:
        scene, scale = each.observation.scene, each.observation.scale
        constraints = Constraints(scene)
        if constraints.m != Constraints(copies[0].observation.scene).m:
            continue
        inner = slice(REACH, len(each.states.t) - REACH)
        x, R, v, w = (getattr(each.states, name)[inner] for name in ("x", "R", "v", "w"))
        a, alpha = each.accelerations[:, :, :3], each.accelerations[:, :, 3:]
        effort = Accelerations(points_of(each)).forces(of_scene(scene)).reshape(len(x), -1)
        mass = mechanics.mass_matrix(scene)
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


def opening(copy: ObservedCopy, absent: int | None) -> str:
    """The largest opening of joints, in words."""
    scene, states, constraints = copy.observation.scene, copy.states, Constraints(copy.observation.scene)
    gaps = np.abs(constraints.position(states.x, states.R)[:, constraints.rows_without(absent)])
    return f"joints open to {gaps.max():.3g} m within {scene.duration:.3g} s at vanishing steps"
