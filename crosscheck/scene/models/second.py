"""Reads a URDF with Pinocchio, to check what MuJoCo reads."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.errors import SceneError, errors_as
from crosscheck.files import aside
from crosscheck.scene.models.source import Source

if TYPE_CHECKING:
    import pinocchio


def explained(build: Callable[[], pinocchio.Model]) -> pinocchio.Model:
    """The result of `build`, without its output; raises `ValueError` with its message and its first line on stderr.

    urdfdom writes the reason of an error to stderr, and its exception does not contain it.
    """
    with aside(2) as file:
        def refused(error: Exception) -> ValueError:  # urdfdom and Pinocchio raise several kinds
            file.seek(0)
            said = file.read(1000).decode(errors="replace").strip().partition("\n")[0].removeprefix("Error:")
            return ValueError("; ".join(" ".join(each.split()) for each in (str(error), said) if each.strip()))

        with errors_as(refused):
            return build()


def parsed(model: Source, base: str = "fixed") -> pinocchio.Model:
    """The `pinocchio.Model` of a URDF; raises `SceneError` with what Pinocchio says."""
    import pinocchio

    root = (pinocchio.JointModelFreeFlyer(),) if base == "free" else ()
    try:
        return explained(lambda: pinocchio.buildModelFromXML(model.text, *root))
    except ValueError as error:
        raise SceneError(f"{model.path}: Pinocchio cannot read it: {error}") from None


def links(pin_model: pinocchio.Model) -> dict[str, int]:
    """The joint of each moving link: the first link in the joint's frame."""
    import pinocchio

    first: dict[int, str] = {}
    for frame in pin_model.frames:
        if frame.parentJoint and frame.type == pinocchio.FrameType.BODY:
            first.setdefault(int(frame.parentJoint), frame.name)
    return {name: joint for joint, name in first.items()}


def bodies(model: Source, base: str) -> dict[str, tuple[float, np.ndarray]]:
    """Mass and principal moments of the moving links, including the links fixed to them."""
    pin_model = parsed(model, base)
    return {name: (float(pin_model.inertias[joint].mass), np.linalg.eigvalsh(pin_model.inertias[joint].inertia))
            for name, joint in links(pin_model).items()}
