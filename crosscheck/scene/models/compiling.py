"""Compiles model files with MuJoCo, without textures and without meshes that no inertia needs."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from crosscheck.errors import SceneError, foreign, missing
from crosscheck.scene.models import known, source
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


def compiled(model: Source, base: str = "fixed", balance: bool = False) -> Any:
    """The `mujoco.MjModel` of a source, which `balance` lets MuJoCo replace inertias that no body can have.

    A URDF loses all geometry, so that MuJoCo needs no meshes and makes no mass from collision shapes.
    """
    try:
        import mujoco
    except ImportError as error:
        raise SceneError(f"{model.path}: models are read by MuJoCo: {missing(error)}") from None
    if model.is_urdf:
        _prepare_urdf(model, base)
    else:
        _prepare_mjcf(model)
    if balance:
        _compiler(model).set("balanceinertia", "true")

    def refused(error: Exception) -> SceneError:  # a ValueError or MuJoCo's own FatalError
        words = model.told(str(error))
        offer = "" if "balanceinertia" not in words or balance else (
            "; --balance (balance=True) lets MuJoCo replace such inertias, and lists it")
        offer = "; give each that moves an inertial, or fix its joint" if "mjMINVAL" in words else offer
        return SceneError(f"{model.path}: MuJoCo cannot read it: {words}{offer}")

    with listening(), foreign(refused):
        spec = mujoco.MjSpec.from_string(model.text)
        spec.modelfiledir = str(model.path.parent.resolve())
        if base == "free":
            _free(spec)
        m = spec.compile()
    _check_finite(model, m)
    return m


def _check_finite(model: Source, m: Any) -> None:
    """Raise `SceneError` for a number of a body or a joint that is none, which MuJoCo takes."""
    for kind, prefix, fields in (("body", "body", ("pos", "quat", "ipos", "iquat", "mass", "inertia")),
                                 ("joint", "jnt", ("pos", "axis", "stiffness"))):
        for field in fields:
            fine = np.isfinite(getattr(m, f"{prefix}_{field}"))
            wrong = np.flatnonzero(~(fine if fine.ndim == 1 else fine.all(axis=1)))
            if len(wrong):
                raise SceneError(f"{model.path}: {kind} {getattr(m, kind)(int(wrong[0])).name!r}: its {field} is not "
                                 "finite; write finite numbers")


def _free(spec: Any) -> None:
    """Let the base move freely: of the bodies in the world without a joint, the one with the most bodies on it."""
    held = [body for body in spec.worldbody.bodies if not body.joints and not body.mocap]
    if held:
        max(held, key=lambda body: len(body.find_all("body"))).add_freejoint()


def _prepare_urdf(model: Source, base: str) -> None:
    for link in model.root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    held = {end.get("link") for joint in model.root.findall("joint") for end in joint.findall("parent")}
    if "world" in held and all(link.get("name") != "world" for link in model.root.findall("link")):
        SubElement(model.root, "link", name="world")  # Drake has it without a word
    try:
        _merge(model.root, drop_root=base == "fixed")
    except ValueError as error:
        raise SceneError(f"{model.path}: {error}; correct it there") from None
    for key in set(_compiler(model).keys()) - set(str(known.URDF["compiler"]).split()):
        del _compiler(model).attrib[key]  # they change masses before these are merged, and are named as not known
    for key, value in (("fusestatic", "false"), ("strippath", "false"), ("discardvisual", "true")):
        _compiler(model).set(key, value)


def _compiler(model: Source) -> Element:
    """The last <compiler> of a model, which is made if there is none; that of a URDF is in its element <mujoco>."""
    holder = model.root
    if model.is_urdf:
        extension = model.root.find("mujoco")
        holder = SubElement(model.root, "mujoco") if extension is None else extension
    compilers = holder.findall("compiler")
    return compilers[-1] if compilers else SubElement(holder, "compiler")


def _prepare_mjcf(model: Source) -> None:
    """Remove textures, materials and skins, whose files are not needed, and meshes that cannot be read."""
    for parent in list(model.root.iter()):
        for child in list(parent):
            if child.tag in ("texture", "skin", "material") and parent.tag in ("asset", "default"):
                parent.remove(child)
        parent.attrib.pop("material", None)
    absent: dict[str | None, str] = {}
    for element, name, target in source.files(model):
        if element.tag != "mesh" and target is None:
            raise source.outside(model.path, name)
        if element.tag == "mesh" and (target is None or not target.is_file()):
            absent[element.get("name") or Path(name).stem] = (
                f"{name}, which is {'missing' if target else 'outside its folder'}")
    if not absent:
        return
    shaped = any(each.get("inertiafromgeom") == "true" for each in model.root.iter("compiler"))
    bodies = {child: body for body in model.root.iter("body") for child in body.iter() if child.tag != "body"}
    for parent in list(model.root.iter()):
        for child in list(parent):
            if child.tag == "mesh" and (child.get("name") or Path(child.get("file", "")).stem) in absent:
                parent.remove(child)
            elif child.tag in ("geom", "site") and child.get("mesh") in absent:
                body = bodies.get(child)
                weightless = child.tag == "site" or "0" in (child.get("mass"), child.get("density"))
                if body is not None and not weightless and (shaped or body.find("inertial") is None):
                    raise SceneError(f"{model.path}: body {body.get('name')!r} ({source.place(body)}) has its mass "
                                     f"from the mesh {absent[child.get('mesh')]}; put it beside the model or give an "
                                     "inertial")
                parent.remove(child)


def _merge(root: Element, drop_root: bool) -> None:
    """Give every moving link the inertial of all links fixed to it, as engines do that fuse such links.

    A single link may have no inertia, or one that no body can have, even if the body of which it is a part is
    admissible. With `drop_root` the root gets none.
    """
    links = {link.get("name", ""): link for link in root.findall("link")}
    inertials = {name: _read(link) for name, link in links.items()}
    joints = [joint for joint in root.findall("joint") if joint.find("child") is not None]
    children = {_end(joint, "child"): joint for joint in joints}

    inner = {name for joint in joints if (name := _end(joint, "parent")) in links}
    order = [name for name in links if name not in inner]  # the deepest first; the parsers refuse a circle of joints
    waiting = Counter(_end(joint, "parent") for joint in joints)
    for name in order:
        if name in children:
            parent = _end(children[name], "parent")
            waiting[parent] -= 1
            if not waiting[parent] and parent in links:
                order.append(parent)
    for name in order:
        joint = children.get(name)
        parent = "" if joint is None else _end(joint, "parent")
        own, base = inertials[name], inertials.get(parent)
        if joint is not None and joint.get("type") == "fixed" and parent in inertials and own is not None:
            X = _pose(joint.find("origin"))
            inertials[parent], inertials[name] = X @ own @ X.T + (0.0 if base is None else base), None
    for name, link in links.items():
        for old in link.findall("inertial"):
            link.remove(old)
        merged = inertials[name]
        if merged is not None and not (drop_root and name not in children):
            _write(link, merged)


def _end(joint: Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _numbers(element: Element, key: str) -> np.ndarray:
    words = element.get(key, "0 0 0").split()
    if len(words) != 3:
        raise ValueError(f"{source.label(element)}: {key} has {len(words)} numbers, not three")
    return np.array([finite(element, word) for word in words])


def finite(element: Element, word: str) -> float:
    """A number in an attribute of the element; raises `ValueError` that names its line."""
    try:
        value = float(word)
    except ValueError:
        raise ValueError(f"{source.label(element)}: {word!r} is not written in numbers") from None
    if not math.isfinite(value):
        raise ValueError(f"{source.label(element)}: {word!r} is not finite")
    return value


def _pose(origin: Element | None) -> np.ndarray:
    """(4, 4) homogeneous matrix of an origin."""
    from scipy.spatial.transform import Rotation

    X = np.eye(4)
    if origin is not None:
        X[:3, 3] = _numbers(origin, "xyz")
        X[:3, :3] = Rotation.from_euler("xyz", _numbers(origin, "rpy")).as_matrix()
    return X


def _read(link: Element) -> np.ndarray | None:
    """(4, 4) the sum of m p p^T over a link's points p = (x, y, z, 1) in its frame, which adds up and turns by X."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    mass, values = inertial.find("mass"), inertial.find("inertia")
    if mass is None:
        raise ValueError(f"{source.label(link)} has an inertial without a mass")
    X, P = _pose(inertial.find("origin")), np.zeros((4, 4))
    if values is not None:
        J = np.array([[finite(values, values.get(f"i{min(a, b)}{max(a, b)}", "0")) for b in "xyz"] for a in "xyz"])
        P[:3, :3] = np.trace(J) / 2 * np.eye(3) - J
    P[3, 3] = finite(mass, mass.get("value", "0"))
    return np.asarray(X @ P @ X.T)


def _write(link: Element, merged: np.ndarray) -> None:
    mass = float(merged[3, 3])
    com = merged[:3, 3] / mass if mass else np.zeros(3)
    squares = merged[:3, :3] - mass * np.outer(com, com)
    J = np.trace(squares) * np.eye(3) - squares
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=" ".join(map(repr, com.tolist())), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(mass))
    SubElement(inertial, "inertia", {f"i{'xyz'[a]}{'xyz'[b]}": repr(float((J[a, b] + J[b, a]) / 2))
                                     for a in range(3) for b in range(a, 3)})
