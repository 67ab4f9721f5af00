"""Fits of hypotheses to observed accelerations, one at a time and in pairs.

The residual z is the difference of observed and predicted accelerations, over the noise of the observed ones. A
hypothesis explains the observation if no entry of z is beyond `EXPLAINED`.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence

import numpy as np

from crosscheck.diagnosis.alterations import Alteration
from crosscheck.diagnosis.models import Accelerations, Model
from crosscheck.errors import CrosscheckError

EXPLAINED = 10.0
"""Largest |z| that noise may leave. The noise estimates the error of the limit to a factor of a few."""

SEEN = 30.0
"""Smallest |z| that counts as a difference. Between `EXPLAINED` and this nothing is decided."""

CLEAR = 0.1
"""Largest part of a difference that a cause may leave and still be named."""

NEAR = 1e3
"""Times `EXPLAINED` that a quick fit may leave and be fitted in full: it ends before the last digits."""

THIN = 3
"""The search uses one in so many instants, the full fit all of them."""

FAILS = (ArithmeticError, ValueError, LookupError, TypeError, CrosscheckError)
"""What an alteration may raise that makes no sense of a scene: it is left out."""

FAR = 1e15
"""Residual of magnitudes for which the equations have no solution."""

ORDERED = {"inertia point", "inertia frame"}
"""Kinds whose order matters in a pair: an inertia may be moved and then turned, or turned and then moved."""

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
    def mistakes(self) -> int:
        """Number of mistakes that lead to it."""
        return sum(cause.mistakes(theta) for cause, theta in zip(self.causes, self.theta, strict=True))

    @property
    def explains(self) -> bool:
        """Whether it leaves nothing but noise, and at most the part `CLEAR` of what was there."""
        return self.left <= self.most


class Data:
    """Observed accelerations of a scene and its copies, and the residuals of models with altered parameters."""

    def __init__(self, copies: Sequence[Copy], absent: int | None = None, soft: bool = False, quick: bool = False
                 ) -> None:
        self.copies, self.absent, self.soft, self.quick = copies, absent, soft, quick

    @property
    def right(self) -> list[Model]:
        """The models that are meant."""
        return [copy.right for copy in self.copies]

    @functools.cached_property
    def before(self) -> float:
        """The largest |z| of the models that are meant."""
        return float(np.abs(self.residual(self.right)).max())

    @property
    def most(self) -> float:
        """The largest |z| that a fit may leave."""
        return min(EXPLAINED, CLEAR * self.before)

    def residual(self, models: Sequence[Model]) -> np.ndarray:
        """The residual z of all copies in one vector."""
        parts = []
        for copy, model in zip(self.copies, models, strict=True):
            there = copy.accelerations
            z = (there.points.rates - there(model, self.soft)) / (copy.units * copy.noise)
            if self.absent is not None:
                z[:, self.absent] = 0.0
            if model.quadratic or model.coulomb:
                z[there.reversing(model.scene)] = 0.0
            parts.append(z.ravel())
        return np.concatenate(parts)

    def fit(self, causes: tuple[Alteration, ...], starts: Sequence[tuple[float, ...]] | None = None) -> Fit:
        """The best fit of a combination of causes from all combinations of `starts`; None: the starts of each cause."""
        from scipy.optimize import least_squares

        def residual(values: np.ndarray) -> np.ndarray:
            with np.errstate(all="ignore"):
                try:
                    z = self.residual(self._altered(causes, values))
                except FAILS:  # these magnitudes make no sense, the next ones may
                    return np.full(sum(copy.accelerations.points.rates.size for copy in self.copies), FAR)
            return np.clip(np.where(np.isfinite(z), z, FAR), -FAR, FAR)

        fits = []
        for choice in [starts] if starts is not None else itertools.product(*(cause.starts for cause in causes)):
            theta = np.concatenate([np.array(start, dtype=float) for start in choice])
            if len(theta) and self.quick:
                theta = gauss_newton(residual, theta)
            elif len(theta):
                theta = least_squares(residual, theta, method="lm", x_scale=np.maximum(np.abs(theta), 0.1), xtol=1e-13,
                                      ftol=1e-13, gtol=1e-13, max_nfev=30 * (len(theta) + 1)).x
            fits.append(self._judged(causes, theta))
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

    def _altered(self, causes: tuple[Alteration, ...], theta: np.ndarray) -> list[Model]:
        models, at = self.right, 0
        for cause in causes:
            models = [cause.apply(model, theta[at:at + cause.free]) for model in models]
            at += cause.free
        if not all(model.physical(right) for model, right in zip(models, self.right, strict=True)):
            raise ValueError("damping that drives a motion, or a mass that is none")
        return models

    def _judged(self, causes: tuple[Alteration, ...], theta: np.ndarray) -> Fit:
        parts = np.split(theta, np.cumsum([cause.free for cause in causes])[:-1])
        with np.errstate(all="ignore"):
            try:
                worst = float(np.abs(self.residual(self._altered(causes, theta))).max())
            except FAILS:
                return Fit(causes, tuple(parts), np.inf)
        return Fit(causes, tuple(parts), worst if np.isfinite(worst) else np.inf, self.most)


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


def search(full: Data, thin: Data, causes: Sequence[Alteration], pairing: bool = True) -> tuple[list[Fit], list[Fit]]:
    """(fits that explain, all fits of single causes). Pairs of causes are fitted only if no single one explains."""
    causes, last = [cause for cause in causes if not cause.last], [cause for cause in causes if cause.last]
    singles = [thin.fit((cause,)) for cause in causes]
    singles = [full.fit(each.causes, tuple(tuple(part) for part in each.theta))
               if each.left <= NEAR * EXPLAINED else each for each in singles]
    explaining = [full.simplest(fit) for fit in singles if fit.explains]
    if explaining or not pairing:
        return explaining, singles
    begin = {id(fit.causes[0]): fit.theta[0] for fit in singles}
    near = [each for each in singles if each.left <= SEEN]
    near = [each for each in near if each.left <= CLEAR * full.before]
    if near:  # what is left for a second cause is hardly more than noise
        return [full.simplest(each) for each in near], singles
    pairs = [pair for pair in itertools.combinations([cause for cause in causes if not cause.alone], 2)
             if pair[0].kind != pair[1].kind or (pair[0].target != pair[1].target and pair[0].target)]
    pairs += [(other, one) for one, other in pairs if {one.kind, other.kind} == ORDERED]
    alone: list[Fit] = []
    for one, other in pairs:
        best = thin.fit((one, other), (tuple(begin[id(one)]), tuple(begin[id(other)])))
        for start in _starts(one, other):
            if best.left <= EXPLAINED:
                break
            best = min(best, thin.fit((one, other), start), key=lambda fit: fit.left)
        if best.left <= NEAR * EXPLAINED:
            refined = full.fit((one, other), tuple(tuple(part) for part in best.theta))
            if refined.explains:
                explaining.append(full.simplest(refined))
                alone += _alone(full, refined)
    if not (alone or explaining):
        explaining = [each for each in (full.fit((cause,)) for cause in last) if each.explains]
    return alone or explaining, singles


def _starts(one: Alteration, other: Alteration) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Starts of a fit of a pair: every start of either cause with the first one of the other."""
    return [(start, other.starts[0]) for start in one.starts] + [(one.starts[0], start) for start in other.starts[1:]]


def _alone(full: Data, pair: Fit) -> list[Fit]:
    """Fits of single causes of a pair that explain: from the magnitudes of the pair a fit may get further."""
    fits = [full.fit((cause,), (tuple(theta),)) for cause, theta in zip(pair.causes, pair.theta, strict=True)]
    return [full.simplest(fit) for fit in fits if fit.explains]
