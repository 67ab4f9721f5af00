"""The document of a run: one set of types from the journal to the page.

A run is a `Run`, then `Measured`, then `Judged`, then `Timed`: each stage returns a new value of its own type, which
has the fields of the stages before, and nothing is changed in place. `Document` is results.json; its JSON Schema is
made from these types (`crosscheck.report.schema`). SI units, angles in rad; None where there is no figure.
"""

from __future__ import annotations

import math
from typing import Literal

from crosscheck.document.curves import RunCurves, SceneCurves
from crosscheck.document.origin import AS_PLANNED as AS_PLANNED
from crosscheck.document.origin import Asked as Asked
from crosscheck.document.origin import Calibration as Calibration
from crosscheck.document.origin import Machine as Machine
from crosscheck.document.origin import Meta as Meta
from crosscheck.document.origin import Origin as Origin
from crosscheck.document.part import Part as Part
from crosscheck.document.part import extended as extended

SCHEMA = 1
"""Version of results.json: raised where a key changes its meaning or goes; new keys alone do not raise it."""

EULER = ("DAE3L_LE", "DAE2L_LE", "DAE2L_LSE", "DAE1L_LSE", "DAE3H_LE", "DAE2H_LE", "DAE2H_LSE", "DAE1H_LSE")
"""The eight Lie group Euler methods of [P1], in the order of its tables (doi:10.1177/1687814019842406)."""

QUANTITIES = {"position": "m", "attitude": "rad", "velocity": "m/s", "angular velocity": "rad/s"}
"""The quantities compared with truth, and their units."""

LEVELS = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
"""Constraint levels and the units of their rows."""

Outcome = Literal["pass", "partly", "known", "fail", "error", "unjudged", "unsupported"]
Status = Literal["ok", "fail", "known", "unjudged"]

PASSING = ("pass", "partly", "known", "unsupported", "unjudged")
"""Outcomes that leave the exit code at 0."""


# --- scenes


class Truth(Part, frozen=True, kw_only=True):
    """Where the truth of a scene comes from, and how far to trust it."""

    source: str
    second_source: str
    disagreement: float
    allowed: float
    amplification: float
    error: float | None = None  # how wrong it may be, over the length of the scene
    horizon: float  # s
    outvoted: str = ""  # which formulation two others outvoted, and by how much


class Plan(Part, frozen=True):
    """Steps for one scene.

    `steps` maps a documented order to the step (s) of the main run over the whole scene, `ladders` to the steps of the
    order study over the first `window` seconds, coarse to fine. Orders that are not listed use the next lower one.
    """

    window: float
    steps: dict[int, float]
    ladders: dict[int, tuple[float, ...]]
    rtol: float = 1e-9
    practical: float | None = None  # s; first-order methods also run at this step, for what a user meets who starts so
    samples: int = 251  # output times of the main run: smooth curves on a screen, and no more
    duration: float | None = None  # s; main runs end here where the scene itself is longer
    budgeted: bool = False  # a budget of steps or the user decided, so that no bound may be able to judge a run

    @property
    def most_steps(self) -> float:
        """Steps of the finest run of the order studies, over the window."""
        return max((self.window / ladder[-1] for ladder in self.ladders.values()), default=0.0)

    def step(self, order: int) -> float:
        """Step (s) of the main run of a method of this order."""
        return self.steps[max(key for key in self.steps if key <= order)]

    def ladder(self, order: int, rungs: int | None = None) -> tuple[float, ...]:
        """Steps (s) of the order study; where `rungs` asks for fewer, those that show the order best.

        Low orders show it in their finest steps, high ones in their coarsest, above the rounding plateau.
        """
        steps = self.ladders[max(key for key in self.ladders if key <= order)]
        return steps if rungs is None else steps[-rungs:] if order <= 2 else steps[:rungs]


class Scales(Part, frozen=True, kw_only=True):
    """Sizes of a scene that turn errors of states into errors of everything else; from the scene and its truth."""

    length: float  # m, the longest lever from a centre of mass to a joint
    speed: float  # m/s, largest speed of a centre of mass
    rate: float  # rad/s, W': largest angular speed, or the rate of falling through the length where that is larger
    unit_rate: float  # rad/s, W: the same at the start; the unit in which truth perturbs velocities
    reach: float  # m, farthest centre of mass from the origin
    kinetic: float  # J, largest kinetic energy
    momentum: float  # kg m^2/s, what the angular momentum could be at these speeds

    @property
    def units(self) -> dict[str, float]:
        """What an error of one in the state y is in each compared quantity, see `crosscheck.judge.tolerances`."""
        return {"position": self.length, "attitude": 1.0, "velocity": self.length * self.rate,
                "angular velocity": self.rate}

    def of(self, quantity: str) -> float:
        """Size of a compared quantity, in its unit: an error beyond this says nothing any more."""
        return {"position": max(self.length, self.reach), "attitude": 1.0, "velocity": self.speed,
                "angular velocity": self.rate}[quantity]


