"""Which method of an engine to take on a scene for an error, at which step, and what that costs; by runs against truth.

`crosscheck.verification.walks` makes the runs, once for all errors.
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

    The first call for a scene and engine runs every method at many steps, for at most half a minute, and keeps what it
    found; further calls, for any error, read that.

    Parameters
    ----------
    scene : Scene, str or path
        From `crosscheck.load_scene`, or what it takes.
    engine : str
        As `crosscheck.run` takes it.
    error : float
        m; the largest `|component of x - truth|` over all bodies and output times that is allowed.

    Raises
    ------
    ArgumentError, SceneError
        As `crosscheck.run`.
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
    """The advice for an error (m) from all runs of an engine; `scene` is its name or path for the command."""
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
    """Step (s) or rtol of the finest run coarser than `best` that failed or is wrong by a tenth of the scene's size.

    None where none did: then the method still gives a meaningful answer at the coarsest step there is.
    """
    broken = [step for step in found.of(best.method) if step.fineness < best.fineness
              and (step.error is None or step.error > USELESS * found.size)]
    return (broken[-1].step or broken[-1].rtol) if broken else None


def of_scenes(scenes: Sequence[str], engines: Sequence[str]) -> list[Advice]:
    """The advice for all `LEVELS` on the scenes (names or paths) and engines whose walks are on the disk."""
    from crosscheck.scene.file import load_scene
    from crosscheck.verification.walks import kept

    # Engines of the user's own may crash as they load, and those in environments of their own are slow to ask.
    tame = [engine for engine in engines if not (adapters.is_own(engine) or adapters.has_own_environment(engine))]
    walked = [(name, kept(load_scene(name), engine)) for name in scenes for engine in tame]
    return [choose(walk, level, name) for name, walk in walked if walk is not None for level in LEVELS]


def prepare(task: tuple[str, str]) -> str:
    """Walk through the methods of an engine on a scene, unless that was done; why it cannot be, or nothing."""
    from crosscheck.scene.file import load_scene
    from crosscheck.verification.walks import walk

    scene, engine = task
    try:
        walk(load_scene(scene), engine)
    except (CrosscheckError, ImportError) as error:
        return said(error)
    return ""
