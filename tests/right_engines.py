"""Right engines of our own that share only equations with the judge: orders 1 to 8, adaptive, other units, projected,
attitudes without normalisation, and declared numbers of 32 bits."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.integrate import DOP853, RK45
from scipy.spatial.transform import Rotation

from crosscheck.adapters.base import Engine, RawRun, steps_per_sample
from crosscheck.scene import mechanics
from crosscheck.scene.states import States


def per_scene(make):
    """A function of a scene that computes once for all the steps of a run."""
    kept = [None, None]

    def made(scene):
        if kept[0] is not scene:
            kept[:] = scene, make(scene)
        return kept[1]
    return made


equations = per_scene(mechanics.Index1)


def rows(A):
    """The rows of a strictly lower triangular array of stages, without their zeros at the end."""
    return [list(A[stage, :stage]) for stage in range(len(A))]


TABLEAUX = {
    1: ([[]], [1.0]),
    2: ([[], [1.0]], [0.5, 0.5]),
    3: ([[], [0.5], [-1.0, 2.0]], [1 / 6, 2 / 3, 1 / 6]),
    4: ([[], [1 / 3], [-1 / 3, 1.0], [1.0, -1.0, 1.0]], [1 / 8, 3 / 8, 3 / 8, 1 / 8]),
    5: (rows(RK45.A), list(RK45.B)),
    6: ([[], [1 / 3], [0.0, 2 / 3], [1 / 12, 1 / 3, -1 / 12], [-1 / 16, 9 / 8, -3 / 16, -3 / 8],
         [0.0, 9 / 8, -3 / 8, -3 / 4, 1 / 2], [9 / 44, -9 / 11, 63 / 44, 18 / 11, 0.0, -16 / 11]],
        [11 / 120, 0.0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120]),
    8: (rows(DOP853.A[:DOP853.n_stages, :DOP853.n_stages]), list(DOP853.B)),
}
"""Stages and weights of Runge-Kutta methods by order. Sources: J. C. Butcher, Numerical Methods for Ordinary
Differential Equations, sections 23 and 32 (3, 4, 6); Dormand and Prince as in SciPy (5, 8)."""


def extrapolated(order):
    """The method of this order with one step and with two halves, whose leading errors cancel."""
    stages, weights = TABLEAUX[order]
    none, half = [0.0] * len(stages), [0.5 * weight for weight in weights]
    halves = [[*none, *(0.5 * c for c in row)] for row in stages]
    again = [[*none, *half, *(0.5 * c for c in row)] for row in stages]
    part = 2.0**order / (2.0**order - 1.0)
    return [*stages, *halves, *again], [*((1.0 - part) * c for c in weights), *(part * c for c in (*half, *half))]


TABLEAUX[7] = extrapolated(6)


class Matrices(Engine):
    """Runge-Kutta on x, R, v, w as plain numbers: nothing makes the attitudes orthogonal."""

    name = "right"
    checks_sizes = True
    methods = tuple(f"RK{order}" for order in TABLEAUX)

    def unsupported(self, scene, spec):
        return None

    def version(self):
        return "1"

    def documented_order(self, scene, spec):
        return int(spec.method[2:])

    def run(self, scene, spec):
        """Steps of equal length."""
        per, h = steps_per_sample(scene, spec.step)
        stages, weights = TABLEAUX[int(spec.method[2:])]
        state = [scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]]
        kept, own = [state], self.taken(scene)
        for k in range(per * (scene.samples - 1)):
            state = self.after(scene, self.step(own, k * h, state, h, stages, weights))
            if (k + 1) % per == 0:
                kept.append(state)
        return self.raw(scene, kept, per * (scene.samples - 1), h)

    def raw(self, scene, kept, steps, h):
        """The run as the adapter gives it, accelerations from the states."""
        x, R, v, w = (np.concatenate(parts) for parts in zip(*kept, strict=True))
        a, alpha, lam = equations(scene)(x, R, v, w, t=scene.t)
        return RawRun(States(scene.t, x, R, v, w, a, alpha, lam), 1e-6 * steps, steps, h)

    def taken(self, scene):
        """The scene as the engine stores it."""
        return scene

    def rates(self, scene, t, x, R, v, w):
        a, alpha, _ = equations(scene)(x, R, v, w, t=np.array([t]))
        return v, R @ np.cross(np.eye(3), w[..., None, :]), a, alpha

    def step(self, scene, t, state, h, stages, weights):
        return self.moved(state, h, weights, self.stages(scene, t, state, h, stages))

    def stages(self, scene, t, state, h, stages):
        """The derivatives at the stages of a step."""
        found: list[tuple[np.ndarray, ...]] = []
        for row in stages:
            found.append(self.rates(scene, t + h * sum(row), *self.moved(state, h, row, found)))
        return found

    @staticmethod
    def moved(state, h, weights, rates):
        """The state moved along weighted derivatives."""
        return [part + h * sum((c * rate[k] for c, rate in zip(weights, rates, strict=True)), np.zeros_like(part))
                for k, part in enumerate(state)]

    def after(self, scene, state):
        """The state from which the next step starts."""
        return state


class Rotations(Matrices):
    """The same, and the nearest rotation after every step."""

    def after(self, scene, state):
        U, _, V = np.linalg.svd(state[1])
        return [state[0], U @ V, *state[2:]]


class Angles(Rotations):
    """Attitudes within a step by three angles about y, x and z, which prefer axes of the world."""

    def step(self, scene, t, state, h, stages, weights):
        x, R, v, w = state
        angles = Rotation.from_matrix(R[0]).as_euler("YXZ")[None]
        x, angles, v, w = super().step(scene, t, [x, angles, v, w], h, stages, weights)
        return [x, Rotation.from_euler("YXZ", angles[0]).as_matrix()[None], v, w]

    def rates(self, scene, t, x, R, v, w):
        """R are the angles: w = Z^T X^T e_y a' + Z^T e_x b' + e_z c'."""
        X, Z = (Rotation.from_euler(axis, R[0][:, [k]]).as_matrix() for axis, k in (("X", 1), ("Z", 2)))
        Zt = np.swapaxes(Z, 1, 2)
        along = np.broadcast_to([0.0, 0.0, 1.0], R[0].shape)
        E = np.stack([(Zt @ np.swapaxes(X, 1, 2))[..., 1], Zt[..., 0], along], -1)
        attitudes = Rotation.from_euler("YXZ", R[0]).as_matrix()[None]
        v, _, a, alpha = super().rates(scene, t, x, attitudes, v, w)
        return v, np.linalg.solve(E, w[0][..., None])[None, ..., 0], a, alpha


