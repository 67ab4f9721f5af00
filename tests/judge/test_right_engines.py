"""Right engines, written after the bounds, are accused of nothing on twelve scenes."""

import numpy as np
import pytest

from crosscheck import load_scene
from crosscheck.document import Asked, Plan, Way
from crosscheck.references import truth
from crosscheck.verification.cell import run_cell
from crosscheck.verification.plan import plan_of
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell
from tests.engines.right import UNUSUAL, Adaptive, Angles, Floats, Millimetres, Projected, Rotations
from tests.engines.stepper import TABLEAUX, Matrices
from tests.fake_engine import install

SCENES = ("single_pendulum", "double_pendulum", "triple_pendulum", "heavy_top", "hinge_pendulum", "four_bar",
          "cylindrical_pendulum", "universal_pendulum", "prismatic_slider", "spring_pendulum", "planar_slider",
          "chain_8")
ENGINES = [*((Rotations, f"RK{order}") for order in TABLEAUX), *((Matrices, f"RK{order}") for order in (1, 4)),
           *((Projected, f"RK{order}") for order in (1, 2, 4)), *((Millimetres, f"RK{order}") for order in (2, 4)),
           *((Floats, f"RK{order}") for order in (2, 4)), (Adaptive, "DP5")]
MOST = 2000
"""Steps of a main run: the equations are solved in Python here."""


def plan(name):
    """The first second of the scene, in no more than `MOST` steps."""
    duration = 0.1 if name == "heavy_top" else 1.0
    scene = load_scene(name).replace(duration=duration)
    return plan_of(scene, truth(scene).states, round(MOST * scene.n**0.5), asked=Asked(duration=duration))


def judged(monkeypatch, name, engine, method):
    install(monkeypatch, engine)
    return run_cell(Cell(name, Way("fake", method), plan(name)))


def accusations(run):
    return [f"{finding.kind}: {finding.value} of {finding.bound}, {finding.detail}" for finding in run.findings
            if finding.status == "fail"]


FORCED = ("spring_pendulum", "cylindrical_pendulum", "prismatic_slider", "planar_slider")
"""Scenes whose numbers the engine in millimetres does not convert."""
CASES = [(name, engine, method) for name in SCENES for engine, method in ENGINES
         if not (engine is Millimetres and name in FORCED)]


def test_coordinates_that_are_chosen_anew_for_each_start_are_no_fault():
    """A ball of Exudyn's tree is three angles: their order depends on the motion, and with it the error."""
    run = run_cell(Cell("heavy_top", Way("exudyn", "DOPRI5", form="tree"), Plan({1: 1e-5}, duration=0.2)))
    assert run.outcome == "pass", run.message


def test_axes_of_the_world_are_no_fault(monkeypatch):
    run = judged(monkeypatch, "single_pendulum", Angles(), "RK4")
    assert run.outcome == "pass", run.message


def test_a_steady_motion_is_judged():
    """Every method is exact there: rounding of positions over h^2 is all that accelerations of index 3 show."""
    scene = prepare_truth(("bicycle", None, 20_000))
    run = run_cell(Cell("bicycle", Way("exudyn", "GeneralizedAlpha"), scene.plan))
    assert run.outcome == "pass", run.message


@pytest.mark.parametrize(("name", "engine", "method"), [
    *CASES, *((name, *unusual) for name in SCENES[:5] for unusual in UNUSUAL)])
def test_no_right_engine_is_accused(monkeypatch, name, engine, method):
    assert not accusations(judged(monkeypatch, name, engine(), method))


def test_their_orders_are_those_they_claim():
    """A tableau with a wrong number would excuse every accusation."""
    scene = load_scene("double_pendulum").replace(duration=0.4, samples=2)
    exact = truth(scene).states.x[-1]
    for order in TABLEAUX:
        step = 0.4 / (64 if order < 5 else 16)
        errors = []
        for factor in (1.0, 0.5):
            spec = type("Spec", (), {"method": f"RK{order}", "step": factor * step})()
            errors.append(np.abs(Rotations().run(scene, spec).states.x[-1] - exact).max())
        assert np.log2(errors[0] / errors[1]) > order - 0.4
