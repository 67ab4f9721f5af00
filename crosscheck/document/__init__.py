"""The types of the results: the table of rows, results.json and the pages all use them.

`Document` is the content of results.json, and its JSON Schema is made from these types (`crosscheck.report.schema`).
Units are SI, angles are in rad, and None means that there is no value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from msgspec.structs import replace

from crosscheck.document.curves import RunCurves, SceneCurves
from crosscheck.document.outcomes import Outcome, worst
from crosscheck.document.part import Part as Part
from crosscheck.document.part import Way as Way
from crosscheck.document.part import extended as extended
from crosscheck.document.part import grouped as grouped
from crosscheck.document.part import set_words as set_words
from crosscheck.document.part import size_of as size_of

SCHEMA = 5
"""Version of results.json. It rises if a key is removed or changes its meaning. New keys do not raise it."""

EULER = ("DAE3L_LE", "DAE2L_LE", "DAE2L_LSE", "DAE1L_LSE", "DAE3H_LE", "DAE2H_LE", "DAE2H_LSE", "DAE1H_LSE")
"""The eight Lie group Euler methods of [P1], in the order of its tables (doi:10.1177/1687814019842406)."""

QUANTITIES = {"position": "m", "attitude": "rad", "velocity": "m/s", "angular velocity": "rad/s"}
"""The quantities compared with truth, and their units."""

LEVELS = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
"""Constraint levels and the units of their rows."""

Status = Literal["ok", "fail", "known", "unresolved"]


# --- what results were made with


class Machine(Part, frozen=True, kw_only=True):
    """The machine that a run was made on."""

    system: str
    processor: str
    cores: int | None


class Calibration(Part, frozen=True, kw_only=True):
    """A fixed piece of work. The times of runs are compared with its time."""

    what: str
    us: float | None  # median
    deviation: float | None = None  # us, median absolute deviation


class Origin(Part, frozen=True, kw_only=True):
    """What results were made with, from `crosscheck.running.provenance.describe`."""

    time: str  # UTC
    engines: dict[str, str]  # name to version
    packages: dict[str, str]
    python: str
    machine: Machine
    commit: str | None


class Asked(Part, frozen=True, kw_only=True, omit_defaults=True):
    """Options that the user asked for in main runs instead of those of the plan; None: as planned."""

    options: tuple[tuple[str, Any], ...] = ()  # name and value, of the engines that have such an option
    step: float | None = None  # s, of methods with a fixed step
    duration: float | None = None  # s

    @property
    def words(self) -> list[str]:
        """The command-line options that ask for the same."""
        given = (("--step", self.step), ("--duration", self.duration))
        return set_words(self.options) + [
            word for option, value in given if value is not None for word in (option, str(value))]


AS_PLANNED = Asked()


class Meta(Origin, frozen=True, kw_only=True):
    """What the results of `crosscheck verify` were made with."""

    profile: str
    jobs: int
    command: str
    seconds: float  # of the whole run
    calibration: Calibration | None = None
    started: str | None = None  # UTC, ISO 8601; only of a nightly run
    compared_with: str | None = None  # name of the earlier run that `changes` compare with
    asked: Asked = AS_PLANNED
    need: float = 1.0  # share of its time over which the motion of a run has to be judged for it to pass
    tolerances: list[tuple[str, float]] = []  # of the user: row and bound, in its unit
    reused: int = 0  # number of results that were computed by earlier commands
    reused_since: str | None = None  # UTC, when the oldest of them was computed
    left: int = 0  # tasks that have not ended: the document is provisional, and written again as they do


# --- scenes


class Truth(Part, frozen=True, kw_only=True):
    """Where the truth of a scene comes from, and how accurate it is."""

    source: str
    second_source: str
    disagreement: float
    allowed: float
    amplification: float
    error: float | None = None  # estimated error, over the length of the scene
    horizon: float  # s, the time up to which it can be used
    events: tuple[tuple[float, str, str], ...] = ()  # s, joint or monitor, what happened; the first 200
    ended: str = ""  # what ends the claim of the scene before its duration: a monitor, with its time


class Plan(Part, frozen=True):
    """The steps that methods use on one scene, see `crosscheck.verification.plan`."""

    steps: dict[int, float]  # documented order to step (s); an order that is not listed uses the next lower one
    rtol: float = 1e-9
    samples: int = 251  # output times of a run, enough for smooth curves on a screen
    duration: float | None = None  # s; runs end here if the scene is longer
    covered: float = 1.0  # share of the time asked for at which runs end, since truth does
    ends: tuple[float, str] | None = None  # s, then, and why

    def step(self, order: int) -> float:
        """Step (s) of a method of this order."""
        return self.steps[max(key for key in self.steps if key <= order)]


class Recommended(Part, frozen=True, kw_only=True):
    """The runs to trust, the fastest first, or where none passes the nearest. All numbers are of the first."""

    runs: list[str]
    step: float | None
    rtol: float | None
    error: float  # the largest of all quantities, each over its size
    seconds: float | None  # of stepping per simulated second
    why: str
    share: float = 1.0  # the part of its time over which its motion is resolved
    passes: bool = True

    size = property(size_of)


class EngineTrust(Part, frozen=True, kw_only=True):
    """The runs to trust of one engine on a scene."""

    engine: str
    runs: int  # that could be made
    passing: int
    recommended: Recommended | None
    text: str


class Scene(Part, frozen=True, kw_only=True, omit_defaults=True):
    """A scene, its plan, its truth or why there is none, and which of its runs to trust."""

    name: str
    title: str
    description: str
    source: str
    hash: str
    bodies: list[str]
    duration: float  # s
    plan: Plan | None
    truth: Truth | None
    sizes: dict[str, float] | None  # of quantities along the true motion, SI
    rounding: dict[str, tuple[float, float]] | None = None  # see `crosscheck.judge.rounding.rounding_of`
    no_truth: str = ""  # why there is no truth
    disputed: bool = False  # two formulations of the truth disagree
    failure: str = ""  # why the scene could not be prepared at all
    details: str = ""  # more about the failure
    curves: SceneCurves = SceneCurves()
    trust: str  # in words; "" as long as no run was judged, as of the following
    recommended: Recommended | None
    engines: list[EngineTrust] = []
    not_trusted: list[str] = []  # labels of the runs that are not to be trusted


# --- runs


ENDED = "a run has to reach its end"


class Finding(Part, frozen=True):
    """One judged value of a run."""

    kind: str  # what it is about, a key of `outcomes.KINDS`, and the row: "limit position", "gap attitude", "order"
    status: Status
    value: float | None
    bound: float | None  # U, or what is promised or asked
    unit: str
    why: str
    detail: str = ""  # where and when it happens, the parts of U, or what is known about it
    size: float | None = None  # of the quantity, in its unit

    @classmethod
    def ended_early(cls, why: str) -> Finding:
        """The finding on a run that did not reach its end."""
        return cls("asked end", "fail", None, None, "", ENDED, why)

    @classmethod
    def truth_ends(cls, time: float, why: str) -> Finding:
        """The finding on a run that goes on after truth has ended, at this time (s)."""
        return cls("unresolved ended", "unresolved", time, None, "s", why)

    @property
    def about(self) -> str:
        """The key of `outcomes.KINDS`."""
        return self.kind.partition(" ")[0]

    @property
    def row(self) -> str:
        """The quantity."""
        return self.kind.partition(" ")[2]

    @property
    def severity(self) -> float:
        """log10 of value / bound, infinite if the value is not finite."""
        if self.value is None or self.bound is None or not math.isfinite(self.value):
            return math.inf if self.status in ("fail", "known") else -math.inf
        if self.value == 0:
            return -math.inf  # also if the bound is 0
        return math.log10(max(self.value, 1e-300)) - math.log10(max(self.bound, 1e-300))  # a bound may be infinite


class Errors(Part, frozen=True, kw_only=True):
    """Errors of one quantity against truth, of the body with the largest ones."""

    unit: str
    end: float | None
    max: float | None
    time: float | None  # s, of the largest error
    body: str
    size: float | None = None  # of the quantity along the true motion, see `crosscheck.compare.sizes`


class Level(Part, frozen=True, kw_only=True):
    """Largest constraint residual at one level, and whether the method satisfies this level by construction."""

    max: float | None
    held: bool
    unit: str


class Order(Part, frozen=True, kw_only=True):
    """The order at which answers at three steps approach each other, over all segments in which it shows."""

    documented: int
    observed: float  # the lowest
    median: float
    segments: int


class Rung(Part, frozen=True, kw_only=True):
    """One step or tolerance at which all segments were asked."""

    step: float | None  # s
    rtol: float | None
    errors: dict[str, float | None] = {}  # the largest of all segments against truth
    steps: int = 0  # of all segments together

    size = property(size_of)


class Speed(Part, frozen=True, kw_only=True):
    """Time per step of a run. `ratio` is this time over that of the calibration kernel, timed just before and after."""

    us_per_step: float
    us_deviation: float  # median absolute deviation over the repeats
    ratio: float
    deviation: float  # the same, or if more a quarter of the distance from the median to the fastest repeat
    repeats: int
    calibration: float  # us


class Record(Way, frozen=True, kw_only=True):
    """A run: what was asked, what was measured of it, and its verdict. What is not known yet has its default."""

    scene: str
    version: str
    documented_order: int | None = None
    command: str = ""  # reproduces the run
    own_environment: bool = False  # another version in its own environment, so that its times are not comparable

    status: str = ""  # as the engine says
    assumed: str = ""  # what is set otherwise than the engine has it by itself, as --set takes it
    duration: float | None = None  # s, of the main run
    errors: dict[str, Errors] = {}  # by quantity
    levels: dict[str, Level] = {}
    # over the largest kinetic energy: of every step, or of samples if work is done; None where that is not known
    energy_error: float | None = None
    energy_error_by_start: float | None = None  # the same over |E(0)|, where the potential is zero at the origin
    momentum_error: float | None = None  # kg m^2/s, at the samples
    orthogonality: float | None = None
    steps: int | None = None
    wall_time: float | None = None  # s
    us_per_step: float | None = None
    seconds_per_second: float | None = None  # of stepping per simulated second, at the judged step
    order: Order | None = None  # None if all answers differ by rounding, or the method is adaptive
    ladder: list[Rung] = []  # coarse to fine
    resolution: dict[str, float] = {}  # by row: a larger error of the model, over the size, would have been seen
    shares: dict[str, float] = {}  # by row: the share of the run's time in which it is resolved
    asked_steps: float | None = None  # engine steps of all answers and the run, over those of the run
    curves: RunCurves = RunCurves()

    outcome: Outcome = "error"
    message: str = ""
    findings: list[Finding] = []
    not_judged: str = ""  # why its motion was not resolved over all of its time
    truth_ends: float | None = None  # s, where that is before the run's end; its errors are known up to there

    label: str = ""  # engine and method, and the form if the method ran in more than one
    default_form: bool = True  # whether the engine, not the plan, chose the form
    seconds_deviation: float | None = None  # median absolute deviation of the repeats; None: timed only once
    speed: Speed | None = None
    word: str = ""  # the outcome in words that say how much of the motion was judged
    share: float | None = None  # of its time in which x, R, v, w are resolved; None if it was not judged at all
    code: str = ""  # of what is wrong or open, see `crosscheck.document.outcomes.KINDS`; "" for a pass
    worst: Finding | None = None  # the most important finding, see `crosscheck.judge.verdict.worst`

    @property
    def off(self) -> float | None:
        """The largest error of all quantities against truth, each over its size; None if there is no truth."""
        return largest({name: error.max for name, error in self.errors.items()}, self.sizes)

    @property
    def least_share(self) -> float:
        """The smallest of the shares of its time in which its rows are resolved."""
        return min([self.share or 0.0, *self.shares.values()])

    @property
    def error(self) -> float:
        """`off`, infinite if it is not known."""
        return math.inf if self.off is None else self.off

    def missed(self, wanted: float) -> float:
        """The error over the wanted one."""
        return self.error / wanted

    @property
    def cost(self) -> float:
        """Stepping time (s) of a simulated second, infinite if it is not known."""
        return math.inf if self.seconds_per_second is None else self.seconds_per_second

    @property
    def timing(self) -> list[tuple[float, Rung]]:
        """Stepping time (s) of all segments, and their errors, at each step or tolerance at which they were asked; none
        where the time of a step was not measured by itself."""
        return [] if self.speed is None else [
            (1e-6 * self.speed.us_per_step * rung.steps, rung) for rung in self.ladder if rung.steps]

    @property
    def sizes(self) -> dict[str, float]:
        """The sizes of the compared quantities, as far as they are known."""
        return {name: error.size for name, error in self.errors.items() if name in QUANTITIES and error.size}

    @property
    def within(self) -> bool:
        """Whether some of the motion is resolved, and nothing of it is beyond its uncertainty."""
        return self.outcome == "pass" or (self.outcome == "unresolved" and bool(self.share)
                                          and all(finding.status != "known" for finding in self.findings))


def largest(errors: Mapping[str, float | None], sizes: Mapping[str, float]) -> float | None:
    """The largest of errors by quantity, each over its size; infinite if one is not a number, None if none is known.

    This is the error of a run wherever runs are ranked, recommended or compared.
    """
    known = [value / sizes[name] for name, value in errors.items() if name in sizes and value is not None]
    return max((value if value == value else math.inf for value in known), default=None)


class Change(Part, frozen=True, kw_only=True):
    """One difference from the run before. A name is empty if the change concerns several scenes, engines or methods."""

    kind: str  # one of `crosscheck.history.changes.KINDS`
    scene: str
    engine: str
    method: str  # with the form, as on the pages
    quantity: str
    before: float | str | None
    after: float | str | None
    text: str  # one clause, with units
    bad: bool = False  # whether it is a finding, or only information

    @property
    def who(self) -> str:
        """Engine and method."""
        return f"{self.engine} {self.method}".strip()


class Advice(Part, frozen=True, kw_only=True):
    """The run that reaches a wanted error. If none was found, `method` and all that follows it are None.

    An error is the largest of all quantities, each over its size (`largest`).
    """

    scene: str
    engine: str
    wanted: float | dict[str, float]  # the error, or SI by quantity
    until: float  # s, the time up to which runs can be compared with truth
    least: float | None  # the smallest error of all runs
    ended: str = ""  # why no further
    tried: str = ""  # how far runs were made
    method: str | None = None
    form: str | None = None  # as the engine chose it
    step: float | None = None  # s, the largest that reaches the error; None for an adaptive method
    rtol: float | None = None
    error: float | None = None  # measured, over bodies and samples
    errors: dict[str, float] = {}  # the same by quantity, SI
    cost: float | None = None  # s of stepping
    breaks_at: float | None = None  # step (s) or rtol of the finest of the coarser runs that fail or cannot be judged
    command: str | None = None

    size = property(size_of)


def renamed(value: Any, names: Mapping[str, str]) -> Any:
    """A part of a document in whose texts, lists and parts, curves aside, every key of `names` is its value."""
    if isinstance(value, str):
        for old, new in names.items():
            value = value.replace(old, new)
    elif isinstance(value, list | tuple):
        return type(value)(renamed(each, names) for each in value)
    elif isinstance(value, Part) and not isinstance(value, RunCurves | SceneCurves):
        return replace(value, **{name: renamed(getattr(value, name), names) for name in value.__struct_fields__})
    return value


class Document(Part, frozen=True, kw_only=True):
    """The content of results.json. Reports are made from it alone."""

    schema: int = SCHEMA
    meta: Meta
    scenes: list[Scene]
    records: list[Record]
    outcome: Outcome  # the worst of all runs; error where a scene lacks the truth that it should have
    exit_code: int  # of the outcome
    changes: list[Change] | None = None
    answers: list[str] = []  # whether runs are within each tolerance that the user asked for, from `headline.answers`
    advice: list[Advice] | None = None  # from ladders of runs, where they were made


def outcome_of(scenes: list[Scene], records: list[Record]) -> Outcome:
    """The worst outcome of the runs; error if the truth of a scene failed or its two formulations disagree."""
    lost: list[Outcome] = ["error" for scene in scenes if scene.failure or scene.disputed]
    return worst([*lost, *(record.outcome for record in records)])
