"""What this worker process has printed since its task began, also from C code.

Standard output and error stream of a worker are one file. Its parent empties it before each task and reads it after a
crash.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Callable

MOST_READ = 1 << 16
"""Most bytes of printed text that are read."""

_tell: Callable[[str], None] | None = None


def listen(tell: Callable[[str], None]) -> None:
    """Called once in a worker: from then on `heard` reads the printed text, and `at` calls `tell`."""
    global _tell
    _tell = tell


def at(label: str) -> None:
    """Tell the parent what the task does next. If the process dies, its `Crash` names this label."""
    if _tell is not None:
        _tell(label)


def heard() -> str:
    """The beginning of what the task has printed; "" outside a worker process."""
    if _tell is None:
        return ""
    flush()
    return os.pread(2, MOST_READ, 0).decode("utf-8", "replace")


def flush() -> None:
    """Flush the buffers of Python and the C library, so that each text is counted for the task that printed it."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # an engine may have closed or replaced them
            stream.flush()
    with contextlib.suppress(OSError, AttributeError):  # outside POSIX, None does not name the C library
        ctypes.CDLL(None).fflush(None)
