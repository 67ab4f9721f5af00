"""Right engines of our own: orders 1 to 8, adaptive, other units, projected, attitudes without normalisation, declared
numbers of 32 bits, and unusual ones."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.integrate import RK45
from scipy.spatial.transform import Rotation

from crosscheck.adapters.base import RawRun, steps_per_sample
from crosscheck.scene import mechanics
from crosscheck.scene.states import States
from tests.engines.stepper import TABLEAUX, Matrices, begun, explicit


class Rotations(Matrices):
    """The nearest rotation after every step."""

    def after(self, scene, t, state):
        U, _, V = np.linalg.svd(state[1])
        return [state[0], U @ V, *state[2:]]


class Angles(Rotations):
    """Attitudes within a step by three angles about y, x and z, which prefer axes of the world."""

    width = 3

    def into(self, R):
        return Rotation.from_matrix(R).as_euler("YXZ")

    def out(self, part, state):
        return Rotation.from_euler("YXZ", part).as_matrix()

    def spin(self, part, R, w):
        """w = Z^T X^T e_y a' + Z^T e_x b' + e_z c'."""
        X, Z = (Rotation.from_euler(axis, part[:, [k]]).as_matrix() for axis, k in (("X", 1), ("Z", 2)))
        Zt = np.swapaxes(Z, 1, 2)
        along = np.broadcast_to([0.0, 0.0, 1.0], part.shape)
        E = np.stack([(Zt @ np.swapaxes(X, 1, 2))[..., 1], Zt[..., 0], along], -1)
        return np.linalg.solve(E, w[..., None])[..., 0]


class Projected(Rotations):
    """The same, and states that satisfy positions and velocities of the joints after every step."""

    def held_levels(self, scene, spec):
        return frozenset({"position", "velocity"})

    def after(self, scene, t, state):
        return self.equations(scene).closed(*super().after(scene, t, state))


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

    def after(self, scene, t, state):
        return [part.astype(np.float32).astype(float) for part in super().after(scene, t, state)]


class Adaptive(Rotations):
    """Steps by the estimate of Dormand and Prince's pair of order 5, from output to output."""

    methods = ("DP5",)

    def run(self, scene, spec):
        """Steps by rtol, relative to the size of each part of the state."""
        self.known, state = (), begun(scene)
        kept, steps, h = [self.told(scene, 0.0, state)], 0, 1e-4 * scene.duration
        ends = np.cumsum([3, 9, 3]) * scene.n
        sizes = [np.abs(part).max() for part in state]
        for begin, end in zip(scene.t[:-1], scene.t[1:], strict=True):
            t = begin
            while t < end - 1e-12 * scene.duration:
                length, y = min(h, end - t), self.packed(t, state)
                y, found = explicit(PAIR, lambda at, z: self.slope(scene, at, z), t, y, length)
                new, error = self.unpacked(t, y), np.split(length * (RK45.E @ found), ends)
                sizes = [max(size, np.abs(part).max()) for size, part in zip(sizes, new, strict=True)]
                share = max(np.abs(each).max() / (spec.rtol * max(size, 1e-3)) for each, size in
                            zip(error, sizes, strict=True))
                if share <= 1.0:
                    state, t, steps = self.after(scene, t, new), t + length, steps + 1
                h = length * min(4.0, max(0.2, 0.9 * max(share, 1e-10) ** -0.2)) if share > 1 or length == h else h
            kept.append(self.told(scene, end, state))
        return self.raw(scene, kept, steps, None)


PAIR = [*TABLEAUX[5][0], TABLEAUX[5][1]], [*TABLEAUX[5][1], 0.0]
"""The last stage is the end of the step."""


