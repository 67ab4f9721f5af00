"""The corners of a mesh file, STL or OBJ."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from crosscheck.scene.schema import EntryError

_CORNER = re.compile(rb"^\s*(?:vertex|v)\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE)


def points(entry: str, path: Path) -> np.ndarray:
    """The corners (N, 3) of a mesh, each once; raises `EntryError` that names the entry if there are none."""
    mend = "give an STL or OBJ file"
    try:
        content = path.read_bytes()
    except OSError as error:
        raise EntryError(entry, f"{path} cannot be read, {(error.strerror or str(error)).lower()}", mend) from None
    count = int.from_bytes(content[80:84], "little")
    if path.suffix.lower() == ".stl" and len(content) == 84 + 50 * count:  # binary: normal, three corners, two bytes
        rows = np.frombuffer(content, np.uint8, offset=84).reshape(count, 50)[:, 12:48].tobytes()
        found = np.frombuffer(rows, "<f4").astype(float).reshape(-1, 3)
    else:
        try:
            found = np.array([[float(value) for value in corner] for corner in _CORNER.findall(content)]).reshape(-1, 3)
        except ValueError:
            found = np.empty((0, 3))
    if not len(found) or not np.isfinite(found).all():
        raise EntryError(entry, f"{path} has no corners of a mesh", mend)
    return np.unique(found, axis=0)
