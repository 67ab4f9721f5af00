"""Exudyn's models, in all forms and on both kinds of nodes: the scene and nothing else; their equations of motion."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.exudyn import adapter as exudyn_adapter
from crosscheck.adapters.exudyn import kinematic_tree, models
from crosscheck.adapters.exudyn.independent import dropped_axes
from crosscheck.scene import mechanics
from crosscheck.scene.model import GROUND, Scene
from crosscheck.scene.spanning import spanning_tree
from crosscheck.scene.states import States
from tests.adapters.pairs import loaded_pair
from tests.adapters.scenes import library, off_the_equations, off_the_start, relative
from tests.adapters.test_lieeuler import exact
from tests.scene_making import JOINT_TYPES, make_scene, random_body

ROUNDING = 1e-12  # some thousand roundings of numbers of size 1, relative
CONDITIONING = 1e-10  # of two different eliminations of one system
DIFFERENCES = 1e-6  # Exudyn takes velocity-dependent parts of the start from one-sided differences of size 1e-7
NODES = ("lie", "euler_parameters")
REDUNDANT = ("bricard", "double_four_bar", "four_bar", "parallelogram", "squeezer")
CONNECTORS = {"spherical": "JointSpherical", "distance": "ConnectorDistance", "linear_spring": "ConnectorSpringDamper",
              "torsional_spring": "ConnectorTorsionalSpringDamper"}
NO_LOADS = ("linear_spring", "torsional_spring")


@pytest.fixture(autouse=True)
def _loaded() -> None:
    exudyn_adapter.load()


def _reason(scene: Scene, method: str, form: str | None, node: str | None = None) -> str | None:
    return adapters.get("exudyn").unsupported(scene, RunSpec(method, step=1e-3, form=form, node=node))


def _states(scene: Scene, method: str, form: str, steps: int = 4, node: str | None = None) -> States:
    short = scene.replace(duration=1e-3 * steps, samples=steps + 1)
    return adapters.get("exudyn").run(short, RunSpec(method, step=1e-3, form=form, node=node)).states


def _objects(system: Any) -> list[dict[str, Any]]:
    return [system.GetObject(index) for index in range(system.systemData.NumberOfObjects())]


def _loads(system: Any) -> list[dict[str, Any]]:
    return [system.GetLoad(index) for index in range(system.systemData.NumberOfLoads())]


def _load_count(scene: Scene) -> int:
    """Number of Exudyn's loads: one for each force, and one on each body of a motor's joint."""
    bodies = {joint.name: (joint.parent, joint.child) for joint in scene.joints}
    return sum(1 if force.joint is None else sum(body != GROUND for body in bodies[force.joint])
               for force in scene.forces if force.type not in NO_LOADS)


def _check_springs(scene: Scene, objects: list[dict[str, Any]]) -> None:
    """Each spring has its own stiffness and damping, and none of the other properties of Exudyn's springs."""
    for force, found in zip((f for f in scene.forces if f.type in NO_LOADS), objects, strict=True):
        p = force.parameters
        assert (found["stiffness"], found["damping"]) == (p["stiffness"], p["damping"])
        assert found["velocityOffset"] == 0.0
        assert found.get("force", 0.0) == found.get("torque", 0.0) == 0.0
        rest = found["referenceLength"] if "free_length" in p else found["offset"]
        assert rest == (p["free_length"] if "free_length" in p else p["rest_angle"])


@pytest.mark.parametrize("name", [name for name in crosscheck.scenes()
                                  if library(name).beyond() is None])
