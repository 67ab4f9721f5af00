"""Fixed-step runs: chunks of steps, timing, samples, monitoring of every step, detection of divergence."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec, steps_per_sample
from crosscheck.errors import ArgumentError, EngineError
from crosscheck.scene.events import Event, events
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

if TYPE_CHECKING:
    from crosscheck.scene.monitor import Monitor

CHUNK = 16384
"""Number of steps whose history is kept at once if every step is monitored: some megabytes."""

LIMIT = 1e10
"""Coordinates and velocities larger than this, SI, count as divergence; the same as MuJoCo's mjMAXVAL."""

Advance = Callable[[int, int], tuple[np.ndarray, np.ndarray]]
"""(steps, stride) -> joint positions and velocities after every stride-th of the next `steps` steps."""

Convert = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None], States]
"""(t, q, v, joint accelerations or None) -> states."""


def fixed_step(scene: Scene, spec: RunSpec) -> tuple[int, float]:
    """(steps in one sample interval, step used, s); raises `ArgumentError` if no step is given."""
    if spec.step is None:
        raise ArgumentError(f"step: {spec.method} needs a fixed step; give one in s, such as 1e-3")
    return steps_per_sample(scene, spec.step)


def one_by_one(step: Callable[[], object], state: Callable[[], tuple[np.ndarray, np.ndarray]]) -> Advance:
    """Makes steps one by one, and keeps the state after every stride-th."""
    def advance(steps: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
        kept = []
        for _ in range(steps // stride):
            for _ in range(stride):
                step()
            kept.append([np.array(part) for part in state()])
        q, v = (np.array(part) for part in zip(*kept, strict=True))
        return q, v

    return advance


def march(scene: Scene, spec: RunSpec, initial: tuple[np.ndarray, np.ndarray], advance: Advance, convert: Convert,
          accelerate: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> RawRun:
    """Run a fixed-step engine over the scene; `wall_time` covers only the calls of `advance`.

    `accelerate` maps histories (t, q, v), one row per time, to joint accelerations. It is called for every step if
    `spec.monitor` is on, otherwise only for the samples.

    Raises
    ------
    EngineError
        The state became infinite or NaN.
    """
    per, h = fixed_step(scene, spec)
    total = per * (scene.samples - 1)
    from crosscheck.scene.monitor import Monitor

    monitor = Monitor(scene) if spec.monitor else None
    happened: list[Event] = []
    stride, chunk = (1, CHUNK) if spec.monitor else (per, total)
    q, v = (part[None] for part in initial)
    kept, done, wall = [(q, v, accelerate(np.zeros(1), q, v))], 0, 0.0
    hinges = list[np.ndarray]()
    if monitor is not None:
        last = convert(np.zeros(1), *kept[0])
        watch(monitor, last)
        assert last.hinges is not None
        hinges.append(last.hinges)
    with np.errstate(over="ignore", invalid="ignore"):  # a diverging run is reported below, with its time
        while done < total:
            count = min(chunk, total - done)
            start = time.perf_counter()
            q, v = advance(count, stride)
            wall += time.perf_counter() - start
            steps = np.arange(done + stride, done + count + 1, stride)
            check_finite(spec.method, steps * h, q, v)
            a = accelerate(steps * h, q, v)
            on_sample = steps % per == 0
            if monitor is not None:
                states_here = convert(steps * h, q, v, a)
                watch(monitor, states_here)
                assert states_here.hinges is not None
                hinges.append(states_here.hinges[on_sample])
                happened += events(scene, joined(last, states_here), shapes=False) if scene.has_laws else []
                last = states_here
            kept.append((q[on_sample], v[on_sample], a[on_sample]))
            done += count
    states = convert(scene.t, *(np.concatenate(parts) for parts in zip(*kept, strict=True)))
    if monitor is not None:
        states.hinges = np.concatenate(hinges)
    return RawRun(states, wall, total, h, maxima=None if monitor is None else monitor.maxima(), form=spec.form,
                  events=() if monitor is None else tuple(sorted([*happened, *(
                      event for event in events(scene, states) if event[2] == "touches")])))


def joined(before: States, states: States) -> States:
    """The last of the states before, and these."""
    t, x, R, v, w, hinges = (np.concatenate([getattr(before, key)[-1:], getattr(states, key)]) for key in (
        "t", "x", "R", "v", "w", "hinges"))
    return States(t, x, R, v, w, hinges=hinges)


def watch(monitor: Monitor, states: States) -> None:
    """Add states that follow those that the monitor has seen; they get the angles of hinges."""
    states.hinges = monitor.update(states.x, states.R, states.v, states.w, states.a, states.alpha, states.t,
                                   states.hinges)


def check_finite(method: str, t: np.ndarray, *histories: np.ndarray) -> None:
    """Raise `EngineError` with the first of the times t, (T,), at which a history (T, ...) is not finite."""
    good = np.ones(len(t), dtype=bool)
    for history in histories:
        good &= (np.abs(history.reshape(len(t), -1)) < LIMIT).all(axis=1)
    if not good.all():
        raise EngineError(f"{method} diverged: the state is not finite at t = {t[np.argmin(good)]:.6g} s; "
                          "try a smaller step")
