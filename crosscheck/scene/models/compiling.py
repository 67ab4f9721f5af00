"""Compiles model files with MuJoCo, without textures and without meshes that no inertia needs."""

from __future__ import annotations

import contextlib
import glob
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from crosscheck.errors import SceneError, errors_as, missing
from crosscheck.scene.models import collisions, known, source
from crosscheck.scene.models.source import Source

MOST_REFUSED = 200
"""Elements that may be left out of a model until MuJoCo reads it."""

NEEDED = frozenset(("mujoco", "worldbody", "body", "frame", "joint", "freejoint", "inertial", "geom", "asset", "mesh",
                    "default", "compiler", "option", "robot", "link", "parent", "child", "origin", "mass", "inertia"))
"""Elements without which bodies, their masses or places were others; they are never left out."""

APART = frozenset(("sensor", "contact", "equality", "tendon", "actuator", "deformable", "keyframe", "light", "camera",
                   "composite", "plugin", "extension"))
"""Elements that may be left out, or any in them, and named."""

SPARE = {"repeated name": "name", "in ball joint": "range"}
"""Attributes that may be left out, and named, where MuJoCo refuses their element with these words."""

LIGHT = 1e-7
"""Mass and inertia that a massless link gets, relative to what it carries: the motion changes by as much."""
LEAST_INERTIA = 1e-15
"""mjMINVAL: MuJoCo takes no smaller mass or inertia of what moves."""


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


def compiled(model: Source, base: str = "fixed", balance: bool = False) -> tuple[Any, list[str], list[str]]:
    """(the `mujoco.MjModel` of a source, what MuJoCo refuses and is left out, what is read otherwise, both in words).

    `balance` replaces inertias that no body can have. A URDF gets its collision shapes after it is read, so that MuJoCo
    needs no meshes and makes no mass from them.
    """
    try:
        import mujoco
    except ImportError as error:
        raise SceneError(f"{model.path}: models are read by MuJoCo: {missing(error)}") from None
    shapes, frames, gone, noted = _prepare_urdf(model, base, balance) if model.is_urdf else (
        [], [], *_prepare_mjcf(model))
    if balance:
        _compiler(model).set("balanceinertia", "true")

    def refused(error: Exception) -> SceneError:  # a ValueError or MuJoCo's own FatalError
        words = model.with_lines(str(error))
        offer = "" if not any(each in words for each in ("balanceinertia", "positive eigenvalues")) or balance else (
            "; --balance (balance=True) lets MuJoCo replace such inertias, and lists it")
        offer = "; give each that moves an inertial, or fix its joint" if "mjMINVAL" in words else offer
        return SceneError(f"{model.path}: MuJoCo cannot read it: {words}{offer}")

    folder = model.path.parent.resolve()
    while True:
        try:
            with listening(), errors_as(refused), contextlib.chdir(folder):  # where it looks for models in the model
                spec = mujoco.MjSpec.from_string(model.text)
                spec.modelfiledir = str(folder)
                if base == "free":
                    _free(spec)
                collisions.add(spec, shapes)
                m = spec.compile()
        except SceneError as error:
            words = " ".join(str(error.__cause__).split())
            if len(gone) == MOST_REFUSED or not (reason := _without(model, words)):
                raise
            gone.append(reason)
        else:
            _check_finite(model, m)
            for name in frames:
                m.body(name).mass[:], m.body(name).inertia[:] = 0.0, 0.0
            if frames:
                mujoco.mj_setConst(m, mujoco.MjData(m))
            return m, gone, noted


def _without(model: Source, words: str) -> str:
    """Leave out of the source the element or attribute that MuJoCo refuses in these words; what, or "" if it cannot."""
    line = re.search(r"line (\d{1,9})$", words)
    nodes = list(model.root.iter())
    if line is None or not 0 < int(line[1]) <= len(nodes) or any(node.tag == "model" for node in nodes):
        return ""  # it may be the line of a model in the model
    node = nodes[int(line[1]) - 1]
    unknown = re.search(r"unrecognized attribute: '([^']+)'", words)
    attribute = unknown[1] if unknown else next((each for said, each in SPARE.items() if said in words), "")
    label = source.label(node)
    if node.attrib.pop(attribute, None) is not None or (attribute == "range" and node.get("limited") != "false"):
        if attribute == "range":
            node.set("limited", "false")  # its class may have one, too
        return f"the attribute {attribute} of {label}"
    above = [node, *_above(model, node)]
    if node.tag == "mesh" and node.get("file") and above[1].tag == "asset":
        _strip(model, {node.get("name") or Path(node.get("file", "")).stem: "which MuJoCo refuses"})
    elif inside := [inner for inner, outer in itertools.pairwise(above) if outer.tag in APART]:
        node = inside[-1]  # such as a whole tendon, of which a joint is missing
        _above(model, node)[0].remove(node)
    elif node.tag not in NEEDED and (node.tag in APART or "repeated el" in words or "unrecognized el" in words):
        above[1].remove(node)
    else:
        return ""
    why = words.removeprefix("Error: ").partition(" Element ")[0]
    return f"the element {source.label(node)}, which MuJoCo refuses: {why}"


