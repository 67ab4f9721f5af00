"""Files that are replaced as a whole, and conversion of values to JSON."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import math
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

_UNREADABLE = re.compile("[\\x00-\\x08\\x0b\\x0c\\x0e-\\x1f\\x7f-\\x9f\\ud800-\\udfff\\ufffe\\uffff]")


def readable(text: str) -> str:
    """The text with escapes for control characters and lone surrogates, which XML and databases refuse."""
    return text if text.isprintable() else _UNREADABLE.sub(lambda sign: sign[0].encode("unicode_escape").decode(), text)


def finite(value: object) -> Any:
    """The value with texts made `readable` and None for numbers that are not finite, which JSON cannot hold."""
    if isinstance(value, str):  # the most frequent first: a report has a million values
        return readable(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    if isinstance(value, Mapping):
        return {finite(key): finite(each) for key, each in value.items()}
    return value


def plain(value: object) -> Any:
    """Structs, dataclasses and NumPy scalars as `finite` JSON values, with texts as keys."""
    import msgspec

    return finite(msgspec.to_builtins(value, str_keys=True, enc_hook=scalar))


def digest(*content: object) -> str:
    """The key of a row: a digest of plain values, structs and dataclasses."""
    import msgspec

    values = msgspec.to_builtins(content, str_keys=True, enc_hook=scalar, order="sorted")
    return hashlib.sha256(msgspec.msgpack.encode(values)).hexdigest()


def scalar(value: object) -> object:
    """A NumPy scalar as a Python scalar, for `msgspec`, which does not know NumPy."""
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def cell(value: object) -> Any:
    """A value for a spreadsheet, which would run a text that begins like a formula; such a text gets an apostrophe."""
    return f"'{value}" if isinstance(value, str) and value[:1] in tuple("=+-@\t\r") else value


_TEX = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
        **{letter: f"\\{letter}" for letter in "_{}$&#%"}}


def tex(text: str) -> str:
    """A text for LaTeX, in which no letter is a command."""
    return "".join(_TEX.get(letter, letter) for letter in readable(text))


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path whose file replaces `path` at the end: readers see the whole old file or the whole new one."""
    aside = path.with_name(f".{path.name}.new")
    try:
        yield aside
        os.replace(aside, path)
    finally:
        with contextlib.suppress(OSError):
            aside.unlink()


def put(path: Path, content: str | bytes) -> None:
    """Replace a file by a text or by bytes."""
    with replacing(path) as aside:
        aside.write_bytes(content.encode() if isinstance(content, str) else content)


def cache_folder() -> Path:
    """The folder for cached truth and environments: CROSSCHECK_CACHE, else `crosscheck` in the user's cache folder."""
    if chosen := os.environ.get("CROSSCHECK_CACHE"):
        return Path(chosen)
    if sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "crosscheck"


@contextlib.contextmanager
def aside(*streams: int) -> Iterator[IO[bytes]]:
    """What is written to standard streams (1, 2) inside, by libraries too, goes to this file instead."""
    sys.stdout.flush()
    sys.stderr.flush()
    before = [os.dup(stream) for stream in streams]
    with tempfile.TemporaryFile() as file:
        try:
            for stream in streams:
                os.dup2(file.fileno(), stream)
            yield file
        finally:
            ctypes.CDLL(None).fflush(None)  # C keeps what its library printed
            for stream, own in zip(streams, before, strict=True):
                os.dup2(own, stream)
                os.close(own)
