"""A URDF as Pinocchio reads it: the second opinion on what MuJoCo reads."""

from __future__ import annotations

from typing import Any

import numpy as np

from crosscheck.errors import SceneError
from crosscheck.scene.models.source import Source


def parsed(model: Source, base: str = "fixed") -> Any:
    """The `pinocchio.Model` of a URDF; raises `SceneError` with what Pinocchio says."""
    import pinocchio

    root = (pinocchio.JointModelFreeFlyer(),) if base == "free" else ()
    try:
        return pinocchio.buildModelFromXML(model.text, *root)
    except Exception as error:  # urdfdom and Pinocchio raise several kinds
        raise SceneError(f"{model.path}: Pinocchio cannot read it: {' '.join(str(error).split())}") from None


def links(pin_model: Any) -> dict[str, int]:
    """The joint that moves each link which carries one: the first link in the joint's own frame."""
    import pinocchio

    found: dict[str, int] = {}
    taken: set[int] = set()
    for frame in pin_model.frames:
        joint = int(frame.parentJoint)
        if joint and joint not in taken and frame.type == pinocchio.FrameType.BODY:
            found[frame.name] = joint
            taken.add(joint)
    return found


def bodies(model: Source, base: str) -> dict[str, tuple[float, np.ndarray]]:
    """Mass and principal moments of the moving links, those fixed to them included."""
    pin_model = parsed(model, base)
    return {name: (float(pin_model.inertias[joint].mass), np.linalg.eigvalsh(pin_model.inertias[joint].inertia))
            for name, joint in links(pin_model).items()}
