"""Tasks for worker processes; spawned workers import them by name."""

from __future__ import annotations

import contextlib
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np


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
    """Writes its process id and is busy for long."""
    path.write_text(str(os.getpid()))
    time.sleep(600)


def helper_then_death(path: Path, session: bool = False) -> None:
    """Forks a helper that holds every pipe for long, and dies; the path gets the helper's process."""
    helper = os.fork()
    if not helper:
        if session:
            os.setsid()
        time.sleep(600)
        os._exit(0)
    path.write_text(str(helper))
    os.kill(os.getpid(), signal.SIGKILL)


def helper_left(path: Path) -> int:
    """Starts a helper in a session of its own that outlives the task; the path gets its process."""
    helper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)
    path.write_text(str(helper.pid))
    return helper.pid


def daemon_left(path: Path) -> int:
    """Starts a helper as a daemon: its parent has ended, its session is new, its environment empty."""
    code = (f"import os, time\nif os.fork():\n    os._exit(0)\nos.setsid()\nif os.fork():\n    os._exit(0)\n"
            f"open({str(path)!r}, 'w').write(str(os.getpid()))\ntime.sleep(600)")
    subprocess.run([sys.executable, "-c", code], env={}, check=True)
    while not path.exists() or not path.read_text():
        time.sleep(0.01)
    return 1


def scribble(content: bytes) -> int:
    """Writes into every socket of the process that it can find and does not own."""
    written = 0
    for descriptor in range(3, 64):
        with contextlib.suppress(OSError):
            if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                written += os.write(descriptor, content)
    return written


def close_pipes(seconds: float) -> None:
    """Closes what the process does not own, and sleeps."""
    os.closerange(3, 64)
    time.sleep(seconds)


def replace_pipes(path: Path) -> int:
    """Puts a file of its own in the place of every socket."""
    with open(path, "wb") as file:
        for descriptor in range(3, 64):
            with contextlib.suppress(OSError):
                if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                    os.dup2(file.fileno(), descriptor)
    return 1


def return_twice(number: int) -> int:
    """Forks, and both processes return."""
    os.fork()
    return number


def die_once(path: Path) -> int:
    """Dies at the first time, as if killed from outside by the signal that ends the path; the path remembers."""
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGTERM if path.suffix == ".term" else signal.SIGKILL)
    return 1


def call(task: tuple) -> object:
    """`task[0](*task[1:])`: tasks of several kinds in one worker."""
    return task[0](*task[1:])


class Bomb:
    """Unpickling it makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return Path.touch, (self.path,)


class BombError(ValueError, Bomb):
    """The same as an error."""

    def __str__(self) -> str:
        return "an error of the engine's own kind"


def returned(path: Path) -> list:
    """Returns an object of its own."""
    return [1, Bomb(path)]


def raised(path: Path) -> None:
    """Raises an error of its own."""
    raise BombError(path)


def mistyped(number: int) -> int:
    """Returns something else than it says."""
    return "many"  # type: ignore[return-value]


def arrays(shape: tuple) -> dict[str, np.ndarray]:
    """Arrays of every kind that is taken."""
    values = np.arange(np.prod(shape)).reshape(shape)
    return {kind: values.astype(kind) for kind in ("?", "i1", "u4", "i8", "f4", "f8")} | {"turned": values.T * 0.1}
