"""Reads the XML of a model file with its includes, before any engine does, and only from its own folder."""

from __future__ import annotations

import dataclasses
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from crosscheck.errors import SceneError, install, unknown

LARGEST = 64 * 2**20
"""Largest size of a model file, bytes; large robot descriptions have a hundredth of it."""

MOST_LINKS = 1000
"""Largest number of links of a URDF: a chain of so many takes MuJoCo's compiler 4 s, and the time grows as the cube."""

MOST_ELEMENTS, DEEPEST = 10**5, 400
"""Largest number of elements of a model after replication, and of nested levels; the engines' parsers stop at 500."""

MOST_NESTED = 32
"""Largest depth of files that include or attach others."""

LONGEST_NAME, MOST_RESERVED = 1000, 10**6
"""Most characters of a name, and the largest number in <size>, by which MuJoCo reserves memory."""


_NAMES = ("name", "class", "childclass", "model", "link", "joint", "body", "file")


class Node(Element):
    """An element that knows its line in the file."""

    line = 0
    file = ""  # the included file that it comes from; "" is the model itself


@dataclasses.dataclass
class Source:
    """A model as one XML tree, its includes expanded."""

    path: Path
    root: Element
    within: Path  # the folder of which files may be read

    @property
    def is_urdf(self) -> bool:
        """Whether the root says URDF."""
        return self.root.tag == "robot"

    @property
    def text(self) -> str:
        """The whole as XML, with every element on a line of its own, so that engines' line numbers count elements."""
        pieces: list[str] = []
        stack: list[Element | str] = [self.root]
        while stack:
            part = stack.pop()
            if isinstance(part, str):
                pieces.append(part)
                continue
            attributes = "".join(f" {key}={quoteattr(value)}" for key, value in part.items())
            pieces.append(f"\n<{part.tag}{attributes}>{escape((part.text or '').strip())}")
            stack += [f"</{part.tag}>", *reversed(part)]
        return "".join(pieces).lstrip("\n")

    def with_lines(self, words: str) -> str:
        """An engine's message about `text` with the lines of the file."""
        nodes = list(self.root.iter())

        def line(match: re.Match[str]) -> str:
            number = int(match[1])
            return place(nodes[number - 1]) if 0 < number <= len(nodes) else match[0]

        return re.sub(r"line (\d{1,9})", line, " ".join(words.split()).removeprefix("Error: "))

    def located(self, words: str) -> str:
        """A sentence with the line of the element that it names in quotes, if there is one."""
        if (name := re.search(r"'([^']+)'", words)) is None or "(line" in words:
            return words
        kind = "link" if self.is_urdf else "body"
        kinds = [tag for tag in ("joint", "actuator", "tendon", "equality", kind) if tag in words] or [kind]
        nodes = [node for node in self.root.iter() if node.get("name") == name[1] and node.tag != "site"]
        best = next((node for node in nodes if node.tag in kinds), nodes[0] if nodes else None)
        return words if best is None or not place(best) else f"{words} ({place(best)})"


def roots(model: Source) -> list[str]:
    """Names of the links of a URDF that are on no joint."""
    held = {child.get("link") for joint in model.root.findall("joint") for child in joint.findall("child")}
    return [name for link in model.root.findall("link") if (name := link.get("name", "")) not in held]


def hanging(model: Source, root: str) -> set[str]:
    """Names of the link `root` of a URDF and of those that hang on it."""
    ends = [["".join(each.get("link", "") for each in joint.findall(key)) for key in ("parent", "child")]
            for joint in model.root.findall("joint")]
    kept, count = {root}, 0
    while count < len(kept):
        count = len(kept)
        kept |= {child for parent, child in ends if parent in kept}
    return kept


