"""Whether derivatives of a source are right, and if not, what is wrong with them.

An analytic source is right to rounding times conditioning, or wrong; a finite difference is right to its documented
order in its step. Each cause is the truth with one mistake; the cause is the one that leaves nothing of the difference.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.errors import EngineError, Unsupported
from crosscheck.jointspace.derivatives import Derivatives, of, tangent_space, truth
from crosscheck.jointspace.motion import NONE, JointSpace, TreeSpace, placed, responses
from crosscheck.jointspace.sources import GIVEN, Blocks, acceleration, allowed, condition, taken
from crosscheck.scene import mechanics
from crosscheck.scene.alterations import FAILS, alterations
from crosscheck.scene.altered import of_scene
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import relative, starting
from crosscheck.scene.model import Scene
from crosscheck.scene.starts import started

DIFFERENCE = 1e-3
"""Step by which derivatives are differentiated again, rad or m and per second."""

MOST_DIGITS, WHOLE = 1e9, 1e-3
"""Differences with a small step, in last digits of the accelerations, and how far they may be from whole numbers."""

LINEAR = 0.1  # part by which an error may miss ten times, or a tenth of, that with a tenth of, or ten times its step

WRONG = 1e-5
"""Part of the largest acceleration by which those of an engine are wrong; Exudyn's rows have rounding of 1e-7."""

AMPLIFIED = 100.0
"""Ratio of the errors of derivatives to those of accelerations above which these do not explain them."""

EXPLAINED = 0.02
"""Part of a difference that may be left of it once the cause is in the truth, besides the bound."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Derivatives of one source against truth, each error relative to the block's size; "tangent" on closed loops."""

    source: str
    errors: dict[str, float]
    bound: float
    right: bool
    cause: str = ""  # of wrong ones, "" where none is found


def judge(scene: Scene, source: object, exact: Derivatives | None = None) -> Verdict:
    """The verdict on a source at the start of a scene; errors as of `crosscheck.derivatives`."""
    exact = exact or truth(scene)
    if exact.da_dq is None:
        return _on_loops(scene, source, exact.error)
    given = of(scene, source)
    sizes = scales(exact)
    errors = {name: float(np.abs(values - exact.blocks[name]).max() / sizes[name])
              for name, values in given.blocks.items()}
    bound = float(max(given.error, exact.error))
    wrong = {name: given.blocks[name] for name, error in errors.items() if not error <= bound}
    cause = (wrong and (cause_of(scene, exact, wrong, bound) or _of_its_own(
            scene, source, given.source, max(errors.values()), exact))) or ""
    return Verdict(given.source, errors, bound, not wrong, cause)


def _on_loops(scene: Scene, source: object, known: float) -> Verdict:
    """The verdict where joints close loops: accelerations by the directions in which the joints let the scene move."""
    exact = tangent_space(scene)
    if not exact.a.size:
        raise Unsupported(f"{scene.name!r} has no joint coordinates in which sources give derivatives")
    size = max(float(np.abs(exact.a).max()), 1e-300)

    def apart(source: object) -> tuple[str, Blocks, Callable[[np.ndarray], float]]:
        label, blocks = taken(scene, source, exact.changes)
        rows = np.arange(len(exact.a)) if blocks.rows is None else blocks.rows
        given = blocks.da_dq if blocks.rows is None else blocks.da_dq @ exact.q[rows] + blocks.da_dv @ exact.v[rows]
        return label, blocks, lambda other: float(np.abs(given - other[rows]).max() / size)

    label, blocks, off = apart(source)
    count = exact.changes.shape[1] // 2
    motions = np.linalg.svd(exact.changes[:6 * scene.n])[0][:, :count]
    mass = motions.T @ mechanics.mass_matrix(scene) @ motions
    rows = Constraints(scene).jacobian(scene.x0[None], scene.R0[None])[0]
    sizes = np.linalg.svd(rows @ mechanics.inverse_mass(scene) @ rows.T, compute_uv=False)
    worst = max(condition(mass), float(sizes[0] / sizes[sizes > NONE * sizes[0]].min()))
    rate = float(max(np.abs(scene.v0).max(), np.abs(scene.w0).max()))
    bound, error, cause = max(allowed(blocks, size, worst, rate), known), off(exact.a), ""
    if not error <= bound and blocks.order == 1 and isinstance(source, str):  # no mistake of a model grows with a step
        others = (apart(f"{label.partition('@')[0]}@{blocks.eps * k:g}")[-1](exact.a) / k for k in (0.1, 10.0))
        if any(abs(other / error - 1) < LINEAR for other in others):
            cause = f"forward differences of soft loops: their error is {error / blocks.eps:.0e} times their step"
    if not error <= bound and not cause:
        cause = next((words for words, changed in itertools.chain([("the sign is reversed", -exact.a)], (
            (words, tangent_space(each).a) for words, each in _models(scene)))
            if off(changed) <= bound + EXPLAINED * error), "")
    if not error <= bound and not cause:
        cause = _of_its_own(scene, source, label, error)
    return Verdict(label, {"tangent": error}, bound, error <= bound, cause)


