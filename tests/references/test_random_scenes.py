"""Random scenes all have a truth, and its error is within its bound, as the third formulation shows."""

import pytest

from crosscheck.references import agreement, compute, natural
from tests.references.random_scenes import scene_of

COUNT = 200
WITNESS = 1e-13
"""What the witness itself leaves: Taylor series of extended precision, states in double."""


@pytest.mark.parametrize("seed", range(COUNT))
def test_truth_says_how_wrong_it_is(seed):
    scene = scene_of(seed)
    found = compute(scene)
    count = int((found.t <= found.horizon).sum())
    witness = natural.Natural(scene).run(scene.t[:count])
    assert agreement.difference(scene, found.states, witness, count).size <= found.error + WITNESS
    assert found.error <= 1e-9
