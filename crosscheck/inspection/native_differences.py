"""The differences between what one engine reads from a model file and the neutral scene, in words."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from crosscheck.adapters.common.native import Hinge, Link, Native

TOLERANCE = 1e-7
"""Relative bound on a difference. It is small, because both parsers read the same digits of the file."""


@dataclasses.dataclass(frozen=True)
class Difference:
    """One engine reads one thing differently from the neutral scene."""

    engine: str
    quantity: str  # "mass", "inertia", "damping", ...
    place: str  # of the link or joint; "" for the whole
    words: str

    def __str__(self) -> str:
        return f"{self.engine}: {self.words}"


Told = Callable[[str, str, str], Difference]


def named_alike(neutral: Native, native: Native) -> Native:
    """`native` with the scene's names for bodies without a name in the file. They are matched by their joints."""
    ours = {theirs.child: joint.child for name, joint in neutral.joints.items() if (theirs := native.joints.get(name))
            and joint.child.startswith("body ") and theirs.child not in neutral.links}
    if not ours:
        return native
    joints = {name: dataclasses.replace(joint, parent=ours.get(joint.parent, joint.parent),
                                        child=ours.get(joint.child, joint.child))
              for name, joint in native.joints.items()}
    return dataclasses.replace(native, joints=joints,
                               links={ours.get(name, name): link for name, link in native.links.items()})


def differences(neutral: Native, native: Native, invented: frozenset[str]) -> Iterator[Difference]:
    """All differences. `invented` are links without inertial data, which an engine may make from collision shapes."""
    def told(quantity: str, place: str, words: str) -> Difference:
        return Difference(native.engine, quantity, place, words)

    if not _close(neutral.gravity, native.gravity, 10.0):
        yield told("gravity", "", f"gravity is {native.gravity.tolist()}, the scene has {neutral.gravity.tolist()}")
    ratios = [native.links[name].mass / link.mass for name, link in neutral.links.items() if name in native.links]
    factor = ratios[0] if len(ratios) > 1 and _close(np.array(ratios), np.full(len(ratios), ratios[0]), 1.0) else 1.0
    if abs(factor - 1) > TOLERANCE:
        yield told("mass", "", f"masses of all links times {factor:.6g}")
    for name, link in neutral.links.items():
        link = Link(factor * link.mass, factor * link.inertia)
        other = native.links.get(name)
        if other is None:
            yield told("link", name, f"link {name} is not in its model")
            continue
        yield from _link(name, link, other, invented, told)
    for name in native.links.keys() - neutral.links.keys():
        origin = "from collision geometry" if invented else "otherwise"
        yield told("link", name, f"link {name} is a body of its own, {native.links[name].mass:g} kg, made {origin}")
    off = _shifted_centres(neutral, native)
    for name, gap in off.items():
        yield told("centre of mass", name, f"centre of mass of link {name} is shifted by {_shown(gap)} m")
    for name, joint in neutral.joints.items():
        found = native.joints.get(name)
        if found is None:
            yield told("joint", name, f"joint {name} is not in its model")
        else:
            yield from _joint(name, joint, found, off, told)
    yield from _dynamics(neutral, native, told)


def _link(name: str, ours: Link, theirs: Link, invented: frozenset[str], told: Told) -> Iterator[Difference]:
    if abs(theirs.mass - ours.mass) > TOLERANCE * ours.mass:
        why = " made from collision geometry" if invented else f" times {theirs.mass / ours.mass:.6g}"
        yield told("mass", name, f"mass of link {name}{why}: {theirs.mass:g} kg in place of {ours.mass:g} kg")
    if not _close(ours.inertia, theirs.inertia, float(np.abs(ours.inertia).max())):
        moments = np.linalg.eigvalsh(ours.inertia), np.linalg.eigvalsh(theirs.inertia)
        if _close(*moments, float(moments[0].max())):
            yield told("inertia", name, f"inertial rotation of {name} lost or turned: the principal moments are right, "
                       "their axes are not")
        else:
            yield told("inertia", name, f"inertia of link {name}: principal moments {_shown(moments[1])} in place of "
                       f"{_shown(moments[0])} kg m^2")


def _shifted_centres(neutral: Native, native: Native) -> dict[str, np.ndarray]:
    """Shifts (m) of mass centres. A link has one if all anchors on it shift alike, and those of its neighbours do not.
    """
    gaps: dict[str, list[np.ndarray]] = {}
    for name, ours in neutral.joints.items():
        theirs = native.joints.get(name)
        if theirs is None or (ours.parent, ours.child) != (theirs.parent, theirs.child):
            return {}
        ends = {ours.parent: theirs.parent_anchor - ours.parent_anchor,
                ours.child: theirs.child_anchor - ours.child_anchor}
        alone = sum(np.abs(gap).max() > TOLERANCE for gap in ends.values()) == 1
        for link, gap in ends.items():
            gaps.setdefault(link, []).append(gap if alone else np.full(3, np.nan))
    return {link: -each[0] for link, each in gaps.items() if link in neutral.links
            and np.abs(each[0]).max() > TOLERANCE and _close(np.array([each[0]] * len(each)), np.array(each), 1.0)}


