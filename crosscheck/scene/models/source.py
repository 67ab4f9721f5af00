"""The text of a model file before any engine sees it: readable XML, its includes, nothing outside its folder."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from xml.etree import ElementTree

from crosscheck.errors import SceneError

LARGEST = 64 * 2**20
"""Bytes of a model file; the largest robot descriptions have a hundredth of it."""

MOST_ELEMENTS = 10**6


@dataclasses.dataclass
class Source:
    """A model as one XML tree, its includes expanded."""

    path: Path
    root: ElementTree.Element
    ignored: list[str] = dataclasses.field(default_factory=list)  # files that are missing and not needed

    @property
    def is_urdf(self) -> bool:
        """Whether the root says URDF."""
        return self.root.tag == "robot"

    @property
    def text(self) -> str:
        """The whole as XML."""
        return ElementTree.tostring(self.root, encoding="unicode")


def read(path: Path) -> Source:
    """The model in `path`, checked as far as XML goes; raises `SceneError` with one line."""
    if path.suffix.lower() == ".xacro":
        raise SceneError(f"{path}: a xacro file is a program that writes a URDF; run it first (xacro {path.name} > "
                         f"{path.stem}.urdf) and give the URDF")
    root = _parsed(path)
    if root.tag not in ("mujoco", "robot"):
        raise SceneError(f"{path}: the root element is <{root.tag}>; a model file begins with <mujoco> or <robot>")
    if root.tag == "robot":
        if b"xacro:" in path.read_bytes():
            raise SceneError(f"{path}: holds xacro elements; run xacro first and give the URDF that it writes")
    else:
        _expand(path, root, path.parent.resolve(), (path.resolve(),))
    return Source(path, root)


def _parsed(path: Path) -> ElementTree.Element:
    try:
        size = path.stat().st_size
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
    if sum(1 for _ in root.iter()) > MOST_ELEMENTS:
        raise SceneError(f"{path}: has more than {MOST_ELEMENTS} elements, more than any model; check the path")
    return root


def inside(path: Path, folder: Path, name: str) -> Path:
    """The file that `name` in the model stands for; raises `SceneError` where it lies outside the model's folder."""
    found = (folder / name).resolve()
    if not found.is_relative_to(folder):
        raise SceneError(f"{path}: refers to {name}, which is outside its folder; move it beside the model")
    return found


def _expand(path: Path, element: ElementTree.Element, folder: Path, above: tuple[Path, ...]) -> None:
    """Replace every <include> by the content of its file."""
    for index, child in reversed(list(enumerate(element))):
        if child.tag != "include":
            _expand(path, child, folder, above)
            continue
        name = child.get("file", "")
        target = inside(path, folder, name)
        if target in above:
            raise SceneError(f"{path}: includes {name} in a circle; remove one of the includes")
        if len(above) > 32:
            raise SceneError(f"{path}: includes are nested more than 32 deep; flatten them")
        included = _parsed(target)
        _expand(path, included, folder, (*above, target))
        element.remove(child)
        for offset, each in enumerate(included):
            element.insert(index + offset, each)
