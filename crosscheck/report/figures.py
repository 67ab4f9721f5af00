"""The main plots of a report for papers, as SVG or PDF files.

matplotlib draws the plots, so that no browser is needed. Text is kept as text, so that a paper can use its own fonts.
The same results always give the same file. The pages offer each of their figures as SVG, too, by the link below it.
"""

from __future__ import annotations

import collections
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.document import EULER, Document, Record, Scene, grouped
from crosscheck.document.curves import Curve, RunCurves
from crosscheck.report import identity, pages
from crosscheck.report.curves import unpack

SMALLEST = 1e-18
"""The value at which an exact zero is drawn on a logarithmic axis."""
SERIES: dict[str, tuple[str, Callable[[RunCurves], Curve]]] = {
    "position-error": ("position error (m)", lambda curves: curves.errors.get("position")),
    "energy-error": ("energy error (1)", lambda curves: curves.energy),
    "constraint-position": ("position level (m)", lambda curves: curves.constraint_position),
    "constraint-velocity": ("velocity level (m/s)", lambda curves: curves.constraint_velocity),
    "constraint-acceleration": ("acceleration level (m/s$^2$)", lambda curves: curves.constraint_acceleration),
    "orthogonality": (r"max $|R^T R - I|$ (1)", lambda curves: curves.orthogonality)}
"""Figures over time by the last part of their file names: title of the axis, and the curve of a run to draw."""
SHOWN = "DAE1L_LSE"
"""The method in figures of a single run, as on the pages. If it was not run, the first run is drawn."""
MOST_BODIES = 4
"""Up to this number of bodies, the rotation matrices of all are drawn; beyond it, only that of the last."""


FORMATS: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
"""Formats of the files, without the times at which they were made."""
WIDEST, THINNEST = 3.6, 0.7
"""Widths, pt, of the first and the last of several curves over time: of those that coincide, each stays visible."""


def write_figures(document: Document, folder: Path) -> list[Path]:
    """Write the figures of every scene into `folder` as SVG and return their paths.

    Figures of the motion show one run. Figures over time show the eight Lie group Euler methods and the most accurate
    run of each other engine. Figures of speed and convergence show all runs.
    """
    folder.mkdir(exist_ok=True)
    with style():
        return [folder / f"{stem}.svg" for scene in document.scenes for stem, _ in drawn(
            scene, [record for record in document.records if record.scene == scene.name], folder, ("svg",))]


def style() -> Any:
    """The context in which figures are drawn: text is kept as text, and the same results give the same file."""
    import matplotlib

    matplotlib.use("svg")
    return matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "crosscheck", "pdf.fonttype": 42,
                                  "font.size": 9, "axes.grid": True, "grid.color": "#dddddd", "legend.fontsize": 7,
                                  "lines.linewidth": 1.1})


