"""One fit of alterations to what an engine shows, and one search: the best, then the next on what it leaves.

What is shown is a residual z over its noise: of accelerations, a motion, joint coordinates, a reading or derivatives.
Alterations explain it if no entry of z is beyond `EXPLAINED`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from crosscheck.errors import OutOfTime, check_time
from crosscheck.scene.alterations import FAILS, Alteration
from crosscheck.scene.altered import Accelerations, Model

EXPLAINED = 10.0
"""Largest |z| that noise may leave. The noise estimates the error of the limit to a factor of a few."""

SEEN = 30.0
"""Smallest |z| that counts as a difference. Between `EXPLAINED` and this nothing is decided."""

CLEAR = 0.1
"""Largest part of a difference that a cause may leave and still be named."""

PART = 0.5
"""Largest part of a difference that a cause may leave and still be said to explain a part of it."""

ALTERNATIVES = 4
"""Most explanations of equal simplicity that are named together. More of them name nothing."""

BEST = 8
"""Number of single alterations, from the best on, to which a second one is added."""

FAR = 1e15
"""Residual of magnitudes for which the equations have no solution."""

ORDERED = {"inertia point", "inertia frame"}
"""Causes whose order matters in a pair: an inertia may be moved and then turned, or turned and then moved."""

ITERATIONS, GIVE_UP, DIFFERENCE = 10, 0.97, 1e-6
"""Of the quick fits: the largest number of steps, the ratio of residuals above which they end, and the relative width
of difference quotients."""


@dataclasses.dataclass
class Copy:
    """What an engine shows of one copy of a scene, whose model is meant to be `right`."""

    right: Model
    accelerations: Accelerations  # of models, at the states that were observed
    noise: float  # of the normalised accelerations
    units: np.ndarray  # (6,) by which accelerations are divided


@dataclasses.dataclass
class Fit:
    """A combination of causes with its magnitudes and the residual that it leaves."""

    causes: tuple[Alteration, ...]
    theta: tuple[np.ndarray, ...]
    left: float  # max |z|
    most: float = EXPLAINED  # max |z| that it may leave

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes, sorted."""
        return tuple(sorted({cause.name(theta) for cause, theta in zip(self.causes, self.theta, strict=True)}))

    @property
    def words(self) -> str:
        """The causes with their magnitudes."""
        return "; ".join(cause.words(theta) for cause, theta in zip(self.causes, self.theta, strict=True))

    @property
    def mistakes(self) -> int:
        """Number of mistakes that lead to it."""
        return sum(cause.mistakes(theta) for cause, theta in zip(self.causes, self.theta, strict=True))

    @property
    def magnitudes(self) -> int:
        """Number of fitted numbers. Special magnitudes do not count."""
        return sum(cause.magnitudes(theta) for cause, theta in zip(self.causes, self.theta, strict=True))

    @property
    def explains(self) -> bool:
        """Whether it leaves nothing but noise, and at most the part `CLEAR` of what was there."""
        return self.left <= self.most


def simplest(fits: Sequence[Fit]) -> list[Fit]:
    """Of fits that explain, those with the fewest mistakes, and of these those with the fewest fitted numbers."""
    fits = [each for each in fits if each.mistakes == min(other.mistakes for other in fits)]
    return [each for each in fits if each.magnitudes == min(other.magnitudes for other in fits)]


