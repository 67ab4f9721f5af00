"""A scene as the tree that model files need: every body on one joint, parents first, and the loop joints."""

from __future__ import annotations

from collections.abc import Iterable

from crosscheck.errors import SceneError
from crosscheck.scene.model import GROUND, Joint, Scene


def numbers(values: Iterable[float]) -> str:
    """Numbers as text for an attribute, with every bit."""
    return " ".join(repr(float(value)) for value in values)


def refused(scene: Scene, form: str, what: str) -> SceneError:
    """The error for something that a format cannot hold."""
    return SceneError(f"{scene.name}: {form} cannot hold {what}")


def grown(scene: Scene, form: str) -> tuple[list[tuple[int, Joint | None]], list[Joint]]:
    """((body, its joint or None if it is free), parents first; the joints that close loops)."""
    hung: dict[int, Joint] = {}
    loops = []
    for joint in scene.joints:
        if joint.child in hung or joint.type == "distance":
            loops.append(joint)
        else:
            hung[joint.child] = joint
    order: list[tuple[int, Joint | None]] = []
    placed = {GROUND}
    while len(order) < scene.n:
        ready = [body for body in range(scene.n) if body not in placed
                 and (body not in hung or hung[body].parent in placed)]
        if not ready:
            names = [hung[body].name for body in range(scene.n) if body not in placed]
            raise refused(scene, form, f"the circle of the joints {', '.join(map(repr, names))}")
        order += [(body, hung.get(body)) for body in ready]
        placed |= set(ready)
    return order, loops
