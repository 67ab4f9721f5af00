"""Every figure that is derived for all sources, of a motion of `motion`, by its definition."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.oracle_values.links import matrix, quaternion
from tests.oracle_values.mechanics import Mechanism, Pose
from tests.oracle_values.motion import Instant

ATTITUDE = (0.8, 0.1, -0.4, 0.3)
OF_SITES = ("position", "velocity", "acceleration", "angular_velocity", "angular_acceleration", "accelerometer",
            "gyroscope")
ROTARY = ("revolute", "prismatic", "cylindrical")


def watched(data: dict[str, Any]) -> dict[str, Any]:
    """The file with a site on its last body and every sensor there and on every joint, in both frames."""
    sites = [{"name": "tip", "body": data["bodies"][-1]["name"], "position": [0.1, -0.2, 0.3],
              "attitude": list(ATTITUDE)}]
    sensors = [{"name": f"{kind} {frame}", "type": kind, "site": "tip", "frame": frame} for kind in OF_SITES
               for frame in ("site", "world")]
    sensors.append({"name": "attitude", "type": "attitude", "site": "tip"})
    for joint in data.get("joints", []):
        name, kinds = joint["name"], []
        if joint["type"] not in ("fixed", "distance", "point_on_line", "point_on_plane"):
            kinds = ["joint_position", "joint_velocity", "joint_acceleration"]
        if joint["type"] in ROTARY:
            kinds.append("joint_effort")
        sensors += [{"name": f"{kind} {name}", "type": kind, "joint": name} for kind in kinds]
        sensors += [{"name": f"{kind} {frame} {name}", "type": kind, "joint": name, "site": "tip", "frame": frame}
                    for kind in ("force", "torque") for frame in ("site", "world")]
    return data | {"sites": sites, "sensors": sensors}


class Figures:
    """What a state of a mechanism shows."""

    def __init__(self, mech: Mechanism, state: Instant) -> None:
        self.mech, self.state = mech, state
        self.q = mech.scalars(state.p)
        self.du, self.added, _ = mech.accelerations(state.p, state.u, state.t, state.mode, state.samples)
        self.pose: Pose = mech.pose(state.p, state.u, self.du)
        self.F, self.T, self.stored, _ = mech.applied(self.pose, state.t)
        _, self.supplied, laws, _ = mech.along(self.q, state.u, state.t, state.mode, state.samples)
        self.stored = self.stored | laws
        for k in mech.drives:
            self.supplied[k] += self.added[k]
        self.wrench = [part[0] for part in mech.carried(self.pose, self.F, self.T)]

    def energies(self) -> dict[str, float]:
        """J, by element."""
        mech, pose = self.mech, self.pose
        out = dict(self.stored)
        for k, name in enumerate(mech.names):
            w = pose.R[k].T @ pose.w[k]
            out[f"kinetic {name}"] = 0.5 * mech.mass[k] * float(pose.v[k] @ pose.v[k]) + 0.5 * float(w @ mech.J[k] @ w)
            out[f"weight {name}"] = -mech.mass[k] * float(mech.g @ pose.x[k])
        for k, rotor in enumerate(mech.armature):
            out[f"kinetic rotor {k}"] = 0.5 * rotor * self.state.u[k] ** 2
        return out

    def energy(self) -> dict[str, float]:
        parts = self.energies()
        kinetic = sum(value for name, value in parts.items() if name.startswith("kinetic"))
        return {"kinetic": kinetic, "potential": sum(parts.values()) - kinetic, "energy": sum(parts.values()),
                "work": self.state.work}

    def momentum(self) -> float:
        """Angular momentum about the vertical through the origin."""
        mech, pose = self.mech, self.pose
        total = np.zeros(3)
        for k in range(mech.n):
            total += mech.mass[k] * np.cross(pose.x[k], pose.v[k])
            total += pose.R[k] @ mech.J[k] @ pose.R[k].T @ pose.w[k]
        return float(-mech.g @ total / np.linalg.norm(mech.g))

    def states(self) -> dict[str, np.ndarray]:
        pose, n = self.pose, self.mech.n
        turned = np.einsum("nji,nj->ni", pose.R[:n], pose.w[:n])
        return {"x": pose.x[:n], "R": pose.R[:n], "v": pose.v[:n], "w": turned}

    def accelerations(self) -> dict[str, np.ndarray]:
        pose, n = self.pose, self.mech.n
        return {"a": pose.a[0, :n], "alpha": np.einsum("nji,nj->ni", pose.R[:n], pose.alpha[0, :n])}

    def joints(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        return {link.name: (self.state.p[link.place], self.state.u[link.rates]) for link in self.mech.links
                if link.kind not in ("fixed", "free")}

    def read(self, sensor: dict[str, Any]) -> np.ndarray:
        """The value of a sensor."""
        mech, pose, kind = self.mech, self.pose, sensor["type"]
        if kind.startswith("joint_"):
            link = mech.named(sensor["joint"])
            return np.array({"joint_position": self.state.p[link.place], "joint_velocity": self.state.u[link.rates],
                             "joint_acceleration": self.du[link.rates],
                             "joint_effort": self.supplied[link.rates]}[kind])
        site = next(site for site in mech.data["sites"] if site["name"] == sensor["site"])
        body = mech.index(site["body"])
        axes = pose.R[body] @ matrix(site.get("attitude", (1.0, 0.0, 0.0, 0.0)))
        s, w, alpha = pose.R[body] @ np.array(site["position"]), pose.w[body], pose.alpha[0, body]
        if kind == "attitude":
            return quaternion(axes)
        if kind in ("force", "torque"):
            number = next(k for k, link in enumerate(mech.links) if link.name == sensor["joint"])
            force, about = self.wrench[0][number], self.wrench[1][number]
            value = force if kind == "force" else about + np.cross(pose.anchors[number] - pose.x[body] - s, force)
        else:
            a = pose.a[0, body] + np.cross(alpha, s) + np.cross(w, np.cross(w, s))
            value = {"position": pose.x[body] + s, "velocity": pose.v[body] + np.cross(w, s), "acceleration": a,
                     "accelerometer": a - mech.g, "angular_velocity": w, "gyroscope": w,
                     "angular_acceleration": alpha}[kind]
        own = kind in ("accelerometer", "gyroscope", "force", "torque")
        return axes.T @ value if sensor.get("frame", "site" if own else "world") == "site" else value


def inverse_dynamics(mech: Mechanism, p: np.ndarray, u: np.ndarray, du: np.ndarray) -> np.ndarray:
    """Efforts that are to be supplied for a motion; given torques and servos do not act."""
    M, h, _ = mech.system(p, u, 0.0)
    mode = {k: int(np.sign(u[k])) for k in mech.friction}
    tau, _, _, _ = mech.along(mech.scalars(p), u, 0.0, mode, mech.sampled(p, u, 0.0))
    return M @ du + h - tau


def moved(mech: Mechanism, p: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Coordinates after a small step (dofs,): a turn in its own axes of a ball."""
    out = p.copy()
    for link in mech.links:
        d = step[link.rates]
        if link.kind in ("spherical", "free"):
            w, r = p[link.place][-4:], d[-3:]
            size = np.linalg.norm(r)
            e = np.array([np.cos(size / 2), *(0.5 * np.sinc(size / 2 / np.pi) * r)])
            product = [w[0] * e[0] - w[1:] @ e[1:], *(w[0] * e[1:] + e[0] * w[1:] + np.cross(w[1:], e[1:]))]
            out[link.place] = [*(p[link.place][:-4] + d[:-3]), *product]
        else:
            out[link.place] = p[link.place] + d
    return out


