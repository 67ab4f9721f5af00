"""A planar ladder of n loops: microseconds a step against n.

Two rails of n links hang from hinges on the ground, and a rung joins them at every level: n loops of four bars, with
three bodies, one degree of freedom and three rows too many each. Prints the wall time of a step and its exponent.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

import lieeuler
from lieeuler.types import GROUND

METHODS = ("DAE1L_LSE", "DAE1H_LSE", "rattle2", "rkmk4", "taylor")
SIZES = (5, 10, 20, 40, 80, 160)
LINK, RUNG, STEP, RTOL = 0.5, 0.6, 1e-3, 1e-9  # m, m, s
Y = (0.0, 1.0, 0.0)


def ladder(loops: int) -> lieeuler.Problem:
    """The ladder at rest, with levels that lean to alternate sides."""
    angles = 0.4 * np.sin(np.arange(1, loops + 1))
    R_rail = [np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]) for a in angles]
    bodies, joints, x, R = [], [], [], []

    def add(position: np.ndarray, attitude: np.ndarray, length: float, upright: bool) -> int:
        across, along = length**2 / 12, 1e-3
        moments = (across, across, along) if upright else (along, across, across)
        bodies.append(lieeuler.Body(1.0, np.diag(moments)))
        x.append(position), R.append(attitude)
        return len(bodies) - 1

    up, down, half = np.array([0, 0, LINK / 2]), np.array([0, 0, -LINK / 2]), np.array([RUNG / 2, 0, 0])
    nodes = [np.zeros(3), np.array([RUNG, 0, 0])]
    above = [(GROUND, nodes[0]), (GROUND, nodes[1])]
    for level in range(loops):
        rails = []
        for side in range(2):
            rail = add(nodes[side] - R_rail[level] @ up, R_rail[level], LINK, upright=True)
            parent, anchor = above[side]
            joints.append(lieeuler.revolute_joint(parent, rail, anchor, up, Y, Y))
            nodes[side] = nodes[side] + R_rail[level] @ (down - up)
            above[side] = rail, down
            rails.append(rail)
        rung = add((nodes[0] + nodes[1]) / 2, np.eye(3), RUNG, upright=False)
        joints.append(lieeuler.revolute_joint(rails[0], rung, down, -half, Y, Y))
        joints.append(lieeuler.revolute_joint(rails[1], rung, down, half, Y, Y))
    still = np.zeros((len(bodies), 3))
    return lieeuler.Problem(bodies, joints, [0, 0, -9.81], np.array(x), np.array(R), still, still)


def us_per_step(problem: lieeuler.Problem, method: str, steps: int, rounds: int) -> float:
    """Wall time of a step, less what the start of a run costs; the least of all rounds, since other work only adds."""
    def run(count: int) -> tuple[float, int]:
        control = {"rtol": RTOL} if method == "taylor" else {"step": STEP}
        run = lieeuler.prepare(problem, method, t_eval=[0, count * STEP], monitor=False, **control)
        stats = [run().stats for _ in range(rounds)]
        return min(each.wall_time for each in stats), stats[0].steps

    scale = 25 if method == "taylor" else 1  # its steps are longer; the ladder locks at 1.3 s
    (few, short), (many, long) = run(steps // 4 * scale), run(steps * scale)
    return 1e6 * (many - few) / max(1, long - short)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ladder", description=__doc__.splitlines()[0])
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--steps", type=int, default=40, help="of a run")
    options = parser.parse_args(arguments)
    print(f"{'us a step':12}" + "".join(f"{n:>10}" for n in options.sizes) + "  exponent")
    for method in options.methods:
        costs = [us_per_step(ladder(n), method, options.steps, options.rounds) for n in options.sizes]
        slope = np.polyfit(np.log(options.sizes), np.log(costs), 1)[0]
        print(f"{method:12}" + "".join(f"{cost:10.0f}" for cost in costs) + f"{slope:10.2f}", flush=True)


if __name__ == "__main__":
    main()
