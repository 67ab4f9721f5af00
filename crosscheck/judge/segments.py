"""The segments of a run, each with the true motion from the run's own state at its beginning."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from crosscheck.compare.apart import ROUNDED, STATE, apart
from crosscheck.judge.crossings import Crossed
from crosscheck.judge.system_flow import Flowed, SystemFlow
from crosscheck.judge.world import begun
from crosscheck.references import TruthError, dense
from crosscheck.references.base import GROWN, Reference, ending
from crosscheck.references.dense_output import Truth
from crosscheck.references.modes import Mode
from crosscheck.scene import mechanics
from crosscheck.scene.assembly import closed
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion, States

SEGMENTS = 8
"""Fewest segments of a run: building models costs little then, and a small error grows little in each."""
EVENTFUL = 2
"""At most so many times the segments for events, several of which may share one."""

QUARTER = 0.25
"""Share of a segment by which a cut may lie off, so that none is where an engine expects it."""

Pulled = tuple[np.ndarray, np.ndarray]
"""Forces and torques on bodies, as of `reactions_of`."""


@dataclasses.dataclass
class Segment:
    """The samples `first` to `last` of a run, and what an engine is asked of them."""

    first: int
    last: int
    given: Scene  # from the run's own state
    start: Scene  # the same, with closed joints where the run has them open by more than rounding
    mode: Mode | None = None  # what that state lacks of a scene with laws of joints
    flowed: Flowed | None = None  # the true motion from `start` at the segment's outputs, the first included
    why: str = ""  # why there is none
    reactions: Pulled | None = None
    whole: bool = False  # whether answers are parts of whole runs, and not started at its beginning

    @property
    def t(self) -> np.ndarray:
        """Its output times, s since its beginning."""
        return self.start.t

    @property
    def intervals(self) -> int:
        """Intervals between outputs from where an answer begins to its end."""
        return self.last - (0 if self.whole else self.first)

    @property
    def growth(self) -> float:
        """The factor by which an error of its start grows; 1 where that is not known."""
        return 1.0 if self.flowed is None else self.flowed.growth

    def smooth(self, steps: Sequence[float]) -> bool:
        """Whether the true motion is smooth in every step of methods with these steps."""
        return self.flowed is not None and all(jump.due and all(
            abs(jump.after - h * round(jump.after / h)) < ROUNDED * max(h, jump.after) for h in steps)
            for jump in self.flowed.jumps)

    def kept(self, name: str, step: float) -> np.ndarray:
        """(T - 1,) at which outputs after the first a row is one number for methods with steps up to this (s).

        Accelerations and what follows from them jump at any event and settle within two steps of a restart.
        """
        t, jumps = self.t[1:], () if self.flowed is None else self.flowed.jumps
        jerky = name not in (*STATE, "energy", "orthogonality")
        near = [jump.after for jump in jumps if jump.impact or jerky] if name not in ("position", "attitude") else []
        keep = np.ones(len(t), bool)
        for after in near:
            keep &= np.abs(t - after) > step + ROUNDED * max(step, t[0])
        return keep & (t > 2 * step * (1 - ROUNDED)) if jerky and step else keep


def rows(segment: Segment, answer: States, pulled: Pulled | None = None) -> dict[str, np.ndarray]:
    """An answer less truth by quantity, (T - 1, n, k), the outputs after the first; `pulled` as of `reactions_of`."""
    assert segment.flowed is not None
    true, scene = segment.flowed.states, segment.start
    found = apart(answer, true)
    gap = mechanics.energy(scene, answer) - mechanics.energy(scene, true)
    found["energy"] = gap[:, None, None]
    if pulled is not None and not scene.has_laws:
        if segment.reactions is None:
            segment.reactions = reactions_of(scene, true, mechanics.index1(
                scene, true.x, true.R, true.v, true.w, mechanics.torsion_angles(scene, true), true.t)[2])
        for name, own, exact in zip(("reaction force", "reaction torque"), pulled, segment.reactions, strict=True):
            found[name] = own - exact
    return {name: each[1:] for name, each in found.items()}


def reactions_of(scene: Scene, states: States, lam: np.ndarray) -> Pulled:
    """The sum of what all joints exert on each body: forces (T, n, 3) world, torques (T, n, 3) about its centre, body.

    A split among redundant joints is free, the sum is not.
    """
    G = Constraints(scene).jacobian(states.x, states.R)
    pull = -np.einsum("tmk,tm->tk", G, lam).reshape(len(states.t), scene.n, 6)
    return pull[..., :3], pull[..., 3:]


def marks(grown: np.ndarray, eventful: Sequence[int], seed: str, until: int | None = None) -> list[int]:
    """Samples at which a run is cut into intervals, the first and the last included.

    Intervals with events are segments of their own, up to `EVENTFUL` times the segments; beyond, the nearest ones share
    one.

    Parameters
    ----------
    grown : (T,) logarithm of the growth of errors from the start to each sample. An error grows by about e in a segment
    until : the last sample of which there is truth, where that ends before the run
    """
    count = len(grown) - 1
    parts = min(count, max(SEGMENTS, math.ceil(grown[-1])))
    rng = np.random.default_rng([*seed.encode()])
    drawn = np.arange(1, parts) + QUARTER * rng.uniform(-1.0, 1.0, parts - 1)
    passed = grown + np.linspace(0.0, parts, count + 1)  # so that none is longer than twice the mean
    inner = np.interp(drawn * passed[-1] / parts, passed, np.arange(count + 1))
    plain = {0, count, *np.round(inner).astype(int).tolist()} | ({until} if until else set())
    groups = [[k, k + 1] for k in sorted(set(eventful)) if not until or k < until]  # none holds the end of truth
    while True:
        merged = list[list[int]]()
        for first, last in groups:
            if merged and first <= merged[-1][1]:
                merged[-1][1] = max(last, merged[-1][1])
            else:
                merged.append([first, last])
        kept = {k for k in plain if not any(first < k < last for first, last in merged)}
        cuts = sorted(kept | {k for group in merged for k in group})
        if len(cuts) - 1 <= EVENTFUL * parts or len(merged) < 2:
            return cuts
        near = min(range(len(merged) - 1), key=lambda k: merged[k + 1][0] - merged[k][1])
        groups = [*merged[:near], [merged[near][0], merged[near + 1][1]], *merged[near + 2:]]


def eventful(scene: Scene, traj: Motion) -> tuple[list[int], Mapping[int, Mode]]:
    """Intervals of a run within which a law of a joint changes, and by sample what its states lack."""
    if not scene.has_laws:
        return [], {}
    crossed = Crossed(scene, traj, np.arange(len(traj.t) - 1), 1.0)
    inside = [k for k, each in enumerate(crossed.intervals) if each.crossings]
    return inside, {k: mode for k, mode in enumerate(crossed.modes) if mode is not None}


def growth(scene: Scene, truth: Reference | None, t: np.ndarray) -> np.ndarray:
    """(T,) logarithm of the growth of errors from the start up to each time; past the horizon at its mean rate there.

    Without a truth nothing is known of it, which is 0.
    """
    if truth is None:
        return np.zeros(len(t))
    known, until = dense(scene), max(min(truth.horizon, float(t[-1])), ROUNDED * float(t[-1]))
    most = np.log(np.maximum(1.0, np.maximum.accumulate(known.growth)))
    return np.asarray(np.interp(np.minimum(t, until), known.times, most) * np.maximum(1.0, t / until))


def end_of_truth(truth: Reference | Truth | None) -> float:
    """The time (s) at which truth ends by what acts there; by chaos none ends, as each segment has its own."""
    return math.inf if truth is None or truth.horizon_cause in ("", GROWN) else truth.horizon


def segments_of(scene: Scene, traj: Motion, truth: Reference | None, open_joints: bool,
                cut: Sequence[int] | None = None) -> list[Segment]:
    """The segments of a run, between the samples `cut` or, by default, those of `marks`."""
    inside, modes = eventful(scene, traj)
    until = int(np.searchsorted(traj.t, end_of_truth(truth) * (1 + ROUNDED), side="right")) - 1
    made = []
    for first, last in itertools.pairwise(cut or marks(growth(scene, truth, traj.t), inside, scene.key, until)):
        given = begun(scene, traj, first, last, modes.get(first)).replace(
            name="elsewhere", description="", source="", tags=())
        start = (closed(given, scene) or given) if open_joints else given
        made.append(Segment(first, last, given, start, modes.get(first)))
    return made


def fill(segments: Sequence[Segment], flow: SystemFlow, traj: Motion, truth: Reference) -> None:
    """Sets the true motion of each segment, or why it has none."""
    end = end_of_truth(truth)
    for segment in segments:
        since = float(traj.t[segment.first])
        if float(traj.t[segment.last]) > end * (1 + ROUNDED):
            segment.why = ending(end, truth.horizon_cause)
            continue
        try:
            flowed = flow.from_(segment.start, since, segment.t, segment.mode)
        except (TruthError, np.linalg.LinAlgError, FloatingPointError) as error:
            segment.why = str(error)
            continue
        if not (np.isfinite(flowed.states.x).all() and math.isfinite(flowed.growth)):
            segment.why = "its true motion is not finite"
        elif not flowed.linear:
            segment.why = "errors of its start do not grow in proportion to them: a loop is near a singular position"
        else:
            segment.flowed = flowed
