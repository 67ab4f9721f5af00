"""The true motion over every sample interval of a run, started from the run's own state at its beginning.

The index-1 equations are integrated over all intervals at once. The derivatives of the solution bound the error of a
method of a given order: in a calm part of the run it is far smaller than in the wildest one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crosscheck.document import Scales
from crosscheck.judge.claim import Trace
from crosscheck.judge.crossings import Crossed
from crosscheck.references.base import GROWN, Reference
from crosscheck.references.maximal import fastest
from crosscheck.references.modes import Mode
from crosscheck.scene import mechanics
from crosscheck.scene.batch import TURN, integrate
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import hinge_angles
from crosscheck.scene.model import Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.states import States

UNKNOWN = 2.0
"""Times the rates of truth that rates past the horizon may reach: there the run is another motion of that energy."""

RANK = 1e-7
"""Share of the largest singular value of the constraint Jacobian below which a singular value counts as zero."""

ROUNDED = 1e-11
"""The same share below which no engine tells a singular value from rounding."""

@dataclasses.dataclass(frozen=True)
class Answer:
    """The parts of a run once more, at another step or in another world."""

    traj: Trace  # at the output times, in the scene's own world
    marks: np.ndarray  # samples at which parts begin, and the last one
    begins: States  # (P,) where they begin: in the run's own states, with closed joints where an engine wants them
    turned: bool  # whether the other world was turned
    closed: bool = False  # whether joints had to be closed somewhere
    memory: Sequence[Mode | None] = ()  # (P,) of a scene with laws of joints: what the states there lack
    failed: Mapping[int, str] = dataclasses.field(default_factory=dict)  # parts that did not run, and why

    @property
    def ran(self) -> np.ndarray:
        """Which of the parts ran."""
        return np.delete(np.arange(len(self.marks) - 1), list(self.failed))

    @property
    def firsts(self) -> np.ndarray:
        """The samples after the first interval of every part that ran."""
        return np.asarray(self.marks[self.ran] + 1)


@dataclasses.dataclass(frozen=True)
class Flow:
    """The flow over each of I sample intervals."""

    index: np.ndarray  # (I,) which intervals of the run
    tau: np.ndarray  # (I,) s, their lengths
    begin: States  # the run's own
    since: np.ndarray  # (I,) s, at their beginning, since the engine was started
    end: States
    rate: np.ndarray  # (I,) 1/s, the rate at which errors may grow
    sizes: np.ndarray  # (K, I) the largest k-th derivative of y = (x / L, R) in the interval and near it, 1/s^k
    jerks: np.ndarray  # (K, I) the same for the accelerations (a / L, alpha), 1/s^(k + 2)
    spring: float  # 1/s, the rate of the fastest spring
    regular: np.ndarray  # (I,) whether it ends before the claim, and closed loops are away from a loss of rank
    ended: np.ndarray  # (I,) whether the claim of the scene ends before it does
    crossed: Crossed | None = None  # of a scene with laws of joints

    @property
    def solvable(self) -> np.ndarray:
        """For every interval its own number or, if it is not regular, that of the last regular one before it, (I,)."""
        return _last(self.regular)

    @property
    def eventful(self) -> np.ndarray:
        """Whether surfaces are crossed in it or shortly after, (I,)."""
        return np.array([bool(each.events) for each in self.crossed.intervals] if self.crossed else self.tau < 0.0)

    def unsettled(self, within: float) -> np.ndarray:
        """Whether a mode or a held value changes at its end, or this time (s) before or after it, (I,)."""
        if self.crossed is None:
            return self.tau < 0.0
        return np.array([any(abs(after - tau) <= within + 1e-9 * tau for after in each.changes)
                         for each, tau in zip(self.crossed.intervals, self.tau.tolist(), strict=True)])

    @property
    def resting(self) -> np.ndarray:
        """Whether something holds a coordinate with a law at its end, (I,)."""
        return np.array([any(part.held for part in mode or ()) for mode in self.crossed.modes[1:]] if self.crossed else
                        self.tau < 0.0)

    def after_event(self, within: float) -> np.ndarray:
        """Whether a surface was crossed at most this time (s) before it begins, (I,)."""
        if self.crossed is None:
            return self.tau < 0.0
        late = [any(tau - within <= event.after <= tau for event in each.events)
                for each, tau in zip(self.crossed.intervals, self.tau.tolist(), strict=True)]
        return np.array([False, *late[:-1]])

    @property
    def growth(self) -> np.ndarray:
        """Factor by which an error may grow within the interval, (I,)."""
        return np.asarray(np.exp(np.minimum(self.rate * self.tau, 50.0)))


Run = tuple[Any, Answer | None, float]
"""A run; where the engine was started, if it has been put together of parts; how late (s) an event may be."""


def flows(scene: Scene, runs: Sequence[Run], truth: Reference, scale: Scales, degree: int, index: np.ndarray
          ) -> list[Flow]:
    """The flows over the intervals `index` of runs at the same output times, with derivatives up to `degree`."""
    tau = runs[0][0].t[index + 1] - runs[0][0].t[index]
    begins = [_begin(scene, traj, index, answer) for traj, answer, _ in runs]
    regular = [_regular(scene, begin) for begin in begins]
    moved: list[Any] = [None] * len(runs)
    if not scene.has_laws:
        steps = max(math.ceil(min(3.0, max(scale.rate, fastest(scene)) * float(tau.max())) / TURN), 2)
        own = [[getattr(begin, name)[_last(good)] for name in ("t", "x", "R", "v", "w", "hinges")]
               for begin, good in zip(begins, regular, strict=True)]
        *parts, hinges = map(np.concatenate, zip(*own, strict=True))
        end, nodes, fast = integrate(scene, States(*parts, hinges=hinges), np.tile(tau, len(runs)), steps,
                                     max(steps, degree - 1))
        for k in range(len(runs)):
            part = slice(k * len(tau), (k + 1) * len(tau))
            moved[k] = (_rows(end, part), [tuple(each[part] for each in node) for node in nodes], fast[part])
    return [_flow(scene, *each, truth, scale, degree, index) for each in zip(runs, begins, regular, moved, strict=True)]


def _begin(scene: Scene, traj: Trace, index: np.ndarray, answer: Answer | None) -> States:
    """The run's own states at the beginning of intervals, or those in which the engine was started there."""
    begin = _rows(traj, index)
    begin.hinges = hinge_angles(scene, traj)[index]
    if answer is not None:
        marks = answer.marks[:-1]
        fresh = np.isin(index, marks)
        for name in "xRvw":
            getattr(begin, name)[fresh] = getattr(answer.begins, name)[np.isin(marks, index)]
    return begin


