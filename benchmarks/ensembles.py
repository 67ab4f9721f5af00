"""Ensembles beside `mujoco.rollout` and heyoka's batches with the same threads, and a loop, for `benchmarks.speed`.

Members start with angular velocities scattered about the scene's; each
contender gets the coarsest setting of a ladder whose median error over the members (largest component of the bodies'
positions after 10 s, against Taylor at rtol 1e-13) is at most the one asked for. Contenders take turns in one process,
of the stepping alone without the building of models. heyoka integrates joint coordinates
(quaternions), as many members in a register as it recommends, with code compiled for one tolerance.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem

DURATION = 10.0  # s
SCATTER = 0.1  # rad/s
STEPS = tuple(DURATION / round(50 * 2 ** (k / 2)) for k in range(25))
RTOLS = tuple(10.0 ** (-k / 2) for k in range(4, 25))


@dataclasses.dataclass(frozen=True)
class Contender:
    """`run(states, control)` returns end positions (N, n, 3) and the seconds it took."""

    name: str
    controls: Sequence[float]
    run: Callable[[dict[str, np.ndarray], float], tuple[np.ndarray, float]]


def members(scene: Any, count: int) -> dict[str, np.ndarray]:
    """States of a chain of ball joints from the ground."""
    w = scene.w0 + SCATTER * np.random.default_rng(1).standard_normal((count, scene.n, 3))
    v = np.zeros_like(w)
    for body, joint in enumerate(scene.joints):
        above = v[:, body - 1] + np.cross(w[:, body - 1], joint.parent_anchor) @ scene.R0[body - 1].T if body else 0.0
        v[:, body] = above - np.cross(w[:, body], joint.child_anchor) @ scene.R0[body].T
    return {"v": v, "w": w}


def contenders(scene: Any, threads: int) -> list[Contender]:
    """Ensembles, the loop, heyoka, and MuJoCo's Runge-Kutta rule of order 4."""
    problem = build_problem(scene)

    def ensemble(method: str, control: str = "rtol") -> Any:
        def run(states: dict[str, np.ndarray], value: float) -> tuple[np.ndarray, float]:
            began = time.perf_counter()
            many = lieeuler.integrate_ensemble(problem, method, t_eval=[0.0, DURATION], threads=threads,
                                               **{control: value}, **states)
            return many.x[:, -1], time.perf_counter() - began
        return run

    def loop(states: dict[str, np.ndarray], rtol: float) -> tuple[np.ndarray, float]:
        began = time.perf_counter()
        ends = [lieeuler.integrate(dataclasses.replace(problem, v=v, w=w), "taylor", rtol=rtol, monitor=False,
                                   t_eval=[0.0, DURATION]).x[-1] for v, w in zip(states["v"], states["w"], strict=True)]
        return np.array(ends), time.perf_counter() - began

    return [Contender("ensemble taylor", RTOLS, ensemble("taylor")),
            Contender("ensemble rkmk853", RTOLS, ensemble("rkmk853")),
            Contender("ensemble rkmk4", STEPS, ensemble("rkmk4", "step")),
            Contender("loop over integrate, taylor", RTOLS, loop),
            Contender("heyoka batches", RTOLS, heyoka_batches(scene, threads)),
            Contender("mujoco.rollout RK4", STEPS, mujoco_rollout(scene, threads))]


def moved(scene: Any, states: dict[str, np.ndarray], k: int) -> Any:
    """The scene with the velocities of member k."""
    return scene.replace(bodies=tuple(
        dataclasses.replace(body, velocity=states["v"][k, i], angular_velocity=states["w"][k, i])
        for i, body in enumerate(scene.bodies)))