@pytest.mark.parametrize("node", NODES)
def test_maximal_model_is_the_scene_and_nothing_else(name: str, node: str) -> None:
    scene = library(name)
    system = models.maximal(scene, node).system
    objects = _objects(system)
    springs = [force.type for force in scene.forces if force.type in NO_LOADS]
    joints = [joint.type for joint in scene.joints]
    assert [item["objectType"] for item in objects] == [
        "Ground", *["RigidBody"] * scene.n, *(CONNECTORS.get(kind, "JointGeneric") for kind in joints),
        *(CONNECTORS[kind] for kind in springs)]
    for item, mass, inertia, turn in zip(objects[1:], scene.masses, scene.inertias, scene.R0, strict=False):
        xx, yy, zz, yz, xz, xy = item["inertia"]
        stated = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert item["mass"] == mass
        assert not np.any(item["centerOfMass"])
        assert relative(stated, turn @ inertia @ turn.T) < ROUNDING  # node axes are the world's at the start
    _check_springs(scene, objects[1 + scene.n + len(joints):])
    loads = _loads(system)
    assert [load["loadVector"].tolist() for load in loads[:scene.n]] == [scene.gravity.tolist()] * scene.n
    assert len(loads) == scene.n + _load_count(scene)
    kinds = [system.GetNode(index)["nodeType"] for index in range(system.systemData.NumberOfNodes())]
    body = {"lie": "RigidBodyRotVecLG", "euler_parameters": "RigidBodyEP"}[node]
    assert sorted(kinds) == sorted([body] * scene.n + ["GenericData"] * springs.count("torsional_spring"))


@pytest.mark.parametrize("name", [name for name in crosscheck.scenes()
                                  if _reason(library(name), "GeneralizedAlpha", "tree") is None])
def test_tree_model_is_the_scene_and_nothing_else(name: str) -> None:
    scene = library(name)
    system = kinematic_tree.kinematic_tree(scene, "XYZ").system
    tree, *others = _objects(system)
    _, closing = kinematic_tree.spanned(scene)
    assert np.sum(tree["linkMasses"]) == pytest.approx(scene.masses.sum(), rel=1e-15)
    assert tree["gravity"].tolist() == scene.gravity.tolist()
    torsions = [force.parameters for force in scene.loads if force.is_spring and force.joint is not None]
    for key, name_ in (("jointPControlVector", "stiffness"), ("jointDControlVector", "damping")):
        found = np.array(tree[key])
        assert sorted(found[np.nonzero(found)]) == sorted(p[name_] for p in torsions if p[name_])
    for key in ("jointForceVector", "jointVelocityOffsetVector"):
        assert not np.any(tree[key])
    springs = [force for force in scene.forces if force.type == "linear_spring"]
    geared = any(any(joint.armature) for joint in scene.joints)
    ratios = [joint.mimic.ratio for joint in scene.joints if joint.mimic is not None]
    kinds = [*["GenericODE2"] * geared, *["ConnectorCoordinate"] * len(ratios),
             *(CONNECTORS.get(joint.type, "JointGeneric") for joint in closing),
             *[CONNECTORS["linear_spring"]] * len(springs)]
    assert sorted(abs(item["factor1"]) for item in others if item["objectType"] == "ConnectorCoordinate") == sorted(
        map(abs, ratios))
    assert [item["objectType"] for item in others if item["objectType"] != "Ground"] == kinds
    assert len(_loads(system)) == _load_count(scene)


@pytest.mark.parametrize("kind", [kind for kind in JOINT_TYPES if kind != "distance"])
@pytest.mark.parametrize("inward", [False, True])
def test_tree_with_every_joint_and_force_either_way_round(kind: str, inward: bool) -> None:
    """At every step the engine's own accelerations solve the equations of motion at the engine's own state."""
    scene = loaded_pair(kind, inward)
    states = _states(scene, "RK44", "tree", steps=40)
    assert off_the_start(scene, states) < ROUNDING
    assert off_the_equations(scene, states, 1) < CONDITIONING


@pytest.mark.parametrize("kind", JOINT_TYPES)
@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("node", NODES)
def test_maximal_start_with_every_joint_and_force_either_way_round(kind: str, inward: bool, node: str) -> None:
    scene = loaded_pair(kind, inward)
    states = _states(scene, "GeneralizedAlpha", "maximal", node=node)
    a, alpha, _ = mechanics.index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    assert off_the_start(scene, states) < ROUNDING
    assert relative(states.a[:1], a) < DIFFERENCES
    assert relative(states.alpha[:1], alpha) < DIFFERENCES


