"""The verdict on one run: findings that compare values with bounds and their reasons, and one outcome.

The outcomes are those of `crosscheck.document.outcomes`. A run is "unresolved" if nothing failed, but its motion was
judged over less of its time than was asked for: there is no truth, nothing moves, or no bound reaches farther.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from crosscheck.compare.sizes import at_rest
from crosscheck.document import (
    LEVELS,
    QUANTITIES,
    Errors,
    Finding,
    Order,
    Record,
    Rung,
    Status,
    outcomes,
)
from crosscheck.document.known import Known
from crosscheck.document.outcomes import Outcome, percent
from crosscheck.judge import known, tolerances
from crosscheck.judge.claim import Claim, Trace
from crosscheck.judge.crossings import near_impacts
from crosscheck.judge.defects import Defects
from crosscheck.judge.metrics import Error, Plateau, errors, observed_order, up_to
from crosscheck.judge.tolerances import Tol
from crosscheck.references.base import Reference
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene

SINGLE = 2.0**-23
"""Spacing at 1 of numbers in single precision."""


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Bounds of the states of one run, and the time up to which they judge it."""

    states: dict[str, Tol]
    invariants: dict[str, Tol]  # bounds of the states, from which those of energy and momentum follow
    empty: frozenset[str]  # kinds of findings whose bound is too large to judge anything
    until: float  # s
    near: np.ndarray | None = None  # (T,) output times next to an impact, where no bound of velocities holds

    @property
    def reach(self) -> float:
        """The time (s) up to which the bounds of the states judge the motion."""
        return 0.0 if self.empty & {"position", "attitude"} else self.until


def _judged(kind: str, value: float, tol: Tol, unit: str, detail: str = "", empty: bool = False) -> Finding:
    """A finding. With `empty`, the bound exceeds the size of the quantity, so that the value is not judged."""
    if empty and np.isfinite(value):
        return Finding(kind, "unresolved", float(value), None, unit,
                       f"at this step the bound, {tol.value:.2g}, exceeds the size of the quantity itself", detail)
    # A NaN fails.
    return Finding(kind, "ok" if value <= tol.value else "fail", float(value), tol.value, unit, tol.why, detail)


def _uncounted(traj: Trace, unit: str, detail: str) -> Finding | None:
    """The finding about an energy that is not known."""
    if np.isfinite(traj.energy).all() or not all(np.isfinite(getattr(traj, name)).all() for name in "xRvw"):
        return None
    return Finding("energy", "unresolved", None, None, unit, "the engine has not counted how often hinges turn between "
                   "its outputs, so that the energy of their springs is not known", detail)


def judge_states(scene: Scene, traj: Trace, truth: Reference, window: Reference, claim: Claim
                 ) -> tuple[list[Finding], dict[str, Error], Bounds]:
    """Judge errors against truth over the longest time that bounds can judge: the whole run, or else its first window.

    Returns the findings, the errors over the whole run, and the bounds that were used.
    """
    def bounds_for(reference: Reference, growth: float | None = None) -> dict[str, Tol]:
        if claim.fixed is not None:
            return tolerances.fixed_step(scene, reference, *claim.fixed, growth, claim.eps)
        return tolerances.adaptive(scene, reference, claim.rtol or 0.0, traj.steps, growth, claim.eps)

    used, until = truth, min(float(truth.t[-1]), truth.horizon)
    growth = 1.0 if _conservative(scene, truth) else None
    states, invariants = bounds_for(truth), bounds_for(truth, growth)
    if tolerances.vacuous(scene, truth, states, invariants):
        used, until = window, min(float(window.t[-1]), window.horizon)
        states, invariants = bounds_for(window), bounds_for(window, growth)
    near = near_impacts(scene, truth, states["position"].value, _late(claim))
    if near.any():
        v, w = (np.where(near[:, None, None], getattr(truth.states, name), getattr(traj, name)) for name in "vw")
        traj = dataclasses.replace(traj, v=v, w=w)
    judged = errors(scene, traj, truth.states, until)
    empty = tolerances.vacuous(scene, used, states, invariants)
    bounds = Bounds(states, invariants, empty, until)
    findings = [_judged(quantity, error.max, bounds.states[quantity], error.unit,
                        f"body {error.body}, t = {error.time:.4g} s, judged up to {until:g} s", quantity in empty)
                for quantity, error in judged.items()]
    if claim.eps > tolerances.EPS:
        findings.append(_arithmetic(scene, used, claim, round(until / float(traj.t[-1]) * traj.steps)))
    return findings, errors(scene, traj, truth.states.until(truth.horizon)), dataclasses.replace(bounds, near=near)


