"""The interface of engine adapters: what one can do, a request, a raw result. An engine knows no tolerances."""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import math
from collections.abc import Iterable, Mapping, Sequence
from decimal import ROUND_CEILING, Context
from fractions import Fraction
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypedDict, final

import msgspec
import numpy as np

from crosscheck.errors import ArgumentError, EngineError, Unsupported, said
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

if TYPE_CHECKING:
    from crosscheck.adapters.common.native import JointStates, Native


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """How to integrate a scene. At most one of `step` (s) and `rtol` is given; neither means the method's default."""

    method: str
    step: float | None = None
    rtol: float | None = None
    form: str | None = None  # "tree" | "maximal" | "pivot"; None: the best one for the scene
    monitor: bool = True  # evaluate energy, constraint levels and orthogonality after every step
    coordinate_map: str | None = None
    events: bool | None = None  # whether changes of friction, servos and stops are located in time (lieeuler)
    polish: bool | None = None  # False: attitudes keep the rounding errors of products of rotations (lieeuler)
    spin_free: bool | None = None  # given only to an engine that lists it in `options`
    reduce: str | None = None  # "welded" | "planar" | "axis" | "joints" | "off" (lieeuler)
    alpha: float | None = None
    beta: float | None = None
    spectral_radius: float | None = None  # of generalized_alpha
    correction: str | None = None  # "mass" | "plain": weight of the correction of stabilised methods (lieeuler)
    conserve: bool | None = None  # keep energy and momentum of free bodies in twice the digits (lieeuler)
    softness: str | None = None  # "tight" | "default": equality constraints of MuJoCo
    node: str | None = None  # "lie" | "euler_parameters": rigid bodies of Exudyn


ENGINE_OPTIONS = tuple(field.name for field in dataclasses.fields(RunSpec)
                       if field.name not in ("method", "step", "rtol", "monitor"))
"""The names that an engine may list in its `options`."""

CHOICES = {"form": ("tree", "maximal", "pivot"), "coordinate_map": ("exp", "cayley", "ccsk"),
           "reduce": ("welded", "planar", "axis", "joints", "off"),
           "correction": ("mass", "plain"), "softness": ("tight", "default"), "node": ("lie", "euler_parameters")}
"""The allowed values of options."""


class Stats(TypedDict, total=False):
    """Further results of a run: counters, choices of the engine, and in a `Trajectory` maxima and step.

    An engine of the user may add keys.
    """

    step: float | None  # s, the step used; None if the engine chose its steps
    energy_error: float  # this and the next five: `crosscheck.scene.monitor.MAXIMA`
    kinetic_energy: float
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
    stated_time: float  # s, the wall time that an engine of the user states


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
    sensors: Mapping[str, np.ndarray] | None = None  # readings that the engine made itself; kept in `states`
    events: tuple[tuple[float, str, str], ...] = ()  # time (s), joint, and what happened, as far as the engine says

    def __post_init__(self) -> None:
        if self.sensors is not None and isinstance(self.states, States):
            self.states.sensors = self.sensors


def plain_events(events: object) -> tuple[tuple[float, str, str], ...]:
    """The events of a run as plain data; raises `EngineError` if they are something else."""
    try:
        plain: tuple[tuple[float, str, str], ...] = msgspec.convert(events, tuple[tuple[float, str, str], ...])
        return plain
    except (TypeError, ValueError) as error:
        raise EngineError(f"the events of a run are tuples of a time, a joint and a word: {said(error)}") from None


MOST_STEPS = 10**5
"""Largest number of steps in a sample interval that is tried to meet the period of a servo."""

FIRST = 1
"""The order assumed for a fixed-step method without a claim; every convergent method has it."""


version_of = functools.cache(importlib.metadata.version)
"""Version of an installed package, kept because reading it takes milliseconds."""


