"""Spanning trees of scenes: the joints of the tree, those that close loops, the free coordinates."""

import dataclasses

import crosscheck
from crosscheck.scene.mechanics import redundant_rows
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.spanning import spanning_tree


def _ranked(scene: Scene, first: str) -> list[str]:
    """Names of the joints outside the tree if the joint `first` enters it first and no distance joint does."""
    def preference(joint) -> int:
        return -1 if joint.type == "distance" else int(joint.name == first)

    branches, left = spanning_tree(scene, preference)
    reached = {GROUND}
    for branch in branches:
        assert branch.parent in reached
        reached.add(branch.body)
    assert reached == {GROUND, *range(scene.n)}
    assert len(branches) == scene.n
    return [joint.name for joint in left]


def test_preferred_joints_enter_the_tree() -> None:
    scene = crosscheck.load_scene("four_bar")
    names = [joint.name for joint in scene.joints]
    assert _ranked(scene, "none of them") == names[-1:]
    assert _ranked(scene, names[-1]) == names[-2:-1]


def test_a_joint_that_may_not_enter_leaves_its_body_free() -> None:
    scene = crosscheck.load_scene("rod_pendulum")
    assert _ranked(scene, "") == ["rod"]
    branches, _ = spanning_tree(scene, lambda joint: -1)
    assert [(branch.body, branch.parent, branch.joint) for branch in branches] == [(0, GROUND, None)]


def test_branches_know_which_way_round_their_joint_is_written() -> None:
    scene = crosscheck.load_scene("slider_crank")
    branches, _ = spanning_tree(scene, lambda joint: 1 if joint.type in ("universal", "prismatic") else 0)
    outward = {branch.joint.name: branch.outward for branch in branches if branch.joint is not None}
    turned = [dataclasses.replace(joint, parent=joint.child, child=joint.parent) for joint in scene.joints]
    again, _ = spanning_tree(scene.replace(joints=tuple(turned)),
                             lambda joint: 1 if joint.type in ("universal", "prismatic") else 0)
    assert {branch.joint.name: not branch.outward for branch in again if branch.joint is not None} == outward


def test_redundant_rows_are_counted() -> None:
    rows = {"four_bar": 3, "bricard": 1, "slider_crank": 0, "double_pendulum": 0}
    assert {name: redundant_rows(crosscheck.load_scene(name)) for name in rows} == rows
