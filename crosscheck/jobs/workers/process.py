"""The parent's side of worker processes: start one, send it tasks, limit its time and memory, explain its end."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import pickle
import secrets
import selectors
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import IO, TYPE_CHECKING, TypeVar, TypeVarTuple

from crosscheck.errors import EngineWarning
from crosscheck.jobs import threads
from crosscheck.jobs.workers import frames
from crosscheck.jobs.workers.frames import BrokenFrame, framed

if TYPE_CHECKING:
    import psutil

Given = TypeVarTuple("Given")
Result = TypeVar("Result")

GIGABYTE = 2**30

TICK = 0.05
"""Time (s) between two checks of a busy worker. Memory fills by a few gigabytes per second at most."""

_CHUNK = 1 << 20

MARK = "CROSSCHECK_WORKERS"
"""Environment variable with the marks of the workers that a process descends from.

By it, processes are found that an engine has started in another session or group.
"""

PATIENCE = 5.0
"""Time (s) that a process may take to end after its pipes are closed."""

FAMILY = 20
"""Ticks between two searches for processes that the worker has started. A search takes milliseconds."""

SIGNALS = {"SIGSEGV": "a crash inside the engine, wrong memory accessed", "SIGABRT": "the engine aborted",
           "SIGBUS": "a crash inside the engine", "SIGFPE": "a crash inside the engine, division by zero",
           "SIGILL": "an instruction this processor does not have",
           "SIGKILL": "killed from outside, as the system does when memory runs out"}
"""The usual cause of each signal that ends a process."""

MOST_PRINTED = 64 * 2**20
"""Bytes that a task may print before it is stopped. The text is on the disk until the task ends."""

# The package is loaded from its folder, because it is not installed in an environment for one version of an engine.
BOOT = """
import sys
from importlib.util import module_from_spec, spec_from_file_location
folder = sys.argv[1]
spec = spec_from_file_location("crosscheck", folder + "/__init__.py", submodule_search_locations=[folder])
package = sys.modules["crosscheck"] = module_from_spec(spec)
spec.loader.exec_module(package)
from crosscheck.jobs.workers.child import main
main()
"""


class Ended(Exception):
    """The process ended, or closed its end of the pipe."""


class Pipes:
    """Requests to and answers from one process. Only one thread may use it at a time.

    Reads and writes never wait for a process that has ended. A closed pipe is not a safe sign of that end: a process
    that an engine forked keeps the pipe open. So the state of the worker process itself is checked.
    """

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


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of one task; None: no limit."""

    time: float | None = None  # s
    memory: float | None = None  # bytes resident, of the worker and of the processes it starts


@dataclasses.dataclass(frozen=True)
class Crash:
    """Why a task has no result."""

    message: str  # one line
    details: str = ""  # the traceback, or the end of what was printed
    error: Exception | None = dataclasses.field(default=None, compare=False)  # what the task raised
    at: str = ""  # the last label that it gave to `crosscheck.jobs.workers.output.at`
    signal: str = ""  # name of the signal that ended the process, for example "SIGKILL"; "" if a limit did


