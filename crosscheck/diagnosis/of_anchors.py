"""Joints at other points than the scene's: anchors fitted to the velocities of an engine.

The point of a joint moves with both bodies: v + R (w x s) is the same on either side, and is linear in the anchors s.
The fitted anchors are a cause only if the accelerations are those of joints at these points.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from crosscheck.diagnosis import fit
from crosscheck.diagnosis.misreadings import POINTS
from crosscheck.diagnosis.physics import of_scene
from crosscheck.diagnosis.result import Evidence, NamedCause
from crosscheck.diagnosis.shown import FAITHFUL, Shown, data
from crosscheck.scene.model import GROUND, Joint, Scene
from crosscheck.scene.vectors import cross

SIDES = (("child_anchor",), ("parent_anchor",), ("child_anchor", "parent_anchor"))

LEFT = 0.1
"""Share of the speed at which a joint opens that other anchors may leave. Where runs hardly converge, that speed is of
the size of its noise, and many anchors take a part of it away."""

Moves = dict[str, np.ndarray]
"""Displacements (m) of the anchors of one joint, in the axes of their bodies."""


def diagnose(shown: list[Shown], whole: Scene) -> tuple[NamedCause, Evidence] | None:
    """The cause if the motion is that of joints at other points. `whole` has every force that any copy has."""
    scene = shown[0].observation.scene
    if any(joint.type not in POINTS for joint in scene.joints):
        return None
    moves: dict[int, Moves] = {}
    worst = 0.0
    for k in range(len(scene.joints)):
        before, found = fitted(shown, k)
        worst = max(worst, before)
        if found is None:
            return None
        moves[k] = found
    moves = {k: found for k, found in moves.items() if found}
    if not moves:
        return None
    altered = [dataclasses.replace(each, observation=dataclasses.replace(each.observation, scene=moved(
        each.observation.scene, moves))) for each in shown]
    right = of_scene(whole, len(shown))
    left = float(np.abs(data(altered, right, False, 1).residual(right)).max())
    text = "; ".join(f"joint {scene.joints[k].name!r}: {side.replace('_anchor', '')}'s anchor off by "
                     f"({', '.join(f'{value:.5g}' for value in d)}) m" for k, found in moves.items()
                     for side, d in found.items())
    holds = left <= fit.EXPLAINED
    evidence = Evidence("anchors", "model", worst, left, "speed at which joints open, then accelerations with the "
                        "fitted anchors, over their noise", text, holds)
    return (NamedCause("anchors", text, "check the anchors that the engine is given, and the point of the body that it "
                       "takes for the centre of mass"), evidence) if holds else None


def moved(scene: Scene, moves: dict[int, Moves]) -> Scene:
    """The scene with these anchors moved. Its bodies stay where they are."""
    joints: list[Joint] = list(scene.joints)
    for k, found in moves.items():
        joints[k] = dataclasses.replace(joints[k], **{side: getattr(joints[k], side) + d for side, d in found.items()})
    return scene.replace(joints=tuple(joints))


def fitted(shown: list[Shown], k: int) -> tuple[float, Moves | None]:
    """(speed over its noise at which the k-th joint opens, the fewest moved anchors that keep it closed, or None).

    A joint may open at a constant speed of its own in every copy.
    """
    rows: dict[str, list[np.ndarray]] = {"child_anchor": [], "parent_anchor": []}
    gaps, copies = [], []
    for each in shown:
        scene, scale, states = each.observation.scene, each.observation.scale, each.states
        joint, noise = scene.joints[k], FAITHFUL + fit.EXPLAINED * each.observation.noise
        gap = np.zeros((len(states.t), 3))
        for sign, body, side in ((1.0, joint.child, "child_anchor"), (-1.0, joint.parent, "parent_anchor")):
            if body == GROUND:
                continue
            turning = sign * cross(states.R[:, body], states.w[:, body, None])  # R hat(w), row by row
            gap += sign * states.v[:, body] + turning @ getattr(joint, side)
            rows[side].append(turning.reshape(-1, 3) / (noise * scale.length * scale.rate))
        gaps.append(gap.ravel() / (noise * scale.length * scale.rate))
        copies.append(np.tile(np.eye(3), (len(gap), 1)) / (noise * scale.length * scale.rate))
    opening = np.concatenate(gaps)
    before = float(np.abs(opening).max())
    if before <= 1.0:
        return before, {}
    constant = np.zeros((len(opening), 3 * len(copies)))
    at = 0
    for number, block in enumerate(copies):
        constant[at:at + len(block), 3 * number:3 * number + 3] = block
        at += len(block)
    for kept, sides in itertools.product((False, True), SIDES):
        if all(rows[side] for side in sides):
            columns = [np.concatenate(rows[side]) for side in sides] + ([constant] if kept else [])
            design = np.column_stack(columns)
            found = np.linalg.lstsq(design, -opening, rcond=1e-9)[0]
            if float(np.abs(opening + design @ found).max()) <= min(1.0, LEFT * before):
                return before, {side: found[3 * place:3 * place + 3] for place, side in enumerate(sides)}
    return before, None