class Projected(Rotations):
    """The same, and states that satisfy positions and velocities of the joints after every step."""

    def held_levels(self, scene, spec):
        return frozenset({"position", "velocity"})

    def after(self, scene, state):
        """Newton's iteration with the mass matrix as the metric."""
        x, R, v, w = super().after(scene, state)
        constraints, inverse = equations(scene).constraints, equations(scene).inverse[0]
        if not constraints.m:
            return [x, R, v, w]

        def closing(rest):
            G = constraints.jacobian(x, R)[0]
            return (-inverse @ G.T @ np.linalg.lstsq(G @ inverse @ G.T, rest, rcond=1e-12)[0]).reshape(-1, 6)
        for _ in range(3):
            move = closing(constraints.position(x, R)[0])
            x, R = x + move[None, :, :3], R @ Rotation.from_rotvec(move[:, 3:]).as_matrix()[None]
        push = closing(constraints.velocity(x, R, v, w)[0])
        return [x, R, v + push[None, :, :3], w + push[None, :, 3:]]


class Millimetres(Rotations):
    """Lengths in mm, masses in g, times in ms."""

    def run(self, scene, spec):
        length, mass, time = 1e3, 1e3, 1e3
        bodies = tuple(dataclasses.replace(
            body, mass=body.mass * mass, inertia=np.asarray(body.inertia) * mass * length**2,
            position=np.asarray(body.position) * length, velocity=np.asarray(body.velocity) * length / time,
            angular_velocity=np.asarray(body.angular_velocity) / time) for body in scene.bodies)
        joints = tuple(dataclasses.replace(joint, parent_anchor=np.asarray(joint.parent_anchor) * length,
                                           child_anchor=np.asarray(joint.child_anchor) * length)
                       for joint in scene.joints)
        other = scene.replace(bodies=bodies, joints=joints, duration=scene.duration * time,
                              gravity=np.asarray(scene.gravity) * length / time**2)
        found = super().run(other, dataclasses.replace(spec, step=spec.step * time))
        s = found.states
        states = States(scene.t, s.x / length, s.R, s.v * time / length, s.w * time, s.a * time**2 / length,
                        s.alpha * time**2)
        return RawRun(states, found.wall_time, found.steps, found.step / time)