class Engine:
    """An engine adapter. It has to give `name`, `methods`, `unsupported` and `run`; all else has a default here."""

    name: str
    methods: tuple[str, ...]
    package: str = ""  # the distribution whose version is that of the engine
    forms: tuple[str, ...] = ()  # model forms, the preferred one first
    adaptive_methods: tuple[str, ...] = ()  # methods that take rtol
    orders: Mapping[str, int] = MappingProxyType({})  # claimed by method, where they do not depend on the scene
    checks_sizes: bool = False  # it refuses a wrong choice of step or rtol itself, in `unsupported`
    pace: int = 0  # larger for slower engines, whose runs a grid starts first
    on_group: bool = False  # attitudes stay on SO(3) by construction
    eps: float = 2.0**-52  # spacing at 1 of its numbers
    interpolation: float = 0.0  # error of outputs that are interpolated between steps, over the tolerance
    reads: tuple[str, ...] = ()  # endings of the model files that `native` reads

    @functools.cached_property
    def options(self) -> frozenset[str]:
        """Names of the optional fields of `RunSpec` that it knows."""
        return frozenset({"form"} if self.forms else ())

    @functools.cached_property
    def fixed_step_methods(self) -> tuple[str, ...]:
        """Methods that take a step; some may also take rtol."""
        return tuple(method for method in self.methods if method not in self.adaptive_methods)

    def version(self) -> str:
        """Version of the engine as installed."""
        return version_of(self.package) if self.package else ""

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """Order of accuracy claimed by the engine's documentation or the method's users; None for adaptive methods.

        A claim that is known to be wrong stays here and is an entry of known.toml.
        """
        return None if spec.method in self.adaptive_methods else self.orders.get(spec.method, FIRST)

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """Constraint levels ("position", "velocity", "acceleration") that hold to rounding by construction."""
        return frozenset()

    def iteration(self, scene: Scene, spec: RunSpec) -> float:
        """What an iteration leaves in positions in one step, m: its tolerance times a scale. The verdict allows so much
        in every step, grown as errors grow, and states it as declared.
        """
        return 0.0

    def refused_map(self, spec: RunSpec) -> str | None:
        """Why a method does not work with `spec.coordinate_map`, or None if it does."""
        return None

    def turning(self, scene: Scene, form: str | None) -> Sequence[int]:
        """The bodies that its model has on coordinates of SO(3), free bodies included.

        A known defect of its methods on such coordinates shows on these bodies.
        """
        return range(scene.n)

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why this engine cannot run this scene with this request, or None if it can."""
        raise NotImplementedError

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` with the engine's message if it fails."""
        raise NotImplementedError

    def native(self, path: str, states: JointStates) -> Native:
        """The model that the engine makes of a model file by itself; raises `Unsupported` where it reads none."""
        raise Unsupported(f"{self.name} reads no model files here")

    def own_law(self, scene: Scene, spec: RunSpec) -> States | None:
        """The motion under laws of its own that the engine documents, integrated without it; None if it has none."""
        return None

    def nearest_law(self, scene: Scene, spec: RunSpec) -> RunSpec | None:
        """The request that comes nearest to the laws of the scene, if it is another one."""
        return None

    def own_words(self, spec: RunSpec) -> str:
        """What a user of the engine alone writes for its softness, "" if there is nothing to write."""
        return ""

    def probe(self, scene: Scene, states: States, form: str | None) -> Any:
        """What its model says about the scene at some states, a `crosscheck.inspection.Probe`."""
        raise Unsupported(f"the adapter of {self.name} has no method probe(scene, states, form)")

    @final
    def takes(self, wanted: Iterable[tuple[str, Any]]) -> dict[str, Any]:
        """Those of the options `wanted`, with their values, that the engine has."""
        return {name: value for name, value in wanted if name in self.options}


class StandIn(Engine):
    """An engine in place of another one: what its class does not define is as the other one declares it."""

    def __init__(self, engine: Any) -> None:
        self._engine = engine
        for name in (*Engine.__annotations__, *vars(Engine)):
            default, here = getattr(Engine, name, None), getattr(type(self), name, None)
            fixed = name.startswith("_") or here is not default or getattr(default, "__final__", False)
            if not fixed and hasattr(engine, name):
                vars(self)[name] = getattr(engine, name)


def steps_per_sample(scene: Scene, step: float) -> tuple[int, float]:
    """(steps in one sample interval, step used): the step is shortened to the next one that divides the interval.

    It also divides the periods of sampled servos. Raises `ArgumentError` if there is no such step.
    """
    interval = scene.interval
    count, least = _steps_in(interval, step), 1
    for name, servo in scene.servos.values():
        for time in (servo.period, servo.phase):
            ratio = Fraction((time or 0.0) / interval).limit_denominator(MOST_STEPS)
            if abs(ratio * interval - (time or 0.0)) > 1e-9 * interval:
                raise ArgumentError(f"samples: no step divides both the interval between samples, {interval:g} s, and "
                                    f"the period {time:g} s of the servo of joint {name!r}; choose another number")
            least = math.lcm(least, ratio.denominator)
    count = -(-count // least) * least
    return count, interval / count


def _steps_in(interval: float, step: float) -> int:
    """The fewest steps in an interval (s) of which none is longer than `step` (s), but for rounding."""
    return max(1, math.ceil(interval / step * (1 - 1e-12)))


def step_text(interval: float, step: float) -> str:
    """The step (s) to three digits, or as many as keep the number of steps that a run makes in an interval (s)."""
    count = _steps_in(interval, step)
    for digits in range(3, 17):
        value = float(Context(prec=digits, rounding=ROUND_CEILING).create_decimal_from_float(step * (1 - 1e-14)))
        if _steps_in(interval, value) == count:
            return repr(value)
    return repr(step)
