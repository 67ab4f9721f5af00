"""Import and export of model files: MJCF and URDF.

MuJoCo's own parser and compiler read a model; a URDF is also checked against Pinocchio if that is installed. Anything
that a scene cannot hold and that would change the motion is refused, or on request dropped and listed in
`Scene.left_out`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from crosscheck.errors import ArgumentError, SceneError
from crosscheck.scene.model import Scene

if TYPE_CHECKING:  # the schema needs msgspec, which the environment of an engine version does not have
    from crosscheck.scene.schema import Content

SUFFIXES = (".xml", ".urdf", ".mjcf", ".xacro", ".sdf", ".world", ".usd", ".usda", ".usdc")
"""Endings of model files; the last six are listed so that they can be refused with a reason."""

LIMITS = {"processor": 45.0, "memory": 4 * 2**30, "time": 900.0}
"""Limits of reading a model: processor time (s), memory (bytes), time (s). Large robots take two seconds and .3 GB."""

T = TypeVar("T")


DURATION = 2.0
"""Time (s) that the scene of a model file lasts if none is given."""


def lasts_by_default(scene: Scene) -> bool:
    """Whether nobody gave the scene's duration: it is that of a model file."""
    return "imported" in scene.tags and scene.duration == DURATION


def is_model(path: object) -> bool:
    """Whether this is the name of a model file."""
    return isinstance(path, str | os.PathLike) and Path(os.fsdecode(path)).suffix.lower() in SUFFIXES


def import_model(path: str | os.PathLike[str], keyframe: str | int | None = None, drop: bool = False,
                 base: Literal["fixed", "free"] = "fixed", qpos: Sequence[float] | None = None,
                 qvel: Sequence[float] | None = None, duration: float = DURATION, samples: int = 101,
                 balance: bool = False, root: str | None = None, actuators: Literal["keep", "drop"] = "keep",
                 controls: Mapping[str, Any] | None = None, limits: Literal["keep", "monitor", "drop"] = "monitor",
                 contacts: Literal["monitor", "drop"] = "monitor", friction: Literal["keep", "drop"] = "keep",
                 start: str | int = "model", within: str | os.PathLike[str] | None = None) -> Scene:
    """An MJCF or URDF file as a scene.

    Parameters
    ----------
    path
        Ends in .xml (MJCF, or URDF if its root element says so) or .urdf.
    keyframe
        Name or number of an MJCF keyframe, which brings qpos, qvel and ctrl.
    drop
        Leave out what a scene cannot hold, actuators and dry friction, and list it in `left_out`. By default such a
        model is refused. Limits and contacts are watched still: the motion is claimed until one would act.
    base
        Whether the base is as the file has it, that of a URDF "fixed" to the world, or "free".
    qpos, qvel
        The start in the coordinates of the compiled MuJoCo model: joints in file order, after the position and
        quaternion w, x, y, z of a free base. Default: the model's reference, at rest.
    duration, samples
        Duration of the scene, s, and number of output times.
    balance
        Replace inertias that no body can have as MuJoCo's `balanceinertia` does, and list it in `left_out`.
    root
        Take only this link of a URDF, or this body in the world of an MJCF, and what hangs on it.
    actuators
        Keep actuators of hinges and slides as servos, with gear and ranges, or drop them.
    controls
        Of actuators by their names or those of their joints: a number, or the table of a function of time, such as
        `{"type": "sine", "terms": [[0.5, 3.0, 0.0]]}`. Default: those of the keyframe, or none.
    limits
        "monitor": the scene claims the motion until a joint leaves its range; "keep": rigid stops; or drop them.
    contacts
        "monitor": it claims the motion until two shapes touch that MuJoCo would let collide; or drop them.
    friction
        Keep dry friction, or drop it.
    start
        "model", "random", or the seed of a random start inside the limits and free of contacts.
    within
        A folder above the model, in which files that it names are read; by default its own. No other file is read.

    Raises
    ------
    SceneError
        The file is wrong, or has elements that a scene cannot hold; the message names all of them.
    ArgumentError
        An argument is wrong.
    """
    from crosscheck.scene.building import scene_from

    content = table(path, keyframe=keyframe, drop=drop, base=base, qpos=qpos, qvel=qvel, duration=duration,
                    samples=samples, balance=balance, root=root, actuators=actuators, controls=controls, limits=limits,
                    contacts=contacts, friction=friction, start=start, within=within)
    return scene_from(content, path)


def table(path: str | os.PathLike[str], **options: Any) -> Content:
    """The content of the scene file for a model; options and errors as `import_model`.

    It is read in a worker process with limits of time and memory, because a model may make its parser stall or crash.
    """
    if not isinstance(path, str | os.PathLike):
        raise ArgumentError(f"path: the name of a model file is wanted, not {type(path).__name__}")
    return apart(_read, (os.getcwd(), os.fsdecode(path), options), os.fsdecode(path))


def apart(function: Callable[[Any], T], task: Any, path: str) -> T:
    """The result of a function that reads the model `path`, from a worker; raises its error, or `SceneError`."""
    from crosscheck.jobs.workers.process import Crash, Limits, isolated

    answer = isolated(function, task, Limits(**LIMITS))
    if isinstance(answer, Crash):
        if (error := answer.error()) is not None:  # of ours: that a file is wrong, or a mistake
            error.add_note(answer.details)
            raise error
        raise SceneError(f"{path}: reading it {answer.message.removeprefix('stopped: it ')}; no engine needs "
                         "so much for a robot, check what it reserves, repeats and includes")
    result: T = answer
    return result


def _read(task: tuple[str, str, dict[str, Any]]) -> dict[str, Any]:
    """The content of a scene file for (working folder, path, options), of which a scene can be made in time."""
    from crosscheck.scene.building import scene_from
    from crosscheck.scene.models import checking, reading  # need msgspec

    folder, path, options = task
    os.chdir(folder)
    content = reading.table(path, **options)
    return checking.watchable(content, scene_from(content, path))


def joint_data(path: str | os.PathLike[str]) -> dict[str, dict[str, tuple[float | str, ...]]]:
    """What the joints of a model have and `Scene.left_out` does not list, by joint and name, in SI: limits of effort
    and velocity, the gear, gain and bias of actuators, and kind and half sizes of the shapes that may collide of what
    the joint carries. Errors as `import_model`."""
    return apart(_joint_data, (os.getcwd(), os.fsdecode(path)), os.fsdecode(path))


def _joint_data(task: tuple[str, str]) -> dict[str, dict[str, tuple[float | str, ...]]]:
    """`joint_data` of (working folder, path)."""
    from crosscheck.scene.models import reading, source

    os.chdir(task[0])
    return reading.joint_data(source.read(Path(task[1])))
