"""Advice: the method and step of an engine that reach an error on a scene at the lowest cost, found by runs.

`crosscheck.verification.walks` makes the runs once for all errors and compares them with truth.
"""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Sequence

from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.document import Advice
from crosscheck.errors import ArgumentError, CrosscheckError, said
from crosscheck.running import versions
from crosscheck.scene.model import Scene
from crosscheck.verification.walks import USELESS, Step, Walk

LEVELS = tuple(10.0**-power for power in range(2, 12))
"""Errors (m) for which a document has advice."""


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
    from crosscheck.scene.file import as_scene
    from crosscheck.verification.walks import walk

    try:
        wanted = float(error)
    except (TypeError, ValueError):
        wanted = math.nan
    if isinstance(error, bool) or not (math.isfinite(wanted) and wanted > 0):
        raise ArgumentError(f"error: a positive number of metres is wanted, not {error!r}")
    loaded = as_scene(scene)
    versions.need([engine])
    name = scene.name if isinstance(scene, Scene) else os.fspath(scene)
    return choose(walk(loaded, engine), wanted, name)


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


def of_scenes(scenes: Sequence[str], engines: Sequence[str]) -> list[Advice]:
    """The advice for all `LEVELS`, for those scenes (names or paths) and engines whose walks are on the disk."""
    from crosscheck.scene.file import load_scene
    from crosscheck.verification.walks import kept

    # The user's own engines may crash when they are loaded, and engines in their own environments are slow to start.
    tame = [engine for engine in engines if not (adapters.is_own(engine) or adapters.has_own_environment(engine))]
    walked = [(name, kept(load_scene(name), engine)) for name in scenes for engine in tame]
    return [choose(walk, level, name) for name, walk in walked if walk is not None for level in LEVELS]


def prepare(task: tuple[str, str]) -> str:
    """Make the walk of an engine on a scene unless it is on the disk. Returns why it cannot be made, or ""."""
    from crosscheck.scene.file import load_scene
    from crosscheck.verification.walks import walk

    scene, engine = task
    try:
        walk(load_scene(scene), engine)
    except (CrosscheckError, ImportError) as error:
        return said(error)
    return ""
