"""What a recording itself says of its noise, and the states in it: local polynomials in time, without a model."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import CubicSpline

ROWS, DEGREES = 12, (5, 7)
"""Rows of a window, and the degrees of the polynomials that are taken out of it, to measure noise."""

WINDOWS = 4000
"""Windows whose noise is averaged, over the whole recording."""

OF_STATE = 4
"""Degree of the polynomials that give states."""

HALVES, SOME = (4, 6, 9, 13, 19, 28, 41, 60, 88, 130, 190, 280, 410, 600, 880), 120
"""Rows in half of a window that are tried, and states by which it is chosen."""

WIDER = 1.1
"""Mean square of what a polynomial leaves, over that of the noise, up to which a window may grow, beyond chance."""

MORE = 2.0
"""Mean square of what a polynomial lacks, over that of what two degrees more change, which lack something as well."""

SHARED = 0.1
"""Noise of rates per noise of positions, over that of differences from row to row, above which they are differences."""

LAGS = 10
"""Rows over which noise may be correlated, or a quarter of half a window."""


@dataclasses.dataclass(frozen=True)
class Noise:
    """The noise of one column."""

    sigma: float  # standard deviation
    quantum: float  # step of an encoder or of printed digits; 0: none
    correlation: float = 1.0  # variance of a mean over that of as many independent values
    half: float = 0.0  # s, half of the window from which states are taken

    @property
    def said(self) -> str:
        """In words."""
        parts = [f"noise {self.sigma:.2g}"]
        if self.quantum > 0.3 * self.sigma:
            parts.append(f"steps of {self.quantum:.3g}")
        if self.correlation > 1.5:
            parts.append("filtered: neighbours are alike")
        return ", ".join(parts)


def measured(t: np.ndarray, y: np.ndarray) -> Noise:
    """The noise of values y at times t, (T,)."""
    count = len(y) // ROWS
    if count < 1:
        return Noise(0.0, 0.0)
    picked = np.unique(np.linspace(0, count - 1, WINDOWS).astype(int))
    rows = picked[:, None] * ROWS + np.arange(ROWS)
    tau = t[rows] - t[rows].mean(axis=1, keepdims=True)
    tau /= np.abs(tau).max(axis=1, keepdims=True)
    values, sizes = y[rows] - y[rows].mean(axis=1, keepdims=True), []
    for degree in DEGREES:  # the motion that a lower one leaves is no noise
        Q = np.linalg.qr(tau[..., None] ** np.arange(degree + 1))[0]
        left = values - np.einsum("wij,wkj,wk->wi", Q, Q, values)
        squares = np.sum(left**2, axis=1) / (ROWS - degree - 1)
        usual = squares[squares <= 16 * np.median(squares)] if np.median(squares) > 0 else squares
        sizes.append(float(usual.mean()))
    quantum = _quantum(y)
    return Noise(float(np.sqrt(max(min(sizes), quantum**2 / 12))), quantum)


def _quantum(y: np.ndarray) -> float:
    """The step of which all values are multiples; 0 if there is none."""
    values = np.unique(y[:20000])
    gaps = np.diff(values)
    if not len(gaps) or len(values) < 3:
        return 0.0
    least = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    ratio = (values - values[0]) / least
    rounded = np.abs(ratio - np.round(ratio)).max() < 0.02 + 1e-9 * ratio.max()
    return least if rounded and least > 1e-9 * np.abs(values).max() else 0.0


def of_rates(t: np.ndarray, q: np.ndarray, sigma: float, r: np.ndarray, sure: float) -> tuple[Noise | None, str]:
    """(the noise of rates r (T,) of positions q (T,) with noise sigma, None where it is not their own; what they are).

    Without a model: positions are the integral of rates, but for a delay, a factor and an offset of these. Such beyond
    `sure` standard deviations, neighbours that are alike, and noise that positions share are not a rate's own.
    """
    noise = measured(t, r)
    if len(t) < 4 * ROWS or not noise.sigma > 0.0:
        return None, "not told from differences"
    h = float(np.median(np.diff(t)))
    for many in (4 * ROWS, 2 * ROWS, ROWS):  # in which polynomials leave no more of positions than noise
        Q = np.linalg.qr(np.linspace(-1.0, 1.0, many)[:, None] ** np.arange(DEGREES[1] + 1))[0]
        white = np.eye(many) - Q @ Q.T  # what is left of white noise, in which neighbours are alike as well
        positions, rates = (each[:len(t) // many * many].reshape(-1, many) @ white for each in (q, r))
        count = len(rates) * float(np.trace(white))
        if np.sum(positions**2) <= WIDER * sigma**2 * count:
            break
    sizes = [float(np.sqrt(np.sum(part**2))) or 1.0 for part in (positions, rates)]
    most = sure / np.sqrt(count)
    for lag in (-1, 0, 1):
        one, other = (part[:, max(sign * lag, 0):many + min(sign * lag, 0)]
                      for sign, part in ((1, positions), (-1, rates)))
        alike = abs(float(np.sum(one * other)))  # a controller moves by noise as well, but far less in one row
        if alike > most * sizes[0] * sizes[1] and alike > SHARED * sizes[0] ** 2 / h:
            return None, "differences of positions, whose noise they share"
    for lag in range(1, ROWS // 2):
        alike = float(np.sum(rates[:, lag:] * rates[:, :-lag])) / sizes[1] ** 2
        if alike - float(np.trace(white, lag) / np.trace(white)) > most:
            return None, "filtered, or without noise: neighbours are alike"
    whole = CubicSpline(t, r).antiderivative()(t)
    many = max(int(BLOCK / h), 20)
    every = np.stack([r, whole, t, q - whole], axis=1)[:max(len(t) // many, 1) * many]
    blocks = every.reshape(-1, min(many, len(every)), 4)  # what noise has summed up before is a constant in each
    every = (blocks - blocks.mean(axis=1, keepdims=True)).reshape(-1, 4)
    A, y = every[:, :3], every[:, 3]
    spread = sigma**2 + noise.sigma**2 * h**2 * many**2 / 3  # the sum of the noise of rates is alike in all of a block
    inverse = np.linalg.pinv(A.T @ A)
    found = inverse @ (A.T @ y)
    beyond = np.abs(found) / np.sqrt(spread * np.diag(inverse) + 1e-300)
    if beyond.max() > sure:
        k = int(np.argmax(beyond))
        return None, ("late by {:.2g} s", "scaled by {:.4g}", "off by {:.2g}")[k].format(
            (found[0], 1.0 / (1.0 + found[1]), -found[2])[k])
    return noise, "measured on their own"


BLOCK = 0.5
"""s over which rates are integrated and compared with positions."""


def states(t: np.ndarray, y: np.ndarray, at: np.ndarray, noise: Noise, within: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray, Noise]:
    """(value and rate (S, 2) at times (S,), their covariances (S, 2, 2), the noise with its window and correlation),
    from rows within (S, 2) s.

    The window is the one in which noise and what two degrees more change, all but the noise, leave the least of rates,
    among those in which polynomials leave the noise and no more.
    """
    h, best = float(np.median(np.diff(t))), None
    parts = [(at[:-1] + part * np.diff(at), within[:-1]) for part in np.linspace(0.0, 1.0, 1 + SOME // len(at))[1:-1]]
    probes, rooms = (np.concatenate(each) for each in zip((at, within), *parts, strict=True))
    some = np.flatnonzero(probes <= rooms[:, 1])
    some = some[np.unique(np.linspace(0, len(some) - 1, SOME).astype(int))]
    probes, rooms = probes[some], rooms[some]
    for rows in HALVES:
        half = (rows + 0.5) * h
        fits = [_fit(t, y, *each, half) for each in zip(probes, rooms, strict=True)]
        free = np.array([max(len(r) - OF_STATE - 1, 1) for *_, r in fits])
        chance = 1.0 + 3.0 * np.sqrt(2.0 * np.mean(1.0 / free) / len(free))
        if best and np.mean([r @ r for *_, r in fits] / free) > WIDER * chance * noise.sigma**2:
            break
        bias = _bias(fits, [_fit(t, y, *each, half, OF_STATE + 2) for each in zip(probes, rooms, strict=True)],
                     noise.sigma**2)
        leaves = noise.sigma**2 * float(np.mean([spread[1, 1] for _, spread, _ in fits])) + bias[1]
        if best is None or leaves < best[0]:
            best = leaves, rows, [r for *_, r in fits], bias
    assert best is not None
    _, rows, left, bias = best
    total = sum(float(r @ r) for r in left) or 1.0
    alike = [sum(float(r[k:] @ r[:-k]) for r in left if len(r) > k) / total for k in range(1, max(LAGS, rows // 4) + 1)]
    sure = 3 / np.sqrt(sum(map(len, left)))
    noise = dataclasses.replace(noise, half=(rows + 0.5) * h,
                                correlation=1.0 + 2.0 * sum(each for each in alike if each > sure))
    values, spreads, _ = zip(*(_fit(t, y, *each, noise.half) for each in zip(at, within, strict=True)), strict=True)
    return np.array(values), noise.sigma**2 * noise.correlation * np.array(spreads) + np.diag(bias), noise


OfState = tuple[np.ndarray, np.ndarray, np.ndarray]


def _bias(fits: list[OfState], others: list[OfState], size: float) -> np.ndarray:
    """(2,) mean squares of what values and rates of polynomials lack, by those of two degrees more, without noise."""
    off = np.array([one[0] - other[0] for one, other in zip(fits, others, strict=True)]) ** 2
    more = [np.diag(other[1] - one[1]) for one, other in zip(fits, others, strict=True)]
    return np.asarray(MORE * np.maximum(np.mean(off, axis=0) - size * np.mean(more, axis=0), 0.0))


def _fit(t: np.ndarray, y: np.ndarray, at: float, within: np.ndarray, half: float, degree: int = OF_STATE
         ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(value and rate, their covariance for noise of one, what is left) of a polynomial around a time."""
    low, high = np.searchsorted(t, within + np.array([0.0, 1e-9 * half]))
    begin, end = np.clip(np.searchsorted(t, [at - half, at + half]), low, high)
    while end - begin < OF_STATE + 5 and (begin > low or end < high):
        begin, end = max(begin - 1, low), min(end + 1, high)
    tau = (t[begin:end] - at) / half
    A = tau[:, None] ** np.arange(min(degree, end - begin - 1) + 1)
    Q, R = np.linalg.qr(A)
    inverse = np.linalg.inv(R)
    c = inverse @ (Q.T @ y[begin:end])
    scale = np.array([1.0, 1.0 / half])
    return c[:2] * scale, (inverse @ inverse.T)[:2, :2] * np.outer(scale, scale), y[begin:end] - A @ c
