"""The worker process: reads requests from its standard input until that ends, answers each on its standard output.

Both are taken away from the engines first. What engines print goes to the error stream, which the parent made a file.
Nothing but the standard library is imported here: this also runs in environments made for one version of an engine.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import pickle
import signal
import sys
import threading
import time
import traceback
import warnings
from typing import Any, BinaryIO

from crosscheck.jobs.workers import output

GRACE = 30.0
"""s beyond the time limit after which a worker whose parent has vanished ends itself, whatever it is at."""

GLANCE = 1.0
"""s between two looks whether the parent still lives."""


def main() -> None:
    """Serve one parent; called by the command line of `crosscheck.jobs.workers.process`."""
    # Ctrl-C reaches the whole process group; the parent alone answers it, and ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests, answers = _take_streams()
    faulthandler.enable()  # a crash inside an engine then prints where Python was
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    output.listen(lambda label: _send(answers, pickle.dumps(("at", label))))
    said: list[str] = []
    with contextlib.suppress(EOFError, BrokenPipeError):
        path = pickle.load(requests)
        if path is not None:
            sys.path[:] = path
        while True:
            seconds, payload = pickle.load(requests)
            # Not the parent's watch, which comes first; this one ends orphans inside a C loop that never returns.
            if seconds is not None:
                faulthandler.dump_traceback_later(min(seconds + GRACE, threading.TIMEOUT_MAX), exit=True)
            answer = _answer(payload, said)
            faulthandler.cancel_dump_traceback_later()
            _send(answers, answer)


def _end_with_parent(parent: int) -> None:
    """Nobody reads an orphan's answer: a killed night leaves no run behind that takes the machine from the next."""
    while os.getppid() == parent:
        time.sleep(GLANCE)
    os._exit(1)


def _send(answers: BinaryIO, answer: bytes) -> None:
    pickle.dump(answer, answers)  # bytes in bytes: an answer that cannot be understood leaves the stream in step
    answers.flush()


def _take_streams() -> tuple[BinaryIO, BinaryIO]:
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return requests, answers


def _answer(payload: bytes, said: list[str]) -> bytes:
    """The pickled answer to a pickled (function, arguments): ("done", result, warnings) or ("raised", words, ...)."""
    said.clear()
    with warnings.catch_warnings():
        # The text of a warning is for the person at the terminal; it is no engine's printing.
        warnings.showwarning = lambda *shown: said.append(warnings.formatwarning(*shown[:4]))
        try:
            function, arguments = pickle.loads(payload)
            answer: tuple[Any, ...] = ("done", function(*arguments))
        except Exception as error:
            answer = _raised(error)
    output.flush()
    try:
        return pickle.dumps((*answer, tuple(said)))
    except Exception as error:  # a result that cannot leave the process
        return pickle.dumps((*_raised(error), tuple(said)))


def _raised(error: Exception) -> tuple[Any, ...]:
    words, where = f"{type(error).__name__}: {error}", traceback.format_exc()
    try:
        return "raised", words, where, pickle.loads(pickle.dumps(error))
    except Exception:  # many exceptions cannot travel; their words can
        return "raised", words, where, None