class Worker:
    """One process that runs one task after the other. Only one thread may use it at a time, except for `kill`.

    Parameters
    ----------
    python : path of another interpreter, which uses its own `sys.path`; None: this interpreter and `sys.path`
    """

    def __init__(self, python: str | None = None) -> None:
        # Opened for appending, so that it can be emptied between tasks.
        self._printed = tempfile.TemporaryFile("a+b")  # noqa: SIM115
        folder = str(Path(__file__).resolve().parents[2])
        self._mark = secrets.token_hex(8)
        marks = {MARK: " ".join(filter(None, (os.environ.get(MARK), self._mark)))}
        command = [python or sys.executable, "-P", "-c", BOOT, folder]
        # Its own process group, so that all of it can be ended at once.
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._printed,
                                         env={**threads.ONE, **os.environ, **marks}, process_group=0)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipes = Pipes(self._process.pid, self._process.stdin, self._process.stdout)
        self._reason: str | None = None
        self._path = list(sys.path) if python is None else None
        self._family: set[psutil.Process] = set()  # processes that descend from it, also those that have ended
        self._number = 0  # of the last request
        self._at = ""

    def call(self, function: Callable[[*Given], Result], arguments: tuple[*Given], limits: Limits | None = None
             ) -> Result | Crash:
        """The result of `function(*arguments)` in the worker, or a `Crash`. `alive` is False if the process died.

        The worker must be able to import the function by its name.
        """
        limits = limits or Limits()
        try:
            payload = pickle.dumps((function, arguments))
        except (pickle.PicklingError, AttributeError, TypeError, ValueError, RecursionError) as error:
            return Crash(f"the task cannot be sent to a worker: {error}", error=error)
        os.ftruncate(self._printed.fileno(), 0)
        self._at = ""
        over = threading.Event()
        watch = threading.Thread(target=self._watch, args=(limits, over), daemon=True)
        watch.start()
        try:
            answer = self._exchange((limits.time, payload))
        finally:
            over.set()
            watch.join()
        if answer is not None:
            for text, count in answer.warnings.items():
                warnings.warn(EngineWarning(text, count), stacklevel=2)
            return self._result(function, answer)
        self._end_helpers()
        code = self._process.wait()
        printed = self.printed()
        if self._reason is not None:
            return Crash(self._reason, printed, at=self._at)
        name, cause = "", f"something in it ended the process (exit code {code})"
        if code < 0:
            name = cause = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
            cause += f" ({SIGNALS[name]})" if name in SIGNALS else ""
        self._reason = f"the worker process died while it ran this: {cause}"
        if code > 0 and printed.strip():
            self._reason += f"; it said: {printed.strip().splitlines()[-1]}"
        return Crash(self._reason, printed, at=self._at, signal=name)

    @property
    def alive(self) -> bool:
        """Whether the worker can run another task."""
        return self._reason is None and not ended(self._process.pid) and self._pipes.quiet()

    def memory(self) -> int:
        """Resident bytes of the process without its children; 0 if it has ended."""
        import psutil

        try:
            return _resident(psutil.Process(self._process.pid))
        except psutil.Error:
            return 0

    def printed(self) -> str:
        """What the last task printed. Of a long text, only the end."""
        size = os.fstat(self._printed.fileno()).st_size
        return os.pread(self._printed.fileno(), 1 << 16, max(0, size - (1 << 16))).decode("utf-8", "replace")

    def close(self) -> None:
        """Let an idle worker end, and end the processes that its engines left behind. Returns at once."""
        self._look()
        for stream in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                stream.close()  # type: ignore[union-attr]

        def bury() -> None:
            if self._process.returncode is None:
                self._wait()
                self._end_helpers()
                self._process.wait()
            self._printed.close()

        # Not a daemon thread: the parent stays until the worker and its helpers have ended.
        threading.Thread(target=bury).start()

    def kill(self, reason: str = "stopped") -> None:
        """End the worker and every process it started, at once."""
        self._reason = self._reason or reason
        self._end_helpers()

    def _wait(self) -> None:
        """Give the process time to end by itself."""
        began = time.monotonic()
        while not ended(self._process.pid) and time.monotonic() - began < PATIENCE:
            time.sleep(TICK / 5)

    def _end_helpers(self) -> None:
        """End the whole process group, and processes of the worker that have moved to another group.

        The process must not have been reaped yet: only until then is its number not given to another group.
        """
        import psutil

        if self._process.returncode is not None:
            return
        self._look()
        with contextlib.suppress(OSError):
            os.killpg(self._process.pid, signal.SIGKILL)
        for process in tuple(self._family):  # a daemon may have left the group and cleared its environment
            with contextlib.suppress(psutil.Error):
                process.kill()
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if self._mark in process.environ().get(MARK, ""):
                    process.kill()

    def _look(self) -> list[psutil.Process]:
        """The processes that descend from the worker now, which are remembered."""
        import psutil

        with contextlib.suppress(psutil.Error):  # the process has ended
            found: list[psutil.Process] = psutil.Process(self._process.pid).children(recursive=True)
            self._family.update(found)
            return found
        return []

    def _result(self, function: Callable[..., Result], answer: frames.Done | frames.Raised) -> Result | Crash:
        if isinstance(answer, frames.Raised):
            return Crash(answer.words, answer.where, answer.error(), self._at)
        try:
            result: Result = frames.decode(answer.result, frames.answered(function))
            return result
        except ValueError as error:
            return Crash(f"the result is not of the type that was asked for: {error}")

    def _exchange(self, request: tuple[float | None, bytes]) -> frames.Done | frames.Raised | None:
        """The answer to a request, or None if the process ended instead."""
        try:
            if not self._number:
                self._pipes.send(framed(0, pickle.dumps(self._path)))
            self._number += 1
            self._pipes.send(framed(self._number, pickle.dumps(request)))
            while True:
                answer = frames.unpacked(self._pipes.receive(self._number))
                if not isinstance(answer, frames.At):
                    return answer
                self._at = answer.label
        except Ended:
            self._wait()
            if not ended(self._process.pid):
                self.kill("stopped: it closed the pipe through which it answers")
            return None
        except BrokenFrame:
            self.kill("stopped: something in it wrote to the pipe through which it answers")
            return None

    def _watch(self, limits: Limits, over: threading.Event) -> None:
        """Kill the worker if the running task exceeds its limits."""
        began, tick = time.monotonic(), 0
        family: list[psutil.Process] = []
        while not over.wait(TICK):
            if limits.time is not None and time.monotonic() - began > limits.time:
                return self.kill(f"stopped: it did not end within the time limit of {limits.time:g} s")
            if tick % FAMILY == 0:
                family = self._look()
            if limits.memory is not None and self.memory() + sum(map(_resident, family)) > limits.memory:
                return self.kill("stopped: it took more memory than the limit of "
                                 f"{limits.memory / GIGABYTE:.3g} GB resident")
            if os.fstat(self._printed.fileno()).st_size > MOST_PRINTED:
                return self.kill(f"stopped: it printed more than {MOST_PRINTED >> 20} MB")
            tick += 1
        return None


def _resident(process: psutil.Process) -> int:
    """Resident bytes of a process; 0 if it has ended."""
    import psutil

    try:
        return int(process.memory_info().rss)
    except psutil.Error:
        return 0
