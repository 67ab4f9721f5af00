"""MuJoCo's models, in both forms: the scene and nothing else; their equations of motion; what they refuse."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.mujoco import models
from crosscheck.errors import EngineError
from crosscheck.scene import mechanics
from crosscheck.scene.model import Force, Scene
from crosscheck.scene.states import States
from tests.adapters.pairs import loaded_pair
from tests.adapters.scenes import library, off_the_equations, relative
from tests.scene_making import JOINT_TYPES, make_scene, random_body

ROUNDING = 1e-12  # some thousand roundings of numbers of size 1: sums over a chain, relative
CONDITIONING = 1e-10  # of two different eliminations of one system
LONG_CHAIN = 1e-8  # the same for 64 bodies in joint coordinates, whose mass matrix has a condition number of 1e8
MASS_RATIO = 1e-8  # the same where a light body carries a heavy one: G M^-1 G^T has a condition number of 7e6
LOOPS = ("bricard", "double_four_bar", "four_bar", "parallelogram", "slider_crank", "taut_chain", "squeezer")
RODS = ("rod_pendulum", "iftomm_simple_pendulum")
OPEN = tuple(name for name in crosscheck.scenes() if name not in LOOPS + RODS)
SLIDES = ("cylindrical", "prismatic", "planar", "point_on_line", "point_on_plane")


def _reason(scene: Scene, form: str | None, method: str = "RK4") -> str | None:
    return adapters.get("mujoco").unsupported(scene, RunSpec(method, step=1e-3, form=form))


def _states(scene: Scene, form: str, steps: int = 4, method: str = "RK4", step: float | None = None) -> States:
    step = step or (1e-5 if "stiff" in scene.tags else 1e-3)  # an explicit method has to resolve the fastest rate
    short = scene.replace(duration=step * steps, samples=steps + 1)
    return adapters.get("mujoco").run(short, RunSpec(method, step=step, form=form)).states


MODELS = [(name, form) for name in crosscheck.scenes() for form in ("tree", "maximal")
          if _reason(library(name), form) is None]


@pytest.mark.parametrize(("name", "form"), MODELS)
def test_model_is_the_scene_and_nothing_else(name: str, form: str) -> None:
    import mujoco

    scene = library(name)
    model = models.build(scene, "RK4", 1e-3, form)
    springs = [force for force in scene.forces if force.type == "linear_spring"]
    torsions = [force for force in scene.loads if force.is_spring and force.joint is not None]
    _, closing = models.closures(scene, form)
    rods = sum(joint.type in ("distance", "universal") for joint in closing)
    points = sum({"distance": 0, "revolute": 2}.get(joint.type, 1) for joint in closing)

    assert model.nbody == scene.n + 1
    mimics = sum(joint.mimic is not None for joint in scene.joints)
    assert (model.neq, model.ntendon) == (points + rods + mimics, len(springs) + rods)
    loads = [force for force in scene.forces if not force.type.endswith("spring")]
    moving = [force for force in torsions if force.functions]  # an actuator moves the rest angle
    assert model.nu == len(loads) + len(moving)
    absent = (model.ngeom, model.nsensor, model.npair, model.nflex, model.nexclude, model.nplugin, model.nmocap)
    assert absent == (0,) * len(absent)
    for extra in (model.dof_frictionloss, model.jnt_limited, model.tendon_limited,
                  model.tendon_frictionloss, model.tendon_armature, model.body_gravcomp, model.opt.wind,
                  [model.opt.density, model.opt.viscosity]):
        assert not np.any(extra)
    for found, wanted in ((model.jnt_stiffness, [force.parameters["stiffness"] for force in torsions]),
                          (model.dof_damping, [force.parameters["damping"] for force in torsions]),
                          (model.dof_armature, [value for joint in scene.joints for value in joint.armature]),
                          (model.tendon_stiffness, [force.parameters["stiffness"] for force in springs]),
                          (model.tendon_damping, [force.parameters["damping"] for force in springs])):
        assert sorted(found[np.nonzero(found)]) == sorted(value for value in wanted if value)
    assert model.opt.gravity.tolist() == scene.gravity.tolist()
    assert model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT


@pytest.mark.parametrize(("name", "form"), MODELS)
def test_bodies_are_those_of_the_scene(name: str, form: str) -> None:
    import mujoco

    scene = library(name)
    model = models.build(scene, "RK4", 1e-3, form)
    data = mujoco.MjData(model)
    models.set_initial_state(scene, model, data)
    mujoco.mj_forward(model, data)
    for index in range(scene.n):
        body = model.body(str(index)).id
        frame = data.ximat[body].reshape(3, 3)  # principal axes
        inertia = frame @ np.diag(model.body_inertia[body]) @ frame.T
        assert model.body_mass[body] == scene.masses[index]
        assert relative(data.xipos[body], scene.x0[index]) < ROUNDING
        assert relative(data.xmat[body].reshape(3, 3), scene.R0[index]) < ROUNDING
        assert relative(inertia, scene.R0[index] @ scene.inertias[index] @ scene.R0[index].T) < ROUNDING


@pytest.mark.parametrize("name", [name for name in OPEN if _reason(library(name), "tree") is None
                                  and not models.softened(library(name), "tree")])
def test_tree_accelerations_are_those_of_the_scene(name: str) -> None:
    """At every sample the engine's own accelerations solve the equations of motion at the engine's own state."""
    scene = library(name)
    states = _states(scene, "tree")
    assert relative(states.v[0], scene.v0) < ROUNDING
    assert relative(states.w[0], scene.w0) < ROUNDING
    bound = {"chain_64": LONG_CHAIN, "light_heavy": MASS_RATIO}.get(name, CONDITIONING)
    assert off_the_equations(scene, states) < bound


@pytest.mark.parametrize("kind", [kind for kind in JOINT_TYPES if kind != "distance"])
@pytest.mark.parametrize("inward", [False, True])
def test_tree_with_every_joint_and_force_either_way_round(kind: str, inward: bool) -> None:
    scene = loaded_pair(kind, inward)
    states = _states(scene, "tree", steps=40)
    assert relative(states.x[0], scene.x0) < ROUNDING
    assert off_the_equations(scene, states) < CONDITIONING
    run = crosscheck.run(scene, "mujoco", "RK4", step=1e-3, duration=0.04, samples=2)
    bounds = {"position": 1e-13, "velocity": 1e-12, "acceleration": 1e-9}  # rounding, growing with derivatives
    assert all(run.stats[f"constraint_{level}"] < bound for level, bound in bounds.items())


@pytest.mark.parametrize("method", ["Euler", "implicit", "implicitfast"])
def test_accelerations_are_derivatives(method: str) -> None:
    scene = loaded_pair("cylindrical")
    states = _states(scene, "tree", method=method)
    assert off_the_equations(scene, states) < CONDITIONING


def test_accelerations_of_discrete_are_changes_of_velocity_over_the_next_step() -> None:
    """In the metric of springs and dampers: they come to the derivatives with order 1."""
    scene, step = loaded_pair("cylindrical"), 1e-4
    states = _states(scene, "tree", 10, "discrete", step)
    for rates, given in ((states.v, states.a), (states.w, states.alpha)):
        assert relative(np.diff(rates, axis=0) / step, given[:-1]) < 1e-3  # half a step of their change
    gaps = []
    for h in (step, step / 2):
        found = _states(scene, "tree", 4, "discrete", h)
        a, alpha, _ = mechanics.index1(scene, found.x, found.R, found.v, found.w)
        gaps.append([relative(found.a, a), relative(found.alpha, alpha)])
    assert np.divide(*gaps) == pytest.approx(2.0, rel=0.05)


def test_free_bodies_fly_in_either_form() -> None:
    rng = np.random.default_rng(8)
    scene = make_scene([random_body(rng, "first"), random_body(rng, "second")], [])
    tree, maximal = (_states(scene, form) for form in ("tree", "maximal"))
    assert off_the_equations(scene, tree) < ROUNDING
    assert np.array_equal(tree.x, maximal.x)


ORDERS = [("double_pendulum", "maximal"), ("universal_pendulum", "maximal"), ("hinge_pendulum", "maximal"),
          ("fixed_pair", "maximal"), ("rod_pendulum", "maximal"), ("four_bar", "tree"), ("bricard", "tree")]


@pytest.mark.parametrize(("name", "form"), ORDERS)
@pytest.mark.parametrize("method", ["RK4", "discrete"])
def test_tight_constraints_converge_to_truth(name: str, form: str, method: str) -> None:
    """Velocities with order 1, as documented by the adapter, and RK4's positions with order 2."""
    scene = library(name).replace(duration=0.5, samples=3)
    truth = crosscheck.truth(scene).states
    assert adapters.get("mujoco").documented_order(scene, RunSpec(method, form=form)) == 1
    errors = []
    for step in (5e-4, 2.5e-4):
        run = crosscheck.run(scene, "mujoco", method, step=step, form=form, monitor=False)
        errors.append([np.abs(getattr(run, field) - getattr(truth, field)).max() for field in ("x", "R", "v", "w")])
    orders = np.log2(np.divide(*errors))
    # the usual bands; from above, as higher terms still contribute
    assert orders.min() > 1 - 0.1
    if method == "RK4":
        assert orders[:2].min() > 2 - 0.15


