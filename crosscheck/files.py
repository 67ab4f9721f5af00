"""Files as readers may meet them at any moment: whole, and in numbers that JSON knows."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def finite(value: Any) -> Any:
    """The same with None for every number that is not finite: JSON has no infinity, and no plot shows one."""
    if isinstance(value, Mapping):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def put(path: Path, text: str) -> None:
    """Write a file such that a reader sees the old one or the new one, never a part."""
    aside = path.with_name(f".{path.name}.new")
    aside.write_text(text, encoding="utf-8")
    os.replace(aside, path)
