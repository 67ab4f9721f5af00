"""The journal of a run in progress: every result is written to the disk before the run continues.

Each result is one line of JSON, written and synced at once. If the process is killed while it writes, only the last
line is incomplete. That line is dropped when the journal is opened again, and its task runs again.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from crosscheck.errors import FAILED, ArgumentError
from crosscheck.files import scalar
from crosscheck.jobs.grid import Crash, Limits, run_tasks

CRASH = "crash"


class Journal:
    """Results by (stage, key), in memory and on the disk.

    Parameters
    ----------
    path : the file; created if it does not exist
    types : the type of the results of each stage, to which `msgspec` converts the JSON it reads
    """

    def __init__(self, path: Path, types: Mapping[str, object]) -> None:
        self._types = types
        self._found: dict[tuple[str, str], Any] = {}  # results of earlier sessions
        self._spent: dict[int, float] = {}  # s, length of each earlier session
        self._opened = time.perf_counter()
        try:
            self._read(path)
            self._file = open(path, "ab", buffering=0)  # noqa: SIM115 - open as long as the run
        except OSError as error:
            raise ArgumentError(f"{path}: {error.strerror or error}") from None

    def _read(self, path: Path) -> None:
        """Read the complete lines and cut off an incomplete last one."""
        content = path.read_bytes() if path.exists() else b""
        whole = content[:content.rfind(b"\n") + 1]
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                entry = json.loads(line)
                self._found[entry["stage"], entry["key"]] = entry["result"]
                self._spent[int(entry["session"])] = float(entry["elapsed"])
            except (ValueError, KeyError, TypeError) as error:
                raise ArgumentError(f"{path}, line {number}: not a line of a journal ({error}); remove the folder "
                                    f"{path.parent} to start the run anew") from None
        self._session = max(self._spent, default=0) + 1
        if len(whole) < len(content):
            os.truncate(path, len(whole))

    def __len__(self) -> int:
        """Number of results that earlier sessions left."""
        return len(self._found)

    @property
    def seconds(self) -> float:
        """Time (s) spent on the run so far, in this session and in the earlier ones that were killed."""
        return sum(self._spent.values()) + time.perf_counter() - self._opened

    def get(self, stage: str, key: str) -> Any:
        """The result of a task in an earlier session, or None if it did not end."""
        if (stage, key) not in self._found:
            return None
        return self._typed(stage, self._found[stage, key])

    def put(self, stage: str, key: str, result: Any) -> Any:
        """Write a result and return it as `get` will return it, so that a resumed run sees the same values."""
        import msgspec

        if isinstance(result, Crash):  # only its texts: an exception cannot always be written
            plain = {CRASH: {name: text for name, text in vars(result).items() if isinstance(text, str)}}
        else:
            plain = msgspec.to_builtins(result, str_keys=True, enc_hook=scalar)
        entry = {"stage": stage, "key": key, "session": self._session, "elapsed": time.perf_counter() - self._opened,
                 "result": plain}
        line = json.dumps(entry, separators=(",", ":")).encode() + b"\n"
        try:
            while line:
                line = line[self._file.write(line):]
            os.fsync(self._file.fileno())
        except OSError as error:
            raise ArgumentError(f"{self._file.name}: {error.strerror or error}; mend this and start the run again, "
                                "what ended before is kept") from None
        return self._typed(stage, json.loads(json.dumps(plain)))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _typed(self, stage: str, plain: Any) -> Any:
        import msgspec

        if isinstance(plain, dict) and plain.keys() == {CRASH}:
            return Crash(**plain[CRASH])
        return msgspec.convert(plain, self._types[stage], str_keys=True)


@dataclasses.dataclass
class Stages:
    """Run the stages of a run. A stage is many tasks of one kind; those with a result in the journal are not run."""

    jobs: int
    journal: Journal | None
    count: Callable[[str], None]  # called as each task ends
    executor: concurrent.futures.Executor | None = None  # instead of `jobs` processes on this machine

    def run(self, stage: str, function: Callable[[Any], Any], tasks: Sequence[Any], keys: Sequence[str],
            labels: Sequence[str], limits: Limits | None = None, again: bool = False,
            failure: Callable[[Any], str] | None = None) -> list[Any]:
        """Results of one stage, in order. `keys` name the tasks in the journal, `labels` in the progress bar.

        With `again`, a task whose process was killed from outside runs once more. `failure` returns what is wrong with
        a result, or "". If something is wrong, the label begins with `FAILED` and ends with that text.
        """
        results = [self.journal.get(stage, key) if self.journal is not None else None for key in keys]
        missing = [index for index, result in enumerate(results) if result is None]
        for index in set(range(len(tasks))) - set(missing):
            self.count(labels[index])

        def ended(position: int, result: Any) -> None:
            index = missing[position]
            results[index] = self.journal.put(stage, keys[index], result) if self.journal is not None else result
            wrong = failure(result) if failure is not None else ""
            self.count(f"{FAILED}{labels[index]}: {wrong}" if wrong else labels[index])

        run_tasks(function, [tasks[index] for index in missing], self.jobs, ended, limits, self.executor,
                  again)
        return results
