"""Mechanics of a few kinds of scenes, written for these engines alone: a state vector, its rate, and the way back.

Every model has `refuse(scene)`, `start`, `rate(t, y)`, `settle(y)` and `report(Y)`, arrays of the states of all bodies.
"""

import numpy as np
from scipy.spatial.transform import Rotation


def cross(a, b):
    """Vector product of two triples; much faster than NumPy's for single vectors."""
    (a0, a1, a2), (b0, b1, b2) = a, b
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def across(a, b):
    """Vector products along the last axis of arrays of one shape."""
    return cross(a.T, b.T).T


def hat(a):
    """The matrix of the vector product with `a`."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def matrix(q):
    """Attitudes (..., 3, 3) from quaternions w, x, y, z of any length but zero."""
    w, x, y, z = q.T if q.ndim > 1 else q.tolist()  # of one quaternion numbers are faster
    s = 2.0 / (w * w + x * x + y * y + z * z)
    columns = [[1 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)],
               [s * (x * y - w * z), 1 - s * (x * x + z * z), s * (y * z + w * x)],
               [s * (x * z + w * y), s * (y * z - w * x), 1 - s * (x * x + y * y)]]
    return np.array(columns).T


def turn(q, w):
    """Rate of a quaternion at the angular velocity `w` in body axes."""
    (a, b, c, d), (x, y, z) = q, w
    return [0.5 * (-b * x - c * y - d * z), 0.5 * (a * x + c * z - d * y),
            0.5 * (a * y + d * x - b * z), 0.5 * (a * z + b * y - c * x)]


def exponential(vectors):
    """The rotations (..., 3, 3) by vectors."""
    return Rotation.from_rotvec(vectors).as_matrix()


class Model:
    """Of a state that needs no mending."""

    @staticmethod
    def settle(y):
        return y


class Points:
    """The loads that these models know: springs between points, and constant forces and torques."""

    def __init__(self, scene):
        self.springs, self.pushes, self.torques = [], [], []
        for load in scene.loads:
            p = dict(load.parameters)
            if load.type == "linear_spring":
                ends = [(load.parent, np.array(p["parent_point"])), (load.child, np.array(p["child_point"]))]
                self.springs.append((ends, p["stiffness"], p["free_length"], p["damping"]))
            elif load.type == "constant_force":
                self.pushes.append((load.child, np.array(p["child_point"]), p["frame"] == "body", np.array(p["force"])))
            else:
                self.torques.append((load.child, p["frame"] == "body", np.array(p["torque"])))

    @staticmethod
    def refuse(scene):
        if {load.type for load in scene.loads} - {"linear_spring", "constant_force", "constant_torque"} or scene.timed:
            return "it knows springs between points and constant loads"
        return None

    def wrenches(self, t, x, R, v, w):
        """Forces (world) and torques (body axes) on the centres of mass, by lists over the bodies."""
        force, torque = [np.zeros(3) for _ in x], [np.zeros(3) for _ in x]

        def push(body, point, value):
            force[body] = force[body] + value
            torque[body] = torque[body] + cross(point, value @ R[body])

        for ends, stiffness, free_length, damping in self.springs:
            at = [(p, np.zeros(3)) if b < 0 else (x[b] + R[b] @ p, v[b] + R[b] @ cross(w[b], p)) for b, p in ends]
            apart, rate = at[1][0] - at[0][0], at[1][1] - at[0][1]
            length = np.sqrt(apart @ apart)
            along = apart / length
            pull = stiffness * (length - free_length) + self.damper(t, damping) * (along @ rate)
            for (body, point), sign in zip(ends, (1.0, -1.0), strict=True):
                if body >= 0:
                    push(body, point, sign * pull * along)
        for body, point, turning, value in self.pushes:
            push(body, point, R[body] @ value if turning else value)
        for body, turning, value in self.torques:
            torque[body] = torque[body] + (value if turning else value @ R[body])
        return force, torque

    @staticmethod
    def damper(_t, damping):
        """A damper's coefficient."""
        return damping


