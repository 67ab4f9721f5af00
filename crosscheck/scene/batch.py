"""The true flow over many intervals at once: the index-1 equations in maximal coordinates, by a method of order 8."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crosscheck.errors import check_time
from crosscheck.scene import mechanics
from crosscheck.scene.coordinates import hinge_angles, starting
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from crosscheck.scene.vectors import hat

TURN = 0.1
"""Turn (rad) of the fastest motion in one step of the integration. With order 8 the error stays below 1e-12."""

State = list[np.ndarray]
"""x, R, v, w of all intervals."""


Nodes = list[tuple[np.ndarray, np.ndarray, np.ndarray]]


def integrate(scene: Scene, begin: States, tau: np.ndarray, count: int, parts: int | None = None
              ) -> tuple[States, Nodes, np.ndarray]:
    """The states at the ends; a, R'' and alpha at the ends of `parts` equal parts, by default of all steps; the largest
    angular speed there (I,) in rad/s.

    Ends are met by `count` steps from break to break of functions of time; nodes lie across them.
    """
    end, nodes, fast = _integrated(scene, begin, tau, np.full(len(tau), np.inf), count, parts)
    until, now = begin.t + tau, begin
    times = np.array(scene.knots)
    first = np.searchsorted(times, begin.t, side="right")
    last = np.searchsorted(times, until, side="right")
    rounds = int((last - first).max(initial=0))
    for k in range(rounds + 1 if rounds else 0):
        cut = first + k < last
        stop = np.where(cut, times[np.minimum(first + k, len(times) - 1)], until)
        length = stop - now.t
        now = _integrated(scene, now, length, np.where(cut, np.nextafter(stop, -np.inf), np.inf), count, 1)[0]
        now.t = stop
        end = now
    return end, nodes, fast


def _integrated(scene: Scene, begin: States, tau: np.ndarray, latest: np.ndarray, count: int, parts: int | None
                ) -> tuple[States, Nodes, np.ndarray]:
    """As `integrate`, with the functions of time as they are up to the times `latest`.

    `count` steps of Dormand and Prince's method of order 8, between which its polynomials of degree 7 are taken.
    Attitudes are matrices, which stay orthogonal as far as the method is exact. Source: E. Hairer, S. P. Norsett, G.
    Wanner, Solving Ordinary Differential Equations I, II.5 and II.6.
    """
    from scipy.integrate import DOP853

    # In an interval that turns little, what combinations of rows are redundant changes little.
    combined = mechanics.Index1(scene).independent(begin.x, begin.R) if count * TURN <= 1.0 else None
    hinges = np.tile(hinge_angles(scene, starting(scene)), (len(tau), 1)) if begin.hinges is None else (
        begin.hinges.copy())
    rates, each = rates_of(scene, combined, hinges), tau[:, None, None]
    span = np.where(tau > 0.0, tau, 1.0)[:, None]  # what is at its end already stays there
    nodes, fast, grid = [], np.zeros(len(tau)), np.linspace(0.0, 1.0, (parts or count) + 1).tolist()

    def states(y: np.ndarray) -> State:
        x, R, v, w = np.split(y.reshape(len(tau), scene.n, 18), (3, 12, 15), axis=-1)
        return [x, R.reshape(*R.shape[:2], 3, 3), v, w]

    def flat(state: State) -> np.ndarray:
        return np.concatenate([part.reshape(len(tau), scene.n, -1) for part in state], axis=-1)

    def slope(share: float, y: np.ndarray) -> np.ndarray:
        check_time()
        return np.asarray((each * flat(rates(np.minimum(begin.t + share * tau, latest), *states(y)))).ravel())

    def keep(y: np.ndarray, dy: np.ndarray) -> None:
        (_, R, _, w), (_, dR, a, alpha) = states(y), states((dy.reshape(len(tau), -1) / span).ravel())
        nodes.append((a, dR @ hat(w) + R @ hat(alpha), alpha))
        np.maximum(fast, np.linalg.norm(w, axis=-1).max(axis=-1), out=fast)

    step, begun = min(1.0, (1.0 + 1e-12) / count), flat([begin.x, begin.R, begin.v, begin.w]).ravel()
    solver = DOP853(slope, 0.0, begun, 1.0, max_step=step, first_step=step, rtol=1.0, atol=1e300)  # of any error
    keep(solver.y, solver.f)
    while len(nodes) < len(grid):
        solver.step()
        within = None
        for share in grid[len(nodes):]:
            if abs(share - solver.t) < 1e-9:
                keep(solver.y, solver.f)
            elif share < solver.t:
                within = within or solver.dense_output()
                keep(within(share), slope(share, within(share)))
    return States(begin.t + tau, *states(solver.y), hinges=hinges), nodes, fast


def rates_of(scene: Scene, combined: np.ndarray | None = None, hinges: np.ndarray | None = None
             ) -> Callable[..., State]:
    """(t, x, R, v, w) -> the rates of x, R, v, w by the index-1 equations; `combined` is of `mechanics.Index1`.

    Hinges with springs are followed from one call to the next, in `hinges` (T, h), or from the scene's start on.
    """
    index1, last = mechanics.Index1(scene), hinges

    def rates(t: np.ndarray, x: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray) -> State:
        nonlocal last
        if last is None:
            last = np.tile(hinge_angles(scene, starting(scene)), (len(x), 1))
        angles = mechanics.torsion_angles(scene, States(np.broadcast_to(t, len(x)), x, R, v, w, hinges=last))
        for name, values in angles.items():
            joint = scene.joint(name)
            last[:, scene.hinges.index((name, joint.kind.number("angle")))] = values - joint.zero_angle
        a, alpha, _ = index1(x, R, v, w, angles, t, combined=combined)
        return [v, R @ hat(w), a, alpha]

    return rates
