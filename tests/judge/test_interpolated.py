"""Adaptive engines that interpolate between their steps, and engines that fail where they are started again."""

import numpy as np
import pytest

from tests.engines.mistakes import pulled
from tests.engines.right import Dense, Floats
from tests.judge.test_right_engines import judged


class Lines(Dense):
    """Straight lines between steps."""

    def between(self, scene, found):
        return lambda t: np.array([np.interp(t, found.t, row) for row in found.y])


class Cubic(Dense):
    """Cubic polynomials between steps of order 8."""

    def between(self, scene, found):
        from scipy.interpolate import CubicHermiteSpline

        rates = [self.slope(scene, t, y) for t, y in zip(found.t, found.y.T, strict=True)]
        return CubicHermiteSpline(found.t, found.y.T, rates)


class Careless(Dense):
    """A tolerance three hundred times the one that is asked for."""

    factor = 300.0


class Late(Dense):
    """Gravity is .1 % off after three quarters of a long run."""

    def accelerations(self, scene, t, *state):
        return super().accelerations(pulled(scene, 1.001) if t > 0.075 else scene, t, *state)


class Noisy(Dense):
    """Noise of 3e-7 in attitudes."""

    def after(self, scene, t, state):
        x, R, v, w = super().after(scene, t, state)
        return [x, R + 3e-7 * np.sin(1e6 * t + np.arange(9.0)).reshape(3, 3) * (t > 0), v, w]


@pytest.mark.parametrize("engine", [Lines, Cubic, Careless, Late, Noisy])
def test_what_is_no_interpolation_of_its_order_fails(monkeypatch, engine):
    assert judged(monkeypatch, "heavy_top", engine(), "P").outcome == "fail"


class Refusing(Floats):
    """Single precision, declared; it does not run in some of the worlds in which it is started again."""

    def __init__(self, most, gravity=1.0):
        self.most, self.gravity, self.calls = most, gravity, 0

    def taken(self, scene):
        return scene.replace(gravity=self.gravity * np.asarray(scene.gravity))

    def run(self, scene, spec):
        self.calls += scene.name == "elsewhere"
        if scene.name == "elsewhere" and self.calls % 8 < self.most:
            raise RuntimeError("the state is not finite")
        return super().run(scene, spec)


@pytest.mark.parametrize(("most", "gravity", "outcome"), [
    (0, 1.0, "pass"), (2, 1.0, "unresolved"), (2, 1.01, "fail"), (8, 1.0, "unresolved"), (8, 1.01, "unresolved"),
    (8, 1.1, "fail")])
def test_an_engine_that_cannot_be_started_again_is_not_accused_of_its_precision(monkeypatch, most, gravity, outcome):
    """What it says of its numbers is measured in the parts that ran; without any, nothing has shown it."""
    run = judged(monkeypatch, "single_pendulum", Refusing(most, gravity), "RK4")
    assert run.outcome == outcome, run.message
    if outcome == "unresolved":
        assert "not finite" in run.message