class Case:
    """Something that an engine shows, and the residual z that alterations of what is right leave of it."""

    dear = False
    """Whether residuals cost so much that a fit begins at the best start alone, and ends early."""

    def residual(self, causes: Sequence[Alteration], theta: Sequence[np.ndarray]) -> np.ndarray:
        """z, one vector. It may raise any of `FAILS` for magnitudes that make no sense."""
        raise NotImplementedError

    @functools.cached_property
    def size(self) -> int:
        """Number of entries of z."""
        return self.residual((), ()).size

    @functools.cached_property
    def before(self) -> float:
        """The largest |z| without alterations."""
        return float(np.abs(self.residual((), ())).max())

    @property
    def most(self) -> float:
        """The largest |z| that a fit may leave."""
        return min(EXPLAINED, CLEAR * self.before)

    def _finite(self, causes: Sequence[Alteration], values: np.ndarray) -> np.ndarray:
        check_time()
        parts = np.split(values, np.cumsum([cause.free for cause in causes])[:-1])
        with np.errstate(all="ignore"):
            try:
                z = self.residual(causes, parts)
            except FAILS:  # these magnitudes make no sense, the next ones may
                return np.full(self.size, FAR)
        return np.clip(np.where(np.isfinite(z), z, FAR), -FAR, FAR)

    def fit(self, causes: tuple[Alteration, ...], starts: Sequence[tuple[float, ...]] | None = None) -> Fit:
        """The best fit of a combination of causes from all combinations of `starts`; None: the starts of each cause."""
        residual = functools.partial(self._finite, causes)
        choices = [np.concatenate([np.array(start, dtype=float) for start in choice]) for choice in (
            [starts] if starts is not None else itertools.product(*(cause.starts for cause in causes)))]
        fits = []
        if self.dear:
            choices += [np.array(special) for cause in causes[:1] for special in cause.special(choices[0])]
            fits = [self._judged(causes, theta) for theta in choices]
            least = min(fits, key=lambda fit: fit.left)
            choices = [np.concatenate(least.theta)] if 1.0 < least.left < self.before else []
        fits += [self._judged(causes, gauss_newton(residual, theta) if len(theta) else theta) for theta in choices]
        return min(fits, key=lambda fit: fit.left)

    def simplest(self, fit: Fit) -> Fit:
        """The fit with special magnitudes, such as none or the opposite sign, if these explain the observation, too.

        Noise lets a fit end beside them, but the name of a cause depends on them.
        """
        for k, cause in enumerate(fit.causes):
            for special in cause.special(fit.theta[k]):
                parts = [*fit.theta[:k], np.array(special), *fit.theta[k + 1:]]
                trial = self._judged(fit.causes, np.concatenate(parts))
                if trial.explains:
                    fit = trial
                    break
        return fit

    def _judged(self, causes: tuple[Alteration, ...], theta: np.ndarray) -> Fit:
        parts = np.split(theta, np.cumsum([cause.free for cause in causes])[:-1])
        worst = float(np.abs(self._finite(causes, theta)).max())
        return Fit(causes, tuple(parts), worst if worst < FAR else np.inf, self.most)


class Data(Case):
    """Observed accelerations of a scene and its copies, beside those of models."""

    def __init__(self, copies: Sequence[Copy], absent: int | None = None, soft: bool = False) -> None:
        self.copies, self.absent, self.soft = copies, absent, soft

    def residual(self, causes: Sequence[Alteration], theta: Sequence[np.ndarray]) -> np.ndarray:
        """Of all copies."""
        parts = []
        for copy in self.copies:
            model = altered(copy.right, causes, theta)
            there = copy.accelerations
            z = (there.points.rates - there(model, self.soft)) / (copy.units * copy.noise)
            if self.absent is not None:
                z[:, self.absent] = 0.0
            if model.quadratic or model.coulomb:
                z[there.reversing(model.scene)] = 0.0
            parts.append(z.ravel())
        return np.concatenate(parts)


def altered(right: Model, causes: Sequence[Alteration], theta: Sequence[np.ndarray]) -> Model:
    """The model after these alterations of its scene. Raises ValueError if it is not physical."""
    model = right
    for cause, part in zip(causes, theta, strict=True):
        model = cause.apply(model, part)
    if not model.physical(right):
        raise ValueError("damping that drives a motion, or a mass that is none")
    return model


def gauss_newton(residual: Callable[[np.ndarray], np.ndarray], theta: np.ndarray) -> np.ndarray:
    """A few Gauss-Newton steps that end as soon as they gain little, since most hypotheses soon prove wrong."""
    z = residual(theta)
    size = float(np.linalg.norm(z))
    for _ in range(ITERATIONS):
        widths = DIFFERENCE * np.maximum(np.abs(theta), 1.0)
        columns = [(residual(theta + width * unit) - z) / width
                   for width, unit in zip(widths, np.eye(len(theta)), strict=True)]
        change = np.linalg.lstsq(np.column_stack(columns), -z, rcond=None)[0]
        for part in (1.0, 0.4, 0.1):
            trial = residual(theta + part * change)
            new = float(np.linalg.norm(trial))
            if new < size:
                break
        else:
            return theta
        theta, z, gain, size = theta + part * change, trial, new / size, new
        if gain > GIVE_UP or float(np.abs(z).max()) <= 1.0:
            return theta
    return theta


