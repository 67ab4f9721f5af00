"""The parent's ends of a worker's pipes. Reads and writes never wait for a process that has ended.

A closed pipe is not a safe sign of that end: a process that an engine forked keeps the pipe open. So the state of the
worker process itself is checked.
"""

from __future__ import annotations

import os
import selectors
from typing import IO

from crosscheck.jobs.workers import frames

TICK = 0.05
"""Time (s) between two checks of a busy worker. Memory fills by a few gigabytes per second at most."""

_CHUNK = 1 << 20


class Ended(Exception):
    """The process ended, or closed its end of the pipe."""


class Pipes:
    """Requests to and answers from one process. Only one thread may use it at a time."""

    def __init__(self, pid: int, requests: IO[bytes], answers: IO[bytes]) -> None:
        self._pid, self._requests, self._answers = pid, requests, answers
        for stream in (requests, answers):
            os.set_blocking(stream.fileno(), False)

    def send(self, frame: bytes) -> None:
        """Write a frame. Raises `Ended` if nobody reads it."""
        left = memoryview(frame)
        try:
            while left:
                if self._ready(self._requests, selectors.EVENT_WRITE):
                    left = left[os.write(self._requests.fileno(), left[:_CHUNK]):]
        except (OSError, ValueError):  # broken, or closed here
            raise Ended from None

    def receive(self, number: int) -> bytes:
        """The content of the next frame. Raises `Ended`, or `frames.BrokenFrame` if it is not of this request."""
        length, checksum = frames.size(self._read(frames.HEADER.size), number)
        content = self._read(length)
        frames.check(content, checksum)
        return content

    def quiet(self) -> bool:
        """Whether no bytes wait to be read, as it must be between two requests."""
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
        """Wait for at most one tick: can the stream be used now? Raises `Ended` if the process has ended."""
        over = ended(self._pid)  # checked first, so that what it wrote before its end is still read
        with selectors.DefaultSelector() as selector:
            selector.register(stream, event)
            ready = bool(selector.select(0.0 if over else TICK))
        if over and not ready:
            raise Ended
        return ready


def ended(pid: int) -> bool:
    """Whether a child process has ended. This does not reap it, so that no other process can get its number."""
    try:
        return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    except ChildProcessError:  # reaped already
        return True
