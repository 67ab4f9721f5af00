"""Reads scene files, TOML or JSON. Anything wrong raises one error that names the file, the entry and the mend."""

from __future__ import annotations

import copy
import difflib
import functools
import json
import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from crosscheck.errors import ArgumentError, SceneError
from crosscheck.scene.building import printable
from crosscheck.scene.building import scene_from as scene_from
from crosscheck.scene.model import Scene
from crosscheck.scene.models import is_model, table
from crosscheck.scene.schema import Content, EntryError, listed, nearest

_SUFFIXES = (".toml", ".json")

MOST_BYTES = 64 * 2**20
"""Largest scene file: twenty times that of a chain of ten thousand bodies. Reading it takes a minute."""

MOST_DOTS = 32
"""Largest number of dots in one key; a scene needs one ("drive.type")."""

_KEY_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_DEEP_KEY = re.compile(rf"(?:^|[\[{{,])[ \t]*({_KEY_PART}(?:[ \t]*\.[ \t]*{_KEY_PART}){{{MOST_DOTS},}})", re.MULTILINE)


def scene_names() -> tuple[str, ...]:
    """Names of the built-in scenes, sorted."""
    return tuple(sorted(path.stem for path in _folder().glob("*.toml")))


def tagged(*tags: str) -> list[str]:
    """Names of the built-in scenes with one of these tags, as their files say, which are not checked."""
    return [name for name in (scene_names() if tags else ()) if set(tags) & set(read_scene(name)[1].get("tags", ()))]


_carried: dict[str, Content] = {}  # contents from another machine, by their names there


def carry(contents: Mapping[str, Content]) -> None:
    """From now on, in this process, scenes with these names have these contents, which came from another machine."""
    _carried.update(contents)


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """Read and check a scene.

    Parameters
    ----------
    name_or_path
        The name of a built-in scene, a path that ends in .toml or .json, or a model file (see
        `crosscheck.import_model`).

    Returns
    -------
    Scene
        With its complete initial state, which satisfies the joints to rounding level.

    Raises
    ------
    SceneError
        The scene is unknown, unreadable or wrong; the message names the file, the entry and the mend.
    ArgumentError
        `name_or_path` is neither text nor a path.
    """
    if isinstance(name_or_path, str) and name_or_path.isidentifier() and name_or_path not in _carried:
        path = _folder() / f"{name_or_path}.toml"
        if os.path.isfile(path):  # a name may be longer than one of a file
            return copy.deepcopy(_built_in(name_or_path, path.stat().st_mtime_ns))
    path, data = read_scene(name_or_path)
    return scene_from(data, path)


@functools.lru_cache(maxsize=256)
def _built_in(name: str, changed: int) -> Scene:
    """A built-in scene, read and checked once as long as its file stays; a copy costs a thirtieth of that."""
    path, data = read_scene(name)
    return scene_from(data, path)


def read_scene(name_or_path: str | os.PathLike[str]) -> tuple[Path, Content]:
    """The path of a scene and the content of its file before any check; arguments and errors as `load_scene`.

    A model file gives the content of the scene file it is imported as.
    """
    if isinstance(name_or_path, str) and name_or_path in _carried:
        return Path(name_or_path), copy.deepcopy(_carried[name_or_path])
    if is_model(name_or_path):
        return Path(name_or_path), table(name_or_path)
    if not isinstance(name_or_path, str | os.PathLike):
        raise ArgumentError(f"a scene is named by text or a path, not by {type(name_or_path).__name__}; "
                            f"the built-in scenes are {listed(scene_names())}")
    text = os.fsdecode(name_or_path)
    path = Path(text)
    if os.path.isdir(text or ".") and text not in scene_names():
        raise SceneError(f"{printable(text or '.')}: it is a folder; name a scene or model file in it")
    if path.suffix not in _SUFFIXES:
        if isinstance(name_or_path, os.PathLike) or path.name != text:
            raise SceneError(f"{printable(text)}: the name of the file: a scene file ends in .toml or .json; rename it")
        if text not in scene_names():
            near = difflib.get_close_matches(text, scene_names(), n=3, cutoff=0.0)
            raise SceneError(f'"{printable(text[:80])}": no built-in scene has this name; {nearest(text, near)}'
                             f"the nearest are {listed(near)}, `crosscheck list` names all; or write a path that ends "
                             "in .toml, .json, .xml or .urdf")
        path = _folder() / f"{text}.toml"
    try:
        return path, _read(path)
    except EntryError as error:
        raise SceneError(printable(f"{path}: {error}")) from None


