"""Two steppers: Runge-Kutta methods in NumPy on dense equations of our own, and lieeuler from output to output."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
from scipy.integrate import DOP853, RK45

import lieeuler
from crosscheck import adapters
from crosscheck.adapters.base import Engine, RawRun, steps_per_sample
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.errors import EngineError
from crosscheck.scene.states import States
from tests.engines.equations import RIGHT, Equations, exponential


def _rows(A):
    """The rows of a strictly lower triangular array of stages, without their zeros at the end."""
    return [list(A[stage, :stage]) for stage in range(len(A))]


TABLEAUX = {
    1: ([[]], [1.0]),
    2: ([[], [1.0]], [0.5, 0.5]),
    3: ([[], [0.5], [-1.0, 2.0]], [1 / 6, 2 / 3, 1 / 6]),
    4: ([[], [1 / 3], [-1 / 3, 1.0], [1.0, -1.0, 1.0]], [1 / 8, 3 / 8, 3 / 8, 1 / 8]),
    5: (_rows(RK45.A), list(RK45.B)),
    6: ([[], [1 / 3], [0.0, 2 / 3], [1 / 12, 1 / 3, -1 / 12], [-1 / 16, 9 / 8, -3 / 16, -3 / 8],
         [0.0, 9 / 8, -3 / 8, -3 / 4, 1 / 2], [9 / 44, -9 / 11, 63 / 44, 18 / 11, 0.0, -16 / 11]],
        [11 / 120, 0.0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120]),
    8: (_rows(DOP853.A[:DOP853.n_stages, :DOP853.n_stages]), list(DOP853.B)),
}
"""Stages and weights of Runge-Kutta methods by order. Sources: J. C. Butcher, Numerical Methods for Ordinary
Differential Equations, sections 23 and 32 (3, 4, 6); Dormand and Prince as in SciPy (5, 8)."""


def _extrapolated(order):
    """The method of this order with one step and with two halves, whose leading errors cancel."""
    stages, weights = TABLEAUX[order]
    none, half = [0.0] * len(stages), [0.5 * weight for weight in weights]
    halves = [[*none, *(0.5 * c for c in row)] for row in stages]
    again = [[*none, *half, *(0.5 * c for c in row)] for row in stages]
    part = 2.0**order / (2.0**order - 1.0)
    return [*stages, *halves, *again], [*((1.0 - part) * c for c in weights), *(part * c for c in (*half, *half))]


TABLEAUX[7] = _extrapolated(6)
CLASSIC = {1: TABLEAUX[1], 2: ([[], [0.5]], [0.0, 1.0]),
           4: ([[], [0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6])}
"""Those of the Munthe-Kaas methods: Euler's, the midpoint rule, Kutta's."""
ORDERS = {**{f"{name}{order}": order for order in TABLEAUX for name in ("RK", "RKMK")},
          "DP5": None, "first": 1, "second": 2, "fourth": 4}
"""Documented orders by method."""


HAT = np.cross(np.eye(3), np.eye(3)[:, None]).reshape(3, 9)
"""w @ HAT is hat(w), flat."""


def begun(scene):
    """The state at the start."""
    return [scene.x0, scene.R0, scene.v0, scene.w0]


def explicit(tableau, f, t, y, h):
    """A Runge-Kutta step of y' = f(t, y), and the rates at its stages."""
    stages, weights = tableau
    rates = np.empty((len(stages), len(y)))
    for k, row in enumerate(stages):
        rates[k] = f(t + h * sum(row), y + h * (row @ rates[:k]) if row else y)
    return y + h * (weights @ rates), rates