def cut(model: Source, root: str) -> None:
    """Keep only the link or body `root`, and what hangs on it; raises `SceneError` if there is none."""
    if model.is_urdf:
        names = [link.get("name", "") for link in model.root.findall("link")]
        kept = hanging(model, root)
        away = [link for link in model.root.findall("link") if link.get("name") not in kept]
        away += [joint for joint in model.root.findall("joint")
                 if not any(end.get("link") in kept for end in joint.findall("parent"))]
        holder = model.root
    else:
        tops = [body for world in model.root.findall("worldbody") for body in world.findall("body")]
        names = [body.get("name", "") for body in tops]
        away = [body for body in tops if body.get("name") != root]
        holder = next(iter(model.root.findall("worldbody")), model.root)
    if root not in names:
        raise SceneError(f"{model.path}: {unknown('root', root, names)}")
    for element in away:
        holder.remove(element)


def place(element: Element) -> str:
    """The line of an element in words; "" if it comes from no file."""
    line, file = getattr(element, "line", 0), getattr(element, "file", "")
    return f"line {line}{f' of {file}' if file else ''}" if line else ""


def label(element: Element) -> str:
    """An element in words: its tag, name and line."""
    name = f" {element.get('name')!r}" if element.get("name") else ""
    return f"<{element.tag}>{name}" + (f" ({place(element)})" if place(element) else "")


def read(path: Path, sdf: bool = False, within: str | os.PathLike[str] | None = None) -> Source:
    """The model in `path`, with checks of its XML; with `sdf` also one of SDF. Raises `SceneError` with one line.

    Files of the folder `within` may be read, by default those of the model's folder.
    """
    if path.suffix.lower() == ".xacro":
        raise SceneError(f"{path}: a xacro file is a program that writes a URDF; run it first (xacro {path.name} > "
                         f"{path.stem}.urdf) and give the URDF")
    if path.suffix.lower().startswith(".usd"):
        raise SceneError(f"{path}: a USD file is only read by engines, for `crosscheck inspect`; convert it to URDF")
    root = _parsed(path)
    _check_size(path, root)
    _check_reserved(path, root)
    macro = next((node for node in root.iter() if "xacro:" in node.tag), None)
    if root.tag == "robot" and macro is not None:
        raise SceneError(f"{path}: {place(macro)} is a xacro element; run xacro first and give the URDF that it writes")
    if root.tag == "sdf" and not sdf:
        raise SceneError(f"{path}: an SDF file is read by engines alone, for `crosscheck inspect {path}` after "
                         f"{install('drake')}; a scene is made of a URDF or MJCF")
    if root.tag not in ("mujoco", "robot", "sdf"):
        raise SceneError(f"{path}: the root element is <{root.tag}>; a model file begins with <mujoco> or <robot>")
    if root.tag == "robot" and (count := len(root.findall("link"))) > MOST_LINKS:
        raise SceneError(f"{path}: has {count} links, at most {MOST_LINKS} are read; merge those on fixed joints")
    inside = path.parent.resolve() if within is None else Path(within).resolve()
    if root.tag == "mujoco":
        _expand(path, root, inside, (path.resolve(),))
        for option in root.iter("option"):
            option.attrib.pop("apirate", None)  # of a remote control; MuJoCo 4 no longer takes it
        _check_size(path, root)
    return Source(path, root, inside)


def _parsed(path: Path) -> Node:
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
    return _tree(path, data)


