"""Derivatives of the flow of a scene over a time, with respect to its start and to numbers of the scene.

Truth is the variational equations as a Taylor jet of the articulated formulation (heyoka), checked along a random
direction by central differences of the maximal one; derivatives by numbers of the scene are such differences of order
eight. Of an engine it is the derivative of its discrete map, by central differences of order eight of its runs.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.errors import ArgumentError, Unsupported
from crosscheck.jointspace.derivatives import WEIGHTS
from crosscheck.jointspace.motion import JointSpace, angles, between, coordinates
from crosscheck.references import compute
from crosscheck.references.base import TruthError
from crosscheck.references.maximal import Maximal
from crosscheck.references.tree import FREE
from crosscheck.running.attempt import Ran, Way, attempt
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene
from crosscheck.scene.paths import changed, content_of, number_at, size_at
from crosscheck.scene.starts import started
from crosscheck.scene.states import States

AGREED = 1e-7
"""Largest difference of the two routes of truth, relative to the largest entry; what it is counts as the error."""

STEP = 2e-3
"""Of differences of runs, rad, m and relative to a number of the scene. Their truncation is below rounding, which of a
run, 1e-14, is 1e-11 over the step."""

Ended = tuple[States, tuple[Any, ...]]
"""States of a run, the last of which is its end, and the events of its laws."""

End = Callable[[Scene], Ended]


@dataclasses.dataclass(frozen=True)
class FlowDerivative:
    """Derivatives of the state after a time.

    Attributes
    ----------
    coordinates : names of q, in order; rows and columns are those of q, then those of the rates v.
    matrix : (2n, 2n) with respect to (q, v) at the start. A ball has a small turn in its child's axes.
    parameters : (2n, p) with respect to numbers of the scene's file.
    error : what truth claims, relative to the largest entry; that of differences for an engine.
    """

    scene: str
    source: str
    duration: float
    coordinates: tuple[str, ...]
    matrix: np.ndarray
    parameters: np.ndarray
    error: float


def flow_derivative(scene: Scene | str | os.PathLike[str], duration: float, source: str = "truth",
                    step: float | None = None, parameters: Sequence[str] = (), **options: object) -> FlowDerivative:
    """Derivatives of the state of a tree of joints after `duration` (s).

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    source : "truth", or "engine:method"
    step, **options : of the engine's run, as in `crosscheck.run`
    parameters : paths of numbers of the scene's file, such as "bodies.upper.mass", "gravity.2" or
        "joints.rail.damping"; the scene with another one is the edited file, read again

    Raises
    ------
    ArgumentError, SceneError, EngineError
        An argument is wrong, a number cannot be changed by itself, or the engine fails.
    Unsupported
        The scene has no joint coordinates, or the events of its laws change with the start or a number.
    TruthError
        The two routes of the truth differ by more than 1e-7.
    """
    loaded = scene_file.as_scene(scene)
    if isinstance(duration, bool) or not isinstance(duration, int | float) or not 0 < duration < np.inf:
        raise ArgumentError(f"duration: {duration!r} is no time in s above 0")
    if isinstance(parameters, str):
        raise ArgumentError(f"parameters: give a tuple of paths, ({parameters!r},)")
    loaded = loaded.lasting(duration).replace(samples=2)
    space = JointSpace(loaded.lawless)
    content = content_of(loaded) if parameters else {}
    numbers = [number_at(content, path) for path in parameters]
    for path, value in zip(parameters, numbers, strict=True):
        if isinstance(value, list):
            raise ArgumentError(f"parameters: {path!r} is a list of numbers; name one of them, {path + '.0'!r}")
    end, error = (_exact(loaded), 1e-9) if source == "truth" else (_engine(source, step, options), 1e-10)
    base = end(loaded)

    def along(row: np.ndarray) -> np.ndarray:
        return _difference(lambda s: loaded.replace(bodies=space.moved(*np.split(s * row, 2)).bodies), end, loaded,
                           base)

    if source == "truth" and not loaded.has_laws:
        matrix = jet(space)
        direction = np.random.default_rng(1).normal(size=2 * space.size)
        scale = float(np.abs(matrix).max() * np.linalg.norm(direction))
        error = max(float(np.abs(matrix @ direction - along(direction)).max()) / scale, 1e-13)
        if not error <= AGREED:
            raise TruthError(f"derivative of the flow of {loaded.name!r}: two routes differ by {error:.1e}")
    else:
        matrix = np.stack([along(row) for row in np.eye(2 * space.size)], axis=1)

    def by(path: str, value: float) -> np.ndarray:
        size = size_at(content, path)
        return _difference(lambda s: changed(loaded, {path: value + s * size}), end, loaded, base) / size

    columns = np.array([by(*each) for each in zip(parameters, numbers, strict=True)]).reshape(-1, 2 * space.size).T
    return FlowDerivative(loaded.name, source, float(duration), loaded.coordinates, matrix, columns, error)


def jet(space: JointSpace) -> np.ndarray:
    """(2n, 2n) by the variational equations of the articulated formulation."""
    import heyoka

    scene, equations = space.scene, space.equations
    if scene.timed:
        raise Unsupported(f"derivative of the flow of {scene.name!r}: its forces depend on time")
    symbols = [heyoka.make_vars(f"y{k}") for k in range(len(equations.initial))]
    rates = equations._rates(symbols, lambda value: value)
    system = [(symbol, heyoka.expression(rate) if isinstance(rate, float | int) else rate)
              for symbol, rate in zip(symbols, rates, strict=True)]
    varied = heyoka.var_ode_sys(system, heyoka.var_args.vars, order=1)
    size = len(symbols)
    integrator = heyoka.taylor_adaptive(varied, equations.initial.tolist(), compact_mode=True, high_accuracy=True,
                                        opt_level=0)
    integrator.propagate_until(scene.duration)
    state = np.array(integrator.state)
    first = np.array([state[integrator.get_vslice(order=1, component=k)] for k in range(size)])
    end = space.at(state[:size].tolist())
    last = JointSpace(started(scene, *(np.real(each) for each in (end.x, end.R, end.v, end.w))))
    for link in last.links:
        place = last.equations.tree.coordinates[link.body].start
        if link.turn == FREE and state[place:place + 4] @ last.equations.initial[place:place + 4] < 0.0:
            first[place:place + 4] *= -1.0  # one attitude has two quaternions
    after, before = (np.concatenate(each.derivative(lambda bodies: bodies.state), axis=1) for each in (last, space))
    return np.asarray(np.linalg.pinv(after) @ first @ before)


def _exact(scene: Scene) -> End:
    if scene.has_laws:  # both formulations, which have to find the same events
        return lambda other: ((moved := compute(other)).states, moved.events)
    return lambda other: (Maximal(other).run(np.array([0.0, other.duration])), ())


def _engine(source: str, step: float | None, options: dict[str, Any]) -> End:
    name, method = adapters.split(source)
    if not method:
        raise ArgumentError(f"source: {source!r}: name a method too, as in \"lieeuler:rattle2\"")

    def end(scene: Scene) -> Ended:
        outcome = attempt(scene, Way.of(name, method, step, **options), monitor=False, derived=False)
        if isinstance(outcome, Ran):
            return outcome.raw.states, outcome.raw.events or ()
        raise outcome.error

    return end


def _difference(made: Callable[[float], Scene], end: End, scene: Scene, base: Ended) -> np.ndarray:
    """d/ds of the coordinates at the end of `made(s)`, (2n,), at s = 0; the jumps at events are in it."""
    def moved(size: float) -> np.ndarray:
        other = made(size)
        states, events = end(other)
        if [event[1:] for event in events] != [event[1:] for event in base[1]]:
            raise Unsupported(f"derivative of the flow of {scene.name!r}: the events of its laws, or their order, "
                              "change with the start or the number, so that it has none")
        return change(scene, base[0], other, states)

    return np.asarray(sum(weight / STEP * (moved(k * STEP) - moved(-k * STEP)) for k, weight in WEIGHTS))


def change(scene: Scene, base: States, other: Scene, states: States) -> np.ndarray:
    """(q, v) of the last states of another scene minus those of the scene, (2n,), each by its own joints."""
    (p, u), (q, v) = (coordinates(each, States(run.t[-1:], run.x[-1:], run.R[-1:], run.v[-1:], run.w[-1:]))
                      for each, run in ((scene, base), (other, states)))
    moved = between(scene, p[0], q[0])
    turned = angles(scene)
    moved[turned] -= 2 * np.pi * np.round(moved[turned] / (2 * np.pi))
    return np.concatenate([moved, v[0] - u[0]])
