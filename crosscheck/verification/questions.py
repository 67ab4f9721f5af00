"""What an engine is asked for a verdict: the segments of its own run again, at several steps or tolerances."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import steps_per_sample
from crosscheck.compare.apart import ROUNDED, Rows
from crosscheck.compare.ladder import FEWEST, counts, finer
from crosscheck.compare.order import SAFETY
from crosscheck.compare.sizes import length_of
from crosscheck.document import Record
from crosscheck.judge.rounding import EPS
from crosscheck.judge.segments import Segment
from crosscheck.judge.system_flow import Flowed
from crosscheck.references.maximal import fastest
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.verification.probe import Answer, Probe, answer_of

TENFOLD = 10.0
"""Factor between the tolerances that an adaptive method is asked at, as in tests of such codes (Hairer, Wanner)."""


@dataclasses.dataclass
class Answers:
    """Answers to one segment, the finest first; refined ones are put before."""

    k: int  # number of the segment
    segment: Segment
    steps: list[float]  # s, or tolerances
    counts: list[int]  # steps of one interval between outputs; none of tolerances
    answers: list[Answer]
    far: tuple[float, Answer] | None = None  # a far smaller step, and the answer there
    orders: list[float] = dataclasses.field(default_factory=list)  # as observed, one a refinement
    promised: dict[str, float] = dataclasses.field(default_factory=dict)  # orders of accelerations less the states' own
    order: float | None = None  # what follows from these; None where the motion is not smooth, or all is rounding

    @property
    def flowed(self) -> Flowed:
        """The true motion of the segment."""
        assert self.segment.flowed is not None
        return self.segment.flowed

    def rows(self) -> list[Rows]:
        """The answers, each less truth."""
        return [each.rows(self.segment) for each in self.answers]


class Questions:
    """One run, and how its engine is asked about it."""

    def __init__(self, run: Record, scene: Scene, traj: Trajectory, sizes: Mapping[str, float]) -> None:
        self.run, self.scene, self.traj, self.sizes = run, scene, traj, sizes
        self.engine, self.p = adapters.get(run.engine), run.documented_order
        self.states = own_states(traj)
        self.dt = float(traj.t[1] - traj.t[0])
        self.n = 0 if run.step is None else steps_per_sample(scene, run.step)[0]
        self.multiple = 1 if run.step is None else steps_per_sample(scene, self.dt)[0]
        self.fine = False  # whether the engine has no coarser steps
        self.length = length_of(scene)
        self.probe, self._runs = Probe(run, scene, self.length), dict[float, Answer | None]()

    @property
    def own(self) -> float:
        """The run's own step (s) or tolerance."""
        return self.dt / self.n if self.p is not None else float(self.run.rtol or 1.0)

    @functools.cached_property
    def rate(self) -> float:
        """What an adaptive method has to follow, rad/s."""
        return max(self.sizes["angular velocity"], fastest(self.scene))

    def step_of(self, *sizes: float) -> float:
        """The largest of these steps; 0 of tolerances."""
        return max(sizes) if self.p is not None else 0.0

    def at(self, size: float) -> tuple[float | None, float | None]:
        """Step and tolerance of an answer."""
        return (size, None) if self.p is not None else (None, size)

    def ask(self, segment: Segment, size: float) -> Answer | None:
        """The answer to a segment at a step or tolerance; None where there is none."""
        if not segment.whole:
            return self.probe.answer(segment.start, *self.at(size))
        whole = self.entire(size)
        return None if whole is None else whole.within(segment)

    def entire(self, size: float) -> Answer | None:
        """The whole run at a step or tolerance, in its own world."""
        if size not in self._runs:
            self._runs[size] = self.probe.repeat(*self.at(size)) if abs(size / self.own - 1) > ROUNDED else answer_of(
                self.scene, self.states, self.traj.steps)
        return self._runs[size]

    def answers(self, segments: Sequence[Segment]) -> list[Answers | None]:
        """Answers to every segment, at coarser steps where the engine has them in all; None where one is missing."""
        made: list[Answers | None] = []
        for self.fine in (False, True):
            made = [self._answers(k, segment) for k, segment in enumerate(segments)]
            if all(each is not None for each in made) or (self.p is not None and self.n < FEWEST):
                break
        return made

    def _answers(self, k: int, segment: Segment) -> Answers | None:
        numbers = list(counts(self.n, self.multiple, self.fine)) if self.p is not None else []
        sized, got = [self.dt / n for n in numbers] or [
            self.own * TENFOLD**(power - 2 * self.fine) for power in (0, 1, 2)], []
        for size in sized:
            answer = self.ask(segment, size)
            if answer is None:
                return None
            got.append(answer)
        return Answers(k, segment, sized, numbers, got)

    def refine(self, asked: Answers) -> bool:
        """Puts an answer at a finer step before the others; whether there is one."""
        number = finer(asked.counts[0], self.multiple) if asked.counts else 0
        size = self.dt / number if number else asked.steps[0] / TENFOLD
        got = None if self.p is None and size < TENFOLD * EPS else self.ask(asked.segment, size)
        if got is None:
            return False
        asked.steps.insert(0, size)
        asked.counts[:0] = [number] if number else []
        asked.answers.insert(0, got)
        return True

    def confirm(self, asked: Answers) -> bool:
        """Asks at a far smaller step, which confirms a limit before it fails; whether there is an answer.

        At least a tenth of the finest, and so small that the fastest oscillation is not damped away in the segment.
        """
        if self.p is None:
            return False
        segment, h = asked.segment, asked.steps[0]
        span = float(segment.t[-1])
        followed = math.pow(SAFETY * max(1.0, self.rate * span), -1.0 / self.p) / max(self.rate, 1.0 / span)
        number = math.ceil(self.dt / max(h / TENFOLD**2, min(h / TENFOLD, followed)) / self.multiple) * self.multiple
        got = self.ask(segment, self.dt / number) if segment.smooth([self.dt / number, *asked.steps[:3]]) else None
        asked.far = None if got is None else (self.dt / number, got)
        return got is not None

    def nearest(self, asked: Answers) -> Answer:
        """The answer at the run's own step or tolerance, or at the nearest."""
        return min(zip(asked.steps, asked.answers, strict=True), key=lambda each: abs(each[0] - self.own))[1]


def own_states(traj: Trajectory) -> States:
    """The states of a run, with what the engine gave beside them."""
    return States(traj.t, traj.x, traj.R, traj.v, traj.w, traj.a, traj.alpha, traj.lam, sensors=traj.own_sensors,
                  hinges=traj.hinges)


def start_of(scene: Scene) -> States:
    """The state at the start of a scene."""
    return States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
