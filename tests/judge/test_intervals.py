"""Every interval of a run from its own state: the errors allowed to right methods, and those beyond."""

import dataclasses
import functools

import numpy as np
import pytest

import crosscheck
from crosscheck.judge.accelerations import judge_accelerations
from crosscheck.judge.claim import Claim
from crosscheck.judge.defects import measured
from crosscheck.judge.intervals import judge_intervals, judge_noise, judge_windows
from crosscheck.references import truth
from tests.fake_engine import whole

FIXED = {"DAE1L_LSE": (1, 1e-4), "DAE3L_LE": (1, 1e-4), "DAE2H_LE": (1, 1e-4), "INDEX1_LE": (1, 1e-4),
         "rattle2": (2, 1e-3), "generalized_alpha": (2, 1e-3), "rkmk4": (4, 2e-3), "rattle8": (8, 1e-2)}
"""Methods with their orders and steps (s)."""

LIBRARY = ("single_pendulum", "double_pendulum", "triple_pendulum", "hinge_pendulum", "spring_pendulum",
           "torsion_wheel", "four_bar", "prismatic_slider", "universal_pendulum", "thrown_double", "rod_pendulum",
           "damped_pendulum")


@functools.cache
def scene_of(name):
    return crosscheck.load_scene(name).replace(duration=2.0, samples=51)


def runs_of(scene, method, step):
    """A run and, of order one two, else one, at other steps."""
    steps = [step, 2 * step, 4 * step] if FIXED[method][0] == 1 else [step, 2 * step]
    return [crosscheck.run(scene, "lieeuler", method, step=each) for each in steps]


def failing(scene, runs, claim):
    judged = scene_of(scene) if isinstance(scene, str) else scene
    defects = measured(judged, runs[0], [whole(run) for run in runs[1:]], truth(judged), claim)
    found = [*judge_intervals(judged, runs[0], defects)[0], *judge_noise(defects), *judge_windows(defects),
             *judge_accelerations(judged, runs, defects)]
    return {finding.kind: finding for finding in found if finding.status == "fail"}


def changed(runs, **change):
    """The runs with something else reported: functions of the values."""
    return [dataclasses.replace(run, **{name: make(getattr(run, name)) for name, make in change.items()})
            for run in runs]


def cases(every):
    found = [(name, method) for name in LIBRARY for method in FIXED]
    return found if every else [(LIBRARY[k], method) for k, method in enumerate(FIXED)]


def accuses_nobody(name, method):
    order, step = FIXED[method]
    assert not failing(name, runs_of(scene_of(name), method, step), Claim(order, step, None))


@pytest.mark.parametrize(("name", "method"), cases(False))
def test_right_methods_are_accused_of_nothing(name, method):
    accuses_nobody(name, method)


@pytest.mark.parametrize(("name", "method"), cases(True))
def test_right_methods_are_accused_of_nothing_on_twelve_scenes(name, method):
    accuses_nobody(name, method)


@pytest.mark.parametrize("method", ["DAE1L_LSE", "rattle2", "rkmk4"])
@pytest.mark.parametrize("number", ["gravity", "mass", "inertia"])
def test_a_number_wrong_by_a_thousandth_fails_at_every_order(method, number):
    scene = scene_of("double_pendulum")
    if number == "gravity":
        wrong = dataclasses.replace(scene, gravity=1.001 * np.asarray(scene.gravity))
    else:
        first = scene.bodies[0]
        first = dataclasses.replace(first, **{number: 1.001 * np.asarray(getattr(first, number))})
        wrong = dataclasses.replace(scene, bodies=(first, *scene.bodies[1:]))
    order, step = FIXED[method]
    found = failing(scene, runs_of(wrong, method, step), Claim(order, step, None))
    assert "interval velocity" in found
    assert order > 1 or "extrapolated" in found["interval velocity"].detail


@pytest.mark.parametrize(("size", "method"), [(1e-6, "DAE1L_LSE"), (1e-6, "rattle2"), (1e-9, "rkmk4")])
def test_noise_between_outputs_fails(size, method):
    order, step = FIXED[method]
    random = np.random.default_rng(3)
    runs = changed(runs_of(scene_of("single_pendulum"), method, step),
                   x=lambda x: x + size * random.standard_normal(x.shape))
    assert failing("single_pendulum", runs, Claim(order, step, None)).keys() & {"noise", "interval position"}


@pytest.mark.parametrize(("noise", "status"), [(0.0, "ok"), (1e-8, "fail")])
def test_intervals_next_to_a_singular_position_are_no_noise(noise, status):
    """Nothing is measured there, and a difference across such a gap jumps."""
    order, step = FIXED["rattle2"]
    scene = scene_of("single_pendulum")
    runs = runs_of(scene, "rattle2", step)
    own = measured(scene, runs[0], [], truth(scene), Claim(order, step, None))[0]
    regular = np.arange(len(own.flow.tau)) % 17 > 2
    random = np.random.default_rng(5)
    vectors = {name: np.where(regular[:, None, None], part + noise * random.standard_normal(part.shape), 0.0)
               for name, part in own.vectors.items()}
    gaps = dataclasses.replace(own, vectors=vectors, flow=dataclasses.replace(own.flow, regular=regular))
    finding, = judge_noise([gaps])
    assert finding.status == status


def test_what_the_engine_says_of_its_start_is_compared_with_the_scene():
    order, step = FIXED["DAE1L_LSE"]
    runs = changed(runs_of(scene_of("single_pendulum"), "DAE1L_LSE", step), x=lambda x: x + 1e-9)
    found = failing("single_pendulum", runs, Claim(order, step, None))
    assert found["interval position"].detail == "at t = 0, from the scene's start"
    # An engine in single precision has no more digits.
    assert "interval position" not in failing("single_pendulum", runs, Claim(order, step, None, eps=2.0**-23))


@pytest.mark.parametrize("method", ["DAE1L_LSE", "rkmk4"])
def test_accelerations_without_gravity_fail_on_a_fast_top(method):
    scene = crosscheck.load_scene("heavy_top").replace(duration=0.2, samples=51)
    order, step = FIXED[method][0], {"DAE1L_LSE": 1e-5, "rkmk4": 1e-4}[method]
    runs = runs_of(scene, method, step)
    assert not failing(scene, runs, Claim(order, step, None))
    wrong = changed(runs, a=lambda a: a + np.array([0.0, 0.0, 9.81]))
    assert "acceleration" in failing(scene, wrong, Claim(order, step, None))


@pytest.mark.parametrize("name", ["sleeping_top_below", "hinge_pendulum"])
def test_right_methods_pass_at_equilibrium(name):
    scene = crosscheck.load_scene(name).replace(duration=1.0, samples=26)
    body = dataclasses.replace(scene.bodies[0], velocity=np.zeros(3), angular_velocity=np.zeros(3))
    scene = dataclasses.replace(scene, bodies=(body, *scene.bodies[1:]))
    for method in ("DAE1L_LSE", "rattle2", "rkmk4"):
        order, step = FIXED[method]
        assert not failing(scene, runs_of(scene, method, step), Claim(order, step, None)), method
