"""Assertions for tests: engines converge to truth, or agree with it and with each other within a tolerance.

Whole runs of an engine at three steps say where it goes as they vanish, and how surely: T3 lacks two powers of the
step, and its uncertainty U is 3 |T3 - T2| and what rounding and truth leave. Truth has to be within U.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec, steps_per_sample
from crosscheck.compare.apart import STATE, scaled, state_apart
from crosscheck.compare.errors import differences, up_to
from crosscheck.compare.ladder import counts, finer
from crosscheck.compare.order import (
    MARGIN,
    SAFETY,
    Limit,
    differ,
    index,
    limit,
    observed_order,
    spread_of_tolerances,
)
from crosscheck.compare.sizes import at_rest, length_of, sizes
from crosscheck.document import QUANTITIES, Way
from crosscheck.document.outcomes import percent
from crosscheck.errors import ArgumentError, EngineError
from crosscheck.judge.rounding import EPS, grading
from crosscheck.judge.rules import RESOLVED
from crosscheck.references.base import Reference
from crosscheck.references.maximal import fastest
from crosscheck.running.arguments import best_method
from crosscheck.running.run import run as run_scene
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene

Entry = str | Sequence[Any]
Run = Callable[..., Any]

MOST_STEPS = 1e6
"""Most steps of a run whose step the test does not give; with any engine they take seconds."""

AIM, FEWEST = 1e-4, 20
"""Uncertainty over the size, a hundredth of what counts as resolved, that a chosen step aims at, and its fewest steps.
"""


@dataclasses.dataclass(frozen=True)
class Tol:
    """A bound and the reason for it."""

    value: float
    why: str


def assert_agree(scene: Scene | str | os.PathLike[str], engines: Entry | Sequence[Entry], tol: object = None, *,
                 step: float | None = None, rtol: float | None = None, need: float = 1.0, run: Run | None = None,
                 truth: Callable[[Scene], Reference] | None = None) -> None:
    """Assert that every engine converges to the independent truth of a scene, or is within a tolerance of it.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    engines : one or several (in a list or tuple), each a name, "engine:method", or a tuple or list (engine, method) or
        (engine, method, options), where options is a dictionary of arguments of `crosscheck.run`, such as
        {"step": 1e-3, "form": "tree"}. Without a method the engine's last one of the highest documented order is used.
    tol : a number or `crosscheck.testing.agreement.Tol` for every quantity in its SI unit, or a mapping from quantities
        ("position", "attitude", "velocity", "angular velocity") to such; quantities not in it are not compared. Runs
        are then within it of truth, and of each other. By default runs at three steps or tolerances, one of them that
        of the test, have truth within the uncertainty of their limit, and their documented order. Any two then agree
        within the sum of their errors and uncertainties.
    step, rtol : for engines whose options give neither; by default a step is chosen at which the uncertainty is small
    need : share of the scene's time over which the comparison with truth has to reach
    run, truth : replace `crosscheck.run` and `crosscheck.truth`, for example by fixtures that run each engine only once

    Raises
    ------
    AssertionError
        Begins with the outcome: "fail" names quantity, bound, reason, first time of violation and worst body,
        "unresolved" the share of the time that was compared, or the uncertainty that is too large.
    ArgumentError, SceneError, Unsupported, EngineError, TruthError
        As `crosscheck.run` and `crosscheck.truth`.
    """
    __tracebackhide__ = True  # so that pytest shows the line of the test
    loaded = scene_file.as_scene(scene)
    if not isinstance(engines, Iterable) or isinstance(engines, Mapping):
        raise ArgumentError(f"engines: a name or a list of them is wanted, not {engines!r}")
    entries: list[Entry] = [engines] if isinstance(engines, str) else list(engines)
    if not entries:
        raise ArgumentError("engines: at least one is needed")
    tol = _checked(tol)
    reference = (truth or references.truth)(loaded)
    contenders = [contender(entry, loaded, reference, step, rtol) for entry in entries]
    trajectories = [(run or run_scene)(loaded, each.engine, each.method, **each.arguments) for each in contenders]
    keep, (share, why) = up_to(reference.t, reference.horizon), _compared(loaded, reference)
    for i, (each, traj) in enumerate(zip(contenders, trajectories, strict=True)):
        pairs = [(f"{named(each)} and truth", reference.states), *(
            (f"{named(other)} and {named(each)}", one)
            for other, one in zip(contenders[:i], trajectories, strict=False))]
        said = _Limits(loaded, reference, each, run or run_scene, keep).wrong(traj) if tol is None else next(filter(
            None, (_beyond(loaded, who, differences(traj, one), tol, reference.t, keep) for who, one in pairs)), "")
        if said:
            raise AssertionError(said)
    if share < need:
        raise AssertionError(f"unresolved: {loaded.name}: compared over {percent(share)} of its {loaded.duration:g} s, "
                             f"since {why}")


def _compared(scene: Scene, truth: Reference) -> tuple[float, str]:
    """The share of a scene's time over which a comparison with truth says something, and why not all of it."""
    if at_rest(scene, truth.states):
        return 0.0, "nothing moves, so that an engine which does nothing is right; give it a start that moves"
    return min(1.0, truth.horizon / scene.duration), f"truth ends there: {truth.horizon_cause or 'errors grow too far'}"


