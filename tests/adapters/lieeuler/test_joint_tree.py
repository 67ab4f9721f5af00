"""Scenes in the coordinates of their joints move like the whole systems; what is no tree is told."""

import dataclasses

import numpy as np
import pytest

import lieeuler
from lieeuler.joint_tree import joint_tree
from tests.adapters.lieeuler.against_truth import library
from tests.lieeuler.accuracy import largest_difference
from tests.lieeuler.test_joint_tree import Growing

SCENES = ("hinge_pendulum", "cylindrical_pendulum", "prismatic_slider", "universal_pendulum", "bead_on_line",
          "puck_on_plane", "geared_arm", "branching_tree", "planar_slider")


@pytest.mark.parametrize("name", SCENES)
def test_joints_change_nothing_but_the_cost(name):
    problem = library(name)
    times = np.linspace(0, 1, 7)
    off = lieeuler.integrate(problem, "rkmk853", t_eval=times, rtol=1e-13, reduce="off")
    on = lieeuler.integrate(problem, "rkmk853", t_eval=times, rtol=1e-13, reduce="joints")
    assert on.stats.reduce == "joints"
    assert max(on.stats.maxima[f"constraint_{level}"] for level in ("position", "velocity")) < 2e-14
    assert largest_difference(off, on) < 1e-11


@pytest.mark.parametrize(("method", "count"), [("rkmk4", 80), ("rkmk54", 30), ("rkmk853", 7)])
def test_order_and_uneven_outputs(method, count):
    """Errors fall with the order of the method; outputs that change the step do not matter."""
    problem = library("geared_arm")
    best = lieeuler.integrate(problem, "rkmk853", t_eval=[0.0, 0.7], rtol=1e-14)
    assert best.stats.reduce == "joints"
    steps = 0.7 / np.array([count, 2 * count])
    ends = [lieeuler.integrate(problem, method, step, [0.0, 0.7]) for step in steps]
    errors = [np.abs(end.x[-1] - best.x[-1]).max() for end in ends]
    assert abs(np.log2(errors[0] / errors[1]) - lieeuler.METHODS[method].order) < 0.5
    uneven = lieeuler.integrate(problem, method, steps[1], [0.0, 0.013, 0.3, 0.7])
    assert np.abs(uneven.x[-1] - best.x[-1]).max() < 2 * errors[1]


def test_samples_between_steps_are_as_good_as_steps():
    problem = library("prismatic_slider")
    times = np.linspace(0, 1, 101)
    off, on = (lieeuler.integrate(problem, "rkmk853", t_eval=times, rtol=1e-11, reduce=word) for word in ("off", None))
    assert on.stats.reduce == "joints"
    assert on.stats.steps < 50
    assert largest_difference(off, on) < 1e-8


def test_default():
    """The explicit methods, where no plane and no spin-free frame serves and joints have no more nodes than pay."""
    times = [0.0, 0.01]
    words = {name: lieeuler.integrate(library(name), "rkmk4", 1e-3, times).stats.reduce for name in (
        "geared_arm", "universal_pendulum", "branching_tree", "puck_on_plane", "planar_slider", "hinge_pendulum",
        "double_pendulum", "chain_8", "bricard", "coupled_arm", "rolling_disk", "driven_slider_crank")}
    assert words == {
        "geared_arm": "joints", "universal_pendulum": "joints", "branching_tree": "welded, joints",
        "puck_on_plane": "off", "planar_slider": "planar", "hinge_pendulum": "axis", "double_pendulum": "off",
        "chain_8": "off", "bricard": "off", "coupled_arm": "off", "rolling_disk": "off",
        "driven_slider_crank": words["driven_slider_crank"]}
    assert "joints" not in words["driven_slider_crank"]
    for method in ("rattle2", "DAE1L_LSE", "generalized_alpha"):
        assert lieeuler.integrate(library("geared_arm"), method, 1e-3, times).stats.reduce == "off"


@pytest.mark.parametrize(("name", "method"), [
    ("bricard", "rkmk4"), ("double_pendulum", "rkmk4"), ("driven_slider_crank", "rkmk4"), ("rolling_disk", "rkmk4"),
    ("coupled_arm", "rkmk4"), ("rod_pendulum", "rkmk4"), ("geared_arm", "rattle2")])
def test_what_is_no_tree_of_joints_is_told(name, method):
    with pytest.raises(lieeuler.ArgumentError, match="reduce='joints' does not apply"):
        lieeuler.integrate(library(name), method, 1e-3, [0.0, 0.01], reduce="joints")


def test_look_alikes_are_left_alone():
    """A body without joint, a second joint between two bodies, a joint open by 1e-10, a joint that points inwards."""
    problem = library("geared_arm")
    assert joint_tree(problem)
    tree = Growing(3)
    tree.add("revolute", -1)
    tree.add("spherical", 0)
    inward = dataclasses.replace(tree.joints[1], parent=1, child=0, parent_anchor=tree.joints[1].child_anchor,
                                 child_anchor=tree.joints[1].parent_anchor)
    still = np.zeros_like(problem.v)
    others = [
        dataclasses.replace(problem, joints=problem.joints[:-1], forces=()),
        dataclasses.replace(problem, joints=(*problem.joints, lieeuler.point_on_plane_joint(
            0, 1, [0, 0, 0], problem.R[1].T @ (problem.x[0] - problem.x[1]), [0, 0, 1])), forces=(), v=still, w=still),
        dataclasses.replace(problem, x=problem.x + 1e-10),
        dataclasses.replace(tree.problem(), joints=(tree.joints[0], inward), forces=()),
    ]
    for other in others:
        assert joint_tree(other) == ()


def test_steps_that_are_too_large_are_told():
    problem = library("geared_arm")
    with pytest.raises(lieeuler.IntegrationError) as ended:
        lieeuler.integrate(problem, "rkmk4", 5.0, [0.0, 500.0], reduce="joints")
    assert ended.value.status in ("map_domain", "non_finite", "singular_matrix")
    assert ended.value.solution.stats.reduce == "joints"
