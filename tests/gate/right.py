"""Twenty engines without a mistake. Name one as `tests.gate.right:Heun` from the top folder of the repository."""

import time

import numpy as np

from crosscheck.adapters.base import RawRun, steps_per_sample
from crosscheck.scene.states import States
from tests.gate import steppers
from tests.gate.mechanics import (
    Balls,
    Floating,
    FloatingMomentum,
    Hinge,
    Linkage,
    Model,
    Slide,
    across,
    exponential,
)

OWN = "tests/gate/scenes/"
BALLS = ("single_pendulum", "double_pendulum", "spring_pendulum", "damped_pendulum", "loaded_pendulum")
HINGES = ("hinge_pendulum", "torsion_wheel")


class Fixed:
    """The frame of all: a model of the scene, a stepper, fixed steps that meet every output."""

    models = (Balls,)
    scenes = BALLS
    order = 1
    stepper = None
    adaptive_methods = ()
    elements = ()
    undamped = False

    def __init__(self):
        self.name = type(self).__name__.lower()
        self.methods = (type(self).__name__,)
        self.adaptive_methods = self.methods if self.adaptive_methods else ()
        self.orders = {} if self.adaptive_methods else {self.methods[0]: self.order}

    def find(self, scene):
        """The first model that holds the scene, and why there is none."""
        reasons = [model.refuse(scene) for model in self.models]
        fits = [model for model, reason in zip(self.models, reasons, strict=True) if reason is None]
        return (fits[0], None) if fits else (None, reasons[0])

    def unsupported(self, scene, spec):
        """Why this engine cannot run the scene; None if it can."""
        if spec.step is None and not self.adaptive_methods:
            return "it needs a step"
        if self.undamped and any(load.parameters.get("damping") for load in scene.loads):
            return "it knows no dampers"
        known = "dry_friction" in self.elements or not any(joint.dry_friction for joint in scene.joints)
        return self.find(scene)[1] if known else "it knows no dry friction"

    def adjust(self, model, scene):
        """What is changed in the model of a scene: nothing."""

    def make(self, model, scene):
        """A stepper for one run."""
        return self.stepper

    def grid(self, scene, spec):
        """Steps in an output interval, and their length."""
        return steps_per_sample(scene, spec.step)

    def march(self, model, scene, spec):
        """States at the outputs, the number of steps and their length."""
        n, h = self.grid(scene, spec)
        step, y, t, out = self.make(model, scene), model.start, 0.0, [model.start]
        for k in range(1, len(scene.t)):
            for _ in range(n):
                y = model.settle(step(model.rate, t, y, h))
                t += h
            t = scene.t[k]
            out.append(y)
        return np.array(out), n * (len(scene.t) - 1), h

    def tell(self, model, scene, Y):
        """What is reported at the outputs."""
        return model.report(Y)

    def run(self, scene, spec):
        """Integrate."""
        return States(scene.t, **self.answer(scene, spec))

    def answer(self, scene, spec):
        """Arrays of the answer."""
        model = self.find(scene)[0](scene)
        self.adjust(model, scene)
        Y, self.steps, self.step = self.march(model, scene, spec)
        return self.tell(model, scene, Y)


class Heun(Fixed):
    """Heun's method, order 2, on quaternions that are made unit after every step; gives accelerations, too."""

    order, stepper = 2, staticmethod(steppers.heun2)

    def tell(self, model, scene, Y):
        a, alpha = model.accelerations(scene.t, Y)
        return {**model.report(Y), "a": a, "alpha": alpha}


class SymplecticEuler(Fixed):
    """Semi-implicit Euler in the angle of a hinge, order 1."""

    models, scenes, order = (Hinge,), HINGES, 1
    stepper = staticmethod(steppers.symplectic_euler)


class VerletMeans(Fixed):
    """Störmer-Verlet, order 2; the velocity is the mean of those half a step before and after."""

    models, scenes, order = (Hinge,), HINGES, 2
    undamped, stepper = True, staticmethod(steppers.verlet)


class ChainedVerlet(Fixed):
    """Three Verlet steps in a chain with the middle one backwards: symplectic, order 4."""

    models, scenes, order = (Hinge,), HINGES, 4
    undamped, stepper = True, staticmethod(steppers.chained_verlet)


class DiscreteLagrange(Fixed):
    """Variational integrator of the midpoint Lagrangian with momenta as rates, order 2."""

    models, scenes, order = (Hinge,), HINGES, 2
    undamped, stepper = True, staticmethod(steppers.variational)


