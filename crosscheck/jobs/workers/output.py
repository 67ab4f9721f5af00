"""What this worker process has printed since its task began; engines print below Python too, from C.

A worker's standard output and error stream are one file that its parent reads after a crash and empties per task.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Callable

MOST_READ = 1 << 16
"""Bytes of printed text that are looked at; a report needs no more."""

_tell: Callable[[str], None] | None = None


def listen(tell: Callable[[str], None]) -> None:
    """Say that the streams of this process are such a file, and how its parent is told what comes next; once."""
    global _tell
    _tell = tell


def at(label: str) -> None:
    """Tell the parent what the running task turns to; should the process die, its `Crash` names this."""
    if _tell is not None:
        _tell(label)


def heard() -> str:
    """The beginning of what was printed; nothing outside a worker process."""
    if _tell is None:
        return ""
    flush()
    return os.pread(2, MOST_READ, 0).decode("utf-8", "replace")


def flush() -> None:
    """Empty the buffers of Python and of the C library, so that text belongs to the task that printed it."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # an engine may have closed or replaced them
            stream.flush()
    with contextlib.suppress(OSError, AttributeError):  # no C library by this name outside POSIX
        ctypes.CDLL(None).fflush(None)