def as_scene(scene: Scene | str | os.PathLike[str]) -> Scene:
    """`scene` itself, or the scene with this name or path.

    Raises
    ------
    ArgumentError
        It is none of the three.
    SceneError
        As `load_scene`.
    """
    if isinstance(scene, Scene):
        return scene
    if not isinstance(scene, str | os.PathLike):
        raise ArgumentError(f"scene: a Scene, the name of a built-in one or a path is wanted, not "
                            f"{type(scene).__name__}; the built-in scenes are {listed(scene_names())}")
    return load_scene(scene)


def _folder() -> Path:
    """The folder of the built-in scenes: in the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "scenarios"
    return inside if inside.is_dir() else package.parent / "scenarios"


def _read(path: Path) -> Content:
    """The content of a file; reads at most MOST_BYTES, and refuses pipes and devices."""
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise EntryError("the file", "is not a regular file", "give the path of a text file")
        with open(path, "rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise EntryError("the file", f"is larger than {MOST_BYTES >> 20} MB", "describe a smaller system, or build "
                             "the scene in Python")
        text = content.decode("utf-8-sig").replace("\r\n", "\n")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise EntryError("the file", f"cannot be read, {reason}",
                         "check the path; `crosscheck list` names the built-in scenes") from None
    except UnicodeDecodeError as error:
        raise EntryError("the file", f"byte {error.start} is not UTF-8", "save the file as UTF-8 text") from None
    except ValueError:  # a zero byte, or characters that no file system can hold
        raise EntryError("the name of the file", "no file can have it",
                         f"correct it, or write one of {listed(scene_names())}") from None
    try:
        # The time of Python's TOML reader grows as the square of the number of parts of a dotted key.
        if path.suffix == ".toml" and (deep := _DEEP_KEY.search(text)):
            line = text.count("\n", 0, deep.start(1)) + 1
            raise EntryError("syntax", f"line {line}: a key has more than {MOST_DOTS} dots",
                             "a scene has tables of keys and rows of numbers only")
        data = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text, object_pairs_hook=_distinct)
        json.dumps(data, ensure_ascii=False, default=str).encode()
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        kind = path.suffix[1:].upper()
        raise EntryError("syntax", f"not {kind}, {error}", f"write {kind} there") from None
    except UnicodeEncodeError:  # a lone surrogate, which only a JSON escape can write
        raise EntryError("syntax", "a \\ud800 to \\udfff escape stands alone, which is half a character",
                         "write the character itself") from None
    except ValueError:  # Python refuses to convert integers of thousands of digits
        raise EntryError("syntax", "a whole number has thousands of digits",
                         "write numbers as 1.5 or 1.5e6") from None
    except RecursionError:
        raise EntryError("syntax", "nested too deeply", "a scene has tables of keys and rows of numbers only") from None
    if not isinstance(data, dict):
        raise EntryError("the file", f"holds a {type(data).__name__}", "write one JSON object with the keys of a scene")
    return data


def _distinct(pairs: list[tuple[str, object]]) -> Content:
    """A JSON object as a mapping; raises if a key occurs twice, which TOML refuses too."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise EntryError(twice, "written twice in one JSON object", "keep one of the two")
    return table
