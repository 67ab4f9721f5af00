"""Mechanisms reduced to their plane move like the whole systems, to rounding, and return all states."""

import dataclasses
import pickle
import re
from random import Random

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
import lieeuler
from lieeuler.planar import plane_of
from tests import random_mechanisms
from tests.lieeuler.accuracy import largest_difference, library

PLANAR = ("four_bar", "parallelogram", "planar_slider", "driven_cart", "torsion_wheel", "hinge_pendulum")
TURNING = ("torsion_wheel", "hinge_pendulum")


def turned(problem, Q):
    """The problem in a world turned by Q (3, 3), its bodies' axes turned at random; forces are linear springs."""
    P = Rotation.random(problem.n, random_state=3).as_matrix()

    def item(thing):
        ends = {"parent": Q if thing.parent == -1 else P[thing.parent], "child": P[thing.child]}
        changed = {}
        for field in dataclasses.fields(thing):
            value = getattr(thing, field.name)
            if isinstance(value, np.ndarray) and value.shape == (3,):
                changed[field.name] = ends["parent" if field.name.startswith("parent") else "child"] @ value
        if isinstance(thing, lieeuler.Joint):
            changed["dots"] = tuple(dataclasses.replace(
                dot, a_axis=ends.get(dot.a, np.eye(3)) @ dot.a_axis, b_axis=ends.get(dot.b, np.eye(3)) @ dot.b_axis)
                for dot in thing.dots)
        return dataclasses.replace(thing, **changed)

    bodies = [lieeuler.Body(b.mass, (T @ b.inertia @ T.T + (T @ b.inertia @ T.T).T) / 2)
              for b, T in zip(problem.bodies, P, strict=True)]
    R = Q @ problem.R @ np.swapaxes(P, 1, 2)
    return lieeuler.Problem(bodies, [item(j) for j in problem.joints], Q @ problem.gravity, problem.x @ Q.T, R,
                            problem.v @ Q.T, np.einsum("bij,bj->bi", P, problem.w), [item(f) for f in problem.forces])


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
    ("DAE1L_LSE", {"coordinate_map": "cayley"}), ("DAE1L_LSE", {"correction": "plain", "polish": False}),
    ("DAE1H_LSE", {"coordinate_map": "cayley"})])
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


@pytest.mark.parametrize("seed", range(24))
def test_random_mechanisms_move_alike_in_their_plane(seed):
    """All flat joints, graded masses, loads in any direction; some are rigid, some have no hinge or odd springs."""
    problem = random_mechanisms.mechanism(Random(seed), flat=True)
    size = np.abs(problem.x).max()
    rate = problem.kernel.natural_rate(problem.kernel.length)
    for method in ("rattle2", "DAE1H_LSE"):
        try:
            off, on = (lieeuler.integrate(problem, method, 1e-3 / rate, [0.0, 5e-2 / rate], reduce=word)
                       for word in ("off", "planar"))
        except lieeuler.IntegrationError as ended:
            if ended.status in (lieeuler.Status.SINGULAR_MATRIX, lieeuler.Status.NEWTON_FAILED):
                continue
            raise
        except lieeuler.ArgumentError as refused:
            if re.search("pulls out of the plane|no joint turns", str(refused)):
                continue
            raise
        assert np.abs(off.x - on.x).max() < 1e-8 * size
        assert np.abs(off.R - on.R).max() < 1e-8


@pytest.mark.parametrize(("reduce", "word"), [("planar", "planar"), (None, "welded, planar")])
def test_multipliers_are_right_where_rows_have_lost_a_rank(reduce, word):
    """G^T lam = f - M a, by the dense blocks of the kernel."""
    assert random_mechanisms.answer(Random(8002679)) == "success"
    random = Random(8002679)
    make, options = random_mechanisms.case(random, flat=random.random() < 0.2)
    problem = make()
    solution = lieeuler.integrate(problem, **options, reduce=reduce)
    assert solution.stats.reduce == word
    for k in range(len(solution.t)):
        state = [np.ascontiguousarray(getattr(solution, name)[k]) for name in ("x", "R", "v", "w")]
        lam = np.ascontiguousarray(solution.lam[k])
        G = lieeuler._kernel.constraints(problem.kernel, *state, lam)["G"]
        applied = lieeuler._kernel.forces(problem.kernel, *state)["f"]
        inertia = np.ravel([np.r_[body.mass * a, body.inertia @ alpha + np.cross(w, body.inertia @ w)]
                            for body, a, alpha, w in zip(problem.bodies, solution.a[k], solution.alpha[k],
                                                         solution.w[k], strict=True)])
        assert np.abs(G.T @ lam - (applied - inertia)).max() < 1e-10 * np.abs(applied).max()


