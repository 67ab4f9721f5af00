"""The four scenes on four engines: each against truth, and every two against each other."""

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.document import EULER
from crosscheck.errors import ArgumentError
from crosscheck.testing.agreement import Tol
from tests import SCENARIOS
from tests.diagnosis import misbuilt
from tests.engines.stepper import Misbuilt

HIGH_ORDER = ("mujoco:RK4", "pinocchio:RKMK4", "pinocchio:RKMK8", "exudyn:RK44", "exudyn:RK67")
# Some swings and five turns of the top.
WHOLE = {"single_pendulum": (3.0, 1e-3), "double_pendulum": (1.0, 5e-4), "triple_pendulum": (2.0, 1e-3),
         "heavy_top": (0.2, 1e-4)}
EULER_STEP = {"single_pendulum": (1.0, 1e-3), "double_pendulum": (1.0, 1e-4), "triple_pendulum": (1.0, 1e-4)}


@pytest.fixture(scope="session")
def agree(crosscheck_run, crosscheck_truth):
    def check(scene, engines, tol=None, **options):
        return crosscheck.assert_agree(scene, engines, tol, run=crosscheck_run, truth=crosscheck_truth, **options)
    return check


def shortened(name, duration):
    return crosscheck.load_scene(name).replace(duration=duration, samples=21)


@pytest.mark.parametrize("name", WHOLE)
def test_high_order_methods_of_three_engines(agree, name):
    duration, step = WHOLE[name]
    agree(shortened(name, duration), HIGH_ORDER, step=step)


@pytest.mark.parametrize("name", EULER_STEP)
def test_eight_euler_methods_and_mujoco(agree, name):
    duration, step = EULER_STEP[name]
    agree(shortened(name, duration), [*(f"lieeuler:{method}" for method in EULER), "mujoco:Euler"], step=step)


def test_eight_euler_methods_on_the_fast_top(agree):
    agree(shortened("heavy_top", 0.1), [*(f"lieeuler:{method}" for method in EULER), "pinocchio:SymplecticEuler"],
          step=5e-6)


@pytest.mark.parametrize("name", WHOLE)
def test_implicit_solvers_of_exudyn_agree_with_explicit_ones(agree, name):
    duration = min(WHOLE[name][0], 1.0) if name != "heavy_top" else 0.1
    step = 1e-3 if name != "heavy_top" else 2e-5
    agree(shortened(name, duration), ["exudyn:GeneralizedAlpha", "exudyn:TrapezoidalIndex2", "exudyn"], step=step)


def test_a_naive_method_is_exposed_by_its_order(agree):
    """Classic RK4 on summed joint velocities is second order, and documented as fourth."""
    record, = agree(shortened("heavy_top", 0.1), ["pinocchio:RK4naive"], step=5e-5)
    assert record.outcome == "known"
    assert next(finding for finding in record.findings if finding.kind == "order").status == "known"


def test_a_model_that_is_a_millionth_off_is_exposed_by_its_limit():
    """At any step: the errors of the steps are taken away."""
    scene, heavier = shortened("double_pendulum", 1.0), misbuilt.gravity(lambda g: (1 + 1e-6) * g)
    with adapters.lent(Misbuilt(adapters.get("mujoco"), (heavier,))) as name:
        for method, step in (("RK4", 1e-2), ("Euler", 1e-3)):
            with pytest.raises(AssertionError, match=r"^fail: .*\(CC10[24]\)$"):
                crosscheck.assert_agree(scene, [(name, method)], step=step)


@pytest.fixture
def spoiling(crosscheck_run):
    """A run that moves the second body by 1e-3 m from the sixth sample on."""
    def run(scene, engine, method, **options):
        traj = crosscheck_run(scene, engine, method, **options)
        x = traj.x.copy()
        if engine == "pinocchio":
            x[5:, 1] += [1e-3, 0.0, 0.0]
            x[9, 1] += [1e-3, 0.0, 0.0]
        return dataclasses.replace(traj, x=x)
    return run