class Floats(Rotations):
    """States of 32 bits after every step, declared."""

    eps = 2.0**-23

    def after(self, scene, state):
        return [part.astype(np.float32).astype(float) for part in super().after(scene, state)]


class Adaptive(Rotations):
    """Steps by the estimate of Dormand and Prince's pair of order 5, from output to output."""

    methods = ("DP5",)

    def documented_order(self, scene, spec):
        return None

    def run(self, scene, spec):
        """Steps by rtol, relative to the size of each part of the state."""
        state = [scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]]
        kept, steps, h = [state], 0, 1e-4 * scene.duration
        sizes = [np.abs(part).max() for part in state]
        for begin, end in zip(scene.t[:-1], scene.t[1:], strict=True):
            t = begin
            while t < end - 1e-12 * scene.duration:
                length = min(h, end - t)
                new, error = self.pair(scene, t, state, length)
                sizes = [max(size, np.abs(part).max()) for size, part in zip(sizes, new, strict=True)]
                share = max(np.abs(each).max() / (spec.rtol * max(size, 1e-3)) for each, size in
                            zip(error, sizes, strict=True))
                if share <= 1.0:
                    state, t, steps = self.after(scene, new), t + length, steps + 1
                h = length * min(4.0, max(0.2, 0.9 * max(share, 1e-10) ** -0.2)) if share > 1 or length == h else h
            kept.append(state)
        return self.raw(scene, kept, steps, None)

    def pair(self, scene, t, state, h):
        """The step of order 5 and its estimated error."""
        stages, weights = TABLEAUX[5]
        found = self.stages(scene, t, state, h, [*stages, weights])  # the last stage is the end of the step
        error = self.moved([np.zeros_like(part) for part in state], h, RK45.E, found)
        return self.moved(state, h, weights, found[:-1]), error


class Packed(Rotations):
    """States as one vector y, of which `slope` is the rate: the base of the unusual ones below."""

    methods = ("P",)
    order = 4

    def documented_order(self, scene, spec):
        return self.order

    def packed(self, scene, t, state):
        return np.concatenate([part.ravel() for part in state])

    def unpacked(self, scene, t, y):
        x, R, v, w = np.split(y, np.cumsum([3 * scene.n, 9 * scene.n, 3 * scene.n]))
        x, R, v, w = x.reshape(1, -1, 3), R.reshape(1, -1, 3, 3), v.reshape(1, -1, 3), w.reshape(1, -1, 3)
        return self.after(scene, [x, R, v, w])

    def slope(self, scene, t, y):
        x, R, v, w = np.split(y, np.cumsum([3 * scene.n, 9 * scene.n, 3 * scene.n]))
        return np.concatenate([part.ravel() for part in self.rates(
            scene, t, x.reshape(1, -1, 3), R.reshape(1, -1, 3, 3), v.reshape(1, -1, 3), w.reshape(1, -1, 3))])

    def runge_kutta(self, f, t, y, h, order=4):
        stages, weights = TABLEAUX[order]
        found = []
        for row in stages:
            found.append(f(t + h * sum(row), y + h * sum((c * k for c, k in zip(row, found, strict=True)), 0.0 * y)))
        return y + h * sum(c * k for c, k in zip(weights, found, strict=True))

    def run(self, scene, spec):
        """From output to output, by `advanced`."""
        per, h = (1, None) if spec.step is None else steps_per_sample(scene, spec.step)
        y, self.past, self.steps = self.packed(scene, 0.0, [
            scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]]), [], 0
        kept = [self.unpacked(scene, 0.0, y)]
        for begin, end in zip(scene.t[:-1], scene.t[1:], strict=True):
            y = self.advanced(scene, begin, end, y, per, h, spec)
            kept.append(self.unpacked(scene, end, y))
        return self.raw(scene, kept, self.steps, h)

    def advanced(self, scene, begin, end, y, per, h, spec):
        for k in range(per):
            y = self.stepped(lambda t, z: self.slope(scene, t, z), begin + k * h, y, h)
            self.steps += 1
        return y

    def stepped(self, f, t, y, h):
        return self.runge_kutta(f, t, y, h, self.order)


