"""The interface of engine adapters: what one can do, a request, a raw result. An engine knows no tolerances."""

from __future__ import annotations

import dataclasses
from typing import Protocol, TypedDict

import numpy as np

from crosscheck.scene.model import Scene
from crosscheck.scene.states import States


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """How to integrate a scene. At most one of `step` (s) and `rtol` is given; neither means the method's default."""

    method: str
    step: float | None = None
    rtol: float | None = None
    form: str | None = None  # "tree" | "maximal" | "pivot"; None: the best one for the scene
    monitor: bool = True  # evaluate energy, constraint levels and orthogonality after every step
    coordinate_map: str | None = None
    polish: bool | None = None  # False: attitudes keep the rounding errors of products of rotations (lieeuler)
    spin_free: bool | None = None  # given only to an engine that lists it in `options`
    reduce: str | None = None  # "welded" | "planar" | "axis" | "joints" | "off" (lieeuler)
    alpha: float | None = None
    beta: float | None = None
    spectral_radius: float | None = None  # of generalized_alpha
    softness: str | None = None  # "tight" | "default": equality constraints of MuJoCo
    node: str | None = None  # "lie" | "euler_parameters": rigid bodies of Exudyn


ENGINE_OPTIONS = tuple(field.name for field in dataclasses.fields(RunSpec)
                       if field.name not in ("method", "step", "rtol", "monitor"))
"""The names that an engine may list in its `options`."""

CHOICES = {"form": ("tree", "maximal", "pivot"), "coordinate_map": ("exp", "cayley", "ccsk"),
           "reduce": ("welded", "planar", "axis", "joints", "off"),
           "softness": ("tight", "default"), "node": ("lie", "euler_parameters")}
"""The allowed values of options."""


class Stats(TypedDict, total=False):
    """Further results of a run: counters, choices of the engine, and in a `Trajectory` maxima and step.

    An engine of the user may add keys.
    """

    step: float | None  # s, the step used; None if the engine chose its steps
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
    """The result of `Engine.run`: states at the scene's output times, and the cost of stepping.

    `maxima` covers every step (keys of `crosscheck.scene.monitor.MAXIMA`, `constraint_acceleration` only if the engine
    has accelerations). An adapter computes it with `crosscheck.scene.monitor.Monitor`, or leaves it None if
    `spec.monitor` is false.
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

    Entry points and classes of the user need only `name`, `methods`, `unsupported` and `run`, which may return
    `States`; `crosscheck.adapters.foreign.own` supplies defaults for the rest.

    An adapter may also declare:

    - `options`: names of the optional fields of `RunSpec` that it knows; by default all;
    - `adaptive_methods`: methods that take rtol; if declared, the others need a step;
    - `fixed_step_methods`: methods that take a step, if some of these also take rtol;
    - `forms`: model forms, the preferred one first;
    - `pace`: 0, or larger for slower engines, whose runs a grid starts first;
    - `refused_map(spec)`: why a method does not work with `spec.coordinate_map`, None if it does;
    - `on_group`: True if attitudes stay on SO(3) by construction;
    - `eps`: spacing at 1 of its numbers, if they are not doubles (2**-23 for single precision);
    - `dash`, `marker`: its line style and marker in figures, as in Matplotlib;
    - `turning(scene, form)`: the bodies that its model has on coordinates of SO(3), free bodies included. A known
      defect of its methods on such coordinates shows on these bodies.
    """

    name: str
    methods: tuple[str, ...]

    def version(self) -> str:
        """Version of the engine as installed."""

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """Order of accuracy claimed by the engine's documentation or the method's users; None for adaptive methods.

        A claim that is known to be wrong stays here and gets an entry in `crosscheck.judge.known`.
        """

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """Constraint levels ("position", "velocity", "acceleration") that hold to rounding by construction."""

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why this engine cannot run this scene with this request, or None if it can."""

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` with the engine's message if it fails."""


def steps_per_sample(scene: Scene, step: float) -> tuple[int, float]:
    """(steps in one sample interval, step used): the step is shortened to the next one that divides the interval."""
    interval = scene.duration / (scene.samples - 1)
    count = max(1, int(np.ceil(interval / step * (1 - 1e-12))))
    return count, interval / count
