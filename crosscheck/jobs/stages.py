"""The stages of a command: many tasks of one kind each, of which only those without a row are run."""

from __future__ import annotations

import concurrent.futures
import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from crosscheck.errors import FAILED
from crosscheck.jobs.grid import Crash, Limits, run_tasks

if TYPE_CHECKING:
    from crosscheck.jobs.table import Session

Reuse = Literal["rows", "any rows", "samples"]
"""What counts as a result: rows as the session was asked to take them, rows even if it is fresh, or its samples."""


@dataclasses.dataclass
class Stages:
    """Run the stages of a command. Without a session nothing is kept."""

    jobs: int
    session: Session | None
    count: Callable[[str], None]  # called as each task ends
    executor: concurrent.futures.Executor | None = None  # instead of `jobs` processes on this machine

    def run(self, stage: str, function: Callable[[Any], Any], tasks: Sequence[Any], keys: Sequence[str],
            labels: Sequence[str], limits: Limits | None = None, again: bool = False,
            failure: Callable[[Any], str] | None = None, reuse: Reuse = "rows") -> list[Any]:
        """Results of one stage, in order. `keys` are those of the rows, `labels` name tasks in the progress bar.

        With `again`, a task whose process was killed from outside runs once more. `failure` returns what is wrong with
        a result, or "". If something is wrong, the label begins with `FAILED` and ends with that text.
        """
        results = [self.kept(stage, key, reuse) for key in keys]
        missing = [index for index, result in enumerate(results) if result is None]
        for index in set(range(len(tasks))) - set(missing):
            self.count(labels[index])

        def ended(position: int, result: Any) -> None:
            index = missing[position]
            if self.session is not None and not isinstance(result, Crash):  # which a busy machine may have caused
                result = self.session.put(stage, keys[index], result)
            results[index] = result
            wrong = failure(result) if failure is not None else ""
            self.count(f"{FAILED}{labels[index]}: {wrong}" if wrong else labels[index])

        run_tasks(function, [tasks[index] for index in missing], self.jobs, ended, limits, self.executor,
                  again)
        return results

    def kept(self, stage: str, key: str, reuse: Reuse = "rows") -> Any:
        """The result of a task that has not to be run, or None."""
        if self.session is None:
            return None
        return self.session.sample(stage, key) if reuse == "samples" else self.session.get(
            stage, key, ever=reuse == "any rows")
