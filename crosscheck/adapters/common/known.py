"""The known defects of all engines, from known.toml beside this package, and the rules of where they show."""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Callable, Mapping
from types import MappingProxyType

import msgspec
import numpy as np

from crosscheck.adapters.base import Engine
from crosscheck.document import Record
from crosscheck.document.known import Known
from crosscheck.scene.model import Scene

FILE = pathlib.Path(__file__).parents[1] / "known.toml"
"""The table of known defects."""

CONING = 0.1
"""Size of w x dw/dt over the largest |w| |dw/dt| of a body above which an axis of rotation moves for sure."""


@functools.lru_cache(maxsize=64)
def scene_of(name: str) -> Scene | None:
    """The scene of a name or path; None where there is none, so that nothing is known about it."""
    from crosscheck.errors import ArgumentError, SceneError
    from crosscheck.scene.file import as_scene

    try:
        return as_scene(name)
    except (ArgumentError, SceneError):
        return None


def _bounces(engine: Engine, scene: Scene, form: str | None) -> bool:
    from crosscheck.adapters.common import open_tree

    return open_tree.bouncing(scene) is not None


def _softly_joined(engine: Engine, scene: Scene, form: str | None) -> bool:
    """Whether MuJoCo closes joints of a scene by soft ones: loops and mimics, or all of them."""
    from crosscheck.scene.spanning import spanning_tree

    return (form == "maximal" or bool(spanning_tree(scene)[1])
            or any(joint.mimic is not None for joint in scene.joints))


def naive(engine: Engine, scene: Scene, form: str | None) -> str:
    """Whether summed joint velocities show on a scene.

    "no": no joint of the model turns on SO(3); "surely": the axis of rotation of such a body moves from the start;
    "maybe": turns about one axis add up.
    """
    from crosscheck.scene import mechanics

    turning = list(engine.turning(scene, form))
    if not turning:
        return "no"
    _, alpha, _ = mechanics.index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
    w, alpha = scene.w0[turning], alpha[0, turning]
    speeds = np.linalg.norm(w, axis=1)
    sizes = speeds * np.linalg.norm(alpha, axis=1)
    # The direction of what rests, or does not accelerate, is rounding.
    least = max(CONING * sizes.max(), 1e-9 * speeds.max() ** 3)
    return "surely" if np.linalg.norm(np.cross(w, alpha), axis=1).max() > least else "maybe"


WHERE: Mapping[str, Callable[[Engine, Scene, str | None], bool]] = MappingProxyType({
    "a ball whose axis of rotation moves": lambda engine, scene, form: naive(engine, scene, form) == "surely",
    "a ball": lambda engine, scene, form: naive(engine, scene, form) == "maybe",
    "balls": lambda engine, scene, form: any(joint.kind.is_ball for joint in scene.joints),
    "a stop with restitution": _bounces, "joints closed softly": _softly_joined})
"""What a scene has that shows a defect."""


@functools.cache
def table() -> tuple[Known, ...]:
    """All known defects."""

    class Table(msgspec.Struct, forbid_unknown_fields=True):
        defect: tuple[Known, ...]

    return msgspec.toml.decode(FILE.read_bytes(), type=Table).defect


def of_sensors(entry: Known, scene: Scene | None) -> Known:
    """The entry with the names of the scene's sensors in place of "KIND sensor: TYPE FRAME"."""
    rows = dict[str, float]()
    for kind, size in entry.rows.items():
        about, _, meant = kind.partition(" sensor: ")
        rows |= {f"{about} sensor {sensor.name}": size for sensor in (scene.sensors if scene else ())
                 if meant == f"{sensor.type} {sensor.frame}"} if meant else {kind: size}
    return msgspec.structs.replace(entry, rows=rows)


def defects(engine: Engine, run: Record) -> tuple[Known, ...]:
    """The known defects of an engine that are about a run."""
    def shows(entry: Known) -> bool:
        scene = scene_of(run.scene) if entry.where else None
        return not entry.where or (scene is not None and WHERE[entry.where](engine, scene, run.form))

    about = (entry for entry in table()
             if entry.engine == run.engine.partition("==")[0] and run.method in entry.methods
             and any(f"{run.version}.".startswith(f"{version}.") for version in entry.versions)
             and (not entry.forms or run.form in entry.forms)
             and (not entry.scenes or run.scene in entry.scenes) and shows(entry))
    return tuple(entry for each in about if (entry := of_sensors(each, scene_of(run.scene))).rows)