@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_implicit_methods_converge_on_every_joint_and_force(kind: str) -> None:
    """Against dense index-1 equations, with guides of slides and lines on a moving body."""
    scene = loaded_pair(kind).replace(duration=0.1, samples=2)
    x, R, v, w = exact(scene, 0.1)
    modes = [("GeneralizedAlpha", "maximal", node) for node in NODES] + [("TrapezoidalIndex2", "maximal", "lie")]
    modes += [("GeneralizedAlpha", "tree", None)] if kind in ("planar", "universal", "distance") else []
    for method, form, node in modes:
        errors = []
        for step in (2e-3, 1e-3):
            run = crosscheck.run(scene, "exudyn", method, step=step, form=form, node=node, monitor=False)
            errors.append([np.abs(found[-1] - wanted).max() for found, wanted in
                           ((run.x, x), (run.R, R), (run.v, v), (run.w, w))])
        orders = np.log2(np.divide(*errors))
        assert orders.min() > 2 - 0.15, (method, form, node)  # the house band
        assert np.max(errors[-1]) < 1e-3, (method, form, node)


LOOPS = [("four_bar", "maximal", "lie"), ("four_bar", "maximal", "euler_parameters"), ("four_bar", "tree", None),
         ("bricard", "maximal", "lie"), ("bricard", "tree", None)]


@pytest.mark.parametrize(("name", "form", "node"), LOOPS)
def test_redundant_loops_converge_to_truth(name: str, form: str, node: str | None) -> None:
    scene = library(name).replace(duration=0.5, samples=3)
    truth = crosscheck.truth(scene).states
    errors = []
    for step in (4e-3, 2e-3):
        run = crosscheck.run(scene, "exudyn", "GeneralizedAlpha", step=step, form=form, node=node)
        errors.append([np.abs(getattr(run, field) - getattr(truth, field)).max() for field in ("x", "R", "v", "w")])
    assert np.log2(np.divide(*errors)).min() > 2 - 0.15  # the house band
    assert run.stats["constraint_position"] < 1e-11  # of all rows, including those left out


def test_index_2_on_a_redundant_spatial_loop_is_of_its_order() -> None:
    """With all rows Exudyn fails here: positions drift, and dependent velocity rows contradict each other."""
    scene = library("bricard").replace(duration=1.0, samples=3)
    truth = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-12)
    coarse, fine = (np.abs(crosscheck.run(scene, "exudyn", "TrapezoidalIndex2", step=h).x - truth.x).max()
                    for h in (4e-3, 2e-3))
    assert np.log2(coarse / fine) > 2 - 0.15


def test_linear_solvers() -> None:
    adapter = adapters.get("exudyn")
    spec = RunSpec("GeneralizedAlpha", step=1e-3)
    found = {name: adapter.linear_solver(library(name), spec, "maximal") for name in crosscheck.scenes()}
    assert {name for name, solver in found.items() if solver} == {"chain_8", "chain_64"}
    assert found["chain_8"] == "EigenSparse"
    assert adapter.linear_solver(library("chain_8"), RunSpec("RK44"), "tree") is None


@pytest.mark.parametrize("name", REDUNDANT)
def test_loops_have_independent_rows(name: str) -> None:
    scene = library(name)
    dropped = dropped_axes(scene, spanning_tree(scene)[1])
    assert sum(map(len, dropped.values())) == mechanics.redundant_rows(scene)
    assert not dropped_axes(library("slider_crank"), ())


@pytest.mark.parametrize("form", ["maximal", "tree"])
@pytest.mark.parametrize("method", ["GeneralizedAlpha", "TrapezoidalIndex2"])
def test_the_squeezer_runs(method: str, form: str) -> None:
    """Nine of its fifty rows depend on others; with all of them Exudyn fails in its first step."""
    scene = library("squeezer").replace(duration=1e-3, samples=6)
    run = crosscheck.run(scene, "exudyn", method, step=1e-5, form=form)
    assert np.abs(run.x - crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-12).x).max() < 2e-9