class Matrices(Engine):
    """Runge-Kutta on x, R, v, w as plain numbers: nothing makes the attitudes orthogonal.

    A step works on one vector y of x, the attitudes in some chart, v and w: `into`, `out` and `spin` are the chart.
    """

    name = "dense"
    checks_sizes = True
    methods = tuple(f"RK{order}" for order in TABLEAUX)
    tableaux = TABLEAUX
    flaws = RIGHT
    order = None  # of methods that are not in `ORDERS`
    width = 9  # numbers of an attitude in the chart
    known: tuple = ()

    def unsupported(self, scene, spec):
        return None

    def version(self):
        return "1"

    def documented_order(self, scene, spec):
        return ORDERS.get(spec.method, self.order)

    def run(self, scene, spec):
        """Steps of equal length."""
        own, (per, h) = self.taken(scene), steps_per_sample(scene, spec.step)
        self.known, tableau, state = (), self.tableaux[ORDERS[spec.method]], begun(scene)
        kept = [self.told(scene, 0.0, state)]
        for k in range(per * (scene.samples - 1)):
            state = self.after(scene, k * h, self.step(own, k * h, state, h, tableau))
            if (k + 1) % per == 0:
                kept.append(self.told(scene, (k + 1) * h, state))
        return self.raw(scene, kept, per * (scene.samples - 1), h)

    def taken(self, scene):
        """The scene as the engine stores it."""
        return scene

    def told(self, scene, t, state):
        """A state with its accelerations and multipliers."""
        return [*state, *self.equations(scene)(t, *state)]

    def raw(self, scene, kept, steps, h):
        """The run as the adapter gives it."""
        states = States(scene.t, *(np.array(part) for part in zip(*kept, strict=True)))
        return RawRun(self.reported(scene, states), 1e-6 * steps, steps, h)

    def reported(self, scene, states):
        return states

    def equations(self, scene):
        """Those of a scene, made once in a run."""
        for there, made in self.known:
            if there is scene:
                return made
        self.known = (*self.known[-3:], (scene, Equations(scene, self.flaws)))
        return self.known[-1][1]

    def accelerations(self, scene, t, *state):
        return self.equations(scene)(t, *state)[:2]

    def step(self, scene, t, state, h, tableau):
        y, _ = explicit(tableau, lambda at, y: self.slope(scene, at, y, state), t, self.packed(t, state), h)
        return self.unpacked(t + h, y, state)

    def packed(self, t, state):
        x, R, v, w = state
        return np.concatenate([x.ravel(), self.into(R).ravel(), v.ravel(), w.ravel()])

    def unpacked(self, t, y, state=None):
        """The state that y is in the chart around `state`."""
        n = len(y) // (9 + self.width)
        x, v, w = (part.reshape(n, 3) for part in (y[:3 * n], y[-6 * n:-3 * n], y[-3 * n:]))
        return [x, self.out(y[3 * n:-6 * n].reshape(n, -1), state), v, w]

    def slope(self, scene, t, y, state=None):
        """The rate of y."""
        x, R, v, w = self.unpacked(t, y, state)
        a, alpha = self.accelerations(scene, t, x, R, v, w)
        part = y[3 * len(x):-6 * len(x)].reshape(len(x), -1)
        return np.concatenate([v.ravel(), self.spin(part, R, w).ravel(), a.ravel(), alpha.ravel()])

    def into(self, R):
        return R

    def out(self, part, state):
        return part.reshape(-1, 3, 3)

    def spin(self, part, R, w):
        """The rate of the attitudes in the chart."""
        return R @ (w @ HAT).reshape(-1, 3, 3)

    def after(self, scene, t, state):
        """The state from which the next step starts, after a step from t."""
        return state


class Turning(Matrices):
    """Munthe-Kaas' method: within a step, attitudes are rotation vectors from its beginning."""

    name, methods, width = "stepper", tuple(f"RKMK{order}" for order in CLASSIC), 3
    tableaux = CLASSIC

    def into(self, R):
        return np.zeros((len(R), 3))

    def out(self, part, state):
        return state[1] @ exponential(part)

    def spin(self, part, R, w):
        """w and dexp^-1 as far as methods of order 4 need it."""
        once = np.cross(part, w)
        return w if self.flaws.naive else w + 0.5 * once + np.cross(part, once) / 12.0


