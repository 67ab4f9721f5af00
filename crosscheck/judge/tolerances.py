"""Tolerances: from the documented order of a method and the truth of a scene to bounds with reasons.

No bound depends on the run that it judges. The state is y = (x / L, R, v / (L W), w / W) with a length L and a rate W
of the scene. In each step a method of order p with step h makes an error of at most h^(p+1) |y^(p+1)|: its principal
error constant is below one. T / h such errors add up, each magnified by at most A, the growth of a small perturbation
of y over the run. The error of y therefore stays below B = A T h^p max |y^(p+1)|, where p is documented and A and y are
those of truth. It is L B for positions and B for attitudes. Errors of velocities change as fast as the motion turns, at
most at the rate W': they are L W' B and W' B.
"""

from __future__ import annotations

import dataclasses
import math
import pathlib
import tomllib

import numpy as np

from crosscheck.compare.sizes import at_rest, length_of
from crosscheck.document import QUANTITIES, Scales
from crosscheck.judge.metrics import Plateau
from crosscheck.references.base import Reference
from crosscheck.references.maximal import fastest
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.scene.states import Motion

EPS = float(np.finfo(float).eps)

FILE = pathlib.Path(__file__).with_name("tolerances.toml")
"""The file with every constant and every rule of the verdicts, and their reasons."""


def _read() -> tuple[dict[str, float], dict[str, dict[str, str]]]:
    content = tomllib.loads(FILE.read_text(encoding="utf-8"))
    return {name: entry["value"] for name, entry in content["constant"].items()}, content["bound"]


CONSTANTS, BOUNDS = _read()
"""The constants by name, and the bounded quantities with unit, rule and reason."""

ORDER_MARGIN = {1: CONSTANTS["order_margin_first"]}
"""How far the observed order may lie below the documented one, by documented order."""
ORDER_MARGIN_HIGH = CONSTANTS["order_margin"]
"""The same for every order that `ORDER_MARGIN` does not have."""

BY_USER = "set by the user"
"""First words of the reason of a bound that the user set, see `crosscheck.judge.overrides`."""

HELD = {level: CONSTANTS[f"held_{level}"] for level in ("position", "velocity", "acceleration")}
"""Rounding of the constraint levels that a method enforces, for terms of the size of a pendulum (about 1 m, 10 m/s,
100 m/s^2 over 1e4 steps). For larger terms it is 50 eps times their size."""

ORTHOGONALITY = CONSTANTS["orthogonality"]
"""Rounding of R^T R - I for attitudes that stay on SO(3) by construction."""


@dataclasses.dataclass(frozen=True)
class Tol:
    """A bound and the reason for it."""

    value: float
    why: str


def scales(scene: Scene, truth: Reference) -> Scales:
    """Lengths, speeds, rates and energies of a scene along its true motion."""
    return scales_of(scene, truth.states)


def scales_of(scene: Scene, states: Motion) -> Scales:
    """Lengths, speeds, rates and energies of a scene along a motion, which is NaN where it is not known."""
    length = length_of(scene)
    fall = float(np.sqrt(np.linalg.norm(scene.gravity) / length))
    rates = np.linalg.norm(states.w, axis=-1)
    kinetic = 0.5 * (np.einsum("i,tik,tik->t", scene.masses, states.v, states.v)
                     + np.einsum("tik,ikl,til->t", states.w, scene.inertias, states.w))
    speed, reach = (float(np.nanmax(np.linalg.norm(values, axis=-1))) for values in (states.v, states.x))
    inertia = float(np.linalg.norm(scene.inertias, ord=2, axis=(1, 2)).sum())
    rate, most = max(float(np.nanmax(rates)), fall), float(np.nanmax(kinetic))
    if at_rest(scene, states):  # the sizes are those of a fall through the length
        speed = length * (rate or 1.0)
        most = float(scene.masses.sum()) * speed**2
    return Scales(length=length, speed=speed, rate=rate or 1.0,
                  unit_rate=max(float(rates[0].max()), fall) or 1.0, reach=reach, kinetic=most,
                  momentum=float(scene.masses.sum() * reach * speed + inertia * np.nanmax(rates)))


def energy_size(scene: Scene, run: Motion, truth: Motion | None) -> float:
    """What errors of the energy of a run are relative to, J: its largest kinetic energy, that of truth if there is one.
    """
    if truth is not None:
        return scales_of(scene, truth).kinetic
    return float(mechanics.kinetic_energy(scene, run).max()) or 1.0


def derivative(truth: Reference, order: int, scale: Scales) -> float:
    """max |d^order y / dt^order| (1/s^order) of the state y, in which velocities are derivatives of one order more.

    It is the larger one of positions and attitudes, since joints couple them: an error of one is an error of the other.
    """
    def pose(degree: int) -> float:
        return float(max(truth.position_derivatives[degree] / scale.length,
                         truth.attitude_derivatives[degree] / np.sqrt(2.0)))
    return max(pose(order), pose(order + 1) / scale.unit_rate)


