"""Numbers of steps between two output times at which an engine is asked."""

from __future__ import annotations

from math import gcd

FEWEST = 6
"""Fewest steps between two outputs with two coarser numbers, near a half and a quarter, without a common divisor."""


def counts(n: int, multiple: int = 1, finer: bool = False) -> tuple[int, int, int]:
    """Three numbers of steps in one interval between outputs, the most first, from the `n` of a run.

    Coarser ones, near n / 2 and n / 4, have no divisor in common with n or with each other: of steps that are nested
    an event shortly before a common time is equally late in all. Below six, or if `finer`, they are n, 2n + 1, 4n + 1.
    `multiple`: what all have to be multiples of, as a sampled servo wants; they are nested then.
    """
    base = max(1, n // multiple)
    if base < FEWEST or finer:
        return multiple * (2 * 2 * base + 1), multiple * (2 * base + 1), multiple * base
    half = _coprime(base / 2, base - 1, (base,))
    return multiple * base, multiple * half, multiple * _coprime(base / 2 / 2, half - 1, (base, half))


def finer(n: int, multiple: int = 1) -> int:
    """The number of steps that refines n: 2n + 1, which has no divisor in common with it."""
    return multiple * (2 * (n // multiple) + 1)


def _coprime(near: float, most: int, others: tuple[int, ...]) -> int:
    """The number up to `most` nearest `near` that has no divisor in common with the others."""
    fit = [k for k in range(1, most + 1) if all(gcd(k, other) == 1 for other in others)]
    return min(fit, key=lambda k: (abs(k - near), -k))
