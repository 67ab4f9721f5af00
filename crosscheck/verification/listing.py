"""The list of cells: every method and form of the chosen engines on the chosen scenes."""

from __future__ import annotations

from collections.abc import Sequence

from crosscheck.jobs.grid import Crash, Limits, run_tasks
from crosscheck.judge.plan import PENDING, PLANS, Profile
from crosscheck.running import provenance
from crosscheck.verification.task import Cell


def all_cells(scene_names: Sequence[str], engine_names: Sequence[str], profile: Profile,
              within: Limits | None = None) -> list[Cell]:
    """The cells of all scenes and engines, scene by scene.

    The user's own engines are asked in a worker process. If one crashes or hangs when asked what it can run, each of
    its methods gets one cell, and the run of that cell shows the reason.
    """
    from crosscheck import adapters

    pairs = [(scene, engine) for scene in scene_names for engine in engine_names]
    risky = [pair for pair in pairs if adapters.is_own(pair[1])]
    told = dict(zip(risky, run_tasks(_cells, [(*pair, profile) for pair in risky], 1, limits=within),
                    strict=True))
    cells: list[Cell] = []
    for scene, engine in pairs:
        found = told[scene, engine] if (scene, engine) in told else cells_of(scene, engine, profile)
        if isinstance(found, Crash):
            found = [Cell(scene, engine, method, None, PENDING, True, profile.rungs, profile.whole)
                     for method in adapters.methods(engine)]
        cells += found
    return cells


def _cells(task: tuple[str, str, Profile]) -> list[Cell]:
    return cells_of(*task)


def cells_of(scene_name: str, engine_name: str, profile: Profile) -> list[Cell]:
    """The cells of one scene and engine: every method in the form that fits best, then in the other forms."""
    from crosscheck import adapters
    from crosscheck.adapters.base import RunSpec
    from crosscheck.scene.file import load_scene

    if provenance.engine_version(engine_name) == provenance.NOT_INSTALLED:
        try:
            methods = adapters.methods(engine_name)
        except ImportError:  # the adapter needs the engine to know its methods
            methods = ("any method",)
        return [Cell(scene_name, engine_name, method, None, PENDING) for method in methods]
    engine, scene = adapters.get(engine_name), load_scene(scene_name)
    cells = []
    for method in engine.methods:
        cells.append(Cell(scene_name, engine_name, method, None, PENDING, True, profile.rungs,
                          profile.whole))
        forms = engine.forms if profile.forms else ()
        usable = [form for form in forms if engine.unsupported(scene, RunSpec(method, step=1e-3, form=form)) is None]
        # The first usable form is the engine's default, which has a cell already.
        cells += [Cell(scene_name, engine_name, method, form, PENDING, True, profile.rungs, profile.whole, False)
                  for form in usable[1:]]
        plan = PLANS.get(scene_name, PENDING)
        spec = RunSpec(method, step=1e-3)
        if profile.whole and plan.practical and engine.documented_order(scene, spec) == 1 and not engine.unsupported(
                scene, spec):
            cells.append(Cell(scene_name, engine_name, method, None, PENDING, study=False, practical=True))
    return cells
