"""The true motion over sample intervals, and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from crosscheck.references import truth
from crosscheck.scene.batch import integrate, rates_of
from crosscheck.scene.file import load_scene
from crosscheck.scene.states import States


@pytest.mark.parametrize("name", ["double_pendulum", "four_bar", "spring_pendulum"])
@pytest.mark.parametrize(("count", "parts"), [(2, 2), (2, 5), (3, 10), (4, 6)])
def test_states_and_accelerations_within_intervals_are_those_of_truth(name, count, parts):
    """Against independent truth at every node: order 8, and degree 7 within the steps."""
    scene = load_scene(name).replace(duration=1.0, samples=50 * parts + 1)
    true = truth(scene).states
    at = slice(0, -1, parts)
    begin = true.at(at)
    end, nodes, fast = integrate(scene, begin, np.diff(true.t[::parts]), count, parts)
    assert len(nodes) == parts + 1
    for part in "xRvw":
        np.testing.assert_allclose(getattr(end, part), getattr(true, part)[parts::parts], rtol=0, atol=3e-11)
    for k, (a, _, alpha) in enumerate(nodes):
        rows = slice(k, k + 50 * parts - parts + 1, parts)
        rates = rates_of(scene, hinges=true.hinges[rows].copy())
        wanted = rates(*(getattr(true, part)[rows] for part in ("t", "x", "R", "v", "w")))
        for one, other in ((a, wanted[2]), (alpha, wanted[3])):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * max(1.0, np.abs(other).max()))
    speeds = np.linalg.norm(true.w, axis=-1).max(axis=-1)
    around = [speeds[k * parts:(k + 1) * parts + 1].max() for k in range(50)]
    np.testing.assert_allclose(fast, around, rtol=0, atol=1e-9)


def test_each_of_several_runs_winds_its_joints_by_itself():
    """The wheel has turned by several turns when the second run begins at zero again."""
    scene = load_scene("torsion_wheel").replace(duration=3.0, samples=126)
    true = truth(scene).states
    begin = States(*(np.concatenate([getattr(true, part)[:-1]] * 2) for part in ("t", "x", "R", "v", "w")),
                   hinges=np.concatenate([true.hinges[:-1]] * 2))
    end, *_ = integrate(scene, begin, np.tile(np.diff(true.t), 2), 6)
    for part in "xRvw":
        wanted = np.concatenate([getattr(true, part)[1:]] * 2)
        np.testing.assert_allclose(getattr(end, part), wanted, rtol=0, atol=3e-11)


def test_the_integration_is_of_order_eight():
    scene = load_scene("double_pendulum").replace(duration=0.4, samples=2)
    true = truth(scene).states
    begin = true.at(slice(0, 1))
    errors = [np.abs(integrate(scene, begin, np.array([0.4]), count)[0].x - true.x[1:]).max() for count in (16, 24)]
    assert 7.5 < np.log(errors[0] / errors[1]) / np.log(1.5) < 9.0
