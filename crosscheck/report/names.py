"""File names of the pages, and anchors on them."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from crosscheck.document import Record, Scene

STUDIES = {"convergence": "Convergence", "speed": "Speed against error", "conservation": "Energy and constraints",
           "coarse": "At a coarse step"}
"""Titles of the studies by the keys in their file names."""


def slug(text: str) -> str:
    """Text as a part of a file name or an anchor."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-") or "scene"


def anchor(record: Record) -> str:
    """The anchor of a run on the page of its scene."""
    return slug(f"run {record.label}")


def _part(name: str) -> str:
    """A name as a part of a file name. Different names give different parts.

    For this, a part of a checksum is added to names that lose letters, such as paths, and to names with capital
    letters, which some file systems ignore.
    """
    part = slug(Path(name).stem if name.endswith((".toml", ".json")) else name)
    if part == name == name.lower():
        return part
    return f"{part}-{hashlib.sha256(name.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def scene_file(scene: Scene) -> str:
    """File name of a scene's page."""
    return f"scene-{_part(scene.name)}.html"


def data_file(scene: Scene) -> str:
    """File name of a scene's curves."""
    return f"scene-{_part(scene.name)}.js"


def engine_file(name: str) -> str:
    """File name of an engine's page."""
    return f"engine-{_part(name)}.html"


def study_file(key: str) -> str:
    """File name of a study's page."""
    return f"study-{key}.html"
