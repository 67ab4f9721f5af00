"""Tolerances: documented orders and truth in, bounds with reasons out. Nothing here has seen the run it judges.

The state is y = (x / L, R, v / (L W), w / W), L a length and W a rate of the scene. A method of order p with step h
makes in each step an error of h^(p+1) |y^(p+1)| at most (its principal error constant is below one); T / h such errors
add up, each magnified on the way by at most A, the growth of a small perturbation of y over the run. So the error of y
stays below B = A T h^p max |y^(p+1)|, with p documented and A and y from truth; positions L B, attitudes B, and the
errors of velocities change as fast as the motion turns, L W' B and W' B, W' the largest rate.
"""

from __future__ import annotations

import dataclasses
import pathlib
import tomllib

import numpy as np

from crosscheck.document import QUANTITIES, Scales
from crosscheck.judge.metrics import Plateau
from crosscheck.references.base import Reference
from crosscheck.references.rates import fastest
from crosscheck.scene.model import GROUND, Scene

EPS = float(np.finfo(float).eps)

FILE = pathlib.Path(__file__).with_name("tolerances.toml")
"""Every constant and every rule of the verdicts, with its reason."""


def _read() -> tuple[dict[str, float], dict[str, dict[str, str]]]:
    content = tomllib.loads(FILE.read_text(encoding="utf-8"))
    return {name: entry["value"] for name, entry in content["constant"].items()}, content["bound"]


CONSTANTS, BOUNDS = _read()
"""Constants by name, and the bounded quantities with unit, rule and reason."""

ORDER_MARGIN = {1: CONSTANTS["order_margin_first"]}
"""How far below its documented order a method may be observed; `ORDER_MARGIN_HIGH` for every other order."""
ORDER_MARGIN_HIGH = CONSTANTS["order_margin"]

BY_USER = "set by the user"
"""How the reason of a bound begins that the user set, see `crosscheck.judge.overrides`."""

HELD = {level: CONSTANTS[f"held_{level}"] for level in ("position", "velocity", "acceleration")}
"""Rounding level of the constraint levels that a method solves for, for terms of the size of a pendulum (about 1 m,
10 m/s, 100 m/s^2 over 1e4 steps); scenes with larger terms get 50 eps times the size of the terms."""

ORTHOGONALITY = CONSTANTS["orthogonality"]
"""Rounding level of R^T R - I for attitudes that stay on the group by construction."""


@dataclasses.dataclass(frozen=True)
class Tol:
    """A bound and the reason it is what it is."""

    value: float
    why: str


AT_REST = 1e-20
"""A kinetic energy below this share of that of falling is rounding."""


def scales(scene: Scene, truth: Reference) -> Scales:
    """Sizes of a scene along its true motion."""
    levers = [float(np.linalg.norm(joint.child_anchor)) for joint in scene.joints if joint.child != GROUND]
    levers += [float(np.linalg.norm(joint.parent_anchor)) for joint in scene.joints if joint.parent != GROUND]
    # A free body has no lever: its radius of gyration plays the part.
    gyration = np.sqrt(np.trace(scene.inertias, axis1=1, axis2=2) / (2.0 * scene.masses))
    states = truth.states
    length = float(max([*levers, 0.0]) or gyration.max())
    fall = float(np.sqrt(np.linalg.norm(scene.gravity) / length))
    rates = np.linalg.norm(states.w, axis=-1)
    kinetic = 0.5 * (np.einsum("i,tik,tik->t", scene.masses, states.v, states.v)
                     + np.einsum("tik,ikl,til->t", states.w, scene.inertias, states.w))
    speed, reach = (float(np.linalg.norm(values, axis=-1).max()) for values in (states.v, states.x))
    inertia = float(np.linalg.norm(scene.inertias, ord=2, axis=(1, 2)).sum())
    rate, most = max(float(rates.max()), fall), float(kinetic.max())
    falling = float(scene.masses.sum()) * (length * (rate or 1.0)) ** 2
    if most <= AT_REST * falling:  # nothing moves: the sizes are those of falling through the length
        speed, most = length * (rate or 1.0), falling
    return Scales(length=length, speed=speed, rate=rate or 1.0,
                  unit_rate=max(float(rates[0].max()), fall) or 1.0, reach=reach, kinetic=most,
                  momentum=float(scene.masses.sum() * reach * speed + inertia * rates.max()))


