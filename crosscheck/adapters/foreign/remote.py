"""Runs inside the separate environment of an engine, made by `crosscheck.adapters.foreign.versions`.

Only the engine and the packages that its adapter needs are installed there.
"""

from __future__ import annotations

import functools

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine, RunSpec
from crosscheck.adapters.common.native import JointStates, Native
from crosscheck.adapters.foreign.plain import PlainRun, plain
from crosscheck.scene.model import Scene


def version(engine: str) -> str:
    """Version of the engine in its environment."""
    return _adapter(engine).version()


def run(engine: str, scene: Scene, spec: RunSpec) -> PlainRun:
    """The run of the adapter."""
    return plain(_adapter(engine).run(scene, spec))


def native(engine: str, path: str, states: JointStates) -> Native:
    """What the engine's own reader makes of a model file; see `crosscheck.inspection.native`."""
    return _adapter(engine).native(path, states)


@functools.cache
def _adapter(engine: str) -> Engine:
    return built_in.ENTRIES[engine].make()
