"""Pinocchio's models are the scene and nothing else; joints, forces and constraints against index-1 accelerations."""

import numpy as np
import pytest

import crosscheck
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.pinocchio import models, redundant
from crosscheck.adapters.pinocchio.adapter import Pinocchio
from crosscheck.adapters.pinocchio.dynamics import Dynamics
from crosscheck.errors import EngineError
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.model import Scene
from tests.adapters.pairs import loaded_pair
from tests.adapters.scenes import off_the_equations, off_the_start, relative
from tests.scene_making import JOINT_TYPES

SOLVED = 1e-10  # conditioning of two different eliminations of the same system
FORMS = ("tree", "maximal")


def _model(scene: Scene, form: str) -> models.Model:
    return models.build(scene, form)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["mixed", "slider_crank", "branching_tree"])
def test_model_is_the_scene_and_nothing_else(name: str, form: str) -> None:
    """Masses and inertias add up to those of the bodies, whatever was cut; nothing resists or limits motion."""
    scene = loaded_pair("cylindrical") if name == "mixed" else crosscheck.load_scene(name)
    own = _model(scene, form)
    model = own.model
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(scene.masses.sum(), rel=1e-15)
    for body in range(scene.n):
        shares = [part for part, of in own.parts.items() if of == body] + [body]
        carried = [model.inertias[own.frames[part][0]] for part in shares]
        fixed = any(link.parent == body and not link.parts for link in own.links) or own.frames[body][0] in [
            own.frames[other][0] for other in range(scene.n) if other != body]
        if not fixed:  # bodies fixed to each other are one
            assert sum(share.mass for share in carried) == pytest.approx(scene.masses[body], rel=1e-15)
            assert relative(sum(share.inertia for share in carried), scene.inertias[body]) < 1e-15
    for extra in (model.armature, model.rotorInertia, model.damping, model.lowerDryFrictionLimit):
        assert not np.any(extra)
    assert model.gravity.linear.tolist() == scene.gravity.tolist()
    assert not np.any(model.gravity.angular)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("kind", JOINT_TYPES)
def test_every_joint_under_every_force(kind: str, inward: bool, form: str) -> None:
    """The initial state is that of the scene; its accelerations solve the equations of motion."""
    scene = loaded_pair(kind, inward)
    dynamics = Dynamics(_model(scene, form))
    q, v = dynamics.model.initial_state()
    states = dynamics.model.states(np.zeros(1), q[None], v[None], dynamics(q, v)[None])
    assert off_the_start(scene, states) < 1e-13  # some hundred roundings
    assert off_the_equations(scene, states) < SOLVED


@pytest.mark.parametrize(("name", "form", "method", "counts", "order"), [
    ("cylindrical_pendulum", "tree", "RKMK4", (160, 240, 320, 480), 4),
    ("torsion_wheel", "maximal", "SymplecticEuler", (1500, 3000, 6000), 1),
    ("torsion_wheel", "maximal", "RKMK8", (72, 96, 120, 144), 8),
])
def test_order_on_composites_and_cut_bodies(name: str, form: str, method: str, counts: tuple[int, ...],
                                            order: int) -> None:
    """The wheel turns more than once: its torsional spring has to count turns."""
    scene = crosscheck.load_scene(name).replace(samples=2)
    truth = crosscheck.truth(crosscheck.load_scene(name)).states
    errors = []
    for count in counts:
        run = crosscheck.run(scene, "pinocchio", method, step=scene.duration / count, form=form, monitor=False)
        errors.append(max(np.abs(getattr(run, field)[-1] - getattr(truth, field)[-1]).max()
                          for field in ("x", "R", "v", "w")))
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.1 if order == 1 else 0.15)  # the house bands


def test_baumgarte_gains_act_as_stated() -> None:
    """G a + gamma = -2 alpha G u - beta^2 Phi; exactly so if nothing turns, and gains reduce the drift."""
    scene = crosscheck.load_scene("single_pendulum")
    dynamics = Dynamics(_model(scene, "maximal"), alpha=20.0, beta=15.0)
    q, v = dynamics.model.initial_state()
    q[:3] += [1e-3, -2e-3, 3e-3]  # a body that has left its joint and keeps drifting
    v[:] = [0.01, 0.02, -0.03, 0.0, 0.0, 0.0]
    at = dynamics.model.states(np.zeros(1), q[None], v[None], dynamics(q, v)[None])
    constraints, state = Constraints(scene), (at.x, at.R, at.v, at.w)
    wanted = -40.0 * constraints.velocity(*state) - 15.0**2 * constraints.position(*state[:2])
    assert np.abs(wanted).max() > 0.1
    assert np.abs(constraints.acceleration(*state, at.a, at.alpha) - wanted).max() < 1e-12  # roundings of g, 9.81

    short = crosscheck.load_scene("double_pendulum").replace(duration=1.0, samples=2)
    bare, held = (crosscheck.run(short, "pinocchio", "SymplecticEuler", step=1e-3, form="maximal", **gains)
                  for gains in ({}, {"alpha": 20.0, "beta": 15.0}))
    assert held.stats["constraint_position"] < bare.stats["constraint_position"] / 2
    with pytest.raises(crosscheck.Unsupported, match="alpha, beta"):
        crosscheck.run(scene, "pinocchio", "RKMK4", step=1e-3, alpha=1.0)


