"""Random scenes all have a truth, and its error is within its bound, as a run by the second formulation shows."""

import numpy as np
import pytest

from crosscheck.references import compute
from crosscheck.references.base import scene_length
from crosscheck.references.maximal import Maximal
from tests.references.random_scenes import scene_of

COUNT = 200
WITNESS = 1e-14
"""What the witness itself leaves, times the growth of rounding."""


@pytest.mark.parametrize("seed", range(COUNT))
def test_truth_says_how_wrong_it_is(seed):
    scene = scene_of(seed)
    found = compute(scene)
    count = int((found.t <= found.horizon).sum())
    witness = Maximal(scene).run(scene.t[:count])
    apart = max(np.linalg.norm(found.states.x[:count] - witness.x, axis=-1).max() / scene_length(scene),
                np.linalg.norm(found.states.R[:count] - witness.R, axis=(-2, -1)).max())
    assert apart <= found.error + WITNESS * max(1.0, found.amplification)
    assert found.error <= 1e-9
