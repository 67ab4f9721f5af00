"""The main job: truths, every cell of the grid, timings, one document that holds it all, one report written from it."""

from __future__ import annotations

import dataclasses
import math
import os
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from crosscheck import provenance, trust
from crosscheck.errors import ArgumentError
from crosscheck.grid import Crash, run_tasks
from crosscheck.spelling import unknown
from crosscheck.studies.cell import Cell, Timing, prepare_truth, run_cell, time_cells
from crosscheck.studies.plan import PENDING, PLANS, Profile
from crosscheck.studies.plan import profile as profile_called
from crosscheck.verdict import PASSING, Finding, Record

Progress = Callable[[int, int, str], None]
"""Called with (tasks done, tasks in all, what ended last)."""


@dataclasses.dataclass
class Results:
    """All that a report needs, and all it may use."""

    meta: dict[str, Any]
    scenes: list[dict[str, Any]]
    records: list[Record]

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
        return _finite({"meta": self.meta, "scenes": self.scenes, "records": records, "exit_code": self.exit_code})


def _finite(value: Any) -> Any:
    """The same with None for every number that is not finite: JSON has no infinity, and no plot shows one."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def select_scenes(names: Sequence[str] | None) -> list[str]:
    """Names or paths of the scenes to run; every one is loaded once, so that a bad file ends it here."""
    from crosscheck.scene_file import load_scene

    chosen = list(dict.fromkeys(names or PLANS))
    for name in chosen:
        load_scene(name)
    return chosen


def select_engines(names: Sequence[str] | None) -> list[str]:
    """Names of the engines to run; `ArgumentError` for one that is not there."""
    from crosscheck import engines

    allowed = engines.names()
    for name in names or ():
        if name not in allowed:
            raise ArgumentError(unknown("engine", name, allowed))
    return list(dict.fromkeys(names or allowed))


def cells_of(scene_name: str, engine_name: str, profile: Profile) -> list[Cell]:
    """The cells of one scene and engine: every method in the form that fits best, then in the other forms."""
    from crosscheck import engines
    from crosscheck.engines.base import RunSpec
    from crosscheck.scene_file import load_scene

    if provenance.engine_version(engine_name) == provenance.NOT_INSTALLED:
        return [Cell(scene_name, engine_name, method, None, PENDING) for method in _methods_in_absence(engine_name)]
    engine, scene = engines.get(engine_name), load_scene(scene_name)
    cells = []
    for method in engine.methods:
        cells.append(Cell(scene_name, engine_name, method, None, PENDING, True, profile.rungs,
                          profile.whole))
        forms = getattr(engine, "forms", ()) if profile.forms else ()
        usable = [form for form in forms if engine.unsupported(scene, RunSpec(method, step=1e-3, form=form)) is None]
        # The first usable form is the engine's choice when none is named.
        cells += [Cell(scene_name, engine_name, method, form, PENDING, True, profile.rungs, profile.whole, False)
                  for form in usable[1:]]
        plan = PLANS.get(scene_name, PENDING)
        spec = RunSpec(method, step=1e-3)
        if profile.whole and plan.practical and engine.documented_order(scene, spec) == 1 and not engine.unsupported(
                scene, spec):
            cells.append(Cell(scene_name, engine_name, method, None, PENDING, study=False, practical=True))
    return cells


def _methods_in_absence(engine_name: str) -> tuple[str, ...]:
    """Methods of an engine that is not installed, where its adapter at least can be imported to name them."""
    from crosscheck import engines

    try:
        return engines.methods(engine_name)
    except ImportError:
        return ("any method",)


def verify(profile: str = "default", scenes: Sequence[str] | None = None, engines: Sequence[str] | None = None,
           jobs: int = 2, progress: Progress | None = None) -> Results:
    """Run the main job and return its results; nothing is written.

    Parameters
    ----------
    profile : "default" or "smoke"
    scenes : names or paths; None: those with a plan in `crosscheck.studies.plan`
    engines : names; None: all
    jobs : worker processes

    Raises
    ------
    SceneError, ArgumentError
        Before anything runs.
    """
    if jobs < 1:
        raise ArgumentError(f"jobs has to be at least 1, not {jobs}")
    settings = profile_called(profile)
    scene_names, engine_names = select_scenes(scenes), select_engines(engines)
    started = time.perf_counter()
    cells = [cell for scene in scene_names for engine in engine_names for cell in cells_of(scene, engine, settings)]
    count = _Counter(len(scene_names) + len(cells) + (len(scene_names) if settings.timing else 0), progress)

    truths = run_tasks(prepare_truth, [(name, settings.whole) for name in scene_names], jobs,
                       lambda i, _: count(f"truth of {scene_names[i]}"))
    described = [_failed_scene(name, found) if isinstance(found, Crash) else found
                 for name, found in zip(scene_names, truths, strict=True)]
    plans = {scene["name"]: scene.pop("plan") for scene in described if "failure" not in scene}
    without = {scene["name"]: scene["no_truth"] for scene in described if "no_truth" in scene}
    cells = [dataclasses.replace(cell, plan=plans.get(cell.scene, PENDING), no_truth=without.get(cell.scene, ""))
             for cell in cells if not (cell.practical and cell.scene in without)]

    # The slowest kind first, so that no worker is left alone with one at the end.
    ready = sorted((index for index, cell in enumerate(cells) if cell.scene in plans),
                   key=lambda index: cells[index].engine != "pinocchio")
    found = run_tasks(run_cell, [cells[index] for index in ready], jobs,
                      lambda i, _: count(f"{cells[ready[i]].scene}: {cells[ready[i]].label}"))
    by_index = dict(zip(ready, found, strict=True))
    records = [_recorded(cell, by_index.get(index), described) for index, cell in enumerate(cells)]
    _label(records)
    if settings.timing:
        _time(cells, records, settings.timing, count)
    meta = provenance.describe(engine_names) | {"profile": profile, "jobs": jobs, "command": _command(
        profile, scenes, engines, jobs), "seconds": time.perf_counter() - started}
    for scene in described:
        scene["plan"] = dataclasses.asdict(plans[scene["name"]]) if scene["name"] in plans else None
        own = [record for record in records if record.scene == scene["name"]]
        scene["recommended"] = trust.recommend(scene, own)
        scene["trust"] = trust.sentence(scene, own)
    return Results(meta, described, records)


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
        if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
            raise ArgumentError(f"--out {out}: {place} cannot be written; choose another folder")
    except OSError as error:
        raise ArgumentError(f"--out {out}: {error.strerror or error}") from None


def _is_report(folder: Path) -> bool:
    """Whether this folder is a report that `write` left, and nobody put anything else into it."""
    import json

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
    from crosscheck.report import write_report

    check_out(out)
    out = out.resolve()
    aside = out.with_name(f".{out.name}.{os.getpid()}.new")
    old = out.with_name(f".{out.name}.{os.getpid()}.old")
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


def _time(cells: list[Cell], records: list[Record], repeats: int, count: _Counter) -> None:
    """Stepping times, one scene after the other in a single worker, with nothing else running."""
    for scene in dict.fromkeys(cell.scene for cell in cells):
        chosen = [(cell, record) for cell, record in zip(cells, records, strict=True)
                  if cell.scene == scene and record.ladder]
        if chosen:
            task = Timing(tuple(cell for cell, _ in chosen), tuple(record.documented_order for _, record in chosen),
                          repeats, tuple(record.step or record.rtol or 0.0 for _, record in chosen))
            timed = run_tasks(time_cells, [task], 1)[0]
            if not isinstance(timed, Crash):
                for (_, record), points in zip(chosen, timed, strict=True):
                    record.timing = [point for point in points if not point["main"]]
                    for point in points:
                        if point["main"]:
                            record.us_per_step = point["us_per_step"]
                            record.seconds_per_second = point["seconds_per_second"]
                            record.seconds_deviation = point["seconds_deviation"]
        count(f"timing of {scene}")


def _command(profile: str, scenes: Sequence[str] | None, engines: Sequence[str] | None, jobs: int) -> str:
    words = ["crosscheck", "verify", "--profile", profile]
    for option, names in (("--scene", scenes), ("--engine", engines)):
        for name in names or ():
            words += [option, str(name)]
    return shlex.join([*words, "--jobs", str(jobs)])