def _flow(scene: Scene, run: Run, begin: States, regular: np.ndarray, moved: Any, truth: Reference, scale: Scales,
          degree: int, index: np.ndarray) -> Flow:
    """The flow of one run from `begin`; `moved` as from `integrate`, for a scene without laws."""
    traj, answer, ahead = run
    t, tau = begin.t, traj.t[index + 1] - begin.t
    spring = fastest(scene)
    marks = np.zeros(1, int) if answer is None else answer.marks[:-1]
    since = t - traj.t[marks[np.searchsorted(marks, index, side="right") - 1]]
    # Derivatives are the largest of those intervals in which the motion turns by about a radian.
    near = 2 * math.ceil(1.0 / (scale.rate * float(tau.mean()))) + 1 if len(index) > 1 else 1
    crossed = None
    if scene.has_laws:
        begins = {} if answer is None else {int(k): (_rows(answer.begins, slice(j, j + 1)), answer.memory[j])
                                            for j, k in enumerate(marks)}
        crossed = Crossed(scene, traj, index, ahead, scale.length, begins)
        end, fast = crossed.end, np.array([each.fast for each in crossed.intervals])
        fast = np.maximum(fast, [each.stiff for each in crossed.intervals])
        sizes = around(crossed.sizes(degree), near)
        spring = max(spring, crossed.restarts.decay, *(each.stiff for each in crossed.intervals))
        largest = [sizes[2:degree + 1], sizes[2:]]
    else:
        end, nodes, fast = moved
        end = dataclasses.replace(end, t=t + tau)
        a, R, alpha = (np.array(part).reshape(len(nodes), len(tau), scene.n, -1) for part in zip(*nodes, strict=True))
        with np.errstate(invalid="ignore", over="ignore"):
            largest = [around(_derivatives(parts, tau, degree - 1), near) for parts in (
                (a / scale.length, R / math.sqrt(2.0)), (a / scale.length, alpha))]
    sizes = np.concatenate([np.zeros((2, len(index))), largest[0]])
    later = np.where(t + tau > truth.horizon * (1 + 1e-12), UNKNOWN, 1.0)
    for k in range(2, min(len(sizes), len(truth.position_derivatives))):
        most = max(truth.position_derivatives[k] / scale.length, truth.attitude_derivatives[k] / math.sqrt(2.0))
        sizes[k] = np.fmin(sizes[k], later**k * most)
    fall = math.sqrt(float(np.linalg.norm(scene.gravity)) / scale.length)
    rate = np.maximum(around(fast, near), max(fall, fastest(scene)))
    ended = t + tau > claimed(truth) * (1 + 1e-12)
    return Flow(index, tau, begin, since, end, rate, sizes, largest[1], spring,
                regular & _regular(scene, end) & ~ended, ended, crossed)


