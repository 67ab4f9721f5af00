"""The collision shapes of a URDF as geometries of a MuJoCo model, which weigh nothing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from crosscheck.scene import touching
from crosscheck.scene.model import quaternion_from_rotation
from crosscheck.scene.models.source import Source, label

MOST_CORNERS = 10**6
"""Of a mesh that is read."""

THINNEST = 1e-12
"""m^3. A hull of less is flat, which no library of distances takes."""

REMOTE = ("package://", "model://", "file://")


@dataclasses.dataclass(frozen=True)
class Collision:
    """A shape on a link: kind and size as `laws.SIZES` has them, and where it is in the frame of the link."""

    link: str
    kind: str
    size: list[float]
    position: np.ndarray  # (3,) m
    attitude: np.ndarray  # (3, 3)
    points: np.ndarray | None = None  # (k, 3) corners of the convex hull of a mesh


def read(model: Source, pose: Callable[[Element | None], np.ndarray],
         number: Callable[[Element, str], float]) -> tuple[list[Collision], list[str]]:
    """(collision shapes of a URDF, those that cannot be watched, in words).

    Parameters
    ----------
    pose, number : read an <origin> as (4, 4), and a number of an element; raise `ValueError` for what is none
    """
    shapes, absent = list[Collision](), dict[str, list[str]]()
    for link in model.root.iter("link"):
        for collision in link.findall("collision"):
            for form in (each for geometry in collision.findall("geometry") for each in geometry):
                X = pose(collision.find("origin"))
                try:
                    kind, size, points = _form(model, form, number)
                except _UnwatchedError as error:
                    absent.setdefault(str(error), []).append(form.get("filename") or label(form))
                    continue
                shapes.append(Collision(link.get("name", ""), kind, size, X[:3, 3], X[:3, :3], points))
    return shapes, [f"collision shapes {', '.join(dict.fromkeys(names))}: {why}" for why, names in absent.items()]


class _UnwatchedError(Exception):
    """Why a shape cannot be watched."""


def _form(model: Source, form: Element, number: Callable[[Element, str], float]
          ) -> tuple[str, list[float], np.ndarray | None]:
    """(kind, size, corners) of an element of <geometry>."""
    def numbers(key: str, default: str = "") -> list[float]:
        return [number(form, word) for word in form.get(key, default).split()]

    kind, size = form.tag, list[float]()
    if kind == "box":
        size = [each / 2 for each in numbers("size")]
    elif kind == "sphere":
        size = numbers("radius")
    elif kind in ("cylinder", "capsule"):
        size = [*numbers("radius"), *(each / 2 for each in numbers("length"))]
    elif kind == "mesh":
        return kind, size, _hull(model, form.get("filename", ""), numbers("scale", "1 1 1"))
    if len(size) != {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}.get(kind) or not min(size) > 0:
        raise _UnwatchedError("their sizes are not those of a box, cylinder, capsule, sphere or mesh")
    return kind, size, None


def _hull(model: Source, name: str, scale: list[float]) -> np.ndarray:
    """(k, 3) corners of the convex hull of a mesh file."""
    from scipy.spatial import ConvexHull, QhullError

    if not touching.available():
        raise _UnwatchedError("coal, which reads them, comes with pin and is not installed (pip install pin)")
    import coal

    near = list(_places(model, name))
    paths = [path for path in near if path.is_relative_to(model.within) and path.is_file()]
    if not paths:
        outside = any(path.is_file() for path in near)
        raise _UnwatchedError("outside the folder of the model; --within FOLDER, one above both, reads them" if outside
                              else "missing")
    try:
        corners = np.array(coal.MeshLoader().load(str(paths[0]), np.array(scale)).vertices())
    except (ValueError, RuntimeError):
        raise _UnwatchedError("not read by coal") from None
    if len(corners) > MOST_CORNERS or not np.isfinite(corners).all():
        raise _UnwatchedError(f"more than {MOST_CORNERS} corners, or one that is not finite")
    try:
        hull = ConvexHull(corners)
    except (QhullError, ValueError):
        raise _UnwatchedError("flat") from None
    if hull.volume < THINNEST:
        raise _UnwatchedError("flat")
    return np.asarray(corners[hull.vertices])


def _places(model: Source, name: str) -> Iterator[Path]:
    """Where a mesh may be: beside the model, and in the package of this name around it."""
    folder = model.path.parent.resolve()
    scheme = next((each for each in REMOTE if name.startswith(each)), "")
    rest = Path(name.removeprefix(scheme))
    yield (folder / rest).resolve()
    if scheme in REMOTE[:2] and len(rest.parts) > 1:
        for above in (folder, *folder.parents):
            yield (above / rest).resolve()
            if above.name == rest.parts[0]:
                yield above.joinpath(*rest.parts[1:]).resolve()


def add(spec: Any, shapes: list[Collision]) -> None:
    """Give the bodies of a `mujoco.MjSpec` these shapes; the links that it has none of are of the world."""
    import mujoco

    for k, shape in enumerate(shapes):
        geom: dict[str, Any] = {"type": getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}"),
                                "size": [*shape.size, 0.0, 0.0, 0.0][:3]}
        if shape.points is not None:
            geom["meshname"] = f"collision {k}"
            spec.add_mesh(name=geom["meshname"], uservert=shape.points.ravel(),
                          inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
        body = spec.body(shape.link) or spec.worldbody
        body.add_geom(name=f"{shape.link} {shape.kind} {k}", mass=0.0, pos=shape.position,
                      quat=quaternion_from_rotation(shape.attitude), **geom)
