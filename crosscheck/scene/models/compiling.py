"""Compiles model files with MuJoCo, without textures and without meshes that no inertia needs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from crosscheck.errors import SceneError, missing
from crosscheck.scene.models import merging, source
from crosscheck.scene.models.source import Source


@contextlib.contextmanager
def listening() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings in a list; by itself MuJoCo appends them to MUJOCO_LOG.TXT in the working folder.

    Python warnings, by which MuJoCo advises the authors of models about deprecated attributes, are ignored.
    """
    import warnings

    import mujoco

    heard: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(heard.append)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            yield heard
    finally:
        mujoco.set_mju_user_warning(before)


def compiled(model: Source, base: str = "fixed", bare: bool = True) -> Any:
    """The `mujoco.MjModel` of a source.

    `bare` removes all geometry from a URDF, so that MuJoCo needs no meshes and makes no mass from collision shapes.
    """
    try:
        import mujoco
    except ImportError as error:
        raise SceneError(f"{model.path}: models are read by MuJoCo: {missing(error)}") from None
    if model.is_urdf:
        _prepare_urdf(model, base, bare)
    else:
        _prepare_mjcf(model)
    with listening():
        try:
            spec = mujoco.MjSpec.from_string(model.text)
            spec.modelfiledir = str(model.path.parent.resolve())
            if model.is_urdf and base == "free":
                spec.worldbody.first_body().add_freejoint()
            return spec.compile()
        except Exception as error:  # MuJoCo raises ValueError, and its own FatalError
            words = " ".join(str(error).split()).removeprefix("Error: ")
            raise SceneError(f"{model.path}: MuJoCo cannot read it: {words}") from None


def _prepare_urdf(model: Source, base: str, bare: bool) -> None:
    if bare:
        for link in model.root.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)
        try:
            merging.merge(model.root, drop_root=base == "fixed")
        except ValueError as error:
            raise SceneError(f"{model.path}: an inertial or origin is not written in numbers: {error}") from None
    for extension in model.root.findall("mujoco"):
        model.root.remove(extension)
    extension = ElementTree.SubElement(model.root, "mujoco")
    ElementTree.SubElement(extension, "compiler", fusestatic="false", strippath="false", balanceinertia="false",
                           discardvisual="true")


def _prepare_mjcf(model: Source) -> None:
    """Remove textures, materials and skins, whose files are not needed, and meshes that cannot be read."""
    for parent in list(model.root.iter()):
        for child in list(parent):
            if child.tag in ("texture", "skin", "material") and parent.tag in ("asset", "default"):
                parent.remove(child)
        parent.attrib.pop("material", None)
    missing = {}
    for element, name, target in source.files(model):
        if element.tag != "mesh" and target is None:
            raise source.outside(model.path, name)
        if element.tag == "mesh" and (target is None or not target.is_file()):
            missing[element.get("name") or Path(name).stem] = (
                f"{name}, which is {'missing' if target else 'outside its folder'}", element)
    for asset in model.root.findall("asset"):
        for _, element in missing.values():
            if element in list(asset):
                asset.remove(element)
    for body in model.root.iter("body"):
        for geom in body.findall("geom"):
            if geom.get("mesh") not in missing:
                continue
            if body.find("inertial") is None:
                raise SceneError(f"{model.path}: body {body.get('name')!r} has its mass from the mesh "
                                 f"{missing[geom.get('mesh', '')][0]}; put it there or give an inertial")
            body.remove(geom)
    world = model.root.find("worldbody")
    for geom in [] if world is None else world.findall("geom"):
        if world is not None and geom.get("mesh") in missing:
            world.remove(geom)
