"""The parent's side of worker processes: start them, send them tasks, limit time and memory, explain their ends."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, TypeVarTuple

import msgspec
import psutil

from crosscheck.errors import EngineWarning
from crosscheck.jobs import threads
from crosscheck.jobs.workers import frames
from crosscheck.jobs.workers.frames import Crash as Crash

Given = TypeVarTuple("Given")
Task = TypeVar("Task")
Result = TypeVar("Result")

GIGABYTE = 2**30

TICK = 0.05
"""Time (s) between two checks of a busy worker. Memory fills by a few gigabytes per second at most."""

LOOK = 1.0
"""Time (s) between two searches for the processes that one has started. A search takes milliseconds."""

START = 60.0
"""Time (s) that a process may take to start and to import what a task names, before the limit of the task counts."""

PATIENCE = 5.0
"""Time (s) that a process may take to end after it has closed its socket."""

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


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of one task; None: no limit."""

    time: float | None = None  # s
    memory: float | None = None  # bytes resident, of the worker and of the processes it starts
    processor: float | None = None  # s of processor time of the same, which other programs do not lengthen


class Family:
    """The processes that one has started, however deep, and this one if `whole`.

    Parameters
    ----------
    pid : None: this process
    """

    def __init__(self, pid: int | None = None, whole: bool = False) -> None:
        self._pid, self._whole, self._members, self._seen = pid, whole, list[psutil.Process](), -LOOK

    def processor(self) -> float:
        """Processor time (s) of all, with those of them that have ended and were waited for, to hundredths."""
        return self._sum(lambda process: sum(process.cpu_times()[:4]))

    def memory(self) -> float:
        """Resident bytes of all."""
        return self._sum(lambda process: process.memory_info().rss)

    def _sum(self, number: Callable[[psutil.Process], float]) -> float:
        total = 0.0
        if not self._members or time.monotonic() - self._seen > LOOK:
            with contextlib.suppress(psutil.Error):
                first, self._seen = psutil.Process(self._pid), time.monotonic()
                self._members = [*[first] * self._whole, *first.children(recursive=True)]
        for process in self._members:
            with contextlib.suppress(psutil.Error):  # it has ended
                total += number(process)
        return total