USUAL = 50.0
"""Roundings (eps) that a step is allowed: about the size of the terms of accelerations over their sum, in an ordinary
scene."""


def grading(scene: Scene) -> float:
    """Roundings (eps) that a step is allowed in this scene: `USUAL`, and more if masses or inertias differ widely.

    Joints transmit the forces of all bodies. The lightest body is moved by a difference of such forces that is as small
    as its mass, and a needle turns about its own axis by one as small as its least moment of inertia.
    """
    principal = np.linalg.eigvalsh(scene.inertias)
    return float(max(USUAL, scene.masses.sum() / scene.masses.min(), (principal[:, -1] / principal[:, 0]).max()))


def rounding(scene: Scene, truth: Reference, size: float, steps: int, eps: float = EPS) -> float:
    """Error by rounding alone of a quantity of this size after so many steps, plus the error of truth."""
    return float(truth.error * max(1.0, size)
                 + grading(scene) * eps * size * truth.amplification * max(1, steps) ** 0.6)


def plateau(scene: Scene, truth: Reference, size: float, order: int, eps: float = EPS) -> Plateau:
    """How large rounding may be in errors of a quantity of this size, for a method of this order.

    Rounding is usually as large as the floor. In an ill-conditioned model it may take up to half of the digits.
    """
    floor = max(truth.disagreement, grading(scene) / USUAL * eps * truth.amplification) * max(1.0, size)
    return Plateau(floor, float(np.sqrt(eps)) * size, order)


def differenced(length: float, eps: float) -> dict[str, float]:
    """Rounding of velocities that are differences of positions over a step, times the step; none of double precision.

    It is 1e-4 m/s at 1 ms and 1 m.
    """
    return {"velocity": eps * length, "angular velocity": eps} if eps > EPS else {}


def fixed_step(scene: Scene, truth: Reference, order: int, step: float,
               amplification: float | None = None, eps: float = EPS) -> dict[str, Tol]:
    """Bounds of the errors per quantity for a method of this documented order with a fixed step (s).

    `amplification` replaces that of the truth; `eps` is the relative spacing of the engine's numbers.
    """
    scale = scales(scene, truth)
    duration = float(truth.t[-1])
    steps = round(duration / step)
    largest = derivative(truth, order + 1, scale)
    growth = truth.amplification if amplification is None else amplification
    bound = growth * duration * step**order * largest
    why = (f"A T h^{order} max|y^({order + 1})| with A = {growth:.3g}, T = {duration:g} s, "
           f"h = {step:.3g} s, max|y^({order + 1})| = {largest:.3g} /s^{order + 1} from truth")
    bounds = {}
    for quantity, unit in scale.units.items():
        floor = rounding(scene, truth, scale.of(quantity), steps, eps)
        bounds[quantity] = Tol(unit * bound + floor, f"{why}; times {unit:.3g} {QUANTITIES[quantity]}; "
                                                     f"rounding floor {floor:.1e}")
    return bounds


def limit(scene: Scene, truth: Reference, order: int, step: float, eps: float = EPS) -> dict[str, Tol]:
    """Bounds of the errors of the limit that is extrapolated from two steps, the coarser of which is `step` (s).

    Extrapolation removes the leading term of the error. The next one is bounded as for a method one order higher.
    """
    last = len(truth.position_derivatives) - 3  # the bound of order p takes derivatives up to p + 2
    scale = scales(scene, truth)
    upon = _upon_itself(truth, scale, order, step)
    return {name: Tol(bound.value + upon * scale.units[name], f"the leading term of the error extrapolated away: "
                                                              f"{bound.why}; that term upon itself {upon:.1e}")
            for name, bound in fixed_step(scene, truth, min(order + 1, last), step, eps=eps).items()}


def _upon_itself(truth: Reference, scale: Scales, order: int, step: float) -> float:
    """The part of the leading error's own square that extrapolation leaves: (A T h^p)^2 max|y^(2p+2)| / 16.

    Errors of c h^(p+1) y^(p+1) per step, with c at most 1/2, enter to second order as half of their square, and
    extrapolation from h and h/2 leaves half of that. If truth has no derivative of order 2p + 2, the square of that of
    order p + 1 stands for it, as in a motion at a single rate.
    """
    grown = truth.amplification * float(truth.t[-1]) * step**order / 4.0
    highest = len(truth.position_derivatives) - 2
    if 2 * order + 2 <= highest:
        return grown**2 * derivative(truth, 2 * order + 2, scale)
    return (grown * derivative(truth, min(order + 1, highest), scale)) ** 2


