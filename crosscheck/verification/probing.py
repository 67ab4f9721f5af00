"""The verdict on a simulator that is known by its logs: the questions that it has to answer, and what they say."""

from __future__ import annotations

from pathlib import Path

from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec, steps_per_sample
from crosscheck.adapters.external.own import completed
from crosscheck.adapters.external.probes import Probes
from crosscheck.adapters.external.program import read_states
from crosscheck.compare.ladder import counts
from crosscheck.document import Record
from crosscheck.errors import ArgumentError
from crosscheck.judge.segments import segments_of
from crosscheck.references import truth
from crosscheck.running.attempt import Ran, attempt
from crosscheck.scene.model import Scene
from crosscheck.verification.cell import judged
from crosscheck.verification.solution import Solution


def judge_probes(scene: Scene, log: Path, folder: Path, step: float, order: int) -> tuple[Record | None, list[str]]:
    """The verdict on a run that a file holds, by answers to questions in a folder, and the questions that are open.

    The verdict is None as long as first questions are open. Finer ones may come with it.

    Parameters
    ----------
    log : states of the run, as `crosscheck run --csv` writes them, at even times
    step, order : of the simulator, s

    Raises
    ------
    ArgumentError, EngineError, TruthError
        The log or an answer cannot be read, or the scene has no truth.
    """
    states = read_states(log.name, scene, log)
    if len(states.t) < 3:
        raise ArgumentError(f"{log}: at least three output times are needed")
    logged = scene.replace(duration=float(states.t[-1]), samples=len(states.t))
    probes = Probes(folder, order)
    with adapters.lent(completed(probes, folder.name, "1")) as name:
        run = Record(scene=scene.name, engine=name, version="1", method="fixed", step=step, documented_order=order)
        first = _Log(log, states, order)
        outcome = attempt(logged, run, completed(first, log.name, "1"))
        if not isinstance(outcome, Ran):
            raise outcome.error
        traj, reference = outcome.trajectory, truth(logged)
        found = Solution(run, logged, traj, reference)
        asked = found.questions
        per, _ = steps_per_sample(logged, step)
        missing = []
        for segment in segments_of(logged, asked.states, reference, found.open):
            for count in counts(per, asked.multiple):
                question = probes.ask(asked.probe.worlds[0].scene(segment.start), asked.dt / count)
                missing += [] if probes.answer(question) else [question]
        if missing:
            return None, missing
        record = judged(run, logged, traj, frozenset(), reference, planned=False)
        return replace(record, engine=folder.name), list(dict.fromkeys(probes.open))


class _Log:
    """An engine whose run is the one that a file holds."""

    methods = ("fixed",)

    def __init__(self, path: Path, states: object, order: int) -> None:
        self.name, self._states, self.orders = path.stem, states, {"fixed": order}

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        return None

    def run(self, scene: Scene, spec: RunSpec) -> object:
        return self._states
