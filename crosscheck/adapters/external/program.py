"""A program as an engine: any executable that reads a scene from a file and writes the states to another one.

An engine is such a program if its name is a command with `{out}` in it:

    [order=4] [name=top] [eps=1.2e-7] [elements=function,armature] PROGRAM ... {scene} {step} {out}

Words before the program declare what a class of the user would. In the others

- `{scene}` is a JSON file, see `crosscheck.scene.model.Scene.json`; `{mjcf}` is an MJCF file of the same system,
- `{step}` is the fixed step (s), or `{rtol}` the tolerance of an adaptive method,
- `{out}` is the file for the states at the scene's output times. As CSV it has the columns of `crosscheck run --csv`;
  needed are t, x, v, w, and R_11 ... R_33 or the quaternion q_w, q_x, q_y, q_z (body to world). As NPZ it has the
  arrays t, x (T, n, 3), v, w, and R (T, n, 3, 3) or q (T, n, 4).

The program ends with 0; with 3 and a line on standard error if it does not know something in the scene.
"""

from __future__ import annotations

import csv
import hashlib
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from crosscheck.adapters.base import RunSpec
from crosscheck.errors import ArgumentError, EngineError, Unsupported, brief
from crosscheck.scene.laws import FORCE_TYPES
from crosscheck.scene.model import ELEMENTS, Scene, rotation_from_quaternion
from crosscheck.scene.states import COLUMNS, States

FORM = "[order=4] PROGRAM ... {scene} {step} {out}"
REFUSED = 3
"""The exit code of a program that does not know something in the scene."""


def is_program(name: str) -> bool:
    """Whether an engine of this name is a program."""
    return "{out}" in name


class Program:
    """An engine in the sense of `crosscheck.adapters.external.own`. Raises `ArgumentError` for a wrong command."""

    def __init__(self, command: str) -> None:
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise ArgumentError(f"engine: {command!r}: {error}; write it as {FORM}") from None
        declared: dict[str, str] = {}
        while words and (key := words[0].partition("=")[0]) in ("order", "name", "eps", "elements") and "=" in words[0]:
            declared[key] = words.pop(0).partition("=")[2]
        self._words = words
        steps = [each for each in ("{step}", "{rtol}") if each in command]
        if not words or len(steps) != 1 or not any(each in command for each in ("{scene}", "{mjcf}")):
            raise ArgumentError(f"engine: {command!r}: a program gets {{scene}} or {{mjcf}}, {{step}} or {{rtol}}, and "
                                f"{{out}}; write it as {FORM}")
        if shutil.which(words[0]) is None:
            raise ArgumentError(f"engine: there is no program {words[0]!r}; give its path")
        self.name = declared.get("name") or Path(words[0]).stem
        self.methods = ("fixed",) if steps == ["{step}"] else ("adaptive",)
        self.adaptive_methods = () if steps == ["{step}"] else self.methods
        self.elements = tuple(each for each in declared.get("elements", "").split(",") if each)
        if unknown := set(self.elements) - {*ELEMENTS, *FORCE_TYPES}:
            raise ArgumentError(f"engine: {command!r}: elements: {', '.join(sorted(unknown))}; there are: "
                                f"{', '.join(ELEMENTS)}")
        try:
            self.orders = {"fixed": int(declared["order"])} if "order" in declared else {}
            self.eps = float(declared.get("eps", 2.0**-52))
        except ValueError as error:
            raise ArgumentError(f"engine: {command!r}: order and eps: {error}") from None

    def digest(self) -> str:
        """Eight hexadecimal digits of the program and of the files among its words."""
        files = [shutil.which(self._words[0]), *self._words[1:]]
        return hashlib.sha256(b"".join(Path(each).read_bytes() for each in files
                                       if each and os.path.isfile(each))).hexdigest()[:8]

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """What the program itself refuses shows when it runs."""
        return None

    def run(self, scene: Scene, spec: RunSpec) -> States:
        """The states that the program writes; raises `Unsupported` and `EngineError`."""
        with tempfile.TemporaryDirectory() as folder:
            names = {"{scene}": "scene.json", "{mjcf}": "scene.xml", "{out}": "states"}
            values = {word: str(Path(folder) / name) for word, name in names.items()}
            self._write(scene, values)
            values |= {"{step}": repr(spec.step), "{rtol}": repr(spec.rtol or 1e-6)}
            ended = subprocess.run([_filled(word, values) for word in self._words], capture_output=True, text=True,
                                   errors="replace", stdin=subprocess.DEVNULL)
            said = brief(([*ended.stderr.split("\n"), *ended.stdout.split("\n")] if ended.returncode else [""])[0]
                         or "it says nothing")
            if ended.returncode == REFUSED:
                raise Unsupported(f"{self.name}: {said}")
            if ended.returncode:
                raise EngineError(f"{self.name}: the program ended with {ended.returncode}: {said}")
            return read_states(self.name, scene, Path(values["{out}"]))

    def _write(self, scene: Scene, paths: Mapping[str, str]) -> None:
        if any("{scene}" in word for word in self._words):
            Path(paths["{scene}"]).write_text(scene.json(), encoding="utf-8")
        if any("{mjcf}" in word for word in self._words):
            from crosscheck.scene.models.writing import mjcf

            ElementTree.ElementTree(mjcf(scene)).write(paths["{mjcf}"])


def read_states(who: str, scene: Scene, path: Path) -> States:
    """The states in a file, CSV or NPZ; raises `EngineError` that names `who` wrote it."""
    try:
        if path.with_suffix(".npz").exists() or path.read_bytes()[:2] == b"PK":
            with np.load(path.with_suffix(".npz") if not path.exists() else path, allow_pickle=False) as kept:
                table: dict[str, Any] = dict(kept)
        else:
            table = _columns(scene, path)
        R = table["R"] if "R" in table else rotation_from_quaternion(np.asarray(table["q"], dtype=float))
        return States(table["t"], table["x"], R, table["v"], table["w"])
    except FileNotFoundError:
        raise EngineError(f"{who} wrote no file of states") from None
    except KeyError as error:
        raise EngineError(f"{who}: the file of states has no {error.args[0]!r}; t, x, v, w and R or q are needed for "
                          "each body") from None
    except (ValueError, OSError, StopIteration) as error:
        raise EngineError(f"{who}: the states cannot be read: {brief(str(error))}") from None


def _filled(word: str, values: Mapping[str, str]) -> str:
    for name, value in values.items():
        word = word.replace(name, value)
    return word


def _columns(scene: Scene, path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="", encoding="utf-8") as stream:
        header, *rows = (row for row in csv.reader(stream) if row)
    titles = {title.partition(" [")[0].strip(): number for number, title in enumerate(header)}
    values = np.array(rows, dtype=float)
    wanted = {key: names for key, (names, _) in COLUMNS.items()}
    if f"{scene.bodies[0].name} {wanted['R'][0]}" not in titles:
        del wanted["R"]
        wanted["q"] = tuple(f"q_{axis}" for axis in "wxyz")
    table = {"t": values[:, titles["t"]]}
    for key, names in wanted.items():
        table[key] = np.stack([values[:, [titles[f"{body.name} {name}"] for name in names]] for body in scene.bodies],
                              axis=1)
    if "R" in table:
        table["R"] = table["R"].reshape(-1, scene.n, 3, 3)
    return table
