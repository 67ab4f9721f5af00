"""Scenes whose welded bodies are integrated as one move like the bodies and their welds; what is no weld is told."""

import dataclasses
import pickle
from random import Random

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
import lieeuler
from lieeuler.welded import welded_for
from tests.adapters.lieeuler.against_truth import library
from tests.lieeuler.accuracy import FIELDS, largest_difference
from tests.lieeuler.test_welded import Z, angle_between, both, problem_of, random_tree, weld
from tests.random_mechanisms import joint


@pytest.mark.parametrize("method", ["taylor", "rkmk853"])
@pytest.mark.parametrize("name", ["fixed_pair", "branching_tree"])
def test_welds_change_nothing_but_the_cost(name, method):
    off, on = both(library(name), method, rtol=1e-13)
    assert (on.stats.reduce, off.stats.reduce) == ("welded", "off")
    assert largest_difference(off, on) < 1e-11


@pytest.mark.parametrize(("method", "step"), [("rkmk4", 4e-3), ("rattle4", 4e-3), ("generalized_alpha", 1e-3),
                                              ("seulex", None)])
@pytest.mark.parametrize("name", ["fixed_pair", "branching_tree"])
def test_errors_are_those_of_the_method(name, method, step):
    """Against the whole system in the series: of the same size, welded or not, in every quantity."""
    problem = library(name)
    best = both(problem, rtol=1e-13)[0]
    off, on = both(problem, method, **({"step": step} if step else {"rtol": 1e-11}))
    room = 1e-11 * (1 if step else on.stats.steps)  # each step of an adaptive method keeps its tolerance
    assert largest_difference(best, on) < 2 * largest_difference(best, off) + room
    assert largest_difference(best, on) < (1e-4 if method == "generalized_alpha" else 1e-7)
    if step:
        finer = both(problem, method, step=step / 2)[1]
        order = lieeuler.METHODS[method].order
        assert largest_difference(best, finer) < largest_difference(best, on) / 2 ** (order - 0.5)


def test_welds_are_closed_to_rounding_at_the_samples():
    for problem in (library("fixed_pair"), library("branching_tree"), random_tree(1), random_tree(3)):
        on = both(problem, "rkmk4", step=0.02)[1]
        welds = [k for k in problem.joints if len(k.dots) == 3 and k.spherical]
        only = dataclasses.replace(problem, joints=tuple(welds), forces=())
        arrays = [np.ascontiguousarray(getattr(on, name)) for name in ("x", "R", "v", "w")]
        assert lieeuler._kernel.constraint_levels(only.kernel, *arrays, 0.0, 0.0).max() < 1e-13


def test_look_alikes_are_left_alone():
    """Welds to the ground, a weld open by 1e-10, a spring or a joint between two welded bodies, welds in a loop, welds
    with a rotor, rows that only look like a weld's."""
    random = Random(2)
    problem = problem_of(random, [(0, 1), (1, 2)], ["fixed", "revolute"])
    assert welded_for(problem) is not None
    index = next(k for k, each in enumerate(problem.joints) if each.rows == 6)

    def with_weld(changed):
        return dataclasses.replace(problem, joints=(*problem.joints[:index], changed, *problem.joints[index + 1:]))

    known = problem.joints[index]
    a, b, c = known.dots
    z = known.dots[0].a_axis
    across = [dataclasses.replace(a, a_axis=z, b_axis=problem.R[1].T @ problem.R[0] @ n) for n in np.eye(3)[[1, 2, 1]]]
    at = angle_between(problem, 0, 1, z, 0.0)
    bound = joint(random, "point_on_plane", 0, 2, problem.x, problem.R, 0.3).following(lieeuler.Mimic(
        index, angle_between(problem, 0, 2, z, 0.0), at, 0.0))
    spring = lieeuler.LinearSpring(0, 1, [0, 0, 0], [0, 0, 0], 3.0, 0.1)
    single = dataclasses.replace(library("hinge_pendulum"), v=np.zeros((1, 3)), w=np.zeros((1, 3)))
    others = {
        "ground": dataclasses.replace(single, joints=(weld(single, -1, 0),)),
        "open": dataclasses.replace(problem, x=problem.x + np.outer([0, 1e-10, 0], Z)),
        "spring": dataclasses.replace(problem, forces=(spring,)),
        "joint": dataclasses.replace(problem, joints=(*problem.joints, joint(random, "spherical", 1, 0, problem.x,
                                                                             problem.R, 0.3))),
        "loop": dataclasses.replace(problem, joints=(*problem.joints, weld(problem, 1, 0))),
        "rotor": with_weld(known.geared(lieeuler.Rotor(0.1, z, problem.R[1].T @ problem.R[0] @ z))),
        "two rows": with_weld(dataclasses.replace(known, dots=(a, b))),
        "a row twice": with_weld(dataclasses.replace(known, dots=(a, b, dataclasses.replace(b)))),
        "a row of no size": with_weld(dataclasses.replace(known, dots=(a, b, dataclasses.replace(c, scale=1e-9)))),
        "a leader": dataclasses.replace(problem, joints=(*problem.joints, bound)),
        "axes in one plane": with_weld(dataclasses.replace(known, dots=tuple(across))),
    }
    for name, other in others.items():
        assert welded_for(other) is None, name
    for name in ("open", "spring", "two rows"):
        assert lieeuler.integrate(others[name], "rkmk4", 1e-3, [0.0, 0.01]).stats.reduce == "off", name


