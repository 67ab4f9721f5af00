"""The papers' figures, drawn by matplotlib as vector graphics.

Coinciding curves stay visible: the first method has the widest line, the last and topmost the thinnest, and their
markers are at different places.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck import files
from crosscheck.report.identity import look
from crosscheck.studies.paper.runs import Shown, ends

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("pdf", "svg")
COLOURS = ("#a6cee3", "#fdbf6f", "#b2df8a", "#1f4e9c", "#d55e00", "#7b3f9d", "#e7298a", "#000000")
"""Light colours for the lower curves and dark ones for the upper, distinct also without colour."""
WIDEST, THINNEST = 3.6, 0.7
"""Line widths, pt."""
MARKS = 5
"""Number of markers on a curve."""
MARGIN = 0.1
"""Margin around a figure, inches."""
PEAKS = 50
"""Noisy values are drawn as the largest one in each of this many parts of the run, so that curves stay visible."""
SMALLEST = 1e-18
"""The value at which an exact zero is drawn on a logarithmic axis."""
MOST_BODIES = 4
"""Up to this number of bodies, the rotation matrices of all are shown; else those of the first and the last."""
LEVELS = (("position", "m", r"position, $|\Phi|$ (m)"), ("velocity", "m/s", r"velocity, $|G u|$ (m/s)"),
          ("acceleration", "m/s^2", r"acceleration, $|G a + \gamma|$ (m/s$^2$)"))
STYLE: dict[Any, Any] = {"svg.fonttype": "none", "svg.hashsalt": "crosscheck", "pdf.fonttype": 42, "font.size": 8,
         "axes.titlesize": 8, "axes.grid": True, "grid.color": "#dddddd", "grid.linewidth": 0.5,
         "legend.fontsize": 7, "legend.frameon": False}


@dataclasses.dataclass(frozen=True)
class Drawing:
    """A figure, the last part of its file name, and its caption in LaTeX."""

    name: str
    figure: Figure
    caption: str


def write(shown: Shown, method: str, folder: Path, formats: Sequence[str]) -> list[tuple[str, str]]:
    """Write all figures of a scene. Returns (stem of the file name, caption) of each."""
    import matplotlib

    written = []
    with matplotlib.rc_context(STYLE):
        for drawing in drawings(shown, method):
            stem = f"{shown.scene.name}-{drawing.name}"
            drawing.figure.draw_without_rendering()
            drawing.figure.set_layout_engine("none")  # keep one layout for all formats
            box = drawing.figure.get_tightbbox().padded(MARGIN)
            for kind in formats:
                drawing.figure.savefig(folder / f"{stem}.{kind}", format=kind, bbox_inches=box,
                                       metadata={"Date": None} if kind == "svg" else {"CreationDate": None})
            written.append((stem, drawing.caption))
    return written


def drawings(shown: Shown, method: str) -> Iterator[Drawing]:
    """All figures of a scene. Figures of one method show `method`, or the first one if `method` has no run."""
    if not shown.runs:
        return
    method = method if method in shown.runs else next(iter(shown.runs))
    yield _path(shown, method)
    yield _paths(shown)
    yield _energies(shown, method)
    yield _levels(shown)
    bodies = range(shown.scene.n) if shown.scene.n <= MOST_BODIES else (0, shown.scene.n - 1)
    for body in bodies:
        yield _rotation(shown, method, body)
    yield _orthogonality(shown)


def _many(shown: Shown, points: int | None = None) -> Iterator[tuple[str, dict[str, object]]]:
    """Every method with the style of its curve. `points` is the number of points; None: all samples."""
    widths = np.geomspace(WIDEST, THINNEST, max(2, len(shown.runs)))
    for index, method in enumerate(shown.runs):
        apart = max(1, (points or len(shown.runs[method].t)) // MARKS)
        yield method, {"color": COLOURS[index % len(COLOURS)], "linewidth": widths[index], "label": method,
                       "solid_capstyle": "butt", "marker": look("lieeuler", index).matplotlib_marker, "markersize": 4.5,
                       "markeredgecolor": "#444444", "markeredgewidth": 0.4,
                       "markevery": (index * apart // len(shown.runs), apart)}


def _sheet(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def _legend(figure: Figure, axes: Axes, columns: int) -> None:
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def _path(shown: Shown, method: str) -> Drawing:
    """Fig. 2 and 12 of P1: the path of the pendulum's end, and of the mass centres."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    traj, scene = shown.runs[method], shown.scene
    figure = Figure(figsize=(4.6, 3.9), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    points = [(f"mass centre of {body.name}", traj.x[:, b]) for b, body in enumerate(scene.bodies)]
    points += [(f"end of {scene.bodies[b].name}", traj.x[:, b] + traj.R[:, b] @ s) for b, s in ends(scene).items()]
    for index, (label, path) in enumerate(points):
        colour = COLOURS[3 + index % 5]
        axes.plot(*path.T, color=colour, linewidth=0.8, label=label)
        axes.plot(*path[0], marker="o", markersize=3, color=colour)
    axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    axes.set_aspect("equal")
    extent = np.ptp(np.concatenate([path for _, path in points]), axis=0)
    for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), extent / extent.max(), strict=True):
        axis.set_major_locator(MaxNLocator(max(1, round(4 * share))))
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.08))
    caption = ("Paths of the mass centres" + (" and of the end, the point opposite the joint," if ends(scene) else "")
               + f" by {tex(method)}; a dot marks the start. {_caption(shown)}")
    return Drawing("path", figure, caption)


