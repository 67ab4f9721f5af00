"""Scenes reduced to their plane move like the whole systems, to rounding, and return all states."""

import dataclasses
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
import lieeuler
from lieeuler.planar import plane_of
from tests.adapters.lieeuler.against_truth import library
from tests.lieeuler.accuracy import largest_difference
from tests.lieeuler.test_planar import turned

PLANAR = ("four_bar", "parallelogram", "planar_slider", "driven_cart", "torsion_wheel", "hinge_pendulum")
TURNING = ("torsion_wheel", "hinge_pendulum")


@pytest.mark.parametrize("method", ["DAE1L_LSE", "DAE1H_LSE", "generalized_alpha", "rattle4", "rkmk4"])
@pytest.mark.parametrize("name", PLANAR)
def test_a_plane_changes_nothing_but_the_cost(name, method):
    """Near singular positions the last digits of multipliers go as their pivots."""
    problem = library(name)
    off, on = (lieeuler.integrate(problem, method, 5e-3, np.linspace(0, 0.5, 6), reduce=word)
               for word in ("off", "planar"))
    assert (on.stats.reduce, off.stats.reduce) == ("planar", "off")
    assert on.stats.redundant_rows == off.stats.redundant_rows
    assert largest_difference(off, on) < (1e-8 if name == "parallelogram" else 2e-11)


@pytest.mark.parametrize(("method", "options"), [
    ("DAE1L_LSE", {"map": "cayley"}), ("DAE1L_LSE", {"correction": "plain", "polish": False}),
    ("DAE1H_LSE", {"map": "cayley"})])
@pytest.mark.parametrize("name", PLANAR)
def test_euler_steps_are_those_of_the_whole_system(name, method, options):
    """To rounding, with every map that turns alike in any axes: so a plane is left out by default."""
    problem = library(name)
    off, on = (lieeuler.integrate(problem, method, 1e-3, np.linspace(0, 0.03, 4), reduce=word, **options)
               for word in ("off", None))
    assert (on.stats.reduce, off.stats.reduce) == ("axis" if name in TURNING else "planar", "off")
    for field in ("x", "R", "v", "w", "a", "alpha", "lam"):
        a, b = getattr(off, field), getattr(on, field)
        assert np.abs(a - b).max() < 1e-11 * np.abs(a).max(), field


@pytest.mark.parametrize("method", ["taylor", "rkmk853", "seulex"])
@pytest.mark.parametrize("name", ["four_bar", "planar_slider", "torsion_wheel"])
def test_adaptive_methods_are_in_the_plane_unless_told(name, method):
    problem = library(name)
    off, on = (lieeuler.integrate(problem, method, t_eval=np.linspace(0, 0.5, 6), rtol=1e-11, reduce=word)
               for word in ("off", None))
    assert on.stats.reduce == ("axis" if name == "torsion_wheel" else "planar")
    assert largest_difference(off, on) < 1e-7


