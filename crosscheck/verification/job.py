"""The main job: truths, every cell of the grid, timings, one document that holds it all, one report written from it."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shlex
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from crosscheck import adapters
from crosscheck.errors import ArgumentError
from crosscheck.files import finite
from crosscheck.jobs.grid import Crash, Limits
from crosscheck.jobs.journal import Journal, Stages
from crosscheck.judge.overrides import Overrides
from crosscheck.judge.plan import PENDING, PLANS, Profile, ScenePlan
from crosscheck.judge.plan import profile as profile_called
from crosscheck.judge.verdict import PASSING, Finding, Record
from crosscheck.running import provenance, support
from crosscheck.verification import trust
from crosscheck.verification.cell import Cell, Timing, prepare_truth
from crosscheck.verification.guarded import check_engines, guarded_cell, guarded_timing
from crosscheck.verification.guarded import limits as default_limits
from crosscheck.verification.listing import all_cells
from crosscheck.verification.speed import measure_speed

Progress = Callable[[int, int, str], None]
"""Called with (tasks done, tasks in all, what ended last)."""


@dataclasses.dataclass
class Results:
    """All that a report needs, and all it may use."""

    meta: dict[str, Any]
    scenes: list[dict[str, Any]]
    records: list[Record]
    support: list[dict[str, Any]] = dataclasses.field(default_factory=list)  # as `running.support.of_scenes` has it

    @property
    def exit_code(self) -> int:
        """0: every verdict passes; 1: one does not; 2: the run itself failed (a scene without truth, nothing ran)."""
        if any("failure" in scene or scene.get("disputed") for scene in self.scenes) or not self.records:
            return 2
        return int(any(record.outcome not in PASSING for record in self.records))

    def plain(self) -> dict[str, Any]:
        """The document as values that JSON knows."""
        records = []
        for record in self.records:
            worst = record.worst
            records.append(dataclasses.asdict(record) | {"word": record.word, "partly": record.partly,
                                                         "worst": dataclasses.asdict(worst) if worst else None})
        return finite({"meta": self.meta, "scenes": self.scenes, "records": records, "exit_code": self.exit_code,
                       "support": self.support})


JOURNAL_TYPES = {"truth": dict[str, Any], "cell": Record, "speed": list[list[tuple[float, float]]]}
"""What the results of each stage are, for `crosscheck.jobs.journal`."""


def select_scenes(names: Sequence[str] | None, every: bool = False) -> list[str]:
    """Names or paths of the scenes to run; every one is loaded once, so that a bad file ends it here.

    None: those with a plan of their own, or `every` scene of the library.
    """
    from crosscheck.scene.file import load_scene, scene_names

    chosen = list(dict.fromkeys(names or (scene_names() if every else PLANS)))
    for name in chosen:
        load_scene(name)
    return chosen


def select_engines(names: Sequence[str] | None, within: Limits | None = None) -> list[str]:
    """Names of the engines to run; `ArgumentError` or `EngineError` for one that is not there or cannot be loaded."""
    check_engines(names or (), within)
    return list(dict.fromkeys(names or adapters.names()))


def fingerprint(profile: str, scenes: Sequence[str] | None, engines: Sequence[str] | None, within: Limits | None,
                *more: Any) -> str:
    """Digest of all that results depend on: scenes, versions, our code and kernel, `more` that JSON knows."""
    from crosscheck.scene.file import load_scene

    names = select_scenes(scenes, profile_called(profile).every_scene)
    return provenance.code_digest(select_engines(engines, within), [
        profile, [[name, load_scene(name).hash] for name in names], *more])


def verify(profile: str = "default", scenes: Sequence[str] | None = None, engines: Sequence[str] | None = None,
           jobs: int = 2, progress: Progress | None = None, journal: Journal | None = None,
           limits: Limits | None = None, overrides: Overrides = ()) -> Results:
    """Run the main job and return its results; nothing is written, except into the journal.

    Parameters
    ----------
    profile : "default", "smoke" or "full"
    scenes : names or paths; None: those with a plan in `crosscheck.judge.plan`, all with the profile "full"
    engines : names; None: all
    jobs : worker processes
    journal : gets every result as it comes in; what it holds already is not run again
    limits : time and resident memory of one cell; None: generous ones
    overrides : bounds set by the user, from `crosscheck.judge.overrides.read`

    Raises
    ------
    SceneError, ArgumentError, EngineError
        Before anything runs.
    """
    if jobs < 1:
        raise ArgumentError(f"jobs has to be at least 1, not {jobs}")
    settings = profile_called(profile)
    within = limits or default_limits()
    scene_names, engine_names = select_scenes(scenes, settings.every_scene), select_engines(engines, within)
    started = time.perf_counter()
    cells = all_cells(scene_names, engine_names, settings, within)
    stages = Stages(jobs, journal, _Counter(len(scene_names) * (1 + bool(settings.timing) + settings.speed)
                                             + len(cells), progress))

    described, plans = _truths(stages, scene_names, settings)
    without = {scene["name"]: scene["no_truth"] for scene in described if "no_truth" in scene}
    cells = [dataclasses.replace(cell, plan=plans.get(cell.scene, PENDING), no_truth=without.get(cell.scene, ""),
                                 overrides=overrides, most_seconds=settings.most_seconds)
             for cell in cells if not (cell.practical and cell.scene in without)]
    records = _records(stages, cells, plans, described, within)
    if settings.timing:
        _time(cells, records, settings.timing, stages.count, within)
    meta = provenance.describe(engine_names) | {"profile": profile, "jobs": jobs, "command": _command(
        profile, scenes, engines, jobs, overrides)}
    if settings.speed:
        meta["calibration"] = measure_speed(records, settings.speed, dataclasses.replace(stages, jobs=1), within)
    meta["seconds"] = journal.seconds if journal is not None else time.perf_counter() - started
    for scene in described:
        scene["plan"] = dataclasses.asdict(plans[scene["name"]]) if scene["name"] in plans else None
    results = Results(meta, described, records, support.of_scenes(scene_names, engine_names, within))
    recommend(results)
    return results


def recommend(results: Results) -> None:
    """Say per scene which runs to trust; again where their times were measured anew."""
    for scene in results.scenes:
        own = [record for record in results.records if record.scene == scene["name"]]
        scene["recommended"] = trust.recommend(scene, own)
        scene["trust"] = trust.sentence(scene, own)


def _truths(stages: Stages, names: list[str], settings: Profile) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """What the report says about every scene, and the plans of those that did not fail."""
    found = stages.run("truth", prepare_truth, [(name, settings.whole, settings.most_steps) for name in names], names,
                       [f"truth of {name}" for name in names], again=True)  # every run of the scene needs it
    described = [_failed_scene(name, each) if isinstance(each, Crash) else each
                 for name, each in zip(names, found, strict=True)]
    plans = {scene["name"]: scene.pop("plan") for scene in described if "failure" not in scene}
    # Out of a journal a plan comes as plain values.
    import msgspec

    return described, {name: plan if isinstance(plan, ScenePlan) else msgspec.convert(plan, ScenePlan, str_keys=True)
                       for name, plan in plans.items()}


def _records(stages: Stages, cells: list[Cell], plans: dict[str, Any], described: list[dict[str, Any]],
             within: Limits) -> list[Record]:
    """The records of all cells, in their order."""
    bodies = {scene["name"]: len(scene["bodies"]) for scene in described if scene["name"] in plans}
    # The longest first, so that no worker is left alone with one at the end.
    ready = sorted((index for index, cell in enumerate(cells) if cell.scene in plans),
                   key=lambda index: (-adapters.pace(cells[index].engine),
                                      -bodies[cells[index].scene] * cells[index].plan.most_steps))
    chosen = [cells[index] for index in ready]
    found = stages.run("cell", guarded_cell, chosen, [_key(cell) for cell in chosen],
                       [f"{cell.scene}: {cell.label}" for cell in chosen], limits=within)
    by_index = dict(zip(ready, found, strict=True))
    records = [_recorded(cell, by_index.get(index), described) for index, cell in enumerate(cells)]
    for cell, record in zip(cells, records, strict=True):
        record.default_form = cell.default_form
    _label(records)
    return records


def _key(cell: Cell) -> str:
    return json.dumps([cell.scene, cell.engine, cell.method, cell.form, cell.practical])


def check_out(out: Path) -> None:
    """Raise `ArgumentError` where a report must not or cannot be written; asked before anything runs.

    A folder is replaced only where it is empty or is a report of ours: its results.json says so.
    """
    try:
        if out.is_symlink() and not out.exists():
            raise ArgumentError(f"--out {out}: a link that leads nowhere; remove it or choose another folder")
        if out.exists() and not out.is_dir():
            raise ArgumentError(f"--out {out}: a file is there; choose a folder that does not exist yet")
        if out.is_dir() and any(out.iterdir()) and not _is_report(out):
            raise ArgumentError(f"--out {out}: this folder holds something else than a report of crosscheck, and would "
                                "be replaced; choose an empty folder or one that does not exist yet")
        place = next(folder for folder in out.resolve().parents if folder.exists())
        try:
            tempfile.TemporaryDirectory(dir=place).cleanup()  # rights alone do not tell: root may write into /proc
        except OSError:
            raise ArgumentError(f"--out {out}: {place} cannot be written; choose another folder") from None
    except OSError as error:
        raise ArgumentError(f"--out {out}: {error.strerror or error}") from None


def _is_report(folder: Path) -> bool:
    """Whether this folder is a report that `write` left, and nobody put anything else into it."""
    from crosscheck.report import is_file_of_report

    try:
        document = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        ours = str(document["meta"]["command"]).startswith("crosscheck verify")
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return ours and all(is_file_of_report(path) for path in folder.iterdir())


def write(results: Results, out: Path) -> Path:
    """Write the report into the folder `out`, replacing an older one only once the new one is complete.

    Returns the path of the page to open; raises `ArgumentError` where `check_out` does, and where writing fails.
    """
    import psutil

    from crosscheck.report import write_report

    check_out(out)
    out = out.resolve()
    aside = out.with_name(f".{out.name}.{os.getpid()}.new")
    old = out.with_name(f".{out.name}.{os.getpid()}.old")
    for leftover in out.parent.glob(f".{out.name}.*.*"):
        if (left := re.fullmatch(r"\.(\d+)\.(new|old)", leftover.name.removeprefix(f".{out.name}"))) and (
                not psutil.pid_exists(int(left[1]))):
            _remove(leftover)  # of a process that was killed as it wrote
    try:
        write_report(results.plain(), aside)
        if out.exists():
            out.rename(old)
        try:
            aside.rename(out)
        except OSError:
            if old.exists():
                old.rename(out)
            raise
    except OSError as error:
        raise ArgumentError(f"--out {out}: the report cannot be written ({error.strerror or error})") from error
    finally:
        for leftover in (aside, old):
            _remove(leftover)
    return out / "index.html"


def _remove(folder: Path) -> None:
    import shutil

    if folder.exists():
        shutil.rmtree(folder)


class _Counter:
    """Counts ended tasks for the progress callback."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self.done, self.total, self.progress = 0, total, progress

    def __call__(self, label: str) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(self.done, self.total, label)