def _joint(name: str, ours: Hinge, theirs: Hinge, off: Mapping[str, np.ndarray], told: Told) -> Iterator[Difference]:
    if ours.kind != theirs.kind:
        yield told("type", name, f"joint {name} is {theirs.kind} in place of {ours.kind}")
    if ours.parent != theirs.parent or ours.child != theirs.child:
        yield told("tree", name, f"joint {name} joins {theirs.parent} and {theirs.child} in place of {ours.parent} and "
                   f"{ours.child}")
        return
    cosine = float(ours.axis @ theirs.axis)
    if cosine < -1 + TOLERANCE:
        yield told("axis", name, f"axis of joint {name} is flipped")
    elif cosine < 1 - TOLERANCE:
        yield told("axis", name, f"axis of joint {name} is turned by {np.degrees(np.arccos(cosine)):.4g} deg")
    turn = theirs.attitude.T @ ours.attitude
    angle = float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    if np.abs(turn - np.eye(3)).max() > TOLERANCE:
        yield told("frame", name, f"frame of joint {name} is turned by {np.degrees(angle):.4g} deg"
                   + _degrees(ours.attitude, theirs.attitude))
    for end in ("parent", "child"):
        gap, link = getattr(theirs, f"{end}_anchor") - getattr(ours, f"{end}_anchor"), getattr(ours, end)
        if link not in off and np.abs(gap).max() > TOLERANCE * max(1.0, float(np.abs(ours.parent_anchor).max())):
            yield told("frame", name, f"frame of joint {name} is shifted by {_shown(gap)} m against the "
                       + ("ground" if link == "ground" else f"centre of mass of {link}"))
    sprung = ("rest_position",) if ours.stiffness and theirs.stiffness else ()
    if ours.mimic != theirs.mimic:
        yield told("mimic", name, f"joint {name} follows " + (
            f"{theirs.mimic or 'no other joint'} in place of {ours.mimic or 'none'}"))
    for key in ("damping", "armature", "stiffness", *sprung):
        value, goal = getattr(theirs, key), getattr(ours, key)
        if abs(value - goal) > TOLERANCE * max(abs(goal), abs(value)):
            wrong = "missing" if value == 0 else f"is {value:g}, not {goal:g}"
            yield told(key, name, f"{key.replace('_', ' ')} of joint {name} {wrong}")


def _degrees(ours: np.ndarray, theirs: np.ndarray) -> str:
    """A hint if the turn comes from degrees read as radians, or radians as degrees; else ""."""
    from scipy.spatial.transform import Rotation

    for factor, words in ((180 / np.pi, "radians written as degrees"), (np.pi / 180, "degrees read from radians")):
        for axes in ("xyz", "XYZ"):
            angles = Rotation.from_matrix(ours).as_euler(axes) * factor
            if np.abs(Rotation.from_euler(axes, angles).as_matrix() - theirs).max() < 1e-6:
                return f", as by {words}: degree for radian"
    return ""


def _dynamics(neutral: Native, native: Native, told: Told) -> Iterator[Difference]:
    """Differences of mass matrix, bias forces and accelerations."""
    if neutral.mass_matrix is None or native.mass_matrix is None or neutral.order != native.order:
        return
    assert neutral.bias is not None
    assert native.bias is not None
    assert neutral.acceleration is not None
    assert native.acceleration is not None
    gap = native.mass_matrix - neutral.mass_matrix
    if not _close(native.mass_matrix, neutral.mass_matrix, float(np.abs(neutral.mass_matrix).max())):
        armature = np.array([neutral.joints[name].armature for name in neutral.order])
        if armature.any() and np.allclose(gap, -np.diag(armature), atol=1e-9 * float(armature.max())):
            for name in np.array(neutral.order)[armature > 0]:
                yield told("armature", str(name), f"armature of joint {name} missing in the mass matrix")
        else:
            name = neutral.order[int(np.unravel_index(int(np.abs(gap).argmax()), gap.shape)[1])]
            yield told("mass matrix", name, f"mass matrix of joint {name} is off by {np.abs(gap).max():.3g}")
    scale = max(1e-9, float(np.abs(neutral.bias).max()))
    if not _close(native.bias, neutral.bias, scale):
        worst = int(np.abs(native.bias - neutral.bias).max(axis=0).argmax())
        yield told("bias", neutral.order[worst], f"bias force of joint {neutral.order[worst]} is off by "
                   f"{np.abs(native.bias - neutral.bias).max():.3g}")
    # The efforts of springs and dampers. Errors of mass matrix and bias, which are reported above, drop out of them.
    ours = np.einsum("kij,kj->ki", neutral.mass_matrix, neutral.acceleration) + neutral.bias
    theirs = np.einsum("kij,kj->ki", native.mass_matrix, native.acceleration) + native.bias
    scale = max(scale, float(np.abs(ours).max()))
    geared = {each for one in (neutral, native) for name, joint in one.joints.items() if joint.mimic
              for each in (name, joint.mimic)}  # their efforts contain the constraint force
    for index in np.flatnonzero(np.abs(theirs - ours).max(axis=0) > 10 * TOLERANCE * scale):
        name = neutral.order[int(index)]
        gap = float(np.abs(theirs - ours)[:, index].max())
        if native.joints[name].damping and np.abs(theirs[:, index]).max() <= 10 * TOLERANCE * scale:
            yield told("damping", name, f"damping of joint {name} is stored but not applied by {native.solver}")
        elif name not in geared:
            yield told("acceleration", name, f"acceleration of joint {name} by {native.solver} differs by an effort of "
                       f"{gap:.3g}")


def _close(one: np.ndarray, other: np.ndarray, scale: float) -> bool:
    return one.shape == other.shape and bool(np.abs(one - other).max(initial=0.0) <= TOLERANCE * max(scale, 1e-12))


def _shown(values: np.ndarray) -> str:
    values = np.where(np.abs(values) > TOLERANCE * np.abs(values).max(), values, 0.0)
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
