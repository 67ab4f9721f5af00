"""Files that are replaced as a whole, and values as JSON has them."""

from __future__ import annotations

import contextlib
import math
import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

_UNREADABLE = re.compile("[\\x00-\\x08\\x0b\\x0c\\x0e-\\x1f\\ud800-\\udfff\\ufffe\\uffff]")


def readable(text: str) -> str:
    """The text with escapes for what no encoding, XML or database takes: control characters, halves of characters."""
    return _UNREADABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def finite(value: Any) -> Any:
    """The same as any file can hold it: texts `readable`, None for numbers that are not finite.

    JSON has no infinity, and no plot shows one.
    """
    if isinstance(value, Mapping):
        return {finite(key): finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    if isinstance(value, str):
        return readable(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def plain(value: Any) -> Any:
    """Structs, dataclasses and NumPy's scalars as `finite` values that JSON knows, keys as texts."""
    import msgspec

    return finite(msgspec.to_builtins(value, str_keys=True, enc_hook=scalar))


def scalar(value: Any) -> Any:
    """A scalar of NumPy as one of Python's; for `msgspec`, which knows none."""
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def cell(value: Any) -> Any:
    """A text as a spreadsheet shows it: one that begins like a formula is not computed."""
    return f"'{value}" if isinstance(value, str) and value[:1] in tuple("=+-@\t\r") else value


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Where to write what replaces a file once it is whole: a reader sees the old file or the new one, never a part."""
    aside = path.with_name(f".{path.name}.new")
    try:
        yield aside
        os.replace(aside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise


def put(path: Path, text: str) -> None:
    """Replace a file by a text."""
    with replacing(path) as aside:
        aside.write_text(text, encoding="utf-8")


def cache_folder() -> Path:
    """Where truth and environments of engines are kept: CROSSCHECK_CACHE, else `crosscheck` in the user's cache."""
    if chosen := os.environ.get("CROSSCHECK_CACHE"):
        return Path(chosen)
    if sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "crosscheck"