def _blank(cell: Cell, message: str) -> Record:
    record = Record(cell.scene, cell.engine, "", cell.method, cell.form, None, None, None, "")
    record.outcome, record.message = "error", message
    record.findings.append(Finding("run", "fail", None, None, "", "a run has to reach its end", message))
    return record


def _recorded(cell: Cell, result: Record | Crash | None, described: list[dict[str, Any]]) -> Record:
    """The record of a cell, also where its worker crashed or its scene has no truth."""
    if isinstance(result, Record):
        return result
    if isinstance(result, Crash):
        return _blank(cell, result.message)
    failure = next(scene["failure"] for scene in described if scene["name"] == cell.scene)
    return _blank(cell, f"not run, the scene has no truth to judge by: {failure}")


def _label(records: list[Record]) -> None:
    """Name every run; the form only where the same method ran in more than one, on whatever scene."""
    forms: dict[tuple[str, str], set[str]] = {}
    for record in records:
        forms.setdefault((record.engine, record.method), set()).update({record.form} if record.form else ())
    for record in records:
        several = len(forms[record.engine, record.method]) > 1 and record.form
        coarse = f" at {1e3 * record.step:g} ms" if record.practical and record.step else ""
        record.label = f"{record.engine} {record.method}" + (f" ({record.form})" if several else "") + coarse