class ImplicitMidpoint(Fixed):
    """Implicit midpoint rule, order 2, Newton's iteration down to rounding, on bodies without joints."""

    models, scenes, order = (Floating,), ("axis_flip", "nesc_brick", "rod_pendulum"), 2
    stepper = staticmethod(steppers.implicit(steppers.MIDPOINT))


class Radau5(Fixed):
    """Radau IIA with three stages, order 5, Newton's iteration down to rounding."""

    scenes, order = ("damped_pendulum", "spring_pendulum"), 5
    stepper = staticmethod(steppers.implicit(steppers.RADAU5))


class AdamsBashforth4(Fixed):
    """A method of four steps, order 4, whose first three steps are those of RK4."""

    order = 4

    def make(self, model, scene):
        return steppers.Bashforth4()


class RandomKutta3(Fixed):
    """Kutta's method, order 3, with every step cut at random into two or three, none longer than asked."""

    order = 3

    def make(self, model, scene):
        return steppers.RandomParts(steppers.kutta3)


class Adaptive5(Fixed):
    """Dormand and Prince's pair with rtol, whose steps meet every output."""

    order, adaptive_methods, rtol = 5, ("Adaptive5",), 1.0

    def unsupported(self, scene, spec):
        return "it is adaptive; give rtol" if spec.step is not None else super().unsupported(scene, spec)

    def march(self, model, scene, spec):
        return steppers.adaptive(model, scene.t, self.rtol * (spec.rtol or 1e-8)), 0, None


class SingleRK4(Fixed):
    """RK4 whose states are kept in single precision, which it declares."""

    order, eps = 4, 2.0**-23

    def make(self, model, scene):
        return lambda rate, t, y, h: np.asarray(steppers.rk4(rate, t, y, h), np.float32)

    def march(self, model, scene, spec):
        model.start = np.asarray(model.start, np.float32)
        Y, steps, h = super().march(model, scene, spec)
        return Y.astype(float), steps, h


class BaumgarteRK4(Fixed):
    """RK4, order 4, on the index-1 equations of a body on a rod, drawn back by Baumgarte's terms (10/s, 10/s)."""

    models, scenes, order = (Floating,), ("rod_pendulum", "iftomm_simple_pendulum"), 4
    stepper = staticmethod(steppers.rk4)


class ProjectedRK4(Fixed):
    """RK4, order 4, on the index-1 equations of a plane linkage, projected after every step."""

    models, scenes, order = (Linkage,), ("four_bar",), 4
    stepper = staticmethod(steppers.rk4)

    def held_levels(self, scene, spec):
        return frozenset({"position", "velocity"})


class Stop:
    """RK4 on a rail; where a step runs through the stop, the time of the impact is found by bisection."""

    def __init__(self, model):
        self.model = model

    def __call__(self, rate, t, y, h):
        while True:
            new = steppers.rk4(rate, t, y, h)
            if new[0] >= self.model.lower:
                return new
            part = steppers.bisect(lambda d, y=y: steppers.rk4(rate, t, y, d)[0] >= self.model.lower, 0.0, h)
            y = steppers.rk4(rate, t, y, part)
            y, h = np.array([self.model.lower, -self.model.restitution * y[1]]), h - part


class Bouncing(Fixed):
    """RK4, order 4, with impacts on a rigid stop found by bisection."""

    models, scenes, order = (Slide,), (OWN + "bouncing_slide.toml",), 4
    elements = ("limits",)

    def make(self, model, scene):
        return Stop(model)


class Brake:
    """RK4 on a hinge with dry friction; where a rate would change its sign, its zero is found by bisection."""

    def __init__(self, model):
        self.model = model
        self.sign = np.sign(model.start[1]) or self.pushed(model.start[0])

    def pushed(self, angle):
        load = self.model.torque(angle, 0.0)
        return np.sign(load) if abs(load) > self.model.friction else 0.0

    def __call__(self, rate, t, y, h):
        while self.sign:
            slipping = self.model.slipping(self.sign)
            new = steppers.rk4(slipping, t, y, h)
            if self.sign * new[1] >= 0:
                return new
            part = steppers.bisect(
                lambda d, y=y, slipping=slipping: self.sign * steppers.rk4(slipping, t, y, d)[1] >= 0, 0.0, h)
            y = np.array([steppers.rk4(slipping, t, y, part)[0], 0.0])
            self.sign, h = self.pushed(y[0]), h - part
        return y


class Braked(Fixed):
    """RK4, order 4, with reversals under dry friction found by bisection."""

    models, scenes, order = (Hinge,), (OWN + "braked_hinge.toml", *HINGES), 4
    elements = ("dry_friction",)

    def make(self, model, scene):
        return Brake(model)