def test_softness_is_mujocos_own_or_its_stiffest() -> None:
    scene = library("double_pendulum")
    own, tight = (models.build(scene, "RK4", 1e-3, "maximal", softness) for softness in ("default", "tight"))
    assert np.all(own.eq_solref == [0.02, 1.0])
    assert np.all(own.eq_solimp == [0.9, 0.95, 0.001, 0.5, 2.0])
    assert np.all(tight.eq_solref == [0.002, 1.0])
    assert np.all(tight.eq_solimp[:, :2] == 0.9999)
    runs = [crosscheck.run(scene, "mujoco", "RK4", step=1e-2, form="maximal", softness=softness, duration=0.1)
            for softness in ("default", "tight", None)]
    assert [run.stats["softness"] for run in runs] == ["default", "tight", "tight"]
    assert np.array_equal(runs[1].x, runs[2].x)
    assert "softness" not in crosscheck.run(scene, "mujoco", "RK4", step=1e-2, duration=0.1).stats  # nothing is soft


def test_discrete_differs_from_euler_where_there_is_damping_or_stiffness() -> None:
    scene = library("damped_pendulum").replace(duration=0.5, samples=3)
    first, second = (crosscheck.run(scene, "mujoco", method, step=1e-3, monitor=False)
                     for method in ("discrete", "Euler"))
    assert np.abs(first.x - second.x).max() > 1e-6


