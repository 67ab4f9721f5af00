"""The built-in scenes are complete, closed and described rightly, and together use every joint and force."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.file import load_scene, scene_names, tagged
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.mechanics import RANK_TOLERANCE
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.schema import FORCE_ENTRIES

EPS = np.finfo(float).eps
NAMES = scene_names()
DEFAULT = ("double_pendulum", "heavy_top", "single_pendulum", "triple_pendulum")
STEP = 1e-3  # s; a few thousandths of the fastest oscillation in the library


@pytest.fixture(scope="module")
def library() -> dict[str, Scene]:
    return {name: load_scene(name) for name in NAMES}


def start(scene: Scene) -> tuple[np.ndarray, ...]:
    return scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]


def sizes(scene: Scene) -> tuple[float, float]:
    """The largest terms of Phi, in m, and of G u, in m/s: |x| + |s| and |v| + |s| |w|."""
    anchors = [np.linalg.norm(s) for joint in scene.joints for s in (joint.parent_anchor, joint.child_anchor)]
    reach, lever = np.linalg.norm(scene.x0, axis=1).max(), max([1.0, *anchors])  # dot-1 rows: unit vectors
    spin = np.linalg.norm(scene.w0, axis=1).max()
    return reach + lever, np.linalg.norm(scene.v0, axis=1).max() + (lever + reach) * spin


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_says_what_it_is_and_starts_closed_to_rounding(library, name):
    scene = library[name]
    assert scene.name == name
    assert scene.description
    assert "\n" not in scene.description
    assert scene.source
    assert scene.tags
    constraints = Constraints(scene)
    length, speed = sizes(scene)
    assert np.abs(constraints.position(*start(scene)[:2])).max(initial=0.0) <= 50 * EPS * length
    assert np.abs(constraints.velocity(*start(scene))).max(initial=0.0) <= 50 * EPS * max(speed, 1.0)


def test_the_scenes_of_the_default_job_are_these():
    assert tuple(tagged("default")) == DEFAULT


def test_every_joint_and_force_type_occurs(library):
    joints = {joint.type for scene in library.values() for joint in scene.joints}
    forces = {force.type for scene in library.values() for force in scene.forces}
    assert joints == set(JOINT_TYPES)
    assert forces == set(FORCE_ENTRIES) - {"servo"}  # a built-in scene has one as soon as there is truth for it
    frames = {force.parameters["frame"] for scene in library.values() for force in scene.forces
              if "frame" in force.parameters}
    assert frames == {"world", "body"}


def test_joints_between_bodies_and_to_the_ground_both_occur(library):
    to_ground = {joint.parent == GROUND for scene in library.values() for joint in scene.joints}
    assert to_ground == {True, False}


def closes_a_loop(scene: Scene) -> bool:
    """Whether two paths of joints lead from one body to another; the ground counts as a body."""
    group = list(range(scene.n + 1))  # bodies joined so far share a number; the ground is the last
    for joint in scene.joints:
        parent, child = group[joint.parent], group[joint.child]
        if parent == child:
            return True
        group = [parent if number == child else number for number in group]
    return False


@pytest.mark.parametrize("name", NAMES)
def test_tags_tell_the_truth(library, name):
    scene = library[name]
    constraints = Constraints(scene)
    singular_values = np.linalg.svd(constraints.jacobian(*start(scene)[:2])[0], compute_uv=False)
    rank = np.count_nonzero(singular_values > RANK_TOLERANCE * singular_values.max(initial=0.0))
    true = {
        "loop": closes_a_loop(scene),
        "redundant": rank < constraints.m,
        "spring": any(force.type.endswith("spring") for force in scene.loads),
        "damper": any(force.parameters.get("damping", 0.0) > 0 for force in scene.loads),
        "load": any(force.type.startswith("constant") for force in scene.forces),
        "iftomm": "IFToMM benchmark" in scene.source and "A04" not in scene.source,  # A04: inertia ours
    }
    assert {tag for tag, holds in true.items() if holds} == set(scene.tags) & set(true)


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_moves_and_its_kernel_run_ends_well(library, name):
    scene = library[name].replace(duration=min(1.0, library[name].duration), samples=11)
    traj = crosscheck.run(scene, engine="lieeuler", method="DAE1H_LSE", step=STEP)
    assert traj.status == "success"
    # every body takes part: by a tenth of a radian or of a metre; K5 of the squeezer swings by 0.034 rad, and the
    # slider of the IFToMM crank goes 0.09 m
    turned = np.abs(traj.R - traj.R[0]).max(axis=(0, 2, 3))
    shifted = np.abs(traj.x - traj.x[0]).max(axis=(0, 2))
    assert (np.maximum(turned, shifted) > (0.03 if name in ("squeezer", "iftomm_slider_crank") else 0.1)).all()


def test_the_parallelogram_passes_its_singular_position_on_its_own_branch(library):
    """All bars on one line: the rank drops, and only the motion through it keeps the coupler level."""
    scene = library["parallelogram"]
    traj = crosscheck.run(scene.replace(samples=round(scene.duration / STEP) + 1), engine="lieeuler",
                          method="DAE1H_LSE", step=STEP)
    height = traj.x[:, 1, 2]
    crossings = np.count_nonzero(np.diff(np.sign(height)))
    assert crossings >= 2
    constraints = Constraints(scene)
    flat = int(np.argmin(np.abs(height)))
    smallest = np.linalg.svd(constraints.jacobian(traj.x, traj.R), compute_uv=False)[:, 16]  # 17 are independent
    assert smallest[flat] < 0.05 * smallest[0]
    # Phi is held to 50 eps, which allows motion off the branch in inverse proportion to the smallest singular value
    open_motion = 50 * EPS / smallest.min()
    assert np.abs(traj.R[:, 1] - np.eye(3)).max() < open_motion
    assert np.abs(traj.R[:, 0] - traj.R[:, 2]).max() < open_motion