class Charted(Balls):
    """Trees on ball joints by matrices; inside a step the attitude is a rotation vector from its beginning."""

    def __init__(self, scene):
        super().__init__(scene)
        self.start = np.concatenate([scene.R0.ravel(), scene.w0.ravel()])

    settle = staticmethod(Model.settle)

    def report(self, Y):
        return self.reported(Y[:, :9 * self.n].reshape(-1, self.n, 3, 3), Y[:, 9 * self.n:])


class RotationVectors(Fixed):
    """RK4, order 4, on rotation vectors that begin anew in every step; accelerations, and multipliers of one body."""

    models, scenes, order = (Charted, Hinge), ("heavy_top", *BALLS, *HINGES), 4
    @staticmethod
    def spin(theta, w):
        once = across(theta, w)
        return w + 0.5 * once + across(theta, once) / 12

    def make(self, model, scene):
        if isinstance(model, Hinge):
            return steppers.rk4
        n = model.n

        def step(_rate, t, y, h):
            R, w = y[:9 * n].reshape(n, 3, 3), y[9 * n:]

            def local(time, z):
                vectors, rates = z[:3 * n].reshape(n, 3), z[3 * n:].reshape(n, 3)
                return np.concatenate([self.spin(vectors, rates).ravel(), model.accelerate(
                    time, R @ exponential(vectors), rates).ravel()])

            z = steppers.rk4(local, t, np.concatenate([np.zeros(3 * n), w]), h)
            return np.concatenate([(R @ exponential(z[:3 * n].reshape(n, 3))).ravel(), z[3 * n:]])

        return step

    def tell(self, model, scene, Y):
        if isinstance(model, Hinge):
            return model.report(Y)
        a, alpha = model.accelerations(scene.t, Y)
        known = {"lam": model.m[0, 0] * (model.g - a[:, 0])} if model.n == 1 and not scene.loads else {}
        return {**model.report(Y), "a": a, "alpha": alpha, **known}


class Extrapolated6(Fixed):
    """Modified midpoint rules of 2, 4 and 6 parts, extrapolated to order 6."""

    scenes, order = ("double_pendulum", "triple_pendulum", *BALLS, "hinge_pendulum"), 6
    models = (Balls, Hinge)
    stepper = staticmethod(steppers.extrapolated)


class HalfTheStep(Fixed):
    """RK4, order 4, with half the step that is asked for, and it says so."""

    order, stepper = 4, staticmethod(steppers.rk4)

    def grid(self, scene, spec):
        n, h = super().grid(scene, spec)
        return 2 * n, h / 2

    def run(self, scene, spec):
        began = time.perf_counter()
        states = States(scene.t, **self.answer(scene, spec))
        wall, maxima = time.perf_counter() - began, None
        if spec.monitor:
            from crosscheck.scene.monitor import Monitor

            monitor = Monitor(scene)
            monitor.update(states.x, states.R, states.v, states.w)
            maxima = monitor.maxima()
        return RawRun(states, wall, self.steps, self.step, maxima=maxima)


class WorldMomenta(Fixed):
    """RK4, order 4, on the momenta of a free body in world axes; its rates are converted to body axes."""

    models, scenes, order = (FloatingMomentum,), ("axis_flip", "nesc_brick"), 4
    stepper = staticmethod(steppers.rk4)


class DenseRK4(Fixed):
    """RK4, order 4, by exactly the step that is asked for; outputs by interpolation of order 7 in states and rates."""

    order, stepper = 4, staticmethod(steppers.rk4)

    def between(self, times, nodes, states, rates):
        return steppers.hermite(times, nodes, states, rates)

    def march(self, model, scene, spec):
        h = spec.step
        count = max(3, int(np.ceil(scene.duration / h - 1e-9)))
        y, nodes, states = model.start, h * np.arange(count + 1), [model.start]
        for t in nodes[:-1]:
            y = model.settle(self.stepper(model.rate, t, y, h))
            states.append(y)
        rates = np.array([model.rate(t, y) for t, y in zip(nodes, states, strict=True)])
        return self.between(scene.t, nodes, np.array(states), rates), count, h


RIGHT = (Heun, SymplecticEuler, VerletMeans, ChainedVerlet, DiscreteLagrange, ImplicitMidpoint, Radau5,
         AdamsBashforth4, RandomKutta3, Adaptive5, SingleRK4, BaumgarteRK4, ProjectedRK4, Bouncing, Braked,
         RotationVectors, Extrapolated6, HalfTheStep, WorldMomenta, DenseRK4)
