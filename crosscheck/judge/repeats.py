"""Whether an engine, started again at states of its own run, does the same again.

A run says nothing of itself that is not seen here: what it does at a state may not depend on the time, on the way that
led there, on the names and places of things, or on how the world is turned. Two runs from one state in two worlds
differ by rounding, grown as errors grow. A method that remembers more than the state, or that prefers an axis of the
world, differs by a part of its own errors; these it may have.
"""

from __future__ import annotations

import itertools

import numpy as np

from crosscheck.compare.errors import differences
from crosscheck.document import QUANTITIES, Finding
from crosscheck.judge.claim import Trace
from crosscheck.judge.defects import Defects
from crosscheck.judge.flow import Answer
from crosscheck.judge.tolerances import EPS
from crosscheck.scene.states import States

ROUNDINGS = 1e4
"""Times the rounding of an interval by which two runs may differ where they are the same otherwise: conversions at a
start lose digits, and iterations end at others. It is far below every error that matters."""

SAME = 0.5
"""Share of the parts in which two runs have to agree to rounding, so that they have to in all others."""

GROWTH = 30.0
"""Largest exponent of growth within a part."""

JUMP = 4.0
"""Times the distance between a run and the state with closed joints, in which a part of it begins: it is measured in a
norm of its own, and joints that are open move on."""

DECLARED = 100.0
"""An engine's numbers are believed to be so many times coarser than two runs from one state differ; and it prefers axes
if these differ by more roundings in two worlds."""


def seen_eps(traj: Trace, repeat: Answer, units: dict[str, float], said: float, most: float) -> float:
    """The spacing of an engine's numbers: as it says, but no more than two runs from one state show, or `most`.

    `units` are the sizes of the quantities. The median over the parts counts, so that a mistake that begins late does
    not.
    """
    gaps = differences(traj, repeat.traj)
    shown = np.max([gaps[name].max(axis=1)[repeat.firsts] / units[name] for name in QUANTITIES], axis=0)
    return float(min(said, most, max(EPS, DECLARED * float(np.median(shown)))))


SHOWN = 30.0
"""Times the rounding that two runs show in an interval, which the rounding of coarser numbers may be there: parts of it
are the same in both worlds."""


def shown_floor(traj: Trace, repeat: Answer, own: Defects) -> float:
    """The share of the floor of an engine with coarser numbers that its rounding takes: two worlds differ by it."""
    if own.claim.eps <= EPS or not repeat.turned or len(own.flow.index) < len(traj.t) - 1:
        return 1.0
    gaps, after = differences(traj, repeat.traj), repeat.firsts
    shown = np.max([gaps[name].max(axis=1)[after] / own.floor[name][after - 1] for name in QUANTITIES], axis=0)
    return float(min(1.0, SHOWN * float(np.median(shown))))


