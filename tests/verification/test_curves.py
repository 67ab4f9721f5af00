"""Curves for the report: packed and unpacked alike, geometry with the right mass and inertia."""

import dataclasses

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec.structs import replace

from crosscheck.document.curves import PACKED_STEPS, Packed
from crosscheck.references import truth
from crosscheck.report.curves import unpack
from crosscheck.running.run import run
from crosscheck.scene.file import load_scene
from crosscheck.verification import curves

VALUES = arrays(float, st.integers(2, 40), elements=st.floats(-1e6, 1e6) | st.just(np.nan))


@given(VALUES)
def test_a_linear_curve_keeps_its_values_to_the_spacing_of_its_codes(values):
    packed = curves.pack(values)
    found = unpack(msgspec.json.decode(msgspec.json.encode(packed), type=Packed))
    assert np.array_equal(np.isnan(found), np.isnan(values))
    finite = values[np.isfinite(values)]
    # Half a spacing, and the nine digits of lo and hi: half a unit of the ninth is 5e-9 of a number that starts with 1.
    spacing = np.ptp(finite) / (PACKED_STEPS - 1) if len(finite) else 0.0
    tiny = np.finfo(float).tiny  # there is no spacing below it
    bound = 0.5001 * spacing + 5.001e-9 * np.abs(finite).max(initial=0.0) + 2 * tiny
    assert np.nanmax(np.abs(found - values), initial=0.0) <= bound


@given(arrays(float, st.integers(2, 40), elements=st.floats(1e-18, 1e6) | st.just(0.0)))
def test_a_logarithmic_curve_keeps_zeros_and_relative_precision(values):
    found = unpack(curves.pack(values, log=True))
    assert np.array_equal(found == 0, values == 0)
    some = values > 0
    # Half a spacing of at most 24 decades.
    assert np.abs(np.log10(found[some] / values[some])).max(initial=0.0) <= 0.51 * 24 / (PACKED_STEPS - 1)


def test_a_curve_is_the_true_one_only_within_two_spacings():
    exact = np.linspace(-1, 3, 50)
    spacing = 4 / PACKED_STEPS
    assert curves.pack(exact + 1.9 * spacing, truth=exact) == "truth"
    assert isinstance(curves.pack(exact + 2.1 * spacing, truth=exact), Packed)
    assert isinstance(curves.pack(np.where(exact > 0, np.inf, exact), truth=exact), Packed)


def test_long_logarithmic_curves_keep_their_peaks():
    values = np.full(251, 1e-10)
    values[[0, 77, 128]] = 1e-12, 1e-3, 1e-4
    found = unpack(curves._log(values))
    assert len(found) == 126
    assert found[[0, 39, 64]] == pytest.approx([1e-12, 1e-3, 1e-4], rel=1e-3)


def test_the_box_of_a_body_has_its_inertia():
    for scene in map(load_scene, ("heavy_top", "spring_pendulum")):
        body, corners = scene.bodies[0], np.array(curves.drawing(scene).bodies[0].corners)
        # Second moments of a uniform box are a third of those of its corners.
        second = body.mass * corners.T @ corners / 8 / 3
        assert np.trace(second) * np.eye(3) - second == pytest.approx(body.inertia, rel=2e-3, abs=2e-3)


@pytest.fixture(scope="module")
def spinning():
    scene = load_scene("heavy_top").replace(duration=0.2, samples=51)
    return scene, run(scene, "lieeuler", "DAE1L_LSE", step=1e-4), truth(scene)


def test_curves_of_a_run_give_back_its_states(spinning):
    scene, traj, reference = spinning
    packed = curves.run_curves(scene, traj, {}, reference)
    exact = curves.scene_curves(scene, reference)

    def values(read):
        curve = read(packed)
        return unpack(curve, read(exact))

    for k in range(3):
        assert values(lambda c, k=k: c.x[0][k]) == pytest.approx(traj.x[:, 0, k], abs=1e-4)
        error = unpack(replace(packed.x[0][k], over=False))  # the differences that a picture magnifies
        true = traj.x[:, 0, k] - reference.states.x[:, 0, k]
        assert error == pytest.approx(true, abs=1e-4 * np.abs(true).max())
    w, x, y, z = (values(lambda c, k=k: c.q[0][k]) for k in range(4))
    assert 1 - 2 * (y * y + z * z) == pytest.approx(traj.R[:, 0, 0, 0], abs=3e-4)
    assert 2 * (x * y - w * z) == pytest.approx(traj.R[:, 0, 0, 1], abs=3e-4)
    assert 2 * (w * x + y * z) == pytest.approx(traj.R[:, 0, 2, 1], abs=3e-4)
    steps = np.diff(np.stack([w, x, y, z]), axis=1)
    assert np.linalg.norm(steps, axis=0).max() < 0.5  # signs do not jump: a quarter turn at most between samples
    force, _ = traj.reactions["tip"]
    size = np.abs(force).max()
    for k in range(3):
        assert values(lambda c, k=k: c.reactions["tip"].force[k]) == pytest.approx(force[:, k], abs=1e-4 * size)
    assert packed.reactions["tip"].torque is None  # a ball joint carries none


def test_true_reactions_hold_the_weight_and_the_motion(spinning):
    scene, _, reference = spinning
    exact = curves.scene_curves(scene, reference)
    force = np.stack([unpack(each) for each in exact.reactions["tip"].force], axis=-1)
    # Newton: the only other force is the weight.
    expected = scene.masses[0] * (reference.states.a[:, 0] - scene.gravity)
    assert force == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())


def test_curves_of_truth_and_of_runs_end_with_truth(spinning):
    scene, traj, reference = spinning
    early = dataclasses.replace(reference, horizon=0.1)
    exact, packed = curves.scene_curves(scene, early), curves.run_curves(scene, traj, {}, early)
    over = scene.t > 0.1
    for motion in (exact, packed):
        force = [(c, e) for c, e in zip(motion.reactions["tip"].force, exact.reactions["tip"].force, strict=True)]
        places = [(c, e) for c, e in zip(motion.x[0] + motion.q[0], exact.x[0] + exact.q[0], strict=True)]
        figures = [(getattr(motion, key), getattr(exact, key)) for key in ("kinetic", "potential", "total", "momentum")]
        for curve, true in [*force, *places, *figures]:
            np.testing.assert_array_equal(np.isnan(unpack(curve, true)), over)
    np.testing.assert_array_equal(np.isnan(unpack(packed.energy)), over)
    assert exact.reactions["tip"].torque is None
    known = np.where(over, np.nan, np.sin(scene.t))
    assert curves.pack(known, truth=known) == "truth"
    assert isinstance(curves.pack(np.sin(scene.t), truth=known), Packed)


def test_a_run_that_left_the_group_has_gaps_and_not_an_error(spinning):
    _, traj, _ = spinning
    R = traj.R.copy()
    R[10], R[11] = np.nan, -np.eye(3)
    found = curves.quaternions(R)
    assert np.isnan(found[0, :, 10:12]).all()
    assert np.isfinite(found[0, :, :10]).all()