@pytest.mark.parametrize(("method", "form", "node", "step"), [
    ("GeneralizedAlpha", "maximal", "lie", 2e-3), ("TrapezoidalIndex2", "maximal", "euler_parameters", 2e-3),
    ("RK44", "tree", None, 1e-2)])
def test_torsional_springs_count_full_turns(method: str, form: str, node: str | None, step: float) -> None:
    scene = library("torsion_wheel")
    truth = crosscheck.truth(scene)
    angle = mechanics.torsion_angles(scene, truth.states)["hinge"]
    assert np.ptp(angle) > 4 * np.pi
    run = crosscheck.run(scene, "exudyn", method, step=step, form=form, node=node)
    # an angle off by one turn is a torque off by 3.8 N m, which ruins the motion within seconds
    assert np.abs(run.x - truth.states.x).max() < 1e-3
    assert np.abs(run.R - truth.states.R).max() < 1e-2


@pytest.mark.parametrize(("method", "node"), [("RK44", None), ("GeneralizedAlpha", "lie"),
                                              ("GeneralizedAlpha", "euler_parameters"), ("TrapezoidalIndex2", "lie")])
def test_pivot_with_loads(method: str, node: str | None) -> None:
    name = "loaded_pendulum" if method == "RK44" else "damped_pendulum"
    scene = library(name).replace(duration=1.0, samples=3)
    truth = crosscheck.truth(scene).states
    errors = [np.abs(crosscheck.run(scene, "exudyn", method, step=step, form="pivot", node=node, monitor=False).x
                     - truth.x).max() for step in (1e-2, 5e-3)]
    assert np.log2(errors[0] / errors[1]) > exudyn_adapter.ORDERS[method] - 0.15  # the house band


def test_free_bodies_fly() -> None:
    rng = np.random.default_rng(8)
    scene = make_scene([random_body(rng, "first"), random_body(rng, "second")], [])
    assert adapters.get("exudyn").form(scene, RunSpec("RK44")) == "maximal"
    for method, form in (("RK44", "maximal"), ("RK44", "tree"), ("GeneralizedAlpha", "maximal")):
        states = _states(scene, method, form)
        a, alpha, _ = mechanics.index1(scene, states.x, states.R, states.v, states.w)
        assert relative(states.a[1:], a[1:]) < CONDITIONING
        assert relative(states.alpha[1:], alpha[1:]) < (CONDITIONING if method == "RK44" else 1e-3)  # gen.-alpha's own


def test_what_cannot_be_modelled_is_said() -> None:
    weld = library("hinge_pendulum")
    weld = weld.replace(joints=(dataclasses.replace(weld.joints[0], type="fixed"),))
    rod, bar = library("rod_pendulum"), library("four_bar")
    spring, wheel = library("spring_pendulum"), library("torsion_wheel")
    cases = [
        (rod, "RK44", None, None, "explicit"), (weld, "RK44", None, None, "nothing moves"),
        (bar, "RK44", None, None, "explicit"), (bar, "RK44", "maximal", None, "explicit"),
        (spring, "RK44", "pivot", None, "sees it move"), (spring, "GeneralizedAlpha", "tree", "lie", "node='lie'"),
        (wheel, "RK44", "pivot", None, "one body on one spherical joint"),
        (library("heavy_top"), "RK44", "pivot", "euler_parameters", "Euler parameters"),
    ]
    for scene, method, form, node, words in cases:
        reason = _reason(scene, method, form, node)
        assert reason is not None, (scene.name, method, form)
        assert words in reason
    assert adapters.get("exudyn").form(spring, RunSpec("RK44")) == "tree"
    assert adapters.get("exudyn").held_levels(wheel, RunSpec("GeneralizedAlpha", form="tree")) == frozenset(
        {"position", "velocity", "acceleration"})
    assert adapters.get("exudyn").held_levels(bar, RunSpec("GeneralizedAlpha", form="tree")) == {"position"}
