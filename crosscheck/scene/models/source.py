"""Reads the XML of a model file with its includes, before any engine does, and only from its own folder."""

from __future__ import annotations

import dataclasses
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from crosscheck.errors import SceneError

LARGEST = 64 * 2**20
"""Largest size of a model file, bytes; large robot descriptions have a hundredth of it."""

MOST_ELEMENTS, DEEPEST = 10**5, 400
"""Largest number of elements of a model after replication, and of nested levels; the engines' parsers stop at 500."""


@dataclasses.dataclass
class Source:
    """A model as one XML tree, its includes expanded."""

    path: Path
    root: ElementTree.Element

    @property
    def is_urdf(self) -> bool:
        """Whether the root says URDF."""
        return self.root.tag == "robot"

    @property
    def text(self) -> str:
        """The whole as XML."""
        return ElementTree.tostring(self.root, encoding="unicode")


def read(path: Path) -> Source:
    """The model in `path`, with checks of its XML; raises `SceneError` with one line."""
    if path.suffix.lower() == ".xacro":
        raise SceneError(f"{path}: a xacro file is a program that writes a URDF; run it first (xacro {path.name} > "
                         f"{path.stem}.urdf) and give the URDF")
    root = _parsed(path)
    _check_size(path, root)
    if root.tag == "robot" and re.search(rb"<xacro:", re.sub(rb"<!--.*?-->", b"", path.read_bytes(), flags=re.DOTALL)):
        raise SceneError(f"{path}: holds xacro elements; run xacro first and give the URDF that it writes")
    if root.tag not in ("mujoco", "robot"):
        raise SceneError(f"{path}: the root element is <{root.tag}>; a model file begins with <mujoco> or <robot>")
    if root.tag == "mujoco":
        _expand(path, root, path.parent.resolve(), (path.resolve(),))
        _check_size(path, root)
    return Source(path, root)


def _parsed(path: Path) -> ElementTree.Element:
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise SceneError(f"{path}: cannot be read, is no file; check the path")
        size = about.st_size
        if size > LARGEST:
            raise SceneError(f"{path}: has {size / 2**20:.0f} MB, more than any model; check the path")
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read, {(error.strerror or str(error)).lower()}; check the path") from None
    except ValueError:
        raise SceneError(f"{path!s}: no file can have this name; correct it") from None
    if re.search(rb"<!(DOCTYPE|ENTITY)", data, re.IGNORECASE):
        raise SceneError(f"{path}: declares a document type or entities, which no model needs and which can read other "
                         "files; remove the declaration")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SceneError(f"{path}: not XML, {' '.join(str(error).split())[:120]}; correct it there") from None
    return root


def _check_size(path: Path, root: ElementTree.Element) -> None:
    """Raise if elements are nested too deep, or are too many after <replicate> and the like are expanded."""
    total, level = 0, [(root, 1)]
    for _ in range(DEEPEST):
        total += sum(times for _, times in level)
        if not level or total > MOST_ELEMENTS:
            break
        level = [(child, times * _copies(child)) for element, times in level for child in element]
    if total > MOST_ELEMENTS:
        raise SceneError(f"{path}: has or makes more than {MOST_ELEMENTS} elements, more than a model; check the path")
    if level:
        raise SceneError(f"{path}: elements are nested more than {DEEPEST} deep, no engine reads that; flatten them")


def _copies(element: ElementTree.Element) -> int:
    """How often MuJoCo repeats the content of an element."""
    found = 1
    for word in element.get("count", "").split() if element.tag in ("replicate", "composite", "flexcomp") else ():
        found *= int(word[:10]) if word.isdecimal() else 1  # a number of ten digits is too large anyway
    return found


def files(model: Source) -> Iterator[tuple[ElementTree.Element, str, Path | None]]:
    """(element, name, path or None if outside the model's folder) of all files to which a model refers.

    A URDF has none, because MuJoCo strips their paths, unless the file forbids that.
    """
    folder = model.path.parent.resolve()
    compilers = list(model.root.iter("compiler"))
    if model.is_urdf and not any(each.get("strippath") == "false" for each in compilers):
        return
    places = {key: next((each.get(key, "") for each in reversed(compilers) if each.get(key)), "")
              for key in ("assetdir", "meshdir", "texturedir")}
    for element in model.root.iter():
        key = {"texture": "texturedir", "model": ""}.get(element.tag, "meshdir")
        place = key and (places[key] or places["assetdir"])
        for attribute, name in element.items():
            if attribute.startswith("file"):
                target = (folder / place / name).resolve()
                yield element, name, target if target.is_relative_to(folder) else None


def inside(path: Path, folder: Path, name: str) -> Path:
    """The path of the file `name` in a model; raises `SceneError` if it lies outside the model's folder."""
    found = (folder / name).resolve()
    if not found.is_relative_to(folder):
        raise outside(path, name)
    return found


def outside(path: Path, name: str) -> SceneError:
    """The error that a model refers to a file outside its folder."""
    return SceneError(f"{path}: refers to {name}, which is outside its folder; move it beside the model")


def _expand(path: Path, element: ElementTree.Element, folder: Path, above: tuple[Path, ...]) -> None:
    """Replace every <include> by the content of its file."""
    for index, child in reversed(list(enumerate(element))):
        if child.tag != "include":
            _expand(path, child, folder, above)
            continue
        name = child.get("file", "")
        if not name:
            raise SceneError(f"{path}: an <include> names no file; give it one or remove it")
        target = inside(path, folder, name)
        if target in above:
            raise SceneError(f"{path}: includes {name} in a circle; remove one of the includes")
        if len(above) > 32:
            raise SceneError(f"{path}: includes are nested more than 32 deep; flatten them")
        included = _parsed(target)
        _check_size(target, included)
        _expand(path, included, folder, (*above, target))
        element.remove(child)
        for offset, each in enumerate(included):
            element.insert(index + offset, each)
