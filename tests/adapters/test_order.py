"""Observed order of every method on the single pendulum against its documented order; errors against truth, T = 1 s."""

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

EULER, LOW, FOUR = (250, 500, 1000, 2000), (100, 200, 400, 800), (50, 100, 200, 400)
# coarse enough to stay above the truth's 1e-12, fine enough to be past the method's first terms
SIX, EIGHT, FIVE = (16, 24, 32, 48), (8, 10, 12, 14), (50, 60, 80, 100)

CASES = [
    *[("mujoco", method, "tree", EULER) for method in ("Euler", "implicit", "implicitfast", "discrete")],
    ("mujoco", "RK4", "tree", FOUR),
    ("pinocchio", "SymplecticEuler", "tree", EULER),
    ("pinocchio", "RKMK4", "tree", FOUR),
    ("pinocchio", "RKMK8", "tree", EIGHT),
    ("exudyn", "GeneralizedAlpha", "maximal", LOW),
    ("exudyn", "TrapezoidalIndex2", "maximal", LOW),
    ("exudyn", "RK44", "pivot", FOUR),
    ("exudyn", "RK44", "tree", FOUR),
    ("exudyn", "DOPRI5", "pivot", FIVE),
    ("exudyn", "RK67", "pivot", SIX),
]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return crosscheck.load_scene("single_pendulum").replace(duration=1.0, samples=3)


@pytest.fixture(scope="module")
def hinge() -> Scene:
    return crosscheck.load_scene("hinge_pendulum").replace(duration=1.0, samples=3)


@pytest.fixture(scope="module")
def truth(scene: Scene) -> States:
    return crosscheck.truth(scene).states


def _orders(scene: Scene, truth: States, engine: str, method: str, form: str, counts: tuple[int, ...]) -> list[float]:
    """Slopes of the largest error over the samples in position, attitude and velocities."""
    errors = []
    for count in counts:
        run = crosscheck.run(scene, engine, method, step=1.0 / count, form=form, monitor=False)
        assert run.steps == count
        errors.append([np.abs(getattr(run, field) - getattr(truth, field)).max() for field in ("x", "R", "v", "w")])
    return (-np.polyfit(np.log(counts), np.log(errors), 1)[0]).tolist()


@pytest.mark.parametrize(("engine", "method", "form", "counts"), CASES)
def test_observed_order(scene: Scene, truth: States, engine: str, method: str, form: str,
                        counts: tuple[int, ...]) -> None:
    documented = adapters.get(engine).documented_order(scene, RunSpec(method, form=form))
    band = 0.1 if documented == 1 else 0.15  # the house bands for slopes over four step sizes
    assert _orders(scene, truth, engine, method, form, counts) == pytest.approx([documented] * 4, abs=band)


@pytest.mark.parametrize(("method", "documented", "counts"), [("DOPRI5", 5, (20, 30, 40, 60)), ("RK67", 6, SIX)])
def test_high_order_in_cardan_angles_is_not_missed(scene: Scene, truth: States, method: str, documented: int,
                                                   counts: tuple[int, ...]) -> None:
    """In this chart the leading error term nearly vanishes, so the slope comes down to the order from above."""
    assert min(_orders(scene, truth, "exudyn", method, "tree", counts)) > documented - 0.15  # the house band


def test_naive_rk4_is_second_order_though_its_authors_claim_four(scene: Scene, truth: States) -> None:
    claimed = adapters.get("pinocchio").documented_order(scene, RunSpec("RK4naive"))
    assert claimed == 4
    observed = _orders(scene, truth, "pinocchio", "RK4naive", "tree", FOUR)
    assert observed == pytest.approx([2] * 4, abs=0.15)  # the house band


def test_naive_rk4_keeps_order_4_on_a_hinge(hinge: Scene) -> None:
    reference = crosscheck.run(hinge, "pinocchio", "RKMK8", step=0.02, monitor=False)  # 1e6 times more accurate
    observed = _orders(hinge, reference, "pinocchio", "RK4naive", "tree", (20, 40, 80, 160))
    assert min(observed) > 4 - 0.15  # the house band