class Recommended(Part, frozen=True, kw_only=True):
    """Which runs to trust, the fastest first, with the figures of the first."""

    runs: list[str]
    step: float | None
    rtol: float | None
    error: float  # m, the largest judged position error
    until: float | None  # s, judged up to
    seconds: float | None  # of stepping per simulated second
    why: str
    share: float = 1.0  # of its time, over which the motion of the first was judged


class EngineTrust(Part, frozen=True, kw_only=True):
    """What to trust of one engine on a scene, by the runs that were made."""

    engine: str
    runs: int
    passing: int
    recommended: Recommended | None
    text: str


class SceneTruth(Part, frozen=True, kw_only=True, omit_defaults=True):
    """A scene, its plan and its truth; what is wrong with it where it has none."""

    name: str
    title: str
    description: str
    source: str
    hash: str
    bodies: list[str]
    duration: float  # s
    plan: Plan | None
    truth: Truth | None
    scales: Scales | None
    rounding: dict[str, tuple[float, float]] | None = None  # see `crosscheck.judge.tolerances.rounding_levels`
    no_truth: str = ""  # why there is none
    disputed: bool = False  # two formulations of the truth disagreed
    failure: str = ""  # why the scene could not be prepared at all
    details: str = ""  # of the failure
    curves: SceneCurves = SceneCurves()


class Scene(SceneTruth, frozen=True, kw_only=True, omit_defaults=True):
    """A scene as the document has it: also which of its runs to trust."""

    trust: str
    recommended: Recommended | None
    engines: list[EngineTrust] = []


# --- runs


class Finding(Part, frozen=True):
    """One judged figure of a run."""

    kind: str  # quantity of metrics, "energy", "momentum", "level position", "orthogonality", "order position", "run"
    status: Status
    value: float | None
    bound: float | None
    unit: str
    why: str
    detail: str = ""  # where and when, or what is known about it

    @property
    def severity(self) -> float:
        """log10 of the value over its bound, infinite for what is not finite; of orders, tenths below the bound."""
        if self.value is None or self.bound is None or not math.isfinite(self.value):
            return math.inf if self.status in ("fail", "known") else -math.inf
        if self.kind.startswith("order"):
            return 10.0 * (self.bound - self.value)
        if self.value == 0:
            return -math.inf  # nothing of it at all, also where the bound is 0
        return math.log10(max(self.value, 1e-300) / max(self.bound, 1e-300))


class Errors(Part, frozen=True, kw_only=True):
    """Errors of one quantity against truth, the worst body."""

    unit: str
    end: float | None
    max: float | None
    time: float | None  # s, of the largest
    body: str
    judged: float | None = None
    bound: float | None = None
    why: str = ""


class Level(Part, frozen=True, kw_only=True):
    """Largest constraint row at one level, and whether the method holds this level by construction."""

    max: float | None
    held: bool
    unit: str


class Order(Part, frozen=True, kw_only=True):
    """Order fitted to errors at several steps."""

    observed: float | None  # None where fewer than three steps lie above the rounding plateau
    documented: int
    used: int  # steps that took part
    pairs: tuple[float | None, ...]  # orders between neighbouring steps, all of them, coarse to fine
    note: str = ""
    settled: bool = True  # the last three orders between neighbouring steps above the plateau agree
    exhausted: bool = False  # the finest step lies on the plateau, a finer one would show nothing but rounding
    finest: float | None = None  # order between the two finest steps above the plateau, where orders rise towards it
    rounding: float = 0.0  # largest error at the finer steps at which errors fall no more


class Rung(Part, frozen=True, kw_only=True):
    """One step, or tolerance, of the order study."""

    step: float | None  # s
    rtol: float | None
    errors: dict[str, float | None] = {}  # largest of the window
    end: dict[str, float | None] = {}  # at its end
    wall_time: float | None = None  # s
    steps: int | None = None
    guide: float | None = None  # m, the documented slope through the coarsest rung
    message: str = ""  # why there is no figure


class Point(Part, frozen=True, kw_only=True):
    """One step, or tolerance, of the timing study."""

    step: float | None  # s
    rtol: float | None
    wall_time: float  # s, median
    steps: int
    us_per_step: float
    seconds_per_second: float  # of stepping per simulated second
    seconds_deviation: float  # median absolute deviation
    error: float | None  # m, at the end
    main: bool  # at the step of the main run


class Speed(Part, frozen=True, kw_only=True):
    """Time per step of a run. `ratio` is that over the time of the calibration kernel beside it."""

    us_per_step: float
    us_deviation: float  # median absolute deviation over the repeats
    ratio: float
    deviation: float
    repeats: int
    calibration: float  # us