def derivative(truth: Reference, order: int, scale: Scales) -> float:
    """max |d^order y / dt^order| (1/s^order) of the state y; its velocities are derivatives one order up.

    A joint ties positions and attitudes together, so that an error made in one of them is an error of the other.
    """
    def pose(degree: int) -> float:
        return float(max(truth.position_derivatives[degree] / scale.length,
                         truth.attitude_derivatives[degree] / np.sqrt(2.0)))
    return max(pose(order), pose(order + 1) / scale.unit_rate)


USUAL = 50.0
"""Roundings (eps) that a step is allowed: about the terms of an ordinary scene's accelerations over their sum."""


def grading(scene: Scene) -> float:
    """Roundings (eps) that a step is allowed in this scene: `USUAL`, and more where light bodies carry heavy ones.

    A joint transmits what moves all bodies, and of that the lightest one is left with a difference as small as its
    mass; about its thickest axis a needle turns by differences as small as its least inertia.
    """
    principal = np.linalg.eigvalsh(scene.inertias)
    return float(max(USUAL, scene.masses.sum() / scene.masses.min(), (principal[:, -1] / principal[:, 0]).max()))


def rounding(scene: Scene, truth: Reference, size: float, steps: int, eps: float = EPS) -> float:
    """What rounding alone may do to a quantity of this size in that many steps, on top of the doubt of truth itself."""
    return float(truth.error * max(1.0, size)
                 + grading(scene) * eps * size * truth.amplification * max(1, steps) ** 0.6)


def plateau(scene: Scene, truth: Reference, size: float, order: int, eps: float = EPS) -> Plateau:
    """What in errors of a quantity of this size may be rounding; a method of this order is being judged.

    Rounding is typically as large as the floor. A model that conditions it badly may lose up to half of the digits.
    """
    floor = max(truth.disagreement, grading(scene) / USUAL * eps * truth.amplification) * max(1.0, size)
    return Plateau(floor, float(np.sqrt(eps)) * size, order)


def fixed_step(scene: Scene, truth: Reference, order: int, step: float,
               amplification: float | None = None, eps: float = EPS) -> dict[str, Tol]:
    """Bounds of the errors per quantity for a method of documented order with a fixed step (s).

    `amplification` replaces that of the truth, `eps` is the spacing of the engine's numbers.
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
    """Bounds of the errors of the limit extrapolated from two steps, the coarser `step` (s), of a method of this order.

    The leading term of the error is gone; the next one is bounded like that of a method one order higher.
    """
    last = len(truth.position_derivatives) - 3  # the bound of order p needs derivatives up to p + 2
    scale = scales(scene, truth)
    upon = _upon_itself(truth, scale, order, step)
    return {name: Tol(bound.value + upon * scale.units[name], f"the leading term of the error extrapolated away: "
                                                              f"{bound.why}; that term upon itself {upon:.1e}")
            for name, bound in fixed_step(scene, truth, min(order + 1, last), step, eps=eps).items()}


def _upon_itself(truth: Reference, scale: Scales, order: int, step: float) -> float:
    """What the leading term of the error makes of itself and extrapolation leaves: (A T h^p)^2 max|y^(2p+2)| / 16.

    Errors of c h^(p+1) y^(p+1) a step, c at most 1/2, act on the motion twice as half their square, of which
    extrapolation from h and h/2 leaves half. Where truth has no derivative so high: the square of that of order p + 1,
    as for a motion at one rate.
    """
    grown = truth.amplification * float(truth.t[-1]) * step**order / 4.0
    if 2 * order + 3 < len(truth.position_derivatives):
        return grown**2 * derivative(truth, 2 * order + 2, scale)
    return (grown * derivative(truth, order + 1, scale)) ** 2


def adaptive(scene: Scene, truth: Reference, rtol: float, steps: int,
             amplification: float | None = None, eps: float = EPS) -> dict[str, Tol]:
    """Bounds of the errors per quantity for a method that keeps the error of each step below rtol times the state y.

    W is the rate of the scene's fastest spring or damper where that is larger: an error e of a position that oscillates
    at W is one of W e in its velocity. `amplification` replaces that of the truth.
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

    The energy and the momentum about the vertical are constants of the motion: the true motion carries an error of them
    along and magnifies nothing, so that where they are conserved the bounds are those with A = 1.
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


LEFT = 1e-9
"""Residual of Newton's iteration, relative to the forces of the motion, beyond which it has not ended: 64 bodies leave
as much. What an engine says that it leaves is believed up to here."""


