"""An engine for `crosscheck verify`: methods of lieeuler on a scene with one mistake of a given size.

A method is named after that of lieeuler, the mistake, its size, and the part of the run after which it begins:
"DAE1L_LSE gravity 0.001 0.5". A number of the scene is larger by a share; "interval" is gravity in one interval between
outputs alone; "drag" is what bodies lose of their velocities from output to output.
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
MISTAKES = (*((number, begin) for number in NUMBERS for begin in (0.0, 0.5)), ("drag", 0.5), ("interval", 0.5))
"""Each with the part of the run after which it begins."""


def altered(scene: Any, number: str, share: float) -> Any:
    """The scene with gravity, or the mass or the inertia of every body, larger by a share."""
    if number in ("gravity", "interval"):
        return scene.replace(gravity=np.asarray(scene.gravity) * (1 + share))
    bodies = tuple(dataclasses.replace(body, **{number: np.asarray(getattr(body, number)) * (1 + share)})
                   for body in scene.bodies)
    return scene.replace(bodies=bodies)


class Altered:
    """See the module."""

    name = "altered"
    elements = ("armature", "mimic", "drive", "dry_friction", "static_friction", "limits", "soft_limits")
    methods = tuple(f"{method} {number} {share} {begin}" for method, share, (number, begin) in itertools.product(
        ORDERS, (0.0, *SHARES), MISTAKES))

    def documented_order(self, scene: Any, spec: Any) -> int:
        """That of the method of lieeuler."""
        return ORDERS[spec.method.split()[0]]

    def unsupported(self, scene: Any, spec: Any) -> str | None:
        """Takes any scene."""
        return None

    def run(self, scene: Any, spec: Any) -> Any:
        """The right run up to the time, and the wrong one from its state there."""
        method, number, share, begin = spec.method.split()
        count, size = scene.samples - 1, float(share)
        first, interval = round(float(begin) * count), scene.duration / count
        cuts = sorted({0, first, count} | ({first + 1} if number == "interval" else set()) | (
            set(range(first, count)) if number == "drag" else set()))
        parts, now = list[Any](), scene
        for begun, end in itertools.pairwise(cuts):
            wrong = begun >= first and number != "drag" and (number != "interval" or begun == first)
            part = (altered(now, number, size) if wrong else now).replace(
                duration=(end - begun) * interval, samples=end - begun + 1)
            found = crosscheck.run(part, "lieeuler", method, step=spec.step, monitor=False)
            if number == "drag" and begun >= first:
                found = dataclasses.replace(found, v=(1 - size) * found.v, w=(1 - size) * found.w)
            parts.append(found)
            if end < count:
                now = restarted(now, found, end - begun, (count - end) * interval, count - end + 1)
        return crosscheck.States(scene.t, *(np.concatenate([getattr(parts[0], name), *(
            getattr(part, name)[1:] for part in parts[1:])]) for name in "xRvw"))