def _tree(path: Path, data: bytes) -> Node:
    """The tree of an XML text with the line of each element; a document type is refused in every encoding."""
    parser, builder = expat.ParserCreate(), TreeBuilder(element_factory=Node)
    parser.buffer_text = True

    def refuse(*_: object) -> None:
        raise SceneError(f"{path}: line {parser.CurrentLineNumber} declares a document type or entities, which no "
                         "model needs and which can read other files; remove the declaration")

    def start(tag: str, attributes: dict[str, str]) -> None:
        name = next((value for key, value in attributes.items() if key in _NAMES and len(value) > LONGEST_NAME
                     and not (key == "body" and tag == "flex")), None)  # that is a list of them
        if name is not None:
            raise SceneError(f"{path}: line {parser.CurrentLineNumber}: a name has {len(name)} characters; at most "
                             f"{LONGEST_NAME} are taken, shorten it")
        node = builder.start(tag, attributes)
        assert isinstance(node, Node)
        node.line = parser.CurrentLineNumber

    if late := re.match(rb"((?:\s|(?><!--.*?-->))+)<\?xml[^>]*\?>", data, re.DOTALL):  # which other parsers take
        data = late[1] + data[late.end():]
    data = data.rstrip(b"\0 \r\n\t")
    parser.StartDoctypeDeclHandler, parser.EntityDeclHandler = refuse, refuse
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, builder.end, builder.data
    try:
        parser.Parse(data, True)
        root = builder.close()
    except (expat.ExpatError, AssertionError, ValueError, LookupError) as error:
        raise SceneError(f"{path}: not XML, {' '.join(str(error).split())[:120]}; correct it there") from None
    assert isinstance(root, Node)
    return root


def _check_size(path: Path, root: Element) -> None:
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


def _check_reserved(path: Path, root: Element) -> None:
    """Raise if <size> would make MuJoCo reserve memory for more than any model has."""
    for size in root.iter("size"):
        for key, value in size.items():
            if key.startswith("n") and value.strip().isdecimal() and int(value.strip()[:10]) > MOST_RESERVED:
                raise SceneError(f"{path}: {place(size)}: {key} reserves room for {value[:20]} entries, more than "
                                 f"{MOST_RESERVED}; lower it")


def _copies(element: Element) -> int:
    """How often MuJoCo repeats the content of an element."""
    count = 1
    for word in element.get("count", "").split() if element.tag in ("replicate", "composite", "flexcomp") else ():
        count *= int(word[:10]) if word.isdecimal() else 1  # a number of ten digits is too large anyway
    return count


def bare(path: Path, sdf: bool = False) -> Source:
    """`read` without the shapes of links, whose meshes may be anywhere."""
    model = read(path, sdf)
    for link in [*model.root.iter("link")]:
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return model


def files(model: Source) -> Iterator[tuple[Element, str, Path | None]]:
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
                yield element, name, target if target.is_relative_to(model.within) else None


def nested(model: Source, depth: int = 1) -> Iterator[Source]:
    """The models that an MJCF attaches, and those that they attach; raises `SceneError` for one outside its folder."""
    for element, name, target in files(model):
        if element.tag == "model":
            if target is None:
                raise outside(model.path, name)
            if depth > MOST_NESTED:
                raise SceneError(f"{model.path}: attaches models more than {MOST_NESTED} deep; flatten them")
            inner = read(target, within=model.within)
            yield inner
            yield from nested(inner, depth + 1)


def outside(path: Path, name: str) -> SceneError:
    """The error that a model refers to a file outside its folder."""
    return SceneError(f"{path}: refers to {name}, which is outside its folder; move it beside the model, or "
                      "give --within FOLDER, one above both")


def _expand(path: Path, element: Element, within: Path, above: tuple[Path, ...]) -> None:
    """Replace every <include> by the content of its file, which is in the folder `within`."""
    for index, child in reversed(list(enumerate(element))):
        if child.tag != "include":
            _expand(path, child, within, above)
            continue
        name = child.get("file", "")
        if not name:
            raise SceneError(f"{path}: an <include> names no file; give it one or remove it")
        target = (path.parent / name).resolve()
        if not target.is_relative_to(within):
            raise outside(path, name)
        if target in above:
            raise SceneError(f"{path}: includes {name} in a circle; remove one of the includes")
        if len(above) > MOST_NESTED:
            raise SceneError(f"{path}: includes are nested more than {MOST_NESTED} deep; flatten them")
        included = _parsed(target)
        for node in included.iter():
            assert isinstance(node, Node)
            node.file = name
        _check_size(target, included)
        _expand(path, included, within, (*above, target))
        element.remove(child)
        for offset, each in enumerate(included):
            element.insert(index + offset, each)