def scales(exact: Derivatives) -> dict[str, float]:
    """Sizes of the blocks; a rate counts as the root of a stiffness, where dampers and spins are absent."""
    assert exact.da_dq is not None
    assert exact.da_dv is not None
    assert exact.da_dtau is not None
    stiff, slow, light = (float(np.abs(part).max()) for part in (exact.da_dq, exact.da_dv, exact.da_dtau))
    return {"da_dq": max(stiff, slow**2, 1e-300), "da_dv": max(slow, np.sqrt(stiff), 1e-300), "da_dtau": light}


def cause_of(scene: Scene, exact: Derivatives, wrong: dict[str, np.ndarray], bound: float) -> str:
    """What is wrong with the wrong blocks, in words; "" if no known mistake explains it."""
    sizes = scales(exact)
    apart = {name: float(np.abs(values - exact.blocks[name]).max()) for name, values in wrong.items()}
    best, least = "", EXPLAINED
    for words, changed in itertools.chain(_algebra(scene, exact), _altered(scene), _steps(scene, exact, wrong)):
        if not wrong.keys() <= changed.keys():
            continue
        left = max((float(np.abs(values - changed[name]).max()) - bound * sizes[name]) / apart[name]
                   for name, values in wrong.items())
        if left <= least:
            best, least = f"{words} ({', '.join(wrong)})", left
        if left <= 0.0:  # to the digits that are known
            break
    return best


def _of_its_own(scene: Scene, source: Any, label: str, error: float, exact: Derivatives | None = None) -> str:
    """What the accelerations of the engine itself say, where no known mistake explains its derivatives."""
    name, _, way = label.partition(":")
    with contextlib.suppress(Unsupported, EngineError):
        said = acceleration(scene, adapters.get(source if name not in adapters.names() else name))
        true = np.real(responses(scene, TreeSpace(scene).start.states, True)[0])
        off = float(np.abs(said - true).max() / max(1.0, np.abs(true).max()))
        if off > max(WRONG, error / AMPLIFIED):
            return f"its accelerations are wrong themselves, by {off:.2g} of the largest"
        if way in GIVEN and judge(scene, f"{name}:differences", exact).right:
            composite = [joint.name for joint in scene.joints if len(joint.kind.motion) > 1 and name == "pinocchio"]
            return "they are not the derivatives of its own accelerations, whose differences are right" + (
                f"; joint {composite[0]!r} is a JointModelComposite, whose axes turn against each other" if composite
                else "")
    return ""


Mistakes = Iterator[tuple[str, dict[str, np.ndarray]]]
"""Each known mistake and the blocks that it would give."""


