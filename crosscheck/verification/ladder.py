"""Ladders: the ways to integrate a scene, and the steps or tolerances of each way from coarse to fine.

A way is an engine, a method and a form. Truth has `INTERVALS` + 1 equally spaced times, which coincide with steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from crosscheck import adapters, references
from crosscheck.adapters.base import RunSpec
from crosscheck.compare.sizes import natural_time
from crosscheck.document import Way
from crosscheck.references.base import Reference
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

INTERVALS = 64
"""Number of sample intervals for the largest errors: a power of two, as step counts of ladders are, up to a factor 3.
"""

RTOLS = tuple(10.0**-power for power in range(1, 15))
"""Relative tolerances of the adaptive methods."""


class GradedWay(Way, frozen=True, kw_only=True):
    """A way without step or rtol, of which there is a ladder."""

    adaptive: bool = False
    order: int | None = None  # documented


def ways(scene: Scene, engines: Sequence[str], methods: Sequence[str] | None = None,
         default_form: bool = False, asked_map: str | None = None
         ) -> tuple[list[GradedWay], list[tuple[GradedWay, str]]]:
    """All ways to integrate the scene, and the unsupported combinations with their reasons.

    Parameters
    ----------
    engines : names for `crosscheck.adapters.get`
    methods : only these; None: all
    default_form : only the form that the engine chooses by itself; the `form` of a way is None then
    asked_map : coordinate map for the engines that have this option
    """
    possible, missing = [], []
    for name in engines:
        adapter = adapters.get(name)
        chart = adapter.takes_map(asked_map)
        forms = (None,) if default_form else adapter.forms or (None,)
        for form in forms:
            for method in adapter.methods:
                if methods is not None and method not in methods:
                    continue
                varies = method in adapter.adaptive_methods
                spec = RunSpec(method, None if varies else scene.duration / 64, RTOLS[0] if varies else None, form,
                               coordinate_map=chart)
                reason = adapter.unsupported(scene, spec)
                way = GradedWay(name, method, form=form, coordinate_map=chart, adaptive=varies,
                                order=None if reason else adapter.documented_order(scene, spec))
                if reason is None:
                    possible.append(way)
                else:
                    missing.append((way, reason))
    return possible, missing


def ladder(scene: Scene, way: GradedWay) -> Iterator[tuple[int | None, float]]:
    """(number of steps, step in s) of a fixed-step way, coarse to fine without end, or (None, rtol) of an adaptive one.

    The first step is about four natural times of the scene, and is divided by 3/2 and 4/3 in turn. For methods up to
    order 2 it is about one natural time and is halved, because errors of low order change less from step to step.
    """
    if way.adaptive:
        yield from ((None, rtol) for rtol in RTOLS)
        return
    low = way.order is not None and way.order <= 2
    natural = scene.duration / natural_time(scene) / (1 if low else 4)
    count = 2 ** max(1, math.floor(math.log2(max(natural, 1.0))))
    while True:
        yield count, scene.duration / count
        if not low:
            yield count * 3 // 2, scene.duration / (count * 3 // 2)
        count *= 2


def reference(scene: Scene) -> tuple[Scene, Reference]:
    """The scene, shortened to the horizon of its truth if necessary, and its truth at `INTERVALS` + 1 times.

    Raises `crosscheck.references.TruthError` or `Unsupported` for a scene without truth.
    """
    sampled = scene.replace(samples=INTERVALS + 1)
    truth = references.truth(sampled)
    if truth.horizon < scene.duration * (1 - 1e-12):
        sampled = sampled.replace(duration=float(np.floor(10 * truth.horizon) / 10) or truth.horizon)
        truth = references.truth(sampled)
    return sampled, truth


def thinned(states: States, intervals: int) -> States:
    """The states at `intervals` + 1 equally spaced times."""
    every = (len(states.t) - 1) // intervals
    return states.at(slice(None, None, every))