def search(case: Case, causes: Sequence[Alteration], pairing: bool = True) -> tuple[list[Fit], list[Fit]]:
    """(fits that explain, all other fits of single causes and the best of several), as far as the time goes.

    Only if no single cause explains, a second one is added to each of the `BEST`. Where no pair does, a third one is
    added to the best pair, and to the next ones if that explains nothing, and so on, as long as it gains anything. No
    two of three or more causes alter the same body: together they would stand for any inertia.
    """
    explaining: list[Fit] = []
    tried: list[Fit] = []
    with contextlib.suppress(OutOfTime):
        for cause in causes:
            if not cause.last:
                tried.append(case.fit((cause,)))
        explaining = [case.simplest(fit) for fit in tried if fit.explains]
        if explaining or not pairing:
            return explaining, tried
        if near := [each for each in tried if each.left <= SEEN and each.left <= CLEAR * case.before]:
            return [case.simplest(each) for each in near], tried  # hardly more than noise is left for a second cause
        singles = sorted((each for each in tried if not each.causes[0].alone), key=lambda each: each.left)
        explaining, grown = _grown(case, singles[:BEST], singles)
        if not explaining:
            explaining = [each for each in (case.fit((cause,)) for cause in causes if cause.last) if each.explains]
        before = singles
        while grown and not explaining and grown[0].left <= GIVE_UP * before[0].left:
            tried.append(grown[0])
            before, grown = grown, []
            for base in before[:BEST]:
                explaining, more = _grown(case, [base], singles)
                grown = sorted([*grown, *more], key=lambda each: each.left)
                if explaining:
                    break
    return explaining, tried


def _grown(case: Case, bases: Sequence[Fit], singles: Sequence[Fit]) -> tuple[list[Fit], list[Fit]]:
    """(fits of one cause more than bases that explain, or of fewer causes from their magnitudes; all fits, best first).
    """
    explaining, fewer, fits = list[Fit](), list[Fit](), list[Fit]()
    done = set[frozenset[int]]()
    for base, single in itertools.product(bases, singles):
        other, = single.causes
        ids = frozenset(map(id, (*base.causes, other)))
        if ids in done or any((other.cause == each.cause and (other.target == each.target or not other.target)) or (
                len(base.causes) > 1 and other.overlaps(each)) for each in base.causes):
            continue
        done.add(ids)
        matters = any({other.cause, each.cause} == ORDERED for each in base.causes)
        for causes in ((*base.causes, other), *([(other, *base.causes)] if matters else [])):
            best = None
            for begin in _starts(base, single):
                each = case.fit(causes, [begin[id(cause)] for cause in causes])
                best = each if best is None or each.left < best.left else best
                if best.left <= EXPLAINED:
                    break
            assert best is not None
            fits.append(best)
            if best.explains:
                explaining.append(case.simplest(best))
                fewer += [case.simplest(fit) for fit in _without_one(case, best) if fit.explains]
    return fewer or explaining, sorted(fits, key=lambda fit: fit.left)


def _starts(base: Fit, single: Fit) -> Iterator[dict[int, tuple[float, ...]]]:
    """Where the fit of one cause more than a base begins, by cause: at what was found, then at the starts."""
    found = {id(cause): tuple(theta) for cause, theta in zip(base.causes, base.theta, strict=True)}
    one, other, pair = base.causes[0], single.causes[0], len(base.causes) == 1
    if pair:
        yield found | {id(other): tuple(single.theta[0])}
        yield from ({id(one): start, id(other): other.starts[0]} for start in one.starts)
        found = {id(one): one.starts[0]}
    yield from (found | {id(other): start} for start in other.starts[1 if pair else 0:])


def _without_one(case: Case, fit: Fit) -> Iterator[Fit]:
    """Fits of all but one of the causes, from their magnitudes."""
    for kept in itertools.combinations(range(len(fit.causes)), len(fit.causes) - 1):
        yield case.fit(tuple(fit.causes[k] for k in kept), tuple(tuple(fit.theta[k]) for k in kept))
