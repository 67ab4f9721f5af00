"""An engine for `crosscheck verify`: methods of lieeuler on a scene with one wrong number, from the start or late.

A method is named after that of lieeuler, the number, the share by which it is wrong, and the part of the run after
which it is wrong: "DAE1L_LSE gravity 0.001 0.5".
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

import crosscheck
from crosscheck.scene.starts import restarted

ORDERS = {"DAE1L_LSE": 1, "rattle2": 2, "rkmk4": 4}
SHARES = tuple(10.0**k for k in range(-10, -1))
NUMBERS = ("gravity", "mass", "inertia")
BEGINS = (0.0, 0.5)


def altered(scene: Any, number: str, share: float) -> Any:
    """The scene with gravity, or the mass or the inertia of every body, larger by a share."""
    if number == "gravity":
        return scene.replace(gravity=np.asarray(scene.gravity) * (1 + share))
    bodies = tuple(dataclasses.replace(body, **{number: np.asarray(getattr(body, number)) * (1 + share)})
                   for body in scene.bodies)
    return scene.replace(bodies=bodies)


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
        count = scene.samples - 1
        last, interval = round(float(begin) * count), scene.duration / count

        def motion(part: Any) -> Any:
            return crosscheck.run(part, "lieeuler", method, step=spec.step, monitor=False)

        wrong = altered(scene, number, float(share))
        if last == 0:
            found = motion(wrong)
            return crosscheck.States(scene.t, found.x, found.R, found.v, found.w)
        right = motion(scene.replace(duration=last * interval, samples=last + 1))
        late = motion(restarted(wrong, right, last, (count - last) * interval, count - last + 1))
        return crosscheck.States(scene.t, *(np.concatenate([getattr(right, name), getattr(late, name)[1:]])
                                            for name in "xRvw"))
