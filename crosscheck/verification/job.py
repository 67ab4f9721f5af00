"""The main job: truths, every cell of the grid, timings, and the document with all results."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import shlex
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.document import (
    AS_PLANNED,
    Advice,
    Asked,
    Document,
    Finding,
    Meta,
    Record,
    Scene,
    extended,
    grouped,
    outcome_of,
)
from crosscheck.document.outcomes import EXIT_CODES
from crosscheck.errors import ArgumentError, unknown
from crosscheck.files import digest, plain, readable
from crosscheck.jobs.drive import Crash, Limits, Place, Stages, run_tasks
from crosscheck.jobs.workers import child
from crosscheck.jobs.workers.process import GIGABYTE
from crosscheck.judge import verdict
from crosscheck.judge.overrides import Overrides
from crosscheck.judge.verdict import beyond
from crosscheck.report.headline import answers, clause
from crosscheck.running import cluster, provenance
from crosscheck.running.arguments import engine_options
from crosscheck.scene.file import load_scene, read_scene, scene_names, tagged
from crosscheck.verification import advice, trust
from crosscheck.verification.cell import run_cell
from crosscheck.verification.ladder import STAGE, Ladder, key
from crosscheck.verification.plan import PENDING, Profile
from crosscheck.verification.plan import profile as profile_called
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.speed import Pair, measure_speed
from crosscheck.verification.task import Carried, Cell, all_cells

if TYPE_CHECKING:
    from crosscheck.jobs.table import Session  # a database, which workers do not need

TIME_LIMIT = 1800.0
"""Time limit (s) of one cell: a run and its verdict. With built-in engines it takes seconds to minutes."""

MEMORY_LIMIT = 4.0
"""Limit of resident memory (GB) of one worker process. With all built-in engines loaded it needs 0.2 GB."""

SHOWN = 200
"""Most characters of printed text that a record quotes."""


def limits_of(time_limit: float | None = TIME_LIMIT, memory_limit: float | None = MEMORY_LIMIT) -> Limits:
    """Limits of a cell from the options of the command line, in s and GB. None means no limit."""
    for name, value in (("time-limit", time_limit), ("memory-limit", memory_limit)):
        if value is not None and not value > 0:
            raise ArgumentError(f"{name}: a positive number is wanted, not {value:g}")
    return Limits(time_limit, None if memory_limit is None else memory_limit * GIGABYTE)


def guarded_cell(cell: Cell) -> Record:
    """`run_cell`, but a run fails if its engine printed text, because a user would miss a warning in it."""
    judged = run_cell(cell)
    if adapters.has_own_environment(cell.way.engine):
        judged = replace(judged, own_environment=True, us_per_step=None, seconds_per_second=None)
    lines = [line for line in child.heard().splitlines() if line.strip()]
    if not lines:
        return judged
    printed = "".join(letter if letter.isprintable() else "?" for letter in lines[0].strip()[:SHOWN])
    printed = f"it printed {len(lines)} lines, first: {printed}"
    return beyond(judged, Finding("asked end", "fail", None, None, "", "an engine answers by what it returns; what it "
                                  "prints is lost on its user", printed), printed)


Progress = Callable[[int, int, str], None]
"""Called with (number of finished tasks, number of all tasks, name of the last finished one)."""

ROW_TYPES = {"truth": Scene, "cell": Record, "speed": list[list[Pair]], STAGE: Ladder}
"""Types of the results of each stage, for `crosscheck.jobs.table`."""


def select_scenes(names: Sequence[str] | None, every: bool = False) -> list[str]:
    """Names or paths of the scenes to run. Each is loaded once, so that a bad file is refused before anything runs.

    If `names` is None, these are the scenes with the tag "default" or, with `every`, all of the library.
    """
    chosen = list(dict.fromkeys(names or (scene_names() if every else tagged("default"))))
    for name in chosen:
        load_scene(name)
    return chosen


def select_engines(names: Sequence[str] | None) -> list[str]:
    """Names of the engines to run; raises `ArgumentError` or `EngineError` for one that is unknown or not installed."""
    for name in names or ():
        if isinstance(name, str) and adapters.is_own(name):
            adapters.get(name)
    provenance.need(names or ())
    return list(dict.fromkeys(names or adapters.names()))


def check_methods(names: Sequence[str] | None, engines: Sequence[str]) -> None:
    """Raise `ArgumentError` for a method that none of the engines has."""
    known = dict.fromkeys(method for engine in engines for method in adapters.methods(engine)) if names else {}
    for name in names or ():
        if name not in known:
            raise ArgumentError(unknown("method", name, known))


def check_options(wanted: Iterable[tuple[str, Any]], engines: Sequence[str]) -> None:
    """Raise `ArgumentError` for an option that none of the engines has, or a value that it cannot have."""
    for name, value in wanted:
        takers = [engine for engine in engines if name in adapters.get(engine).options]
        if not takers:
            raise ArgumentError(unknown("--set", name, sorted({
                option for engine in engines for option in adapters.get(engine).options} - {"form"})))
        engine_options(takers[0], adapters.get(takers[0]), "", {name: value})


def fingerprint(profile: str, scenes: Sequence[str] | None, engines: Sequence[str] | None, *more: object) -> str:
    """Digest of all that results depend on: scenes, versions, the code with its kernel, and `more` (JSON values)."""
    names = select_scenes(scenes, profile_called(profile).every_scene)
    return provenance.code_digest(select_engines(engines), [
        profile, [[name, load_scene(name).hash] for name in names], *more])


def verify(profile: str = "default", scenes: Sequence[str] | None = None, engines: Sequence[str] | None = None,
           jobs: int = 2, progress: Progress | None = None, session: Session | None = None,
           limits: Limits | None = None, overrides: Overrides = (), search: bool = False,
           methods: Sequence[str] | None = None, asked: Asked = AS_PLANNED, scheduler: str | None = None,
           on_results: Callable[[Document], object] | None = None, need: float = 1.0, budget: float | None = None,
           on_budget: Callable[[Document], object] | None = None) -> Document:
    """Run the main job and return its document. Nothing is written except rows.

    Parameters
    ----------
    profile : "default", "smoke" or "full"
    scenes : names or paths; None: those with the tag "default", or all with the profile "full"
    engines, methods : names; None: all
    jobs : number of worker processes
    progress : called as tasks end
    session : every result is put into its table; what is there already is not computed again
    limits : of one cell; None: those of `crosscheck.verification.job`
    overrides : tolerances of the user, from `crosscheck.judge.overrides.read`
    search : also make the runs for advice, up to half a minute of processor time per scene and engine
    asked : options, step and duration of main runs instead of those of the plan
    scheduler : where truths and runs are computed, for `crosscheck.running.cluster.place`; timings are made here
    on_results : called now and then with the document of what has ended, see `PAUSE`
    need : the share of its time over which the motion of a run has to be judged for it to pass
    budget : cheap runs come first, and after this time (s) `on_budget` is called, from a thread, with the document of
        what has ended by then, if anything is left: `meta.left` counts it. The job goes on

    Raises
    ------
    SceneError, ArgumentError, EngineError
        A name or option is wrong. This is checked first.
    """
    if not isinstance(jobs, int) or jobs < 1:
        raise ArgumentError(f"jobs: at least 1 is wanted, not {jobs}")
    if budget is not None and not budget > 0:
        raise ArgumentError(f"budget: a positive number of seconds is wanted, not {budget:g}")
    if not 0 < need <= 1:
        raise ArgumentError(f"need: a share above 0 and up to 1 is wanted, not {need:g}")
    adapters.renew()
    settings = profile_called(profile)
    within = limits or limits_of()
    scene_names, engine_names = select_scenes(scenes, settings.every_scene), select_engines(engines)
    check_methods(methods, engine_names)
    check_options(asked.options, engine_names)
    started = time.perf_counter()
    with Place(jobs) as near:  # its workers keep the engines that they have loaded
        cells = [cell for cell in all_cells(scene_names, engine_names, settings, within, near)
                 if not methods or cell.way.method in methods]
        left = total = (len(scene_names) * (1 + settings.speed)
                        + len(cells) + search * len(scene_names) * len(engine_names))

        def ended(label: str) -> None:
            nonlocal left
            left -= 1
            if progress:
                progress(total - left, total, label)

        def meta(**more: object) -> Meta:
            return msgspec.convert(provenance.describe(engine_names) | {
                "profile": profile, "jobs": jobs, "asked": asked, "need": need,
                "tolerances": [(name, bound) for name, bound, _ in overrides],
                "command": command("verify", profile, scenes, engines, methods, [
                    *(word for name, bound, _ in overrides for word in ("--tol", f"{name}={bound!r}")), *asked.words,
                    *(["--need", f"{need:g}"] if need < 1 else []), "--jobs", str(jobs)]),
                "seconds": session.seconds if session is not None else time.perf_counter() - started,
                "reused": session.reused if session is not None else 0,
                "reused_since": session.since if session is not None else None} | more, Meta)

        truths: list[Scene] = []
        paced = Paced(lambda records: None if on_results is None else on_results(
            document(meta(left=left), truths, records)))

        stages = Stages(jobs, session, ended)
        with (contextlib.nullcontext() if budget is None or on_budget is None else _after(
                budget, lambda: left and on_budget(document(meta(left=left), truths, paced.latest()))),
              contextlib.nullcontext(near) if scheduler is None else cluster.place(
                  scheduler, tuple(engine_names)) as place):
            elsewhere = dataclasses.replace(stages, place=place)
            carried = Carried.of(scene_names, engine_names if scheduler is not None else ())  # each file is read once
            keys = _keys(session is not None)
            truths = _truths(elsewhere, keys, scene_names, settings, asked, carried)
            cells = _planned(cells, truths, settings, overrides, asked)
            paced.call([])
            records = _records(elsewhere, keys, cells, truths, within, carried, paced, budget is not None)
        # One task at a time. Each of several rounds is of a new process, one alone of a worker with its engines loaded.
        alone = dataclasses.replace(stages, jobs=1, place=near if settings.speed == 1 else None)
        calibration = None
        if settings.speed:
            records, calibration = measure_speed(records, profile, alone, within)
        advised = _advice(alone, truths, engine_names, within, search)
        return replace(document(meta(calibration=calibration), truths, records), advice=advised or None)


PAUSE, SHARE = 10.0, 0.05
"""Time (s) between the page with the truths, the first with runs, and the next; share that writing may take."""


class Paced:
    """Calls a function with the `latest` value, if the last call is so long ago that it takes little time."""

    def __init__(self, call: Callable[[list[Record]], object]) -> None:
        self.call, self._due = call, time.perf_counter() + PAUSE
        self.latest: Callable[[], list[Record]] = list

    def __call__(self, value: Callable[[], list[Record]]) -> None:
        self.latest, began = value, time.perf_counter()
        if began >= self._due:
            self.call(value())
            ended = time.perf_counter()
            self._due = ended + max(PAUSE, (ended - began) / SHARE)


@contextlib.contextmanager
def _after(seconds: float, call: Callable[[], object]) -> Iterator[None]:
    """Call a function after so many seconds, unless the context has ended by then."""
    timer = threading.Timer(seconds, call)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


def document(meta: Meta, truths: Sequence[Scene], records: Sequence[Record]) -> Document:
    """The document with these records and the recommendations that follow from them."""
    records = [verdict.worded(record, meta.need) for record in records]
    scenes = []
    for scene in truths:
        own = [record for record in records if record.scene == scene.name]
        added = {"recommended": trust.recommend(scene, own), "trust": trust.sentence(scene, own),
                "engines": trust.by_engine(scene, own), "not_trusted": trust.not_trusted(own)}
        scenes.append(replace(scene, **added))
    # JSON has no infinity: values that are not finite become None.
    finite = msgspec.convert(plain(records), list[Record], str_keys=True)
    outcome = outcome_of(scenes, records)
    return Document(meta=meta, scenes=scenes, records=finite, outcome=outcome, exit_code=EXIT_CODES[outcome],
                    answers=answers(finite, meta.need, meta.tolerances))


def _keys(wanted: bool) -> Callable[..., str]:
    """A function of stage, scene, engine and task: the key of a row, a digest of all that a result depends on.

    The code of this project and of the engine are among that. Without a session nobody reads keys, so that they are "".
    """
    content = functools.cache(lambda scene: digest(read_scene(scene)[1]))
    code = functools.cache(lambda engine: provenance.code_digest(() if engine is None else (engine,), []))
    return lambda stage, scene, engine, *task: digest(stage, content(scene), code(engine), *task) if wanted else ""


def _advice(stages: Stages, truths: list[Scene], engines: Sequence[str], within: Limits, search: bool
            ) -> list[Advice]:
    """The advice for all scenes and engines. Without `search`, for those that were made before."""
    # The user's own engines may crash when they are loaded, and engines in their own environments are slow to start.
    tasks = [(scene.name, engine) for scene in truths if scene.truth is not None for engine in engines
             if search or not (adapters.is_own(engine) or adapters.has_own_environment(engine))]
    if stages.session is None and not search:
        return []
    keys = [key(load_scene(scene), engine) for scene, engine in tasks]
    kept = stages.kept(STAGE, keys, "any rows")
    ladders = [kept.get(each) for each in keys]
    left = [k for k, ladder in enumerate(ladders) if search and (ladder is None or not {*advice.LEVELS} <= {
        level for level in ladder.climbed if isinstance(level, float)})]
    for _ in range(len(tasks) - len(left) if search else 0):
        stages.count("ladders")
    made = run_tasks(advice.prepare, [(*tasks[k], ladders[k]) for k in left], stages.jobs, lambda position, _:
                     stages.count(f"ladder of {' '.join(tasks[left[position]])}"), within)
    for k, ladder in zip(left, made, strict=True):
        ladders[k] = ladder if stages.session is None or not isinstance(ladder, Ladder) else stages.session.put(
            STAGE, keys[k], ladder)
    return advice.of_ladders([scene for scene, _ in tasks], ladders)


def _truths(stages: Stages, keys: Callable[..., str], names: list[str], settings: Profile, asked: Asked,
            carried: Carried) -> list[Scene]:
    """The truth of every scene, or why it could not be prepared."""
    prepare = functools.partial(carried.call, functools.partial(prepare_truth, asked=asked))
    tasks = [(name, settings.most_seconds, settings.most_steps) for name in names]
    prepared = stages.run("truth", prepare, tasks, [keys("truth", task[0], None, *task, asked) for task in tasks],
                          # Every run of a scene needs it.
                          [f"truth of {Path(name).name}" for name in names], retry=True)
    return [Scene(name=name, title=name, description="", source="", hash="", bodies=[], duration=0.0, plan=None,
                  truth=None, sizes=None, trust="", recommended=None, failure=readable(each.message),
                  details=readable(each.details) or "") if isinstance(each, Crash) else each
            for name, each in zip(names, prepared, strict=True)]


def _planned(cells: list[Cell], truths: list[Scene], settings: Profile, overrides: Overrides, asked: Asked
             ) -> list[Cell]:
    """The cells with the plans of their scenes."""
    plans = {scene.name: scene.plan for scene in truths if scene.plan is not None}
    without = {scene.name: scene.no_truth for scene in truths if scene.no_truth}
    return [dataclasses.replace(cell, plan=plans.get(cell.scene, PENDING), no_truth=without.get(cell.scene, ""),
                                overrides=overrides, as_planned=asked == AS_PLANNED,
                                way=cell.way.having(adapters.get(cell.way.engine).takes(asked.options)))
            for cell in cells]


def _failure(result: Record | Crash) -> str:
    """Why a run fails, in one line; "" if it does not."""
    if isinstance(result, Crash):
        return result.message
    if result.outcome not in ("fail", "error"):
        return ""
    return result.message or clause(verdict.worded(result)) or result.outcome


def _records(stages: Stages, keys: Callable[..., str], cells: list[Cell], truths: list[Scene], within: Limits,
             carried: Carried, on_results: Callable[[Callable[[], list[Record]]], None],
             cheap_first: bool) -> list[Record]:
    """The records of all cells, in their order, also if a worker crashed or a scene could not be prepared.

    `on_results` is called as cells end, with a function that returns the records of those that have. The longest cells
    are run first, so that all workers end at about the same time, or the cheap ones.
    """
    scenes = {scene.name: scene for scene in truths}
    def cost(index: int) -> tuple[float, float]:
        cell = cells[index]
        return adapters.get(cell.way.engine).pace, len(scenes[cell.scene].bodies) / cell.plan.step(1)

    ready = sorted((index for index, cell in enumerate(cells) if not scenes[cell.scene].failure), key=cost,
                   reverse=not cheap_first)
    chosen = [cells[index] for index in ready]

    def recorded(results: Sequence[Record | Crash | None]) -> list[Record]:
        by_index = dict(zip(ready, results, strict=True))
        judged = []
        for index, cell in enumerate(cells):
            if (result := by_index.get(index)) is None and index in by_index:
                continue  # it has not ended
            if result is None or isinstance(result, Crash):
                message = (f"not run, the scene has no truth to judge by: {scenes[cell.scene].failure}"
                           if result is None else result.message)
                result = extended(Record, cell.way, scene=cell.scene, version="", message=message, findings=[
                    Finding.ended_early(message)])
            judged.append((cell, result))
        return [replace(each, label=label, default_form=cell.default_form) for (cell, each), label in zip(
            judged, labels([each for _, each in judged]), strict=True)]

    results = stages.run(
        "cell", functools.partial(carried.call, guarded_cell), chosen,
        [keys("cell", cell.scene, cell.way.engine, cell) for cell in chosen],
        [f"{Path(cell.scene).name}: {cell.label}" for cell in chosen], within, failure=_failure,
        on_results=lambda results: on_results(functools.partial(recorded, results)))
    return recorded(results)


def labels(runs: Sequence[Record]) -> list[str]:
    """The name of every run. It has the form only if the method was run in more than one form on any scene."""
    forms = grouped({(run.engine, run.method, run.form) for run in runs if run.form}, lambda each: each[:2])
    return [f"{run.engine} {run.method}"
            + (f" ({run.form})" if run.form and len(forms[run.engine, run.method]) > 1 else "")
            + (f" with {', '.join(named)}" if (named := [*filter(None, [run.coordinate_map]), *run.settings]) else "")
            for run in runs]


def command(name: str, profile: str, scenes: Sequence[str] | None, engines: Sequence[str] | None,
            methods: Sequence[str] | None = None, more: Sequence[str] = ()) -> str:
    """The shell command `name` with these options and `more`."""
    words = [word for option, names in (("--scene", scenes), ("--engine", engines), ("--method", methods))
             for each in names or () for word in (option, str(each))]
    return shlex.join(["crosscheck", name, "--profile", profile, *words, *more])