def adaptive(scene: Scene, truth: Reference, rtol: float, steps: int,
             amplification: float | None = None, eps: float = EPS) -> dict[str, Tol]:
    """Bounds of the errors per quantity for a method that keeps the error of each step below rtol times the state y.

    If the rate of the fastest spring or damper is larger than W, it takes its place: if a position that oscillates at
    the rate W is off by e, its velocity is off by W e. `amplification` replaces that of the truth.
    """
    growth = truth.amplification if amplification is None else amplification
    scale = scales(scene, truth)
    rate = max(scale.rate, fastest(scene))
    least = {"position": 0.0, "attitude": 0.0, "velocity": scale.length * rate, "angular velocity": rate}
    bounds = {}
    for quantity in QUANTITIES:
        size = max(scale.of(quantity), least[quantity])
        value = growth * steps * rtol * size + rounding(scene, truth, size, steps, eps)
        bounds[quantity] = Tol(value, f"A n rtol times the size: A = {growth:.3g}, n = {steps} steps, "
                                      f"rtol = {rtol:.1e}, size {size:.3g} {QUANTITIES[quantity]}")
    return bounds


def energy(scene: Scene, truth: Reference, bounds: dict[str, Tol]) -> Tol:
    """Bound of the error of the energy over the largest kinetic energy, from bounds of the states.

    If energy and momentum about the vertical are conserved, the motion does not magnify an error of them. The bounds of
    the states are then those with A = 1.
    """
    scale = scales(scene, truth)
    mass, inertia = scene.masses.sum(), np.linalg.norm(scene.inertias, axis=(1, 2)).sum()
    x, v, w = (bounds[quantity].value for quantity in ("position", "velocity", "angular velocity"))
    potential = mass * np.linalg.norm(scene.gravity) * x
    kinetic = mass * (scale.speed + 0.5 * v) * v + inertia * (scale.rate + 0.5 * w) * w
    return Tol(float((potential + kinetic) / scale.kinetic),
               "what the bounds of position, velocity and angular velocity allow: sum of m g dx, m v dv and J w dw, "
               "over the largest kinetic energy")


def momentum(scene: Scene, truth: Reference, bounds: dict[str, Tol]) -> Tol:
    """Bound (kg m^2/s) of the error of the angular momentum about the vertical, from the bounds of the states."""
    scale = scales(scene, truth)
    mass, inertia = scene.masses.sum(), np.linalg.norm(scene.inertias, axis=(1, 2)).sum()
    x, r, v, w = (bounds[quantity].value for quantity in QUANTITIES)
    value = mass * ((scale.reach + x) * v + scale.speed * x) + inertia * (w + (scale.rate + w) * r)
    return Tol(float(value), "what the bounds of the states allow: sum of m x dv, m v dx, J dw and J w dR")


def most_steps(scene: Scene, truth: Reference, rtol: float, samples: int, said: int, order: int | None = None) -> int:
    """The steps that an adaptive run made: as it says, but no more than a pair of order 4(3) takes for the tolerance.

    Its local error is about (h W)^4; that of a lower documented order p is (h W)^(p + 1). Bounds of adaptive methods
    grow with this number.
    """
    turned = float(truth.t[-1]) * max(scales(scene, truth).rate, fastest(scene))
    return min(said, math.ceil(samples + PAIR * turned * math.pow(rtol, -1.0 / min(4, (order or 3) + 1))))


PAIR = 4.0
"""Times the steps of such a pair that are believed: steps are rejected, and orders differ."""

LEFT = 1e-9
"""Largest residual of a converged Newton iteration, relative to the forces of the motion; 64 bodies reach it. What
an engine states is believed up to here."""


ENDED = 10.0
"""Times the residual at which an engine's Newton iteration ends that constraints may be open."""


def newton_left(scene: Scene, truth: Reference | None, said: float) -> float:
    """The residual that an engine states for its Newton iteration (N or N m), as far as it is believed.

    The forces are those of the true motion. Without truth they are all weights under ten times the gravity.
    """
    weights = 10.0 * float(scene.masses.sum() * np.linalg.norm(scene.gravity))
    forces = weights if truth is None else max(
        weights, float(scene.masses.max() * truth.position_derivatives[2]),
        float(np.linalg.norm(scene.inertias, ord=2, axis=(1, 2)).max() * truth.attitude_derivatives[2]))
    return min(max(said, 0.0), LEFT * (1.0 + forces))


def held_level(scene: Scene, truth: Reference | None, level: str, newton: float = 0.0, eps: float = EPS) -> Tol:
    """Bound of a constraint level that the method enforces: rounding; without truth, that of a pendulum.

    `newton` is the residual that the engine's own iteration leaves.
    """
    tol = _held_level(scene, truth, level, eps)
    ended = ENDED * newton
    return tol if ended <= tol.value else Tol(ended, f"held by construction: ten times {newton:.2g}, the residual "
                                                     "at which the engine's Newton iteration ends")