def drawn(scene: Scene, runs: Sequence[Record], folder: Path, formats: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Write the figures of a scene; the stem of each one's files, and the last part of it."""
    for end, figure in figures(scene, runs):
        stem = f"{Path(pages.scene_file(scene)).stem}-{end}"
        for kind in formats:
            figure.savefig(folder / f"{stem}.{kind}", format=kind, metadata=FORMATS[kind], bbox_inches="tight")
        yield stem, end


def verbatim(name: str) -> str:
    """A name as it is, in which matplotlib finds no formula."""
    return name.replace("$", r"\$")


def figures(scene: Scene, runs: Sequence[Record]) -> Iterator[tuple[str, Any]]:
    """The last part of the file name, and the figure, for every figure of a scene that has data."""
    of_engine = identity.of_runs((record.engine, record.label) for record in runs)
    looks = {record.label: of_engine[record.engine][record.label] for record in runs}
    times = scene.curves.t
    alone = [record for record in runs if record.curves.drawn]
    if alone:
        yield from _motion(scene, next((record for record in alone if record.method == SHOWN), alone[0]))
    for end, (axis, read) in SERIES.items():
        lines = [(record, *_history(times, read(record.curves))) for record in _compared(runs)
                 if read(record.curves)]
        if lines:
            yield end, _drawn(lines, looks, "time (s)", axis, markers=False)
    points = [(record, [1e3 * seconds for seconds, _ in record.timing],
               [rung.errors.get("position") for _, rung in record.timing]) for record in runs if record.timing]
    if points:
        yield "speed", _drawn(points, looks, "stepping time (ms)", "largest position error (m)", log_x=True)
    ladders = [(record, [rung.step for rung in record.ladder],
                [rung.errors.get("position") for rung in record.ladder])
               for record in runs if record.documented_order and record.ladder]
    if ladders:
        yield "convergence", _drawn(ladders, looks, "step (s)", "largest position error (m)", log_x=True)


def _motion(scene: Scene, record: Record) -> Iterator[tuple[str, Any]]:
    """Figures of one run: paths of mass centres and of the last body's end, energies, elements of rotation matrices."""
    from matplotlib.figure import Figure
    from scipy.spatial.transform import Rotation

    def read(curves: Sequence[Curve], exact: Sequence[Curve]) -> np.ndarray:
        return np.array([unpack(curve, true) for curve, true in zip(curves, exact, strict=True)]).T

    own, exact = record.curves, scene.curves
    x, q = ([read(*each) for each in zip(mine or (), true or mine or (), strict=True)]
            for mine, true in ((own.x, exact.x), (own.q, exact.q)))
    R = [Rotation.from_quat(each, scalar_first=True).as_matrix() for each in q]
    energies = read((own.kinetic, own.potential, own.total), (exact.kinetic, exact.potential, exact.total))
    joints = scene.curves.drawing.joints if scene.curves.drawing else []
    joined = collections.Counter(body for joint in joints for body in (joint.parent, joint.child))
    paths = [(f"mass centre of {name}", path) for name, path in zip(scene.bodies, x, strict=True)]
    paths += [(f"end of {scene.bodies[j.child]}", x[j.child] - R[j.child] @ np.array(j.child_anchor)) for j in joints
              if joined[j.child] == 1 and any(j.child_anchor or ())]
    figure = Figure(figsize=(6.8, 3.8), layout="constrained")
    figure.suptitle(verbatim(record.label))
    for axes, across, side in zip(figure.subplots(1, 2), (2, 1), ("the side", "above"), strict=True):
        for label, path in paths:
            line, = axes.plot(path[:, 0], path[:, across], label=verbatim(label))
            axes.plot(path[0, 0], path[0, across], marker="o", markersize=3, color=line.get_color())
        axes.set(xlabel="x (m)", ylabel=f"{'xyz'[across]} (m)", title=f"from {side}")
        axes.set_aspect("equal", adjustable="datalim")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    yield "path", figure
    figure = Figure(figsize=(5.2, 3.6))
    axes = figure.add_subplot(xlabel="time (s)", ylabel="energy (J)", title=verbatim(record.label))
    axes.plot(scene.curves.t, energies, label=("kinetic", "potential", "total"))
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    yield "energies", figure
    for b in range(len(scene.bodies)) if len(scene.bodies) <= MOST_BODIES else (-1,):
        figure = Figure(figsize=(5.2, 4.2), layout="constrained")
        figure.suptitle(verbatim(f"rotation matrix of {scene.bodies[b]}, {record.label}"))
        grid = figure.subplots(3, 3, sharex=True, sharey=True)
        for place in np.ndindex(3, 3):
            grid[place].plot(scene.curves.t, R[b][(slice(None), *place)])
            grid[place].set(title=f"$R_{{{place[0] + 1}{place[1] + 1}}}$", ylim=(-1.1, 1.1))
        figure.supxlabel("time (s)")
        yield f"rotation-{pages.slug(scene.bodies[b])}", figure


def _history(times: list[float], curve: Curve) -> tuple[list[float], Any]:
    """Times and values of a curve without its start, whose error is zero. A curve may have every second time only."""
    values = unpack(curve)
    return times[::(len(times) - 1) // (len(values) - 1)][1:], values[1:]


def _compared(runs: Sequence[Record]) -> list[Record]:
    euler = [record for record in runs if record.engine == "lieeuler" and record.method in EULER]
    others = grouped((record for record in runs if record not in euler and record.errors),
                     lambda record: record.engine)
    return euler + [min(own, key=_largest) for own in others.values()] or list(runs)


def _largest(record: Record) -> float:
    error = record.errors["position"].max
    return math.inf if error is None else error


def _drawn(lines: Sequence[tuple[Record, Any, Any]], looks: dict[str, identity.Look], x_axis: str, y_axis: str,
           log_x: bool = False, markers: bool = True) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 3.6))
    axes = figure.add_subplot(xlabel=x_axis, ylabel=y_axis, yscale="log", xscale="log" if log_x else "linear")
    widths = np.geomspace(WIDEST, THINNEST, max(2, len(lines)))
    for (record, x, y), width in zip(lines, widths, strict=False):
        look = looks[record.label]
        axes.plot(x, [float("nan") if value is None else max(float(value), SMALLEST) for value in y], color=look.light,
                  linestyle=look.pattern(), marker=look.matplotlib_marker if markers else "", markersize=3.5,
                  linewidth=None if markers else width, label=verbatim(record.label))
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, ncols=1 if len(lines) <= 24 else 2)
    return figure
