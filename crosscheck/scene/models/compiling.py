"""Compiles model files with MuJoCo, without textures and without meshes that no inertia needs."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from crosscheck.errors import SceneError, missing
from crosscheck.scene.models import source
from crosscheck.scene.models.source import Source


@contextlib.contextmanager
def listening() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings in a list; by itself MuJoCo appends them to MUJOCO_LOG.TXT in the working folder.

    Python warnings, by which MuJoCo advises the authors of models about deprecated attributes, are ignored.
    """
    import warnings

    import mujoco

    heard: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(heard.append)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            yield heard
    finally:
        mujoco.set_mju_user_warning(before)


def compiled(model: Source, base: str = "fixed", bare: bool = True) -> Any:
    """The `mujoco.MjModel` of a source.

    `bare` removes all geometry from a URDF, so that MuJoCo needs no meshes and makes no mass from collision shapes.
    """
    try:
        import mujoco
    except ImportError as error:
        raise SceneError(f"{model.path}: models are read by MuJoCo: {missing(error)}") from None
    if model.is_urdf:
        _prepare_urdf(model, base, bare)
    else:
        _prepare_mjcf(model)
    with listening():
        try:
            spec = mujoco.MjSpec.from_string(model.text)
            spec.modelfiledir = str(model.path.parent.resolve())
            if model.is_urdf and base == "free":
                spec.worldbody.first_body().add_freejoint()
            return spec.compile()
        except Exception as error:  # MuJoCo raises ValueError, and its own FatalError
            words = " ".join(str(error).split()).removeprefix("Error: ")
            raise SceneError(f"{model.path}: MuJoCo cannot read it: {words}") from None


def _prepare_urdf(model: Source, base: str, bare: bool) -> None:
    if bare:
        for link in model.root.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)
        try:
            _merge(model.root, drop_root=base == "fixed")
        except ValueError as error:
            raise SceneError(f"{model.path}: an inertial or origin is not written in numbers: {error}") from None
    for extension in model.root.findall("mujoco"):
        model.root.remove(extension)
    extension = SubElement(model.root, "mujoco")
    SubElement(extension, "compiler", fusestatic="false", strippath="false", balanceinertia="false",
                           discardvisual="true")


def _prepare_mjcf(model: Source) -> None:
    """Remove textures, materials and skins, whose files are not needed, and meshes that cannot be read."""
    for parent in list(model.root.iter()):
        for child in list(parent):
            if child.tag in ("texture", "skin", "material") and parent.tag in ("asset", "default"):
                parent.remove(child)
        parent.attrib.pop("material", None)
    missing = {}
    for element, name, target in source.files(model):
        if element.tag != "mesh" and target is None:
            raise source.outside(model.path, name)
        if element.tag == "mesh" and (target is None or not target.is_file()):
            missing[element.get("name") or Path(name).stem] = (
                f"{name}, which is {'missing' if target else 'outside its folder'}", element)
    for asset in model.root.findall("asset"):
        for _, element in missing.values():
            if element in list(asset):
                asset.remove(element)
    for body in model.root.iter("body"):
        for geom in body.findall("geom"):
            if geom.get("mesh") not in missing:
                continue
            if body.find("inertial") is None:
                raise SceneError(f"{model.path}: body {body.get('name')!r} has its mass from the mesh "
                                 f"{missing[geom.get('mesh', '')][0]}; put it there or give an inertial")
            body.remove(geom)
    world = model.root.find("worldbody")
    for geom in [] if world is None else world.findall("geom"):
        if world is not None and geom.get("mesh") in missing:
            world.remove(geom)


@dataclasses.dataclass
class Inertial:
    """Mass (kg), first moment (kg m) and inertia about the origin of the link's frame (kg m^2), in its axes."""

    mass: float
    moment: np.ndarray  # (3,)
    inertia: np.ndarray  # (3, 3)


def _merge(root: Element, drop_root: bool) -> None:
    """Give every moving link the inertial of all links fixed to it, as engines do that fuse such links.

    A single link may have no inertia, or one that no body can have, even if the body of which it is a part is
    admissible. With `drop_root` the root gets none.
    """
    links = {link.get("name", ""): link for link in root.findall("link")}
    inertials = {name: _read(link) for name, link in links.items()}
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
        if joint is not None and joint.get("type") == "fixed" and parent in inertials and inertials[name] is not None:
            p, R = _pose(joint.find("origin"))
            inertials[parent] = _added(inertials[parent], inertials[name], p, R)
            inertials[name] = None
    for name, link in links.items():
        for old in link.findall("inertial"):
            link.remove(old)
        merged = inertials[name]
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
