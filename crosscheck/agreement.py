"""Assertions for tests: engines agree with truth, and with each other, within bounds that have reasons."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from crosscheck import tolerances
from crosscheck.errors import ArgumentError
from crosscheck.metrics import QUANTITIES, differences
from crosscheck.references.base import Reference
from crosscheck.scene import Scene
from crosscheck.tolerances import Tol

Entry = str | tuple[Any, ...]
Run = Callable[..., Any]


@dataclasses.dataclass(frozen=True)
class Contender:
    """One engine as `assert_agree` runs it."""

    engine: str
    method: str
    options: tuple[tuple[str, Any], ...]  # arguments of `crosscheck.run`, sorted

    @property
    def label(self) -> str:
        """How a message names it."""
        given = ", ".join(f"{key}={value!r}" for key, value in self.options)
        return f"{self.engine} {self.method}" + (f" ({given})" if given else "")


def assert_agree(scene: Scene | str, engines: Sequence[Entry], tol: Any = None, *, step: float | None = None,
                 rtol: float | None = None, run: Run | None = None,
                 truth: Callable[[Scene], Reference] | None = None) -> None:
    """Assert that every engine agrees with the independent truth of a scene, and every two with each other.

    Parameters
    ----------
    scene : a Scene, a built-in name or a path
    engines : each a name, "engine:method", or (engine, method) or (engine, method, options), options a dictionary of
        arguments of `crosscheck.run`, say {"step": 1e-3, "form": "tree"}. Without a method: the engine's last of the
        highest documented order.
    tol : Tol, or a mapping from quantities ("position", "attitude", "velocity", "angular velocity") to Tol; None takes
        the bounds of `crosscheck.tolerances`, A T h^p max|y^(p+1)| with p documented, per engine. Two engines may
        differ by the larger of their bounds: the principal error constants of two methods differ by less than one.
    step, rtol : for engines whose options give neither; without any of them a step is chosen such that the bounds judge
    run, truth : what runs and what knows the truth; the fixtures of the pytest plugin, to run each engine only once

    Raises
    ------
    AssertionError
        Names quantity, bound, reason, first time of violation and worst body.
    ArgumentError, SceneError, Unsupported, EngineError
        As `crosscheck.run`.
    """
    from crosscheck import references, running, scene_file

    if not engines:
        raise ArgumentError("engines: at least one is needed")
    loaded = scene_file.load_scene(scene) if isinstance(scene, str) else scene
    reference = (truth or references.truth)(loaded)
    contenders = [_contender(entry, loaded, reference, step, rtol) for entry in engines]
    trajectories = [(run or running.run)(loaded, each.engine, each.method, **dict(each.options)) for each in contenders]
    bounds = [_bounds(loaded, reference, each, traj, tol) for each, traj in zip(contenders, trajectories, strict=True)]
    keep = reference.t <= reference.horizon * (1 + 1e-12)
    for each, traj, allowed in zip(contenders, trajectories, bounds, strict=True):
        _compare(loaded, f"{each.label} and truth", traj, reference.states, allowed, keep)
    for i in range(len(contenders)):
        for j in range(i):
            # Not the sum: that would follow from the comparisons with truth and could never fail.
            larger = {name: max(bounds[i][name], bounds[j][name], key=lambda tol: tol.value) for name in bounds[i]}
            _compare(loaded, f"{contenders[j].label} and {contenders[i].label}", trajectories[j], trajectories[i],
                     larger, keep)


def _contender(entry: Entry, scene: Scene, truth: Reference, step: float | None, rtol: float | None) -> Contender:
    from crosscheck import engines
    from crosscheck.engines.base import RunSpec

    options: dict[str, Any] = {}
    if isinstance(entry, str):
        engine, _, method = entry.partition(":")
    elif isinstance(entry, tuple) and 2 <= len(entry) <= 3:
        engine, method = entry[:2]
        options = dict(entry[2]) if len(entry) == 3 else {}
    else:
        raise ArgumentError(f"engines: {entry!r} is not understood: give \"engine\", \"engine:method\" or "
                            "(engine, method, options)")
    adapter = engines.get(engine)
    method = method or _best_method(adapter, scene)
    if method not in adapter.methods:
        raise ArgumentError(f"engines: {engine} has no method {method!r}; it has {', '.join(adapter.methods)}")
    if "step" not in options and "rtol" not in options:
        order = adapter.documented_order(scene, RunSpec(method, step=1e-3, form=options.get("form")))
        if order is None:
            options["rtol"] = rtol or 1e-9
        else:
            options["step"] = step or _judgeable_step(scene, truth, order)
    return Contender(engine, method, tuple(sorted(options.items())))


def _best_method(adapter: Any, scene: Scene) -> str:
    """The last method of the highest documented order that the engine can run on this scene."""
    from crosscheck.engines.base import RunSpec

    specs = [RunSpec(method, step=1e-3) for method in adapter.methods]
    usable = [(adapter.documented_order(scene, spec) or 0, index) for index, spec in enumerate(specs)
              if adapter.unsupported(scene, spec) is None]
    if not usable:
        from crosscheck.errors import Unsupported

        raise Unsupported(f"{adapter.name}: {adapter.unsupported(scene, specs[0])}")
    return adapter.methods[max(usable)[1]]


def _judgeable_step(scene: Scene, truth: Reference, order: int) -> float:
    from crosscheck.studies.plan import plan_from_truth

    return plan_from_truth(scene, truth).steps[max(key for key in (1, 2, 4, 6, 8) if key <= order)]


def _bounds(scene: Scene, truth: Reference, each: Contender, traj: Any, tol: Any) -> dict[str, Tol]:
    if isinstance(tol, Tol):
        return dict.fromkeys(QUANTITIES, tol)
    if isinstance(tol, Mapping):
        unknown = [name for name, bound in tol.items() if name not in QUANTITIES or not isinstance(bound, Tol)]
        if unknown:
            raise ArgumentError(f"tol: {unknown[0]!r} is not understood: give a Tol for any of {', '.join(QUANTITIES)}")
        return dict(tol)
    if tol is not None:
        raise ArgumentError(f"tol: {tol!r} has no reason: give crosscheck.tolerances.Tol(value, why), a mapping of "
                            "quantities to such, or None for the bounds of the documented order")
    return _documented_bounds(scene, truth, each, traj)


def _documented_bounds(scene: Scene, truth: Reference, each: Contender, traj: Any) -> dict[str, Tol]:
    from crosscheck import engines
    from crosscheck.engines.base import RunSpec

    given = dict(each.options)
    spec = RunSpec(each.method, given.get("step"), given.get("rtol"), given.get("form"))
    order = engines.get(each.engine).documented_order(scene, spec)
    if order is None or spec.step is None:
        return tolerances.adaptive(scene, truth, given["rtol"], traj.steps)
    bounds = tolerances.fixed_step(scene, truth, order, traj.stats.get("step") or spec.step)
    empty = tolerances.vacuous(scene, truth, bounds) & set(QUANTITIES)
    if empty:
        raise ArgumentError(f"{each.label} on {scene.name!r}: at this step the bound of the {min(empty)} exceeds the "
                            "size of the motion and would pass anything; give a smaller step, a shorter duration or "
                            "tol=")
    return bounds


def _compare(scene: Scene, who: str, one: Any, other: Any, bounds: Mapping[str, Tol], keep: np.ndarray) -> None:
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
            f"{scene.name}: {who} disagree in {quantity} by {values[sample, body]:.3g} {unit}, allowed {tol.value:.3g} "
            f"{unit} ({tol.why}); first beyond it at t = {first:.6g} s, worst in body {scene.bodies[body].name!r} at "
            f"t = {one.t[sample]:.6g} s")
