"""A driven robot's log against its model: prediction from its own states, and what their difference exceeds.

Source: ASME V&V 20-2009: the error of a model is compared with u_val, u_val^2 = u_num^2 + u_input^2 + u_D^2. The log is
cut into segments. A segment starts from a state that a local polynomial in time gives, without a model, and is
predicted over several horizons. Alterations of the model are fitted to all segments, whose starts are then
free; one that is larger than its uncertainty is a mistake of the model, and the smallest that would have shown is
stated.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import chdtr

from crosscheck.diagnosis.fit import PART
from crosscheck.errors import ArgumentError, Unsupported, unknown
from crosscheck.recordings.columns import EFFORTS
from crosscheck.recordings.inputs import OF_JOINTS, System
from crosscheck.recordings.noise import Noise, measured, of_rates, states
from crosscheck.recordings.reading import Group, Recording
from crosscheck.references import dense
from crosscheck.references.base import Series
from crosscheck.scene.alterations import QUANTITIES
from crosscheck.scene.coordinates import relative_pose
from crosscheck.scene.model import GROUND, Joint, Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.touching import Touching
from crosscheck.scene.vectors import exponential

HORIZONS = (0.05, 0.1, 0.2, 0.5, 1.0)
"""s, after which predictions are compared."""

HALF = 0.5
"""s, the horizon by which resolution and tolerance are measured."""

STEP = 2.5e-3
"""s, of predictions, or the period of the rows if that is longer; 1e-3 where friction changes its sign."""

SEGMENTS, FITTED = 4000, 200
"""Most segments that are predicted, and to which alterations are fitted, evenly over the recording."""

COVER = 2.0
"""Times u_val that an error has to exceed on average, for 95 %; of few segments also two standard deviations more."""

EDGE = 12
"""Rows before the first segment, so that the state at its start has rows on both sides."""

COVERS = 0.9
"""Part of the time that other lengths of segments cover, from which the longest is taken."""

HALVINGS = 4
"""Of the step, at most."""

ROWS, ROUNDS, SOME = 250, 5, 40
"""Rows of a joint in a segment that is fitted, rounds in which its start is found, and segments that say how much of
the noise of inputs is unknown."""

CRITICAL = 4.0
"""Standard deviations of an alteration that show it: with 25 alterations, one right log in 600 shows one."""

DATED = 6.0
"""Times u_val that a prediction has to miss to say since when, as more than one that is right may by its start."""

MISSED = 1.645
"""More of them for 95 of 100 alterations of that size to show."""

ALIKE = 9.2
"""Difference of chi^2 up to which causes are told together: a likelihood of one hundredth."""

STATED = ("mass", "friction", "delay")
"""Of which every answer states the smallest that would have shown."""

BY_NAME = {each.what: each for each in QUANTITIES}


@dataclasses.dataclass
class Sized:
    """An alteration of the model, its size and its standard deviation in SI (relative for %)."""

    what: str
    owner: str
    unit: str
    size: float = 0.0
    sigma: float = math.inf

    @property
    def name(self) -> str:
        """Without its size."""
        return BY_NAME[self.what].of_owner(self.owner)

    @property
    def said(self) -> str:
        """With its size and 95 % interval."""
        factor = 100.0 if self.unit == "%" else 1.0
        width = f"{factor * 1.96 * self.sigma:.2g}"
        places = 2 - math.ceil(math.log10(float(width))) if 0.0 < float(width) < math.inf else 3
        return f"{self.name} {factor * self.size:+.{max(places, 0)}f} {self.unit}, 95 % within {width} {self.unit}"


@dataclasses.dataclass
class Cause:
    """Alterations that act together, and the chi^2 that they leave."""

    parts: list[Sized]
    chi2: float = math.inf
    free: int = 1
    since: float | None = None  # s, where they act from some time on alone
    sign: str = ""  # what has the other sign, in place of alterations

    @property
    def name(self) -> str:
        """Without sizes."""
        return f"sign of {self.sign}" if self.sign else " with ".join(each.name for each in self.parts)

    @property
    def said(self) -> str:
        """With sizes and 95 % intervals."""
        if self.sign:
            return f"{self.name}, which is the other one"
        return ", with ".join(each.said for each in self.parts) + (
            "" if self.since is None else f", from {self.since:.4g} s on")

    @property
    def left(self) -> float:
        """What it leaves, over the noise."""
        return math.sqrt(self.chi2 / self.free)

    @property
    def sure(self) -> bool:
        """Whether no size is none by chance."""
        return all(abs(each.size) > CRITICAL * each.sigma for each in self.parts)


@dataclasses.dataclass
class Predicted:
    """What predictions of a model miss, by joint (n) and horizon (H)."""

    horizons: tuple[float, ...]
    error: np.ndarray  # (n, H) rms over the segments
    u_D: np.ndarray
    u_input: np.ndarray
    u_num: np.ndarray
    ratio: np.ndarray  # (n, H) rms of error / u_val
    since: float | None  # s, up to which the segment that is first to miss `DATED` times u_val does not
    starts: np.ndarray  # (S,) s

    @property
    def allowed(self) -> float:
        """Times u_val above which an error is one of the model."""
        return COVER * (1.0 + 2.0 / math.sqrt(2 * len(self.starts)))

    @property
    def beyond(self) -> tuple[int, int] | None:
        """(joint, horizon) of the error that is most times u_val, if that is more than is allowed."""
        times = self.error / self.u
        k, h = np.unravel_index(int(np.nanargmax(times)), times.shape)
        return (int(k), int(h)) if times[k, h] > self.allowed else None

    @property
    def u(self) -> np.ndarray:
        """(n, H) u_val."""
        return np.asarray(np.sqrt(self.u_D**2 + self.u_input**2 + self.u_num**2))


class Track(NamedTuple):
    """What was recorded of a coordinate, or of a rate."""

    t: np.ndarray
    values: np.ndarray
    noise: Noise


class Log:
    """The positions of all joints in a recording, their noise, and segments with the states at their starts."""

    def __init__(self, scene: Scene, recording: Recording) -> None:
        groups = {g.owner: g for g in recording.groups if g.key == "joint_position"}
        self.names = [joint.name for joint in scene.joints]
        tracks = self.tracks = list[Track]()  # of the positions of each joint, then of its rates
        for joint in scene.joints:
            if joint.name not in groups:
                raise Unsupported(f"the positions of joint {joint.name!r} are not recorded, which states start from")
            group = groups[joint.name]
            known = np.isfinite(group.values[:, 0])
            values = group.values[known, 0]
            if group.angle:
                values = np.unwrap(values)
            if len(values) < 40:
                raise Unsupported(f"joint {joint.name!r}: {len(values)} positions are recorded; 40 at least are wanted")
            tracks.append(Track(recording.t[known], values, measured(recording.t[known], values)))
        own = [float(np.median(np.diff(each.t))) for each in tracks]
        self.period, first = max(own), tracks[int(np.argmax(own))].t
        begin, end = max(each.t[0] for each in tracks), min(each.t[-1] for each in tracks)
        free, self.left_out = self._free(scene, first, begin, end)
        leads = np.minimum(EDGE * self.period, 0.02 * np.diff(free)[:, 0])  # a start has rows on both sides
        lengths = np.diff(free)[:, 0] - leads
        usable = [h for h in HORIZONS if h <= HALF and EDGE * self.period <= h <= lengths.max(initial=0.0)]
        if not usable:
            raise Unsupported("no part of the recording is long enough between " + " and ".join(self.left_out or [
                "its ends"]))
        usable = [lengths.max() / int(lengths.max() / h) for h in usable]
        covered = [h * float((lengths // (h * (1 - 1e-9))).sum()) for h in usable]
        self.span = max(h for h, each in zip(usable, covered, strict=True) if each > COVERS * max(covered))
        counts = (lengths // (self.span * (1 - 1e-9))).astype(int)
        at = np.concatenate([low + self.span * np.arange(count) for low, count in zip(free[:, 0] + leads, counts,
                                                                                      strict=True)])
        self.within = np.repeat(free, counts, axis=0)
        self.reach = self.span * np.minimum(2, np.concatenate([np.arange(count, 0, -1) for count in counts]))
        self.starts = first[np.searchsorted(first, at - 0.5 * self.period)]
        self.share = min(1.0, round(self.span * len(self.starts) / (end - begin - leads[0]), 9))
        if len(self.starts) > SEGMENTS:
            self.share *= SEGMENTS / len(self.starts)
            some = np.unique(np.linspace(0, len(self.starts) - 1, SEGMENTS).astype(int))
            self.starts, self.reach, self.within = self.starts[some], self.reach[some], self.within[some]
        made = [states(t, q, self.starts, noise, self.within) for t, q, noise in tracks]
        self.noise = [noise for *_, noise in made]
        self.state = np.stack([values for values, *_ in made], axis=1)  # (S, n, 2)
        self.spread = np.stack([spread for _, spread, _ in made], axis=1)  # (S, n, 2, 2)
        self.moved = np.array([float(np.ptp(each.values)) for each in tracks])
        self.said: list[str] = []
        given = {g.owner: g.values[:, 0] for g in recording.groups if g.key == "joint_velocity"}
        self.tracks = [each._replace(noise=noise) for each, noise in zip(tracks, self.noise, strict=True)]
        for joint, (t, q, noise) in zip(scene.joints, [*self.tracks], strict=True):
            r = given.get(joint.name, np.full(len(recording.t), np.nan))
            both = np.isfinite(r) & np.isin(recording.t, t)
            found, what = of_rates(recording.t[both], q[np.isin(t, recording.t[both])], noise.sigma, r[both], CRITICAL)
            rate = Track(recording.t[both], r[both], found or noise)
            self.tracks.append(rate if found else Track(rate.t[:0], rate.values[:0], noise))
            if joint.name in given:
                self.said.append(f"{joint.name} {what}" + ("" if found else ", not used"))

    @property
    def begun(self) -> np.ndarray:
        """(S, 2n) positions and rates at the starts."""
        return np.concatenate([self.state[..., 0], self.state[..., 1]], axis=1)

    @property
    def horizons(self) -> tuple[float, ...]:
        """s, of predictions."""
        return tuple(h for h in HORIZONS if h <= 1.01 * self.reach.max()) or (self.span,)

    def _free(self, scene: Scene, rows: np.ndarray, begin: float, end: float
              ) -> tuple[np.ndarray, dict[str, float]]:
        """((intervals, 2) s in which nothing acts that is no part of predictions, s that each other thing takes)."""
        blocked: dict[str, list[np.ndarray]] = {}
        for joint, (t, q, noise) in zip(scene.joints, self.tracks, strict=True):
            gap = np.flatnonzero(np.diff(t) > max(0.1 * HALF, 5 * self.period))
            blocked.setdefault("gaps", []).append(np.stack([t[gap], t[gap + 1]], axis=1))
            ranges = [(each.lower, each.upper) for each in scene.monitors
                      if each.type == "range" and each.joint == joint.name]
            for lower, upper in ranges + [(each.lower, each.upper) for each in joint.limits if each is not None]:
                room = np.minimum(q - lower, upper - q)
                blocked.setdefault(f"the ends of {joint.name}", []).append(_around(t, room < 3 * noise.sigma))
        some = rows[::max(1, int(STEP / self.period))]
        for name, near in touches(scene, some, np.stack([np.interp(some, t, q) for t, q, _ in self.tracks], axis=1)):
            blocked.setdefault(name, []).append(_around(some, near))
        taken = {name: np.concatenate(each).clip(begin, end) for name, each in blocked.items()}
        every = np.concatenate([np.zeros((0, 2)), *taken.values(), [[end, end]]])
        every = every[np.argsort(every[:, 0])]
        done = np.maximum.accumulate(np.append(begin, every[:, 1]))[:-1]
        free = np.stack([done, every[:, 0]], axis=1)[every[:, 0] > done]
        return free, {name: float(np.diff(each).sum()) for name, each in taken.items() if np.diff(each).sum() > 0.0}

    def rows(self, k: int, start: float, span: float, most: int) -> tuple[np.ndarray, np.ndarray, float]:
        """(s since the start, means, standard deviation of a mean) of the positions, and after these of the rates, of
        a joint in a segment, at most so many."""
        t, q, noise = self.tracks[k]
        part = slice(*np.searchsorted(t, [start, start + span * (1 + 1e-12)]))
        t, q = t[part] - start, q[part]
        many = max(1, -(-len(t) // most))
        whole = len(t) // many * many
        return (*(each[:whole].reshape(-1, many).mean(axis=1) for each in (t, q)),
                max(noise.sigma, 1e-12) * math.sqrt(noise.correlation / many))


def _around(t: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(K, 2) s, from the row before to the row after those that are marked."""
    k = np.flatnonzero(near)
    return np.stack([t[np.maximum(k - 1, 0)], t[np.minimum(k + 1, len(t) - 1)]], axis=1)


