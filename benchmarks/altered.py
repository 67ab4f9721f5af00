"""An engine for `crosscheck verify`: methods of lieeuler on a scene with one wrong number, from the start or late.

Its methods are named after the method, the number, the share by which that is wrong, and the part of the run after
which it is: "DAE1L_LSE gravity 0.001 0.5".
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

import crosscheck

try:
    from crosscheck.scene.states import States
except ImportError:  # in versions before the rooms
    from crosscheck.states import States  # type: ignore[import-not-found,no-redef]

ORDERS = {"DAE1L_LSE": 1, "rattle2": 2, "rkmk4": 4}
SHARES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
NUMBERS = ("gravity", "mass", "inertia")
BEGINS = (0.0, 0.5)


def altered(scene: Any, number: str, share: float) -> Any:
    """The scene with gravity, or the mass or the inertia of every body, larger by a share."""
    if number == "gravity":
        return dataclasses.replace(scene, gravity=np.asarray(scene.gravity) * (1 + share))
    bodies = tuple(dataclasses.replace(body, **{number: np.asarray(getattr(body, number)) * (1 + share)})
                   for body in scene.bodies)
    return dataclasses.replace(scene, bodies=bodies)


class Altered:
    """See the module."""

    name = "altered"
    methods = tuple(" ".join(map(str, each)) for each in itertools.product(ORDERS, NUMBERS, (0.0, *SHARES), BEGINS))

    def documented_order(self, scene: Any, spec: Any) -> int:
        """That of the method of lieeuler."""
        return ORDERS[spec.method.split()[0]]

    def unsupported(self, scene: Any, spec: Any) -> str | None:
        """Takes any scene."""
        return None

    def run(self, scene: Any, spec: Any) -> Any:
        """The right run up to the time, and the wrong one from its state there."""
        method, number, share, begin = spec.method.split()
        wrong = altered(scene, number, float(share))
        last = round(float(begin) * (scene.samples - 1))
        parts, state = [], scene
        for each, count in ((scene, last), (wrong, scene.samples - 1 - last)):
            if count:
                bodies = tuple(dataclasses.replace(body, position=now.position, attitude=now.attitude,
                                                   velocity=now.velocity, angular_velocity=now.angular_velocity)
                               for body, now in zip(each.bodies, state.bodies, strict=True))
                some = dataclasses.replace(each, bodies=bodies, samples=count + 1,
                                           duration=scene.duration * count / (scene.samples - 1))
                traj = crosscheck.run(some, "lieeuler", method, step=spec.step, monitor=False)
                parts.append(traj)
                state = _at_end(scene, traj)
        keep = [slice(None), slice(1, None)]
        return States(scene.t, *(np.concatenate([getattr(part, name)[pick] for part, pick in
                                                 zip(parts, keep, strict=False)]) for name in "xRvw"))


def _at_end(scene: Any, traj: Any) -> Any:
    """The scene with the last state of a run."""
    from scipy.spatial.transform import Rotation

    bodies = []
    for index, body in enumerate(scene.bodies):
        x, y, z, w = Rotation.from_matrix(traj.R[-1, index]).as_quat()
        bodies.append(dataclasses.replace(body, position=traj.x[-1, index], attitude=np.array([w, x, y, z]),
                                          velocity=traj.v[-1, index], angular_velocity=traj.w[-1, index]))
    return dataclasses.replace(scene, bodies=tuple(bodies))
