"""Whether derivatives of a source are right, and if not, what is wrong with them.

An analytic source is right to rounding times conditioning, or wrong; a finite difference is right to its documented
order in its step. Each cause is the truth with one mistake; the cause is the one that leaves nothing of the difference.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.jointspace.derivatives import Derivatives, of, truth
from crosscheck.jointspace.motion import JointSpace, starting
from crosscheck.scene.coordinates import relative
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Scene

EXPLAINED = 0.02
"""Part of a difference that may be left of it once the cause is in the truth, besides the bound."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Derivatives of one source against truth, each error relative to the block's size."""

    source: str
    errors: dict[str, float]
    bound: float
    right: bool
    cause: str = ""  # of wrong ones, "" where none is found


def judge(scene: Scene, source: Any, exact: Derivatives | None = None) -> Verdict:
    """The verdict on a source at the start of a scene; errors as of `crosscheck.derivatives`."""
    exact = exact or truth(scene)
    if exact.da_dq is None:
        raise Unsupported(f"{scene.name!r} has no joint coordinates in which sources give derivatives")
    given = of(scene, source)
    sizes = scales(exact)
    errors = {name: float(np.abs(values - exact.blocks[name]).max() / sizes[name])
              for name, values in given.blocks.items()}
    bound = float(max(given.error, exact.error))
    wrong = {name: given.blocks[name] for name, error in errors.items() if not error <= bound}
    cause = cause_of(scene, exact, wrong, bound, given.source) if wrong else ""
    return Verdict(given.source, errors, bound, not wrong, cause)


def scales(exact: Derivatives) -> dict[str, float]:
    """Sizes of the blocks; a rate counts as the root of a stiffness, where dampers and spins are absent."""
    assert exact.da_dq is not None
    assert exact.da_dv is not None
    assert exact.da_dtau is not None
    stiff, slow, light = (float(np.abs(part).max()) for part in (exact.da_dq, exact.da_dv, exact.da_dtau))
    return {"da_dq": max(stiff, slow**2, 1e-300), "da_dv": max(slow, np.sqrt(stiff), 1e-300), "da_dtau": light}


def cause_of(scene: Scene, exact: Derivatives, wrong: dict[str, np.ndarray], bound: float, source: str) -> str:
    """What is wrong with the wrong blocks, in words; "" if no known mistake explains it."""
    sizes = scales(exact)
    for words, changed in _mistakes(scene, exact):
        left = {name: float(np.abs(values - changed[name]).max()) for name, values in wrong.items()}
        apart = {name: float(np.abs(values - exact.blocks[name]).max()) for name, values in wrong.items()}
        if all(left[name] <= bound * sizes[name] + EXPLAINED * apart[name] for name in wrong):
            return f"{words} ({', '.join(wrong)})"
    composite = [joint.name for joint in scene.joints if len(JOINT_TYPES[joint.type].motion) > 1]
    if source.startswith("pinocchio:aba") and composite:
        return (f"joint {composite[0]!r} is a JointModelComposite, whose axes turn against each other: Pinocchio's "
                f"derivatives are not those of its own accelerations ({', '.join(wrong)})")
    return ""


def _mistakes(scene: Scene, exact: Derivatives) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Each known mistake and the blocks that it would give."""
    blocks = {name: exact.blocks[name] for name in ("da_dq", "da_dv", "da_dtau")}
    for words, changed in (
            ("the damping of joints is left out", _without(scene, "damping")),
            ("the springs of joints are left out", _without(scene, "stiffness")),
            ("the armature is left out", scene.replace(joints=tuple(
                dataclasses.replace(joint, armature=()) for joint in scene.joints))),
            ("gravity is left out", scene.replace(gravity=np.zeros(3))),
            ("gravity has the wrong sign", scene.replace(gravity=-scene.gravity)),
            ("the rates are left out", scene.replace(bodies=tuple(dataclasses.replace(
                body, velocity=np.zeros(3), angular_velocity=np.zeros(3)) for body in scene.bodies)))):
        space = JointSpace(changed)
        da_dq, da_dv = space.derivative(space.accelerations)
        yield words, {"da_dq": da_dq, "da_dv": da_dv, "da_dtau": np.linalg.inv(space.mass)}
    yield "the sign is reversed", {name: -values for name, values in blocks.items()}
    yield "rows and columns are exchanged", {name: values.T for name, values in blocks.items()}
    yield "the order of the coordinates is reversed", {name: values[::-1, ::-1] for name, values in blocks.items()}
    turns, spins = _bases(scene)
    yield "small turns of balls are taken in the parent's axes", {
        name: turns @ values @ turns.T for name, values in blocks.items()}
    da_dq, da_dv = blocks["da_dq"], blocks["da_dv"]
    yield "da_dq is taken at rates that are fixed in other axes", blocks | {"da_dq": da_dq + da_dv @ spins}
    yield "it is twice as large", {name: 2 * values for name, values in blocks.items()}
    yield "it is the derivative of the inverse dynamics", {
        name: -np.linalg.solve(blocks["da_dtau"], values) for name, values in blocks.items()}


def _without(scene: Scene, key: str) -> Scene:
    return scene.replace(forces=tuple(
        dataclasses.replace(force, parameters={**force.parameters, key: 0.0}) if force.type == "torsional_spring"
        else force for force in scene.forces))


def _bases(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Turns of the coordinates of balls from child to parent axes, and their rates as matrices w x (.)."""
    space, start = JointSpace(scene), starting(scene)
    turns, spins = np.eye(space.size), np.zeros((space.size, space.size))
    for link in space.links:
        own = space.own[link.body]
        if link.joint is not None and JOINT_TYPES[link.joint.type].coordinates == ("ball",):
            turns[own, own] = relative(link.joint, start).turn[0]
            spins[own, own] = np.cross(space.speeds[own], np.eye(3)).T
    return turns, spins
