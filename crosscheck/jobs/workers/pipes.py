"""The parent's ends of a worker's pipes: no read or write waits for a process that has ended.

The end of a pipe is no sign of that: a helper that an engine forked keeps it open. The process is asked instead.
"""

from __future__ import annotations

import os
import selectors
from typing import IO

from crosscheck.jobs.workers import frames

TICK = 0.05
"""s between two looks at a busy worker: memory fills at a few gigabytes a second at most."""

_CHUNK = 1 << 20


class Ended(Exception):
    """The process ended, or closed its end of the pipe."""


class Pipes:
    """Requests to and answers from one process. Not for two threads at once."""

    def __init__(self, pid: int, requests: IO[bytes], answers: IO[bytes]) -> None:
        self._pid, self._requests, self._answers = pid, requests, answers
        for stream in (requests, answers):
            os.set_blocking(stream.fileno(), False)

    def send(self, frame: bytes) -> None:
        """Write a frame; `Ended` where nobody reads it."""
        left = memoryview(frame)
        try:
            while left:
                if self._ready(self._requests, selectors.EVENT_WRITE):
                    left = left[os.write(self._requests.fileno(), left[:_CHUNK]):]
        except (OSError, ValueError):  # broken, or closed here
            raise Ended from None

    def receive(self, number: int) -> bytes:
        """The content of the next frame; `Ended`, or `frames.BrokenFrame` where it does not answer this request."""
        length, checksum = frames.size(self._read(frames.HEADER.size), number)
        content = self._read(length)
        frames.check(content, checksum)
        return content

    def quiet(self) -> bool:
        """Whether no bytes wait to be read: between two requests there are none."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._answers, selectors.EVENT_READ)
            return not selector.select(0)

    def _read(self, count: int) -> bytes:
        content = bytearray()
        while len(content) < count:
            if self._ready(self._answers, selectors.EVENT_READ):
                try:
                    part = os.read(self._answers.fileno(), min(_CHUNK, count - len(content)))
                except OSError:
                    raise Ended from None
                if not part:
                    raise Ended
                content += part
        return bytes(content)

    def _ready(self, stream: IO[bytes], event: int) -> bool:
        """Whether the stream can be used now, after waiting a little; `Ended` where it never will."""
        over = ended(self._pid)  # asked first: what it wrote before it ended is still read
        with selectors.DefaultSelector() as selector:
            selector.register(stream, event)
            ready = bool(selector.select(0.0 if over else TICK))
        if over and not ready:
            raise Ended
        return ready


def ended(pid: int) -> bool:
    """Whether a child has ended. It is not reaped by this, so that its number stays its own."""
    try:
        return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:  # reaped already
        return True