def _late(claim: Claim) -> float:
    """By how much (s) a method may take an event too late that does not look for it."""
    return claim.step or 0.0 if claim.order == 1 else 0.0


def too_coarse(claim: Claim, budgeted: bool) -> Finding:
    """The finding on a run of which no bound judges anything: its plan has failed, or `budgeted` has none finer."""
    return Finding("step", "unresolved" if budgeted else "fail", claim.step, None, "s", "at so coarse a step the "
                   "bounds exceed the size of the scene, and those of intervals what the motion covers in them, so "
                   "that they would pass anything", "no finer one was asked for or affordable" if budgeted else
                   "choose a smaller step")


def judge_rest(scene: Scene, truth: Reference) -> list[Finding]:
    """The finding on a scene in which nothing moves; none for any other."""
    if not at_rest(scene, truth.states):
        return []
    return [Finding("rest", "unresolved", None, None, "", "nothing moves in this scene, so that an engine which does "
                    "nothing is right: nothing was judged", "give it a start that moves")]


def _arithmetic(scene: Scene, truth: Reference, claim: Claim, steps: int) -> Finding:
    """Says what an engine can reach whose numbers are coarser than doubles."""
    size = tolerances.scales(scene, truth).of("position")
    floor = tolerances.plateau(scene, truth, size, claim.order or 1, claim.eps).floor
    most = tolerances.rounding(scene, truth, size, steps, claim.eps)
    precision = "single precision" if claim.eps >= SINGLE else "its numbers"
    return Finding("arithmetic", "ok", floor, None, "m", f"{precision}, spacing {claim.eps:.1e} at 1, can reach about "
                   f"{floor:.1e} m of truth here, and bounds allow the {most:.1e} m that rounding may leave in {steps} "
                   "steps")


def _conservative(scene: Scene, truth: Reference) -> bool:
    """Whether the true motion conserves energy and vertical momentum, within the error of truth."""
    scale = tolerances.scales(scene, truth)
    pairs = [(mechanics.energy(scene, truth.states), scale.kinetic),
             (mechanics.momentum_vertical(scene, truth.states), scale.momentum)]
    # Energies have the size of the kinetic energy, states have errors up to `error`, and there are about ten terms.
    return all(np.abs(values - values[0]).max() <= 10 * truth.error * size for values, size in pairs)


def judge_invariants(scene: Scene, traj: Trace, truth: Reference, bounds: Bounds) -> list[Finding]:
    """Judge energy and vertical angular momentum against those of truth, up to the time that the bounds judge."""
    keep, where = up_to(truth.t, bounds.until), f"up to {bounds.until:g} s"
    keep &= True if bounds.near is None else ~bounds.near
    exact_energy = mechanics.energy(scene, truth.states)
    exact_momentum = mechanics.momentum_vertical(scene, truth.states)
    energy = np.abs(traj.energy - exact_energy)[keep].max(initial=0.0) / tolerances.scales(scene, truth).kinetic
    momentum = np.abs(traj.momentum_vertical - exact_momentum)[keep].max(initial=0.0)
    none = not keep.any()
    most, turn = (rule(scene, truth, bounds.invariants) for rule in (tolerances.energy, tolerances.momentum))
    return [_uncounted(traj, "1", where) or _judged("energy", energy, most, "1", where,
                                                    none or "energy" in bounds.empty),
            _judged("momentum", momentum, turn, "kg m^2/s", where, none or "momentum" in bounds.empty)]


