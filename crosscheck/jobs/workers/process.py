"""The parent's side of worker processes: start one, ask it, watch its time and memory, say what became of it."""

from __future__ import annotations

import dataclasses
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

GIGABYTE = 2**30
TICK = 0.05
"""s between two looks at a busy worker: memory fills at a few gigabytes a second at most."""

FAMILY = 20
"""Ticks between two looks for processes that the worker started; finding them takes milliseconds."""

MOST_PRINTED = 64 * 2**20
"""Bytes a task may print before it is stopped: the text is kept on disk until the task ends."""

# The package by its folder: an environment made for one version of an engine does not have it installed.
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
    """What one task may take; None: no limit."""

    time: float | None = None  # s
    memory: float | None = None  # bytes resident, of the worker and of the processes it starts


@dataclasses.dataclass(frozen=True)
class Crash:
    """What is left of a task that did not return."""

    message: str  # one line
    details: str = ""  # traceback, or the last that was printed
    error: Exception | None = dataclasses.field(default=None, compare=False)  # what the task raised
    at: str = ""  # what it had turned to, see `crosscheck.jobs.workers.output.at`


class Worker:
    """One process that runs one task after the other. Not for two threads at once, except `kill`.

    Parameters
    ----------
    python : another interpreter, with the modules it finds by itself; None: this one, with the `sys.path` of now
    """

    def __init__(self, python: str | None = None) -> None:
        # Appended to, so that it can be emptied between tasks; open as long as the worker.
        self._printed = tempfile.TemporaryFile("a+b")  # noqa: SIM115
        folder = str(Path(__file__).resolve().parents[2])
        # One thread per worker, so that two workers do not time each other.
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        command = [python or sys.executable, "-P", "-c", BOOT, folder]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._printed,
                                         env={**single, **os.environ})
        self._reason: str | None = None
        self._path = list(sys.path) if python is None else None
        self._greeted = False
        self._at = ""

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...], limits: Limits | None = None) -> Any:
        """`function(*arguments)` in the worker: its result, or a `Crash`; after a crash of the process it is not
        `alive`.

        The function has to be importable by name there.
        """
        limits = limits or Limits()
        try:
            payload = pickle.dumps((function, arguments))
        except Exception as error:
            return Crash(f"the task cannot be sent to a worker: {error}", error=error)
        os.ftruncate(self._printed.fileno(), 0)
        self._at = ""
        ended = threading.Event()
        watch = threading.Thread(target=self._watch, args=(limits, ended), daemon=True)
        watch.start()
        try:
            answer = self._exchange((limits.time, payload))
        finally:
            ended.set()
            watch.join()
        if answer is None:
            return self._obituary()
        kind, *content, said = answer
        for text in said:
            sys.stderr.write(text)
        return content[0] if kind == "done" else Crash(*content)

    @property
    def alive(self) -> bool:
        """Whether it can take another task."""
        return self._process.poll() is None and self._reason is None

    def memory(self) -> int:
        """Resident bytes of the process alone; 0 where it is gone."""
        import psutil

        try:
            return _resident(psutil.Process(self._process.pid))
        except psutil.Error:
            return 0

    def printed(self) -> str:
        """What the last task printed, its end where that is long."""
        size = os.fstat(self._printed.fileno()).st_size
        return os.pread(self._printed.fileno(), 1 << 16, max(0, size - (1 << 16))).decode("utf-8", "replace")

    def close(self) -> None:
        """Let an idle worker end by itself, without waiting for it: its input ends."""
        for stream in (self._process.stdin, self._process.stdout):
            try:
                stream.close()  # type: ignore[union-attr]
            except OSError:  # it died with a request half written
                self.kill()
        # An engine's threads may keep a process from ending.
        threading.Thread(target=self._bury, daemon=True).start()

    def kill(self, reason: str = "stopped") -> None:
        """End it and every process it started, at once."""
        import psutil

        self._reason = self._reason or reason
        if self._process.poll() is not None:
            return
        family = self._family()
        self._process.kill()
        for process in family:
            try:
                process.kill()
            except psutil.Error:  # it was faster
                continue

    def _bury(self) -> None:
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.kill()
            self._process.wait()
        self._printed.close()

    def _exchange(self, request: tuple[float | None, bytes]) -> tuple[Any, ...] | None:
        """The answer to a request, or None where the process ended instead."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        try:
            if not self._greeted:
                pickle.dump(self._path, stdin)
                self._greeted = True
            pickle.dump(request, stdin)
            stdin.flush()
            while True:
                answer = pickle.load(stdout)
                kind, content, *rest = pickle.loads(answer)
                if kind != "at":
                    return kind, content, *rest
                self._at = content
        except (EOFError, OSError):
            return None
        except Exception as error:  # the answer holds something that cannot be made here
            return "raised", f"the result cannot be received: {type(error).__name__}: {error}", "", error, ()

    def _watch(self, limits: Limits, ended: threading.Event) -> None:
        """Kill the worker where the running task goes beyond its limits."""
        began, tick = time.monotonic(), 0
        family: list[Any] = []
        while not ended.wait(TICK):
            if limits.time is not None and time.monotonic() - began > limits.time:
                return self.kill(f"stopped: it did not end within the time limit of {limits.time:g} s")
            if limits.memory is not None:
                family = self._family() if tick % FAMILY == 0 else family
                if self.memory() + sum(_resident(process) for process in family) > limits.memory:
                    return self.kill("stopped: it took more memory than the limit of "
                                     f"{limits.memory / GIGABYTE:.3g} GB resident")
            if os.fstat(self._printed.fileno()).st_size > MOST_PRINTED:
                return self.kill(f"stopped: it printed more than {MOST_PRINTED >> 20} MB")
            tick += 1
        return None

    def _family(self) -> list[Any]:
        """The processes that it started, and theirs."""
        import psutil

        try:
            return psutil.Process(self._process.pid).children(recursive=True)
        except psutil.Error:  # gone meanwhile
            return []

    def _obituary(self) -> Crash:
        code = self._process.wait()
        printed = self.printed()
        if self._reason is None:
            self._reason = f"the worker process died while it ran this: {_cause(code)}"
            if code > 0 and printed.strip():
                self._reason += f"; it said: {printed.strip().splitlines()[-1]}"
        return Crash(self._reason, printed, at=self._at)


def _resident(process: Any) -> int:
    """Resident bytes of a process; 0 where it is gone."""
    import psutil

    try:
        return int(process.memory_info().rss)
    except psutil.Error:
        return 0


def _cause(code: int) -> str:
    """Why a process ended, from its exit code."""
    if code >= 0:
        return f"something in it ended the process (exit code {code})"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    words = {"SIGSEGV": "a crash inside the engine, wrong memory accessed", "SIGABRT": "the engine aborted",
             "SIGBUS": "a crash inside the engine", "SIGFPE": "a crash inside the engine, division by zero",
             "SIGILL": "an instruction this processor does not have",
             "SIGKILL": "killed from outside, as the system does when memory runs out"}
    return f"{name} ({words[name]})" if name in words else name


class Crew:
    """Workers that live on from task to task: one is started when a task comes and none is idle."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[Worker] = []
        self._all: set[Worker] = set()
        self._ending = False

    def call(self, function: Callable[[Any], Any], task: Any, limits: Limits | None = None) -> Any:
        """`function(task)` in a worker: its result, or a `Crash`. For any thread."""
        with self._lock:
            if self._ending:
                return Crash("not run: stopped before it began")
            worker = self._idle.pop() if self._idle else Worker()
            self._all.add(worker)
        if not worker.alive:  # ended while it had nothing to do
            worker = self._replaced(worker)
        result = worker.call(function, (task,), limits)
        most = limits.memory / 2 if limits is not None and limits.memory is not None else None
        if not worker.alive or (most is not None and worker.memory() > most):  # what earlier tasks left counts too
            self._dismiss(worker)
        else:
            with self._lock:
                self._idle.append(worker)
        return result

    def close(self) -> None:
        """Let every worker end; none may be busy."""
        with self._lock:
            workers, self._all, self._idle = list(self._all), set(), []
        for worker in workers:
            worker.close()

    def kill(self) -> None:
        """End every worker at once, busy or not; no new one is started."""
        with self._lock:
            self._ending = True
            workers = list(self._all)
        for worker in workers:
            worker.kill("stopped by an interrupt")

    def _replaced(self, worker: Worker) -> Worker:
        self._dismiss(worker)
        with self._lock:
            fresh = Worker()
            self._all.add(fresh)
        return fresh

    def _dismiss(self, worker: Worker) -> None:
        with self._lock:
            self._all.discard(worker)
        worker.close()


_crew: Crew | None = None


def isolated(function: Callable[[Any], Any], task: Any, limits: Limits | None = None) -> Any:
    """`function(task)` in a worker process beside this one: what an executor on another machine is given to run."""
    global _crew
    if _crew is None:
        _crew = Crew()
    return _crew.call(function, task, limits)
