"""Broken and odd scene files, made from good ones by mutations that know the format."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.scene.file import load_scene
from crosscheck.scene.model import Scene
from tests import SCENARIOS
from tests.wrong_scenes import SCENE

TEXTS = tuple(path.read_text(encoding="utf-8") for path in sorted(SCENARIOS.glob("*.toml")))
TREES = tuple(json.dumps(tree) for tree in (SCENE, *(tomllib.loads(text) for text in TEXTS)))

NUMBERS = (0, -0.0, 1, -1, 2, 1e-300, 5e-324, 1e-16, 1e-8, 1e8, 1e99, 1e100, 1.1e100, -1e300, 1e308, 2**53 + 1, 2**64,
           10**400, float("nan"), float("inf"), -float("inf"), 0.1, 3.141592653589793)
WORDS = ("", " ", "ground", "arm", "revolute", "distance", "linear_spring", "world", "../x", "a\x00b", "\ud800", "\n",
         "é" * 300, "-1", "nan", "1.0", "fixed", "torsional_spring", "%s", "{0}")
OTHERS = (None, True, False, [], {}, [[]], [None], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
          [1e-200, 0, 0], {"name": 1}, {"type": []}, [{}])
KEYS = ("name", "type", "parent", "child", "mass", "inertia", "attitude", "position", "velocity", "length", "joint",
        "child_axis", "parent_axis", "assemble", "samples", "duration", "schema", "tags", "", "$", "a.b", "bodies",
        "forces")
TOKENS = ("=", "[", "]", "{", "}", '"', "'''", "#", "\n", ",", ".", "[[", "]]", "[[bodies]]", "[joints]", "nan", "inf",
          "1e999", "0x1", "1979-05-27", "07:32:00", "true", "-", "\\u0000", "\ufeff", "\x00", "é", "9" * 5000,
          "[" * 3000)


def judged(folder: Path, suffix: str, content: bytes) -> Scene | None:
    """The scene of a file, None if it is refused; neither may break a rule."""
    path = folder / f"fuzzed{suffix}"
    path.write_bytes(content)
    try:
        scene = load_scene(path)
    except SceneError as error:
        _judge_message(str(error), path)
        return None
    assert isinstance(scene, Scene)
    assert all(np.isfinite(values).all() for values in (scene.x0, scene.R0, scene.v0, scene.w0))
    return scene


def _judge_message(message: str, path: Path) -> None:
    name, _, rest = message.partition(": ")
    problem, _, mend = rest.partition("; ")
    assert message.isprintable(), "the message can be printed"
    assert name == str(path), "the message names the file"
    assert problem, "the message says what is wrong"
    assert mend, "the message says what to write"


def scene_file(random: Random) -> tuple[str, bytes]:
    """Suffix and content of one file: mutations of a scene's tree as JSON, or of its text as TOML."""
    if random.random() < 0.6:
        tree = json.loads(random.choice(TREES))
        for _ in range(random.randint(1, 4)):
            _mutate_tree(tree, random)
        return ".json", json.dumps(tree).encode()
    text = random.choice(TEXTS)
    for _ in range(random.randint(1, 4)):
        text = _mutate_text(text, random)
    content = text.encode("utf-8", "surrogatepass")
    return ".toml", _mutate_bytes(content, random) if random.random() < 0.2 else content


def _value(random: Random) -> Any:
    if random.random() < 0.1:
        return random.gauss(0, 1) * 10.0 ** random.randint(-120, 120)
    return copy.deepcopy(random.choice(random.choice((NUMBERS, WORDS, OTHERS))))


def _mutate_tree(tree: dict[str, Any], random: Random) -> None:
    node: Any = tree
    while True:  # down to some container
        children = node.values() if isinstance(node, dict) else node
        inner = [child for child in children if isinstance(child, dict | list)]
        if not inner or random.random() < 0.25:
            break
        node = random.choice(inner)
    places = list(node) if isinstance(node, dict) else list(range(len(node)))
    kind = random.choice(("replace", "nudge", "remove", "copy", "add", "swap"))
    if not places or kind == "add":
        if isinstance(node, dict):
            node[random.choice(KEYS)] = _value(random)
        else:
            node.insert(random.randint(0, len(node)), _value(random))
        return
    place = random.choice(places)
    if kind == "remove":
        del node[place]
    elif kind == "copy" and isinstance(node, list):
        node.append(copy.deepcopy(node[place]))
    elif kind == "swap":
        other = random.choice(places)
        node[place], node[other] = node[other], node[place]
    elif kind == "nudge" and isinstance(node[place], float):
        node[place] *= random.choice((-1.0, 1 + 1e-9, 1e-3, 1e3, 1e-60, 1e60))
    else:
        node[place] = _value(random)


def _mutate_text(text: str, random: Random) -> str:
    kind = random.choice(("token", "cut", "line", "number", "repeat"))
    if kind in ("line", "repeat"):
        lines = text.split("\n")
        at = random.randrange(len(lines))
        moved = lines[at] if kind == "repeat" else lines.pop(at)
        lines.insert(random.randint(0, len(lines)), moved)
        return "\n".join(lines)
    at = random.randint(0, len(text))
    if kind == "cut":
        return text[:at] + text[at + random.randint(1, 20):]
    if kind == "token":
        return text[:at] + random.choice(TOKENS) + text[at:]
    digits = [digit.start() for digit in re.finditer("[0-9]", text)]
    at = random.choice(digits) if digits else 0
    return text[:at] + str(random.choice(NUMBERS[:-6])) + text[at + 1:]


def _mutate_bytes(content: bytes, random: Random) -> bytes:
    changed = bytearray(content)
    for _ in range(random.randint(1, 5)):
        if changed:
            changed[random.randrange(len(changed))] = random.randrange(256)
    return bytes(changed)
