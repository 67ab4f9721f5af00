"""Judge reported accelerations and multipliers against the index-1 equations at the run's own states.

Accelerations and multipliers must fit the states, however accurate these are. A method evaluates them somewhere in a
step, so that they may differ by their change within one step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from crosscheck.document import Finding
from crosscheck.judge import tolerances
from crosscheck.judge.claim import Trace
from crosscheck.judge.crossings import Crossed
from crosscheck.judge.defects import RATES, SHARE, Defects
from crosscheck.judge.flow import around
from crosscheck.judge.intervals import ALIKE, WORTH
from crosscheck.judge.vanishing import APART, NEAR, extrapolation, following, shares, soft_joints, started
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene

WITHIN = 16.0
"""A reported acceleration may differ by its change in this many steps. Methods of index 3, and methods that integrate
an acceleration of their own (generalised alpha), need up to nine."""

SETTLED = 200
"""Steps after which the start no longer affects such an acceleration: a factor of 0.9 per step is 1e-9 by then."""

EXACT, SHOWING, MOST = 0.25, 100.0, 1e4
"""A run that fits its states to rounding in the share `EXACT` of the intervals in which a step would change more than
`SHOWING` roundings evaluates its accelerations at its states, always. Rounding varies less than the factor `MOST`."""

DEPENDING = 4.0
"""An error that falls with the step is at most this many times its difference between two steps."""

UNITS = {"acceleration": "m/s^2", "angular acceleration": "rad/s^2", "reaction": "m/s^2",
         "reaction torque": "rad/s^2"}
"""Reactions are compared by the accelerations that they give each body, M^-1 G^T lam: rows may be redundant."""


def judge_accelerations(scene: Scene, trajectories: Sequence[Trace], runs: Sequence[Defects], soft: bool = False
                        ) -> list[Finding]:
    """Findings for those of a, alpha and lam that the engine reports.

    The first run is judged. The others are at other steps: an error that does not vanish with the step is one of the
    model. Where its laws are `soft`, what holds a joint at rest is its own, and not judged.
    """
    traj, claim = trajectories[0], runs[0].claim
    if traj.a is None and traj.lam is None:
        return []
    pairs = sorted(zip(runs, trajectories, strict=True), key=lambda pair: pair[0].claim.step or 0.0)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            gaps = {id(run): _gaps(scene, each, run.flow.index[run.flow.solvable] + 1, run.flow.crossed)
                    for run, each in pairs}
    except np.linalg.LinAlgError:
        return [Finding("acceleration", "fail", np.inf, None, "m/s^2",
                        "the equations of motion have no solution at the run's own states")]
    power = min(claim.order or 1, 2)  # of higher order, accelerations are either those of the state or of second order
    calm = calm_ends(runs)
    if soft:
        calm &= ~np.any([run.flow.resting for run in runs], axis=0)
    if not calm.any():
        return [Finding("acceleration", "unresolved", None, None, "m/s^2", "forces of joints jump next to every output "
                        "time")]
    findings = []
    for name, unit in UNITS.items():
        given = [(run, gaps[id(run)][name]) for run, _ in pairs if name in gaps[id(run)]]
        if not any(run is runs[0] for run, _ in given):
            continue
        length = 1.0 if unit == "m/s^2" else runs[0].scale.length
        ordered, sizes = [run for run, _ in given], [_sizes(gap) * length for _, gap in given]
        own = next(index for index, run in enumerate(ordered) if run is runs[0])
        bound = within_steps(scene, runs[0])
        candidates = [("", sizes[own], following(sizes, ordered, power) * bound)]
        if len(ordered) > 2:
            candidates.append(("alike at one, two and four times the step, ", sizes[own],
                               _staying(ordered, sizes) * bound))
        if len(ordered) > 1:
            weights, bound = _limit(scene, ordered, sizes, power)
            rest = np.sum([weight * gap for weight, (_, gap) in zip(weights, given, strict=True)], axis=0)
            candidates.append(("extrapolated to vanishing steps, ", _sizes(rest) * length, bound))
            change = _sizes(given[1][1] - given[0][1]) * length
            candidates.append(("no less at a finer step, ", sizes[0], _independent(scene, ordered, change)))
        candidates.append(("where other accelerations are those of the state, ", sizes[own],
                           _exact(scene, runs[0], sizes[own])))
        compared = []
        for word, values, bound in candidates:
            at = int(np.argmax(np.where(calm, values / bound, 0.0)))
            compared.append((float(values[at]) / length, float(bound[at]) / length,
                          f"{word}t = {traj.t[runs[0].flow.index[at] + 1]:.4g} s"))
        value, most, where = max(compared, key=lambda each: each[0] / each[1])
        findings.append(Finding(
            name, "ok" if value <= most else "fail", value, most, unit, "reported, against the index-1 system at "
            "the run's own state: what changes within one step, and what open constraints add", where))
    return findings


def calm_ends(runs: Sequence[Defects]) -> np.ndarray:
    """(I,) whether no force of a joint jumps next to the ends of the intervals."""
    jumps = np.any([run.flow.unsettled(WITHIN * (run.claim.step or 0.0)) for run in runs], axis=0)
    return np.asarray(runs[0].flow.regular & ~jumps)


def within_steps(scene: Scene, run: Defects) -> np.ndarray:
    """(I,) bound of accelerations, as `_bound`; they settle with order one, whatever the order of the method is."""
    settling = _age([run]) < SETTLED * (run.claim.step or 0.0)
    return np.where(settling, _bound(scene, run, 1), _bound(scene, run, min(run.claim.order or 1, 2)))


def _age(runs: Sequence[Defects]) -> np.ndarray:
    """(I,) s at the ends of the intervals, since the engine was started last; infinite if it forgets its past.

    The first step counts all the same: index-3 methods come from a consistent start, and leave half of gamma in it.
    """
    age = np.min([run.flow.since for run in runs], axis=0) + runs[0].flow.tau
    past_first = age > 1.5 * max(run.claim.step or 0.0 for run in runs)
    return np.where(all(run.forgets for run in runs) & past_first, np.inf, age)


def _staying(runs: Sequence[Defects], sizes: Sequence[np.ndarray]) -> np.ndarray:
    """(I,) factor of the bound of the finest of three runs: `WORTH` if errors are alike at all steps, else infinite.

    It is also infinite for soft constraints, whose forces are alike at all steps, and while accelerations settle.
    """
    near = [around(size, NEAR) for size in sizes]
    alike = np.max(near, axis=0) < np.min(near, axis=0) * (1 + ALIKE)
    settling = _age(runs) < SETTLED * max(run.claim.step or 0.0 for run in runs)
    close = np.max(shares(runs, 1), axis=0) < ALIKE
    return np.where(alike & close & ~settling & (not soft_joints(runs)), WORTH, np.inf)


def _limit(scene: Scene, runs: Sequence[Defects], sizes: Sequence[np.ndarray], power: int
           ) -> tuple[np.ndarray, np.ndarray]:
    """Weights of runs, the finest first, that extrapolate to vanishing steps, and the bound (I,) of what remains.

    The states of the runs differ by some share, and their leading terms by the same share. The bound is infinite if a
    coarser run exceeds its own bound, because it has no terms to cancel.
    """
    weights, left = extrapolation(runs, power)
    bound = _bound(scene, runs[0], power, len(runs) - 1, left)
    soft = soft_joints(runs)
    for run, size, weight, share in zip(runs, sizes, weights, shares(runs, power), strict=True):
        own, share = _bound(scene, run, power), np.where(share > APART, 1.0, share)
        bound = bound + abs(weight) * (share * own + soft * _springs(run) + _noise(scene, run))  # noise adds up
        settling = _age([run]) < SETTLED * (run.claim.step or 0.0)
        bound[settling | ((size > own) & (run is not runs[0])) | (soft & started(runs))] = np.inf
    return weights, bound


def _springs(run: Defects) -> np.ndarray:
    """(I,) the accelerations that soft constraints give, m/s^2."""
    opened = np.minimum(run.opening["position"], run.allowed[0]["position"])[run.flow.index + 1]
    return np.asarray(opened / (run.claim.step or 1.0) ** 2)


def _sizes(vectors: np.ndarray) -> np.ndarray:
    """(I,) the largest norm of all bodies; infinite if one is not finite."""
    values = np.linalg.norm(vectors, axis=-1)
    return np.asarray(np.where(np.isfinite(values), values, np.inf).max(axis=1))


def by_equations(scene: Scene, traj: Trace, at: np.ndarray, crossed: Crossed | None
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `mechanics.index1`, in a run's own states at the output times `at`, the ends of the intervals of `crossed`."""
    efforts = None if crossed is None else crossed.efforts()
    angles = {name: values[at] for name, values in mechanics.torsion_angles(scene, traj).items()}
    return mechanics.index1(scene, traj.x[at], traj.R[at], traj.v[at], traj.w[at], angles, traj.t[at], efforts)