def _models(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Scenes with magnitudes that have a name, such as none or the other sign, and one whose state is another one."""
    right = of_scene(scene)
    for cause in alterations(scene):
        for special in cause.special(np.array(cause.starts[0])):
            theta = np.array(special)
            with contextlib.suppress(*FAILS):
                if (made := cause.apply(right, theta).as_scene) is not None:
                    yield f"{cause.name(theta)}: {cause.words(theta)}", made
    yield "gravity counts twice", scene.replace(gravity=2 * scene.gravity)
    yield "the rates are left out", started(scene, scene.x0, scene.R0, 0.0 * scene.v0, 0.0 * scene.w0)


def _altered(scene: Scene) -> Mistakes:
    """The blocks of such scenes."""
    at_zero = ("it is taken at zero coordinates", placed(scene, 0 * (speeds := JointSpace(scene).rates), speeds))
    for words, changed in (*_models(scene), at_zero):
        with contextlib.suppress(*FAILS):
            space = JointSpace(changed)
            da_dq, da_dv = space.derivative(space.accelerations)
            yield words, {"da_dq": da_dq, "da_dv": da_dv, "da_dtau": np.linalg.inv(space.mass)}


def _algebra(scene: Scene, exact: Derivatives) -> Mistakes:
    """The matrices are those of the truth, but in another form."""
    blocks = {name: exact.blocks[name] for name in ("da_dq", "da_dv", "da_dtau")}
    da_dq, da_dv, da_dtau = blocks.values()
    names, one = exact.coordinates, np.eye(len(exact.coordinates))
    turns, spins, balls = _bases(scene)
    yield "the sign is reversed", {name: -values for name, values in blocks.items()}
    for words, change in (("rows and columns are exchanged", np.transpose), ("the lower triangle is left out", np.triu),
                          ("the upper triangle is left out", np.tril), ("only the symmetric part is given", _symmetric),
                          ("the order of the coordinates is reversed", lambda values: values[::-1, ::-1])):
        yield words, {name: change(values) for name, values in blocks.items()}
    yield "da_dq and da_dv are exchanged", {"da_dq": da_dv, "da_dv": da_dq}
    yield "it is the mass matrix, not its inverse", {"da_dtau": np.linalg.inv(da_dtau)}
    yield "it is the derivative of the inverse dynamics", {
        name: -np.linalg.solve(da_dtau, values) for name, values in blocks.items()}
    for k, name in enumerate(names):
        flip = one - 2 * np.outer(one[k], one[k])
        yield f"coordinate {name!r} has the other sign", {key: flip @ each @ flip for key, each in blocks.items()}
    for j, k in itertools.combinations(range(len(names)), 2):
        swap = one[[k if i == j else j if i == k else i for i in range(len(names))]]
        yield f"coordinates {names[j]!r} and {names[k]!r} are exchanged", {
            key: swap @ each @ swap.T for key, each in blocks.items()}
    if balls.any():
        for words, left, right in (("small turns of balls are taken in the parent's axes", turns, turns),
                                   ("the rows of balls are in the parent's axes", turns, one),
                                   ("the columns of balls are by turns in the parent's axes", one, turns)):
            yield words, {name: left @ values @ right.T for name, values in blocks.items()}
        yield "it is by the vector part of the balls' quaternions", {
            "da_dq": da_dq * (1 + balls), "da_dv": da_dv * (1 + balls)}
        yield "da_dq is taken at rates that are fixed in other axes", blocks | {"da_dq": da_dq + da_dv @ spins}


def _symmetric(values: np.ndarray) -> np.ndarray:
    return np.asarray((values + values.T) / 2)


def _steps(scene: Scene, exact: Derivatives, wrong: dict[str, np.ndarray]) -> Mistakes:
    """A factor, or differences whose step is too small or too large, fitted to the first wrong block."""
    space = JointSpace(scene)
    name, values = next(iter(wrong.items()))
    factor = float(np.sum(values * exact.blocks[name]) / np.sum(exact.blocks[name] ** 2))
    yield f"it is {factor:.10g} times as large", {key: factor * each for key, each in exact.blocks.items()}
    a = np.real(space.accelerations(space.start))
    for step in (10.0**-k for k in range(14, 6, -1)):  # they are whole numbers of the last digit of the accelerations
        with np.errstate(over="ignore"):  # of an acceleration that is 0
            digits = values * step / np.spacing(np.abs(a))[:, None]
        if np.abs(digits).max() < MOST_DIGITS and np.abs(digits - digits.round()).max() < WHOLE:
            yield f"differences with a step of {step:.0e}, which leaves nothing but rounding", wrong
    by_q, by_v, inertial = (np.zeros((2, space.size, space.size)) for _ in range(3))
    for k, row in enumerate(np.eye(space.size)):
        for part, made in enumerate((by_q, by_v)):
            shift = np.outer(np.eye(2)[part], DIFFERENCE * row)
            near = [JointSpace(space.moved(*each)) for each in (shift, -shift)]
            inertial[part, :, k] = (near[0].mass - near[1].mass) @ a / (2 * DIFFERENCE)
            slopes = [each.derivative(each.accelerations)[part][:, k] for each in near]
            made[:, :, k] = ((slopes[0] - slopes[1]) / (2 * DIFFERENCE),
                             (slopes[0] - 2 * exact.blocks[("da_dq", "da_dv")[part]][:, k] + slopes[1]) / DIFFERENCE**2)
    yield "the change of the mass matrix with position is left out", exact.blocks | {
        "da_dq": exact.blocks["da_dq"] + exact.blocks["da_dtau"] @ inertial[0]}
    for order, words in enumerate(("forward", "central")):
        curved = {"da_dq": by_q[order], "da_dv": by_v[order]}
        if name in curved and curved[name].any():
            size = float(np.sum((values - exact.blocks[name]) * curved[name]) / np.sum(curved[name] ** 2))
            step = abs((2.0, 6.0)[order] * size) ** (1.0 / (order + 1))
            yield f"{words} differences with a step of {step:.1e}, which is too large", {
                key: exact.blocks[key] + size * each for key, each in curved.items()}


def _bases(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turns of the coordinates of balls from child to parent axes, their rates as matrices w x (.), and where they are.
    """
    space, start = JointSpace(scene), starting(scene)
    turns, spins = np.eye(space.size), np.zeros((space.size, space.size))
    balls = np.zeros(space.size)
    for link in space.links:
        own = space.own[link.body]
        if link.joint is not None and link.joint.kind.is_ball:
            balls[own] = 1.0
            turns[own, own] = relative(link.joint, start).turn[0]
            spins[own, own] = np.cross(space.rates[own], np.eye(3)).T
    return turns, spins, balls