def test_the_message_says_what_where_when_and_why(spoiling, crosscheck_truth):
    scene = shortened("double_pendulum", 1.0)
    engines = ["mujoco:RK4", ("pinocchio", "RKMK4", {"step": 1e-3})]
    who = "fail: double_pendulum: pinocchio RKMK4 (step=0.001)"
    for tol, words in ((1e-4, (f"{who} and truth disagree in position by 0.002 m", "allowed 0.0001", "at t = 0.45 s",
                               "first beyond it at t = 0.25 s", scene.bodies[1].name)),
                       (None, (f"{who}: gap position 0.002 m", "(CC101)"))):
        with pytest.raises(AssertionError) as caught:
            crosscheck.assert_agree(scene, engines, tol, step=1e-3, run=spoiling, truth=crosscheck_truth)
        for part in words:
            assert part in str(caught.value)


def test_engines_are_compared_with_each_other_too(spoiling, crosscheck_truth):
    scene = shortened("double_pendulum", 1.0)

    def opposite(scene, engine, method, **options):
        traj = spoiling(scene, engine, method, **options)
        shift = np.array([-4e-3, 0.0, 0.0]) if engine == "mujoco" else np.array([4e-3, 0.0, 0.0])
        return dataclasses.replace(traj, x=traj.x + shift)

    # One is 4 mm from truth, the other up to 6 mm on the other side: each alone is within 6.5 mm.
    apart = {"position": Tol(6.5e-3, "each alone")}
    for engine in ("mujoco:RK4", "pinocchio:RKMK4"):
        crosscheck.assert_agree(scene, [engine], apart, step=1e-3, run=opposite, truth=crosscheck_truth)
    with pytest.raises(AssertionError, match=r"mujoco RK4 .* and pinocchio RKMK4 .* disagree in position"):
        crosscheck.assert_agree(scene, ["mujoco:RK4", "pinocchio:RKMK4"], apart, step=1e-3, run=opposite,
                                truth=crosscheck_truth)


@pytest.mark.parametrize(("engines", "options", "message"), [
    ([], {}, "at least one"),
    (["mujoco:RK5"], {}, "has no method 'RK5'"),
    (["bullet"], {}, "bullet"),
    ([("mujoco",)], {}, "not understood"),
    ([("mujoco", "RK4", 1e-3)], {}, "options are a dictionary"),
    ([3], {}, "3 is not understood"),
    (3, {}, "^engines: .*3"),
    ([(["mujoco"], "RK4")], {}, "^engine: .*not list"),
    ([("mujoco", 4)], {}, "has no method 4"),
    (["mujoco:RK4"], {"tol": "tight"}, "^tol: 'tight'"),
    (["mujoco:RK4"], {"tol": True}, "^tol: True"),
    (["mujoco:RK4"], {"tol": -1e-6}, "^tol: -1e-06"),
    (["mujoco:RK4"], {"tol": float("nan")}, "^tol: nan"),
    (["mujoco:RK4"], {"tol": {"position": "tight"}}, r"^tol\['position'\]: 'tight'"),
    (["mujoco:RK4"], {"tol": {}}, "^tol: {}"),
    (["mujoco:RK4"], {"step": 0}, "^step: .*positive"),
    (["mujoco:RK4"], {"tol": {"speed": Tol(1.0, "why")}}, "'speed'"),
])
def test_mistakes_are_explained(agree, engines, options, message):
    with pytest.raises(ArgumentError, match=message):
        agree(shortened("single_pendulum", 1.0), engines, **options)


@pytest.mark.parametrize("engines", [
    "mujoco:RK4", "mujoco", ("mujoco:RK4", "pinocchio"), [["mujoco", "RK4", {"step": 1e-2}], ("pinocchio", "RKMK4")],
])
def test_engines_and_bounds_in_every_spelling(agree, engines):
    """1e-4 lies between what RK4 does at 10 ms (some 1e-8 rad/s) and what Euler does (more than 1e-3)."""
    scene = shortened("single_pendulum", 1.0)
    for tol in (1e-4, np.float64(1e-4), Tol(1e-4, "mine"), {"position": 1e-4, "attitude": Tol(1e-4, "mine")}):
        agree(scene, engines, tol, step=1e-2)
        with pytest.raises(AssertionError, match=r"allowed 0\.0001 .*\((given by the caller|mine)\)"):
            agree(scene, "mujoco:Euler", tol, step=1e-2)


def test_a_scene_by_path(agree):
    agree(SCENARIOS / "single_pendulum.toml", "mujoco:RK4", 1e-4, step=1e-2)


def test_engine_alone_takes_its_most_accurate_method_and_a_step_that_judges(agree):
    agree(shortened("single_pendulum", 1.0), ["mujoco", "pinocchio", "exudyn"])