def of_scipy(kind):
    """An adaptive solver of SciPy, from output to output."""
    class Solver(Packed):
        order = None

        def advanced(self, scene, begin, end, y, per, h, spec):
            from scipy.integrate import solve_ivp

            found = solve_ivp(lambda t, z: self.slope(scene, t, z), (begin, end), y, kind, rtol=max(spec.rtol, 3e-14),
                              atol=spec.rtol * np.abs(y).max())
            self.steps += len(found.t) - 1
            return found.y[:, -1]
    Solver.__name__ = kind
    return Solver


class Dense(of_scipy("DOP853")):
    """One call over the whole run: outputs are values of the interpolation between steps."""

    def run(self, scene, spec):
        """The states at the output times."""
        from scipy.integrate import solve_ivp

        y, rtol = self.packed(scene, 0.0, [scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]]), spec.rtol
        found = solve_ivp(lambda t, z: self.slope(scene, t, z), (0.0, scene.duration), y, "DOP853", dense_output=True,
                          rtol=max(self.factor * rtol, 3e-14), atol=self.factor * rtol * np.abs(y).max())
        between = self.between(scene, found)
        return self.raw(scene, [self.unpacked(scene, t, between(t)) for t in scene.t], len(found.t) - 1, None)

    factor = 1.0  # of its tolerance
    interpolation = 115.0  # DOP853's dense output is of order 7: a share of a step of order 8

    def between(self, scene, found):
        """The states at any time."""
        return found.sol


class Multistep(Packed):
    """Adams and Bashforth's method of order 4 with Moulton's corrector, started by Runge-Kutta steps."""

    def stepped(self, f, t, y, h):
        self.past = [f(t, y), *self.past[:3]]
        if len(self.past) < 4:
            return self.runge_kutta(f, t, y, h)
        guess = y + h * np.tensordot([55 / 24, -59 / 24, 37 / 24, -9 / 24], self.past, 1)
        return y + h * np.tensordot([9 / 24, 19 / 24, -5 / 24, 1 / 24], [f(t + h, guess), *self.past[:3]], 1)


class Backward(Packed):
    """The backward differentiation formula of order 2, solved by iteration, started by a step of order 2."""

    order = 2

    def stepped(self, f, t, y, h):
        before, self.past = self.past[:1], [y]
        found = self.runge_kutta(f, t, y, h, 2)
        for _ in range(12 if before else 0):
            found = (4 * y - before[0]) / 3 + 2 * h / 3 * f(t + h, found)
        return found


class Gauss(Packed):
    """Gauss' collocation of order 4, whose two stages are iterated."""

    def stepped(self, f, t, y, h):
        root = np.sqrt(3.0) / 6
        A = np.array([[0.25, 0.25 - root], [0.25 + root, 0.25]])
        k = np.array([f(t, y)] * 2)
        for _ in range(14):
            k = np.array([f(t + h * A[i].sum(), y + h * A[i] @ k) for i in range(2)])
        return y + h * k.mean(axis=0)


class Loose(Packed):
    """The implicit midpoint rule, whose iteration ends at a residual that it states."""

    order, left = 2, 1e-10

    def stepped(self, f, t, y, h):
        middle = y + 0.5 * h * f(t, y)
        while True:
            better = y + 0.5 * h * f(t + 0.5 * h, middle)
            done, middle = np.abs(better - middle).max() < self.left, better
            if done:
                return 2 * middle - y

    def raw(self, scene, kept, steps, h):
        found = super().raw(scene, kept, steps, h)
        found.stats["newton_left"] = self.left
        return found


