"""References stored on disk, one .npz per scene, named by the scene's hash and the version of the formulas."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.metadata
import os
import pathlib
import tempfile
import warnings
import zipfile
import zlib
from typing import Any

import numpy as np

from crosscheck.files import cache_folder
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

_STATES = ("t", "x", "R", "v", "w", "a", "alpha")
_OTHERS = tuple(field.name for field in dataclasses.fields(Reference) if field.name != "states")
_TEXT = ("source", "second_source")
_DIGEST = "digest"
_ARRAYS = ("position_derivatives", "attitude_derivatives")


SHARED = ("functions", "joints", "laws", "model", "states")
"""Modules of `crosscheck.scene` that the formulas import, directly or not."""


@functools.cache
def formula_version() -> str:
    """Digest of the code that makes references and of the versions of its libraries.

    With it, results of an old formula are never used after an edit, even if nobody increases a version number.
    """
    digest = hashlib.sha256()
    here = pathlib.Path(__file__).parent
    shared = [here.parent / "scene" / f"{name}.py" for name in SHARED]
    for source in [*sorted(here.glob("*.py")), *shared]:
        digest.update(source.read_bytes())
    for library in ("heyoka", "scipy", "mpmath"):
        try:
            digest.update(importlib.metadata.version(library).encode())
        except importlib.metadata.PackageNotFoundError:  # an extra
            digest.update(b"none")
    return digest.hexdigest()


def path(scene: Scene) -> pathlib.Path:
    """File of a scene's reference."""
    return cache_folder() / f"{scene.hash[:40]}-{formula_version()[:12]}.npz"


def load(scene: Scene) -> Reference | None:
    """The stored reference, or None if there is none that can be read."""
    try:
        with np.load(path(scene), allow_pickle=False) as stored:
            content = {name: stored[name] for name in (*_STATES, *_OTHERS)}
            if str(stored[_DIGEST]) != _digest(content):
                raise ValueError("its content is not what was stored")
        _check(scene, content)
        states = States(*(content[name] for name in _STATES))
        others = {name: content[name] if name in _ARRAYS else content[name].item() for name in _OTHERS}
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        warnings.warn(f"the stored reference of {scene.name!r} cannot be read ({error}); it is computed anew",
                      stacklevel=2)
        return None
    return Reference(states, **others)


def _digest(content: dict[str, Any]) -> str:
    """SHA-256 of names, types, shapes and bytes."""
    digest = hashlib.sha256()
    for name in sorted(content):
        array = np.ascontiguousarray(content[name])
        digest.update(f"{name} {array.dtype.str} {np.shape(content[name])} ".encode() + array.tobytes())
    return digest.hexdigest()


def _check(scene: Scene, content: dict[str, Any]) -> None:
    """Raise `ValueError` if the content cannot be a reference of this scene."""
    vectors, count = (scene.samples, scene.n, 3), len(content["position_derivatives"])
    shapes = dict.fromkeys(("x", "v", "w", "a", "alpha"), vectors) | {
        "t": (scene.samples,), "R": (*vectors, 3)} | dict.fromkeys(_ARRAYS, (count,))
    for name, value in content.items():
        if name in shapes and (value.shape != shapes[name] or value.dtype != np.float64
                               or not (name in _ARRAYS or np.isfinite(value).all())):
            raise ValueError(f"{name} is not finite or not of shape {shapes[name]}")
        if name not in shapes and value.shape != ():
            raise ValueError(f"{name} is not a single value")
    if not np.array_equal(content["t"], scene.t):
        raise ValueError("its times are not those of the scene")
    start = max(np.abs(content["x"][0] - scene.x0).max(), np.abs(content["R"][0] - scene.R0).max())
    if start > 1e-9 * max(1.0, np.abs(scene.x0).max()):  # a reference starts where the scene does, to rounding
        raise ValueError("it starts elsewhere than the scene")


def store(scene: Scene, reference: Reference) -> None:
    """Store a reference by writing a temporary file and renaming it; a failure, such as a full disk, only warns."""
    target = path(scene)
    content: dict[str, Any] = {name: getattr(reference.states, name) for name in _STATES}
    content |= {name: getattr(reference, name) for name in _OTHERS}
    content = {name: np.asarray(value) for name, value in content.items()}
    temporary = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=target.parent, suffix=".tmp", delete=False) as file:
            temporary = pathlib.Path(file.name)
            np.savez(file, **(content | {_DIGEST: np.asarray(_digest(content))}))
        os.replace(temporary, target)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        warnings.warn(f"the reference of {scene.name!r} cannot be stored in {target.parent} ({error}); "
                      "set CROSSCHECK_CACHE to a folder that can be written", stacklevel=2)
