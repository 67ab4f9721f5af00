"""A test that leaves method and step open starts no run of millions of steps."""

from __future__ import annotations

import pytest

import crosscheck
from crosscheck.errors import ArgumentError
from crosscheck.testing import agreement


@pytest.fixture
def scene():
    return crosscheck.load_scene("single_pendulum").replace(duration=1.0, samples=11)


def test_a_named_method_of_too_many_steps_is_refused_with_the_words(scene, monkeypatch):
    monkeypatch.setattr(agreement, "MOST_STEPS", 100)
    with pytest.raises(ArgumentError, match=r"steps, more than 1e.02; name another method, a step, or a shorter"):
        agreement.contender("lieeuler:DAE1L_LSE", scene, crosscheck.truth(scene))


def test_an_open_method_follows_a_tolerance_instead(scene, monkeypatch):
    truth = crosscheck.truth(scene)
    before = agreement.contender("lieeuler", scene, truth)
    monkeypatch.setattr(agreement, "MOST_STEPS", 0)
    chosen = agreement.contender("lieeuler", scene, truth)
    assert before.step
    assert chosen.arguments == {"rtol": 1e-9}
    assert crosscheck.run(scene, "lieeuler", chosen.method, rtol=1e-9).steps < 1000


def test_a_step_of_ones_own_is_taken(scene, monkeypatch):
    monkeypatch.setattr(agreement, "MOST_STEPS", 0)
    chosen = agreement.contender(("lieeuler", "rattle2", {"step": 1e-4}), scene, crosscheck.truth(scene))
    assert chosen.arguments == {"step": 1e-4}