def _failed_scene(name: str, crash: Crash) -> dict[str, Any]:
    return {"name": name, "failure": crash.message, "details": crash.details}


def _time(cells: list[Cell], records: list[Record], repeats: int, count: Callable[[str], None],
          within: Limits) -> None:
    """Stepping times, one scene after the other in a single worker, with nothing else running.

    Engines in environments of their own are left out: their times compare with no other.
    """
    for scene in dict.fromkeys(cell.scene for cell in cells):
        chosen = [(cell, record) for cell, record in zip(cells, records, strict=True)
                  if cell.scene == scene and record.ladder and not record.own_environment]
        if chosen:
            task = Timing(tuple(cell for cell, _ in chosen), tuple(record.documented_order for _, record in chosen),
                          repeats, tuple(record.step or record.rtol or 0.0 for _, record in chosen))
            timed, reasons = guarded_timing(task, within)
            for index, ((_, record), points) in enumerate(zip(chosen, timed, strict=True)):
                if index in reasons:
                    record.findings.append(Finding("run", "fail", None, None, "", "a run has to reach its end",
                                                   f"in the timing study: {reasons[index]}"))
                    record.outcome = "fail"
                record.timing = [point for point in points if not point["main"]]
                for point in points:
                    if point["main"]:
                        record.us_per_step = point["us_per_step"]
                        record.seconds_per_second = point["seconds_per_second"]
                        record.seconds_deviation = point["seconds_deviation"]
        count(f"timing of {scene}")


def _command(profile: str, scenes: Sequence[str] | None, engines: Sequence[str] | None, jobs: int,
             overrides: Overrides = ()) -> str:
    words = ["crosscheck", "verify", "--profile", profile]
    for option, names in (("--scene", scenes), ("--engine", engines)):
        for name in names or ():
            words += [option, str(name)]
    for name, bound, _ in overrides:
        words += ["--tol", f"{name}={bound!r}"]
    return shlex.join([*words, "--jobs", str(jobs)])