def _above(model: Source, node: Element) -> list[Element]:
    """The elements that an element is in, the innermost first."""
    parents = {child: parent for parent in model.root.iter() for child in parent}
    above = [node]
    while above[-1] in parents:
        above.append(parents[above[-1]])
    return above[1:]


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


def _prepare_urdf(model: Source, base: str, balance: bool
                  ) -> tuple[list[collisions.Collision], list[str], list[str], list[str]]:
    """(collision shapes, links that are frames, nothing that is left out, what is read otherwise in words).

    Moving links get their masses, and the options that MuJoCo has are taken.
    """
    try:
        shapes, unwatched = collisions.read(model, pose, finite)
    except ValueError as error:
        raise SceneError(f"{model.path}: {error}; correct it there") from None
    for link in model.root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    held = {end.get("link") for joint in model.root.findall("joint") for end in joint.findall("parent")}
    if "world" in held and all(link.get("name") != "world" for link in model.root.findall("link")):
        SubElement(model.root, "link", name="world")  # Drake has it without a word
    try:
        frames, noted = _merge(model.root, base == "fixed", balance)
    except ValueError as error:
        raise SceneError(f"{model.path}: {error}; correct it there") from None
    for key in set(_compiler(model).keys()) - set(str(known.URDF["compiler"]).split()):
        del _compiler(model).attrib[key]  # they change masses before these are merged, and are named as not known
    for key, value in (("fusestatic", "false"), ("strippath", "false"), ("discardvisual", "true")):
        _compiler(model).set(key, value)
    return shapes, frames, [], [*noted, *unwatched]


def _compiler(model: Source) -> Element:
    """The last <compiler> of a model, which is made if there is none; that of a URDF is in its element <mujoco>."""
    holder = model.root
    if model.is_urdf:
        extension = model.root.find("mujoco")
        holder = SubElement(model.root, "mujoco") if extension is None else extension
    compilers = holder.findall("compiler")
    return compilers[-1] if compilers else SubElement(holder, "compiler")


def _prepare_mjcf(model: Source) -> tuple[list[str], list[str]]:
    """Remove textures, materials and skins, whose files are not needed, meshes that cannot be read, and what bends.

    How long muscles can get is not computed. A mesh that a mass needs is looked for beside the model, too. The result
    says in words what is left out, and what is read otherwise.
    """
    gone, noted = list[str](), list[str]()
    for parent in list(model.root.iter()):
        for child in list(parent):
            if child.tag in ("flex", "flexcomp"):
                gone.append(f"the flexible body {source.label(child)}")
                parent.remove(child)
            elif child.tag == "joint" and child.get("type") == "fixed" and parent.tag == "body":
                parent.remove(child)  # Bullet has them
            elif child.tag == "inertial" and child.get("pos") is None:
                child.set("pos", "0 0 0")  # as engines have it that read such files
    tops = {top.get("class", "main") for top in model.root.findall("default")}
    for each in model.root.iter() if len(tops) == 1 else ():  # the class of all, as engines have it that know no "main"
        each.attrib |= {key: "main" for key in ("class", "childclass") if each.get(key) in tops}
    for each in model.root.iter("light"):
        each.attrib.pop("texture", None)
    for each in model.root.iter("option"):
        each.attrib.pop("integrator", None)
    if not any(body.get(key) for body in model.root.iter("body") for key in known.PLACE.split()):
        for each in model.root.iter("compiler"):  # where all frames are the world's, global is local
            each.attrib.pop("coordinate", None)
    for each in list(model.root.iter("lengthrange")) or [SubElement(_compiler(model), "lengthrange")]:
        each.set("mode", "none")
    for parent in list(model.root.iter()):
        for child in list(parent):
            if child.tag in ("texture", "skin", "material") and parent.tag in ("asset", "default"):
                parent.remove(child)
        parent.attrib.pop("material", None)
    absent, needed, folder = dict[str | None, str](), _weighing(model), model.path.parent.resolve()
    for element, name, target in list(source.files(model)):
        if element.tag != "mesh" and target is None:
            raise source.outside(model.path, name)
        if element.tag == "mesh" and (target is None or not target.is_file()):
            mesh, base = element.get("name") or Path(name).stem, Path(name).name
            near = [each for each in (folder / base, *folder.glob(f"*/{glob.escape(base)}")) if each.is_file()]
            if mesh in needed and len(near) == 1 and near[0].resolve().is_relative_to(model.within):
                element.attrib |= {"name": mesh, "file": str(near[0])}
                noted.append(f"the mesh {name}, which is not at its path: taken from {near[0].relative_to(folder)}")
            else:
                absent[mesh] = f"{name}, which is {'missing' if target else 'outside its folder'}"
    _strip(model, absent)
    return gone, noted


def _weighing(model: Source) -> dict[str | None, Element]:
    """The meshes that masses are made of, by name, each with the first body of them."""
    shaped = any(each.get("inertiafromgeom") == "true" for each in model.root.iter("compiler"))
    bodies = {inner: body for body in model.root.iter("body") for inner in body.iter()}  # the innermost
    return {inner.get("mesh"): body for inner, body in reversed(bodies.items())
            if inner.tag == "geom" and "0" not in (inner.get("mass"), inner.get("density"))
            and (shaped or body.find("inertial") is None)}


