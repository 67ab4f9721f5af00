"""Steps far too large, positions where the rank drops, inconsistent starts: a named status or a right answer."""

import copy
import json

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.model import GROUND
from tests.hard.methods import FIXED

SCENES = ("double_pendulum", "heavy_top", "four_bar", "spring_pendulum", "damped_pendulum")


def finite(states):
    return all(np.isfinite(values).all() for values in (states.x, states.R, states.v, states.w))


def outcome(scene, method, step):
    """The run's states as far as it came, and its error or None."""
    try:
        return lieeuler.integrate(build_problem(scene), method, step, scene.t), None
    except lieeuler.IntegrationError as error:
        return error.solution, error


@pytest.mark.parametrize("step", [0.1, 1.0, 1e4])
@pytest.mark.parametrize("method", FIXED)
@pytest.mark.parametrize("name", SCENES)
def test_steps_far_too_large_end_with_a_name_and_never_with_nan(name, method, step):
    scene = crosscheck.load_scene(name).replace(duration=20 * step, samples=21)
    end, failure = outcome(scene, method, step)
    assert finite(end)
    # 20 steps of products of rotations, whatever their angles
    assert np.abs(np.swapaxes(end.R, -1, -2) @ end.R - np.eye(3)).max() < 1e-12
    if failure is not None:
        assert failure.status is not lieeuler.Status.SUCCESS
        assert failure.advice


@pytest.mark.parametrize("step", [1e-2, 1e-3])
@pytest.mark.parametrize("method", [name for name in FIXED if "position" in lieeuler.METHODS[name].held])
def test_a_parallelogram_passes_flat_positions_on_its_branch_or_says_why_not(method, step):
    """At the flat position another branch begins, on which the coupler turns; a run that takes it must not succeed."""
    scene = crosscheck.load_scene("parallelogram")
    traj, failure = outcome(scene, method, step)
    if failure is not None:
        assert failure.status in (lieeuler.Status.SINGULAR_MATRIX, lieeuler.Status.NEWTON_FAILED)
        return
    assert np.count_nonzero(np.diff(np.sign(traj.x[:, 1, 2]))) >= 2
    # near the flat position closed joints leave the angle open to the root of their rounding
    assert np.abs(traj.R[:, 1] - np.eye(3)).max() < np.sqrt(50 * np.finfo(float).eps)


@pytest.mark.parametrize(("name", "method", "step"), [("parallelogram", "rattle2", 1.6e-3),
                                                      ("double_four_bar", "DAE3L_LE", 5e-4)])
def test_newton_ends_where_rounding_at_a_singular_position_does(name, method, step):
    """There corrections stay at 8e-12 and 5e-11, which no iteration makes smaller; the run goes on, closed."""
    run = lieeuler.integrate(build_problem(crosscheck.load_scene(name)), method, step, [0.0, 1.0], reduce="off")
    assert run.status is lieeuler.Status.SUCCESS
    assert run.stats.maxima["constraint_position"] < 1e-14


@pytest.mark.parametrize("method", [name for name, method in lieeuler.METHODS.items() if "rtol" in method.controls])
@pytest.mark.parametrize("rtol", [1e-8, 1e-10])
def test_adaptive_methods_pass_a_singular_position_or_name_it_and_do_not_creep(method, rtol):
    """Rows of the double four-bar are dependent where its rods lie on one line, which it passes eight times in 10 s."""
    scene = crosscheck.load_scene("double_four_bar")
    failure = None
    try:
        stats = lieeuler.integrate(build_problem(scene), method, t_eval=scene.t[[0, -1]], rtol=rtol).stats
    except lieeuler.IntegrationError as error:
        failure, stats = error, error.solution.stats
    if failure is not None:
        assert failure.status is lieeuler.Status.SINGULAR_MATRIX
        assert "larger rtol" in failure.advice
        assert rtol < 1e-8
    # order 5 takes 500 steps at 1e-8, and 2.5 times as many for two digits more; creeping takes tens of thousands
    assert stats.steps + stats.rejected_steps < 5000


