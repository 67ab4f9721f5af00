"""The tasks of worker processes (one cell of the grid, or the timing of several), and the loading of their scenes."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from crosscheck.document import Plan
from crosscheck.judge.plan import STUDY_SAMPLES
from crosscheck.scene.model import Scene
from crosscheck.scene.schema import Content

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Cell:
    """One scene with one engine, method and form."""

    scene: str  # a name or a path
    engine: str
    method: str
    form: str | None
    plan: Plan
    study: bool = True  # whether to make the order study, too
    rungs: int | None = None  # number of its steps; None: all
    whole: bool = True  # whether the main run covers the whole scene or only its first window
    default_form: bool = True
    no_truth: str = ""  # why the scene has no truth; then only findings without truth are made
    practical: bool = False  # runs at the plan's practical step, which is too coarse for bounds of states
    coordinate_map: str | None = None  # None: the default of the method
    overrides: tuple[tuple[str, float, str], ...] = ()  # bounds set by the user, see `crosscheck.judge.overrides`
    most_seconds: float | None = None  # limit of processor time (s) of the order study

    @property
    def label(self) -> str:
        """Engine, method and, if it is not the engine's default, form."""
        return f"{self.engine} {self.method}" + ("" if self.default_form or not self.form else f" ({self.form})")

    def command(self, step: float | None, rtol: float | None) -> str:
        """The shell command that repeats the main run."""
        words = ["crosscheck", "run", self.scene, "--engine", self.engine, "--method", self.method]
        words += ["--step", repr(step)] if step is not None else ["--rtol", repr(rtol)]
        words += ["--form", self.form] if self.form else []
        words += ["--map", self.coordinate_map] if self.coordinate_map else []
        if not self.whole or self.plan.duration:
            words += ["--duration", repr(self.plan.duration if self.whole else self.plan.window)]
        return shlex.join([*words, "--samples", str(self.plan.samples), "--csv", "run.csv"])


@dataclasses.dataclass(frozen=True)
class Timing:
    """The cells of one scene in a timing study, and the largest number of repeats."""

    cells: tuple[Cell, ...]
    orders: tuple[int | None, ...]
    repeats: int
    main: tuple[float, ...] = ()  # step (s) or rtol of each cell's main run, which is timed, too


def load(name: str, plan: Plan, whole: bool = True) -> Scene:
    """A scene, or its first window, at the output times of its plan."""
    from crosscheck.scene.file import load_scene

    scene = load_scene(name)
    duration = plan.duration or scene.duration if whole else min(plan.window, scene.duration)
    return scene.replace(duration=duration, samples=plan.samples)


Contents = Mapping[str, Content]
"""Contents of scene files by the names of the scenes."""


def own_contents(names: Sequence[str]) -> Contents:
    """The contents of those scenes that are not bundled with the package."""
    from crosscheck.scene.file import read_scene, scene_names

    return {name: read_scene(name)[1] for name in names if name not in scene_names()}


def with_scenes(contents: Contents, function: Callable[[Any], T], task: Any) -> T:
    """`function(task)`, in which these names stand for these contents. The files need not be on this machine."""
    from crosscheck.scene.file import carry

    carry(contents)
    return function(task)


def windowed(scene: Scene, window: float) -> Scene:
    """The first `window` seconds of a scene, at the output times of the order study."""
    return scene.replace(duration=min(window, scene.duration), samples=STUDY_SAMPLES)
