"""Assertions for tests: engines agree with truth, and with each other, within justified bounds."""

from __future__ import annotations

import math
import numbers
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec
from crosscheck.compare.errors import differences, up_to
from crosscheck.document import QUANTITIES, Way
from crosscheck.document.outcomes import percent
from crosscheck.errors import ArgumentError
from crosscheck.judge import tolerances
from crosscheck.judge.plan import plan_from_truth
from crosscheck.judge.tolerances import Tol
from crosscheck.judge.verdict import judge_rest
from crosscheck.references.base import Reference
from crosscheck.running.arguments import best_method
from crosscheck.running.run import run as run_scene
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene

Entry = str | Sequence[Any]
Run = Callable[..., Any]

MOST_STEPS = 1e6
"""Most steps of a run whose step the test does not give; with any engine they take seconds."""


def assert_agree(scene: Scene | str | os.PathLike[str], engines: Entry | Sequence[Entry], tol: object = None, *,
                 step: float | None = None, rtol: float | None = None, need: float = 1.0, run: Run | None = None,
                 truth: Callable[[Scene], Reference] | None = None) -> None:
    """Assert that every engine agrees with the independent truth of a scene, and every two with each other.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    engines : one or several (in a list or tuple), each a name, "engine:method", or a tuple or list (engine, method) or
        (engine, method, options), where options is a dictionary of arguments of `crosscheck.run`, such as
        {"step": 1e-3, "form": "tree"}. Without a method the engine's last one of the highest documented order is used.
    tol : a number or Tol for every quantity in its SI unit, or a mapping from quantities ("position", "attitude",
        "velocity", "angular velocity") to numbers or Tol; quantities not in it are not compared. By default the bounds
        of `crosscheck.judge.tolerances` apply, A T h^p max|y^(p+1)| with the documented order p of each engine. Two
        engines may differ by the larger of their bounds: the error constants of two methods differ by less than one.
    step, rtol : for engines whose options give neither; by default a step is chosen with which the bounds can judge
    need : share of the scene's time over which the comparison with truth has to reach
    run, truth : replace `crosscheck.run` and `crosscheck.truth`, for example by fixtures that run each engine only once

    Raises
    ------
    AssertionError
        Begins with the outcome: "fail" names quantity, bound, reason, first time of violation and worst body,
        "unresolved" the share of the time that was compared.
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
    bounds = [_documented_bounds(loaded, reference, each, traj) if tol is None else tol
              for each, traj in zip(contenders, trajectories, strict=True)]
    keep, (share, why) = up_to(reference.t, reference.horizon), _compared(loaded, reference)
    for each, traj, allowed in zip(contenders, trajectories, bounds, strict=True):
        _compare(loaded, f"{named(each)} and truth", traj, reference.states, allowed, keep)
    for i in range(len(contenders)):
        for j in range(i):
            # Not the sum of both bounds: the comparisons with truth imply that one, so it could never fail.
            larger = {name: max(bounds[i][name], bounds[j][name], key=lambda tol: tol.value) for name in bounds[i]}
            _compare(loaded, f"{named(contenders[j])} and {named(contenders[i])}", trajectories[j], trajectories[i],
                     larger, keep)
    if share < need:
        raise AssertionError(f"unresolved: {loaded.name}: compared over {percent(share)} of its {loaded.duration:g} s, "
                             f"since {why}")


def _compared(scene: Scene, truth: Reference) -> tuple[float, str]:
    """The share of a scene's time over which a comparison with truth says something, and why not all of it."""
    if judge_rest(scene, truth):
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
                            "crosscheck.judge.tolerances.Tol(value, why), a mapping of quantities to such, or None for "
                            "the bounds of the documented order")
    return value if isinstance(value, Tol) else Tol(float(given), "given by the caller")


def contender(entry: Entry, scene: Scene, truth: Reference, step: float | None = None,
              rtol: float | None = None) -> Way:
    """An entry of `assert_agree`, completed by a method and by a step with which the bounds can judge.

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
            options["step"] = step if step is not None else plan_from_truth(scene, truth).steps[
                max(key for key in (1, 2, 4, 6, 8) if key <= order)]
            if step is None and scene.duration / options["step"] > MOST_STEPS:
                adaptive = [name for name in adapter.adaptive_methods if left_open and not
                            adapter.unsupported(scene, RunSpec(name, rtol=1e-9, form=options.get("form")))]
                if adaptive:
                    del options["step"]
                    return Way.of(engine, adaptive[-1], **(options | {"rtol": 1e-9}))
                raise ArgumentError(
                    f"{engine} {method} on scene {scene.name!r}: at the step where its bounds judge, "
                    f"{options['step']:.2g} s, it would take {scene.duration / options['step']:.2g} steps, more than "
                    f"{MOST_STEPS:.0e}; name another method, a step, or a shorter duration")
    return Way.of(engine, method, **options)


def _documented_bounds(scene: Scene, truth: Reference, each: Way, traj: Any) -> dict[str, Tol]:
    spec = RunSpec(each.method, each.step, each.rtol, each.form)
    order = adapters.get(each.engine).documented_order(scene, spec)
    if order is None or spec.step is None:
        assert each.rtol is not None  # `contender` gives a step or a tolerance
        return tolerances.adaptive(scene, truth, each.rtol, traj.steps)
    bounds = tolerances.fixed_step(scene, truth, order, traj.stats.get("step") or spec.step)
    empty = tolerances.vacuous(scene, truth, bounds) & set(QUANTITIES)
    if empty:
        raise ArgumentError(f"{named(each)} on {scene.name!r}: at this step the bound of the {min(empty)} exceeds the "
                            "size of the motion and would pass anything; give a smaller step, a shorter duration or "
                            "tol=")
    return bounds


def _compare(scene: Scene, who: str, one: Any, other: Any, bounds: Mapping[str, Tol], keep: np.ndarray) -> None:
    __tracebackhide__ = True
    for quantity, values in differences(one, other).items():
        if quantity not in bounds:
            continue
        tol, unit = bounds[quantity], QUANTITIES[quantity]
        values = np.where(np.isfinite(values), values, np.inf)[keep]
        beyond = np.argwhere(~(values <= tol.value))
        if len(beyond) == 0:
            continue
        first = one.t[beyond[0, 0]]
        sample, body = np.unravel_index(int(np.argmax(values)), values.shape)
        raise AssertionError(
            f"fail: {scene.name}: {who} disagree in {quantity} by {values[sample, body]:.3g} {unit}, allowed "
            f"{tol.value:.3g} {unit} ({tol.why}); first beyond it at t = {first:.6g} s, worst in body "
            f"{scene.bodies[body].name!r} at t = {one.t[sample]:.6g} s")