class Stepper(Turning):
    """The method of order 4 with flaws, at index 1: accelerations satisfy the constraints."""

    methods, forms = ("RK4",), ("maximal",)

    def __init__(self, flaws=RIGHT, held=frozenset({"acceleration"})):
        self.flaws, self.held = flaws, held

    def held_levels(self, scene, spec):
        return self.held

    def unsupported(self, scene, spec):
        return "a fixed step is needed" if spec.step is None else None

    def step(self, scene, t, state, h, tableau):
        """A step in parts, and what is done to the state afterwards."""
        flaws, part = self.flaws, h / self.flaws.substeps
        for k in range(flaws.substeps):
            state = self.spoilt(scene, super().step(scene, t + k * part, state, part, tableau) if not flaws.euler else
                                self.euler(scene, t + k * part, state, part))
        return state

    def euler(self, scene, t, state, h):
        x, R, v, w = state
        a, alpha = self.accelerations(scene, t, *state)
        v, w = v + h * a, w + h * alpha
        return [x + h * v, R @ exponential(h * w), v, w]

    def spoilt(self, scene, state):
        flaws = self.flaws
        if flaws.projected:
            state = self.equations(scene).closed(*state, flaws.projected == "both")
        if flaws.stuck:
            state = [*state[:3], np.clip(state[3], -flaws.stuck, flaws.stuck)]
        return [part.astype(np.float32).astype(float) for part in state] if flaws.single else state

    def told(self, scene, t, state):
        if not all(np.isfinite(part).all() for part in state):
            raise EngineError("the state is not finite")
        return super().told(scene, t, state)

    def run(self, scene, spec):
        """With the time that it takes, and its own count of steps."""
        began, raw = time.perf_counter(), super().run(scene, spec)
        return dataclasses.replace(raw, wall_time=time.perf_counter() - began, form="maximal",
                                   steps=raw.steps * self.flaws.substeps)


HONEST = {"first": "DAE1L_LSE", "second": "rattle2", "fourth": "rkmk4"}
"""lieeuler's methods by those of `Honest`."""


class Honest(Engine):
    """lieeuler's methods of orders 1, 2 and 4, restarted at every output time."""

    name = "stranger"
    checks_sizes = True
    methods = tuple(HONEST)
    same = False  # whether the physics is that of the scene everywhere, so that one call does

    def unsupported(self, scene, spec):
        return None

    def version(self):
        return "1"

    def documented_order(self, scene, spec):
        return ORDERS[spec.method]

    def physics(self, scene, states, k):
        """The scene by which the interval from sample `k` on is stepped."""
        return scene

    def run(self, scene, spec):
        """One interval after the other, each from the state at the end of the one before."""
        (per, h), began, method = steps_per_sample(scene, spec.step), time.perf_counter(), HONEST[spec.method]
        if self.same:
            states = adapters.get("lieeuler").run(scene, dataclasses.replace(spec, method=method)).states
            states = dataclasses.replace(states, a=None, alpha=None, lam=None)
        else:
            states = States(scene.t, *(np.repeat(np.array(part)[None], scene.samples, axis=0)
                                       for part in begun(scene)))
            problems: list[tuple] = []
            for k in range(scene.samples - 1):
                now = self.physics(scene, states, k)
                problem = next((made for there, made in problems if there is now), None)
                if problem is None:
                    problem = build_problem(now)
                    problems = [*problems[-3:], (now, problem)]
                run = lieeuler.prepare(problem, method, h, np.array([0.0, per * h]), monitor=False)
                found = run(*(getattr(states, name)[k] for name in "xRvw"))
                for name in "xRvw":
                    getattr(states, name)[k + 1] = getattr(found, name)[-1]
        return self.told(scene, RawRun(states, time.perf_counter() - began, per * (scene.samples - 1), h))

    def told(self, scene, raw):
        return raw


@dataclasses.dataclass
class Misbuilt:
    """An engine that runs another scene than it is given, and may report something else than it has computed."""

    base: object
    alter: tuple = ()  # functions scene -> scene
    report: tuple = ()  # functions (scene, raw) -> raw

    def __getattr__(self, name):
        return getattr(self.base, name)

    def run(self, scene, spec):
        """As the base, with every alteration."""
        wrong = scene
        for change in self.alter:
            wrong = change(wrong)
        raw = self.base.run(wrong, spec)
        for change in self.report:
            raw = change(scene, raw)
        return raw