def _strip(model: Source, absent: dict[str | None, str]) -> None:
    """Remove these meshes and what has their shape; raises `SceneError` where a body has its mass from one."""
    for mesh, body in reversed(_weighing(model).items()):
        if mesh in absent:
            raise SceneError(f"{model.path}: body {body.get('name')!r} ({source.place(body)}) has its mass from the "
                             f"mesh {absent[mesh]}; put it beside the model, give an inertial, or --within FOLDER, "
                             "one above both")
    for parent in list(model.root.iter()):
        for child in list(parent):
            if ((child.tag == "mesh" and (child.get("name") or Path(child.get("file", "")).stem) in absent)
                    or (child.tag in ("geom", "site") and child.get("mesh") in absent)):
                parent.remove(child)


def _merge(root: Element, drop_root: bool, balance: bool) -> tuple[list[str], list[str]]:
    """Give every moving link the inertial of all links fixed to it, as engines do that fuse such links.

    A single link may have no inertia, or one that no body can have, even if the body of which it is a part is
    admissible. With `drop_root` the root gets none. The result names the links that are frames between joints, whose
    masses are there for MuJoCo's compiler alone, and says in words what joints move nothing and are fixed, and which
    links get a light inertia: without one they are points.
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
    frames, noted, moving, carried = list[str](), list[str](), set[str](), dict.fromkeys(links, np.zeros((4, 4)))
    for name in order:
        joint = children.get(name)
        parent = "" if joint is None else _end(joint, "parent")
        own, base = inertials[name], inertials.get(parent)
        carried[name] = carried[name] + (0.0 if own is None else own)
        if joint is None or parent not in inertials:
            continue
        X = pose(joint.find("origin"))
        if joint.get("type") != "fixed" and name not in moving and _idle(joint, carried[name]):
            joint.set("type", "fixed")
            noted.append(f"joint {joint.get('name')!r}, which moves no mass: it is fixed")
        if joint.get("type") != "fixed" or name in moving:
            moving.add(parent)
        carried[parent] = carried[parent] + X @ carried[name] @ X.T
        if joint.get("type") == "fixed" and own is not None:
            inertials[parent], inertials[name] = X @ own @ X.T + (0.0 if base is None else base), None
    for name, link in links.items():
        for old in link.findall("inertial"):
            link.remove(old)
        merged, joint = inertials[name], children.get(name)
        if not drop_root if joint is None else joint.get("type") != "fixed":
            merged = np.zeros((4, 4)) if merged is None else merged
            if joint is not None and not merged.any():
                frames.append(name)
            merged, reason = _held(merged, carried[name], balance)
            noted += [f"link {name!r} {reason}"] if reason and name not in frames else []
        if merged is not None and not (drop_root and name not in children):
            _write(link, merged)
    return frames, noted


def _idle(joint: Element, carried: np.ndarray) -> bool:
    """Whether a joint moves no mass, or turns none about its axis: without it all the others move as with it."""
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if element is None else _numbers(element, "xyz")
    axis, spread = axis / (np.linalg.norm(axis) or 1.0), carried[:3, :3]
    turns = joint.get("type") in ("revolute", "continuous")
    return not carried.any() or bool(turns and abs(np.trace(spread) - axis @ spread @ axis) < LEAST_INERTIA)


def _held(own: np.ndarray, carried: np.ndarray, balance: bool) -> tuple[np.ndarray, str]:
    """(the sum of m p p^T of a moving link as bodies may have it, what was changed in words); those of all it carries.
    """
    mass, com = float(own[3, 3]), own[:3, 3] / own[3, 3] if own[3, 3] else np.zeros(3)
    central = own[:3, :3] - mass * np.outer(com, com)
    moments = np.linalg.eigvalsh(np.trace(central) * np.eye(3) - central)
    made, reason = own.copy(), ""
    excess = max(-moments[0], moments[2] - moments[0] - moments[1])
    if balance and excess > max(LEAST_INERTIA, 1e-12 * abs(moments[2])) and moments.mean() > LEAST_INERTIA and mass:
        made[:3, :3] += moments.mean() / 2 * np.eye(3) - central
        reason = f"has principal moments {np.array2string(moments, precision=3)}; each is replaced by their mean"
    elif abs(moments[0]) <= max(LEAST_INERTIA, 1e-12 * moments[2]):
        size = LIGHT * (float(np.trace(own[:3, :3])) or float(np.trace(carried[:3, :3])))
        made[:3, :3] += size * np.eye(3)
        if not mass:
            made[3, 3] += LIGHT * carried[3, 3]
        reason = f"has no {'inertia about an axis' if mass else 'mass'}: {LIGHT:g} of what it carries is added"
    return made, reason


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


def pose(origin: Element | None) -> np.ndarray:
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
        return None  # as urdfdom has it
    X, P = pose(inertial.find("origin")), np.zeros((4, 4))
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
