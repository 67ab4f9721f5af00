"""The built-in scenes, one per joint and force: the eight methods converge to independent truth at order one."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
from lieeuler import EULER_METHODS

SCENES = ("single_pendulum", "universal_pendulum", "hinge_pendulum", "cylindrical_pendulum", "prismatic_slider",
          "planar_slider", "fixed_pair", "rod_pendulum", "bead_on_line", "puck_on_plane", "spring_pendulum",
          "damped_pendulum", "torsion_wheel", "loaded_pendulum", "slider_crank", "branching_tree")
STEPS = np.array([1e-3, 5e-4, 2.5e-4])
WINDOW = 0.5  # s
FINER = {"slider_crank": 4}  # its crank is fast: the asymptotic range begins later


LAGRANGE, HAMILTON = EULER_METHODS[:4], EULER_METHODS[4:]
CASES = [(name, methods[(place + place // 4 * shift) % 4])
         for place, name in enumerate(SCENES) for shift, methods in enumerate((LAGRANGE, HAMILTON))]
"""One method of each family on every scene, each method on four; test_lieeuler.py has all pairs of method and joint."""


@pytest.mark.parametrize(("name", "method"), CASES)
def test_first_order_against_truth(name, method, crosscheck_truth):
    scene = crosscheck.load_scene(name)
    count = max(2, int(np.searchsorted(scene.t, WINDOW)))
    scene = scene.replace(duration=float(scene.t[count]), samples=count + 1)
    states = crosscheck_truth(scene).states
    errors = {"x": [], "R": [], "v": [], "w": []}
    for step in STEPS / FINER.get(name, 1):
        traj = crosscheck.run(scene, "lieeuler", method, step=step, monitor=False)
        for quantity, found in errors.items():
            found.append(np.abs(getattr(traj, quantity) - getattr(states, quantity)).max())
    orders = {}
    for quantity, found in errors.items():
        if max(found) < 1e-12:  # the scene does not change this quantity, or the method computes it exactly
            continue
        orders[quantity] = np.polyfit(np.log(STEPS), np.log(found), 1)[0]
    assert min(orders.values()) > 0.9, orders  # symmetry may cancel the first-order term of one quantity
    assert sum(order < 1.1 for order in orders.values()) >= 2, orders
