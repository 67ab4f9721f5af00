"""Advice: the method and step of an engine that reach an error on a scene at the lowest cost, found by runs.

`crosscheck.verification.walks` makes the runs once for all errors and compares them with truth. Where a document has
no such runs, its records say what to expect: the error and time of a run at one step, and the observed order.
"""

from __future__ import annotations

import contextlib
import math
import os
import shlex
from collections.abc import Sequence

from msgspec.structs import replace

from crosscheck.document import Advice, Record, SceneTruth
from crosscheck.errors import ArgumentError, CrosscheckError, EngineDied, said
from crosscheck.jobs.table import Table
from crosscheck.running import versions
from crosscheck.scene.file import as_scene, load_scene
from crosscheck.scene.model import Scene
from crosscheck.verification import walks
from crosscheck.verification.walks import USELESS, Step, Walk

LEVELS = tuple(10.0**-power for power in range(2, 12))
"""Errors (m) for which a document has advice."""


MARGIN = 1.5
"""What an estimated error keeps from the wanted one: on the default scenes estimates were off by up to 1.25."""


def advise(scene: Scene | str | os.PathLike[str], *, engine: str, error: float) -> Advice:
    """The cheapest method of an engine whose error on a scene is at most `error`, with its largest step.

    The first call for a scene and engine runs every method at many steps, for at most half a minute of processor time,
    and stores the results. Later calls, for any error, read them.

    Parameters
    ----------
    scene : Scene, str or path
        A scene from `crosscheck.load_scene`, the name of a bundled scene, or the path of a scene file.
    engine : str
        As in `crosscheck.run`.
    error : float
        The largest allowed `|component of x - truth|` over all bodies and output times, m.

    Raises
    ------
    ArgumentError, SceneError
        As in `crosscheck.run`.
    Unsupported
        The engine cannot model the scene, or the scene has no truth.
    TruthError
        The two formulations of the truth disagree.
    """
    try:
        wanted = float(error)
    except (TypeError, ValueError):
        wanted = math.nan
    if isinstance(error, bool) or not (math.isfinite(wanted) and wanted > 0):
        raise ArgumentError(f"error: a positive number of metres is wanted, not {error!r}")
    loaded = as_scene(scene)
    versions.need([engine])
    name = scene.name if isinstance(scene, Scene) else os.fspath(scene)
    return choose(walked(loaded, engine), wanted, name)


def walked(scene: Scene, engine: str) -> Walk:
    """The walk of an engine from the table, where it is put if it is new; errors as `walks.walk`."""
    key = walks.key(scene, engine)
    with contextlib.closing(Table.opened()) as table, table.session(
            key, f"advise {scene.name} {engine}", {"walk": Walk}) as session:
        found: Walk | None = session.get("walk", key)
        return found or session.put("walk", key, walks.walk(scene, engine))


def choose(found: Walk, wanted: float, scene: str) -> Advice:
    """The advice for an error (m) from all runs of an engine. `scene` is the name or path for the command."""
    known = [step.error for step in found.steps if step.error is not None]
    reaching = found.reaching(wanted)
    advice = Advice(scene=found.scene, engine=found.engine, wanted=wanted, until=found.until,
                    least=min(known, default=None))
    if not reaching:
        return advice
    best = reaching[0]
    size = f"--step {best.step:.12g}" if best.step else f"--rtol {best.rtol!r}"
    words = f"crosscheck run {shlex.quote(scene)} --engine {shlex.quote(found.engine)} --method {best.method} {size}"
    return replace(
        advice, method=best.method, form=best.form, step=best.step, rtol=best.rtol, error=best.error, cost=best.cost,
        breaks_at=breaks_at(found, best), command=words)


