"""Kinematics of the open tree: conversions against central differences and against the engines' own kinematics."""

import numpy as np
import pytest

from crosscheck.adapters.common import tree
from crosscheck.scene.model import GROUND, Scene
from tests.adapters.scenes import mixed_tree

# central differences of step 1e-4 over unit-size smooth functions: h^2 |f'''| / 6 of some 1e-8 and eps / h of 1e-12
DIFFERENCE = 1e-6


def _path(links: tuple[tree.Link, ...], t: np.ndarray) -> list[tree.Motion]:
    """A smooth motion of every link; a ball turns by three successive turns, whose chain rule is `compose`."""
    motions = []
    for number, link in enumerate(links):
        angles = [(np.sin(t * rate + shift), rate * np.cos(t * rate + shift), -rate**2 * np.sin(t * rate + shift))
                  for rate, shift in ((1.0 + number, 0.1), (0.7, 1.0 + number), (1.3, 2.0))]
        if link.type == "spherical":
            first, second, third = (tree.turning(axis, *angle) for axis, angle in zip(np.eye(3), angles, strict=True))
            motions.append(tree.compose(tree.compose(first, second), third))
        else:
            columns = (part[:, None] if link.dofs else np.empty((len(t), 0)) for part in angles[0])
            motions.append(tree.motion(link, *columns))
    return motions


@pytest.fixture(scope="module")
def scene() -> Scene:
    return mixed_tree()


def test_velocities_and_accelerations_are_derivatives(scene: Scene) -> None:
    links = tree.links(scene)
    h, centre = 1e-4, np.linspace(0.0, 2.0, 9)
    before, at, after = (tree.forward(links, _path(links, t), t, accelerations=True)
                         for t in (centre - h, centre, centre + h))
    spin = np.swapaxes(at.R, -1, -2) @ (after.R - before.R) / (2 * h)
    w = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
    assert np.abs((after.x - before.x) / (2 * h) - at.v).max() < DIFFERENCE
    assert np.abs(w - at.w).max() < DIFFERENCE
    assert np.abs((after.v - before.v) / (2 * h) - at.a).max() < DIFFERENCE
    assert np.abs((after.w - before.w) / (2 * h) - at.alpha).max() < DIFFERENCE


def test_initial_coordinates_reproduce_the_scene(scene: Scene) -> None:
    links = tree.links(scene)
    motions = []
    for link in links:
        q, v = tree.initial_coordinates(scene, link)
        motions.append(tree.motion(link, q[None], v[None], None))
    states = tree.forward(links, motions, np.zeros(1), accelerations=False)
    for found, given in ((states.x, scene.x0), (states.R, scene.R0), (states.v, scene.v0), (states.w, scene.w0)):
        assert np.abs(found[0] - given).max() < 1e-13  # some tens of roundings of numbers of size 1


def test_links_run_outwards_whatever_the_joints_call_parent(scene: Scene) -> None:
    links = tree.links(scene)
    reached = {GROUND}
    for link in links:
        assert link.parent in reached
        reached.add(link.body)
    turned = [joint.name for joint in scene.joints if joint.name.startswith("turned")]
    assert turned  # the scene has a joint written from the outer body to the inner one


def test_a_loop_and_a_loose_body_are_no_tree(scene: Scene) -> None:
    joints = scene.joints
    every = ("spherical", "revolute", "prismatic", "fixed")
    assert tree.obstacle(scene, every) is None
    assert "open tree" in tree.obstacle(scene.replace(joints=joints[:-1]), every)
    assert "open tree" in tree.obstacle(scene.replace(joints=(*joints, joints[0])), every)
    assert "prismatic" in tree.obstacle(scene, ("spherical", "revolute", "fixed"))
