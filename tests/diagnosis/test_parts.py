"""The parts of `explain`: altered accelerations, limits, differences, copies and misreadings, each against its own
truth."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.diagnosis import altered, fit, misreadings, observe, of_run, of_stepping, variants
from crosscheck.diagnosis.observe import Observation, Scale, Subject, scale_of
from crosscheck.diagnosis.result import Explanation
from crosscheck.document import Way
from crosscheck.references.maximal import Maximal
from crosscheck.scene import mechanics
from crosscheck.scene.alterations import Alteration, alterations, least_turn
from crosscheck.scene.altered import Accelerations, Points, of_scene
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import hinge_angles, starting
from crosscheck.scene.file import load_scene
from crosscheck.scene.states import States
from tests.diagnosis import misbuilt
from tests.engines.equations import Flaws
from tests.engines.stepper import Stepper
from tests.jointspace.arms import arm

SCENES = ("double_pendulum", "spring_pendulum", "torsion_wheel", "damped_pendulum", "loaded_pendulum", "four_bar",
          "hinge_pendulum", "puck_on_plane")
TURN = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()


def points(scene, count=7):
    """States along a made-up motion; the formulas hold on and off the constraints."""
    rng = np.random.default_rng(1)
    t = np.linspace(0, 0.1, count)
    v, w = scene.v0 + rng.normal(size=(count, scene.n, 3)), scene.w0 + rng.normal(size=(count, scene.n, 3))
    x = scene.x0 + t[:, None, None] * v
    R = scene.R0 @ Rotation.from_rotvec((t[:, None, None] * w).reshape(-1, 3)).as_matrix().reshape(count, scene.n, 3, 3)
    near = np.tile(hinge_angles(scene, starting(scene)), (count, 1))
    angles = mechanics.torsion_angles(scene, States(t, x, R, v, w, hinges=near))
    return Points(x, R, v, w, np.zeros((count, scene.n, 6)), angles)


@pytest.mark.parametrize("name", SCENES)
def test_unaltered_accelerations_are_those_of_the_scene(name):
    scene = load_scene(name)
    at = points(scene)
    found = Accelerations(at)(of_scene(scene))
    a, alpha, _ = mechanics.index1(scene, at.x, at.R, at.v, at.w, at.angles)
    wanted = np.concatenate([a, alpha], axis=2)
    # Two ways through one linear system, of condition up to some 1e4.
    assert np.abs(found - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.parametrize("name", ["spring_pendulum", "double_pendulum"])
def test_altered_parameters_are_those_of_the_altered_scene(name):
    scene = load_scene(name)
    at = points(scene)
    changed = of_scene(scene).altered(gravity=np.array([1.0, 2.0, -3.0])).with_bodies(
        lambda k, body: {"mass": 1.7 * body.mass, "inertia": 0.6 * body.inertia}).with_force(None, lambda force: {
            "stiffness": 0.5 * force.parameters["stiffness"], "free_length": 0.1 + force.parameters["free_length"]})
    wrong = misbuilt.gravity(lambda g: np.array([1.0, 2.0, -3.0]))(scene)
    for k in range(scene.n):
        wrong = misbuilt._bodies(wrong, lambda i, body, k=k: body if i != k else misbuilt.dataclasses.replace(
            body, mass=1.7 * body.mass, inertia=0.6 * body.inertia))
    wrong = wrong.replace(forces=tuple(misbuilt.spring(force, stiffness=0.5, rest=0.1)(
        wrong.replace(forces=(force,))).forces[0] for force in wrong.forces))
    found = Accelerations(at)(changed)
    a, alpha, _ = mechanics.index1(wrong, at.x, at.R, at.v, at.w, at.angles)
    assert np.abs(found - np.concatenate([a, alpha], axis=2)).max() < 1e-9 * np.abs(found).max()


def test_soft_joints_leave_constraint_forces_out():
    """Whatever pulls along the rows of G, the accelerations across them are still predicted."""
    scene = load_scene("double_pendulum")
    at = points(scene)
    G = Constraints(scene).jacobian(at.x, at.R)
    pull = np.einsum("pmk,m->pk", G, np.linspace(-50, 80, G.shape[1])) @ mechanics.inverse_mass(scene)
    free = mechanics.applied_forces(scene, at.x, at.R, at.v, at.w) @ mechanics.inverse_mass(scene)
    at.rates = (free + pull).reshape(at.rates.shape)
    found = Accelerations(at)(of_scene(scene), soft=True)
    assert np.abs(found - at.rates).max() < 1e-9 * np.abs(at.rates).max()


@pytest.mark.parametrize("name", ["double_pendulum", "spring_pendulum"])
def test_the_prediction_is_truth_where_nothing_is_altered(name):
    scene = load_scene(name)
    scale = observe.scale_of(scene)
    brief = observe.window(scene, scale)
    found = altered.predict(of_scene(brief), brief.t, (scene.R0, scene.w0))
    # rtol 1e-11 over a window of one radian, some ten steps
    assert np.abs(scale.flat(found) - scale.flat(Maximal(brief).run())).max() < 1e-9


def test_intervals_are_followed_where_the_turns_of_a_hinge_are_not_known():
    scene = load_scene("torsion_wheel").lasting(1.5).replace(samples=of_run.INTERVALS + 1)
    wheel, = scene.bodies
    scene = scene.replace(bodies=(dataclasses.replace(
        wheel, velocity=5.0 * wheel.velocity, angular_velocity=5.0 * wheel.angular_velocity),))
    states = adapters.get("lieeuler").run(scene, RunSpec("taylor", rtol=1e-12)).states
    _, gaps = of_run._onward(scene, scale_of(scene), states)
    assert gaps.max() < of_run.DEFECT
    states.hinges = None
    assert np.isnan(hinge_angles(scene, states)).any()
    ends, gaps = of_run._onward(scene, scale_of(scene), states)
    assert np.isfinite(ends).all()
    assert gaps.max() > 1e-3


def test_extrapolation_takes_the_named_powers_away():
    h = 1.0 / np.array([1.0, 2.0, 4.0])
    runs = [np.array([3.0 + 2.0 * step**2 - 5.0 * step**3]) for step in h]
    assert observe.extrapolated(runs, (1, 2, 4), 2)[0] == pytest.approx(3.0, abs=1e-13)
    assert observe.convergence([np.array([step**2]) for step in 0.1 * h]) == pytest.approx(2.0, abs=1e-9)


def test_differences_are_exact_to_their_estimate():
    t = np.linspace(0, 1, 21)
    y = np.sin(3 * t)[:, None, None]
    found, error = observe.rates(y, t[1])
    gap = np.abs(found[:, 0, 0] - 3 * np.cos(3 * t[4:-4])).max()
    assert gap <= error < 100 * gap


def test_copies_close_their_joints_and_turn():
    scene = load_scene("hinge_pendulum")
    scale = observe.scale_of(scene)
    balls, kept = variants.on_balls(scene)
    assert all(joint.type == "spherical" for joint in balls.joints)
    assert all(scene.forces[k].joint is None for k in kept)
    for copy in (variants.moved(scene, scale, 0), variants.moved(balls, scale, 1)):
        gaps = Constraints(copy).position(copy.x0[None], copy.R0[None])
        speeds = Constraints(copy).velocity(copy.x0[None], copy.R0[None], copy.v0[None], copy.w0[None])
        assert max(np.abs(gaps).max(), np.abs(speeds).max()) < 1e-9
        assert np.abs(copy.R0 - scene.R0).max() > 0.05


def test_balls_in_place_of_hinges_have_no_laws_of_angles():
    balls, kept = variants.on_balls(arm(2, stiffness=0.5))
    assert not any(getattr(joint, name) for joint in balls.joints for name in (
        "start", "armature", "damping", "stiffness", "rest_position", "dry_friction", "limits", "mimic", "drive"))
    assert not kept
    assert crosscheck.run(balls, "lieeuler", "rkmk4", step=0.1).status == "success"


@pytest.mark.parametrize("wrong", [
    lambda scene: scene,
    lambda scene: scene.replace(gravity=np.array([0.0, -9.81, 0.0])),
    lambda scene: scene.replace(gravity=np.array([3.0, -2.0, 5.0])),
    misbuilt.inertia(lambda s, k: TURN @ s.inertias[k] @ TURN.T),
    misbuilt.inertia(misbuilt.steiner(0.4)),
])
def test_rotations_of_the_planar_copy_commute(wrong):
    """Whatever gravity and inertia an engine makes of it."""
    scene = load_scene("double_pendulum")
    copy = wrong(of_stepping.planar(scene, observe.scale_of(scene), wrong(scene).gravity))
    states = Maximal(copy.replace(duration=0.3, samples=4)).run()
    axis = copy.w0[0] / np.linalg.norm(copy.w0[0])
    assert np.abs(states.R @ axis - axis).max() < 1e-10
    assert np.abs(states.R[-1] - states.R[0]).max() > 0.1


def seen(scene, wrong, noise=1e-9, seed=0):
    """Data of one copy: the accelerations of another scene with noise, as an engine would show them."""
    at = points(scene, 9)
    at.rates = Accelerations(at)(of_scene(wrong))
    at.rates += noise * np.random.default_rng(seed).uniform(-1, 1, at.rates.shape)
    return fit.Data([fit.Copy(of_scene(scene), Accelerations(at), noise, np.ones(6))])


@pytest.mark.parametrize(("turn", "name"), [(0.0, "gravity sign"), (0.3, "gravity axis")])
def test_a_gravity_is_named_by_what_its_noise_leaves_open(turn, name):
    scene = load_scene("single_pendulum")
    gravity = -scene.gravity + turn * np.array([1.0, 0.0, 0.0])
    data = seen(scene, scene.replace(gravity=gravity), noise=1e-3)
    found, _ = fit.search(data, [alterations(scene)[0]])
    assert [each.names for each in found] == [(name,)]


@pytest.mark.parametrize(("change", "name"), [(lambda g: np.roll(g, 1), "gravity axis"),
                                              (lambda g: -g, "gravity sign")])
def test_an_explanation_with_fewer_mistakes_goes_first(change, name):
    # A single body with its inertia about another point moves as one of another mass under a gravity that differs in
    # size too.
    scene = load_scene("single_pendulum")
    wrong = misbuilt.inertia(misbuilt.steiner(0.3))(misbuilt.gravity(change)(scene))
    data = seen(scene, wrong)
    kinds = {"gravity", "inertia point", "mass"}
    found, _ = fit.search(data, [each for each in alterations(scene) if each.cause in kinds])
    mistakes = {each.names: each.mistakes for each in found}
    assert mistakes[name, "inertia point"] == 2
    assert all(count > 2 for names, count in mistakes.items() if names != (name, "inertia point"))
    assert len(mistakes) > 1


def test_a_turned_inertia_is_told_by_its_smallest_turn():
    J = TURN @ np.diag([1.0, 2.0, 2.5]) @ TURN.T
    small = np.array([0.2, -0.1, 0.15])
    half = Rotation.from_rotvec(np.pi * TURN[:, 1])  # about a principal axis: the inertia stays
    large = (Rotation.from_rotvec(small) * half).as_rotvec()
    assert np.linalg.norm(large) > 2
    assert np.abs(least_turn(large, J) - small).max() < 1e-12


@pytest.mark.parametrize("turned_first", [False, True])
def test_an_inertia_may_be_moved_before_or_after_it_is_turned(turned_first):
    scene = load_scene("single_pendulum")
    steps = [misbuilt.inertia(misbuilt.steiner(0.3)), misbuilt.inertia(lambda s, k: TURN @ s.inertias[k] @ TURN.T)]
    wrong = scene
    for step in reversed(steps) if turned_first else steps:
        wrong = step(wrong)
    data = seen(scene, wrong)
    found, _ = fit.search(data, [each for each in alterations(scene) if each.cause in fit.ORDERED])
    assert {each.names for each in found} == {("inertia frame", "inertia point")}


def test_a_pair_of_which_one_explains_by_itself_is_not_named():
    """A search that starts far off may end beside the single cause and find it only with the help of another."""
    class Lucky(fit.Data):
        def fit(self, causes, starts=None):
            good = len(causes) == 2 or starts == ((0.5,),)
            return fit.Fit(tuple(causes), tuple(np.array([0.5]) for _ in causes), 1.0 if good else 1e9)

    data = Lucky([])
    found, _ = fit.search(data, [Alteration(name, lambda m, t: m, ((0.1,),), str, "")
                                       for name in ("one", "other")])
    assert {each.names for each in found} == {("one",), ("other",)}


def test_an_alteration_that_fails_is_left_out():
    """Whatever it raises, the others are tried."""
    scene = load_scene("single_pendulum")
    data = seen(scene, scene.replace(gravity=-scene.gravity))
    bad = [Alteration(kind, apply, ((0.1,),), str, "") for kind, apply in (
        ("no such body", lambda m, t: m.altered(bodies=(*m.scene.bodies[:0], m.scene.bodies[7]))),
        ("a mass below none", lambda m, t: m.with_bodies(lambda k, body: {"mass": -body.mass})),
        ("no such number", lambda m, t: m.altered(gravity="down")))]
    found, singles = fit.search(data, [*bad, alterations(scene)[0]])
    assert [each.names for each in found] == [("gravity sign",)]
    assert [np.isfinite(each.left) for each in singles] == [False, False, False, True]


def test_a_force_that_drives_where_it_should_slow_makes_no_model():
    right = of_scene(load_scene("damped_pendulum"))
    assert right.physical(right)
    assert not right.replace(coulomb=-0.1).physical(right)
    assert not right.with_force(None, lambda force: {"damping": -0.1}).physical(right)


def test_misreadings_are_what_they_say():
    scene = load_scene("double_pendulum")
    scale = Scale(1.0, 1.0)
    R, w = misreadings.misread(scene, misreadings.ATTITUDES[2], None)
    assert np.abs(R - np.swapaxes(scene.R0, -1, -2)).max() == 0
    x, v = misreadings.positions(scene, R, w)
    assert np.abs(Constraints(scene).position(x[None], R[None])).max() < 1e-12
    y = scale.flat(misreadings.States(np.zeros(1), x[None], R[None], v[None], w[None]))
    seen = Observation(scene, scale, y, 0.0, None)
    assert misreadings.gap(seen, R, w) < 1e-13
    assert misreadings.gap(seen, scene.R0, scene.w0) > 0.1


@pytest.mark.parametrize("count", [1, 2, 5])
def test_sub_steps_are_those_that_an_engine_counts(count):
    scene = load_scene("single_pendulum")
    scale = observe.scale_of(scene)
    subject = Subject(Stepper(Flaws(substeps=count)), Way("stepper", "RK4"))
    first = Observation(observe.window(scene, scale), scale, np.zeros((0, 1, 18)), 0.0, None)
    result = Explanation(scene.name, "", "RK4", None, "pass", "", [], [], [], 1.0, None, None)
    of_stepping._substeps(subject, first, 4, result)
    assert [each.magnitude.partition(" ")[0] for each in result.evidence] == [str(count)] * (count > 1)


@pytest.mark.parametrize(("errors", "whole"), [
    ([2.0**(-2 * k) for k in range(4)], 2),
    ([2.0**(-4 * k) for k in range(4)], 4),
    ([1e-4, 1e-5, 3e-12, 3e-12], None),  # rounding
    ([1e-4, 1e-5, 1e-5, 1e-5], None),  # noise, which has no order
    ([1.0, 2**-2.4, 2**-5.8, 2**-9.6], None),  # slopes 2.4, 3.4, 3.8 climb to four
])
def test_an_order_is_named_only_where_it_is_clear(errors, whole):
    assert of_stepping._whole((1.0, 0.5, 0.25, 0.125), errors) == whole
