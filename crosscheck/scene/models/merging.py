"""Merges the inertials of a URDF along its fixed joints, as engines do that fuse such links.

A single link may have no inertia, or one that no body can have, even if the body of which it is a part is admissible.
"""

from __future__ import annotations

import dataclasses
import math
from xml.etree.ElementTree import Element, SubElement

import numpy as np


@dataclasses.dataclass
class Inertial:
    """Mass (kg), first moment (kg m) and inertia about the origin of the link's frame (kg m^2), in its axes."""

    mass: float
    moment: np.ndarray  # (3,)
    inertia: np.ndarray  # (3, 3)


def merge(root: Element, drop_root: bool) -> None:
    """Give every moving link the inertial of all links fixed to it; with `drop_root` the root gets none."""
    links = {link.get("name", ""): link for link in root.findall("link")}
    found = {name: _read(link) for name, link in links.items()}
    joints = [joint for joint in root.findall("joint") if joint.find("child") is not None]
    children = {_end(joint, "child"): joint for joint in joints}

    def depth(name: str) -> int:
        steps = 0
        while name in children and steps <= len(children):
            name, steps = _end(children[name], "parent"), steps + 1
        return steps

    for name in sorted(links, key=depth, reverse=True):  # the deepest first; the parsers refuse a circle of joints
        joint = children.get(name)
        parent = "" if joint is None else _end(joint, "parent")
        if joint is not None and joint.get("type") == "fixed" and parent in found and found[name] is not None:
            p, R = _pose(joint.find("origin"))
            found[parent] = _added(found[parent], found[name], p, R)
            found[name] = None
    for name, link in links.items():
        for old in link.findall("inertial"):
            link.remove(old)
        merged = found[name]
        if merged is not None and not (drop_root and name not in children):
            _write(link, merged)


def _end(joint: Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _numbers(text: str | None, count: int) -> np.ndarray:
    values = np.array([_finite(word) for word in (text or "").split()])
    return values if len(values) == count else np.zeros(count)


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(f"{word!r} is not finite")
    return value


def _pose(origin: Element | None) -> tuple[np.ndarray, np.ndarray]:
    from scipy.spatial.transform import Rotation

    if origin is None:
        return np.zeros(3), np.eye(3)
    return (_numbers(origin.get("xyz"), 3), Rotation.from_euler("xyz", _numbers(origin.get("rpy"), 3)).as_matrix())


def _read(link: Element) -> Inertial | None:
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    values = None if inertial is None else inertial.find("inertia")
    if inertial is None or mass is None or values is None:
        return None
    m, (com, R) = _finite(mass.get("value", "0")), _pose(inertial.find("origin"))
    J = np.array([[_finite(values.get(f"i{min(a, b)}{max(a, b)}", "0")) for b in "xyz"] for a in "xyz"])
    return Inertial(m, m * com, R @ J @ R.T + m * (com @ com * np.eye(3) - np.outer(com, com)))


def _added(base: Inertial | None, part: Inertial | None, p: np.ndarray, R: np.ndarray) -> Inertial | None:
    """`base` with `part`, whose frame is at p, R in that of `base`."""
    if part is None:
        return base
    c, m = R @ part.moment, part.mass
    # about the new origin; the terms p c^T appear because the part's centre of mass is not at its own origin
    shifted = R @ part.inertia @ R.T + m * (p @ p * np.eye(3) - np.outer(p, p)) + (
        2 * (p @ c) * np.eye(3) - np.outer(p, c) - np.outer(c, p))
    if base is None:
        return Inertial(m, c + m * p, shifted)
    return Inertial(base.mass + m, base.moment + c + m * p, base.inertia + shifted)


def _write(link: Element, merged: Inertial) -> None:
    com = merged.moment / merged.mass if merged.mass else np.zeros(3)
    J = merged.inertia - merged.mass * (com @ com * np.eye(3) - np.outer(com, com))
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=" ".join(map(repr, com.tolist())), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(merged.mass))
    SubElement(inertial, "inertia", {f"i{'xyz'[a]}{'xyz'[b]}": repr(float((J[a, b] + J[b, a]) / 2))
                                     for a in range(3) for b in range(a, 3)})
