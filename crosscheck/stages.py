"""Stages of a run: many tasks of one kind, those that a journal holds excepted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from crosscheck.jobs.grid import Limits, run_tasks
from crosscheck.jobs.journal import Journal


@dataclasses.dataclass
class Stages:
    """What all stages of a run share."""

    jobs: int
    journal: Journal | None
    count: Callable[[str], None]  # called as each task ends

    def run(self, stage: str, function: Callable[[Any], Any], tasks: Sequence[Any], keys: Sequence[str],
            labels: Sequence[str], limits: Limits | None = None) -> list[Any]:
        """Results of one stage, in order; `keys` name the tasks in the journal, `labels` in the progress bar."""
        results = [self.journal.get(stage, key) if self.journal else None for key in keys]
        missing = [index for index, result in enumerate(results) if result is None]
        for index in set(range(len(tasks))) - set(missing):
            self.count(labels[index])

        def ended(position: int, result: Any) -> None:
            index = missing[position]
            results[index] = self.journal.put(stage, keys[index], result) if self.journal else result
            self.count(labels[index])

        run_tasks(function, [tasks[index] for index in missing], self.jobs, ended, limits)
        return results
