"""Model files of others as scenes: MJCF and URDF, in and out.

A model is read by MuJoCo's own parser and compiler; a URDF is checked against Pinocchio where that is installed. What a
scene cannot hold and what would change the motion is refused, or dropped on request and listed in `Scene.left_out`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from crosscheck.errors import ArgumentError, SceneError
from crosscheck.scene.model import Scene

if TYPE_CHECKING:  # the schema needs msgspec, which the environment of an engine's version has not
    from crosscheck.scene.schema import Content

SUFFIXES = (".xml", ".urdf", ".mjcf", ".xacro")
"""Names of files that are models, not scenes; xacro is refused by its name."""


def is_model(path: object) -> bool:
    """Whether a name stands for a model file."""
    return isinstance(path, str | os.PathLike) and Path(os.fsdecode(path)).suffix.lower() in SUFFIXES


def import_model(path: str | os.PathLike[str], keyframe: str | int | None = None, drop: bool = False,
                 base: Literal["fixed", "free"] = "fixed", qpos: Sequence[float] | None = None,
                 qvel: Sequence[float] | None = None, duration: float = 2.0, samples: int = 101) -> Scene:
    """An MJCF or URDF file as a scene.

    Parameters
    ----------
    path
        Ends in .xml (MJCF, or URDF by its root) or .urdf. Nothing outside its folder is read.
    keyframe
        Name or number of an MJCF keyframe, which brings qpos, qvel and ctrl.
    drop
        Leave out what a scene cannot hold, and list it in `left_out`; otherwise it is refused.
    base
        Of a URDF: "fixed" to the world, or "free".
    qpos, qvel
        Start in the coordinates of the compiled MuJoCo model: joints in file order; a free base first, position and
        quaternion w, x, y, z. Default: the model's reference, at rest.
    duration, samples
        Of the scene: s, and number of output times.

    Raises
    ------
    SceneError
        The file is wrong, or holds what a scene cannot; the message names everything.
    ArgumentError
        A wrong argument.
    """
    from crosscheck.scene.building import scene_from

    content = table(path, keyframe=keyframe, drop=drop, base=base, qpos=qpos, qvel=qvel, duration=duration,
                    samples=samples)
    return scene_from(content, path)


def table(path: str | os.PathLike[str], **options: Any) -> Content:
    """The content of the scene file that a model is imported as; options and errors as `import_model`."""
    from crosscheck.scene.models import reading

    return reading.table(path, **options)


def import_file(path: str | os.PathLike[str], target: Path, **options: Any) -> Scene:
    """As `import_model`, and write the scene to the file `target`, which ends in .toml."""
    from crosscheck.files import put
    from crosscheck.scene.building import scene_from
    from crosscheck.scene.models.writing import toml

    if target.suffix != ".toml":
        raise ArgumentError(f"{target}: a scene file ends in .toml; rename it")
    content = table(path, **options)
    scene = scene_from(content, path)
    try:
        put(target, toml(content))
    except OSError as error:
        raise SceneError(f"{target}: cannot be written, {(error.strerror or str(error)).lower()}") from None
    return scene