def named(way: Way) -> str:
    """A way in messages, with all that was asked for."""
    given = ", ".join(f"{key}={value!r}" for key, value in sorted(way.arguments.items()))
    return f"{way.engine} {way.method}" + (f" ({given})" if given else "")


def _checked(tol: object) -> dict[str, Tol] | None:
    """`tol` as a bound per quantity; None for the documented bounds."""
    if tol is None:
        return None
    if isinstance(tol, Mapping):
        unknown = [name for name in tol if name not in QUANTITIES]
        if unknown or not tol:
            raise ArgumentError(f"tol: {unknown[0] if unknown else tol!r} is not understood: give a bound for any of "
                                f"{', '.join(QUANTITIES)}")
        return {name: _bound(f"tol[{name!r}]", bound) for name, bound in tol.items()}
    return dict.fromkeys(QUANTITIES, _bound("tol", tol))


def _bound(name: str, value: Any) -> Tol:
    given = value.value if isinstance(value, Tol) else value
    number = isinstance(given, numbers.Real) and not isinstance(given, bool)
    if not number or not math.isfinite(given) or given < 0:
        raise ArgumentError(f"{name}: {value!r} is not understood: give a number that is not negative, "
                            "crosscheck.testing.agreement.Tol(value, why), a mapping of quantities to such, or None "
                            "for the limit of vanishing steps")
    return value if isinstance(value, Tol) else Tol(float(given), "given by the caller")


def contender(entry: Entry, scene: Scene, truth: Reference, step: float | None = None,
              rtol: float | None = None) -> Way:
    """An entry of `assert_agree`, completed by a method and by a step at which its uncertainty is small.

    Raises
    ------
    ArgumentError
        The entry is not understood, or its step would be too small.
    Unsupported
        No method of the engine can run the scene.
    """
    options: dict[str, Any] = {}
    if isinstance(entry, str):
        engine, method = adapters.split(entry)
    elif isinstance(entry, list | tuple) and 2 <= len(entry) <= 3:
        engine, method = entry[:2]
        given = entry[2] if len(entry) == 3 else {}
        if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
            raise ArgumentError(f"engines: {entry!r}: the options are a dictionary of arguments of crosscheck.run")
        options = dict(given)
    else:
        raise ArgumentError(f"engines: {entry!r} is not understood: give \"engine\", \"engine:method\" or "
                            "(engine, method, options)")
    adapter = adapters.get(engine)
    left_open = method is None or (isinstance(method, str) and not method)
    if left_open:
        method = best_method(adapter, scene)
    if not isinstance(method, str) or method not in adapter.methods:
        raise ArgumentError(f"engines: {engine} has no method {method!r}; it has {', '.join(adapter.methods)}")
    if "step" not in options and "rtol" not in options:
        order = adapter.documented_order(scene, RunSpec(method, step=1e-3, form=options.get("form")))
        if order is None:
            options["rtol"] = 1e-9 if rtol is None else rtol
        else:
            options["step"] = step if step is not None else _step(scene, truth, order)
            if step is None and scene.duration / options["step"] > MOST_STEPS:
                adaptive = [name for name in adapter.adaptive_methods if left_open and not
                            adapter.unsupported(scene, RunSpec(name, rtol=1e-9, form=options.get("form")))]
                if adaptive:
                    del options["step"]
                    return Way.of(engine, adaptive[-1], **(options | {"rtol": 1e-9}))
                raise ArgumentError(
                    f"{engine} {method} on scene {scene.name!r}: at a step where it is resolved, "
                    f"{options['step']:.2g} s, it would take {scene.duration / options['step']:.2g} steps, more than "
                    f"{MOST_STEPS:.0e}; name another method, a step, or a shorter duration")
    return Way.of(engine, method, **options)


