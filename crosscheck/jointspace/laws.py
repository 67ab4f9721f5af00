"""Scenes with force laws: without them, and with the pieces of them that act at the start.

Between events a law is linear in its coordinate and rate: a spring, a damper and a constant force. At an event it has
no derivative; that of a flow has a jump there, which differences of whole motions have too.
"""

from __future__ import annotations

import dataclasses

from crosscheck.errors import Unsupported
from crosscheck.jointspace.motion import NONE
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.model import Force, Joint, Scene


def smooth(scene: Scene) -> Scene:
    """The scene whose laws are the pieces that act at its start.

    Raises
    ------
    Unsupported
        A law changes at just this state, so that there is no derivative; or it is one of a joint of two coordinates.
    """
    if not scene.has_laws:
        return scene
    plain, made, joints = scene.lawless, list[Force](), list[Joint]()
    for joint, now in zip(scene.joints, plain.joints, strict=True):
        if joint.dry_friction or joint.limits or any(name == joint.name for name, _ in scene.servos.values()):
            stiffness, damping, effort = _piece(scene, joint)
            q, rate = (float(each[0]) for each in at_start(scene)[joint.name])
            own, drag, rest = ((values or (0.0,))[0] for values in (now.stiffness, now.damping, now.rest_position))
            joints.append(dataclasses.replace(
                now, stiffness=(own + stiffness,), damping=(drag + damping,),
                rest_position=((own * rest + stiffness * q) / (own + stiffness) if own + stiffness else 0.0,)))
            word = "torque" if joint.kind.turns else "force"
            made.append(Force(f"joint_{word}", None, None, joint.name, {word: effort + damping * rate}))
        else:
            joints.append(now)
    return plain.replace(forces=(*plain.forces, *made), joints=tuple(joints))


def _piece(scene: Scene, joint: Joint) -> tuple[float, float, float]:
    """Minus the derivatives of a joint's laws by its coordinate and by its rate, and their effort, at the start."""
    def refuse(why: str) -> Unsupported:
        return Unsupported(f"derivatives of {scene.name!r}: joint {joint.name!r} {why}, where its law has none; take "
                           "another state, of a model file by --qpos or --qvel")

    if not joint.kind.has_one:
        raise Unsupported(f"derivatives of {scene.name!r}: joint {joint.name!r} has laws on several coordinates")
    q, rate = (float(each[0]) for each in at_start(scene)[joint.name])
    stiffness = damping = effort = 0.0
    for friction in filter(None, joint.dry_friction):
        if abs(rate) < NONE:
            raise refuse("is at rest with dry friction")
        effort += float(friction.force(rate))
    for limits in filter(None, joint.limits):
        if min(abs(q - limits.lower), abs(q - limits.upper)) < NONE or (limits.rigid and limits.depth(q)):
            raise refuse("is at its limit")
        push = float(limits.force(q, rate))
        if push:
            stiffness, damping, effort = stiffness + (limits.stiffness or 0.0), damping + limits.damping, effort + push
    for servo in (servo for name, servo in scene.servos.values() if name == joint.name):
        given = float(servo.held[0] if servo.held else 0.0) if servo.delay else float(servo.effort(0.0, q, rate))
        effort += given
        if servo.period is None:
            lower, upper = (float(each) for each in servo.bounds(rate))
            if lower < given < upper:
                stiffness, damping = stiffness + servo.proportional, damping + servo.derivative
            elif servo.no_load_speed is not None and given * rate > 0:
                damping += abs((servo.effort_limit or (0.0, 0.0))[int(given > 0)]) / servo.no_load_speed
    return stiffness, damping, effort
