"""Steppers of vectors: each takes (rate, t, y, h) and returns y one step later; one with a memory is made per run."""

import numpy as np
from scipy.integrate import RK45

from tests.engines import stepper
from tests.engines.right import PAIR
from tests.engines.stepper import CLASSIC, TABLEAUX

MIDPOINT = ([[0.5]], [1.0], [0.5])
ROOT6 = np.sqrt(6.0)
RADAU5 = ([[(88 - 7 * ROOT6) / 360, (296 - 169 * ROOT6) / 1800, (-2 + 3 * ROOT6) / 225],
           [(296 + 169 * ROOT6) / 1800, (88 + 7 * ROOT6) / 360, (-2 - 3 * ROOT6) / 225],
           [(16 - ROOT6) / 36, (16 + ROOT6) / 36, 1 / 9]],
          [(16 - ROOT6) / 36, (16 + ROOT6) / 36, 1 / 9], [(4 - ROOT6) / 10, (4 + ROOT6) / 10, 1.0])


def explicit(tableau):
    """An explicit Runge-Kutta step."""
    return lambda rate, t, y, h: stepper.explicit(tableau, rate, t, y, h)[0]


heun2, kutta3, rk4 = map(explicit, (TABLEAUX[2], TABLEAUX[3], CLASSIC[4]))


def implicit(tableau):
    """An implicit Runge-Kutta step by Newton's iteration down to rounding, with a Jacobian by differences."""
    A, b, c = (np.array(part) for part in tableau)
    s = len(b)

    def step(rate, t, y, h):
        n, base = len(y), rate(t, y)
        jacobian = np.empty((n, n))
        for k in range(n):
            delta = 1e-7 * max(1.0, abs(y[k]))
            moved = y.copy()
            moved[k] += delta
            jacobian[:, k] = (rate(t, moved) - base) / delta
        inverse = np.linalg.inv(np.eye(s * n) - h * np.kron(A, jacobian))
        K, before = np.tile(base, s), np.inf
        for _ in range(30):
            stages = y + h * (A @ K.reshape(s, n))
            miss = np.concatenate([rate(t + h * a, z) for a, z in zip(c, stages, strict=True)]) - K
            K = K + inverse @ miss
            size = np.max(np.abs(inverse @ miss)) * h / (1 + np.max(np.abs(y)))
            if size < 1e-15 or (size >= before and size < 1e-12):
                break
            before = size
        return y + h * (b @ K.reshape(s, n))

    return step


def symplectic_euler(rate, t, y, h):
    """Rates first, then angles by the new rates."""
    n = len(y) // 2
    u = y[n:] + h * rate(t, y)[n:]
    return np.concatenate([y[:n] + h * u, u])


def verlet(rate, t, y, h):
    """Störmer-Verlet: the velocity is the mean of those half a step before and after."""
    n = len(y) // 2
    half = y[n:] + 0.5 * h * rate(t, y)[n:]
    q = y[:n] + h * half
    return np.concatenate([q, half + 0.5 * h * rate(t + h, np.concatenate([q, half]))[n:]])


def chained_verlet(rate, t, y, h):
    """Three Verlet steps in a chain, the middle one backwards: order 4."""
    a = 1 / (2 - 2 ** (1 / 3))
    for part in (a, 1 - 2 * a, a):
        y = verlet(rate, t, y, part * h)
        t += part * h
    return y


def variational(rate, _t, y, h):
    """Discrete Euler-Lagrange equations of the midpoint Lagrangian, for one coordinate; y is angle and momentum/J."""
    angle, momentum = y
    change = h * momentum
    for _ in range(60):
        push = rate(0.0, np.array([angle + 0.5 * change, 0.0]))[1]
        new = h * momentum + 0.5 * h * h * push
        if abs(new - change) <= 1e-17 + 1e-16 * abs(new):
            break
        change = new
    push = rate(0.0, np.array([angle + 0.5 * change, 0.0]))[1]
    return np.array([angle + change, momentum + h * push])


def extrapolated(rate, t, y, h):
    """Three modified midpoint rules of 2, 4 and 6 parts, extrapolated to order 6."""
    table = []
    for parts in (2, 4, 6):
        d = h / parts
        old, new = y, y + d * rate(t, y)
        for k in range(1, parts):
            old, new = new, old + 2 * d * rate(t + k * d, new)
        table.append(0.5 * (old + new + d * rate(t + h, new)))
    first, second, third = table
    low, high = second + (second - first) / 3, third + (third - second) / (9 / 4 - 1)
    return high + (high - low) / (9 - 1)


class Bashforth4:
    """Adams and Bashforth's method of order 4, started by three steps of RK4."""

    def __init__(self, history=()):
        self.history = list(history)

    def __call__(self, rate, t, y, h):
        self.history = [*self.history[-3:], rate(t, y)]
        if len(self.history) < 4:
            return rk4(rate, t, y, h)
        a, b, c, d = self.history
        return y + h / 24 * (55 * d - 59 * c + 37 * b - 9 * a)


class RandomParts:
    """Every step in two or three parts of random lengths, none above what was asked."""

    def __init__(self, inner, seed=5):
        self.inner, self.numbers = inner, np.random.default_rng(seed)

    def __call__(self, rate, t, y, h):
        cuts = np.sort(self.numbers.uniform(0.1, 0.9, self.numbers.integers(1, 3)))
        for part in np.diff([0.0, *cuts, 1.0]):
            y = self.inner(rate, t, y, part * h)
            t += part * h
        return y


def adaptive(model, times, rtol):
    """States at the times by Dormand and Prince's pair, whose steps meet every time."""
    atol, y, t, out = 1e-2 * rtol, model.start, times[0], [model.start]
    h = 1e-3
    for end in times[1:]:
        while end - t > 1e-13 * max(1.0, end):
            d = min(h, end - t)
            new, rates = stepper.explicit(PAIR, model.rate, t, y, d)
            miss = d * (RK45.E @ rates)
            size = np.sqrt(np.mean((miss / (atol + rtol * np.maximum(np.abs(y), np.abs(new)))) ** 2))
            if size <= 1:
                t, y = t + d, model.settle(new)
            grown = d * min(5.0, max(0.2, 0.9 * max(size, 1e-10) ** -0.2))
            h = grown if size > 1 or d == h else max(h, grown)
        out.append(y)
        t = end
    return np.array(out)


def hermite(times, nodes, states, rates):
    """Interpolation in the four nodes around each time that matches states and rates: order 7 in every step."""
    out = []
    for t in times:
        first = int(np.clip(np.searchsorted(nodes, t, side="right") - 2, 0, len(nodes) - 4))
        k = slice(first, first + 4)
        z, unit = (nodes[k] - t), nodes[first + 1] - nodes[first]
        z = np.repeat(z / unit, 2)
        d = np.repeat(states[k], 2, axis=0)
        column = np.empty_like(d)
        column[1::2] = rates[k] * unit
        column[2::2] = (d[2::2] - d[1:-1:2]) / (z[2::2] - z[1:-1:2])[:, None]
        terms = [d[0], column[1]]
        current = column[1:]
        for order in range(2, 8):
            current = (current[1:] - current[:-1]) / (z[order:] - z[:-order])[:, None]
            terms.append(current[0])
        value = terms[-1]
        for term, at in zip(terms[-2::-1], z[6::-1], strict=True):
            value = term - at * value
        out.append(value)
    return np.array(out)


def bisect(inside, low, high):
    """The last number from `low` on for which `inside` holds, within rounding."""
    for _ in range(80):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if inside(middle) else (low, middle)
    return high
