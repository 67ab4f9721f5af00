"""Builds a scene from the plain content of a scene file: checks it, completes its state and closes its joints."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.scene import assembly, checks
from crosscheck.scene.model import Scene
from crosscheck.scene.schema import Content, EntryError, decode


def scene_from(data: Content, origin: str | os.PathLike[str]) -> Scene:
    """The scene with this content of a file; raises `SceneError`, which names `origin`, the entry and the mend."""
    try:
        scene = _assembled(checks.draft(decode(data), Path(origin).parent))
        checks.check_start(scene)
        checks.check_touching(scene)
        return scene.replace(file=(os.fsdecode(origin), json.dumps(data)))
    except EntryError as error:
        raise SceneError(printable(f"{os.fsdecode(origin)}: {error}")) from None


def _assembled(draft: checks.Draft) -> Scene:
    """The scene with its joints closed; raises if its numbers together exceed what double precision can solve."""
    problem = "the numbers of this scene differ too much in size to close its joints in double precision"
    mend = "bring masses, inertias and lengths nearer to each other, in SI units"
    with np.errstate(all="ignore"):  # overflow is detected below
        try:
            scene = assembly.completed(draft)
        except (np.linalg.LinAlgError, FloatingPointError, OverflowError):
            raise EntryError("bodies", problem, mend) from None
    if not all(np.isfinite(values).all() for values in (scene.x0, scene.R0, scene.v0, scene.w0)):
        raise EntryError("bodies", problem, mend)
    return scene


def printable(text: str) -> str:
    """The text with escapes for characters that would break its line or cannot be printed."""
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text)
