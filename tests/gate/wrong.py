"""Thirty engines with a mistake or a cheat each, beside the right one that they were made from (their base class)."""

import numpy as np

from tests.gate import right, steppers
from tests.gate.mechanics import Balls, Floating, Hinge, exponential


class GravityTenThousandth(right.AdamsBashforth4):
    """Gravity is too large by 1e-4."""

    def adjust(self, model, scene):
        model.g = model.g * (1 + 1e-4)


class GravityTenMillionth(right.Extrapolated6):
    """Gravity is too large by 1e-7."""

    models = (Balls,)

    def adjust(self, model, scene):
        model.g = model.g * (1 + 1e-7)


class InertiaOnePercent(right.Extrapolated6):
    """The last body's inertia is too large by 1 %."""

    models = (Balls,)

    def adjust(self, model, scene):
        model.I[-1] = 1.01 * model.I[-1]


class NoGyroscope(right.Heun):
    """The gyroscopic term w x J w is missing."""

    def adjust(self, model, scene):
        model.gyroscopic = 0.0


class HalfStepRates(right.VerletMeans):
    """Rates are those half a step before the output, as the leapfrog has them."""

    def tell(self, model, scene, Y):
        Y = Y.copy()
        Y[1:, 1] -= 0.5 * self.step * np.array([model.rate(0.0, y)[1] for y in Y[1:]])
        return model.report(Y)


class LateDamping(right.Radau5):
    """Dampers set in after half of the time."""

    def adjust(self, model, scene):
        model.loads.damper = lambda t, damping: damping if t >= 0.5 * scene.duration else 0.0


class Jump(right.AdamsBashforth4):
    """In the middle interval the angular velocity jumps by 1e-5 rad/s."""

    def make(self, model, scene):
        inner, middle, done = super().make(model, scene), 0.5 * scene.duration, []

        def step(rate, t, y, h):
            y = inner(rate, t, y, h)
            if not done and t + h > middle:
                done.append(t)
                y = y + np.eye(len(y))[-1] * 1e-5
            return y

        return step


class NaiveChart(right.RotationVectors):
    """Rotation vectors turn with w alone, without the terms of the chart: order 2 on ball joints, 4 on hinges."""

    @staticmethod
    def spin(theta, w):
        return w


class LinearOutput(right.DenseRK4):
    """Outputs between steps are interpolated linearly."""

    def between(self, times, nodes, states, rates):
        return np.array([np.interp(times, nodes, column) for column in states.T]).T


class LastStepsRates(right.HalfTheStep):
    """Velocities, and so the energy, are those of the state one step before the output."""

    def make(self, model, scene):
        self.kept = []
        inner, (n, _) = super().make(model, scene), self.grid(scene, self.spec)

        def step(rate, t, y, h):
            self.kept.append(y)
            return inner(rate, t, y, h)

        self.per = n
        return step

    def answer(self, scene, spec):
        self.spec = spec
        return super().answer(scene, spec)

    def tell(self, model, scene, Y):
        Y = Y.copy()
        before = np.array(self.kept)[self.per - 1::self.per]
        Y[1:, 4 * model.n:] = before[:, 4 * model.n:]
        return model.report(Y)


class WorldRates(right.WorldMomenta):
    """Angular velocities are reported in world axes."""

    def tell(self, model, scene, Y):
        got = model.report(Y)
        return {**got, "w": np.einsum("tnij,tnj->tni", got["R"], got["w"])}


class Unstabilised(Floating):
    """The rod without Baumgarte's terms."""

    baumgarte = (0.0, 0.0)


class DriftCalledHeld(right.BaumgarteRK4):
    """Nothing draws the constraint back, yet positions and velocities are called held at rounding."""

    models = (Unstabilised,)

    def held_levels(self, scene, spec):
        return frozenset({"position", "velocity"})


class DoubleStep(right.VerletMeans):
    """Every step is twice as long as asked."""

    def grid(self, scene, spec):
        n, h = super().grid(scene, spec)
        fewer = (n + 1) // 2
        return fewer, h * n / fewer


class EndMissed(right.AdamsBashforth4):
    """The last output is the state one step before the end."""

    def march(self, model, scene, spec):
        Y, steps, h = super().march(model, scene, spec)
        back = steppers.rk4(model.rate, scene.t[-1], Y[-1], -h)
        return np.concatenate([Y[:-1], [model.settle(back)]]), steps, h


class HalfPrecision(right.RandomKutta3):
    """Velocities are rounded to half precision on the way out."""

    def tell(self, model, scene, Y):
        got = model.report(Y)
        return {**got, "v": got["v"].astype(np.float16).astype(float)}


class StaleHistory(right.AdamsBashforth4):
    """The history of the last run starts the next one, where states have the same size."""

    memory = {}  # noqa: RUF012

    def make(self, model, scene):
        kept = self.memory.get(len(model.start))
        self.memory[len(model.start)] = stepper = steppers.Bashforth4(kept.history if kept else ())
        return stepper


