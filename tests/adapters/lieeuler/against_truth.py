"""Errors of runs against crosscheck's independent truth, for the tests of the higher-order methods."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

import crosscheck
import lieeuler
from crosscheck import references
from crosscheck.adapters.lieeuler import build_problem
from tests.lieeuler.accuracy import QUANTITIES, slopes


def library(name):
    """A scene of the library as a problem."""
    return build_problem(crosscheck.load_scene(name))


@functools.cache
def scene(name, duration, samples):
    return dataclasses.replace(crosscheck.load_scene(name), duration=duration, samples=samples)


@functools.cache
def truth(name, duration, samples):
    return references.truth(scene(name, duration, samples)).states


def solve(name, method, duration, samples, step=None, rtol=None, monitor=True):
    s = scene(name, duration, samples)
    # Without spin-free frames: in them the top has no error to which a slope could be fitted.
    return lieeuler.integrate(build_problem(s), method, step, s.t, rtol=rtol, monitor=monitor, spin_free=False)


def errors(name, solution, duration, samples):
    """Largest errors of x, R, v, w over all samples."""
    exact = truth(name, duration, samples)
    return [np.abs(getattr(solution, q) - getattr(exact, q)).max() for q in QUANTITIES]


def observed_orders(scene, method, steps, exact, **options):
    """Slopes of the largest errors of x, R, v, w over the steps taken, which are shortened to divide the intervals."""
    runs = [lieeuler.integrate(build_problem(scene), method, h, scene.t, monitor=False, **options) for h in steps]
    return slopes([run.stats.step for run in runs],
                  [[np.abs(getattr(run, q) - getattr(exact, q)).max() for q in QUANTITIES] for run in runs])