def heyoka_batches(scene: Any, threads: int) -> Callable[[dict[str, np.ndarray], float], tuple[np.ndarray, float]]:
    """heyoka's `ensemble_propagate_until_batch` on the equations of the truth."""
    import heyoka

    from crosscheck.references.joint_motion import Tree
    from crosscheck.references.taylor import Taylor
    from crosscheck.references.tree import unfold

    truth, links = Taylor(scene), unfold(scene)[0]
    equations = truth.integrator(compact_mode=True).sys
    batch = heyoka.recommended_simd_size()

    @functools.cache
    def compiled(tolerance: float) -> Any:
        return heyoka.taylor_adaptive_batch(equations, np.zeros((len(truth.initial), batch)), tol=tolerance,
                                            compact_mode=scene.n > 1)  # without, two bodies compile for a minute

    def run(states: dict[str, np.ndarray], tolerance: float) -> tuple[np.ndarray, float]:
        starts = np.array([Tree(moved(scene, states, k), links).initial() for k in range(len(states["w"]))])
        groups = np.array([starts[np.arange(low, low + batch) % len(starts)].T for low in range(0, len(starts), batch)])

        def begin(integrator: Any, group: int) -> Any:
            integrator.set_time(0.0)
            integrator.state[:] = groups[group]
            return integrator

        integrator = compiled(tolerance)
        began = time.perf_counter()
        done = heyoka.ensemble_propagate_until_batch(integrator, DURATION, len(groups), begin, max_workers=threads)
        seconds = time.perf_counter() - began
        ends = np.concatenate([each[0].state.T for each in done])[:len(starts)]
        return truth.pose(truth.normalised(ends))[0], seconds

    return run


def mujoco_rollout(scene: Any, threads: int) -> Callable[[dict[str, np.ndarray], float], tuple[np.ndarray, float]]:
    """`mujoco.rollout`: the threads step members of one model, all states of all steps are kept."""
    import mujoco
    from mujoco import rollout

    from crosscheck.adapters.mujoco.models import build, set_initial_state

    def run(states: dict[str, np.ndarray], step: float) -> tuple[np.ndarray, float]:
        model = build(scene, "RK4", step)
        data = mujoco.MjData(model)
        count = len(states["w"])
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        first = np.empty(size)
        starts = np.empty((count, size))
        for k in range(count):
            set_initial_state(moved(scene, states, k), model, data)
            mujoco.mj_getState(model, data, first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            starts[k] = first
        slots = [mujoco.MjData(model) for _ in range(threads)]
        steps = round(DURATION / step)
        ends = np.empty((count, scene.n, 3))
        block = max(1, 2_000_000 // steps)  # rollout keeps the state of every step
        seconds = 0.0
        for low in range(0, count, block):
            began = time.perf_counter()
            states_out, _ = rollout.rollout(model, slots, starts[low:low + block], nstep=steps)
            seconds += time.perf_counter() - began
            for k, last in enumerate(states_out[:, -1]):
                mujoco.mj_setState(model, data, np.ascontiguousarray(last), mujoco.mjtState.mjSTATE_FULLPHYSICS)
                mujoco.mj_kinematics(model, data)
                ends[low + k] = [data.body(str(body)).xipos for body in range(scene.n)]
        return ends, seconds

    return run


def coarsest(contender: Contender, few: dict[str, np.ndarray], truth: np.ndarray,
             wanted: float) -> tuple[Contender, float, float] | None:
    """The contender, its coarsest setting whose median error is at most `wanted`, and that error."""
    for control in contender.controls:
        error = float(np.median(np.abs(contender.run(few, control)[0] - truth).max(axis=(1, 2))))
        if error <= wanted:
            return contender, control, error
    return None


def compared(name: str, wanted: float, count: int, threads: int, rounds: int
             ) -> dict[str, tuple[float, float, list[float]]]:
    """By contender its setting, its error (m), and seconds per member in each round, at an error of at most `wanted`.

    `count` members of an ensemble on so many threads; slow contenders run a part of them.
    """
    scene = crosscheck.load_scene(name).replace(duration=DURATION, samples=2)
    few, states = members(scene, 20), members(scene, count)
    truth = lieeuler.integrate_ensemble(build_problem(scene), "taylor", rtol=1e-13, t_eval=[0.0, DURATION], **few)
    chosen = [found for contender in contenders(scene, threads)
              if (found := coarsest(contender, few, truth.x[:, -1], wanted))]
    seconds: dict[str, list[float]] = {contender.name: [] for contender, _, _ in chosen}
    for _ in range(rounds):
        for contender, control, _ in chosen:
            part = max(2, count // (1 if contender.name.startswith("ensemble") else 20))
            taken = contender.run({key: value[:part] for key, value in states.items()}, control)[1]
            seconds[contender.name].append(taken / part)
    return {contender.name: (control, error, seconds[contender.name]) for contender, control, error in chosen}