class CoarseGrid(right.ChainedVerlet):
    """Only every fifth output is integrated; those between are interpolated by a cubic."""

    def tell(self, model, scene, Y):
        Y, t = Y.copy(), scene.t
        for a in range(0, len(t) - 5, 5):
            span = t[a + 5] - t[a]
            ends = [Y[a], Y[a + 5], span * model.rate(0.0, Y[a]), span * model.rate(0.0, Y[a + 5])]
            for k in range(a + 1, a + 5):
                s = (t[k] - t[a]) / span
                base = [(1 + 2 * s) * (1 - s) ** 2, s * s * (3 - 2 * s), s * (1 - s) ** 2, s * s * (s - 1)]
                Y[k] = sum(c * e for c, e in zip(base, ends, strict=True))
        return model.report(Y)


class TunedStep(right.ChainedVerlet):
    """Exact where the step is 1 ms, and the plain Verlet method of order 2 at all others."""

    def make(self, model, scene):
        return lambda rate, t, y, h: (steppers.extrapolated if abs(h - 1e-3) < 1e-6 else steppers.verlet)(rate, t, y, h)


class WarmBearing(right.ChainedVerlet):
    """A drag of 1e-5/s times the angle turned since the run began: a run that begins anew differs."""

    def make(self, model, scene):
        turned = [0.0]

        def step(rate, t, y, h):
            new = self.stepper(rate, t, y, h)
            turned[0] += abs(new[0] - y[0])
            return new * np.array([1.0, 1 - 1e-5 * turned[0] * h])

        return step


class Noise(right.Extrapolated6):
    """Positions and angular velocities carry noise of 1e-7 that is not declared."""

    def tell(self, model, scene, Y):
        got, numbers = model.report(Y), np.random.default_rng()
        return {**got, **{k: got[k] + 1e-7 * numbers.standard_normal(got[k].shape) for k in "xw"}}


class LooseTolerance(right.Adaptive5):
    """The tolerance is a hundred times what is asked."""

    rtol = 100.0


class LastStepsAccelerations(right.Heun):
    """Accelerations are those of one step before the output."""

    def tell(self, model, scene, Y):
        back = np.array([Y[0], *[self.stepper(model.rate, 0.0, y, -self.step) for y in Y[1:]]])
        a, alpha = model.accelerations(scene.t, back)
        return {**model.report(Y), "a": a, "alpha": alpha}


class LateReversal(right.Braked):
    """Friction keeps its sign until the end of the step in which the motion reverses, and nothing sticks."""

    def make(self, model, scene):
        return lambda _rate, t, y, h: steppers.rk4(model.slipping(np.sign(y[1])), t, y, h)


class Restitution(right.Bouncing):
    """The restitution is larger by 0.01."""

    def adjust(self, model, scene):
        model.restitution += 0.01


class RestLength(right.Radau5):
    """The free length of springs is too large by 1e-4 of it."""

    def adjust(self, model, scene):
        model.loads.springs = [(ends, k, length * (1 + 1e-4), d) for ends, k, length, d in model.loads.springs]


class Tilted(Hinge):
    """A hinge whose axis leans, through the same point of the ground."""

    @staticmethod
    def axes(joint, R):
        across = np.cross(joint.parent_axis, [1.0, 0.0, 0.0])
        axis = exponential(1e-5 * across / np.linalg.norm(across)) @ joint.parent_axis
        return axis, R.T @ axis


class TiltedAxis(right.ChainedVerlet):
    """The axis of the hinge is off by 1e-5 rad."""

    models = (Tilted,)


class BetweenOutputs(right.HalfTheStep):
    """An error of 1e-4 m that swings with the outputs of the scene's own file and vanishes at them."""

    def tell(self, model, scene, Y):
        got, beat = model.report(Y), np.pi / 0.1
        ripple, slope = 1e-4 * np.sin(beat * scene.t) ** 2, 1e-4 * beat * np.sin(2 * beat * scene.t)
        return {**got, "x": got["x"] + ripple[:, None, None], "v": got["v"] + slope[:, None, None]}


class Reaction(right.RotationVectors):
    """Multipliers, and so reactions, are too large by a tenth."""

    def tell(self, model, scene, Y):
        got = super().tell(model, scene, Y)
        return {**got, "lam": 1.1 * got["lam"]} if "lam" in got else got


class Degrees(right.VerletMeans):
    """Rest angles of torsional springs are read in degrees."""

    def adjust(self, model, scene):
        model.springs = [(k, np.deg2rad(rest), d) for k, rest, d in model.springs]


class Shadow(right.Extrapolated6):
    """The motion of another start, 1e-9 rad/s away, after the first output."""

    models = (Balls,)

    def adjust(self, model, scene):
        model.start = model.start.copy()
        model.start[-1] += 1e-9


WRONG = (GravityTenThousandth, GravityTenMillionth, InertiaOnePercent, NoGyroscope, HalfStepRates, LateDamping, Jump,
         NaiveChart, LinearOutput, LastStepsRates, WorldRates, DriftCalledHeld, DoubleStep, EndMissed, HalfPrecision,
         StaleHistory, CoarseGrid, TunedStep, WarmBearing, Noise, LooseTolerance, LastStepsAccelerations, LateReversal,
         Restitution, RestLength, TiltedAxis, BetweenOutputs, Reaction, Degrees, Shadow)