class Worker:
    """One process that runs one task after the other. Only one thread may use it at a time, except for `kill`.

    Parameters
    ----------
    python : path of another interpreter, which uses its own `sys.path`; None: this interpreter and `sys.path`
    """

    def __init__(self, python: str | None = None) -> None:
        self._python = python
        self._printed = tempfile.TemporaryFile("a+b")  # noqa: SIM115  # appended to, so that it can be emptied
        self._start()

    def _start(self) -> None:
        here, there = socket.socketpair()
        command = [self._python or sys.executable, "-P", "-c", BOOT, str(Path(__file__).resolve().parents[2])]
        with there:  # in a group of its own, which Ctrl-C does not reach
            self._process = subprocess.Popen(command, stdin=there.fileno(), stdout=self._printed, stderr=self._printed,
                                             env={**threads.ONE, **os.environ}, process_group=0)
        self._pipe, self._family = frames.Pipe(here), Family(self._process.pid)
        self._path = None if self._python else list(sys.path)
        self._reason = self._at = ""

    def ready(self) -> None:
        """Start the process again if it has ended."""
        if not self.alive:
            self.close()
            self._start()

    def call(self, function: Callable[[*Given], Result], arguments: tuple[*Given], limits: Limits | None = None
             ) -> Result | Crash:
        """The result of `function(*arguments)` in the worker, or a `Crash`. `alive` is False if the process ended.

        The worker must be able to import the function by its name.
        """
        try:
            payload = pickle.dumps((function, arguments))
        except (pickle.PicklingError, AttributeError, TypeError, ValueError, RecursionError) as error:
            return Crash(f"the task cannot be sent to a worker: {error}")
        os.ftruncate(self._printed.fileno(), 0)
        self._at, self._began, self._used = "", time.monotonic() + START, self._family.processor()
        over = threading.Event()
        watch = threading.Thread(target=self._watch, args=(limits or Limits(), over), daemon=True)
        watch.start()
        try:
            answer = self._exchange(payload)
        finally:
            over.set()
            watch.join()
        if answer is None:
            return self._crash()
        for text, count in answer.warnings.items():
            warnings.warn(EngineWarning(text, count), stacklevel=2)
        if isinstance(answer, Crash):
            return msgspec.structs.replace(answer, at=self._at)
        try:
            result: Result = frames.decode(answer.result, frames.answered(function))
            return result
        except ValueError as error:
            return Crash(f"the result is not of the type that was asked for: {error}")

    @property
    def alive(self) -> bool:
        """Whether the worker can run another task."""
        return not self._reason and self._pipe.quiet()

    def memory(self) -> float:
        """Resident bytes of the worker and of the processes that it was last seen to have started."""
        return self._family.memory()

    def printed(self) -> str:
        """What the last task printed. Of a long text, only the end."""
        size = os.fstat(self._printed.fileno()).st_size
        return os.pread(self._printed.fileno(), 1 << 16, max(0, size - (1 << 16))).decode("utf-8", "replace")

    def close(self) -> None:
        """Let an idle worker end, and with it the processes that its engines left behind. Returns at once."""
        self._pipe.close()
        threading.Thread(target=self._process.wait).start()  # no daemon: the parent stays until they have ended

    def kill(self, reason: str = "stopped") -> None:
        """End the worker and every process it started, at once."""
        self._reason = self._reason or reason
        self._process.terminate()
        self._pipe.close()

    def _exchange(self, payload: bytes) -> frames.Done | Crash | None:
        """The answer to a request, or None if the process ended instead."""
        try:
            self._pipe.number += 1
            self._pipe.send(pickle.dumps((self._path, payload)))
            self._path = None
            while True:
                answer: frames.Answer = frames.decode(self._pipe.receive(), frames.Answer)
                if not isinstance(answer, str):
                    return answer
                if not answer:  # the process has started
                    self._began, self._used = time.monotonic(), self._family.processor()
                self._at = answer
        except (EOFError, OSError):
            try:
                self._process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                self.kill("stopped: it closed the pipe through which it answers")
        except ValueError:  # no frame, or no answer in it
            self.kill("stopped: something in it wrote to the pipe through which it answers")
        return None

    def _crash(self) -> Crash:
        """Why the process ended."""
        code, name, printed = self._process.wait(), "", self.printed()
        if not self._reason:
            cause = f"something in it ended the process (exit code {code})"
            if code < 0:
                name = cause = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
                cause += f" ({SIGNALS[name]})" if name in SIGNALS else ""
            elif code and printed.strip():
                cause += f"; it said: {printed.strip().splitlines()[-1]}"
            self._reason = f"the worker process died while it ran this: {cause}"
        return Crash(self._reason, printed, at=self._at, signal=name)

    def _watch(self, limits: Limits, over: threading.Event) -> None:
        """Kill the worker if the running task exceeds its limits."""
        while not over.wait(TICK):
            if limits.time is not None and time.monotonic() - self._began > limits.time:
                return self.kill(f"stopped: it did not end within the time limit of {limits.time:g} s")
            if limits.processor is not None and self._family.processor() - self._used > limits.processor:
                return self.kill(f"stopped: it did not end within {limits.processor:g} s of processor time")
            if limits.memory is not None and self.memory() > limits.memory:
                return self.kill("stopped: it took more memory than the limit of "
                                 f"{limits.memory / GIGABYTE:.3g} GB resident")
            if os.fstat(self._printed.fileno()).st_size > MOST_PRINTED:
                return self.kill(f"stopped: it printed more than {MOST_PRINTED >> 20} MB")
        return None


class Crew:
    """Workers that each run many tasks, called from any thread. A new one is started when none is idle."""

    def __init__(self) -> None:
        self._lock, self._ending = threading.Lock(), False
        self._idle, self._all = list[Worker](), list[Worker]()

    def call(self, function: Callable[[Task], Result], task: Task, limits: Limits | None = None) -> Result | Crash:
        """The result of `function(task)` in a worker, or a `Crash`."""
        with self._lock:
            if self._ending:
                return Crash("not run: stopped before it began")
            if not self._idle:
                self._all.append(Worker())
                self._idle.append(self._all[-1])
            worker = self._idle.pop()
            worker.ready()
        result = worker.call(function, (task,), limits)
        if limits is not None and limits.memory is not None and worker.memory() > limits.memory / 2:
            worker.close()  # memory that tasks have not freed
        with self._lock:
            self._idle.append(worker)
        return result

    def close(self) -> None:
        """Let every worker end. None may be busy."""
        with self._lock:
            while self._all:
                self._all.pop().close()
            self._idle.clear()

    def kill(self) -> None:
        """End every worker at once, even a busy one, and start no new one."""
        with self._lock:
            self._ending = True
            for worker in self._all:
                worker.kill("stopped by an interrupt")


_crew = functools.cache(lambda pid: Crew())


def isolated(function: Callable[[Task], Result], task: Task, limits: Limits | None = None) -> Result | Crash:
    """The result of `function(task)` in a worker process of this machine. Executors on other machines call this."""
    return _crew(os.getpid()).call(function, task, limits)  # a fork cannot use the workers of its parent
