"""The cells of the grid, which are tasks of worker processes, and the loading of their scenes."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec, step_text
from crosscheck.document import Plan, Way, set_words
from crosscheck.jobs.drive import Crash, Limits, Place, run_tasks
from crosscheck.running import cluster, provenance
from crosscheck.scene.file import carry, load_scene, read_scene, scene_names
from crosscheck.scene.model import Scene
from crosscheck.scene.schema import Content
from crosscheck.verification.plan import PENDING, Profile

T = TypeVar("T")
Task = TypeVar("Task")


@dataclasses.dataclass(frozen=True)
class Cell:
    """One scene and one way to run it."""

    scene: str  # a name or a path
    way: Way  # without step and rtol, which are those of the plan
    plan: Plan
    default_form: bool = True
    no_truth: str = ""  # why the scene has no truth; then only findings without truth are made
    overrides: tuple[tuple[str, float, str], ...] = ()  # tolerances of the user, see `crosscheck.judge.overrides`
    as_planned: bool = True  # whether steps and duration are those of the library, where known defects were measured

    @property
    def label(self) -> str:
        """Engine, method and, if it is not the engine's default, form."""
        form = "" if self.default_form or not self.way.form else f" ({self.way.form})"
        return f"{self.way.engine} {self.way.method}{form}"

    def command(self, way: Way, interval: float) -> str:
        """The shell command that repeats the main run, which is run in this way with outputs at an interval (s)."""
        words = ["crosscheck", "run", self.scene, "--engine", way.engine, "--method", way.method]
        words += ["--step", step_text(interval, way.step)] if way.step is not None else ["--rtol", repr(way.rtol)]
        words += ["--form", way.form] if way.form else []
        words += set_words((("coordinate_map", way.coordinate_map), *way.options))
        words += ["--duration", repr(self.plan.duration)] if self.plan.duration else []
        return shlex.join([*words, "--samples", str(self.plan.samples), "--csv", "run.csv"])


def load(name: str, plan: Plan) -> Scene:
    """A scene at the output times of its plan."""
    scene = load_scene(name)
    return scene.lasting(plan.duration or scene.duration).replace(samples=plan.samples)


@dataclasses.dataclass(frozen=True)
class Carried:
    """What tasks in other processes and on other machines need of this one."""

    scenes: Mapping[str, Content] = dataclasses.field(default_factory=dict)  # contents of files, by names of scenes
    engines: Mapping[str, Mapping[str, bytes]] = dataclasses.field(default_factory=dict)  # as `adapters.sources`

    @classmethod
    def of(cls, scenes: Sequence[str], engines: Sequence[str]) -> Carried:
        """Those scenes and engines that are not bundled with the package."""
        return cls({name: read_scene(name)[1] for name in scenes if name not in scene_names()},
                   adapters.sources(engines))

    def call(self, function: Callable[[Task], T], task: Task) -> T:
        """`function(task)` with these scenes and engines. Their files need not be on this machine."""
        carry(self.scenes)
        return cluster.carrying(self.engines, function, task)


def all_cells(scene_names: Sequence[str], engine_names: Sequence[str], profile: Profile,
              within: Limits | None = None, place: Place | None = None) -> list[Cell]:
    """The cells of all scenes and engines, scene by scene.

    The user's own engines are asked in a worker process, one of `place` if it is given. If one crashes or hangs when
    asked what it can run, each of its methods gets one cell, and the run of that cell shows the reason.
    """
    pairs = [(scene, engine) for scene in scene_names for engine in engine_names]
    risky = [pair for pair in pairs if adapters.is_own(pair[1])]
    cells_by_pair = dict(zip(risky, run_tasks(_cells, [(*pair, profile) for pair in risky], 1, limits=within,
                                          place=place), strict=True))
    cells: list[Cell] = []
    for pair in pairs:
        own = cells_by_pair[pair] if pair in cells_by_pair else cells_of(*pair, profile)
        cells += own if not isinstance(own, Crash) else [
            Cell(pair[0], Way(pair[1], method), PENDING)
            for method in adapters.methods(pair[1])]
    return cells


def _cells(task: tuple[str, str, Profile]) -> list[Cell]:
    return cells_of(*task)


def cells_of(scene_name: str, engine_name: str, profile: Profile) -> list[Cell]:
    """The cells of one scene and engine: every method in the form that fits best, then in the other forms."""
    if provenance.engine_version(engine_name) == provenance.NOT_INSTALLED:
        try:
            methods = adapters.methods(engine_name)
        except ImportError:  # the adapter needs the engine to know its methods
            methods = ("any method",)
        return [Cell(scene_name, Way(engine_name, method), PENDING) for method in methods]
    engine, scene = adapters.get(engine_name), load_scene(scene_name)
    cells = []
    for method in engine.methods:
        forms = engine.forms if profile.forms else ()
        usable = [form for form in forms if engine.unsupported(scene, RunSpec(method, step=1e-3, form=form)) is None]
        # The first usable form is the engine's default.
        cells += [Cell(scene_name, Way(engine_name, method, form=form), PENDING, form is None)
                  for form in (None, *usable[1:])]
    return cells
