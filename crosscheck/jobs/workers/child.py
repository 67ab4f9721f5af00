"""The worker process, which answers requests, and the process above it, which ends all that engines start.

The socket to the parent is moved to another descriptor first, so that engines cannot use it by accident. What they
print goes to a file of the parent, which empties it before each task and reads it after a crash.
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
import socket
import sys
import traceback

from crosscheck.errors import LONGEST, brief, counting_warnings
from crosscheck.jobs.workers import frames

GLANCE = 1.0
"""Time (s) between two checks that the parent still runs."""

PATIENCE = 5.0
"""Time (s) that a worker may take for its exit functions."""

MOST_READ = 1 << 16
"""Most bytes of printed text that are read."""

_WAKING = {signal.SIGCHLD, signal.SIGTERM, signal.SIGALRM}
_PDEATHSIG, _SUBREAPER = 1, 36  # of prctl(2)

_parent: frames.Pipe | None = None  # in a worker


def at(label: str) -> None:
    """Tell the parent what the task does next. If the process dies, its `Crash` names this label."""
    if _parent is not None:
        _parent.send(frames.encode(label))


def heard() -> str:
    """The beginning of what the task has printed, also from C code; "" outside a worker process."""
    if _parent is None:
        return ""
    _flush()
    return os.pread(2, MOST_READ, 0).decode("utf-8", "replace")


def main() -> None:
    """Serve the parent at standard input; called by the command line of `crosscheck.jobs.workers.process`."""
    global _parent
    parent = os.getppid()
    signal.pthread_sigmask(signal.SIG_BLOCK, _WAKING)
    if worker := os.fork():
        _supervise(worker, parent)
    _prctl(_PDEATHSIG, signal.SIGKILL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _WAKING)
    os.setpgrp()
    pipe, pid = frames.Pipe(socket.socket(fileno=os.dup(0))), os.getpid()
    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
    faulthandler.enable()  # a crash inside an engine then prints where Python was
    _parent = pipe
    with contextlib.suppress(EOFError, ConnectionError):  # the parent has ended, or this process is a fork
        while True:
            path, payload = pickle.loads(pipe.receive(request=True))
            if path is not None:
                sys.path[:] = path
            pipe.send(_answer(payload))
    if os.getpid() == pid:
        faulthandler.dump_traceback_later(PATIENCE, exit=True)
        atexit._run_exitfuncs()
    os._exit(0)


def _supervise(worker: int, parent: int) -> None:
    """Wait for the end of the worker, of its parent, or for SIGTERM. Then end what engines started; end as it did.

    Processes whose own parents end become children of this one, so that none is missed, be it a daemon.
    """
    os.close(0)
    _prctl(_SUBREAPER, 1)
    signal.setitimer(signal.ITIMER_REAL, GLANCE, GLANCE)
    status = 0
    while os.getppid() == parent:
        ended, code = os.waitpid(-1, os.WNOHANG)
        if ended == worker:
            status = code
            break
        if not ended and signal.sigwait(_WAKING) == signal.SIGTERM:
            break
    with contextlib.suppress(OSError):
        os.killpg(worker, signal.SIGKILL)
    with contextlib.suppress(OSError):  # until there are none
        while True:
            for child in pathlib.Path("/proc/thread-self/children").read_text().split():
                os.kill(int(child), signal.SIGKILL)
            os.waitpid(-1, 0)
    if os.WIFSIGNALED(status):
        with contextlib.suppress(OSError):  # SIGKILL has no other handler
            signal.signal(os.WTERMSIG(status), signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {os.WTERMSIG(status)})
        os.kill(os.getpid(), os.WTERMSIG(status))
    os._exit(os.waitstatus_to_exitcode(status))


def _prctl(option: int, value: int) -> None:
    with contextlib.suppress(OSError, AttributeError):  # Linux has it
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _answer(payload: bytes) -> bytes:
    """The answer to a pickled (function, arguments)."""
    warned: dict[str, int] = {}
    with counting_warnings(warned):  # apart from what engines print: the parent tells the user
        try:
            function, arguments = pickle.loads(payload)  # imports what it names
            at("")  # from here on the time of the task counts
            content = frames.encode(function(*arguments))
            answer: frames.Done | frames.Crash = frames.Done(content, warned)
            if len(content) > frames.MOST:
                raise ValueError(f"the result takes {len(content) / 2**30:.3g} GB; at most {frames.MOST / 2**30:g} GB "
                                 "can be sent")
        except Exception as error:
            kinds = tuple(kind.__name__ for kind in type(error).__mro__)
            answer = frames.Crash(f"{kinds[0]}: {brief(str(error))}", brief(traceback.format_exc(), 10 * LONGEST),
                                  kinds, warned)
    _flush()
    return frames.encode(answer)


def _flush() -> None:
    """Flush the buffers of Python and the C library, so that each text is counted for the task that printed it."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # an engine may have closed or replaced them
            stream.flush()
    with contextlib.suppress(OSError, AttributeError):  # outside POSIX, None does not name the C library
        ctypes.CDLL(None).fflush(None)