def test_words():
    problem = library("fixed_pair")
    for name in ("four_bar", "double_pendulum"):
        with pytest.raises(lieeuler.ArgumentError, match=r"^reduce='welded' does not apply: no two bodies are welded"):
            lieeuler.integrate(library(name), "rkmk4", 1e-3, [0.0, 0.01], reduce="welded")
    for method in ("DAE1L_LSE", "DAE3H_LE", "BAUMGARTE_LE"):
        assert lieeuler.integrate(problem, method, 1e-3, [0.0, 0.01]).stats.reduce == "off"
        assert lieeuler.integrate(problem, method, 1e-3, [0.0, 0.01], reduce="welded").stats.reduce == "welded"
    for method in ("rkmk4", "rattle2", "generalized_alpha"):
        assert lieeuler.integrate(problem, method, 1e-3, [0.0, 0.01]).stats.reduce == "welded"
    copy = pickle.loads(pickle.dumps(problem))
    run, again = (lieeuler.integrate(each, "taylor", t_eval=[0.0, 0.3, 0.5]) for each in (problem, copy))
    assert again.stats.reduce == "welded"
    assert all((getattr(run, name) == getattr(again, name)).all() for name in FIELDS)
    assert crosscheck.run("fixed_pair", "lieeuler", "rkmk4", step=1e-2, duration=0.1).stats["reduce"] == "welded"


def welded_on(name, body):
    """A planar mechanism with a further body welded on one of its bodies, out of its plane, at an angle."""
    problem = library(name)
    twist = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    arm = np.array([0.2, 0.1, -0.3])
    x = problem.x[body] + problem.R[body] @ arm
    v = problem.v[body] + problem.R[body] @ np.cross(problem.w[body], arm)
    part = lieeuler.Body(0.8, np.diag([0.02, 0.03, 0.04]))
    return dataclasses.replace(
        problem, bodies=(*problem.bodies, part),
        joints=(*problem.joints, lieeuler.fixed_joint(body, problem.n, arm, np.zeros(3), twist.T)),
        x=np.vstack([problem.x, x]), v=np.vstack([problem.v, v]), w=np.vstack([problem.w, twist.T @ problem.w[body]]),
        R=np.concatenate([problem.R, [problem.R[body] @ twist]]))


@pytest.mark.parametrize(("name", "word"), [("four_bar", "welded, planar"), ("hinge_pendulum", "welded, axis"),
                                            ("torsion_wheel", "welded, axis")])
def test_a_mechanism_with_a_weld_is_reduced_to_its_plane_after_it(name, word):
    """With the angles of springs on their way back through both."""
    problem = welded_on(name, 0)
    off, on = both(problem, rtol=1e-12, word=None)
    assert on.stats.reduce == word
    assert on.stats.redundant_rows == off.stats.redundant_rows
    assert largest_difference(off, on) < 1e-10


def test_a_run_that_ends_early_comes_back_whole():
    """With welds and the plane left out, all arrays have the samples that were reached."""
    problem = welded_on("four_bar", 1)
    with pytest.raises(lieeuler.IntegrationError) as ended:
        lieeuler.integrate(problem, "rattle2", 0.5, np.linspace(0, 50, 101))
    solution = ended.value.solution
    assert solution.stats.reduce == "welded, planar"
    assert {len(getattr(solution, name)) for name in FIELDS} == {len(solution.t)}
    assert solution.x.shape[1:] == (problem.n, 3)
    assert solution.lam.shape == (len(solution.t), problem.rows)