def apart(mech: Mechanism, p: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The small step from the second coordinates to the first."""
    out = np.zeros(mech.dofs)
    for link in mech.links:
        a, b = p[link.place], other[link.place]
        if link.kind in ("spherical", "free"):
            q, r = a[-4:] / np.linalg.norm(a[-4:]), b[-4:] / np.linalg.norm(b[-4:])
            w, vector = r @ q, r[0] * q[1:] - q[0] * r[1:] - np.cross(r[1:], q[1:])
            size = np.linalg.norm(vector)
            turned = 2 * np.arctan2(size, abs(w)) * np.sign(w) * vector / size if size else 0 * vector
            out[link.rates] = [*(a[:-4] - b[:-4]), *turned]
        else:
            out[link.rates] = a - b
    return out


def slope(function: Any, h: float) -> np.ndarray:
    """The derivative at 0 by the central difference of order six."""
    return sum(c * (function(k * h) - function(-k * h)) for k, c in ((1, 45.0), (2, -9.0), (3, 1.0))) / (60 * h)


def derivatives(mech: Mechanism, p: np.ndarray, u: np.ndarray, mode: dict[int, Any]) -> dict[str, np.ndarray]:
    """da/dq at fixed rates, da/dv, da/dtau."""
    eye, h = np.eye(mech.dofs), 2e-3

    def a(dq: np.ndarray, dv: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return mech.accelerations(moved(mech, p, dq), u + dv, 0.0, mode, None, tau)[0]

    zero = np.zeros(mech.dofs)
    return {"da_dq": np.stack([slope(lambda e, d=d: a(e * d, zero, zero), h) for d in eye], axis=1),
            "da_dv": np.stack([slope(lambda e, d=d: a(zero, e * d, zero), h) for d in eye], axis=1),
            "da_dtau": np.stack([slope(lambda e, d=d: a(zero, zero, e * d), 1.0) for d in eye], axis=1)}

