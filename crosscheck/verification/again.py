"""The engine is started again at states of its own run: what it says of itself is measured, never believed.

A run is cut at samples drawn by a seeded generator. From the state at the beginning of every part the engine runs once
more to its end: at the same step in another world, and at coarser steps, whose errors are those of the method. The
other world is turned and shifted at random, under other names, bodies and joints in another order: what an engine knows
of a scene by its name, its place or its clock is of no use there.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping

import numpy as np

from crosscheck.adapters.base import RawRun, steps_per_sample
from crosscheck.document import Record
from crosscheck.judge.crossings import memories, sampled_within
from crosscheck.judge.flow import Answer, stiffened
from crosscheck.judge.world import SEED, World, begun
from crosscheck.references.modes import Mode
from crosscheck.running.attempt import Ran, attempt, lasting
from crosscheck.running.trajectory import Trajectory, derive
from crosscheck.scene.assembly import closed
from crosscheck.scene.coordinates import hinge_angles, starting
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

PARTS = 8
"""Parts of a run. Few enough that building models costs little, many enough that a small error grows little in each."""

REPEATED = 0.75
"""Share of every part that is run once more elsewhere: what an engine does at its own start, it does at once."""


def cuts(count: int) -> np.ndarray:
    """Samples at which `count` intervals are cut into parts, 0 and `count` included."""
    parts = min(PARTS, count)
    rng = np.random.default_rng([SEED, count])
    inner = np.linspace(0, count, parts + 1)[1:-1] + rng.uniform(-0.25, 0.25, parts - 1) * count / parts
    return np.unique(np.round([0, *inner, count]).astype(int))


@dataclasses.dataclass(frozen=True)
class Asked:
    """How an engine is asked again about a run."""

    run: Record
    scene: Scene
    traj: Trajectory

    @property
    def marks(self) -> np.ndarray:
        """Samples at which parts begin, and the last one."""
        return cuts(len(self.traj.t) - 1)

    @functools.cached_property
    def memories(self) -> Mapping[int, Mode]:
        """By sample what the run's states lack; nothing where no joint has laws."""
        modes = memories(self.scene, self.traj) if self.scene.has_laws else []
        return {k: mode for k, mode in enumerate(modes) if mode is not None}

    @functools.cached_property
    def guessed(self) -> bool:
        """Whether servos hold values at the beginning of a part that are not known to be those of the run."""
        return any(sampled_within(self.scene, self.traj.t, k, self.memories.get(k)) for k in self.marks[:-1].tolist())

    def part(self, first: int, last: int, step: float | None, world: World | None) -> tuple[Scene, Ran, bool] | str:
        """The scene of one part, its run, and whether joints were closed; or why there is none.

        Some engines want joints closed that are open, and so do loops whose open joints leave no motion.
        """
        why, raw = "", begun(self.scene, self.traj, first, last, self.memories.get(first)).replace(
            name="elsewhere", description="", source="", tags=())
        for make in (closed,) if stiffened(self.scene, raw) else (lambda scene: scene, closed):
            scene = make(raw)
            if scene is None:
                break
            outcome = lasting(attempt(scene if world is None else world.scene(scene), self.run, step=step,
                                      rtol=self.run.rtol if step is None else None, monitor=False, derived=False))
            if isinstance(outcome, Ran):
                return scene, outcome, make is closed
            why = why or outcome.why
        return why

    def parts(self, step: float | None, world: World | None = None, ends: bool = False) -> Answer | str:
        """The engine's answers to all parts, put together in the scene's own world; or why there are none.

        What is not run once more in another `world`, or fails there in less than half of the parts, is that of the run
        itself. `ends`: every sample is the end of a run, at which no method interpolates between steps.
        """
        traj, marks = self.traj, self.marks
        got: dict[str, np.ndarray] = {name: getattr(traj, name).copy() for name in "xRvw"}
        more: dict[str, list[np.ndarray]] = {} if world is not None or ends else {
            name: [] for name in ("a", "alpha", "lam")}
        steps, begins, any_closed, failed = 0, list[tuple[np.ndarray, ...]](), False, dict[int, str]()
        for first, last in itertools.pairwise(marks.tolist()):
            last = last if world is None else first + math.ceil(REPEATED * (last - first))
            for end in range(first + 1, last + 1) if ends else (last,):
                part = self.part(first, end, step, world)
                if isinstance(part, str):
                    break
                states, since = part[1].raw.states, end if ends else first + 1
                states = states if world is None else world.back(states)
                for name, values in got.items():
                    values[since:end + 1] = getattr(states, name)[since - first:]
            if isinstance(part, str):
                failed[len(begins)] = part
                if world is None or 2 * len(failed) >= len(marks) - 1:
                    return part
                begins.append((traj.x[first], traj.R[first], traj.v[first], traj.w[first]))
                continue
            scene, outcome, was_closed = part
            any_closed |= was_closed
            begins.append((scene.x0, scene.R0, scene.v0, scene.w0))
            for name, kept in more.items():
                if getattr(states, name) is not None:
                    kept.append(getattr(states, name)[min(1, len(kept)):])
            steps += outcome.raw.steps
        extra = {name: np.concatenate(kept) for name, kept in more.items() if sum(map(len, kept)) == len(traj.t)}
        raw = RawRun(States(traj.t, got["x"], got["R"], got["v"], got["w"], extra.get("a"), extra.get("alpha"),
                            extra.get("lam"), hinges=traj.hinges), 0.0, steps, step, form=traj.form)
        x, R, v, w = (np.array(part) for part in zip(*begins, strict=True))
        begun_at = States(traj.t[marks[:-1]], x, R, v, w, hinges=hinge_angles(self.scene, traj)[marks[:-1]])
        return Answer(derive(self.scene, traj.engine, traj.method, raw), marks, begun_at,
                      world is not None and not np.array_equal(world.Q, np.eye(3)), any_closed,
                      [self.memories.get(int(k)) for k in marks[:-1]], failed)

    def whole(self, step: float | None, rtol: float | None = None) -> Answer | str:
        """The run from the scene's start at another step or tolerance, as one part."""
        outcome = lasting(attempt(self.scene, self.run, step=step, rtol=rtol, monitor=False))
        if not isinstance(outcome, Ran):
            return outcome.why
        return Answer(outcome.trajectory, np.array([0, len(self.traj.t) - 1]), starting(self.scene), False, False,
                      [None])

    def companions(self, whole: bool) -> list[Answer]:
        """The parts of the run at other steps, from which its error at vanishing steps is extrapolated.

        Coarser steps are cheaper. For order 1 there are two such runs: most of their error is linear in the step.
        `whole`: they begin at the scene's start and are not cut.
        """
        run, traj = self.run, self.traj
        if run.documented_order is None or not run.step:
            return []
        count, _ = steps_per_sample(self.scene, run.step)
        interval, made = float(traj.t[1] - traj.t[0]), self.whole if whole else self.parts
        # As few may not be possible, or not meet the samples of a servo.
        fewer = [steps_per_sample(self.scene, interval / max(1, each))[0] for each in (count // 2, count // 4)]
        counts = fewer if count > fewer[0] > fewer[1] else [2 * count, 4 * count]
        answers = (made(interval / each) for each in counts[:2 if run.documented_order == 1 else 1])
        return [each for each in answers if not isinstance(each, str)]

    def repeat(self, length: float, turned: bool = True) -> Answer | str:
        """The parts of the run once more, at its own step or tolerance, elsewhere; or why they could not be made.

        Without `turned`, or where a turned world cannot be made, the other world is only shifted.
        """
        answer: Answer | str = ""
        for also in (True, False)[not turned:]:
            answer = self.parts(self.run.step, World.drawn(self.scene, length, also))
            if not isinstance(answer, str):
                break
        return answer