def breaks_at(found: Walk, best: Step) -> float | None:
    """Step (s) or rtol of the finest of the useless runs that are coarser than `best`.

    A run is useless if it failed or if its error exceeds a tenth of the scene's size. None if no run is useless.
    """
    broken = [step for step in found.of(best.method) if step.fineness < best.fineness
              and (step.error is None or step.error > USELESS * found.size)]
    return (broken[-1].step or broken[-1].rtol) if broken else None


def of_walks(scenes: Sequence[str], found: Sequence[Walk | str | None]) -> list[Advice]:
    """The advice for all `LEVELS` from the walks on scenes (names or paths) that could be made."""
    return [choose(walk, level, name) for name, walk in zip(scenes, found, strict=True) if isinstance(walk, Walk)
            for level in LEVELS]


def from_records(scenes: Sequence[SceneTruth], records: Sequence[Record], known: Sequence[Advice]) -> list[Advice]:
    """The advice for all `LEVELS` that records allow, for scenes and engines for which none is known."""
    walks_of = {(each.scene, each.engine) for each in known}
    return [_estimate(scene, [record for record in records if (record.scene, record.engine) == (scene.name, engine)],
                      level)
            for scene in scenes if scene.truth is not None and scene.plan is not None
            for engine in dict.fromkeys(record.engine for record in records if record.scene == scene.name
                                        and record.outcome != "unsupported")
            if (scene.name, engine) not in walks_of for level in LEVELS]


def _estimate(scene: SceneTruth, records: Sequence[Record], wanted: float) -> Advice:
    """The cheapest of the passing runs of an engine, each at the largest step that its order promises the error for.

    No step is longer than the coarsest one at which the order was observed, and none shorter than a hundredth of the
    step of the run: beyond them the order is not known to hold.
    """
    passing = [record for record in records if record.outcome in ("pass", "partly")
               and math.isfinite(record.judged_error) and record.wall_time]
    advice = Advice(scene=scene.name, engine=records[0].engine, wanted=wanted, until=scene.duration,
                    least=min((record.judged_error for record in passing), default=None))
    expected = [each for record in passing if (each := _expected(scene, record, advice)) is not None]
    return min(expected, key=lambda each: each.cost or 0.0, default=advice)


def _expected(scene: SceneTruth, record: Record, asked: Advice) -> Advice | None:
    """The run at the step that a record lets expect for an error; None if the record promises no such step."""
    wanted = asked.wanted
    error, step, order = record.judged_error, record.step, record.orders.get("position")
    assert scene.plan is not None
    assert record.wall_time is not None
    estimated = f"the run at rtol {record.rtol:g}" if step is None else f"the run at {step:g} s"
    stretch = 1.0
    if step is not None and order is not None and order.observed and order.settled and error > order.rounding:
        coarsest = max((rung.step for rung in record.ladder if rung.step and not rung.message), default=step)
        interval = scene.duration / (scene.plan.samples - 1)
        longest = min(step * (wanted / MARGIN / error) ** (1 / order.observed), max(coarsest, step), interval)
        if longest < step / 100 or wanted < order.rounding:
            return None
        stretch = interval / math.ceil(interval / longest * (1 - 1e-9)) / step
        error *= stretch**order.observed
        estimated += f" and its observed order {order.observed:.2f}"
    if error > wanted * (1 + 1e-9):
        return None
    command = record.command.partition(" --samples ")[0]
    if step is not None:
        command = command.replace(f"--step {step!r}", f"--step {step * stretch:.12g}")
    return replace(asked, until=record.judged_until or scene.duration, method=record.method, form=record.form,
                   step=None if step is None else step * stretch, rtol=record.rtol, error=error,
                   cost=record.wall_time / stretch, command=command, estimated=estimated)


def prepare(task: tuple[str, str]) -> Walk | str:
    """The walk of an engine on a scene, or why it cannot be made."""
    scene, engine = task
    try:
        return walks.walk(load_scene(scene), engine)
    except EngineDied:
        raise
    except (CrosscheckError, ImportError) as error:
        return said(error)