@pytest.mark.parametrize("name", ["four_bar", "hinge_pendulum"])
def test_any_plane_will_do(name):
    """An oblique plane, body axes that do not lie along it, and every body at another height."""
    problem = turned(library(name), Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
    for method in ("rattle2", "DAE1H_LSE"):
        off, on = (lieeuler.integrate(problem, method, 5e-3, [0.0, 0.2, 0.4], reduce=word)
                   for word in ("off", "planar"))
        assert largest_difference(off, on) < 1e-11
        assert max(on.stats.maxima[f"constraint_{level}"] for level in ("position", "velocity")) < 1e-12


@pytest.mark.parametrize("name", ["torsion_wheel", "hinge_pendulum"])
def test_an_angle_follows_its_tolerance(name):
    """Errors go with the tolerance; the coarsest run takes few steps: an angle does not know that attitudes turn."""
    problem = library(name)
    best = lieeuler.integrate(problem, "taylor", t_eval=[0.0, 2.0], rtol=1e-14, reduce="off")
    for rtol in 10.0 ** np.arange(-13, 0):
        run = lieeuler.integrate(problem, "taylor", t_eval=[0.0, 2.0], rtol=rtol)
        assert run.stats.reduce == "axis"
        assert np.abs(run.x[-1] - best.x[-1]).max() < 3 * rtol + 1e-13
    assert run.stats.steps <= 8


def test_a_pin_that_a_function_of_time_drives_keeps_the_whole_series():
    """Loads that depend on time, and a prescribed angle, take the series of attitudes."""
    problem = library("hinge_pendulum")
    gust = lieeuler.ConstantLoad(0, force=[3.0, 1.0, 2.0], factor=lieeuler.TimeFunction(terms=[(1.0, 5.0, 0.3)]))
    axis = [0.0, 0.8, 0.6]
    angle = lieeuler.Drive(lieeuler.TimeFunction([[0.0, 1.5, 0.8]]), lieeuler.Coordinate(axis, axis, problem.R[0].T))
    for driven in (dataclasses.replace(problem, forces=(gust,)),
                   dataclasses.replace(problem, joints=(problem.joints[0].driven(angle),))):
        off, on = (lieeuler.integrate(driven, "taylor", t_eval=[0.0, 1.0], rtol=1e-12, reduce=word)
                   for word in ("off", "axis"))
        assert largest_difference(off, on) < 1e-10


def test_multipliers_carry_what_the_plane_leaves_out():
    """A load along the axis and the weight of a mechanism that lies flat."""
    problem = library("four_bar")
    e = plane_of(problem, False).world[2]
    loaded = dataclasses.replace(problem, gravity=problem.gravity + 7.0 * e, forces=(
        *problem.forces, lieeuler.ConstantLoad(1, force=30.0 * e, torque=[1.0, 2.0, 3.0], point=[0.1, 0.2, 0.3])))
    off, on = (lieeuler.integrate(loaded, "rattle2", 1e-3, [0.0, 0.1], reduce=word) for word in ("off", "planar"))
    assert largest_difference(off, on) < 1e-11
    assert np.abs(on.lam).max() > 10


@pytest.mark.parametrize(("name", "why"), [
    ("double_pendulum", "no joint turns"), ("bricard", "does not keep its bodies"),
    ("branching_tree", "the start moves out of the plane"), ("rod_pendulum", "holds a distance")])
def test_what_leaves_the_plane_is_told(name, why):
    problem = library(name)
    with pytest.raises(lieeuler.ArgumentError, match=f"reduce='planar' does not apply: .*{why}"):
        lieeuler.integrate(problem, "rattle2", 1e-3, [0.0, 0.01], reduce="planar")
    done = "welded" if name == "branching_tree" else "off"
    assert lieeuler.integrate(problem, "rattle2", 1e-3, [0.0, 0.01]).stats.reduce == done


def test_look_alikes_are_left_alone():
    """A spring out of the plane, a start tilted by 1e-6, a joint open by 1e-10, a free body."""
    problem = library("hinge_pendulum")
    e = plane_of(problem, False).world[2]
    spring = lieeuler.LinearSpring(-1, 0, problem.x[0] + e, [0, 0, 0], 10.0, 0.5)
    open_ = dataclasses.replace(problem, x=problem.x + 1e-10)
    free = lieeuler.Problem([problem.bodies[0]] * 2, problem.joints, problem.gravity, np.repeat(problem.x, 2, axis=0),
                            np.repeat(problem.R, 2, axis=0), np.repeat(problem.v, 2, axis=0),
                            np.repeat(problem.w, 2, axis=0))
    for other in (dataclasses.replace(problem, forces=(spring,)), open_, free):
        assert lieeuler.integrate(other, "rattle2", 1e-3, [0.0, 0.01]).stats.reduce == "off"


def test_words():
    problem = library("four_bar")
    with pytest.raises(lieeuler.ArgumentError,
                       match="reduce must be one of welded, planar, axis, joints, off, not 'plane'"):
        lieeuler.integrate(problem, "rattle2", 1e-3, [0.0, 0.01], reduce="plane")
    with pytest.raises(lieeuler.ArgumentError, match="reduce='axis' does not apply: its bodies do not all turn"):
        lieeuler.integrate(problem, "rattle2", 1e-3, [0.0, 0.01], reduce="axis")
    for method, chart, word in (("DAE1L_LSE", "exp", "planar"), ("DAE1H_LSE", "cayley", "planar"),
                                ("DAE1L_LSE", "ccsk", "off"), ("DAE2L_LSE", "exp", "off"), ("INDEX1_LE", "exp", "off")):
        assert lieeuler.integrate(problem, method, 1e-3, [0.0, 0.01], map=chart).stats.reduce == word
    assert lieeuler.integrate(pickle.loads(pickle.dumps(problem)), "rkmk4", 1e-3, [0.0, 0.01]).stats.reduce == "planar"


def test_a_run_that_ends_early_comes_back_whole():
    problem = library("four_bar")
    with pytest.raises(lieeuler.IntegrationError) as ended:
        lieeuler.integrate(problem, "rattle2", 0.5, np.linspace(0, 50, 101), reduce="planar")
    solution = ended.value.solution
    assert solution.stats.reduce == "planar"
    assert solution.lam.shape == (len(solution.t), problem.rows)


def test_crosscheck_passes_the_word_on():
    traj = crosscheck.run("four_bar", "lieeuler", "rkmk4", step=1e-2, duration=0.1, reduce="off")
    assert traj.stats["reduce"] == "off"
    assert crosscheck.run("four_bar", "lieeuler", "rkmk4", step=1e-2, duration=0.1).stats["reduce"] == "planar"
    with pytest.raises(crosscheck.ArgumentError, match="reduce: mujoco does not have this option"):
        crosscheck.run("four_bar", "mujoco", "RK4", step=1e-2, reduce="planar")
    with pytest.raises(crosscheck.ArgumentError, match="reduce"):
        crosscheck.run("four_bar", "lieeuler", "rkmk4", step=1e-2, reduce="plane")
