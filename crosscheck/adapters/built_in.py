"""The engines that come with crosscheck, by name: the module of each adapter and the package it needs."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util

from crosscheck.adapters.base import Engine
from crosscheck.errors import PINNED


@dataclasses.dataclass(frozen=True)
class Entry:
    """The place of an adapter."""

    module: str
    adapter: str
    needs: str | None = None  # the module of an optional engine, from the extras [drake] and [dart]
    package: str = ""  # packages for a chosen version, as in "mujoco==3.3.7"; "" if none can be chosen
    version: str = ""  # of an engine that has an environment of its own; "" if it shares this one
    extras: str = ""  # further packages there, of any version

    def importable(self) -> bool:
        """Whether the engine is not optional, or is installed here."""
        return self.needs is None or importlib.util.find_spec(self.needs) is not None

    def make(self) -> Engine:
        """The adapter; this does not import its engine yet."""
        made: Engine = getattr(importlib.import_module(self.module), self.adapter)()
        return made


ENTRIES = {
    "lieeuler": Entry("crosscheck.adapters.lieeuler", "LieEuler"),
    "mujoco": Entry("crosscheck.adapters.mujoco.adapter", "MuJoCo", package="mujoco"),
    "pinocchio": Entry("crosscheck.adapters.pinocchio.adapter", "Pinocchio", package="pin"),
    "exudyn": Entry("crosscheck.adapters.exudyn.adapter", "Exudyn", package="exudyn"),
    "drake": Entry("crosscheck.adapters.drake", "Drake", "pydrake"),
    "dart": Entry("crosscheck.adapters.dart", "Dart", "dartpy"),
    "mjx": Entry("crosscheck.adapters.mjx", "MJX", None, "mujoco-mjx mujoco", PINNED["mjx"]),
    "mjx-single": Entry("crosscheck.adapters.mjx", "MJXSingle", None, "mujoco-mjx mujoco", PINNED["mjx-single"]),
    "pybullet": Entry("crosscheck.adapters.pybullet", "PyBullet", None, "pybullet", PINNED["pybullet"]),
    "newton": Entry("crosscheck.adapters.newton", "Newton", None, "newton[sim]", PINNED["newton"],
                    "usd-core newton-usd-schemas"),
    "sapien": Entry("crosscheck.adapters.sapien", "Sapien", None, "sapien", PINNED["sapien"]),
    "warp": Entry("crosscheck.adapters.warp", "Warp", None, "mujoco-warp mujoco", PINNED["warp"]),
}
