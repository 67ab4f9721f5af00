"""Armature and mimics in the engines that have them: order against truth, levels, and what is refused."""

import numpy as np
import pytest

import crosscheck
from tests.lieeuler.accuracy import slopes


def errors(name, engine, method, steps):
    """Largest errors of positions, and the largest gap of a position row, of runs of half a second."""
    scene = crosscheck.load_scene(name).replace(duration=0.5, samples=6)
    truth, found, gaps = crosscheck.truth(scene).states, [], []
    for step in steps:
        run = crosscheck.run(scene, engine=engine, method=method, step=step)
        found.append([np.abs(run.x - truth.x).max(), np.abs(run.w - truth.w).max()])
        gaps.append(run.constraint_position.max())
    return found, gaps


@pytest.mark.parametrize(("name", "method", "order"), [
    ("geared_arm", "GeneralizedAlpha", 2), ("geared_arm", "RK44", 4), ("coupled_arm", "TrapezoidalIndex2", 2)])
def test_exudyn_is_of_its_order(name, method, order):
    pytest.importorskip("exudyn")
    steps = (4e-3, 2e-3, 1e-3)
    found, gaps = errors(name, "exudyn", method, steps)
    assert np.abs(slopes(steps, found) - order).max() < 0.1
    assert max(gaps) < 1e-13


def test_mujoco_holds_a_mimic_softly_and_is_of_its_order():
    pytest.importorskip("mujoco")
    steps = (2e-3, 1e-3, 5e-4)
    found, gaps = errors("coupled_arm", "mujoco", "Euler", steps)
    assert np.abs(slopes(steps, found) - 1).max() < 0.1
    assert 1e-9 < min(gaps) < max(gaps) < 1e-5  # solref of two steps: the gap goes as their square


@pytest.mark.parametrize(("engine", "options", "words"), [
    ("pinocchio", {"method": "RKMK4"}, "mimic"), ("mujoco", {"method": "RK4", "form": "maximal"}, "mimic"),
    ("exudyn", {"method": "GeneralizedAlpha", "form": "maximal"}, "mimic, which is not built here in form maximal"),
    ("exudyn", {"method": "RK44"}, "explicit")])
def test_who_cannot_says_so(engine, options, words):
    pytest.importorskip(engine)
    with pytest.raises(crosscheck.Unsupported, match=words):
        crosscheck.run(crosscheck.load_scene("coupled_arm"), engine=engine, step=1e-3, **options)
