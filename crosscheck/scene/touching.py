"""Distances between the shapes of a scene, by MuJoCo's own collision geometry."""

from __future__ import annotations

import importlib.util

import numpy as np

from crosscheck.errors import Unsupported
from crosscheck.scene.laws import Monitor
from crosscheck.scene.model import GROUND, Scene, rotation_from_quaternion

BEYOND = 1e6
"""Distances are exact below this, m; MuJoCo asks for such a number."""


def available() -> bool:
    """Whether the library of the distances is installed."""
    return importlib.util.find_spec("mujoco") is not None


class Touching:
    """The distances that the monitors of type touch watch; raises `Unsupported` without MuJoCo.

    `monitors` are their indices among those of the scene.
    """

    def __init__(self, scene: Scene) -> None:
        if not available():
            raise Unsupported(f"{scene.name!r}: distances between shapes need MuJoCo; pip install mujoco")
        import mujoco

        self.monitors = [k for k, monitor in enumerate(scene.monitors) if monitor.joint is None]
        watched: list[Monitor] = [scene.monitors[k] for k in self.monitors]
        self._margins = np.array([monitor.margin for monitor in watched])
        names = {name for monitor in watched for name in monitor.shapes}
        self._shapes = [shape for shape in scene.shapes if shape.name in names]
        spec = mujoco.MjSpec()
        for shape in self._shapes:
            size = np.pad(np.array(shape.size), (0, 3 - len(shape.size))) if shape.size else np.ones(3)
            geom: dict[str, object] = {"type": getattr(mujoco.mjtGeom, f"mjGEOM_{shape.type.upper()}"), "size": size}
            if shape.type == "mesh":
                spec.add_mesh(name=shape.name, uservert=np.array(shape.points).ravel(),
                              inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
                geom["meshname"] = shape.name
            spec.worldbody.add_geom(name=shape.name, **geom)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        # MuJoCo gives a mesh a frame of its own, in which the one of the scene is this
        self._frames = [(self._data.geom_xpos[g].copy(), self._data.geom_xmat[g].reshape(3, 3).copy())
                        for g in range(self._model.ngeom)]
        at = {shape.name: g for g, shape in enumerate(self._shapes)}
        self._pairs = [tuple(at[name] for name in monitor.shapes) for monitor in watched]

    def gaps(self, x: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Distance minus margin of each monitor, m, for bodies at x (n, 3), R (n, 3, 3); negative within it."""
        import mujoco

        for g, (shape, (offset, turn)) in enumerate(zip(self._shapes, self._frames, strict=True)):
            attitude, centre = rotation_from_quaternion(np.array(shape.attitude)), np.array(shape.position)
            if shape.body != GROUND:
                attitude, centre = R[shape.body] @ attitude, x[shape.body] + R[shape.body] @ centre
            self._data.geom_xpos[g] = centre + attitude @ offset
            self._data.geom_xmat[g] = (attitude @ turn).ravel()
        distances = [mujoco.mj_geomDistance(self._model, self._data, *pair, BEYOND, None) for pair in self._pairs]
        return np.asarray(np.array(distances) - self._margins)