def test_long_chains_are_factorized_because_aba_loses_every_digit() -> None:
    import pinocchio

    scene = crosscheck.load_scene("chain_64")
    dynamics = Dynamics(_model(scene, "tree"))
    q, v = dynamics.model.initial_state()
    _, alpha, _ = mechanics.index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    found = dynamics.model.states(np.zeros(1), q[None], v[None], dynamics(q, v)[None])
    assert dynamics.algorithm == "crba, Cholesky"
    # rounding times the conditioning of the mass matrix in joint coordinates, some 1e7
    assert relative(found.alpha, alpha) < 1e-8
    lost = pinocchio.aba(dynamics.model.model, dynamics.data, q, v, np.zeros(len(v))).copy()
    assert relative(dynamics.model.states(np.zeros(1), q[None], v[None], lost[None]).alpha, alpha) > 1e-2
    assert Dynamics(_model(crosscheck.load_scene("chain_8"), "tree")).algorithm == "aba"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["double_pendulum", "slider_crank", "four_bar", "bricard"])
def test_the_rank_of_constraints_leaves_the_freedoms_of_the_scene(name: str, form: str) -> None:
    scene = crosscheck.load_scene(name)
    dynamics = Dynamics(_model(scene, form))
    G = Constraints(scene).jacobian(scene.x0[None], scene.R0[None])[0]
    freedoms = 6 * scene.n - np.linalg.matrix_rank(G, tol=mechanics.RANK_TOLERANCE)
    rank = 0 if dynamics.closure is None else dynamics.closure.rank
    assert dynamics.model.model.nv - rank == freedoms
    assert (dynamics.algorithm == "least norm") == (name in ("four_bar", "bricard"))


def test_least_norm_is_what_constraint_dynamics_finds_where_rows_are_independent() -> None:
    import pinocchio

    scene = crosscheck.load_scene("slider_crank")
    dynamics = Dynamics(_model(scene, "maximal"), 3.0, 2.0)
    (q, v), rng = dynamics.model.initial_state(), np.random.default_rng(2)
    q = pinocchio.integrate(dynamics.model.model, q, 1e-2 * rng.normal(size=len(v)))
    v = v + 0.1 * rng.normal(size=len(v))  # a state off the constraints, so that both gains act
    wanted, torque = dynamics(q, v), np.zeros(len(v))
    forces = [each.contact_force.vector.copy() for each in dynamics.closure.workspaces]
    found = redundant.accelerations(dynamics.model.model, dynamics.data, dynamics.closure, q, v, torque)
    assert relative(found, wanted) < 1e-12
    for each, force in zip(dynamics.closure.workspaces, forces, strict=True):
        assert relative(each.contact_force.vector, force) < 1e-12


def test_overconstrained_loops_keep_moving_although_they_drift() -> None:
    """Meeting every row of the drifted hinges, the mechanism locked: 0.5 m off after a second, energies changed."""
    scene = crosscheck.load_scene("bricard").replace(duration=0.5, samples=2)
    assert Pinocchio().held_levels(scene, RunSpec("RKMK4", step=1e-3)) == frozenset()
    for form in FORMS:
        run = crosscheck.run(scene, "pinocchio", "SymplecticEuler", step=2e-3, form=form, monitor=False)
        assert run.constraint_position.max() > 1e-6  # it does drift
        assert np.abs(np.diff(run.energy)).max() < 0.01 * mechanics.kinetic_energy(scene, run).max()


def test_a_loop_that_diverges_is_told_with_its_time():
    scene = crosscheck.load_scene("double_four_bar").replace(duration=1.6, samples=11)
    with pytest.raises(EngineError, match="not finite at t = "):
        crosscheck.run(scene, "pinocchio", "RKMK8", step=0.01, form="maximal")