def _held_level(scene: Scene, truth: Reference | None, level: str, eps: float) -> Tol:
    usual = HELD[level] * eps / EPS
    if truth is None:
        return Tol(usual, f"held by construction: rounding level, {usual:g}; no truth tells the speeds")
    scale = scales(scene, truth)
    size = {"position": scale.reach + scale.length, "velocity": scale.speed + scale.rate * scale.length,
            "acceleration": scale.speed**2 / scale.length + 2 * scale.rate**2 * scale.length}[level]
    roundings = USUAL if level == "position" else grading(scene)
    value = max(usual, roundings * eps * size)
    return Tol(value, f"held by construction: rounding level, the larger of {usual:g} and {roundings:.3g} eps x "
                      f"{size:.3g}")


def reach(scene: Scene) -> float:
    """Largest distance (m) from the origin that the scene's levers allow a centre of mass."""
    levers = [np.linalg.norm(joint.child_anchor) + np.linalg.norm(joint.parent_anchor) for joint in scene.joints]
    return float(max(np.sum(levers), np.linalg.norm(scene.x0, axis=-1).max()))


def free_level(scene: Scene, truth: Reference, level: str, bounds: dict[str, Tol]) -> Tol | None:
    """Bound of a constraint level that the method does not enforce; None if the bounds of the states imply none.

    The true motion satisfies the constraints. A state within its bounds violates them by no more than this.
    """
    scale = scales(scene, truth)
    x, r, v, w = (bounds[quantity].value for quantity in QUANTITIES)
    lever = max(1.0, scale.length)  # rows such as "two axes are perpendicular" have no unit
    if level == "position":
        return Tol(2 * (x + lever * r), "not enforced: two bodies meet at a joint, each within dx + s dR of truth")
    if level == "velocity":
        return Tol(2 * (v + lever * (w + scale.rate * r)),
                   "not enforced: two bodies meet at a joint, each within dv + s dw + s w dR of truth")
    return None


def vacuous(scene: Scene, truth: Reference, bounds: dict[str, Tol],
            conserved: dict[str, Tol] | None = None) -> frozenset[str]:
    """Kinds of findings whose bound is larger than the quantity itself, so that every run would pass.

    `conserved` are the bounds from which those of energy and momentum follow; None: `bounds`.
    """
    quiet = bounds if conserved is None else conserved
    scale = scales(scene, truth)
    empty = {quantity for quantity, bound in bounds.items() if bound.value > scale.of(quantity)}
    sizes = {"energy": (energy(scene, truth, quiet), 1.0), "momentum": (momentum(scene, truth, quiet), scale.momentum),
             "level position": (free_level(scene, truth, "position", bounds), scale.length),
             "level velocity": (free_level(scene, truth, "velocity", bounds), scale.length * scale.rate)}
    return frozenset(empty | {kind for kind, (bound, size) in sizes.items() if bound and bound.value > size})


def orthogonality(on_group: bool, steps: int, eps: float = EPS) -> Tol:
    """Bound of max |R^T R - I| over a run. `on_group`: the engine declares that its attitudes stay on SO(3)."""
    if on_group:
        return Tol(ORTHOGONALITY * eps / EPS, "attitudes stay on the group by construction: rounding level")
    growth = max(ORTHOGONALITY * eps / EPS, 4 * eps * steps)  # of nine products of three terms each
    return Tol(growth, f"rounding of one product a step, {steps} steps, never more than 4 eps each")


def order_margin(order: int) -> float:
    """How far the observed order of a method may lie below this documented one."""
    return ORDER_MARGIN.get(order, ORDER_MARGIN_HIGH)


def rounding_levels(scene: Scene, truth: Reference) -> dict[str, tuple[float, float]]:
    """(a, b) per figure: in n steps rounding changes it by no more than a + b n^0.6.

    The same code gives the same bits on one machine, but another processor or library may round differently. Figures
    are the compared quantities in their units, "energy" over the largest kinetic energy and "momentum" in kg m^2/s. As
    in `rounding`, a is the error of truth, and b is `grading` times eps and the size, magnified by the motion.
    """
    scale = scales(scene, truth)
    sizes = {quantity: scale.of(quantity) for quantity in QUANTITIES}
    fixed = {quantity: truth.error * max(1.0, size) for quantity, size in sizes.items()}
    step = grading(scene) * EPS * truth.amplification
    growing = {quantity: step * size for quantity, size in sizes.items()}
    levels = {quantity: (fixed[quantity], growing[quantity]) for quantity in QUANTITIES}
    for name, rule in (("energy", energy), ("momentum", momentum)):
        a, b = (rule(scene, truth, {quantity: Tol(value, "rounding") for quantity, value in part.items()}).value
                for part in (fixed, growing))
        levels[name] = (a, b)
    return levels
