"""A truth of arbitrary states, for tests of what is computed from truth."""

import numpy as np

from crosscheck.references.base import Reference
from crosscheck.scene.states import States

DERIVATIVES = np.array([1.0, 3.0, 7.0, 40.0, 90.0, 500.0, 800.0, 9e3, 2e4, 1e5, 7e5])


def truth_of(scene, fast=1.0, turns=1.0, **other):
    """A truth of arbitrary states; `fast` scales its speeds, `turns` the derivatives of attitudes."""
    rng = np.random.default_rng(3)
    shape = (scene.samples, len(scene.bodies), 3)
    x, v, w = (size * rng.normal(size=shape) for size in (1.0, fast, fast))
    states = States(np.linspace(0.0, scene.duration, scene.samples), x, np.broadcast_to(np.eye(3), (*shape, 3)), v, w)
    given = {"disagreement": 3e-13, "allowed": 2e-12, "amplification": 17.0, "horizon": scene.duration} | other
    return Reference(states, "one", "another", position_derivatives=DERIVATIVES,
                     attitude_derivatives=turns * DERIVATIVES, **given)