ROD = {"name": "rod", "mass": 1.0, "inertia": [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.01]]}
LEFT = {"name": "left", "type": "spherical", "parent": "ground", "child": "rod", "parent_anchor": [0.0, 0.0, 0.0],
        "child_anchor": [-0.5, 0.0, 0.0]}
RIGHT = {**LEFT, "name": "right", "parent_anchor": [1.0, 0.0, 0.0], "child_anchor": [0.5, 0.0, 0.0]}
HELD_ROD = {"schema": 1, "name": "held", "gravity": [0.0, 0.0, -9.81], "duration": 1.0, "samples": 3, "bodies": [ROD],
            "joints": [LEFT, RIGHT]}


def written(tmp_path, change):
    data = copy.deepcopy(HELD_ROD)
    change(data)
    path = tmp_path / "held.json"
    path.write_text(json.dumps(data))
    return path


def test_a_rod_held_at_both_ends_loads(tmp_path):
    scene = crosscheck.load_scene(written(tmp_path, lambda data: None))
    assert scene.x0[0] == pytest.approx([0.5, 0.0, 0.0])
    assert scene.joints[1].parent == GROUND


@pytest.mark.parametrize(("change", "words"), [
    (lambda data: data["joints"][1].update(parent_anchor=[1.5, 0.0, 0.0]), "right"),
    (lambda data: data.update(assemble=True, joints=[LEFT, {**RIGHT, "parent_anchor": [1.5, 0.0, 0.0]}]), "joint"),
    (lambda data: data["bodies"][0].update(angular_velocity=[0.0, 1.0, 0.0]), "right"),
], ids=["too far apart", "too far apart for any assembly", "turned against its joints"])
def test_joints_that_contradict_each_other_are_a_scene_error(tmp_path, change, words):
    with pytest.raises(crosscheck.SceneError, match=words) as caught:
        crosscheck.load_scene(written(tmp_path, change))
    assert "held.json" in str(caught.value)


@pytest.mark.parametrize("method", [name for name in FIXED if "position" in lieeuler.METHODS[name].held])
def test_a_chain_almost_fully_stretched_stays_closed_and_symmetric(method):
    """It starts as its own mirror image, and nothing tells left from right afterwards."""
    scene = crosscheck.load_scene("taut_chain").replace(duration=0.3, samples=4)
    step = 5e-4
    traj, failure = outcome(scene, method, step)
    assert failure is None, failure
    # of 1 m, a rounding per step, magnified by 1 / 0.02: the angle of the outer rods makes up for their length
    bound = 50 * np.finfo(float).eps * np.sqrt(0.3 / step) / 0.02
    assert np.abs(traj.x[:, 0, 1:] - traj.x[:, 2, 1:]).max() < bound
    assert np.abs(traj.x[:, 1, 0] - scene.x0[1, 0]).max() < bound
    # it swings on a lever of 0.013 m, 27 rad/s: 1 rad/s at the start takes the middle 7e-4 m aside
    assert np.abs(traj.x[-1, 1] - traj.x[0, 1]).max() > 5e-4


def test_a_slider_crank_passes_its_dead_centres():
    """The slider turns back at each dead centre, which neither energy nor joints show."""
    scene = crosscheck.load_scene("slider_crank")
    traj = crosscheck.run(scene, "lieeuler", "rattle4", step=1e-3)
    along = traj.x[:, 2] - traj.x[:, 2].mean(axis=0)
    stroke = along @ np.linalg.svd(along)[2][0]
    assert np.count_nonzero(np.diff(np.sign(np.diff(stroke)))) >= 4
    assert traj.stats["constraint_position"] < 50 * np.finfo(float).eps  # lengths below 1 m
    # symmetric, of order 4: a band of some (w h)^4 with the crank's 10 rad/s, no jump at a dead centre
    assert np.ptp(traj.energy) < 1e2 * (10 * 1e-3) ** 4 * np.abs(traj.energy).max()
