"""Exports scenes as model files: MJCF for MuJoCo, URDF for many programs, a script for Exudyn."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

from crosscheck.errors import ArgumentError, SceneError
from crosscheck.files import put
from crosscheck.scene.file import as_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.models.writing import mjcf, urdf


def export_model(scene: Scene | str | os.PathLike[str], path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a scene (or its name or path) as MJCF, .xml, as URDF, .urdf, or as a Python script that runs Exudyn, .py.

    `import_model` reads an exported model back with errors of rounding size. An MJCF holds the state in its keyframe
    "start". A URDF holds no state: give `qpos` and `qvel` to `import_model`. The script prints the states of its run as
    CSV.

    Returns
    -------
    tuple of str
        What is left out: shapes, touches that are watched, sites and sensors, which change no motion.

    Raises
    ------
    SceneError
        The format cannot hold an element of the scene, which the message names, or the file cannot be written.
    ArgumentError
        `path` has another ending.
    """
    target, scene = Path(path), as_scene(scene)
    if target.suffix == ".py":
        from crosscheck.adapters.exudyn.script import script

        text = script(scene)
    elif target.suffix in (".xml", ".urdf"):
        root = mjcf(scene) if target.suffix == ".xml" else urdf(scene)
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding="unicode") + "\n"
    else:
        raise ArgumentError(f"{target}: a model ends in .xml (MJCF), .urdf, or .py (a script for Exudyn); rename it")
    try:
        put(target, text)
    except OSError as error:
        raise SceneError(f"{target}: cannot be written, {(error.strerror or str(error)).lower()}") from None
    watched = [f"watched touch of {each.name}" for each in scene.monitors if each.joint is None]
    named = (("shape", scene.shapes), ("site", scene.sites), ("sensor", scene.sensors))
    return (*(f"{word} {each.name!r}" for word, group in named for each in group), *watched)