class Balls:
    """Trees of bodies on ball joints: quaternions and angular velocities; positions follow by the tree."""

    gyroscopic = 1.0

    def __init__(self, scene):
        n = self.n = scene.n
        self.m, self.I, self.g = scene.masses[:, None], np.array(scene.inertias), scene.gravity
        self.weights, self.loads = np.repeat(self.m, 3, axis=0), Points(scene)
        joints = {joint.child: joint for joint in scene.joints}
        arms, self.roots = [], np.zeros((n, 3))  # of every body: the bodies on its way from the ground, with their arms
        for body in range(n):
            child, arm = body, np.zeros(3)
            while child >= 0:
                arms.append((body, child, arm - joints[child].child_anchor))
                arm, child = joints[child].parent_anchor, joints[child].parent
            self.roots[body] = arm
        self.bodies, self.links, self.arms = map(np.array, zip(*arms, strict=True))
        self.hats, self.sum = np.array([hat(arm) for arm in self.arms]), 1.0 * (self.bodies == np.arange(n)[:, None])
        self.start = np.concatenate([*(body.attitude for body in scene.bodies), scene.w0.ravel()])

    @staticmethod
    def refuse(scene):
        if len(scene.joints) != scene.n or {joint.type for joint in scene.joints} != {"spherical"}:
            return "it knows trees of bodies on ball joints"
        if sorted(joint.child for joint in scene.joints) != list(range(scene.n)):
            return "it knows no loops"
        return Points.refuse(scene)

    def split(self, y):
        return y[:4 * self.n].reshape(-1, 4), y[4 * self.n:].reshape(-1, 3)

    def along(self, R, inner):
        """What vectors (..., P, 3) of the arms in their bodies' axes add up to for each body, in the world."""
        return self.sum @ (R[..., self.links, :, :] @ inner[..., None])[..., 0]

    def swing(self, w):
        """The vector products of rates (..., P, 3) with the arms."""
        return -(self.hats @ w[..., None])[..., 0]

    def swung(self, R, w):
        """Positions and velocities (..., n, 3), and accelerations without those of the rates."""
        w = w[..., self.links, :]
        swing = self.swing(w)
        return self.roots + self.along(R, self.arms), self.along(R, swing), self.along(R, across(w, swing))

    def accelerate(self, t, R, w):
        """Angular accelerations (n, 3) in body axes."""
        n, each = self.n, np.arange(self.n)
        x, v, bias = self.swung(R, w)
        force, torque = map(np.array, self.loads.wrenches(t, x, R, v, w))
        J = np.zeros((n, 3, n, 3))
        J[self.bodies, :, self.links] = -R[self.links] @ self.hats
        G = J.reshape(3 * n, 3 * n)
        M = G.T @ (self.weights * G)
        M.reshape(n, 3, n, 3)[each, :, each] += self.I
        torque = torque - self.gyroscopic * across(w, (self.I @ w[..., None])[..., 0])
        f = G.T @ (self.m * (self.g - bias) + force).ravel() + torque.ravel()
        return np.linalg.solve(M, f).reshape(n, 3)

    def rate(self, t, y):
        q, w = self.split(y)
        turned = [turn(a, b) for a, b in zip(q.tolist(), w.tolist(), strict=True)]
        return np.concatenate([*turned, self.accelerate(t, np.array([matrix(a) for a in q]), w).ravel()])

    def settle(self, y):
        q, w = self.split(y)
        return np.concatenate([(q / np.linalg.norm(q, axis=1)[:, None]).ravel(), w.ravel()])

    def report(self, Y):
        return self.reported(matrix(Y[:, :4 * self.n].reshape(-1, self.n, 4)), Y[:, 4 * self.n:])

    def reported(self, R, rates):
        """Arrays of the states over time from attitudes and angular velocities."""
        w = rates.reshape(-1, self.n, 3)
        x, v, _ = self.swung(R, w)
        return {"x": x, "R": R, "v": v, "w": w}

    def accelerations(self, t, Y):
        """World accelerations of the centres of mass and angular ones, (T, n, 3)."""
        got = self.report(Y)
        R, w = got["R"], got["w"]
        alpha = np.array([self.accelerate(time, *both) for time, *both in zip(t, R, w, strict=True)])
        return self.swung(R, w)[2] + self.along(R, self.swing(alpha[:, self.links])), alpha


