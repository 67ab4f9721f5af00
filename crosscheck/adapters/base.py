"""What an engine adapter is: what it can do, one request, one raw result. An engine knows no tolerance."""

from __future__ import annotations

import dataclasses
from typing import Protocol, TypedDict

import numpy as np

from crosscheck.scene.model import Scene
from crosscheck.scene.states import States


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """How to integrate a scene. Exactly one of `step` (s) and `rtol` is given, or neither for a method's default."""

    method: str
    step: float | None = None
    rtol: float | None = None
    form: str | None = None  # "tree" | "maximal" | "pivot"; None: the best that fits the scene
    monitor: bool = True  # evaluate energy, constraint levels and orthogonality after every step
    coordinate_map: str | None = None
    polish: bool | None = None  # False: attitudes keep what rounding does to products of rotations (lieeuler)
    spin_free: bool | None = None  # only ever given to an engine that lists it in `options`
    reduce: str | None = None  # "planar" | "axis" | "off": mechanisms in their plane (lieeuler)
    alpha: float | None = None
    beta: float | None = None
    spectral_radius: float | None = None  # of generalized_alpha
    softness: str | None = None  # "tight" | "default": equality constraints of MuJoCo
    node: str | None = None  # "lie" | "euler_parameters": rigid bodies of Exudyn


ENGINE_OPTIONS = tuple(field.name for field in dataclasses.fields(RunSpec)
                       if field.name not in ("method", "step", "rtol", "monitor"))
"""What an engine may list in its `options`."""

CHOICES = {"form": ("tree", "maximal", "pivot"), "coordinate_map": ("exp", "cayley", "ccsk"),
           "reduce": ("planar", "axis", "off"), "softness": ("tight", "default"), "node": ("lie", "euler_parameters")}
"""The words that options take."""


class Stats(TypedDict, total=False):
    """What a run tells besides its states: counters, what the engine chose, and in a `Trajectory` maxima and step.

    An engine of the user's own may add keys.
    """

    step: float | None  # s, the step used; None where the engine chose its steps
    energy_error: float  # this and the next four: `crosscheck.scene.monitor.MAXIMA`
    constraint_position: float
    constraint_velocity: float
    constraint_acceleration: float
    orthogonality: float
    rejected_steps: int
    force_evaluations: int
    newton_iterations: int
    most_iterations: int  # of Newton's method in one step
    factorizations: int
    redundant_rows: int
    spin_free: tuple[str, ...]  # names of bodies
    reduce: str
    softness: str
    node: str
    newton_tolerance: float
    newton_left: float
    cardan_order: str
    gimbal_clearance: float
    forward_dynamics: str  # Pinocchio's algorithm
    constraint_models: int
    constraint_rank: int
    own_environment: bool


@dataclasses.dataclass
class RawRun:
    """What `Engine.run` returns: states at the scene's output times, and what stepping cost.

    `maxima` covers every step (keys of `crosscheck.scene.monitor.MAXIMA`), `constraint_acceleration` included
    where the engine has accelerations; an adapter builds it with `crosscheck.scene.monitor.Monitor`, or leaves it
    None when `spec.monitor` is false.
    """

    states: States
    wall_time: float  # s, stepping only: no model building, no conversion
    steps: int
    step: float | None  # the step used, s
    status: str = "success"
    stats: Stats = dataclasses.field(default_factory=lambda: Stats())
    maxima: dict[str, float] | None = None
    form: str | None = None


class Engine(Protocol):
    """An engine adapter.

    Entry points and classes of the user's own need only `name`, `methods`, `unsupported` and `run`, which may return
    `States`: `crosscheck.adapters.foreign.own` has the defaults for the rest.

    It may also declare:

    - `options`: names of the optional fields of `RunSpec` it knows; without it, all;
    - `adaptive_methods`: those that take rtol; with it, the others must be given a step;
    - `fixed_step_methods`: those that take a step, where they are more than the others;
    - `forms`: model forms, the preferred one first;
    - `pace`: 0, or more the slower its runs are, which a grid of runs then starts first;
    - `refused_map(spec)`: why a method does not work with `spec.coordinate_map`, None where it does;
    - `on_group`: True where attitudes stay on SO(3) by construction, so that no product of rotations leaves it;
    - `eps`: spacing at 1 of the numbers it computes with, where these are no doubles (2**-23 of single precision);
    - `dash`, `marker`: how figures draw it, in Matplotlib's words;
    - `turning(scene, form)`: the bodies its model carries on coordinates of SO(3), a free body among them: where its
      methods have a known defect on such coordinates, these are the bodies it shows on.
    """

    name: str
    methods: tuple[str, ...]

    def version(self) -> str:
        """Version of the engine as installed."""

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """Order of accuracy claimed by the engine's documentation or the method's users; None for adaptive methods.

        A claim known to be wrong stays, with an entry in `crosscheck.judge.known`.
        """

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """Constraint levels ("position", "velocity", "acceleration") this method holds at rounding by construction."""

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why this engine cannot run this scene in this way, or None where it can."""

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` with the engine's words when it fails."""


def steps_per_sample(scene: Scene, step: float) -> tuple[int, float]:
    """(steps in one sample interval, step used): the step shortened to the nearest one that divides the interval."""
    interval = scene.duration / (scene.samples - 1)
    count = max(1, int(np.ceil(interval / step * (1 - 1e-12))))
    return count, interval / count