class Run(Part, frozen=True, kw_only=True):
    """Which run this is."""

    scene: str
    engine: str
    version: str
    method: str
    form: str | None
    step: float | None = None  # s
    rtol: float | None = None
    documented_order: int | None = None
    coordinate_map: str | None = None  # None: the method's own
    command: str = ""  # reproduces the run
    practical: bool = False  # at a step too coarse for bounds of states, see `crosscheck.judge.verdict.judge_practical`
    own_environment: bool = False  # another version, in an environment of its own: its times compare with no other


class Measured(Run, frozen=True, kw_only=True):
    """A run and its figures."""

    status: str = ""  # the engine's word
    duration: float | None = None  # s, of the main run
    errors: dict[str, Errors] = {}  # by quantity
    levels: dict[str, Level] = {}
    energy_error: float | None = None  # over the largest kinetic energy, every step; less work done, at the samples
    energy_error_by_start: float | None = None  # the same over |E(0)|, the potential zero at the origin
    momentum_error: float | None = None  # kg m^2/s, samples
    orthogonality: float | None = None
    steps: int | None = None
    wall_time: float | None = None  # s
    us_per_step: float | None = None
    seconds_per_second: float | None = None  # of stepping per simulated second, at the judged step
    orders: dict[str, Order] = {}
    ladder: list[Rung] = []
    ladder_cut: str = ""  # why the order study has fewer steps than planned, where the bound of its time cut it
    curves: RunCurves = RunCurves()

    @property
    def judged_error(self) -> float:
        """The largest position error (m) over the judged time; infinite where it was not judged."""
        error = self.errors.get("position")
        return math.inf if error is None or error.judged is None else error.judged


class Judged(Measured, frozen=True, kw_only=True):
    """A run and its verdict."""

    outcome: Outcome = "error"
    message: str = ""
    findings: list[Finding] = []
    judged_until: float | None = None  # s


class Timed(Judged, frozen=True, kw_only=True):
    """A run as the document has it: named beside the others, and timed."""

    label: str = ""  # engine and method, and the form where a method ran in more than one
    default_form: bool = True  # the form is the engine's own choice, not one that the plan named
    seconds_deviation: float | None = None  # median absolute deviation of its repeats; None: timed only once
    speed: Speed | None = None
    timing: list[Point] = []
    word: str = ""  # the outcome in words that claim no more than was judged
    partly: bool = False  # the bounds of the motion judge only its beginning
    worst: Finding | None = None  # to name first, see `crosscheck.judge.verdict.worst`


Record = Timed


class Change(Part, frozen=True, kw_only=True):
    """What differs from the run before; empty texts where it is about more than one scene, engine or method."""

    kind: str  # one of `crosscheck.history.changes.KINDS`
    scene: str
    engine: str
    method: str  # with the form and the coarse step, as on the pages
    quantity: str
    before: float | str | None
    after: float | str | None
    text: str  # one clause, with its units
    bad: bool = False  # whether it is a finding, or only worth knowing

    @property
    def who(self) -> str:
        """Engine and method."""
        return f"{self.engine} {self.method}".strip()


class Support(Part, frozen=True, kw_only=True):
    """Which methods of an engine can run a scene in one form."""

    scene: str
    engine: str
    form: str | None
    reason: str | None  # why those that cannot do not; None where all can
    methods: list[str] = []  # those that can


class Advice(Part, frozen=True, kw_only=True):
    """What to run for an error. Where no method reaches it, `method` and all that belongs to it are None."""

    scene: str
    engine: str
    wanted: float  # m, the error asked for
    until: float  # s, up to where truth is comparable
    least: float | None  # m, the least error that any run had
    method: str | None = None
    form: str | None = None  # the engine's own choice
    step: float | None = None  # s, the largest that was found; None for an adaptive method
    rtol: float | None = None
    error: float | None = None  # m, measured: the largest |component of x - truth| over bodies and samples
    cost: float | None = None  # s of stepping
    breaks_at: float | None = None  # step (s) or rtol of the finest coarser run that fails or says nothing
    command: str | None = None


class Document(Part, frozen=True, kw_only=True):
    """results.json: all that a report needs, and all it may use."""

    schema: int = SCHEMA
    meta: Meta
    scenes: list[Scene]
    records: list[Record]
    exit_code: int  # 0: every verdict passes; 1: one does not; 2: the run is incomplete
    changes: list[Change] | None = None
    support: list[Support] | None = None
    advice: list[Advice] | None = None  # of the scenes and engines whose methods have been walked through


def exit_code(scenes: list[Scene], records: list[Record]) -> int:
    """0: every verdict passes; 1: one does not; 2: the run itself failed (a scene without truth, nothing ran)."""
    if any(scene.failure or scene.disputed for scene in scenes) or not records:
        return 2
    return int(any(record.outcome not in PASSING for record in records))