class Floating:
    """One body without joints, or with one rod to the ground, held at the index-1 level with Baumgarte's terms."""

    baumgarte = (10.0, 10.0)

    def __init__(self, scene):
        self.m, self.I, self.g, self.loads = scene.masses[0], scene.inertias[0], scene.gravity, Points(scene)
        self.rod = scene.joints[0] if scene.joints else None
        body = scene.bodies[0]
        self.start = np.concatenate([scene.x0[0], body.attitude, scene.v0[0], scene.w0[0]])

    @staticmethod
    def refuse(scene):
        kinds = [(joint.type, joint.parent) for joint in scene.joints]
        return Points.refuse(scene) if scene.n == 1 and kinds in ([], [("distance", -1)]) else "it knows one free body"

    def rate(self, t, y):
        x, q, v, w = y[:3], y[3:7], y[7:10], y[10:]
        R = matrix(q)
        force, torque = self.loads.wrenches(t, [x], [R], [v], [w])
        f, n = self.m * self.g + force[0], torque[0] - cross(w, self.I @ w)
        if self.rod:
            arm = self.rod.child_anchor
            p, u = x + R @ arm - self.rod.parent_anchor, v + R @ cross(w, arm)
            along, about_arm = p, cross(arm, p @ R)  # force and torque of a unit multiplier
            weight = along @ along / self.m + about_arm @ np.linalg.solve(self.I, about_arm)
            a, b = self.baumgarte
            level = 0.5 * (p @ p - self.rod.length**2)
            free = along @ f / self.m + about_arm @ np.linalg.solve(self.I, n)
            bias = u @ u + p @ (R @ cross(w, cross(w, arm)))
            pull = -(free + bias + 2 * a * (p @ u) + b * b * level) / weight
            f, n = f + pull * along, n + pull * about_arm
        return np.concatenate([v, turn(q, w), f / self.m, np.linalg.solve(self.I, n)])

    def settle(self, y):
        y = y.copy()
        y[3:7] /= np.linalg.norm(y[3:7])
        return y

    def report(self, Y):
        return {"x": Y[:, None, :3], "R": matrix(Y[:, 3:7])[:, None], "v": Y[:, None, 7:10], "w": Y[:, None, 10:]}


class FloatingMomentum:
    """One free body without loads by its momenta in world axes; rates in body axes are converted on the way out."""

    def __init__(self, scene):
        self.m, self.I, self.g = scene.masses[0], scene.inertias[0], scene.gravity
        spin = scene.R0[0] @ self.I @ scene.w0[0]
        self.start = np.concatenate([scene.x0[0], scene.bodies[0].attitude, self.m * scene.v0[0], spin])

    @staticmethod
    def refuse(scene):
        return None if scene.n == 1 and not scene.joints and not scene.loads else "it knows one body in free fall"

    def rate(self, _t, y):
        q, p, spin = y[3:7], y[7:10], y[10:]
        w = np.linalg.solve(self.I, spin @ matrix(q))
        return np.concatenate([p / self.m, turn(q, w), self.m * self.g, np.zeros(3)])

    settle = Floating.settle

    def report(self, Y):
        R = matrix(Y[:, 3:7])
        w = np.linalg.solve(self.I, np.einsum("tji,tj->ti", R, Y[:, 10:])[..., None])[..., 0]
        return {"x": Y[:, None, :3], "R": R[:, None], "v": Y[:, None, 7:10] / self.m, "w": w[:, None]}


def shortest(a, b):
    """The shortest rotation that takes the unit vector `a` to `b`."""
    axis, cosine = np.cross(a, b), a @ b
    return np.eye(3) + hat(axis) + hat(axis) @ hat(axis) / (1 + cosine)


