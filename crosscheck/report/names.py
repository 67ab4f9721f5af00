"""File names and anchors of the pages."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from crosscheck.document import Record, Scene

STUDIES = {"convergence": "Convergence", "speed": "Speed against error", "conservation": "Energy and constraints",
           "coarse": "At a coarse step"}
"""Studies by the key in their file names; their titles."""


def slug(text: str) -> str:
    """Text as a part of a file name or an anchor."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-") or "scene"


def anchor(record: Record) -> str:
    """The place of a run on the page of its scene."""
    return slug(f"run {record.label}")


def _part(name: str) -> str:
    """A name as part of a file name, different for every name.

    Names that lose letters on the way, such as paths, get a piece of their checksum; so do those that a file system
    which ignores capitals could take for another's.
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