def newton_left(scene: Scene, truth: Reference | None, said: float) -> float:
    """The residual that an engine says its Newton iteration leaves, as far as it is believed.

    Forces are those of the true motion; where there is no truth, all weights with ten times gravity.
    """
    weights = 10.0 * float(scene.masses.sum() * np.linalg.norm(scene.gravity))
    forces = weights if truth is None else max(
        weights, float(scene.masses.max() * truth.position_derivatives[2]),
        float(np.linalg.norm(scene.inertias, ord=2, axis=(1, 2)).max() * truth.attitude_derivatives[2]))
    return min(max(said, 0.0), LEFT * (1.0 + forces))


def held_level(scene: Scene, truth: Reference | None, level: str, newton: float = 0.0, eps: float = EPS) -> Tol:
    """Rounding level of a constraint level that the method holds by construction; without truth, of a pendulum.

    `newton`: what the engine's own iteration leaves.
    """
    tol = _held_level(scene, truth, level, eps)
    ended = 10 * newton
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
    """Farthest (m) from the origin that the scene's levers let a centre of mass come; from the scene alone."""
    levers = [np.linalg.norm(joint.child_anchor) + np.linalg.norm(joint.parent_anchor) for joint in scene.joints]
    return float(max(np.sum(levers), np.linalg.norm(scene.x0, axis=-1).max()))


def free_level(scene: Scene, truth: Reference, level: str, bounds: dict[str, Tol]) -> Tol | None:
    """Bound of a constraint level the method does not enforce; None where the bounds of the states imply none.

    The true motion satisfies the constraints, so a state within its bounds can miss them by no more than this.
    """
    scale = scales(scene, truth)
    x, r, v, w = (bounds[quantity].value for quantity in QUANTITIES)
    lever = max(1.0, scale.length)  # rows of the kind "two axes are perpendicular" are pure numbers
    if level == "position":
        return Tol(2 * (x + lever * r), "not enforced: two bodies meet at a joint, each within dx + s dR of truth")
    if level == "velocity":
        return Tol(2 * (v + lever * (w + scale.rate * r)),
                   "not enforced: two bodies meet at a joint, each within dv + s dw + s w dR of truth")
    return None


def vacuous(scene: Scene, truth: Reference, bounds: dict[str, Tol],
            conserved: dict[str, Tol] | None = None) -> frozenset[str]:
    """Kinds of findings whose bound exceeds the size of what it bounds, so that it would pass anything.

    `conserved`: the bounds that energy and momentum follow from; None: the others.
    """
    quiet = bounds if conserved is None else conserved
    scale = scales(scene, truth)
    found = {quantity for quantity, bound in bounds.items() if bound.value > scale.of(quantity)}
    sizes = {"energy": (energy(scene, truth, quiet), 1.0), "momentum": (momentum(scene, truth, quiet), scale.momentum),
             "level position": (free_level(scene, truth, "position", bounds), scale.length),
             "level velocity": (free_level(scene, truth, "velocity", bounds), scale.length * scale.rate)}
    return frozenset(found | {kind for kind, (bound, size) in sizes.items() if bound and bound.value > size})


def orthogonality(on_group: bool, steps: int, eps: float = EPS) -> Tol:
    """Bound of max |R^T R - I| over a run; `on_group` where the engine declares that it keeps to SO(3)."""
    if on_group:
        return Tol(ORTHOGONALITY * eps / EPS, "attitudes stay on the group by construction: rounding level")
    growth = max(ORTHOGONALITY * eps / EPS, 4 * eps * steps)
    return Tol(growth, f"rounding of one product a step, {steps} steps, never more than 4 eps each")


def order_margin(order: int) -> float:
    """How far below the documented order the observed one may lie."""
    return ORDER_MARGIN.get(order, ORDER_MARGIN_HIGH)


def rounding_levels(scene: Scene, truth: Reference) -> dict[str, tuple[float, float]]:
    """(a, b) per figure: rounding moves it by no more than a + b n^0.6 in n steps.

    On one machine the same code gives the same bits; another processor or library may round otherwise.

    Figures: the compared quantities in their units, "energy" over the largest kinetic energy, "momentum" in
    kg m^2/s. As `rounding`: the doubt of truth, and 50 eps (`grading`) times the size, magnified
    as the scene magnifies a perturbation.
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
