"""The motion of a mechanism of `mechanics`, in the coordinates of its joints, from one event to the next."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from tests.oracle_values.links import matrix, quaternion, rate_of
from tests.oracle_values.mechanics import Mechanism

HELD = ("stick", "lower", "upper")
RTOL = 1e-11


@dataclass
class Instant:
    """The state at a time: numbers that place the joints, rates, work since the start, modes of laws, held efforts."""

    t: float
    p: np.ndarray
    u: np.ndarray
    work: float
    mode: dict[int, Any] = field(default_factory=dict)
    samples: dict[int, list[float]] = field(default_factory=dict)


def start(mech: Mechanism) -> Instant:
    """The start of the file: coordinates of joints; states of bodies that nothing holds."""
    p, u = np.zeros(mech.places), np.zeros(mech.dofs)
    for link in mech.links:
        if link.kind == "free":
            body = mech.data["bodies"][link.child]
            R = matrix(body.get("attitude", (1.0, 0.0, 0.0, 0.0)))
            p[link.place] = [*body.get("position", (0.0, 0.0, 0.0)), *quaternion(R)]
            u[link.rates] = [*body.get("velocity", (0.0, 0.0, 0.0)), *body.get("angular_velocity", (0.0, 0.0, 0.0))]
        elif "position" in link.entry:
            rest = (1.0, 0.0, 0.0, 0.0) if link.kind == "spherical" else 0.0
            p[link.place], u[link.rates] = link.entry.get("position", rest), link.entry.get("velocity", 0.0)
            if link.kind == "spherical":
                p[link.place] /= np.linalg.norm(p[link.place])
    placed = mech.pose(p, u)
    for link in mech.links:  # given by the bodies: hinges at the ends of the tree
        if link.kind == "revolute" and not {"position", "drive", "mimic"} & set(link.entry):
            far = link.parent if link.turned else link.child
            body = mech.data["bodies"][far]
            R, w = placed.R.copy(), placed.w.copy()
            R[far] = matrix(body["attitude"])
            w[far] = R[far] @ body["angular_velocity"]
            Q = R[link.parent].T @ R[link.child] @ link.zero.T
            across = np.array([Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]])
            p[link.place] = np.arctan2(link.axis @ across, np.trace(Q) - 1)
            u[link.rates] = link.axis @ R[link.parent].T @ (w[link.child] - w[link.parent])
    q, rate, _ = mech.given(0.0)
    for k in mech.drives:
        p[mech.place_of[k]], u[k] = q[k], rate[k]
    for k, (leader, ratio, offset) in mech.follows.items():
        p[mech.place_of[k]], u[k] = ratio * p[mech.place_of[leader]] + offset, ratio * u[leader]
    state = Instant(0.0, p, u, 0.0)
    return Instant(0.0, p, u, 0.0, modes(mech, state), mech.sampled(p, u, 0.0))


def modes(mech: Mechanism, state: Instant) -> dict[int, Any]:
    """What each law does at the start: slip against its rate, stick, rest on a stop."""
    mode: dict[int, Any] = {}
    q = mech.scalars(state.p)
    for k in mech.friction:
        mode[k] = int(np.sign(state.u[k])) or "stick"
    for k, stop in mech.limits.items():
        for side in ("lower", "upper"):
            if "stiffness" not in stop and side in stop and q[k] == stop[side] and state.u[k] == 0:
                mode[k] = side
    return mode


def breaks(mech: Mechanism, end: float) -> list[float]:
    """Times at which a function of time or a held effort changes its piece."""
    times: set[float] = set()

    def collect(entry: Any) -> None:
        if isinstance(entry, dict):
            times.update(entry.get("times", ()))
            for value in entry.values():
                collect(value)
        elif isinstance(entry, list):
            for value in entry:
                collect(value)

    collect([mech.forces, [link.entry for link in mech.links]])
    for _, _, servo in mech.servos:
        if "period" in servo:
            times.update(servo["period"] * np.arange(1, round(end / servo["period"]) + 1))
    return sorted(t for t in times if 0 < t < end)


def derivative(mech: Mechanism, t: float, y: np.ndarray, state: Instant) -> np.ndarray:
    """d(p, u, work)/dt."""
    p, u = y[:mech.places], y[mech.places:-1]
    du, _, power = mech.accelerations(p, u, t, state.mode, state.samples)
    dp = np.zeros(mech.places)
    for link in mech.links:
        rate = u[link.rates]
        if link.kind in ("spherical", "free"):
            dp[link.place] = [*rate[:-3], *rate_of(p[link.place][-4:], rate[-3:])]
        else:
            dp[link.place] = rate
    return np.array([*dp, *du, power])


def surfaces(mech: Mechanism, state: Instant) -> list[Any]:
    """Functions whose zeros end a piece, each with what to do there."""
    def added(t: float, y: np.ndarray, k: int) -> float:
        return float(mech.accelerations(y[:mech.places], y[mech.places:-1], t, state.mode, state.samples)[1][k])

    found: list[Any] = []
    for k, mode in state.mode.items():
        if mode in (1, -1):
            found.append((lambda t, y, k=k: y[mech.places + k], -mode, k, "rest"))
        elif mode == "stick":
            most = mech.friction[k][1]
            found.append((lambda t, y, k=k, most=most: most - abs(added(t, y, k)), -1, k, "loose"))
        elif mode in ("lower", "upper"):
            found.append((lambda t, y, k=k: added(t, y, k), -1 if mode == "lower" else 1, k, "leave"))
    for k, stop in mech.limits.items():
        for side, sign in (("lower", -1), ("upper", 1)):
            if side in stop and state.mode.get(k) not in ("lower", "upper"):
                at, gap = stop[side], abs(mech.scalars(state.p)[k] - stop[side])
                ways = (sign,) if "stiffness" not in stop else (-1, 1)
                found += [(lambda t, y, k=k, at=at: y[mech.place_of[k]] - at, way, k,
                           side if "stiffness" not in stop else "kink")
                          for way in ways if gap > 1e-9 or way * state.u[k] < 0]
    return found


def react(mech: Mechanism, state: Instant, k: int, what: str) -> None:
    """The state after an event of one coordinate."""
    if what == "rest":
        state.u[k], state.mode[k] = 0.0, "stick"
        _, added, _ = mech.accelerations(state.p, state.u, state.t, state.mode, state.samples)
        if abs(added[k]) > mech.friction[k][1]:
            state.mode[k] = -int(np.sign(added[k]))
    elif what == "loose":
        _, added, _ = mech.accelerations(state.p, state.u, state.t, state.mode, state.samples)
        state.mode[k] = -int(np.sign(added[k]))
    elif what == "leave":
        state.mode.pop(k)
    elif what in ("lower", "upper"):
        stop = mech.limits[k]
        M = mech.system(state.p, state.u, state.t)[0]
        free = [i for i in range(mech.dofs) if state.mode.get(i) not in HELD]
        kick = np.linalg.solve(M[np.ix_(free, free)], np.eye(len(free))[free.index(k)])
        restitution = stop.get("restitution", 0.0)
        state.u[free] -= (1 + restitution) * state.u[k] / kick[free.index(k)] * kick
        if restitution == 0.0:
            state.u[k], state.mode[k] = 0.0, what


def advance(mech: Mechanism, state: Instant, until: float, rtol: float) -> Instant:
    """One smooth stretch, with the events in it."""
    while state.t < until:
        found = surfaces(mech, state)
        events = []
        for function, direction, _, _ in found:
            def event(t: float, y: np.ndarray, function: Any = function) -> float:
                return float(function(t, y))

            event.terminal, event.direction = True, direction  # type: ignore[attr-defined]
            events.append(event)
        y = np.array([*state.p, *state.u, state.work])
        run = solve_ivp(lambda t, y, at=state: derivative(mech, t, y, at), (state.t, until), y, method="DOP853",
                        rtol=rtol, atol=0.1 * rtol, events=events or None)
        assert run.success, run.message
        end = run.y[:, -1]
        state = Instant(run.t[-1], end[:mech.places].copy(), end[mech.places:-1].copy(), float(end[-1]),
                        dict(state.mode), {k: list(v) for k, v in state.samples.items()})
        for (_, _, k, what), times in zip(found, run.t_events or [], strict=False):
            if len(times):
                react(mech, state, k, what)
    return state


def motion(mech: Mechanism, times: np.ndarray, first: Instant | None = None, rtol: float = RTOL) -> list[Instant]:
    """The states at times, the first of which is that of the start."""
    state = first or start(mech)
    out, cuts = [state], sorted({*breaks(mech, times[-1]), *times[1:]})
    for until in cuts:
        if until <= state.t:
            continue
        state = advance(mech, state, until, rtol)
        for number, (_, k, servo) in enumerate(mech.servos):
            if "period" in servo and abs(until / servo["period"] - round(until / servo["period"])) < 1e-9:
                value = mech.servo(servo, mech.scalars(state.p)[k], state.u[k], until)
                state.samples[number] = [*state.samples[number], value][1:]
        if until in times:
            out.append(state)
    return out
