"""Scenes as model files: MJCF for MuJoCo, URDF for everybody."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

from crosscheck.errors import ArgumentError, SceneError
from crosscheck.files import put
from crosscheck.scene.file import as_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.models.mjcf import mjcf
from crosscheck.scene.models.urdf import urdf


def export_model(scene: Scene | str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Write a scene (or its name or path) as MJCF, .xml, or URDF, .urdf; reading it back gives the scene to rounding.

    The state is the keyframe "start" of an MJCF. A URDF holds none: give `qpos` and `qvel` to `import_model`.

    Raises
    ------
    SceneError
        The format cannot hold something of the scene, which is named, or the file cannot be written.
    ArgumentError
        `path` ends in something else.
    """
    target = Path(path)
    makers = {".xml": mjcf, ".urdf": urdf}
    if target.suffix not in makers:
        raise ArgumentError(f"{target}: a model file ends in .xml (MJCF) or .urdf; rename it")
    root = makers[target.suffix](as_scene(scene))
    ElementTree.indent(root)
    try:
        put(target, ElementTree.tostring(root, encoding="unicode") + "\n")
    except OSError as error:
        raise SceneError(f"{target}: cannot be written, {(error.strerror or str(error)).lower()}") from None
