"""Figures that others printed for a scene, beside truth and what engines give: a recording of a few numbers.

They are compared with truth and never used as truth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from crosscheck import adapters
from crosscheck.errors import CrosscheckError
from crosscheck.recordings.comparing import UNITS, Outputs, gaps, norms
from crosscheck.recordings.reading import Group
from crosscheck.references import dense
from crosscheck.running.arguments import best_method
from crosscheck.running.run import run
from crosscheck.scene.file import load_scene
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


def figures(names: Sequence[str], engines: Sequence[str]) -> list[Figure]:
    """The published figures of scenes; an engine that cannot run a scene is left out of it."""
    return [_figure(scene, figure, engines) for scene in map(load_scene, names) for figure in scene.published
            if figure.quantity != "eigenvalue"]


def _figure(scene: Scene, figure: Published, engines: Sequence[str]) -> Figure:
    owner = figure.joint or ("" if figure.body is None else scene.bodies[figure.body].name)
    what = f"{figure.quantity.replace('_', ' ')}{f' of {owner}' if owner else ''} at {figure.time:g} s"
    value = np.array([figure.value])
    if figure.quantity == "attitude":
        value = rotation_from_quaternion(value / np.linalg.norm(value)) if value.size == 4 else value.reshape(1, 3, 3)
    group = Group(figure.quantity, owner, tuple(range(len(figure.value))), value, np.zeros(1))
    truth, shown = dense(scene), Outputs(scene, [group])
    exact = shown.of(truth.at(np.array([figure.time])))[0]
    given = {}
    for engine in engines:
        try:
            given[engine] = float(norms(gaps(group, shown.of(_motion(scene, figure, engine))[0][-1:], exact))[0])
        except CrosscheckError:
            continue
    return Figure(scene.name, what, figure.source, figure.value, figure.error,
                  UNITS.get(figure.quantity, "J" if figure.quantity == "energy" else "rad, m, s"),
                  float(norms(gaps(group, value, exact))[0]), truth.error * max(1.0, float(np.abs(exact).max())), given)


def _motion(scene: Scene, figure: Published, engine: str) -> Motion:
    method = best_method(adapter := adapters.get(engine), scene)
    controls = {"rtol": RTOL} if method in adapter.adaptive_methods else {"step": (figure.time or 1.0) / STEPS}
    return run(scene.replace(duration=figure.time, samples=max(3, scene.samples)), engine, method, monitor=False,
               **controls)
