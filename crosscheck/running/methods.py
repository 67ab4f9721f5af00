"""The method of an engine that is used when the user names none."""

from __future__ import annotations

from typing import Any

from crosscheck.adapters.base import RunSpec
from crosscheck.errors import Unsupported
from crosscheck.scene.model import Scene


def best_method(adapter: Any, scene: Scene) -> str:
    """The method with the highest documented order among those that can run this scene; the last of equal ones.

    Raises `Unsupported` where the engine cannot run the scene with any method.
    """
    specs = [RunSpec(method, step=1e-3) for method in adapter.methods]
    usable = [(adapter.documented_order(scene, spec) or 0, index) for index, spec in enumerate(specs)
              if adapter.unsupported(scene, spec) is None]
    if not usable:
        raise Unsupported(f"{adapter.name}: {adapter.unsupported(scene, specs[0])}")
    found: str = adapter.methods[max(usable)[1]]
    return found