def test_a_run_in_its_plane_ends_where_the_whole_system_has_no_multipliers():
    """The inertia of this body is all but singular; no part of it acts in the plane."""
    assert random_mechanisms.answer(Random(8604665)) == "singular_matrix"


@pytest.mark.parametrize("name", ["four_bar", "hinge_pendulum"])
def test_any_plane_will_do(name):
    """An oblique plane, body axes that do not lie along it, and every body at another height."""
    problem = turned(library(name), Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
    for method in ("rattle2", "DAE1H_LSE"):
        off, on = (lieeuler.integrate(problem, method, 5e-3, [0.0, 0.2, 0.4], reduce=word)
                   for word in ("off", "planar"))
        assert largest_difference(off, on) < 1e-11
        assert max(on.stats.maxima[f"constraint_{level}"] for level in ("position", "velocity")) < 1e-12


def test_springs_keep_their_turns():
    """A wheel that has turned five times: rest angle, unwrapped angle and multipliers are those of the whole system."""
    z = [0.0, 0.0, 1.0]
    hinge = lieeuler.revolute_joint(-1, 0, [0, 0, 0], [0, 0, 0], z, z)
    R = Rotation.from_rotvec([0, 0, 3.0]).as_matrix()
    wheel = lieeuler.Problem([lieeuler.Body(1.0, np.diag([1.0, 1.0, 1.5]))], [hinge], [0.0, -3.0, -9.81], [[0, 0, 0]],
                             [R], [[0, 0, 0]], [[0, 0, 20.0]], [lieeuler.TorsionalSpring(-1, 0, z, z, 2.0, 0.4, 0.1)])
    off, on = (lieeuler.integrate(wheel, "taylor", t_eval=np.linspace(0, 2, 9), rtol=1e-13, reduce=word)
               for word in ("off", "axis"))
    assert largest_difference(off, on) < 1e-12
    assert on.alpha[:, 0, 2].min() < -20  # a spring of 2 N m/rad on 1.5 kg m^2, wound up by five turns


def pinned_bodies(random):
    """Up to three unlike bodies on parallel pins, tied by springs that wind up, under loads fixed in world and body."""
    n, z = random.integers(1, 4), np.array([0.0, 0.0, 1.0])
    moments = random.uniform(0.2, 1.0, (n, 3))
    bodies = [lieeuler.Body(m, np.diag([a + b, b + c, c + a]))
              for m, (a, b, c) in zip(random.uniform(0.5, 3.0, n), moments, strict=True)]
    arms, pins = random.normal(size=(n, 3)), random.normal(size=(n, 3))
    w = np.outer(random.normal(scale=6.0, size=n), z)
    forces = [lieeuler.TorsionalSpring(b - 1, b, z, z, *random.uniform(0.1, 5.0, 2), random.uniform(0, 0.2))
              for b in range(n)]
    forces += [lieeuler.ConstantLoad(b, force=random.normal(size=3), torque=random.normal(size=3),
                                     point=random.normal(size=3), frame=frame)
               for b in range(n) for frame in ("world", "body")]
    R = Rotation.from_rotvec(np.outer(random.uniform(-3, 3, n), z)).as_matrix()
    joints = [lieeuler.revolute_joint(-1, b, pins[b], arms[b], z, z) for b in range(n)]
    reach = -np.einsum("bij,bj->bi", R, arms)
    return lieeuler.Problem(bodies, joints, random.normal(scale=9.0, size=3), pins + reach, R, np.cross(w, reach), w,
                            forces)


@pytest.mark.parametrize("seed", range(8))
def test_bodies_on_pins_are_angles(seed):
    """The series of the angles are those of the attitudes, with multipliers and accelerations, over several turns."""
    problem = pinned_bodies(np.random.default_rng(seed))
    off, on = (lieeuler.integrate(problem, "taylor", t_eval=np.linspace(0, 2, 9), rtol=1e-13, reduce=word)
               for word in ("off", "axis"))
    assert largest_difference(off, on) < 2e-11
    assert on.stats.steps < 0.8 * off.stats.steps


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
    e = plane_of(problem, pins=False).normal
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
    e = plane_of(problem, pins=False).normal
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
        assert lieeuler.integrate(problem, method, 1e-3, [0.0, 0.01], coordinate_map=chart).stats.reduce == word
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