class Hinge(Model):
    """One body on a hinge to the ground: its angle and rate; a torsional spring, a damper and dry friction."""

    def __init__(self, scene):
        joint = scene.joints[0]
        self.axis, self.own = self.axes(joint, scene.R0[0])
        self.at = joint.parent_anchor
        self.R, self.arm, self.weight = scene.R0[0], -joint.child_anchor, scene.masses[0] * scene.gravity
        J = scene.inertias[0] + scene.masses[0] * (self.arm @ self.arm * np.eye(3) - np.outer(self.arm, self.arm))
        self.J = self.own @ J @ self.own
        relative = scene.R0[0] @ shortest(self.own, self.axis).T
        self.angle = self.axis @ Rotation.from_matrix(relative).as_rotvec()
        self.springs = [(p["stiffness"], p["rest_angle"], p["damping"]) for p in (f.parameters for f in scene.loads)]
        self.friction = sum(law.sliding for law in joint.dry_friction)
        lever = self.R @ self.arm
        self.sine = self.axis @ np.cross(np.cross(self.axis, lever), self.weight)
        self.cosine = self.axis @ np.cross(lever - self.axis * (self.axis @ lever), self.weight)
        self.start = np.array([self.angle, self.own @ scene.w0[0]])

    @staticmethod
    def axes(joint, _R):
        """The axis in the world and in the body."""
        return joint.parent_axis, joint.child_axis

    @staticmethod
    def refuse(scene):
        if scene.n != 1 or [(joint.type, joint.parent) for joint in scene.joints] != [("revolute", -1)]:
            return "it knows one body on a hinge to the ground"
        if {load.type for load in scene.loads} - {"torsional_spring"} or scene.timed or scene.joints[0].limits:
            return "it knows torsional springs and dry friction alone"
        return None

    def torque(self, angle, rate):
        """What turns the body about the hinge, without friction, N m."""
        gone = angle - self.angle
        return (self.sine * np.sin(gone) + self.cosine * np.cos(gone)
                - sum(k * (angle - rest) + d * rate for k, rest, d in self.springs))

    def rate(self, _t, y):
        return np.array([y[1], self.torque(y[0], y[1]) / self.J])

    def slipping(self, sign):
        """The rate of the state under dry friction against a motion of this sign."""
        return lambda _t, y: np.array([y[1], (self.torque(*y) - sign * self.friction) / self.J])

    def report(self, Y):
        R = exponential((Y[:, :1] - self.angle) * self.axis) @ self.R
        lever, rates = R @ self.arm, Y[:, 1:]
        v = rates * np.cross(self.axis, lever)
        return {"x": (self.at + lever)[:, None], "R": R[:, None], "v": v[:, None], "w": (rates * self.own)[:, None],
                "hinges": Y[:, :1]}


class Slide(Model):
    """One body on a straight rail with a spring, a damper and a rigid stop below."""

    def __init__(self, scene):
        joint = scene.joints[0]
        self.axis, self.R, self.m = joint.parent_axis, scene.R0[0], scene.masses[0]
        where = self.axis @ (scene.x0[0] + self.R @ joint.child_anchor - joint.parent_anchor)
        self.x = scene.x0[0] - where * self.axis
        self.pull = self.m * self.axis @ scene.gravity
        self.springs = [(p["stiffness"], p["rest_position"], p["damping"]) for p in (f.parameters for f in scene.loads)]
        stop = joint.limits[0] if joint.limits else None
        self.lower, self.restitution = (stop.lower, stop.restitution) if stop else (-1e9, 0.0)
        self.start = np.array([where, self.axis @ scene.v0[0]])

    @staticmethod
    def refuse(scene):
        if scene.n != 1 or [(joint.type, joint.parent) for joint in scene.joints] != [("prismatic", -1)]:
            return "it knows one body on a rail"
        joint = scene.joints[0]
        if {load.type for load in scene.loads} - {"slide_spring"} or scene.timed or joint.dry_friction:
            return "it knows the spring and damper of the rail alone"
        return None if not joint.limits or joint.limits[0].stiffness is None else "it knows rigid stops alone"

    def rate(self, _t, y):
        load = self.pull - sum(k * (y[0] - rest) + d * y[1] for k, rest, d in self.springs)
        return np.array([y[1], load / self.m])

    def report(self, Y):
        T = len(Y)
        return {"x": (self.x + Y[:, :1] * self.axis)[:, None], "R": np.broadcast_to(self.R, (T, 1, 3, 3)).copy(),
                "v": (Y[:, 1:] * self.axis)[:, None], "w": np.zeros((T, 1, 3))}


