"""The engines that come with crosscheck, by name: where each adapter is, and what has to be installed for it."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util

from crosscheck.adapters.base import Engine


@dataclasses.dataclass(frozen=True)
class Entry:
    """Where an adapter is."""

    module: str
    adapter: str
    needs: str | None = None  # a module of an optional engine, of the extras [drake] and [dart]
    package: str = ""  # that brings a version of its own, "mujoco==3.3.7"; "" where none can be chosen

    def make(self) -> Engine:
        """The adapter; its engine is imported only when it is used."""
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
    """Names of the entries: those without an optional engine, and those whose engine is installed."""
    return tuple(name for name, entry in ENTRIES.items()
                 if entry.needs is None or importlib.util.find_spec(entry.needs) is not None)