def touches(scene: Scene, t: np.ndarray, q: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """(what touches, (T,) whether it may at a row or before the next) of recorded coordinates q (T, n).

    Distances have noise, and may fall between two rows by as much as they change from one to the next.
    """
    if all(monitor.joint is not None for monitor in scene.monitors):
        return
    watched, (x, R) = Touching(scene), poses(scene, q)
    below = watched.below(x, R)
    for row, index in enumerate(watched.monitors):
        room, shapes = below[:, row], scene.monitors[index].shapes
        near = ~np.isfinite(room)
        if near.any():  # of a plane
            room = np.array([watched.gap(row, *pose) for pose in zip(x, R, strict=True)])
        lacks = 3 * measured(t, room).sigma
        near = room <= lacks + _change(room)
        if near.any() and np.isfinite(below[:, row]).all():
            exact = np.full(len(t), np.nan)
            for k in np.flatnonzero(np.convolve(near, np.ones(3), "same")):
                exact[k] = watched.gap(row, x[k], R[k])
            near &= exact <= lacks + _change(exact)
        yield f"touches of {shapes[0]} and {shapes[1]}", near


def _change(values: np.ndarray) -> np.ndarray:
    """(T,) the larger change of values (T,) from the row before or to the row after."""
    change = np.abs(np.diff(values))
    return np.asarray(np.fmax(np.append(change, 0.0), np.append(0.0, change)))


def poses(scene: Scene, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(x (T, bodies, 3), R (T, bodies, 3, 3)) of a tree of hinges and slides at coordinates q (T, n)."""
    x, R = (np.repeat(each[None], len(q), axis=0) for each in (scene.x0, scene.R0))
    frames = {k: (x[:, k], R[:, k]) for k in range(scene.n)} | {GROUND: (np.zeros(3), np.eye(3))}
    at = {joint.name: q[:, k] for k, joint in enumerate(scene.joints)}
    for branch in spanning_tree(scene)[0]:
        if (joint := branch.joint) is None:
            continue
        (turn, _), (_, way) = (relative_pose(joint, np.array([value])) for value in (0.0, 1.0))
        d = at[joint.name][:, None] * way
        if not joint.kind.slides:
            turn = exponential(at[joint.name][:, None] * joint.parent_axis) @ turn
        x, R = frames[branch.parent]
        across = R if branch.outward else R @ np.swapaxes(turn, -1, -2)  # the attitude of the joint's parent
        arm, out = (np.einsum("...ij,...j->...i", *pair) for pair in (
            (across, joint.parent_anchor + d), (R @ turn if branch.outward else R, joint.child_anchor)))
        near, far = (arm, out) if branch.outward else (out, arm)
        frames[branch.body] = x + near - far, R @ turn if branch.outward else across
    x, R = (np.stack([np.broadcast_to(frames[k][part], (len(q), *shape)) for k in range(scene.n)], axis=1)
            for part, shape in ((0, (3,)), (1, (3, 3))))
    return x, R


def hermite(grid: np.ndarray, q: np.ndarray, v: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(T, ...) values at times t of cubics through values and rates on an even grid."""
    h = grid[1] - grid[0]
    k = np.clip((t / h).astype(int), 0, len(grid) - 2)
    s = (t / h - k).reshape(-1, *(1,) * (q.ndim - 1))
    return np.asarray(q[k] * (1 + 2 * s) * (1 - s) ** 2 + q[k + 1] * s**2 * (3 - 2 * s)
                      + h * (v[k] * s * (1 - s) ** 2 + v[k + 1] * s**2 * (s - 1)))


Flow = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class Fit:
    """Predictions of a system from the states of a log, and their linear dependence on starts and alterations."""

    def __init__(self, log: Log, system: System, most: int = FITTED) -> None:
        self.log, self.system = log, system
        self.picked = np.unique(np.linspace(0, len(log.starts) - 1, most).astype(int))
        parts = round(log.period / STEP, 6)  # steps end at rows, where inputs are held from one to the next
        self.step = log.period / math.ceil(parts) if parts > 1.0 else log.period * int(1.0 / parts)
        for _ in range(HALVINGS):  # until half of the step changes little beside the noise
            rows = log.starts[self.picked[:20]], log.begun[self.picked[:20]]
            span = self.step * math.ceil(log.span / self.step)
            ends = [np.hstack([part[-1] for part in system.flow(*rows, span, self.step * part)[1:3]])
                    for part in (1.0, 0.5)]
            u_num = np.abs(ends[1] - ends[0]).max(axis=0)
            if (u_num < 0.3 * np.array([noise.sigma if len(t) else math.inf for t, _, noise in log.tracks])).all():
                break
            self.step /= 2
        self.sizes = self._sizes()
        self.begun = log.begun[self.picked]
        self.unknown = self.shaken[system.measured].sum(axis=0)  # covariance of accelerations by unknown efforts
        self._roots: dict[bytes, np.ndarray] = {}
        self.nominal = np.zeros((2, 1))  # chi^2 without an alteration, and degrees of freedom, of segments

    def _sizes(self) -> np.ndarray:
        """(K,) alterations that change accelerations by about a hundredth of what they are."""
        system, log = self.system, self.log
        q, v = log.state[..., 0], log.state[..., 1]
        none = np.zeros((len(q), len(system.names)))
        given = system.inputs(log.starts, np.array([0.0, log.period]))[0]
        u = system.pushes(log.starts, q, v, given, np.zeros((len(q), system.n, len(OF_JOINTS))))
        a, S = system.response(q, v, u, *system.parameters(none))
        effort = np.maximum(np.sqrt(np.mean(u**2, axis=0)), np.sqrt(np.mean(a**2, axis=0)) / np.abs(
            np.einsum("nii->ni", S)).mean(axis=0))
        rate, speed = (np.sqrt(np.mean(each**2, axis=0)) + 1e-9 for each in (v, a))
        of_joint = {joint.name: k for k, joint in enumerate(system.scene.joints)}
        made = []
        for what, owner in system.names:
            k = of_joint.get(owner, 0)
            made.append({"damping": effort[k] / rate[k], "friction": effort[k], "torque offset": effort[k], "armature":
                         effort[k] / speed[k], "delay": 0.1, "centre of mass x": 0.1, "centre of mass y": 0.1,
                         "centre of mass z": 0.1}.get(what, 1.0))
        noises = np.array([0.0 if each is None else measured(each.t, each.values).sigma for each in system.efforts])
        self.pushed = np.abs(np.einsum("nii->ni", S)).mean(axis=0) * noises  # accelerations by the noise of inputs
        self.shaken = np.einsum("sik,sjk,k->kij", S, S, noises**2) / len(S)  # their covariance by each effort
        return 1e-2 * np.array(made)

    def flow(self, start: np.ndarray, altered: np.ndarray, halves: np.ndarray | None = None) -> Flow:
        """(grid, q, v, inputs) of the fitted segments from these states (S, 2n)."""
        return self.system.flow(self.log.starts[self.picked], start, self.log.span, self.step,
                                np.tile(altered, (len(start), 1)), halves)

    def slopes(self, flow: Flow, which: Sequence[int], altered: np.ndarray) -> np.ndarray:
        """(T, S, 2n, 2n + len(which)) derivatives of the flow of fitted segments by starts and by alterations."""
        which = list(which)
        return self.system.slopes(self.log.starts[self.picked], *flow[1:], self.step, np.tile(
            altered, (len(self.picked), 1)), np.repeat([1e-6, 1e-5], self.system.n), which, 1e-2 * self.sizes[which])

    def residuals(self, flow: Flow) -> list[np.ndarray]:
        """Of each fitted segment what is left of positions and rates, over their noise."""
        n, (grid, q, v, _) = self.system.n, flow
        with np.errstate(invalid="ignore", over="ignore"):
            left = [np.concatenate([(values - (hermite(grid, q[:, s, k], v[:, s, k], t) if k < n else np.interp(
                t, grid, v[:, s, k - n]))) / scale for k, (t, values, scale) in enumerate(self.data[s])])
                    for s in range(len(self.picked))]
        return [np.nan_to_num(each, nan=1e9, posinf=1e9, neginf=-1e9) for each in left]

    def root(self, s: int) -> np.ndarray | None:
        """A root of the covariance of a segment's rows, over their noise; None: they are independent.

        An unknown effort is held from row to row, and moves a joint as the integral of its integral.
        """
        if not self.unknown.any():
            return None
        data = self.data[s]
        t = np.concatenate([each[0] for each in data])
        counts = [len(each[0]) for each in data]
        scale, joint = np.repeat([each[2] for each in data], counts), np.repeat(range(len(data)), counts)
        key = b"".join(each.tobytes() for each in ((t / self.log.period).round(2), scale, self.unknown))
        if key not in self._roots:
            n, first, last = self.system.n, np.minimum.outer(t, t), np.maximum.outer(t, t)
            pushed = self.unknown[np.ix_(joint % n, joint % n)] * self.log.period
            both = first * (t[:, None] - 0.5 * first)  # of a position with a rate
            of_rate = joint >= n
            alike = np.where(of_rate[:, None], np.where(of_rate, first, both.T), np.where(
                of_rate, both, first**2 * (3 * last - first) / 6))
            self._roots[key] = np.linalg.cholesky(np.eye(len(t)) + pushed * alike / np.outer(scale, scale))
        return self._roots[key]

    def reduced(self, every: int = 1) -> tuple[np.ndarray, np.ndarray, float, int, float]:
        """(N, b, chi^2, degrees of freedom, log of the determinant of the covariance of what no start explains, less a
        constant) of the last rows, of every segment or of some.

        Source: H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545.
        """
        size = 2 * self.system.n
        count = self.last[0][0].shape[1] - size
        N, b, determinant, left = np.zeros((count, count)), np.zeros(count), 0.0, list[tuple[float, int]]()
        self.parts, self.follows = [], np.zeros((len(self.last), size, count))
        for s in range(0, len(self.last), every):
            (A, r), root = self.last[s], self.root(s)
            if root is not None:
                A, r = (solve_triangular(root, each, lower=True) for each in (A, r))
                determinant += 2 * float(np.log(np.diag(root)).sum())
            Q, R = np.linalg.qr(A[:, :size])
            determinant += 2 * float(np.log(np.abs(np.diag(R)) + 1e-300).sum())
            inner = Q.T @ A[:, size:]
            self.follows[s] = -np.linalg.pinv(R, rcond=1e-10) @ inner
            E, rest = A[:, size:] - Q @ inner, r - Q @ (Q.T @ r)
            self.parts.append((E.T @ E, E.T @ rest))
            left.append((float(rest @ rest), len(r) - size))
            N, b = N + E.T @ E, b + E.T @ rest
        self.left = np.array(left).T  # (2, S)
        chi2, free = self.left.sum(axis=1)
        return N, b, float(chi2), int(free), determinant

    def loosened(self) -> None:
        """Take the part of the noise of inputs as unknown that makes the last rows likeliest, without an alteration or
        with one that shows.

        A log may be slower than what gives its inputs, of which it then lacks a part.
        """
        from scipy.optimize import minimize_scalar

        @functools.cache
        def unlikely(part: float) -> float:
            self.unknown = np.tensordot(np.where(self.system.measured, 1.0, part**2), self.shaken, 1)
            N, b, chi2, _, determinant = self.reduced(max(1, len(self.last) // SOME))
            pairs = [np.array([k, len(b) - 1]) for k in range(len(b) - 1) if N[k, k] * self.sizes[k] ** 2 > NOTHING]
            gains = [alone(N[np.ix_(pair, pair)], b[pair], PARTS, self.system.least[pair[0]])[2] for pair in pairs]
            without = float((PARTS * (PARTS * N[-1, -1] - 2 * b[-1])).min())
            return chi2 + determinant + min([without, *(gain + CRITICAL**2 for gain in gains)])

        if self.system.unsure:
            best = minimize_scalar(unlikely, bounds=(0.0, 1.0), method="bounded", options={"xatol": 0.05}).x
            unlikely.__wrapped__(min((0.0, float(best), 1.0), key=unlikely))

    @functools.cached_property
    def data(self) -> list[list[tuple[np.ndarray, np.ndarray, float]]]:
        """Of each fitted segment, of the positions of each joint, then of its rates: s since the start, values, their
        standard deviation."""
        log = self.log
        n = self.system.n
        made = [[log.rows(k, log.starts[row], log.span, ROWS) for k in range(2 * n)] for row in self.picked]
        t = log.tracks[0].t
        lost = [np.diff(t[slice(*np.searchsorted(t, [start, start + log.span]))]) for start in log.starts[self.picked]]
        lost = [gaps[gaps > 1.5 * log.period] for gaps in lost]  # in which a held input was another one
        return [[(t, q, math.hypot(scale, self.pushed[k % n] * math.sqrt(float(gaps @ gaps)) * (
            log.span / math.sqrt(3) if k < n else 1.0))) for k, (t, q, scale) in enumerate(rows)]
                for rows, gaps in zip(made, lost, strict=True)]

    def designs(self, flow: Flow, which: Sequence[int], altered: np.ndarray) -> list[np.ndarray]:
        """Of each fitted segment the derivatives of its residuals by its start and by alterations, (rows, 2n + K)."""
        grid, slopes, h = flow[0], self.slopes(flow, which, altered), flow[0][1] - flow[0][0]
        made = []
        for s in range(len(self.picked)):
            rows = []
            for k, (t, _, scale) in enumerate(self.data[s]):
                place = np.clip((t / h).astype(int), 0, len(grid) - 2)
                w = (t / h - place)[:, None]
                rows.append(((1 - w) * slopes[place, s, k] + w * slopes[place + 1, s, k]) / scale)
            made.append(np.nan_to_num(np.concatenate(rows)))
        return made

    def normal(self, which: Sequence[int], altered: np.ndarray, rounds: int = ROUNDS
               ) -> tuple[np.ndarray, np.ndarray, float, int]:
        """(N, b, chi^2, degrees of freedom) of alterations around a given one, each segment from its best start."""
        start = self.begun.copy()
        flow = self.flow(start, altered)
        left, share = self.residuals(flow), np.ones(len(start))
        for _ in range(rounds):
            designs = self.designs(flow, (), altered)
            change = np.array([np.linalg.lstsq(D, r, rcond=1e-10)[0] for D, r in zip(designs, left, strict=True)])
            other = start + share[:, None] * change
            there = self.flow(other, altered, flow[3])
            after = self.residuals(there)
            better = np.array([r @ r < p @ p for r, p in zip(after, left, strict=True)])
            gain = max(float((p @ p - r @ r) / (1.0 + p @ p)) for r, p in zip(after, left, strict=True))
            start[better] = other[better]
            for part, now in zip(flow[1:3], there[1:3], strict=True):
                part[:, better] = now[:, better]
            left = [r if good else p for r, p, good in zip(after, left, better, strict=True)]
            share = np.where(better, np.minimum(1.0, 2 * share), 0.3 * share)
            if (gain < 1e-2 and share.min() < 0.5) or (gain < 1e-2 and better.all()):
                break
        self.begun = start
        self.last = list(zip(self.designs(flow, which, altered), left, strict=True))
        return self.reduced()[:4]

    def headline(self, prior: np.ndarray, u_num: np.ndarray | None = None, between: float = 0.0) -> Predicted:
        """Errors of prediction over the horizons; `prior` (K,): standard deviations of alterations that are inputs.

        Inputs are straight to the part `between`.
        """
        log, n = self.log, self.system.n
        rows = np.arange(len(log.starts))
        horizons = log.horizons
        altered = np.append(np.zeros(len(prior) - 1), between)
        grid, q, v, halves = self.system.flow(log.starts, log.begun, horizons[-1] + 2 * log.period, self.step,
                                              np.tile(altered, (len(rows), 1)))
        known = np.flatnonzero(prior).tolist()
        some = grid, q[:, self.picked], v[:, self.picked], halves[:, :, self.picked]
        by_start, by_altered = np.split(self.slopes(some, known, altered), [2 * n], axis=-1)
        near = self.picked[np.abs(self.picked[None] - rows[:, None]).argmin(axis=1)]  # segments that were not varied
        like = np.searchsorted(self.picked, near)
        error = np.full((len(rows), n, len(horizons)), np.nan)
        variance, given = np.zeros((2, *error.shape))
        for j, h in enumerate(horizons):
            place = min(round(h / self.step), len(grid) - 1)
            for k in range(n):
                t, q_k, noise = log.tracks[k]
                at = np.clip(np.searchsorted(t, log.starts + h - 0.5 * log.period), 0, len(t) - 1)
                since = t[at] - log.starts
                told = np.array([hermite(grid, q[:, s, k], v[:, s, k], since[s:s + 1])[0] for s in rows])
                gap = q_k[at] - told
                error[:, k, j] = np.where((np.abs(since - h) <= 2 * log.period) & (h <= log.reach * 1.01), gap, np.nan)
                Phi = by_start[place][like][:, k]  # (S, 2n)
                spread = np.zeros((len(rows), 2 * n, 2 * n))
                for i in range(n):
                    spread[:, i::n, i::n] = log.spread[:, i]
                variance[:, k, j] = np.einsum("si,sij,sj->s", Phi, spread, Phi) + noise.sigma**2
                given[:, k, j] = np.sum((by_altered[place][like][:, k] * prior[prior > 0]) ** 2, axis=1) + (
                    self.unknown[k, k] * log.period * h**3 / 3)
        num = np.zeros((n, len(horizons))) if u_num is None else u_num
        z = error / np.sqrt(variance + given + num**2)
        beyond = np.abs(np.nan_to_num(z)).max(axis=1) > DATED  # of each start by horizon
        first = beyond.argmax(axis=1)
        dates = [(log.starts[s] + horizons[j], -log.starts[s] - (0.0, *horizons)[j])  # missed then, and not before
                 for s, j in enumerate(first) if beyond[s, j]]
        rms = functools.partial(np.sqrt)
        return Predicted(horizons, rms(np.nanmean(error**2, axis=0)), rms(variance.mean(axis=0)),
                         rms(given.mean(axis=0)), num, rms(np.nanmean(z**2, axis=0)),
                         -min(dates)[1] if dates else None, log.starts)

    def numerical(self, horizons: Sequence[float], count: int = 3) -> np.ndarray:
        """(n, H) how far predictions are from truth, which crosses every break of the inputs, in so many segments."""
        log, system = self.log, self.system
        worst = np.zeros((system.n, len(horizons)))
        rows = np.unique(np.linspace(0, len(log.starts) - 1, count).astype(int))
        grid, q, v, _ = system.flow(log.starts[rows], log.begun[rows], horizons[-1], self.step)
        for s, row in enumerate(rows):
            scene = system.at_start(log.state[row, :, 0], log.state[row, :, 1], float(log.starts[row]), horizons[-1])
            series = dense(scene.replace(duration=min(horizons[-1], 2 * log.period))).series
            pieces, _ = series.advance(series.begin, horizons[-1])
            moved = Series(pieces)(np.array(horizons)) - series.begin.state
            true = system.positions(moved, log.state[row, :, 0])
            told = hermite(grid, q[:, s], v[:, s], np.array(horizons))
            worst = np.maximum(worst, np.abs(told - true).T)
        return worst


def row(joint: Joint, predicted: Predicted, k: int) -> str:
    """Predictions of one joint in words."""
    parts = [f"{h:g} s: {e:.2g} ({u:.2g})" for h, e, u in zip(predicted.horizons, predicted.error[k], predicted.u[k],
                                                              strict=True)]
    last = predicted.horizons.index(max(h for h in predicted.horizons if h <= HALF or h == predicted.horizons[0]))
    of = ", ".join(f"{each} {getattr(predicted, each)[k, last]:.1g}" for each in ("u_num", "u_input", "u_D"))
    unit = "m" if joint.kind.slides else "rad"
    return (f"{joint.name}: predictions are off by ({unit}, rms; u_val in brackets) {', '.join(parts)}; u_val after "
            f"{predicted.horizons[last]:g} s is of {of}")


def sized(system: System, sizes: Mapping[str, float]) -> list[str]:
    """The sizes of alterations of `STATED` in words, from all, by what they alter and of whom."""
    return [f"{what}{f' of {owner}' if owner else ''} {(100.0 if unit == '%' else 1.0) * sizes[key]:.2g} {unit}"
            for (what, owner), unit in zip(system.names, system.units, strict=True)
            if what in STATED and (key := f"{what} {owner}".strip()) in sizes]


PARTS = np.linspace(0.0, 1.0, 41)
"""Of straight lines in inputs of which it is not known whether they are held, that are tried."""


def alone(N: np.ndarray, b: np.ndarray, parts: np.ndarray, least: np.ndarray | float
          ) -> tuple[np.ndarray, np.ndarray, float, float]:
    """(sizes (m,), their standard deviations, chi^2 less that without them, part of straight lines) of alterations.

    N (m + 1, m + 1) and b (m + 1,) are of these and of that part, which may be any of `parts` at equal odds; no size is
    below `least`.
    """
    own, inverse = N[:-1, :-1], np.linalg.inv(N[:-1, :-1])
    free = b[:-1, None] - N[:-1, -1:] * parts
    size = np.maximum(inverse @ free, np.reshape(least, (-1, 1)))
    chi2 = parts * (parts * N[-1, -1] - 2 * b[-1]) + np.sum(size * (own @ size - 2 * free), axis=0)
    odds = np.exp(-0.5 * (chi2 - chi2.min()))
    odds /= odds.sum()
    mean, best = size @ odds, int(np.argmin(chi2))
    spread = np.sqrt(np.diag(inverse) + (size - mean[:, None]) ** 2 @ odds)
    return mean, spread, float(chi2[best]), float(parts[best])


def scatter(sizes: np.ndarray, weights: np.ndarray) -> float:
    """Variance of a size from segment to segment beyond their own, whose inverses are the weights; 0 if it is noise.

    Source: R. DerSimonian, N. Laird, Controlled Clinical Trials 7 (1986) 177, where Cochran's Q is beyond 95 %.
    """
    mean, count = float(weights @ sizes / weights.sum()), len(sizes) - 1
    Q = float(weights @ (sizes - mean) ** 2)
    if count < 1 or chdtr(count, Q) <= 0.95:
        return 0.0
    return (Q - count) / float(weights.sum() - weights @ weights / weights.sum())


def refined(fit: Fit, which: Sequence[int], begin: float = 0.0, rounds: int = 8) -> Cause:
    """Alterations, fitted together from `begin` where the motion is not linear in them.

    What a size differs by from segment to segment beyond its noise is no noise, and is not less in their mean.
    """
    altered, begun, last, rows = np.zeros(len(fit.system.names)), fit.begun, len(fit.system.names) - 1, list(which)
    altered[rows] = begin
    named = [(*fit.system.names[k], fit.system.units[k]) for k in rows]
    made, before = Cause([Sized(*name) for name in named]), math.inf
    parts = PARTS if fit.system.unsure and ("delay", "") not in [fit.system.names[k] for k in rows] else np.zeros(1)
    for _ in range(rounds):
        N, b, chi2, free = fit.normal([*rows, last], altered)
        if not chi2 < before * 1.001 or not (np.linalg.eigvalsh(N[:-1, :-1]) > 0).all():
            break
        before = chi2
        change, sigma, gain, part = alone(N, b, parts - altered[last], fit.system.least[rows] - altered[rows])
        moved, spare = np.append(change, part), max(1.0, (chi2 + gain) / free)
        for k, name in enumerate(named):
            own = np.array([each[k, k] for each, _ in fit.parts])
            some = own > 0
            sizes = change[k] + np.array([rest[k] - each[k] @ moved for each, rest in fit.parts])[some] / own[some]
            spread = math.sqrt(sigma[k] ** 2 * spare + scatter(sizes, own[some] / spare))
            made.parts[k] = Sized(*name, float(altered[rows[k]] + change[k]), spread)
        made.chi2, made.free = chi2 + gain, free
        altered[rows], altered[last] = altered[rows] + change, altered[last] + part
        fit.begun = fit.begun + fit.follows @ moved
        if all(abs(by) < 0.05 * each.sigma for by, each in zip(change, made.parts, strict=True)):
            break
    fit.begun = begun
    return since(fit, rows[0], made) if len(rows) == 1 else made


def since(fit: Fit, k: int, cause: Cause) -> Cause:
    """An alteration, or the same after the first segment that lacks something without it, if that leaves clearly less.
    """
    left, free = fit.nominal
    first = int(np.argmax(left > COVER * free))
    if not 0 < first < len(left) - 1:
        return cause
    later = copy.copy(fit)
    later.picked, later.begun, later.nominal = fit.picked[first + 1:], fit.begun[first + 1:], fit.nominal[:, first + 1:]
    later.data = fit.data[first + 1:]
    made = refined(later, [k], cause.parts[0].size)
    made = dataclasses.replace(made, chi2=made.chi2 + left[:first].sum() + free[first], free=made.free + int(
        free[:first + 1].sum()), since=float(fit.log.starts[fit.picked[first]]))
    return made if cause.chi2 - made.chi2 > CRITICAL**2 * max(1.0, made.chi2 / made.free) else cause


def priors(system: System, uncertain: Mapping[str, float]) -> np.ndarray:
    """(K,) standard deviations of alterations that are uncertain inputs: "mass": .05 is five percent of each.

    Half of the variance of a mass is one of its place alone, half that of a density, with which its inertia goes.
    """
    kinds = list(dict.fromkeys(what for what, _ in system.names if what != "between"))  # which is never known
    made = np.zeros(len(system.names))
    own = {joint.name: joint for joint in system.scene.joints}
    for key, value in uncertain.items():
        if key not in kinds:
            raise ArgumentError(f"uncertain: {unknown('alteration', key, kinds)}")
        if not isinstance(value, int | float) or not 0 < value < math.inf:
            raise ArgumentError(f"uncertain: {key}: a number > 0 is wanted, not {value!r}")
        for k, (what, owner) in enumerate(system.names):
            if what == key or (key, what) == ("mass", "mass and inertia"):
                joint = own.get(owner)
                size = 1.0 if joint is None or not BY_NAME[key].share else float(
                    joint.dry_friction[0].sliding if key == "friction" and joint.dry_friction and joint.dry_friction[0]
                    else sum(getattr(joint, key, ()) or ()) if key != "friction" else 0.0)
                made[k] = math.hypot(made[k], value * size * (math.sqrt(0.5) if key == "mass" else 1.0))
    return made


@dataclasses.dataclass
class Answer:
    """What a log says of a model."""

    predicted: Predicted
    causes: list[Cause]  # that explain it equally well, the best first
    explained: float  # part of what the log misses beyond its noise, by the best
    worst: float  # rms of what fitted segments leave over their noise
    detectable: dict[str, float]  # the smallest alteration of each kind and owner that would have shown
    fails: bool
    skipped: int = 0  # causes that might explain as well, for which there was no time


def answer(log: Log, system: System, uncertain: Mapping[str, float]) -> Answer:
    """Predictions of one model, and the alterations that its log asks for, as far as `PATIENCE` goes."""
    until = time.process_time() + PATIENCE
    fit, prior = Fit(log, system), priors(system, uncertain)
    none, last = np.zeros(len(system.names)), len(system.names) - 1
    every = range(last)
    fit.normal(range(last + 1), none)
    fit.loosened()
    N, b, chi2, free, _ = fit.reduced()
    fit.nominal = fit.left
    parts = PARTS if system.unsure else np.zeros(1)
    known = np.flatnonzero(prior > 0)

    def without(rows: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """N and b of some alterations, and what chi^2 loses, where uncertain inputs may be what they like."""
        inner = N[np.ix_(others, others)] + np.diag(1 / prior[others] ** 2)
        lost = np.linalg.solve(inner, np.column_stack([N[np.ix_(others, rows)], b[others]]))
        return (N[np.ix_(rows, rows)] - N[np.ix_(rows, others)] @ lost[:, :-1],
                b[rows] - N[np.ix_(rows, others)] @ lost[:, -1], float(b[others] @ lost[:, -1]))

    def straight(N: np.ndarray, b: np.ndarray) -> tuple[float, float]:
        """(part of straight lines that fits best without an alteration, what chi^2 changes by)."""
        chi2 = parts * (parts * N[-1, -1] - 2 * b[-1])
        return float(parts[np.argmin(chi2)]), float(chi2.min())

    def gained_with(others: np.ndarray) -> np.ndarray:
        """(2, K) what chi^2 loses by each alteration, others being free, and the standard deviation of its size."""
        found = np.array([np.zeros(last), np.full(last, math.inf)])
        for k in every:
            if not N[k, k] * fit.sizes[k] ** 2 > NOTHING:
                continue
            M, g, _ = without(np.array([k, last]), others[others != k])
            if M[0, 0] > 1e-9 * N[k, k]:
                lines = parts if system.names[k][0] != "delay" else np.zeros(1)
                _, sigma, gain, _ = alone(M, g, lines, system.least[k])
                gain = max(straight(M, g)[1] - gain, 0.0)
                found[:, k] = (gain * sigma[0] ** 2 / (sigma[0] ** 2 + prior[k] ** 2),
                               math.sqrt(sigma[0] ** 2 + prior[k] ** 2))
        return found

    gains, sizes = gained_with(known)
    M, g, given = without(np.array([last]), known)
    between, less = straight(M, g)
    predicted = fit.headline(prior, fit.numerical(log.horizons), between)
    chi2 += less
    scale = max(1.0, (chi2 - gains.max()) / free)
    early = 0.5 * log.period * system.unsure  # which straight lines make of a delay
    shown = {f"{what} {owner}".strip(): (CRITICAL + MISSED) * size * math.sqrt(scale) + early * (what == "delay")
             for (what, owner), size in zip(system.names, sizes, strict=False) if np.isfinite(size)}
    order = np.argsort(-gains).tolist()
    beyond = bool(chi2 - given > COVER**2 * free)  # of what uncertain inputs may make
    if gains[order[0]] <= CRITICAL**2 * scale and not beyond:
        return Answer(predicted, [], 0.0, math.sqrt(chi2 / free), shown, False)
        order = np.argsort(-gains).tolist()
    made, skipped = [refined(fit, order[:1])], 0

    def explains() -> float:
        gain = chi2 - min(cause.chi2 for cause in made)
        return gain / max(chi2 - free, gain, 1e-300)

    def more(ways: Iterable[Callable[[], Cause]]) -> None:
        nonlocal skipped
        for way in ways:
            if time.process_time() > until:
                skipped += 1
            elif (cause := way()).sure:
                made.append(cause)
        made.sort(key=lambda cause: cause.chi2 + ALIKE * (len(cause.parts) > 1))

    def lacking(enough: float = ENOUGH) -> bool:
        return explains() < enough and made[0].chi2 > COVER * free and not uncertain

    more(functools.partial(refined, fit, [k]) for k in order[1:TRIED] if gains[k] > NEAR * gains[order[0]] and (
        made[0].chi2 > COVER * free or N[k, order[0]] ** 2 > PARALLEL * N[k, k] * N[order[0], order[0]]))
    if lacking(1.0):
        more(functools.partial(cut_off, fit, k) for k in range(system.n) if system.efforts[k])
    part = made[0].parts[0]
    if lacking() or (part.what == "torque gain" and part.size < -1.0):
        more(functools.partial(reversed_sign, fit, k, way) for k in range(system.n) for way in SIGNS)
    if lacking():
        pairs = [(i, j) for i, j in itertools.combinations(np.flatnonzero(sizes < math.inf).tolist(), 2)
                 if N[i, j] ** 2 < TOGETHER * N[i, i] * N[j, j]]
        gained = {pair: alone(N[np.ix_(rows, rows)], b[list(rows)], parts, system.least[list(pair)])[2]
                  for pair in pairs for rows in [(*pair, last)]}
        more(functools.partial(refined, fit, pair) for pair in sorted(gained, key=lambda pair: gained[pair])[:PAIRS])
    best = made[0]
    spare = max(1.0, best.chi2 / free)
    if not best.sure and not beyond:
        return Answer(predicted, [], 0.0, math.sqrt(chi2 / free), shown, False)
    named = explains() > PART and best.sure
    alike = [each for each in made if each.chi2 - best.chi2 <= ALIKE * spare and len(each.parts) <= len(best.parts)]
    alike = [each for each in alike if each.sign] or alike  # there is nothing to fit in it
    if predicted.since is not None:
        for each in alike:
            if each.since is not None and each.since < predicted.since < each.since + log.span:
                each.since = predicted.since
    return Answer(predicted, alike if named else [], explains(), math.sqrt(chi2 / free), shown, True, skipped)


def cut_off(fit: Fit, k: int) -> Cause:
    """The k-th joint's largest torque below that of its inputs, which shows in no small alteration."""
    altered, row = np.zeros(len(fit.system.names)), fit.system.names.index(("largest torque", fit.log.names[k]))
    left = {}
    for begin in CUTS:
        altered[row] = begin
        left[begin] = fit.normal((row,), altered, 2)[2]
    return refined(fit, [row], min(left, key=lambda begin: left[begin]))


def reversed_sign(fit: Fit, k: int, way: str) -> Cause:
    """The k-th joint's positions and rates, its inputs, or both with the other sign."""
    log, system = copy.copy(fit.log), copy.copy(fit.system)
    if "positions" in way:
        log.tracks, log.state = [*log.tracks], log.state.copy()
        for row in (k, k + system.n):
            log.tracks[row] = log.tracks[row]._replace(values=-log.tracks[row].values)
        log.state[:, k] *= -1.0
    if "inputs" in way:
        for name in ("efforts", "targets", "target_velocities"):
            setattr(system, name, [signal and dataclasses.replace(signal, values=-signal.values) if at == k else signal
                                   for at, signal in enumerate(getattr(system, name))])
    other = Fit(log, system, len(fit.picked))
    other.unknown = fit.unknown
    _, _, chi2, free = other.normal((), np.zeros(len(system.names)))
    return Cause([], chi2, free, sign=f"{log.names[k]}'s {way}")


CUTS, SIGNS = (-0.1, -0.3, -0.5, -0.7), ("inputs", "positions", "positions and inputs")
"""Parts of the largest torque from which one that is smaller is fitted; what may have the other sign."""

PATIENCE = 40.0
"""s of processor time after which no further cause is fitted."""

ENOUGH, TOGETHER, PAIRS = 0.9, 0.98, 2
"""Part of what is beyond the noise that one cause has to explain for two together not to be tried; how parallel these
may be; and how many are fitted."""

NOTHING, NEAR, PARALLEL, TRIED = 1e-4, 0.1, 0.5, 5
"""chi^2 of an alteration of its usual size below which it does nothing; parts of the best one's gain, and of being
parallel to it, from which others are fitted as well, of so many."""


def readings(scene: Scene, recording: Recording) -> list[tuple[str, tuple[Group, ...]]]:
    """The ways to read efforts that the mapping leaves open: which column acts, and on which side of the friction."""
    owners: dict[str, list[Group]] = {}
    for group in recording.inputs:
        if group.key in EFFORTS:
            owners.setdefault(group.owner, []).append(group)
    rest = tuple(group for group in recording.inputs if group.key not in EFFORTS)
    kinds = sorted({group.key for groups in owners.values() for group in groups}, key=EFFORTS.index)
    rubs = any(sum(joint.damping or ()) or any(joint.dry_friction) for joint in scene.joints if joint.name in owners)
    told = any(group.row.side for groups in owners.values() for group in groups)
    made = []
    for kind, side in itertools.product(kinds or [""], ("motor", "link") if rubs and not told else ("",)):
        picked = [next((group for group in groups if group.key == kind), groups[0]) for groups in owners.values()]
        words = f"{kind.partition('_')[2]} efforts".strip() + (f" on the {side} side" if side else "")
        made.append((words, (*rest, *(dataclasses.replace(group, row=msgspec.structs.replace(
            group.row, side=group.row.side or side)) for group in picked))))
    return made


def chosen(scene: Scene, log: Log, recording: Recording) -> tuple[System, list[str]]:
    """The system under its inputs, and what was tried of what the mapping leaves open."""
    ways = readings(scene, recording)
    systems = [System(scene, inputs, recording.t) for _, inputs in ways]
    if len(ways) == 1:
        return systems[0], []
    left = []
    for system in systems:
        fit = Fit(log, system, 20)
        _, _, chi2, free = fit.normal((), np.zeros(len(system.names)), 2)
        left.append(chi2 / free)
    best = int(np.argmin(left))
    if left[best] > CLEARER * left[0]:
        best = 0
    tried = "; ".join(f"{words} leave {math.sqrt(size / left[best]):.3g} times as much" for k, ((words, _), size) in (
        enumerate(zip(ways, left, strict=True))) if k != best)
    sure = sorted(left)[1] > left[best] / CLEARER if len(left) > 1 else True
    return systems[best], [f"inputs read as {ways[best][0]} ({'the data decide' if sure else 'the data do not tell'}; "
                           f"{tried})"]


CLEARER = 0.5
"""Part of chi^2 that another reading of efforts may leave to be taken."""