class Linkage:
    """Bodies of a plane linkage with hinges along y: x, z and angle of each, accelerations by the index-1 system."""

    def __init__(self, scene):
        self.n = scene.n
        self.weights = np.array([[m, m, J[1, 1]] for m, J in zip(scene.masses, scene.inertias, strict=True)]).ravel()
        self.force = np.array([[m * scene.gravity[0], m * scene.gravity[2], 0.0] for m in scene.masses]).ravel()
        self.joints = [(j.parent, j.parent_anchor[[0, 2]], j.child, j.child_anchor[[0, 2]]) for j in scene.joints]
        self.level = scene.x0[:, 1]
        angle = np.arctan2(scene.R0[:, 0, 2], scene.R0[:, 0, 0])
        q = np.stack([scene.x0[:, 0], scene.x0[:, 2], angle], axis=1)
        u = np.stack([scene.v0[:, 0], scene.v0[:, 2], scene.w0[:, 1]], axis=1)
        self.start = np.concatenate([q.ravel(), u.ravel()])

    @staticmethod
    def refuse(scene):
        plane = all(j.type == "revolute" and np.allclose(np.abs(j.parent_axis), [0, 1, 0]) for j in scene.joints)
        level = np.allclose(scene.R0[:, 1], [0, 1, 0]) and scene.gravity[1] == 0
        if not plane or not level or scene.loads or not scene.joints or scene.has_laws:
            return "it knows plane linkages with hinges along y under gravity"
        return None

    def closure(self, q, u):
        """Gaps of the joints, their Jacobian, and the part of their second derivative without accelerations."""
        gap, G = np.zeros(2 * len(self.joints)), np.zeros((2 * len(self.joints), 3 * self.n))
        bias = np.zeros_like(gap)
        for row, (parent, near, child, far) in enumerate(self.joints):
            k = slice(2 * row, 2 * row + 2)
            for body, (px, pz), sign in ((parent, near, -1.0), (child, far, 1.0)):
                if body < 0:
                    gap[k] += sign * np.array([px, pz])
                    continue
                x, z, angle = q[3 * body:3 * body + 3]
                s, c = np.sin(angle), np.cos(angle)
                rx, rz = c * px + s * pz, -s * px + c * pz
                gap[k] += sign * np.array([x + rx, z + rz])
                G[2 * row, 3 * body], G[2 * row + 1, 3 * body + 1] = sign, sign
                G[k, 3 * body + 2] = sign * np.array([rz, -rx])
                bias[k] -= sign * u[3 * body + 2] ** 2 * np.array([rx, rz])
        return gap, G, bias

    def rate(self, _t, y):
        q, u = np.split(y, 2)
        _, G, bias = self.closure(q, u)
        W = G / self.weights
        pull = np.linalg.solve(W @ G.T, -bias - W @ self.force)
        return np.concatenate([u, (self.force + G.T @ pull) / self.weights])

    def settle(self, y):
        q, u = np.split(y, 2)
        for _ in range(4):
            gap, G, _ = self.closure(q, u)
            if np.max(np.abs(gap)) < 1e-15:
                break
            W = G / self.weights
            q = q - W.T @ np.linalg.solve(W @ G.T, gap)
        _, G, _ = self.closure(q, u)
        W = G / self.weights
        return np.concatenate([q, u - W.T @ np.linalg.solve(W @ G.T, G @ u)])

    def report(self, Y):
        T, n = len(Y), self.n
        q, u = Y[:, :3 * n].reshape(T, n, 3), Y[:, 3 * n:].reshape(T, n, 3)
        x, v, w = np.zeros((T, n, 3)), np.zeros((T, n, 3)), np.zeros((T, n, 3))
        x[..., 0], x[..., 1], x[..., 2], v[..., 0], v[..., 2], w[..., 1] = (
            q[..., 0], self.level, q[..., 1], u[..., 0], u[..., 1], u[..., 2])
        R = exponential(q[..., 2].reshape(-1, 1) * [0.0, 1.0, 0.0]).reshape(T, n, 3, 3)
        return {"x": x, "R": R, "v": v, "w": w}
