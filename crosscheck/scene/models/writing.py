"""Writes the content of a scene file as TOML; numbers keep every bit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml(content: Mapping[str, Any]) -> str:
    """The text of a scene file from its plain mapping."""
    lines = [f"{key} = {_value(value)}" for key, value in content.items() if key not in ("bodies", "joints", "forces")]
    for group in ("bodies", "joints", "forces"):
        for table in content.get(group, []):
            lines += ["", f"[[{group}]]", *(f"{key} = {_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)
