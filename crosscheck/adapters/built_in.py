"""The engines that come with crosscheck, by name: the module of each adapter and the package it needs."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util

from crosscheck.adapters.base import Engine


@dataclasses.dataclass(frozen=True)
class Entry:
    """The place of an adapter."""

    module: str
    adapter: str
    needs: str | None = None  # the module of an optional engine, from the extras [drake] and [dart]
    package: str = ""  # the package for a chosen version, as in "mujoco==3.3.7"; "" if none can be chosen

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
}


def listed() -> tuple[str, ...]:
    """Names of the entries whose engine is not optional, or is installed."""
    return tuple(name for name, entry in ENTRIES.items()
                 if entry.needs is None or importlib.util.find_spec(entry.needs) is not None)