def judge_repeat(traj: Trace, repeat: Answer, own: Defects, soft: bool = False, between: float = 0.0
                 ) -> tuple[list[Finding], bool]:
    """The finding on the largest difference over its bound, and whether the engine remembers nothing but the state.

    One with `soft` laws remembers how far what holds its joints is bent, and one that interpolates is off by `between`
    at every sample, in y. There is no finding if the run has intervals that are not measured.
    """
    count = len(traj.t) - 1
    if len(own.flow.index) != count:
        return [], False
    gaps = {name: values.max(axis=1)[1:] for name, values in differences(traj, repeat.traj).items()}
    units = own.scale.units
    rounding = np.max([own.floor[name] / units[name] for name in QUANTITIES], axis=0)
    method = np.max([own.bounds[name] / units[name] for name in QUANTITIES], axis=0)
    jumps = differences(repeat.begins, States(*(getattr(traj, name)[repeat.marks[:-1]] for name in "txRvw")))
    begun = JUMP * (np.max([jumps[name].max(axis=1) / units[name] for name in QUANTITIES], axis=0)
                    + _unknown(own, repeat) + between)
    # A method of order 1 that takes an event at the end of a step may take it one step later by rounding.
    decided = np.where(own.flow.eventful & (own.claim.order == 1), method, 0.0)
    rounded, exact, missed = (_added(own, repeat, begun, each) for each in (
        rounding, np.maximum(ROUNDINGS * rounding, decided), method))
    seen = np.where(own.flow.regular, 1.0, 0.0)
    ratio = np.max([gaps[name] / units[name] for name in QUANTITIES], axis=0)
    ratio = np.where(np.isfinite(ratio), ratio, np.inf)
    parts = [slice(repeat.marks[k], repeat.marks[k + 1]) for k in repeat.ran]
    same = 0.0 if soft else float(np.mean([bool((ratio[part] * seen[part] <= rounded[part]).all()) for part in parts]))
    bound = exact if same >= SAME else np.maximum(exact, missed)
    over = {name: gaps[name] / units[name] * seen / bound for name in QUANTITIES}
    name = max(QUANTITIES, key=lambda each: float(np.nan_to_num(over[each], nan=np.inf).max()))
    at = int(np.argmax(np.nan_to_num(over[name], nan=np.inf)))
    value, most = float(gaps[name][at]), float(bound[at] * units[name])
    where = "in a turned and shifted world, renamed and reordered" if repeat.turned else (
        "in a shifted world, renamed and reordered")
    why = f"the run once more from its own states, {where}: "
    why += ("rounding, grown as errors grow" if same >= SAME else
            f"it differs by more than rounding in {100 * (1 - same):.0f} % of its parts, as a method does that "
            "remembers more than the state, chooses its steps, or prefers an axis; no more than its errors may be")
    finding = Finding("repeat", "ok" if value <= most else "fail", value, most, QUANTITIES[name], why,
                      f"{name}, t = {traj.t[at + 1]:.4g} s" + "".join(
                          f"; {len(repeat.failed)} parts did not run: {why}" for why in [*repeat.failed.values()][:1]))
    return [finding], bool(same >= SAME)


def judge_axes(turned: Answer, plain: Answer, own: Defects) -> list[Finding]:
    """The finding that an engine prefers axes of the world: from the same states it does otherwise in a turned one.

    None if both are the same in most parts. Errors of such an engine differ from start to start.
    """
    units = own.scale.units
    gaps = {name: each.max(axis=1)[1:] / units[name] for name, each in differences(plain.traj, turned.traj).items()}
    rounding = DECLARED * np.max([own.floor[name] / units[name] for name in QUANTITIES], axis=0)
    bound = _added(own, plain, 0.0 * plain.begins.t, rounding)
    over = np.max(list(gaps.values()), axis=0) * own.flow.regular / bound
    parts = itertools.pairwise(plain.marks.tolist())
    if np.mean([bool(np.nanmax(over[first:last]) <= 1.0) for first, last in parts]) >= SAME:
        return []
    name = max(gaps, key=lambda each: float(np.nanmax(gaps[each])))
    at = int(np.nanargmax(gaps[name]))
    value = float(gaps[name][at] * units[name])
    return [Finding("axes", "ok", value, None, QUANTITIES[name], "the engine prefers axes of the world, as angles "
                    "do and steps that are chosen by single components: from the same states it moves otherwise where "
                    "the world is turned", f"{name}, t = {plain.traj.t[at + 1]:.4g} s")]


def _unknown(own: Defects, repeat: Answer) -> np.ndarray:
    """(P,) errors of parts that begin with values of sampled servos which are not known to be those of the run."""
    crossed, marks = own.flow.crossed, repeat.marks[:-1]
    if crossed is None:
        return np.zeros(len(marks))
    missed = np.max([np.linalg.norm(own.vectors[name], axis=-1).max(axis=1) / unit
                     for name, unit in own.scale.units.items()], axis=0)
    return np.array([crossed.unknown(k, mode, missed, own.scale.rate)
                     for k, mode in zip(marks.tolist(), repeat.memory, strict=True)])


def _added(own: Defects, repeat: Answer, begun: np.ndarray, each: np.ndarray) -> np.ndarray:
    """(I,) what errors of starts, (P,), and of intervals, (I,), add up to in a part, grown as errors grow."""
    exponent = np.minimum(own.flow.rate * own.flow.tau, GROWTH)
    added, total, left = np.zeros(len(each)), 0.0, GROWTH
    starts = dict(zip(repeat.marks[:-1].tolist(), begun.tolist(), strict=True))
    for k, size in enumerate(each):
        if k in starts:
            total, left = starts[k], own.most_growth
        grown = min(float(exponent[k]), left)
        left -= grown
        total = total * float(np.exp(grown)) + float(size)
        added[k] = total
    return added
