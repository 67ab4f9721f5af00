"""The main job: every method and engine over the scenes, judged and timed. And `crosscheck.run`, with its verdict."""

from __future__ import annotations

import dataclasses
import functools
import os
from typing import Any

from crosscheck.adapters.base import ENGINE_OPTIONS, Engine
from crosscheck.document import Record, Way
from crosscheck.running import run as running
from crosscheck.running.trajectory import Trajectory
from crosscheck.scene.model import Scene


@functools.wraps(running.run)
def run(scene: Scene | str | os.PathLike[str], engine: str | Engine, method: str, step: float | None = None,
        rtol: float | None = None, **options: Any) -> Trajectory:
    """See `running.run`; what judges stands above what runs, and is handed to the trajectory here."""
    traj = running.run(scene, engine, method, step, rtol, **options)
    if not isinstance(engine, str):
        return traj
    more = {key: value for key, value in options.items() if key in ENGINE_OPTIONS}
    return dataclasses.replace(traj, judge=functools.partial(_judged, Way.of(engine, method, step, rtol, **more)))


def _judged(way: Way, traj: Trajectory, name: str, need: float) -> Record | None:
    from crosscheck.verification.cell import judge_alone  # a third of a second, for those who ask

    return judge_alone(name, traj, traj.engine, need=need, **way.arguments)