class Quaternions(Packed):
    """Attitudes as quaternions of any length, which nothing normalises; the length at the start is 1.7."""

    def packed(self, scene, t, state):
        q = 1.7 * Rotation.from_matrix(state[1][0]).as_quat()
        return np.concatenate([state[0].ravel(), q.ravel(), state[2].ravel(), state[3].ravel()])

    def parts(self, scene, y):
        n = scene.n
        return [part.reshape(1, n, -1) for part in np.split(y, np.cumsum([3 * n, 4 * n, 3 * n]))]

    def unpacked(self, scene, t, y):
        x, q, v, w = self.parts(scene, y)
        return [x, Rotation.from_quat(q[0]).as_matrix()[None], v, w]

    def slope(self, scene, t, y):
        x, q, v, w = self.parts(scene, y)
        _, _, a, alpha = self.rates(scene, t, x, Rotation.from_quat(q[0]).as_matrix()[None], v, w)
        vector, scalar = q[..., :3], q[..., 3:]
        turned = np.concatenate([scalar * w + np.cross(vector, w), -(vector * w).sum(-1, keepdims=True)], axis=-1)
        return np.concatenate([v.ravel(), 0.5 * turned.ravel(), a.ravel(), alpha.ravel()])


class Boosted(Packed):
    """Positions and velocities in a frame that moves at a constant velocity."""

    speed = np.array([3.0, -2.0, 1.0])

    def packed(self, scene, t, state):
        return super().packed(scene, t, [state[0] - self.speed * t, state[1], state[2] - self.speed, state[3]])

    def unpacked(self, scene, t, y):
        x, R, v, w = super().unpacked(scene, t, y)
        return [x + self.speed * t, R, v + self.speed, w]

    def slope(self, scene, t, y):
        n = scene.n
        there = y.copy()
        there[:3 * n] += np.tile(self.speed * t, n)
        there[12 * n:15 * n] += np.tile(self.speed, n)
        rate = super().slope(scene, t, there)
        rate[:3 * n] -= np.tile(self.speed, n)
        return rate


class Energetic(Rotations):
    """Velocities are scaled after every step so that the energy stays; for scenes that conserve it."""

    def run(self, scene, spec):
        """The energy to keep is that of the start. What counts as rest may not depend on where the world begins."""
        start = States(np.zeros(1), scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
        self.kept = mechanics.energy(scene, start)[0]
        weight = sum(body.mass for body in scene.bodies) * np.linalg.norm(scene.gravity)
        self.rest = 1e-3 * (weight * 1.0 + mechanics.kinetic_energy(scene, start)[0])  # J, of a fall by a metre
        return super().run(scene, spec)

    def after(self, scene, state):
        x, R, v, w = super().after(scene, state)
        here = States(np.zeros(1), x, R, v, w)
        moving = mechanics.kinetic_energy(scene, here)[0]
        wanted = moving + self.kept - mechanics.energy(scene, here)[0]
        factor = np.sqrt(max(wanted, 0.0) / moving) if moving > self.rest else 1.0
        return [x, R, factor * v, factor * w]


class Composed(Packed):
    """Suzuki's composition of five midpoint steps, explicit ones: order 2, symmetric only in its leading term."""

    order = 2

    def stepped(self, f, t, y, h):
        p = 1.0 / (4.0 - 4.0 ** (1 / 3))
        for share in (p, p, 1 - 4 * p, p, p):
            y = y + share * h * f(t + 0.5 * share * h, y + 0.5 * share * h * f(t, y))
            t += share * h
        return y


UNUSUAL = ((of_scipy("LSODA"), "P"), (of_scipy("Radau"), "P"), (of_scipy("BDF"), "P"), (Dense, "P"), (Multistep, "P"),
           (Backward, "P"), (Gauss, "P"), (Loose, "P"), (Quaternions, "P"), (Boosted, "P"), (Energetic, "RK2"),
           (Energetic, "RK4"), (Composed, "P"))