def claimed(truth: Reference) -> float:
    """The time (s) at which the claim of a scene ends; a motion that goes on beyond its horizon, by chaos, has one."""
    return truth.horizon if truth.horizon_cause not in ("", GROWN) else math.inf


def _rows(states: Trace, rows: object) -> States:
    """Copies of some rows."""
    return States(*(np.array(getattr(states, name)[rows]) for name in "txRvw"),
                  hinges=None if states.hinges is None else np.array(states.hinges[rows]))


SINGULAR = 0.1
"""Share of its median below which the least singular value of the constraint Jacobian marks an interval as singular. It
magnifies violations tenfold there, and a hundredfold in velocities: the bars of a linkage are almost in one line."""


def _regular(scene: Scene, states: States) -> np.ndarray:
    """Whether closed loops are away from positions in which their constraints lose a rank, (I,)."""
    if not spanning_tree(scene)[1]:
        return np.ones(len(states.t), bool)
    # The rank is that of the scene's own state: redundant rows seem independent if positions are a little off.
    x, R = np.concatenate([scene.x0[None], states.x]), np.concatenate([scene.R0[None], states.R])
    values, finite = _singular_values(scene, x, R)
    rank = int((values[0] > RANK * values[0, 0]).sum())
    least = values[:, rank - 1] / np.where(finite, values[:, 0], 1.0)
    return np.asarray(finite & (least > SINGULAR * np.median(least[finite])))[1:]


def _singular_values(scene: Scene, x: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, m) of the constraint Jacobian in the metric of the mass matrix, and whether it is finite, (T,)."""
    G = Constraints(scene).jacobian(x, R)
    root = np.linalg.cholesky(mechanics.inverse_mass(scene))
    with np.errstate(invalid="ignore", over="ignore"):
        finite = np.isfinite(G).all(axis=(1, 2))
        return np.linalg.svd(np.where(finite[:, None, None], G, 0.0) @ root, compute_uv=False), finite


def stiffened(scene: Scene, begun: Scene) -> bool:
    """Whether redundant rows of closed loops are independent where a scene is begun, as its joints are a little open.

    A mechanism that moves only because its rows are redundant has no motion there, for an engine that tells them apart.
    """
    if not spanning_tree(scene)[1]:
        return False
    values, _ = _singular_values(scene, np.stack([scene.x0, begun.x0]), np.stack([scene.R0, begun.R0]))
    ranks = (values > ROUNDED * values[:, :1]).sum(axis=1)
    return bool(ranks[1] > ranks[0])


def _last(regular: np.ndarray) -> np.ndarray:
    """For every interval its own number or, if it is not regular, that of the last regular one before it, (I,)."""
    return np.asarray(np.maximum.accumulate(np.where(regular, np.arange(len(regular)), int(np.argmax(regular)))))


def around(values: np.ndarray, count: int) -> np.ndarray:
    """The largest of `count` neighbours along the last axis."""
    from scipy.ndimage import maximum_filter1d

    return np.asarray(maximum_filter1d(values, min(count, 2 * values.shape[-1] - 1), axis=-1, mode="nearest"))


def _derivatives(parts: tuple[np.ndarray, ...], tau: np.ndarray, degrees: int) -> np.ndarray:
    """The largest derivatives, (degrees, I) from degree 0 on, of the polynomials through `parts`, (nodes, I, n, .)."""
    count = len(parts[0])
    s = np.linspace(-1.0, 1.0, count)
    coefficients = np.linalg.inv(np.polynomial.legendre.legvander(s, count - 1))
    largest = np.zeros((degrees, len(tau)))
    for k in range(degrees):
        derived = np.polynomial.legendre.legder(np.eye(count), k)
        matrix = np.polynomial.legendre.legvander(s, len(derived) - 1) @ derived @ coefficients
        for part in parts:
            size = np.linalg.norm(np.tensordot(matrix, part, 1), axis=-1).max(axis=(0, 2))
            largest[k] = np.maximum(largest[k], size * (2.0 / tau) ** k)
    return largest
