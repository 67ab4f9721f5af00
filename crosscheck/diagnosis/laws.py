"""Three answers about friction, stops and servos in an engine: does it converge, to which law, how far apart.

Most engines have laws of their own, and converge to those. A law that an engine documents is integrated without the
engine (`Engine.own_law`), so that the engine can pass its own documentation and the user reads what it means.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import Engine, RunSpec
from crosscheck.compare.sizes import at_rest
from crosscheck.errors import ArgumentError, Unsupported
from crosscheck.references.base import TruthError
from crosscheck.running.run import run, truth
from crosscheck.scene.coordinates import histories
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion, States

LEVELS, COARSEST = 4, 1000
"""Runs with halved steps, and the number of steps of the first."""

REMAINING, NEAR = 2.0, 3.0
"""What is left of the error at the smallest step, in last differences (one at order 1, more where events fall between
steps); and how many times that a limit may be from a law that it is."""


SAME = 1e-11
"""Two laws that are no farther apart (rad or m) are the same on a scene."""


@dataclasses.dataclass(frozen=True)
class Gap:
    """The largest difference of a joint coordinate between two motions."""

    size: float  # rad or m
    joint: str
    t: float  # s
    position: float  # m, the largest difference of a centre of mass

    def __str__(self) -> str:
        return f"{self.size:.3e} rad or m (joint {self.joint!r} at {self.t:.4g} s; {self.position:.2e} m in positions)"


@dataclasses.dataclass(frozen=True)
class Way:
    """The runs of one setting: their steps, their changes from step to step, and their distances from the laws."""

    setting: str
    steps: tuple[float, ...]
    changes: tuple[float, ...]  # rad or m, between successive steps
    to_scene: tuple[Gap, ...]  # per step; empty without truth
    to_own: tuple[Gap, ...]  # empty where the engine documents no law of its own
    wall_time: float  # s, of the smallest step

    @property
    def order(self) -> float:
        """The order at which the changes fall."""
        first, last = self.changes[0], self.changes[-1]
        return math.inf if last == 0 else math.log2(first / last) / (len(self.changes) - 1) if first else 0.0

    @property
    def remaining(self) -> float:
        """What the motion may still change by as the step falls on.

        Steps that meet an event at the same time differ by less than what is left: the change before counts as well.
        """
        return REMAINING * max(self.changes[-1], self.changes[-2] / 4)

    @property
    def converges(self) -> bool:
        """Whether the changes fall at least at half an order, or are at rounding."""
        return self.order > 0.5 or self.changes[-1] < 1e-12

    def limit(self) -> str | None:
        """Which law it converges to: "the scene's", "its own", "both", "neither"; None if it does not or none is known.
        """
        if not self.converges or not (self.to_scene or self.to_own):
            return None
        reach = NEAR * self.remaining + SAME
        near = [name for name, gaps in (("the scene's", self.to_scene), ("its own", self.to_own))
                if gaps and gaps[-1].size <= reach]
        return "both" if len(near) == 2 else near[0] if near else "neither"


@dataclasses.dataclass(frozen=True)
class LawAnswers:
    """The three answers for one engine and method."""

    title: str  # scene, engine and method
    way: Way
    apart: Gap | None  # of the scene's law and the engine's own
    nearest: Way | None  # the setting that comes nearest to the scene's law
    without: str  # why there is no truth; empty if there is

    @property
    def limit(self) -> str | None:
        """As `Way.limit`, but "undecided" where the steps leave more open than the two laws are apart."""
        told = self.way.limit()
        return "undecided" if told == "both" and self.apart is not None and self.apart.size > SAME else told

    def __str__(self) -> str:
        way = self.way
        lines = [f"{self.title}, {way.setting}, steps {way.steps[0]:g} to "
                 f"{way.steps[-1]:g} s"]
        changes = ", ".join(f"{change:.1e}" for change in way.changes)
        lines.append(f"does it converge: {'yes' if way.converges else 'no'}; halving the step changes joints by "
                     f"{changes} rad or m, order {way.order:.2f}")
        told = [f"motion by {name} law is off at the smallest step by {gaps[-1]}" for name, gaps in (
            ("the scene's", way.to_scene), ("its own documented", way.to_own)) if gaps]
        limit = self.limit or ("to none, it does not converge" if not way.converges else "not known")
        if limit == "undecided":
            limit += f", these steps may still change it by {NEAR * way.remaining:.1e}; take a smaller --step"
        without = [self.without] if self.without else []
        lines.append("; ".join([f"to which law does it come: {limit}", *told, *without]))
        lines.append("how far apart are the two: " + ("not known" if self.apart is None else str(self.apart)))
        return "\n".join([*lines, *([f"nearest setting: {self.price}"] if self.price else [])])

    @property
    def price(self) -> str:
        """The setting that comes nearest to the scene's law, its distance and what it costs; "" if there is no other.
        """
        other = self.nearest
        return "" if other is None or not other.to_scene else (
            f"{other.setting}, {other.to_scene[-1].size:.2e} from the scene's law at the smallest step, order "
            f"{other.order:.2f}, for {other.wall_time / self.way.wall_time:.1f} times the time")


def which_law(scene: Scene, engine: str, method: str | None = None, step: float | None = None,
              softness: str | None = None, form: str | None = None) -> LawAnswers:
    """Whether an engine converges on a scene, to which law of friction, stops and servos, and how far apart these are.

    Parameters
    ----------
    method
        Default: the engine's last one that takes a step and can run the scene.
    step
        The first and largest of four, s, each half the one before; default: a thousandth of the duration.
    softness
        Of MuJoCo's constraints; default: MuJoCo's own, whose law is documented.

    Raises
    ------
    Unsupported
        The engine cannot model the scene, or nothing moves in it.
    ArgumentError
        The engine or method is unknown, or the method takes no step.
    """
    adapter = adapters.get(engine)
    methods = adapter.fixed_step_methods[::-1]
    method = method or next((each for each in methods if not adapter.unsupported(scene, RunSpec(
        each, step or scene.duration / COARSEST, form=form))), methods[0])
    if method not in adapter.fixed_step_methods:
        raise ArgumentError(f"method: {method!r} of {engine} takes no fixed step; write one of "
                            f"{', '.join(adapter.fixed_step_methods)}")
    if softness is None and "softness" in adapter.options:
        softness = "default"
    exact, without = _truth(scene)
    spec = RunSpec(method, step or scene.duration / COARSEST, form=form, softness=softness)
    own = _own(adapter, scene, spec)
    way = _halved(scene, engine, spec, exact, own)
    apart = None if own is None or exact is None else gap(scene, own, exact)
    other = adapter.nearest_law(scene, spec)
    return LawAnswers(f"{scene.name}, {engine} {method}", way, apart,
                      None if other is None else _halved(scene, engine, other, exact, None), without)


def _truth(scene: Scene) -> tuple[States | None, str]:
    try:
        exact = truth(scene)
    except (Unsupported, TruthError) as error:
        return None, f"no truth of the scene's law: {error}"
    if at_rest(scene, exact.states):
        raise Unsupported(f"{scene.name}: nothing moves in it, so that no law shows; let it start in motion, a model "
                          "file by crosscheck convert FILE --start random -o SCENE.toml")
    return exact.states, ""


def _own(adapter: Engine, scene: Scene, spec: RunSpec) -> States | None:
    try:
        law: States | None = adapter.own_law(scene, spec)
        return law
    except Unsupported:
        return None


def _halved(scene: Scene, engine: str, spec: RunSpec, exact: States | None, own: States | None) -> Way:
    assert spec.step is not None
    steps = tuple(spec.step / 2**level for level in range(LEVELS))
    options: dict[str, Any] = {key: value for key, value in (("softness", spec.softness), ("form", spec.form))
                               if value is not None}
    runs = [run(scene, engine, spec.method, step, monitor=False, **options) for step in steps]
    to = functools.partial(_gaps, scene, runs)
    words = adapters.get(engine).own_words(dataclasses.replace(spec, step=steps[-1]))
    setting = ", ".join(f"{key} {value}" for key, value in options.items()) or "its only setting"
    return Way(f"{setting} ({words})" if words else setting,
               tuple(float(each.stats["step"] or 0.0) for each in runs),
               tuple(gap(scene, *pair).size for pair in itertools.pairwise(runs)), to(exact), to(own),
               runs[-1].wall_time)


def _gaps(scene: Scene, runs: Sequence[Motion], law: States | None) -> tuple[Gap, ...]:
    return () if law is None else tuple(gap(scene, each, law) for each in runs)


def gap(scene: Scene, one: Motion, other: Motion) -> Gap:
    """The largest difference of a joint coordinate between two motions, at the times that both have.

    Truth is NaN after a monitor has ended the scene; nothing is compared from there on.
    """
    count, worst = min(len(one.t), len(other.t)), Gap(0.0, "", 0.0, 0.0)
    known = np.isfinite(one.x[:count]).all(axis=(1, 2)) & np.isfinite(other.x[:count]).all(axis=(1, 2))
    count = int(np.argmin([*known, False]))
    first, second = histories(scene, one), histories(scene, other)
    position = float(np.linalg.norm(one.x[:count] - other.x[:count], axis=-1).max(initial=0.0))
    for name, history in first.items():
        difference = np.abs(history.position[:count] - second[name].position[:count]).reshape(count, -1).max(axis=1)
        if (size := float(difference.max())) >= worst.size:
            worst = Gap(size, name, float(one.t[int(difference.argmax())]), position)
    return worst
