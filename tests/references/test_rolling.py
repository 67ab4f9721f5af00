"""Contacts in the two formulations of truth: accelerations of each against the other, and seeded mistakes."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import crosscheck
from crosscheck.references import loops, maximal
from crosscheck.references.taylor import Taylor
from crosscheck.scene import contacts
from crosscheck.scene.coordinates import starting
from crosscheck.scene.functions import at

SCENES = ("chaplygin_sleigh", "rolling_disk", "wobbling_disk", "rolling_ball")
ROUNDING = 1e-12  # of accelerations of some hundred


class Uncompiled(Taylor):
    """The equations of the series, which floats go through as symbols do."""

    def integrator(self, tolerance=None, **options):
        return None


def accelerations(name):
    """Angular ones of the scene's body at the start, by both, body axes."""
    scene = crosscheck.load_scene(name)
    _, second, _ = maximal.Maximal(scene).accelerations(starting(scene))
    series = Uncompiled(scene)
    _, first, _, _ = series._solved(series.initial.tolist(), functools.partial(at, t=0.0))
    return np.array(first[0], float), second[0, 0]


@pytest.mark.parametrize("name", SCENES)
def test_formulations_agree_at_the_start(name):
    first, second = accelerations(name)
    np.testing.assert_allclose(first, second, atol=ROUNDING * np.abs(second).max())


MISTAKES = {
    "the contact stays where it is in the body": lambda place, n, t, rest, *levels: (place, n, t, 0.0 * rest, *levels),
    "the radius is wrong by 1e-3": lambda place, n, t, *rest: (place, n, [1.001 * entry for entry in t], *rest),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_seeded_mistake_in_one_shows(mistake, monkeypatch):
    original = loops._contact_terms
    monkeypatch.setattr("crosscheck.references.loops._contact_terms",
                        lambda *arguments: MISTAKES[mistake](*original(*arguments)))
    first, second = accelerations("wobbling_disk")
    assert np.abs(first - second).max() > 1e6 * ROUNDING * np.abs(second).max()


def test_other_directions_of_slip_move_nothing(monkeypatch):
    """A look-alike: the rows of slip along any two directions of the plane say the same."""
    scene = crosscheck.load_scene("rolling_ball")
    before = np.concatenate(maximal.Maximal(scene).accelerations(starting(scene))[:2], axis=-1)
    original = contacts.RollingSphere._directions
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    monkeypatch.setattr(contacts.RollingSphere, "_directions", lambda self, a: turn @ original(self, a))
    after = np.concatenate(maximal.Maximal(scene).accelerations(starting(scene))[:2], axis=-1)
    np.testing.assert_allclose(after, before, atol=ROUNDING * np.abs(before).max())