class Packed(Rotations):
    """One vector y through the whole run: the base of the unusual ones below."""

    methods = ("P",)
    order = 4

    def run(self, scene, spec):
        """From output to output, by `advanced`."""
        per, h = (1, None) if spec.step is None else steps_per_sample(scene, spec.step)
        state = begun(scene)
        self.known, self.past, self.steps, y = (), [], 0, self.packed(0.0, state)
        kept = [self.told(scene, 0.0, self.after(scene, 0.0, self.unpacked(0.0, y)))]
        for begin, end in zip(scene.t[:-1], scene.t[1:], strict=True):
            y = self.advanced(scene, begin, end, y, per, h, spec)
            kept.append(self.told(scene, end, self.after(scene, end, self.unpacked(end, y))))
        return self.raw(scene, kept, self.steps, h)

    def advanced(self, scene, begin, end, y, per, h, spec):
        for k in range(per):
            y = self.stepped(lambda t, z: self.slope(scene, t, z), begin + k * h, y, h)
            self.steps += 1
        return y

    def stepped(self, f, t, y, h):
        return explicit(TABLEAUX[self.order], f, t, y, h)[0]


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

    factor = 1.0  # of its tolerance
    interpolation = 115.0  # DOP853's dense output is of order 7: a share of a step of order 8

    def run(self, scene, spec):
        """The states at the output times."""
        from scipy.integrate import solve_ivp

        y, rtol, self.known = self.packed(0.0, begun(scene)), spec.rtol, ()
        found = solve_ivp(lambda t, z: self.slope(scene, t, z), (0.0, scene.duration), y, "DOP853", dense_output=True,
                          rtol=max(self.factor * rtol, 3e-14), atol=self.factor * rtol * np.abs(y).max())
        between = self.between(scene, found)
        kept = [self.told(scene, t, self.after(scene, t, self.unpacked(t, between(t)))) for t in scene.t]
        return self.raw(scene, kept, len(found.t) - 1, None)

    def between(self, scene, found):
        """The states at any time."""
        return found.sol


class Multistep(Packed):
    """Adams and Bashforth's method of order 4 with Moulton's corrector, started by Runge-Kutta steps."""

    def stepped(self, f, t, y, h):
        self.past = [f(t, y), *self.past[:3]]
        if len(self.past) < 4:
            return super().stepped(f, t, y, h)
        guess = y + h * np.tensordot([55 / 24, -59 / 24, 37 / 24, -9 / 24], self.past, 1)
        return y + h * np.tensordot([9 / 24, 19 / 24, -5 / 24, 1 / 24], [f(t + h, guess), *self.past[:3]], 1)


class Backward(Packed):
    """The backward differentiation formula of order 2, solved by iteration, started by a step of order 2."""

    order = 2

    def stepped(self, f, t, y, h):
        before, self.past = self.past[:1], [y]
        found = explicit(TABLEAUX[2], f, t, y, h)[0]
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

    width = 4

    def into(self, R):
        return 1.7 * Rotation.from_matrix(R).as_quat()

    def out(self, part, state):
        return Rotation.from_quat(part).as_matrix()

    def spin(self, part, R, w):
        vector, scalar = part[:, :3], part[:, 3:]
        return 0.5 * np.concatenate([scalar * w + np.cross(vector, w), -(vector * w).sum(1, keepdims=True)], axis=1)


class Boosted(Packed):
    """Positions and velocities in a frame that moves at a constant velocity."""

    speed = np.array([3.0, -2.0, 1.0])

    def packed(self, t, state):
        return super().packed(t, [state[0] - self.speed * t, state[1], state[2] - self.speed, state[3]])

    def unpacked(self, t, y, state=None):
        x, R, v, w = super().unpacked(t, y, state)
        return [x + self.speed * t, R, v + self.speed, w]

    def slope(self, scene, t, y, state=None):
        rate = super().slope(scene, t, y, state)
        rate[:3 * scene.n] -= np.tile(self.speed, scene.n)
        return rate


class Energetic(Rotations):
    """Velocities are scaled after every step so that the energy stays; for scenes that conserve it."""

    def run(self, scene, spec):
        """The energy to keep is that of the start. What counts as rest may not depend on where the world begins."""
        start = States(np.zeros(1), *(part[None] for part in begun(scene)))
        self.kept = mechanics.energy(scene, start)[0]
        weight = sum(body.mass for body in scene.bodies) * np.linalg.norm(scene.gravity)
        self.rest = 1e-3 * (weight * 1.0 + mechanics.kinetic_energy(scene, start)[0])  # J, of a fall by a metre
        return super().run(scene, spec)

    def after(self, scene, t, state):
        x, R, v, w = super().after(scene, t, state)
        here = States(np.zeros(1), x[None], R[None], v[None], w[None])
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