def judge_coarse(scene: Scene, traj: Trace, truth: Reference) -> Finding:
    """Judge the energy of a run at a coarse step: its error must not exceed the energy to lift all bodies to the top.

    If other forces or drives act, the range of the true kinetic energy is added, which without gravity comes from them
    alone. A run with a larger error shows another motion than that of the scene.
    """
    scale = tolerances.scales(scene, truth)
    # A constant energy is known for all times, one that loads and dampers change only up to the horizon.
    keep = slice(None) if _conservative(scene, truth) else up_to(truth.t, truth.horizon)
    change = np.abs(traj.energy - mechanics.energy(scene, truth.states))[keep].max() / scale.kinetic
    lift = scene.masses.sum() * np.linalg.norm(scene.gravity) * 2 * scale.reach / scale.kinetic
    why = "the energy of lifting all bodies from bottom to top, 2 m g times the reach"
    if scene.loads or scene.functions or scene.has_laws:
        lift += np.ptp(mechanics.kinetic_energy(scene, truth.states)) / scale.kinetic
        why += ", and what forces and drives turn over"
    return _uncounted(traj, "1", "the whole run") or _judged(
        "energy", change, Tol(float(lift), f"{why}, over the largest kinetic energy"), "1", "the whole run")


def judge_without_truth(scene: Scene, traj: Trace) -> Finding:
    """Judge the energy of a run without truth: as `judge_coarse`, for scenes that conserve energy."""
    change = float(np.abs(traj.energy - traj.energy[0]).max())
    if (unknown := _uncounted(traj, "J", "the whole run")) is not None:
        return unknown
    if scene.loads or scene.has_laws:
        return Finding("energy", "unresolved", change, None, "J",
                       "forces may change the energy, and no truth tells how")
    reach = tolerances.reach(scene)
    kinetic = 0.5 * (np.einsum("i,ik,ik->", scene.masses, scene.v0, scene.v0)
                     + np.einsum("ik,ikl,il->", scene.w0, scene.inertias, scene.w0))
    lift = float(scene.masses.sum() * np.linalg.norm(scene.gravity) * 2 * reach + kinetic)
    why = ("no truth: the kinetic energy at the start and that of lifting all bodies from bottom to top, "
           "2 m g times the reach")
    return _judged("energy", change, Tol(lift, why), "J", "the whole run")


def judge_levels(scene: Scene, traj: Trace, truth: Reference | None, bounds: Bounds | None, held: frozenset[str],
                 maxima: dict[str, float], eps: float = tolerances.EPS, run: Defects | None = None) -> list[Finding]:
    """Judge the constraint levels. Levels that the method satisfies by construction are judged at every step.

    Others are judged at the samples, against what follows from the bounds of the states or, with `run`, against what
    the errors of a method of this order may add up to by then, if that is less.
    """
    findings = []
    for level, unit in LEVELS.items():
        kind, series = f"level {level}", getattr(traj, f"constraint_{level}")
        if series is None:
            findings.append(Finding(kind, "unresolved", None, None, unit, "the engine gives no accelerations"))
            continue
        everywhere = max(maxima.get(f"constraint_{level}", 0.0), float(np.max(series)))
        if level in held:
            left = tolerances.newton_left(scene, truth, traj.stats.get("newton_left", 0.0))
            tol = tolerances.held_level(scene, truth, level, left, eps)
            findings.append(_judged(kind, everywhere, tol, unit, "every step"))
            continue
        free = None if bounds is None or truth is None else tolerances.free_level(scene, truth, level, bounds.states)
        if bounds is None or truth is None or free is None:
            findings.append(Finding(kind, "unresolved", everywhere, None, unit,
                                    "the method does not enforce this level, and no bound of a state implies one"))
            continue
        keep = up_to(truth.t, bounds.until)
        judged = _judged(kind, float(np.max(series[keep])), free, unit, f"up to {bounds.until:g} s",
                         kind in bounds.empty)
        findings.append(judged if run is None or judged.status == "fail" else
                        _drifted(run, level, series, judged, traj.t))
    return findings


def _drifted(run: Defects, level: str, series: np.ndarray, judged: Finding, t: np.ndarray) -> Finding:
    """Judge a level against the sum of the allowed errors of all intervals before, unless that is too large."""
    allowed = run.allowed[0][level]
    size = run.scale.length * (1.0 if level == "position" else run.scale.rate)
    at = int(np.argmax(series / allowed))
    if allowed[at] > size and series[at] <= allowed[at]:
        return judged
    return Finding(judged.kind, "ok" if series[at] <= allowed[at] else "fail", float(series[at]), float(allowed[at]),
                   judged.unit, "not enforced: the errors of a method of this order add up to no more by then",
                   f"t = {t[at]:.4g} s")