def _gaps(scene: Scene, traj: Trace, at: np.ndarray, crossed: Crossed | None) -> dict[str, np.ndarray]:
    """(I, n, 3) for each reported quantity: the difference from the index-1 equations at the output times `at`."""
    a, alpha, lam = by_equations(scene, traj, at, crossed)
    gaps = {}
    if traj.a is not None:
        gaps["acceleration"] = traj.a[at] - a
    if traj.alpha is not None:
        gaps["angular acceleration"] = traj.alpha[at] - alpha
    if traj.lam is not None and lam.shape[1]:
        G = Constraints(scene).jacobian(traj.x[at], traj.R[at])
        given = np.einsum("tmk,tm->tk", G, traj.lam[at] - lam) @ mechanics.inverse_mass(scene)
        rates = given.reshape(len(lam), scene.n, 6)
        gaps |= {"reaction": rates[..., :3], "reaction torque": rates[..., 3:]}
    return gaps


def _exact(scene: Scene, run: Defects, sizes: np.ndarray) -> np.ndarray:
    """(I,) the bound of a run whose accelerations are those of its states, up to rounding; infinite for another."""
    rounding = _lasting(scene, run)
    if not (run.claim.step and run.claim.fixed):  # what a step would show is not known
        return np.full(len(sizes), np.inf)
    showing = run.flow.regular & (run.claim.step * run.scale.length * run.flow.jerks[1] > SHOWING * rounding)
    exact = showing.any() and np.mean(sizes[showing] <= rounding[showing]) >= EXACT
    return MOST * rounding if exact else np.full(len(sizes), np.inf)


