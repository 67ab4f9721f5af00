"""Figures that others printed for a scene, beside truth and what engines give: a recording of a few numbers.

They are compared with truth and never used as truth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.judge.metrics import attitude_angle
from crosscheck.references import dense
from crosscheck.running.methods import best_method
from crosscheck.running.run import run
from crosscheck.scene import mechanics
from crosscheck.scene.coordinates import histories
from crosscheck.scene.file import load_scene, scene_names
from crosscheck.scene.model import Published, Scene, rotation_from_quaternion
from crosscheck.scene.states import Motion

STEPS = 20_000
"""Steps of an engine's run to a published time."""

RTOL = 1e-11


@dataclasses.dataclass(frozen=True)
class Figure:
    """A published figure and how far truth and the engines are from it."""

    scene: str
    what: str
    source: str
    value: tuple[float, ...]
    error: float  # what the printed digits allow
    unit: str
    truth: float  # its distance from the figure
    known: float  # error of truth
    engines: dict[str, float]  # distances of engines from truth

    @property
    def differs(self) -> bool:
        """Whether the figure is not truth, beyond its printed digits and the error of truth."""
        return self.truth > self.error + 4 * self.known


def tagged(tags: Sequence[str]) -> list[str]:
    """Names of the built-in scenes with one of these tags."""
    return [name for name in scene_names() if set(tags) & set(load_scene(name).tags)]


def figures(names: Sequence[str], engines: Sequence[str]) -> list[Figure]:
    """The published figures of scenes; an engine that cannot run a scene is left out of it."""
    made = []
    for name in names:
        scene = load_scene(name)
        for figure in scene.published:
            if figure.quantity != "eigenvalue":
                made.append(_figure(scene, figure, engines))
    return made


def _figure(scene: Scene, figure: Published, engines: Sequence[str]) -> Figure:
    owner = figure.joint or ("" if figure.body is None else scene.bodies[figure.body].name)
    what = f"{figure.quantity.replace('_', ' ')}{f' of {owner}' if owner else ''} at {figure.time:g} s"
    truth = dense(scene)
    # Angles are followed over full turns, from the start on.
    times = np.linspace(0.0, figure.time or 0.0, max(3, scene.samples))
    exact = _shown(scene, figure, truth.at(times))
    distance = _distance(figure, np.array(figure.value), exact)
    scale = max(1.0, float(np.abs(exact).max()))
    given = {}
    for engine in engines:
        try:
            given[engine] = _distance(figure, _shown(scene, figure, _motion(scene, figure, engine)), exact)
        except CrosscheckError:
            continue
    units = {"position": "m", "attitude": "rad", "velocity": "m/s", "angular_velocity": "rad/s", "energy": "J"}
    return Figure(scene.name, what, figure.source, figure.value, figure.error, units.get(figure.quantity, "rad, m, s"),
                  distance, truth.error * scale, given)


def _motion(scene: Scene, figure: Published, engine: str) -> Motion:
    from crosscheck import adapters

    adapter = adapters.get(engine)
    method = best_method(adapter, scene)
    until = scene.replace(duration=figure.time, samples=max(3, scene.samples))
    controls = {"rtol": RTOL} if method in adapter.adaptive_methods else {"step": (figure.time or 1.0) / STEPS}
    return run(until, engine, method, monitor=False, **controls)


def _shown(scene: Scene, figure: Published, motion: Motion) -> np.ndarray:
    """The figure as a motion shows it at its last time."""
    if figure.quantity == "energy":
        return np.asarray(mechanics.energy(scene, motion)[-1:])
    if figure.quantity.startswith("joint_"):
        history = histories(scene, motion)[figure.joint or ""]
        return np.atleast_1d((history.position if figure.quantity == "joint_position" else history.velocity)[-1])
    arrays = {"position": motion.x, "attitude": motion.R, "velocity": motion.v, "angular_velocity": motion.w}
    return np.asarray(arrays[figure.quantity][-1, figure.body])


def _distance(figure: Published, one: np.ndarray, other: np.ndarray) -> float:
    """In the measures of the results: norms, and the angle between attitudes."""
    if figure.quantity == "attitude":
        R, S = (rotation_from_quaternion(each / np.linalg.norm(each)) if each.shape == (4,) else each
                for each in (one, other))
        return float(attitude_angle(R, S))
    return float(np.linalg.norm(one - other))
