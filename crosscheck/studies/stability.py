"""The largest usable step of every method, from the ladders that `crosscheck.advise` climbs.

A run is useless if it fails or if a quantity is wrong by more than a tenth of its size
(`crosscheck.verification.advice`).
"""

from __future__ import annotations

import dataclasses
import functools
import operator

from msgspec.structs import replace

from crosscheck.document import Way
from crosscheck.jobs.drive import Crash, Limits, run_tasks
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.scene.file import load_scene, tagged
from crosscheck.studies.study import Ask, StudyDocument, StudyMeta, Work
from crosscheck.verification.advice import USELESS, prepare
from crosscheck.verification.ladder import STAGE as LADDER
from crosscheck.verification.ladder import Ladder, key

ALSO = ("single_pendulum", "double_pendulum", "heavy_top")
"""Ordinary scenes, for comparison with those tagged "hard"."""

LIMITS = Limits(1800.0, 4.0 * GIGABYTE)
"""Of one ladder, with the truth of its scene: that of stiff_damped takes about 100 s on an idle machine."""


class Line(Way, frozen=True, kw_only=True):
    """A method on a scene; `step` (s) or `rtol` is the largest usable one."""

    scene: str
    error: float | None = None  # of the largest usable step, over its size
    milliseconds: float | None = None  # of stepping, there
    breaks_at: float | None = None  # s or rtol, of the finest useless run; None: no run was useless
    reason: str = ""  # how that run ended, or why nothing could be run


class StabilityDocument(StudyDocument, frozen=True, kw_only=True):
    """stability.json."""

    lines: list[Line]


@dataclasses.dataclass(frozen=True)
class StabilityAsk(Ask):
    """Also the number of worker processes."""

    jobs: int = 2


class Stability:
    """How large can steps be? A killed study continues."""

    name = "stability"
    row_type = Ladder

    rows = staticmethod(operator.attrgetter("lines"))

    @property
    def scenes(self) -> tuple[str, ...]:
        """Ordinary scenes, then the hard ones."""
        return (*ALSO, *tagged("hard"))

    def measure(self, work: Work[StabilityAsk, Line]) -> None:
        """Climb the ladders of every engine on every scene in worker processes."""
        tasks = [(scene, engine) for scene in work.ask.scenes or self.scenes for engine in work.engines]
        keys = [key(load_scene(scene), engine) for scene, engine in tasks]
        before: list[Ladder | None] = [work.session.get(LADDER, each, ever=True) for each in keys]
        found: dict[int, list[Line]] = {}

        def kept(index: int, result: Ladder | str | Crash) -> None:
            scene, engine = tasks[index]
            reason = result.message if isinstance(result, Crash) else result
            found[index] = lines(result) if isinstance(result, Ladder) else [
                Line(engine, "", scene=load_scene(scene).name, reason=str(reason))]
            work.keep([line for place in sorted(found) for line in found[place]])
            work.progress(len(found), len(tasks), f"{scene}: {engine}")

        def ended(index: int, result: Ladder | str | Crash) -> None:
            # Only ladders are put: a crash may have been due to a busy machine.
            kept(index, work.session.put(LADDER, keys[index], result) if isinstance(result, Ladder) else result)

        for index, ladder in enumerate(before):
            if ladder is not None and ladder.every:
                kept(index, ladder)
        left = [index for index in range(len(tasks)) if index not in found]
        run_tasks(functools.partial(prepare, every=True), [(*tasks[index], before[index]) for index in left],
                  work.ask.jobs, lambda place, result: ended(left[place], result), LIMITS)

    def document(self, ask: StabilityAsk, meta: StudyMeta, results: list[Line]) -> StabilityDocument:
        """The document with all lines."""
        return StabilityDocument(study=self.name, meta=meta, lines=results)


def lines(ladder: Ladder) -> list[Line]:
    """A line for every way of a ladder: the coarsest of its runs of which no finer one is useless."""
    made = []
    for label in dict.fromkeys(rung.label for rung in ladder.rungs.values()):
        runs = ladder.of(label)
        broken = next((place for place, run in reversed(list(enumerate(runs))) if run.missed(USELESS) > 1.0), -1)
        usable, last = runs[broken + 1:], runs[broken] if broken >= 0 else None
        line = Line(ladder.engine, runs[-1].method, scene=ladder.scene, form=runs[-1].form)
        if last:
            line = replace(line, breaks_at=last.step or last.rtol,
                           reason=last.reason or (
                "it diverged" if last.error is None else f"an error of {last.error:.2g} of the size"))
        made.append(replace(line, step=usable[0].step, rtol=usable[0].rtol, error=usable[0].error,
                            milliseconds=usable[0].wall_ms) if usable else line)
    return made