def judge_orders(order: int, ladder: Sequence[Rung], plateaus: Mapping[str, Plateau], rungs: int | None = None,
                 final: bool = False) -> tuple[list[Finding], dict[str, Order]]:
    """Judge the observed order of every quantity against the documented one. A higher order passes.

    An order is a property of vanishing steps. If the order of the first `rungs` steps (None: of all) is low, the same
    number of finest steps above the rounding plateau decides. If the order has not settled, and finer steps cannot help
    because of rounding or because there are none (`final`), only the nearest whole number counts.
    """
    findings, orders = [], {}
    steps = [rung.step or 0.0 for rung in ladder]
    for quantity in QUANTITIES:
        values = [math.inf if (error := rung.errors.get(quantity)) is None else error for rung in ladder]
        lowest = order - tolerances.order_margin(order)
        result = observed_order(steps[:rungs], values[:rungs], plateaus[quantity])
        if result.observed is not None and result.observed < lowest:
            result = observed_order(steps, values, plateaus[quantity], rungs)
        why = f"documented order {order}, least squares over {result.used} steps of {len(steps)}"
        if result.observed is not None and result.observed < lowest and not result.settled and (
                result.exhausted or (final and result.finest is not None)):
            lowest = order - tolerances.CONSTANTS["order_margin_coarse"]
            why += "; it still changes where " + ("rounding sets in" if result.exhausted else "the study ends")
            why += ", so that the nearest whole number counts"
            if result.finest is not None:
                result = replace(result, observed=max(result.observed, result.finest))
                why += ", and of orders that rise that of the two finest steps"
        orders[quantity] = result
        status: Status = "unresolved" if result.observed is None else "ok" if result.observed >= lowest else "fail"
        value, detail = result.observed, result.note if result.observed is None else ""
        if value is not None and value <= known.RISING:
            detail = known.RISES
        if not np.isfinite(values).all():
            status, value, detail = "fail", None, "a run of the order study was not finite"
        findings.append(Finding(f"order {quantity}", status, value, lowest, "1", why, detail))
    return findings, orders


def undecided(findings: list[Finding], orders: dict[str, Order]) -> bool:
    """Whether finer steps may raise an order that is too low, see `judge_orders`."""
    low = {finding.kind.removeprefix("order ") for finding in findings
           if finding.status == "fail" and finding.value is not None}
    return any(not orders[quantity].settled and not orders[quantity].exhausted for quantity in low)


def settle(run: Record, findings: list[Finding], defects: Sequence[Known], message: str = "",
           judged_until: float | None = None, why: str = "", whole: Mapping[str, tuple[float, str]] | None = None
           ) -> Record:
    """The verdict on a run: mark known defects, notice those that no longer show, and determine the outcome.

    `defects` are those of the engine that are about this run. Bounds that the user set are not affected by them.
    """
    for entry in defects:
        seen = [finding for finding in findings if finding.kind in entry.kinds and finding.status != "unresolved"
                and not finding.why.startswith(tolerances.BY_USER)]
        alike = known.alike(entry, findings)
        failing = [finding for finding in seen if alike and finding.status == "fail" and known.excuses(entry, finding)]
        findings = [replace(each, status="known", detail=entry.reason) if each in failing else each
                    for each in findings]
        # A defect has vanished only if it was looked for: without an order study, nothing is known about orders.
        if entry.always and not failing and entry.kinds.keys() <= {finding.kind for finding in seen} | {"run"}:
            findings.append(Finding("vanished", "fail", None, None, "", f"a known defect no longer shows: "
                                    f"{entry.reason}", "if the engine was mended, remove the entry"))
    blind = next((each for each in findings if each.kind in BLIND and each.status == "unresolved"), None)
    share = 0.0 if blind is not None else _share(judged_until, run.duration)
    outcome = outcome_of(findings, share)
    if outcome == "unresolved":
        message = _unresolved(blind, share, why)
    judged = {finding.kind: finding for finding in findings}
    errors = {name: _headline(error, judged[name], (whole or {}).get(name)) if name in judged else error
              for name, error in run.errors.items()}
    return replace(run, findings=findings, outcome=outcome, message=message, judged_until=judged_until, share=share,
                   not_judged=why if blind is None else blind.why, errors=errors)


