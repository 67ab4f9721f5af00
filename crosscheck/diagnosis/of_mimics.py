"""Joints that follow others by another ratio, from another offset, or not at all: fitted to the coordinates shown.

They are causes only if the accelerations are those of the scene with its mimics altered in this way.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from crosscheck.diagnosis import fit
from crosscheck.diagnosis.physics import of_scene
from crosscheck.diagnosis.result import Evidence, NamedCause
from crosscheck.diagnosis.shown import FAITHFUL, Shown, data
from crosscheck.scene.coordinates import histories
from crosscheck.scene.model import Joint, Mimic, Scene

EXACT = 1e-6
"""Relative: a fitted ratio nearer than this to one that has a name is that one."""


def diagnose(shown: list[Shown], whole: Scene) -> tuple[list[NamedCause], Evidence] | None:
    """Causes and their evidence; None if all mimics are the scene's. `whole` has every force that any copy has."""
    causes: list[NamedCause] = []
    altered: dict[str, Mimic | None] = {}
    worst = 0.0
    for joint in shown[0].observation.scene.joints:
        if joint.mimic is None:
            continue
        before, altered[joint.name] = fitted(shown, joint, joint.mimic)
        worst = max(worst, before)
        if before > 1.0:
            causes.append(named(joint.name, joint.mimic, altered[joint.name]))
    if not causes:
        return None
    copies = []
    for each in shown:
        scene = each.observation.scene
        scene = scene.replace(joints=tuple(joint if joint.mimic is None else dataclasses.replace(
            joint, mimic=altered[joint.name]) for joint in scene.joints))
        copies.append(dataclasses.replace(each, observation=dataclasses.replace(each.observation, scene=scene)))
    right = of_scene(whole, len(shown))
    left = float(np.abs(data(copies, right, False, 1).residual(right)).max())
    return causes, Evidence(
        "mimic", "model", worst, left, "gap of the joints that follow others, then accelerations with their mimics so "
        "altered, over their noise", "; ".join(cause.magnitude for cause in causes), left <= fit.EXPLAINED)


def fitted(shown: list[Shown], joint: Joint, mimic: Mimic) -> tuple[float, Mimic | None]:
    """(largest gap of the joint over its noise, the mimic that it shows). The mimic is None if no ratio fits."""
    gaps, rates, turns = [], [], []
    for each in shown:
        scene, scale = each.observation.scene, each.observation.scale
        if all(other.name != joint.name or other.mimic is None for other in scene.joints):
            continue
        found = histories(scene, each.states)
        follower, leader = found[joint.name], found[mimic.joint]
        size = scale.length if joint.type == "prismatic" else 1.0
        noise = size * (FAITHFUL + fit.EXPLAINED * each.observation.noise) * (1.0 + abs(mimic.ratio))
        gaps.append((follower.position - mimic.ratio * leader.position - mimic.offset) / noise)
        rates.append(np.column_stack([follower.velocity, leader.velocity]) / (noise * scale.rate))
        turns.append((follower.position, leader.position))
    speed, leading = np.concatenate(rates).T
    gap = max(float(np.abs(each).max()) for each in (*gaps, speed - mimic.ratio * leading))
    if gap <= 1.0:
        return gap, mimic
    ratio = float(speed @ leading / max(leading @ leading, 1e-300))
    ratio = next((value for value in (mimic.ratio, -mimic.ratio, 1 / mimic.ratio if mimic.ratio else 0.0)
                  if abs(ratio - value) <= EXACT * abs(value)), ratio)
    if np.abs(speed - ratio * leading).max() > 1.0:
        return gap, None
    # If the ratio is another one, the offset is that of the start, whatever it is.
    offset = float(np.mean(turns[0][0] - ratio * turns[0][1]))
    return gap, dataclasses.replace(mimic, ratio=ratio, offset=offset)


def named(name: str, mimic: Mimic, found: Mimic | None) -> NamedCause:
    mend = f"check the mimic of joint {name!r} that reaches the engine"
    if found is None:
        return NamedCause("missing mimic", f"joint {name!r} does not follow joint {mimic.joint!r}", mend)
    if found.ratio == mimic.ratio:
        return NamedCause("mimic offset", f"joint {name!r} follows joint {mimic.joint!r} with the offset "
                          f"{found.offset:.5g} in place of {mimic.offset:.5g}", mend)
    kind = {-mimic.ratio: "sign", 1 / mimic.ratio if mimic.ratio else 0.0: "direction"}.get(found.ratio, "ratio")
    return NamedCause(f"mimic {kind}", f"joint {name!r} follows joint {mimic.joint!r} with the ratio "
                      f"{found.ratio:.5g} in place of {mimic.ratio:.5g}", mend)
