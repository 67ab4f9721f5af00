"""What goes wrong in worker processes: engines that fail as foreign libraries can, then tasks, imported by name.

NumPy is imported where it is used: most of the time of a worker that does nothing with it would be this.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path


class Resting:
    """Every body stays where it is at the start: complete, finite and wrong."""

    name = "resting"
    methods = ("Rest",)

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        """The initial state at every output time."""
        import numpy as np

        from crosscheck.scene.states import States

        return States(scene.t, *(np.repeat(start[None], scene.samples, axis=0)
                                 for start in (scene.x0, scene.R0, scene.v0, scene.w0)))


class Killed(Resting):
    """Its worker is killed during the run, as by a system out of memory."""

    def run(self, scene, spec):
        os.kill(os.getpid(), signal.SIGKILL)


class Hanging(Resting):
    """Never ends, and lets no Python thread run meanwhile."""

    def run(self, scene, spec):
        """Sleeps in C with the interpreter locked."""
        ctypes.PyDLL(None).sleep(3600)


class NotANumber(Resting):
    """Returns NaN from the fourth sample on."""

    def run(self, scene, spec):
        states = super().run(scene, spec)
        states.x[3:] = float("nan")
        return states


class Segfaulting(Resting):
    """Reads from an invalid address."""

    def run(self, scene, spec):
        ctypes.string_at(0)


class Hungry(Resting):
    """Allocates without end."""

    def run(self, scene, spec):
        """A fifth of a gigabyte at a time, all of it touched."""
        kept = []
        while True:
            kept.append(bytes([1]) * 200_000_000)


class HungryChild(Resting):
    """Lets a process that it starts allocate without end."""

    def run(self, scene, spec):
        code = "import time\nkept = []\nwhile True:\n    kept.append(bytearray(200_000_000))\n    time.sleep(.1)"
        subprocess.run([sys.executable, "-c", code], check=True)


class Chatting(Resting):
    """Prints garbage on both streams, below Python too; a byte of a file stands for each run."""

    def run(self, scene, spec):
        with open(os.environ["CROSSCHECK_TEST_RUNS"], "ab") as file:
            file.write(b"-")
        print("Traceback (most recent call last): \x00\x1b[31m{")
        os.write(2, b"\xff\xfe<script>\n")
        return super().run(scene, spec)


class Exiting(Resting):
    """Ends the process with exit code 0."""

    def run(self, scene, spec):
        os._exit(0)


class Odd(Resting):
    """Returns something else than states."""

    def run(self, scene, spec):
        return [1.0, 2.0]


class Raising(Resting):
    """Raises what cannot be pickled, in words that no encoding takes."""

    def run(self, scene, spec):
        raise type("Local", (Exception,), {})("no such luck, half \ud800 of a character")


class Moody(Resting):
    """Crashes when asked whether it can run a scene, which happens early because it has forms."""

    forms = ("tree", "maximal")

    def unsupported(self, scene, spec):
        ctypes.string_at(0)


class Nameless:
    """Lacks `methods`."""

    name = "nameless"

    def unsupported(self, scene, spec):
        """Takes any scene."""

    def run(self, scene, spec):
        """Never called."""


class Untimed(Resting):
    """States stepping times that no run has; they are the names of its methods."""

    methods = ("nan", "inf", "-1", "1e300", "x", "None")

    def run(self, scene, spec):
        """A resting run with the stated time."""
        from crosscheck.adapters.base import RawRun

        odd = {"x": "x", "None": None}
        wall_time = odd[spec.method] if spec.method in odd else float(spec.method)
        return RawRun(super().run(scene, spec), wall_time, 10, spec.step)


# --- tasks


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


def be_busy(_: None) -> None:
    """Computes for ever."""
    while True:
        pass


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
