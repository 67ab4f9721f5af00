"""Tasks for worker processes; spawned workers import them by name."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def square_or_die(number: int) -> int:
    """The square; -1 kills the process as a crashing engine would, -2 raises."""
    if number == -1:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == -2:
        raise ValueError("minus two is not liked")
    return number * number


def chatter(number: int) -> int:
    """Writes to the standard output below Python, as engines do."""
    os.write(1, b"engine chatter\n")
    return number


def sleep_for(seconds: float) -> float:
    """The seconds, after that many."""
    time.sleep(seconds)
    return seconds


def tell_and_sleep(path: Path) -> None:
    """Writes which process this is, and is busy for long."""
    path.write_text(str(os.getpid()))
    time.sleep(600)
