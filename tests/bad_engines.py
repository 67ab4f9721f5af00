"""Engines that go wrong in every way a foreign library can; run only in worker processes."""

import ctypes
import os
import signal
import subprocess
import sys

import numpy as np

from crosscheck.adapters.base import RawRun
from crosscheck.scene.states import States


class Resting:
    """Every body stays where it is at the start: complete, finite and wrong."""

    name = "resting"
    methods = ("Rest",)

    def unsupported(self, scene, spec):
        return None

    def run(self, scene, spec):
        """The initial state at every output time."""
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
        states.x[3:] = np.nan
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
            kept.append(np.ones(25_000_000))


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
        odd = {"x": "x", "None": None}
        wall_time = odd[spec.method] if spec.method in odd else float(spec.method)
        return RawRun(super().run(scene, spec), wall_time, 10, spec.step)