def _headline(error: Errors, finding: Finding, whole: tuple[float, str] | None) -> Errors:
    """The error with the figure that counts: the largest over all of the time for which there is truth.

    The bound beside it is left out where it does not reach as far.
    """
    value = finding.value if whole is None else whole[0]
    reaches = finding.value is not None and value is not None and value <= finding.value * (1 + 1e-12)
    return replace(error, judged=value, bound=finding.bound if reaches else None, why=finding.why if reaches else "")


BLIND = ("truth", "rest", "precision", "step")
"""Kinds of findings that, where they are unresolved, say why nothing of the motion was judged."""


def outcome_of(findings: Sequence[Finding], share: float = 1.0, need: float = 1.0) -> Outcome:
    """The outcome that follows from findings and from the `share` of its time over which the motion was judged."""
    statuses = {finding.status for finding in findings}
    return ("fail" if "fail" in statuses else "unresolved" if share < need else
            "known" if "known" in statuses else "pass")


def _unresolved(blind: Finding | None, share: float, why: str) -> str:
    """Why a run is unresolved."""
    if blind is not None:
        return "; ".join(filter(None, (blind.why, blind.detail)))
    return f"judged over {percent(share)} of its time" + (f", since {why}" if why else "")


def needing(run: Record, need: float) -> Record:
    """The run with the outcome that it has where its motion has to be judged over a share `need` of its time.

    Only runs that pass, are known or unresolved by their share depend on it.
    """
    if run.outcome not in ("pass", "known", "unresolved") or not run.share:
        return run
    outcome = outcome_of(run.findings, run.share, need)
    return replace(run, outcome=outcome, message=_unresolved(None, run.share, run.not_judged)
                   if outcome == "unresolved" else "")


def beyond(run: Record, finding: Finding, message: str = "") -> Record:
    """The run with one more finding, which fails."""
    return replace(run, findings=[*run.findings, finding], outcome="fail",
                   message="; ".join(filter(None, (run.message, message))))


FIRST = (("run", "step", "vanished"), (*QUANTITIES, "order", "energy"),
         ("momentum", "sensor", "level", "acceleration", "orthogonality", "limit", "rtol", "sub-steps"))
"""Kinds of findings, or the first words of their names, in the order in which passing ones are named. All others are
plausibility checks, which say little about accuracy and come last."""


def worst(findings: Sequence[Finding]) -> Finding | None:
    """The finding to name first: a failing one, else a known one, else a passing one.

    Runs that did not end come first, then those that blew up. Beyond bounds it is how far that decides, within them the
    order of kinds in `FIRST`.
    """
    def place(finding: Finding) -> tuple[int, bool, bool, bool, float, int, float]:
        group = next((index for index, kinds in enumerate(FIRST)
                      if finding.kind in kinds or finding.kind.partition(" ")[0] in kinds), len(FIRST))
        bad, severity = finding.status in ("fail", "known"), finding.severity
        if finding.kind.startswith("order"):
            severity /= 10.0  # of orders it counts tenths
        says = bad or math.isfinite(severity)
        return ({"fail": 2, "known": 1, "ok": 0}[finding.status], says, group == 0, bad and finding.blown,
                severity if bad else 0.0, -group, severity)

    return max((finding for finding in findings if finding.status != "unresolved"), key=place, default=None)


def code(run: Record) -> str:
    """The stable code of what is wrong with a run or open; "" for a pass."""
    finding = worst(run.findings)
    return outcomes.code(run.outcome) if finding is None or finding.status == "ok" else outcomes.code(
        run.outcome, finding.kind, finding.why.startswith(tolerances.BY_USER))


def _share(judged: float | None, duration: float | None) -> float:
    """The share of a run's time over which its motion was judged; 1 if that is unknown."""
    return 1.0 if judged is None or not duration or judged >= duration * (1 - 1e-9) else judged / duration


def word(run: Record) -> str:
    """The outcome, with the share of the run over which its motion was judged if that is not all of it."""
    if run.share is None or run.share >= 1 or run.outcome not in ("pass", "known", "unresolved"):
        return run.outcome
    return f"{run.outcome}, judged over {percent(run.share)}"
