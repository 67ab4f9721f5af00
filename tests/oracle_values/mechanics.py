"""Mechanics by Newton and Euler, body by body, from the text of a scene file, to hold every derived figure against.

It reads the file itself and shares no line with `crosscheck`. A mechanism is a tree of joints from the ground. Its
coordinates are those of the joints, integrated as they are, so that turns are counted by every step. Lines of action,
velocities and accelerations go out from the ground, forces come back from the leaves, all in world axes. Equations of
motion come from that recursion alone, with unit accelerations one by one (Walker and Orin, doi:10.1115/1.3139699).
Where a joint closes a loop only what follows from given states is computed.
"""

from __future__ import annotations

import copy
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.oracle_values.links import NAMES, SIZES, Link, cross, timed

GROUND = -1


@dataclass
class Pose:
    """All bodies at an instant, in world axes; accelerations (K, n, 3) for K sets of rates' derivatives."""

    R: np.ndarray
    x: np.ndarray
    v: np.ndarray
    w: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    anchors: np.ndarray
    lines: list[tuple[int, np.ndarray, np.ndarray]]
    """Of each rate: link, angular and linear direction of the child against the parent."""


class Mechanism:
    """A scene file as bodies, a tree of joints, and the loads and laws on them."""

    def __init__(self, source: str | Path | dict[str, Any]) -> None:
        if isinstance(source, dict):
            self.data = copy.deepcopy(source)
        else:
            self.data = tomllib.loads(source.read_text() if isinstance(source, Path) else source)
        bodies = self.data["bodies"]
        self.names = [body["name"] for body in bodies]
        self.n = len(bodies)
        self.mass = np.array([body["mass"] for body in bodies], float)
        self.J = np.array([body["inertia"] for body in bodies], float)
        self.g = np.array(self.data["gravity"], float)
        self.forces = self.data.get("forces", [])
        self.grow()
        self.laws()

    def index(self, name: str) -> int:
        return GROUND if name == "ground" else self.names.index(name)

    def grow(self) -> None:
        """The tree: joints in the order of the file, each as soon as one of its ends hangs together with the ground."""
        self.links: list[Link] = []
        known, rest = {GROUND}, list(self.data.get("joints", []))
        while True:
            ready = next((j for j in rest if len({self.index(j["parent"]), self.index(j["child"])} & known) == 1
                          and j["type"] in NAMES), None)
            if ready is None:
                left = next((k for k in range(self.n) if k not in known), None)
                if left is None:
                    break
                self.links.append(Link(self.names[left], "free", GROUND, left, {}))
                known.add(left)
                continue
            parent, child = self.index(ready["parent"]), self.index(ready["child"])
            self.links.append(Link(ready["name"], ready["type"], parent, child, ready, turned=child in known))
            known |= {parent, child}
            rest.remove(ready)
        self.loops = rest
        places = rates = 0
        self.coordinates: list[str] = []
        for link in self.links:
            count = len(NAMES[link.kind])
            size = SIZES.get(link.kind, count)
            link.place, link.rates = slice(places, places + size), slice(rates, rates + count)
            places, rates = places + size, rates + count
            self.coordinates += [link.name + end for end in NAMES[link.kind]]
            link.settle()
        self.places, self.dofs = places, rates

    def named(self, name: str) -> Link:
        return next(link for link in self.links if link.name == name)

    def laws(self) -> None:
        """Springs, dampers, rotors and given efforts of the coordinates, and which coordinates follow others."""
        n = self.dofs
        self.place_of = np.zeros(n, int)
        self.armature, self.damping = np.zeros(n), np.zeros(n)
        self.springs: list[tuple[str, int, float, Any]] = []  # name, coordinate, stiffness, rest
        self.efforts: list[tuple[str, int, Any]] = []  # name, coordinate, function
        self.servos: list[tuple[str, int, dict[str, Any]]] = []
        self.friction: dict[int, tuple[float, float]] = {}
        self.limits: dict[int, dict[str, float]] = {}
        self.drives: dict[int, Any] = {}
        follows: dict[int, tuple[int, float, float]] = {}
        for link in self.links:
            count = link.rates.stop - link.rates.start
            for k in range(count):
                self.place_of[link.rates.start + k] = link.place.start + min(k, link.place.stop - link.place.start - 1)
            for key in ("armature", "damping", "stiffness", "dry_friction", "limits"):
                if key not in link.entry:
                    continue
                given = link.entry[key]
                for k, value in enumerate(given if isinstance(given, list) else [given]):
                    self.law(key, link, link.rates.start + k, k, value)
            if "drive" in link.entry:
                self.drives[link.rates.start] = link.entry["drive"]
            if "mimic" in link.entry:
                m = link.entry["mimic"]
                follows[link.rates.start] = self.named(m["joint"]).rates.start, m["ratio"], m.get("offset", 0.0)
        for number_, force in enumerate(self.forces):
            self.load(f"force {number_}", force)
        self.follow(follows)

    def law(self, key: str, link: Link, dof: int, k: int, value: Any) -> None:
        if key in ("armature", "damping"):
            getattr(self, key)[dof] = value
        elif key == "stiffness":
            rest = link.entry.get("rest_position", 0.0)
            self.springs.append((link.name, dof, value, rest[k] if isinstance(rest, list) else rest))
        elif key == "dry_friction":
            pair = value if isinstance(value, dict) else {"sliding": value}
            if pair["sliding"]:
                self.friction[dof] = pair["sliding"], pair.get("static") or pair["sliding"]
        elif value:
            self.limits[dof] = value

    def load(self, name: str, force: dict[str, Any]) -> None:
        """A load in a coordinate; those on bodies are evaluated by `applied`."""
        if "joint" not in force:
            return
        dof = self.named(force["joint"]).rates.start
        if force["type"] == "torsional_spring":
            self.springs.append((name, dof, force["stiffness"], force["rest_angle"]))
            self.damping[dof] += force.get("damping", 0.0)
        elif force["type"] == "servo":
            self.servos.append((name, dof, force))
        else:
            self.efforts.append((name, dof, force["torque"] if force["type"] == "joint_torque" else force["force"]))

    def follow(self, follows: dict[int, tuple[int, float, float]]) -> None:
        """u = B z + b(t), q = B z + offset: a driven coordinate and one that follows another have no z."""
        own = [k for k in range(self.dofs) if k not in follows and k not in self.drives]
        self.own, self.follows = own, follows
        self.B = np.zeros((self.dofs, len(own)))
        for column, k in enumerate(own):
            self.B[k, column] = 1.0
        for k, (leader, ratio, _) in follows.items():
            self.B[k] = ratio * self.B[leader]

    def given(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates, rates and their derivatives of what is driven, 0 elsewhere."""
        out = np.zeros((3, self.dofs))
        for k, function in self.drives.items():
            out[:, k] = timed(function, t)
        for k, (leader, ratio, offset) in self.follows.items():
            out[:, k] = ratio * out[:, leader]
            out[0, k] += offset
        return out[0], out[1], out[2]

    # ---- motion of the bodies -------------------------------------------------------------------------------------

    def pose(self, p: np.ndarray, u: np.ndarray, du: np.ndarray | None = None, moving: Any = 1.0) -> Pose:
        """Bodies by coordinates, rates and their derivatives (K, dofs); moving (K,): 0 leaves out what rates add."""
        du = np.zeros((1, self.dofs)) if du is None else np.atleast_2d(du)
        moving = np.broadcast_to(moving, len(du))[:, None]
        K, n = len(du), self.n + 1  # the last is the ground
        R, x, v, w = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        a, alpha = np.zeros((K, n, 3)), np.zeros((K, n, 3))
        anchors, lines = np.zeros((len(self.links), 3)), []
        for number_, link in enumerate(self.links):
            i, j = link.parent, link.child
            Q, d, free = link.motion(p[link.place])
            here = np.asarray(link.entry.get("parent_anchor", (0.0, 0.0, 0.0)), float) + d
            there = np.asarray(link.entry.get("child_anchor", (0.0, 0.0, 0.0)), float)
            if link.turned:
                R[i] = R[j] @ Q.T
            else:
                R[j] = R[i] @ Q
            rate, second = u[link.rates], du[:, link.rates]
            W = np.array([R[i] @ f[0] for f in free]).reshape(-1, 3)
            V = np.array([R[i] @ f[1] for f in free]).reshape(-1, 3)
            spin, slip = rate @ W, rate @ V
            if link.turned:
                w[i] = w[j] - spin
            else:
                w[j] = w[i] + spin
            carried = sum((cross(w[j] if f[2] else w[i], W[k]) * rate[k] for k, f in enumerate(free)), np.zeros(3))
            relative = second @ W + moving * carried
            r, s = R[i] @ here, R[j] @ there
            if link.turned:
                alpha[:, i] = alpha[:, j] - relative
            else:
                alpha[:, j] = alpha[:, i] + relative
            gap_v = cross(w[i], r) + slip - cross(w[j], s)
            bent = (cross(w[i], cross(w[i], r)) + 2 * cross(w[i], slip) - cross(w[j], cross(w[j], s)))
            gap_a = cross(alpha[:, i], r) + second @ V - cross(alpha[:, j], s) + moving * bent
            one, other, sign = (i, j, -1.0) if link.turned else (j, i, 1.0)
            x[one] = x[other] + sign * (r - s)
            v[one] = v[other] + sign * gap_v
            a[:, one] = a[:, other] + sign * gap_a
            anchors[number_] = x[j] + s
            lines += [(number_, W[k], V[k]) for k in range(len(free))]
        return Pose(R, x, v, w, a, alpha, anchors, lines)

    # ---- loads ----------------------------------------------------------------------------------------------------

    def applied(self, pose: Pose, t: float) -> tuple[np.ndarray, np.ndarray, dict[str, float], dict[str, float]]:
        """Forces and torques (n + 1, 3) about centres of mass, energies stored and powers supplied, by element."""
        F, T = np.zeros((self.n + 1, 3)), np.zeros((self.n + 1, 3))
        stored: dict[str, float] = {}
        power: dict[str, float] = {}
        for number_, force in enumerate(self.forces):
            name, kind = f"force {number_}", force["type"]
            if kind == "linear_spring":
                i, j = self.index(force["parent"]), self.index(force["child"])
                r, s = pose.R[i] @ np.array(force["parent_point"]), pose.R[j] @ np.array(force["child_point"])
                d = pose.x[j] + s - pose.x[i] - r
                speed = pose.v[j] + cross(pose.w[j], s) - pose.v[i] - cross(pose.w[i], r)
                length = np.linalg.norm(d)
                along = d / length if length else np.zeros(3)
                stretch, c = length - force["free_length"], force.get("damping", 0.0)
                pull = (force["stiffness"] * stretch + c * (along @ speed)) * along
                for body, at, sign in ((i, r, 1.0), (j, s, -1.0)):
                    F[body] += sign * pull
                    T[body] += sign * cross(at, pull)
                stored[name] = 0.5 * force["stiffness"] * stretch**2
                power[name] = -c * float(along @ speed) ** 2
            elif kind in ("constant_force", "constant_torque"):
                j = self.index(force["child"])
                value = np.array([timed(part, t)[0] for part in force[kind.removeprefix("constant_")]])
                value = pose.R[j] @ value if force["frame"] == "body" else value
                if kind == "constant_force":
                    s = pose.R[j] @ np.array(force["child_point"])
                    F[j] += value
                    T[j] += cross(s, value)
                    power[name] = float(value @ (pose.v[j] + cross(pose.w[j], s)))
                else:
                    T[j] += value
                    power[name] = float(value @ pose.w[j])
        return F, T, stored, power

    def along(self, q: np.ndarray, u: np.ndarray, t: float, mode: dict[int, Any], samples: dict[int, list[float]]
              ) -> tuple[np.ndarray, np.ndarray, dict[str, float], dict[str, float]]:
        """Efforts in the coordinates, those of given torques and servos among them; energies and powers by element."""
        tau, supplied = -self.damping * u, np.zeros(self.dofs)
        stored: dict[str, float] = {}
        power = {f"damping {k}": float(-c * u[k] ** 2) for k, c in enumerate(self.damping) if c}
        for name, k, stiffness, rest in self.springs:
            r, dr, _ = timed(rest, t)
            tau[k] -= stiffness * (q[k] - r)
            stored[f"spring {name} {k}"] = 0.5 * stiffness * (q[k] - r) ** 2
            power[f"rest {name} {k}"] = -stiffness * (q[k] - r) * dr
        for name, k, function in self.efforts:
            supplied[k] += timed(function, t)[0]
            power[name] = timed(function, t)[0] * u[k]
        for number_, (name, k, servo) in enumerate(self.servos):
            value = samples[number_][0] if "period" in servo else self.servo(servo, q[k], u[k], t)
            supplied[k] += value
            power[name] = value * u[k]
        for k, (sliding, _) in self.friction.items():
            if mode.get(k) in (1, -1):
                tau[k] -= sliding * mode[k]
                power[f"friction {k}"] = -sliding * abs(u[k])
        for k, stop in self.limits.items():
            beyond = max(q[k] - stop.get("upper", np.inf), 0.0) + min(q[k] - stop.get("lower", -np.inf), 0.0)
            if "stiffness" in stop and beyond:
                push = stop["stiffness"] * beyond + stop.get("damping", 0.0) * u[k]
                push = push if push * beyond > 0 else 0.0
                tau[k] -= push
                stored[f"stop {k}"] = 0.5 * stop["stiffness"] * beyond**2
                power[f"stop {k}"] = -(push - stop["stiffness"] * beyond) * u[k]
        return tau, supplied, stored, power

    def servo(self, servo: dict[str, Any], q: float, u: float, t: float) -> float:
        """The law of a servo, cut to what it can give."""
        target, slope, _ = timed(servo.get("target", 0.0), t)
        if "target_velocity" in servo:
            slope = timed(servo["target_velocity"], t)[0]
        value = (servo.get("proportional", 0.0) * (target - q) + servo.get("derivative", 0.0) * (slope - u)
                 + timed(servo.get("feedforward", 0.0), t)[0])
        limit = servo.get("effort_limit")
        if limit is None:
            return value
        lower, upper = limit if isinstance(limit, list) else (-limit, limit)
        if "no_load_speed" in servo:
            left = max(0.0, 1 - abs(u) / servo["no_load_speed"])
            lower, upper = (lower, upper * left) if u > 0 else (lower * left, upper)
        return min(max(value, lower), upper)

    # ---- equations of motion --------------------------------------------------------------------------------------

    def carried(self, pose: Pose, F: np.ndarray, T: np.ndarray, moving: Any = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Forces and torques about its anchor (K, links, 3) that each parent exerts on its child: Newton and Euler."""
        J = pose.R[:-1] @ self.J @ pose.R[:-1].transpose(0, 2, 1)
        Jw = (J @ pose.w[:-1, :, None])[:, :, 0]
        Ja = (J @ pose.alpha[:, :-1, :, None])[..., 0]
        moving = np.broadcast_to(moving, len(Ja))[:, None, None]
        need = self.mass[:, None] * pose.a[:, :-1] - moving * (self.mass[:, None] * self.g + F[:-1])
        about = Ja + moving * (np.cross(pose.w[:-1], Jw) - T[:-1])
        need = np.concatenate([need, np.zeros((len(need), 1, 3))], axis=1)
        about = np.concatenate([about, np.zeros((len(about), 1, 3))], axis=1)
        force, torque = np.zeros((len(need), len(self.links), 3)), np.zeros((len(need), len(self.links), 3))
        for number_ in reversed(range(len(self.links))):
            link, P = self.links[number_], pose.anchors[number_]
            outer, inner, sign = (link.parent, link.child, -1.0) if link.turned else (link.child, link.parent, 1.0)
            f = need[:, outer]
            n = about[:, outer] - cross(f, pose.x[outer] - P)
            force[:, number_], torque[:, number_] = sign * f, sign * n
            need[:, inner] += f
            about[:, inner] += n - cross(f, P - pose.x[inner])
        return force, torque

    def efforts_of(self, pose: Pose, F: np.ndarray, T: np.ndarray, moving: np.ndarray) -> np.ndarray:
        """(K, dofs) parts of the wrenches along the rates."""
        force, torque = self.carried(pose, F, T, moving)
        return np.stack([torque[:, k] @ W + force[:, k] @ V for k, W, V in pose.lines], axis=1) if pose.lines else (
            np.zeros((len(force), 0)))

    def scalars(self, p: np.ndarray) -> np.ndarray:
        """Coordinates by rate; a number of no meaning for those of balls."""
        return p[self.place_of]

    def system(self, p: np.ndarray, u: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
        """Mass matrix M and h of M du + h = efforts along the coordinates; powers of loads on bodies."""
        moving = np.array([1.0] + [0.0] * self.dofs)
        pose = self.pose(p, u, np.vstack([np.zeros(self.dofs), np.eye(self.dofs)]), moving)
        F, T, _, power = self.applied(pose, t)
        rows = self.efforts_of(pose, F, T, moving)
        return rows[1:].T + np.diag(self.armature), rows[0], power

    def accelerations(self, p: np.ndarray, u: np.ndarray, t: float, mode: dict[int, Any] | None = None,
                      samples: dict[int, list[float]] | None = None, extra: np.ndarray | None = None
                      ) -> tuple[np.ndarray, np.ndarray, float]:
        """du; what drives, sticking friction, stops and gears add along each coordinate; power of all but springs."""
        mode, samples = mode or {}, self.sampled(p, u, t) if samples is None else samples
        M, h, power = self.system(p, u, t)
        tau, supplied, _, of_laws = self.along(self.scalars(p), u, t, mode, samples)
        tau = tau + supplied + (0.0 if extra is None else extra)
        second = self.given(t)[2]
        moving = [column for column, k in enumerate(self.own) if mode.get(k) not in ("stick", "lower", "upper")]
        B = self.B[:, moving]
        dz = np.linalg.solve(B.T @ M @ B, B.T @ (tau - h - M @ second))
        du = B @ dz + second
        added = M @ du + h - tau
        return du, added, sum(power.values()) + sum(of_laws.values()) + sum(added[k] * u[k] for k in self.drives)

    def sampled(self, p: np.ndarray, u: np.ndarray, t: float) -> dict[int, list[float]]:
        """What each sampled servo gives at t = 0; with a delay nothing yet."""
        q = self.scalars(p)
        return {k: [0.0] * s.get("delay", 0) + [self.servo(s, q[dof], u[dof], t)]
                for k, (_, dof, s) in enumerate(self.servos) if "period" in s}
