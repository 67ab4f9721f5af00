"""The free body by elliptic functions: conserved quantities, the Taylor series, special shapes, its limits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crosscheck.errors import Unsupported
from crosscheck.references import compute, taylor
from tests.references import closed_form

EPS = np.finfo(float).eps
SHAPES = {
    "three moments": (0.1, 0.2, 0.29), "falling": (0.29, 0.2, 0.1), "two large": (0.3, 0.3, 0.2),
    "two small": (0.1, 0.1, 0.15), "nearly a sphere": (0.1, 0.1 + 1e-9, 0.1 + 2e-9), "needle": (0.1, 0.1, 1e-7),
}
RATES = {"flips": (0.25, 5.0, 0.1), "about the first": (2.0, -0.1, -0.2), "about the third": (0.3, 0.2, -1.0)}


def tumbling(build, moments, rate, turn=None, duration=3.0):
    """A free body; `turn` are the axes of its moments in body axes."""
    axes = np.eye(3) if turn is None else turn.as_matrix()
    inertia = axes @ np.diag(moments) @ axes.T
    return build([(1.3, (inertia + inertia.T) / 2, [0.3, -0.5, 0.7, 0.4], axes @ rate)], gravity=(0.0, 1.0, -9.81),
                 duration=duration)


TURN = Rotation.from_rotvec([0.3, -1.1, 0.7])


# A needle in other axes is left out: rounded entries of its inertia leave its smallest moment unknown beyond 1e-10.
@pytest.mark.parametrize(("shape", "rate", "turn"), [
    ("three moments", "flips", None), ("three moments", "about the first", TURN), ("falling", "about the third", TURN),
    ("falling", "flips", None), ("two large", "flips", TURN), ("two small", "about the third", None),
    ("nearly a sphere", "about the first", TURN), ("needle", "flips", None)])
def test_agrees_with_taylor_in_everything(build, shape, rate, turn):
    scene = tumbling(build, SHAPES[shape], np.array(RATES[rate]), turn)
    exact, integrator = closed_form.solve(scene), taylor.Taylor(scene)
    series = integrator.states(integrator.run())
    for name in ("x", "R", "v", "w", "a", "alpha"):
        one, other = getattr(exact, name), getattr(series, name)
        # (14.2) of docs/theory.md, relative to the size; alpha vanishes in a sphere: then to that of w^2
        size = max(np.max(np.abs(one)), np.max(np.abs(exact.w)) ** 2 if name == "alpha" else 0.0)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * size, err_msg=name)


def test_conserves_energy_and_momentum_over_a_thousand_flips(build):
    """The closed form keeps its digits over many flips, of 3.1 s each."""
    scene = tumbling(build, SHAPES["three moments"], np.array([0.25, 5.0, 0.0]), duration=3300.0)
    states = closed_form.solve(scene.replace(samples=9))
    J, w = scene.bodies[0].inertia, states.w[:, 0]
    energy = np.sum(w * (w @ J), axis=1)
    momentum = np.einsum("tij,jk,tk->ti", states.R[:, 0], J, w)
    # sums of a few products of numbers rounded to doubles
    assert np.ptp(energy) <= 50 * EPS * energy[0]
    assert np.abs(momentum - momentum[0]).max() <= 50 * EPS * np.linalg.norm(momentum[0])


@pytest.mark.parametrize(("moments", "rate"), [
    ((0.1, 0.2, 0.29), (0.0, 0.0, 3.0)), ((0.1, 0.2, 0.29), (0.0, 3.0, 0.0)), ((0.1, 0.1, 0.1), (1.0, 2.0, 3.0)),
    ((0.1, 0.2, 0.29), (0.0, 0.0, 0.0)),
], ids=["largest axis", "intermediate axis", "sphere", "at rest"])
def test_steady_rotations_are_left_to_the_other_formulations(build, moments, rate):
    scene = tumbling(build, moments, np.array(rate))
    with pytest.raises(Unsupported, match="steady"):
        closed_form.solve(scene)
    assert compute(scene).disagreement <= 1e-12
