"""Truths stored on disk, one .npz per system, named by the key of the system and the version of the formulas."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import hashlib
import importlib.metadata
import json
import os
import pathlib
import re
import sys
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from crosscheck.files import cache_folder
from crosscheck.references.base import End, Piece
from crosscheck.references.dense_output import Truth
from crosscheck.references.modes import Part
from crosscheck.scene.model import Scene

_DIGEST = "digest"

SHARED = ("armature", "basics", "constraints", "contacts", "coordinates", "functions", "joints", "laws", "mechanics",
          "model", "spanning", "sparse", "states", "touching", "vectors")
"""Modules of `crosscheck.scene` that the formulas import, directly or not."""


@functools.cache
def formula_version() -> str:
    """Digest of the code that makes references, without what only explains it, and of the versions of its libraries.

    With it, results of an old formula are never used after an edit, even if nobody increases a version number.
    """
    here = pathlib.Path(__file__).parent
    shared = [here.parent / "scene" / f"{name}.py" for name in SHARED]
    digest = hashlib.sha256(_meaning([*sorted(here.glob("*.py")), *shared]).encode())
    for library in ("heyoka", "scipy", "coal"):
        try:
            digest.update(importlib.metadata.version(library).encode())
        except importlib.metadata.PackageNotFoundError:  # an extra
            digest.update(b"none")
    return digest.hexdigest()


def _meaning(sources: Sequence[pathlib.Path]) -> str:
    """Digest of what these modules do. Parsing takes a tenth of a second, so it is kept by the digest of the texts."""
    texts = [source.read_bytes() for source in sources]
    kept = cache_folder() / f"meaning-{hashlib.sha256(b''.join([sys.version.encode(), *texts])).hexdigest()[:24]}"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        if re.fullmatch("[0-9a-f]{64}", stored := kept.read_text()):
            return stored
    digest = hashlib.sha256()
    for text in texts:
        digest.update(meaning(text).encode())
    with contextlib.suppress(OSError):
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(digest.hexdigest())
    return digest.hexdigest()


def meaning(text: bytes | str) -> str:
    """The syntax tree of a module without docstrings, as text: comments and layout do not count either."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [each for each in node.body if not (isinstance(each, ast.Expr) and isinstance(
                each.value, ast.Constant))]
    return ast.dump(tree)


def path(scene: Scene) -> pathlib.Path:
    """File of the truth of a system."""
    return cache_folder() / f"{scene.key[:40]}-{formula_version()[:12]}.npz"


def load(scene: Scene, portable: bool) -> Truth | None:
    """The stored truth, or None if there is none that can be read."""
    try:
        with np.load(path(scene), allow_pickle=False) as stored:
            content = {name: stored[name] for name in stored.files}
        if str(content.pop(_DIGEST)) != _digest(content):
            raise ValueError("its content is not what was stored")
        return _restored(scene, portable, content)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        warnings.warn(f"the stored reference of {scene.name!r} cannot be read ({error}); it is computed anew",
                      stacklevel=3)
        return None


def _digest(content: dict[str, Any]) -> str:
    """SHA-256 of names, types, shapes and bytes."""
    digest = hashlib.sha256()
    for name in sorted(content):
        array = np.ascontiguousarray(content[name])
        digest.update(f"{name} {array.dtype.str} {np.shape(content[name])} ".encode() + array.tobytes())
    return digest.hexdigest()


def _content(truth: Truth) -> dict[str, np.ndarray]:
    """A truth as named arrays."""
    assert truth.end is not None
    content = {
        "start": [piece.start for piece in truth.pieces], "rest": [piece.rest for piece in truth.pieces],
        "length": [piece.length for piece in truth.pieces],
        "coefficients": np.array([piece.coefficients for piece in truth.pieces]),
        "modes": [] if truth.pieces[0].mode is None else np.array([piece.mode for piece in truth.pieces]),
        "growth": truth.growth, "sizes": truth.sizes, "defects": truth.defects, "end": truth.end.state,
        "end_time": [truth.end.time, truth.end.rest], "laws": _written(truth.end)}
    return {name: np.asarray(value) for name, value in content.items()}


def _written(end: End) -> str:
    """Mode, events and horizon of an end as text."""
    return json.dumps([[dataclasses.astuple(part) for part in end.mode], end.events, end.horizon, end.cause])


def _read_end(state: np.ndarray, times: np.ndarray, text: np.ndarray) -> End:
    parts, events, horizon, cause = json.loads(str(text))
    fields = [field.name for field in dataclasses.fields(Part)]
    values: list[dict[str, Any]] = [{name: tuple(value) if isinstance(value, list) else value
                                     for name, value in zip(fields, part, strict=True)} for part in parts]
    return End(state, float(times[0]), float(times[1]), tuple(Part(**each) for each in values),
               tuple((t, name, what) for t, name, what in events), horizon, cause)


def _restored(scene: Scene, portable: bool, content: dict[str, Any]) -> Truth:
    """The truth of this scene from named arrays."""
    truth = Truth(scene, portable)
    modes = content["modes"] if content["modes"].ndim == 2 else [None] * len(content["start"])
    truth.pieces = [Piece(*parts) for parts in zip(
        *(content[name].tolist() for name in ("start", "rest", "length")), content["coefficients"], modes, strict=True)]
    truth.end = _read_end(content["end"], content["end_time"], content["laws"])
    truth.growth, truth.sizes, truth.defects = (content[name] for name in ("growth", "sizes", "defects"))
    return truth


def store(truth: Truth) -> None:
    """Store a truth by writing a temporary file and renaming it, unless another command has stored a longer one.

    A failure, such as a full disk, only warns.
    """
    target = path(truth.scene)
    content = _content(truth)
    temporary = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=target.parent, suffix=".tmp", delete=False) as file:
            temporary = pathlib.Path(file.name)
            content |= {_DIGEST: np.asarray(_digest(content))}
            np.savez(file, **content)  # type: ignore[arg-type]
        if _stored_reach(target) > truth.reach:
            temporary.unlink()
        else:
            os.replace(temporary, target)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        warnings.warn(f"the reference of {truth.scene.name!r} cannot be stored in {target.parent} ({error}); "
                      "set CROSSCHECK_CACHE to a folder that can be written", stacklevel=2)


def _stored_reach(target: pathlib.Path) -> float:
    """The reach (s) of a stored truth; 0 if it cannot be read."""
    try:
        with np.load(target, allow_pickle=False) as stored:
            return float(stored["end_time"][0])
    except (OSError, ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile, zlib.error):
        return 0.0