def _step(scene: Scene, truth: Reference, order: int) -> float:
    """A step (s) at which the uncertainty of a method of this order, A T W (h W)^(p + 1), is `AIM`: W the fastest rate
    of the scene, A the growth of errors over its duration T."""
    rate = max(sizes(scene, truth.states)["angular velocity"], fastest(scene))
    grown = max(1.0, truth.amplification) * max(1.0, rate * scene.duration)
    return float(min((AIM / grown) ** (1 / (order + 1)) / rate, scene.duration / FEWEST))


class _Limits:
    """Where whole runs of one engine go as their steps or tolerances vanish."""

    def __init__(self, scene: Scene, truth: Reference, way: Way, run: Run, keep: np.ndarray) -> None:
        self.scene, self.truth, self.way, self.run, self.keep = scene, truth, way, run, keep
        self.engine = adapters.get(way.engine)
        spec = RunSpec(way.method, way.step, way.rtol, way.form)
        self.order = self.engine.documented_order(scene, spec)
        self.left = 0.0 if self.order is None else self.engine.iteration(scene, spec) / length_of(scene)
        self.key, self.own = ("rtol", way.rtol or 0.0) if self.order is None else ("step", way.step or 0.0)
        self.sizes = sizes(scene, truth.states)
        self.smooth = self.order is not None and not scene.has_laws and not truth.events
        self.dt = scene.duration / (scene.samples - 1)
        self.multiple = 1 if self.order is None else steps_per_sample(scene, self.dt)[0]
        self.rates = dict(zip(STATE, ("velocity", "angular velocity", "acceleration", "angular acceleration"),
                              strict=True))

    def wrong(self, traj: Any) -> str:
        """What fails or is unresolved, "" if nothing; finer runs are tried while `traj` is one of the three finest."""
        differences(traj, self.truth.states)  # raises where output times differ
        per = 0 if self.order is None else steps_per_sample(self.scene, self.own)[0]
        for fine in (False, True):
            numbers = counts(per, self.multiple, fine) if per else ()
            h = [self.dt / number for number in numbers] or [self.own * 10.0**(k - 2 * fine) for k in range(3)]
            mine = numbers.index(per) if per else 2 * fine
            try:
                runs = [traj if k == mine else self.at(size) for k, size in enumerate(h)]
                break
            except EngineError:  # it may fail at coarser steps
                if fine:
                    raise
        said, order = self.judged(h, runs, -math.inf)
        while said and mine < 2:
            h.insert(0, self.dt / finer(round(self.dt / h[0]), self.multiple) if per else h[0] / 10.0)
            runs.insert(0, self.at(h[0]))
            said, order = self.judged(h[:4], runs[:4], order)
            mine += 1
        return said

    def at(self, size: float) -> Any:
        """The run at another step (s) or tolerance."""
        return self.run(self.scene, self.way.engine, self.way.method, **(self.way.arguments | {self.key: size}))

    def judged(self, h: Sequence[float], runs: Sequence[Any], before: float) -> tuple[str, float]:
        """(what fails or is unresolved, "" if nothing; the observed order), which was `before` at larger steps."""
        rows = [{name: each[self.keep] for name, each in state_apart(one, self.truth.states).items()} for one in runs]
        rounding = [self.rounding(size, one) for size, one in zip(h, runs, strict=True)]
        who, sized, order = named(self.way), ", ".join(f"{size:.4g}" for size in h), math.inf
        if self.smooth:
            order = observed_order(h[:3], [scaled(each, self.sizes) for each in rows[:3]])
            order = max(order, 2 * order - before) if math.isfinite(before) else order
        if order < (self.order or 0) - MARGIN and any(differ([each[name] for each in rows[:3]], [
                each[name] for each in rounding[:3]], 0.0) for name in STATE):
            return (f"fail: {self.scene.name}: {who} converges with order {order:.3g}, documented {self.order}, at "
                    f"{self.key}s {sized}"), order
        for name in STATE:
            found = self.limit(name, h, [each[name] for each in rows], [each[name] for each in rounding], order)
            parts = dict(found.parts) | {"truth": SAFETY * self.truth.error * self.sizes[name]}
            bound = Tol(sum(parts.values()), f"the uncertainty of the limit from {self.key}s {sized}: " + ", ".join(
                f"{part} {value:.2g}" for part, value in parts.items() if value))
            said = _beyond(self.scene, f"{who} as its {self.key} vanishes and truth", {name: np.linalg.norm(
                found.value, axis=-1)}, {name: bound}, self.truth.t[self.keep], np.ones(len(rows[0][name]), bool))
            if not said and bound.value > RESOLVED * self.sizes[name]:
                said = (f"unresolved: {self.scene.name}: {who}: the limit of {name} is known to {bound.value:.3g} "
                        f"{QUANTITIES[name]}, more than {percent(RESOLVED)} of its size {self.sizes[name]:.3g} "
                        f"({bound.why}); give a smaller {self.key}, a shorter duration or tol=")
            if said:
                return said, order
        return "", order

    def limit(self, name: str, h: Sequence[float], answers: list[np.ndarray], rounding: list[float], order: float
              ) -> Limit:
        """Where one quantity goes, less truth."""
        if self.order is None:
            return spread_of_tolerances(answers, rounding[0])
        if self.smooth:
            return limit(h, answers, self.order, rounding, 0.0, order)
        late = self.truth.amplification * h[0] * self.sizes[self.rates[name]] if self.order < 2 else 0.0
        return index(h, answers, 1 if self.order < 2 else self.order, rounding[0], 0.0, late)

    def rounding(self, size: float, one: Any) -> dict[str, float]:
        """What rounding, and an iteration as declared, leave of a run at this step or tolerance, by quantity."""
        steps = one.steps if self.order is None else self.scene.duration / size
        grown, least = max(1.0, steps) * self.truth.amplification, grading(self.scene) * max(EPS, self.engine.eps)
        units = self.sizes | {"position": max(self.sizes["position"], float(np.abs(one.x).max(initial=0.0)))}
        lengths, rates = (length_of(self.scene), 1.0) * 2, (0, 0, 1, 1)
        return {name: grown * (least * units[name] + self.left * length / size**rate)
                for name, length, rate in zip(STATE, lengths, rates, strict=True)}


def _beyond(scene: Scene, who: str, gaps: Mapping[str, np.ndarray], bounds: Mapping[str, Tol], t: np.ndarray,
            keep: np.ndarray) -> str:
    """Where differences (T, n) exceed their bounds at the times `keep` of `t`; "" if nowhere."""
    for quantity, values in gaps.items():
        if quantity not in bounds:
            continue
        tol, unit = bounds[quantity], QUANTITIES[quantity]
        values = np.where(np.isfinite(values), values, np.inf)[keep]
        beyond = np.argwhere(~(values <= tol.value))
        if len(beyond):
            sample, body = np.unravel_index(int(np.argmax(values)), values.shape)
            return (f"fail: {scene.name}: {who} disagree in {quantity} by {values[sample, body]:.3g} {unit}, allowed "
                    f"{tol.value:.3g} {unit} ({tol.why}); first beyond it at t = {t[keep][beyond[0, 0]]:.6g} s, worst "
                    f"in body {scene.bodies[body].name!r} at t = {t[keep][sample]:.6g} s")
    return ""
