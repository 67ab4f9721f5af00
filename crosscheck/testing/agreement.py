"""Assertions for tests: engines come to the truth, and agree with it and each other within tolerances of the user."""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec
from crosscheck.compare.errors import differences, up_to
from crosscheck.compare.sizes import at_rest
from crosscheck.document import QUANTITIES, Record, Way
from crosscheck.document.outcomes import percent
from crosscheck.errors import ArgumentError
from crosscheck.references.base import Reference
from crosscheck.running.arguments import best_method
from crosscheck.running.run import run as run_scene
from crosscheck.scene import file as scene_file
from crosscheck.scene.model import Scene
from crosscheck.verification.cell import judge_alone
from crosscheck.verification.plan import PROFILES, plan_of

Entry = str | Sequence[Any]
Run = Callable[..., Any]


@dataclasses.dataclass(frozen=True)
class Tol:
    """A tolerance and the reason for it."""

    value: float
    why: str


def assert_agree(scene: Scene | str | os.PathLike[str], engines: Entry | Sequence[Entry], tol: object = None, *,
                 step: float | None = None, rtol: float | None = None, need: float = 1.0, run: Run | None = None,
                 truth: Callable[[Scene], Reference] | None = None) -> list[Record]:
    """Assert that every engine agrees with the independent truth of a scene.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    engines : one or several (in a list or tuple), each a name, "engine:method", or a tuple or list (engine, method) or
        (engine, method, options), where options is a dictionary of arguments of `crosscheck.run`, such as
        {"step": 1e-3, "form": "tree"}. Without a method the engine's last one of the highest documented order is used.
    tol : a number or Tol for every quantity in its SI unit, or a mapping from quantities ("position", "attitude",
        "velocity", "angular velocity") to numbers or Tol; quantities not in it are not compared. Every two engines are
        compared by it, too. By default each engine gets its verdict by solution verification, as of `crosscheck verify`
    step, rtol : for engines whose options give neither; by default those of the plan of `crosscheck verify`
    need : share of the scene's time over which the comparison has to be resolved, or with `tol` to reach
    run, truth : replace `crosscheck.run` and `crosscheck.truth`, for example by fixtures that run each engine only once

    Returns
    -------
    list[Record]
        The verdicts, empty with `tol`. One may be "known".

    Raises
    ------
    AssertionError
        Begins with the outcome: "fail" names quantity, value, allowance and place, "unresolved" the share of the time.
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
    if tol is None:
        return list(map(functools.partial(_judged, loaded, need=need), contenders, trajectories))
    keep, (share, why) = up_to(reference.t, reference.horizon), _compared(loaded, reference)
    for k, (each, traj) in enumerate(zip(contenders, trajectories, strict=True)):
        _compare(loaded, f"{named(each)} and truth", traj, reference.states, tol, keep)
        for other, its in zip(contenders[:k], trajectories, strict=False):
            _compare(loaded, f"{named(other)} and {named(each)}", its, traj, tol, keep)
    if share < need:
        raise AssertionError(f"unresolved: {loaded.name}: compared over {percent(share)} of its {loaded.duration:g} s, "
                             f"since {why}")
    return []


def _judged(scene: Scene, way: Way, traj: Any, need: float) -> Record:
    __tracebackhide__ = True
    record = judge_alone(scene.name, traj, way.engine, need=need, **way.arguments)
    assert record is not None  # `contender` gives a step or a tolerance
    if record.outcome not in ("pass", "known"):
        found = record.worst
        why = record.message if found is None or record.outcome != "fail" else (
            f"{found.kind} {found.value:.3g} {found.unit}, allowed {found.bound:.3g} {found.unit} ({found.why}); "
            f"{found.detail}" if found.value is not None and found.bound is not None else found.detail or found.why)
        raise AssertionError(f"{record.outcome}: {scene.name}: {named(way)}: {why} ({record.code})")
    return record


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
    """`tol` as a tolerance per quantity; None for the verdict."""
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
                            "for the verdict of crosscheck verify")
    return value if isinstance(value, Tol) else Tol(float(given), "given by the caller")


def contender(entry: Entry, scene: Scene, truth: Reference, step: float | None = None,
              rtol: float | None = None) -> Way:
    """An entry of `assert_agree`, completed by a method and by a step.

    Raises
    ------
    ArgumentError
        The entry is not understood.
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
    if method is None or (isinstance(method, str) and not method):
        method = best_method(adapter, scene)
    if not isinstance(method, str) or method not in adapter.methods:
        raise ArgumentError(f"engines: {engine} has no method {method!r}; it has {', '.join(adapter.methods)}")
    if "step" not in options and "rtol" not in options:
        order = adapter.documented_order(scene, RunSpec(method, step=1e-3, form=options.get("form")))
        if order is None:
            options["rtol"] = 1e-9 if rtol is None else rtol
        else:
            options["step"] = step if step is not None else plan_of(
                scene, truth.states, PROFILES["default"].most_steps).step(order)
    return Way.of(engine, method, **options)


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