def _paths(shown: Shown) -> Drawing:
    """The last body's mass centre by every method, seen along two axes."""
    extent = np.ptp(np.concatenate([traj.x[:, -1] for traj in shown.runs.values()]), axis=0) + 1e-12
    y, z = extent[1:] / extent[0]
    flat = max(y, z) < 0.7  # then one above the other
    height = 5.6 * (y + z) + 1.4 if flat else min(2.7 * max(y, z), 5.0) + 1.0
    figure, axes = _sheet(6.4, max(height, 2.4), *((2, 1) if flat else (1, 2)),
                          height_ratios=(z, y) if flat else None)
    side, above = axes.flat
    for method, style in _many(shown):
        x = shown.runs[method].x[:, -1]
        side.plot(x[:, 0], x[:, 2], **style)
        above.plot(x[:, 0], x[:, 1], **style)
    side.set(xlabel="x (m)", ylabel="z (m)", aspect="equal")
    above.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    _legend(figure, side, 4)
    return Drawing("path-methods", figure, f"Path of the mass centre of {tex(shown.scene.bodies[-1].name)} by every "
                   f"method, from the side and from above. {_caption(shown)}")


def _energies(shown: Shown, method: str) -> Drawing:
    """Fig. 3 and 13 of P1: kinetic, potential and total energy; beside it the total energy of every method."""
    figure, axes = _sheet(6.4, 3.2, 1, 2)
    traj = shown.runs[method]
    for label, values, colour in (("kinetic", traj.kinetic_energy, COLOURS[3]),
                                  ("potential", traj.potential_energy, COLOURS[4]),
                                  ("total", traj.energy, COLOURS[7])):
        axes[0, 0].plot(traj.t, values, color=colour, linewidth=0.9, label=label)
    axes[0, 0].set(xlabel="t (s)", ylabel="energy (J)", title=method)
    axes[0, 0].legend()
    for name, style in _many(shown):
        axes[0, 1].plot(shown.runs[name].t, shown.runs[name].energy, **style)
    axes[0, 1].set(xlabel="t (s)", ylabel="total energy (J)", title="every method")
    _legend(figure, axes[0, 1], 4)
    return Drawing("energy", figure, f"Kinetic, potential and total energy by {tex(method)}, and the total energy by "
                   f"every method. The potential is zero at the origin. {_caption(shown)}")


def _levels(shown: Shown) -> Drawing:
    """Fig. 4 to 7 and 14 of P1: the three constraint levels."""
    figure, axes = _sheet(6.4, 6.4, 3, 1, sharex=True)
    for row, (level, _, label) in enumerate(LEVELS):
        for method, style in _many(shown, PEAKS):
            values = getattr(shown.runs[method], f"constraint_{level}")
            if values is not None:
                axes[row, 0].semilogy(*_peaks(shown.runs[method].t, values), **style)
        axes[row, 0].set(ylabel=label)
    axes[2, 0].set(xlabel="t (s)")
    _legend(figure, axes[0, 0], 4)
    return Drawing("levels", figure, "Constraints at the levels of position, velocity and acceleration: largest entry "
                   "at the output times in each fiftieth of the run; exact zeros are drawn at "
                   f"{SMALLEST:g}. {_caption(shown)}")


def _peaks(t: np.ndarray, values: np.ndarray) -> tuple[list[float], list[float]]:
    """Mean time (s) and largest value of each of `PEAKS` parts of a run."""
    parts = np.array_split(np.arange(len(t)), min(PEAKS, len(t)))
    return [float(t[part].mean()) for part in parts], [max(float(values[part].max()), SMALLEST) for part in parts]


def _rotation(shown: Shown, method: str, body: int) -> Drawing:
    """Fig. 8 and 15 of P1: the nine elements of a rotation matrix."""
    figure, axes = _sheet(6.4, 4.8, 3, 3, sharex=True, sharey=True)
    traj, name = shown.runs[method], shown.scene.bodies[body].name
    for row in range(3):
        for column in range(3):
            axes[row, column].plot(traj.t, traj.R[:, body, row, column], color=COLOURS[3], linewidth=0.8)
            axes[row, column].set(title=f"$R_{{{row + 1}{column + 1}}}$", ylim=(-1.1, 1.1))
    for column in range(3):
        axes[2, column].set(xlabel="t (s)")
    return Drawing(f"rotation-{name}", figure, f"The nine elements of the rotation matrix of {tex(name)}, from body "
                   f"to world axes, by {tex(method)}. {_caption(shown)}")


def _orthogonality(shown: Shown) -> Drawing:
    """Fig. 9, 10 and 16 of P1: with the polish after every step, and by the group update alone."""
    figure, axes = _sheet(6.4, 3.2, 1, 2, sharey=True)
    for method, style in _many(shown, PEAKS):
        traj = shown.runs[method]
        axes[0, 0].semilogy(*_peaks(traj.t, traj.orthogonality), **style)
        if method in shown.unpolished:
            axes[0, 1].semilogy(*_peaks(traj.t, shown.unpolished[method]), **style)
    axes[0, 0].set(xlabel="t (s)", ylabel=r"max $|R^T R - I|$", title="with the polish after every step")
    axes[0, 1].set(xlabel="t (s)", title="group update alone")
    _legend(figure, axes[0, 0], 4)
    return Drawing("orthogonality", figure, "Orthogonality error of the rotation matrices, with the polish after every "
                   "step and without it: largest entry over all bodies at the output times in each fiftieth of the "
                   f"run. {_caption(shown)}")


def _caption(shown: Shown) -> str:
    return (f"Scene {tex(shown.scene.name)}, step {1e3 * shown.step:g}\\,ms, {shown.scene.duration:g}\\,s"
            + (f", map {tex(shown.lines[0].coordinate_map)}." if shown.lines[0].coordinate_map else "."))


def tex(name: str) -> str:
    """A name in typewriter type."""
    return r"\texttt{" + files.tex(name) + "}"