def test_the_best_form_is_found() -> None:
    forms = {name: adapters.get("mujoco").form(library(name), RunSpec("RK4"))
             for name in crosscheck.scenes()}
    assert {name for name, form in forms.items() if form == "maximal"} == set(RODS)


@pytest.mark.parametrize("kind", SLIDES)
def test_maximal_has_no_slides(kind: str) -> None:
    reason = _reason(loaded_pair(kind, spring=False), "maximal")
    assert reason is not None
    assert kind in reason
    assert "joint" in reason


def test_what_cannot_be_modelled_is_said() -> None:
    spring = library("torsion_wheel")
    assert "the spring of joint 'hinge'" in (_reason(spring, "maximal") or "")
    rod = library("rod_pendulum")
    assert "'rod'" in (_reason(rod, "tree") or "")
    assert "form pivot" in (_reason(rod, "pivot") or "")
    crank = library("slider_crank")
    guides = [dataclasses.replace(joint, type="prismatic", parent_axis=np.eye(3)[0], child_axis=np.eye(3)[0])
              for joint in crank.joints]
    assert "closes a loop" in (_reason(crank.replace(joints=tuple(guides)), "tree") or "")
    # both hinges of a loop's last body have springs, but one of them is no coordinate
    bar = library("four_bar")
    sprung = tuple(Force("torsional_spring", None, None, joint.name,
                         {"stiffness": 1.0, "rest_angle": 0.0, "damping": 0.0}) for joint in bar.joints)
    assert "spring of joint" in (_reason(bar.replace(forces=sprung), "tree") or "")
    assert _reason(bar.replace(forces=sprung[-1:]), "tree") is None


@pytest.mark.parametrize(("name", "form"), [("heavy_top", "maximal"), ("slider_crank", "tree")])
@pytest.mark.parametrize("monitor", [True, False])
def test_divergence_under_constraints_is_an_engine_error(name: str, form: str, monitor: bool) -> None:
    """With a step of half a second every stage is far outside the region of stability; nothing is reset silently."""
    scene = library(name).replace(duration=200.0, samples=3)
    with pytest.raises(EngineError, match=r"MuJoCo warned: .*Try a smaller step|diverged"):
        crosscheck.run(scene, "mujoco", "RK4", step=0.5, form=form, monitor=monitor)
