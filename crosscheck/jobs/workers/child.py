"""The worker process: it reads requests from its standard input and answers each on its standard output.

Both streams are moved to other descriptors first, so that engines cannot use them. What engines print goes to the
error stream, which is a file of the parent.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import faulthandler
import os
import pathlib
import pickle
import signal
import sys
import threading
import time
import traceback

from crosscheck.errors import LONGEST, brief, counting_warnings
from crosscheck.jobs.workers import frames, output

GRACE = 30.0
"""Time (s) after the time limit at which a worker without a parent ends itself, even in the middle of a task."""

GLANCE = 1.0
"""Time (s) between two checks that the parent still runs."""

PR_SET_CHILD_SUBREAPER = 36
"""Of prctl(2)."""


class _Lost(Exception):
    """The parent has closed the pipe, or this process is a fork of the worker."""


class _Parent:
    """The worker's ends of the two pipes, taken from the standard streams."""

    def __init__(self) -> None:
        self._requests, self._answers = os.dup(0), os.dup(1)
        self._pid, self._own = os.getpid(), self._identities()
        self._lock = threading.Lock()  # one thread may report its progress while another sends the answer
        self.number = 0

    def receive(self) -> bytes:
        """The next request. The answers to it carry its number."""
        header = self._read(frames.HEADER.size)
        self.number = frames.number_of(header)
        length, checksum = frames.size(header, self.number)
        content = self._read(length)
        frames.check(content, checksum)
        return content

    def send(self, content: bytes) -> None:
        """Answer the current request."""
        if os.getpid() != self._pid:  # the engine's code forked and returned in the child, too
            raise _Lost
        if self._identities() != self._own:
            raise OSError("an engine has replaced the pipe to the parent by another file")
        left = memoryview(frames.framed(self.number, content))
        with self._lock:
            while left:
                left = left[os.write(self._answers, left):]

    def _read(self, count: int) -> bytes:
        content = b""
        while len(content) < count:
            part = os.read(self._requests, count - len(content))
            if not part:
                raise _Lost
            content += part
        return content

    def _identities(self) -> list[tuple[int, int]]:
        about = [os.fstat(descriptor) for descriptor in (self._requests, self._answers)]
        return [(each.st_dev, each.st_ino) for each in about]


def main() -> None:
    """Serve one parent; called by the command line of `crosscheck.jobs.workers.process`."""
    # On Ctrl-C the parent ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent, pid = _Parent(), os.getpid()
    _adopt()
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    faulthandler.enable()  # a crash inside an engine then prints where Python was
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    output.listen(lambda label: parent.send(frames.packed(frames.At(label))))
    warned: dict[str, int] = {}
    try:
        path = pickle.loads(parent.receive())
        if path is not None:
            sys.path[:] = path
        while True:
            seconds, payload = pickle.loads(parent.receive())
            # The parent's own time limit comes first. This one ends a worker without a parent in an endless C loop.
            if seconds is not None:
                faulthandler.dump_traceback_later(min(seconds + GRACE, threading.TIMEOUT_MAX), exit=True)
            answer = _answer(payload, warned)
            faulthandler.cancel_dump_traceback_later()
            parent.send(answer)
    except (_Lost, BrokenPipeError):
        if os.getpid() == pid:
            atexit._run_exitfuncs()
            _end_group()
        os._exit(0)


def _end_with_parent(parent: int) -> None:
    """End this process when the parent has ended: nobody would read its answer."""
    while os.getppid() == parent:
        time.sleep(GLANCE)
    _end_group()


def _end_group() -> None:
    """End this process, all processes that engines started in its group, and those that descend from it."""
    for pid in _descendants(os.getpid()):
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGKILL)
    os.killpg(0, signal.SIGKILL)


def _adopt() -> None:
    """Let processes whose parents end become children of this one, so that a daemon is still found."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _descendants(pid: int) -> list[int]:
    """Children of a process, and theirs."""
    found: list[int] = []
    for task in pathlib.Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # it has ended
            for child in map(int, task.read_text().split()):
                found += [child, *_descendants(child)]
    return found


def _answer(payload: bytes, warned: dict[str, int]) -> bytes:
    """The answer to a pickled (function, arguments)."""
    warned.clear()
    with counting_warnings(warned):  # apart from what engines print: the parent tells the user
        try:
            function, arguments = pickle.loads(payload)
            content = frames.encode(function(*arguments))
            answer: frames.Answer = frames.Done(content, dict(warned))
            if len(content) > frames.MOST:
                raise ValueError(f"the result takes {len(content) / 2**30:.3g} GB; at most {frames.MOST / 2**30:g} GB "
                                 "can be sent")
        except Exception as error:
            kinds = tuple(kind.__name__ for kind in type(error).__mro__)
            answer = frames.Raised(brief(f"{kinds[0]}: {error}"), brief(traceback.format_exc(), 10 * LONGEST), kinds,
                                   brief(str(error)), dict(warned))
    output.flush()
    return frames.packed(answer)
