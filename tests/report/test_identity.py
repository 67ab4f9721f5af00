"""Looks of runs: distinct for every pair, readable on both pages, the same in every output."""

import itertools

import pytest

from crosscheck.adapters import get
from crosscheck.report.identity import DASHES, METHODS, SHADES, look, looks

LABELS = {"lieeuler": 24, "mujoco": 10, "pinocchio": 8, "exudyn": 15, "drake": 3}
"""Sixty runs of five engines."""


def srgb(colour):
    return [int(colour[k:k + 2], 16) / 255 for k in (1, 3, 5)]


def contrast(one, other):
    """As WCAG 2 defines it."""
    def luminance(colour):
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in srgb(colour)]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.fixture(scope="module")
def sixty():
    made = looks({engine: [f"{engine} m{k}" for k in range(count)] for engine, count in LABELS.items()})
    return [each for own in made.values() for each in own.values()]


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_no_two_of_sixty_are_alike(sixty, theme):
    """By colour and dash alone, which is all that a line without points has; colours count as one below 8/255."""
    assert len(sixty) == 60
    for one, other in itertools.combinations(sixty, 2):
        apart = max(abs(a - b) for a, b in zip(srgb(getattr(one, theme)), srgb(getattr(other, theme)), strict=True))
        assert one.dash != other.dash or apart > 8 / 255, (one, other)


def test_lines_can_be_seen_on_their_page(sixty):
    """WCAG asks 3 : 1 of graphics."""
    assert min(contrast(each.light, "#ffffff") for each in sixty) >= 3.0
    assert min(contrast(each.dark, "#14171a") for each in sixty) >= 3.0


def test_an_engine_may_have_more_methods_than_shades_and_dashes():
    many = [look("lieeuler", place) for place in range(2 * SHADES * len(DASHES))]
    assert len({(each.light, each.dash) for each in many}) == len(many)


@pytest.mark.parametrize("engine", METHODS)
def test_a_method_looks_the_same_whichever_others_are_beside_it(engine):
    methods = get(engine).methods
    assert tuple(METHODS[engine].split()) == methods
    every = looks({engine: [f"{engine} {method}" for method in methods]})[engine]
    assert every == {f"{engine} {method}": look(engine, place) for place, method in enumerate(methods)}
    last = f"{engine} {methods[-1]}"
    assert looks({engine: [f"{engine} mine", last]})[engine][last] == every[last]
    forms = looks({engine: [f"{last}{form}" for form in ("", " (tree)", " (maximal)", " (pivot)", " (tree, ccsk)")]})
    assert len({(each.light, each.dash) for each in forms[engine].values()}) == 5