def _independent(scene: Scene, runs: Sequence[Defects], change: np.ndarray) -> np.ndarray:
    """(I,) the bound of the finest run's errors, which fall with the step, by their `change` to the next run.

    It is infinite where the states are apart, and while accelerations settle.
    """
    settling = _age(runs) < SETTLED * max(run.claim.step or 0.0 for run in runs)
    close = np.max(shares(runs[:2], 1), axis=0) < ALIKE
    lasting = MOST * sum(_lasting(scene, run) + _noise(scene, run) for run in runs[:2])
    if soft_joints(runs):
        settling |= started(runs)
        lasting += DEPENDING * sum(_springs(run) for run in runs[:2])
    return np.where(close & ~settling, DEPENDING * around(change, NEAR) + lasting, np.inf)


def _bound(scene: Scene, run: Defects, power: int, more: int = 0, times: float = 1.0) -> np.ndarray:
    """Bound (I,) of accelerations (m/s^2) and, over the length, of angular ones, at the ends of the intervals.

    The bound is the change in `WITHIN` steps: its leading term or, `times`, the term that is `more` orders higher.
    """
    scale, flow = run.scale, run.flow
    if run.claim.step and run.claim.fixed:
        degree = power + more
        steps = WITHIN if not more else WITHIN**degree / math.factorial(degree)
        # The largest of the run: accelerations of their own remember where they came from.
        changed = times * steps * run.claim.step**degree * scale.length * float(flow.jerks[degree].max())
        changed += _noise(scene, run)
    else:
        share = RATES * run.claim.steps * len(flow.tau) * (run.claim.rtol or 0.0)
        changed = share * scale.length * (flow.jerks[0] + scale.rate**2)
    return np.asarray(changed + _lasting(scene, run))


def _noise(scene: Scene, run: Defects) -> float:
    """Positions open by e, by the rounding that a held level is allowed, are accelerations of e / h^2.

    At the shortest lever they turn a body, and move what is as far from it as the scene is long.
    """
    levers = [float(np.linalg.norm(joint.child_anchor)) or joint.radius or math.inf for joint in scene.joints]
    length, step = run.scale.length, run.claim.step
    e = tolerances.USUAL * run.claim.eps * max(length, run.scale.reach)
    return e / step**2 * max(1.0, length / min([length, *levers])) if step else 0.0


def _lasting(scene: Scene, run: Defects) -> np.ndarray:
    """(I,) what rounding and open constraints give, however small the step."""
    scale = run.scale
    size = scale.length * scale.rate**2 + scale.speed**2 / scale.length
    floor = 16 * tolerances.grading(scene) * run.claim.eps * size
    x, v = (np.minimum(np.minimum(run.opening[level], run.allowed[0][level]), most)[run.flow.index + 1]
            for level, most in (("position", SHARE * scale.length), ("velocity", SHARE * scale.length * scale.rate)))
    return np.asarray(2 * scale.rate * (v + scale.rate * x) + floor)
