"""Pages of modes, with their shapes in motion and eigenvalues over a number, and of derivatives."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.optimize import linear_sum_assignment

from crosscheck.compare.sizes import length_of
from crosscheck.jointspace.derivatives import Derivatives, tangent_space
from crosscheck.jointspace.modes import Modes
from crosscheck.jointspace.motion import shifted
from crosscheck.jointspace.sources import taken
from crosscheck.jointspace.verdicts import Verdict
from crosscheck.report.standalone import page_of
from crosscheck.scene.assembly import projected
from crosscheck.scene.model import Scene
from crosscheck.scene.paths import unit
from crosscheck.verification.curves import drawing, quaternions

PICTURES, SEEN = 120, 0.3
"""Instants of a shape in motion, and its largest turn (rad) or shift (of the lengths of all bodies) in the picture."""

PERIODS, DECAYS = 2.0, 4.0
"""How long a shape is shown: periods of the slowest that swings, or time constants of the slowest of the others."""


def write_modes(folder: Path, scene: Scene, modes: Modes, path: str, over: Mapping[float, np.ndarray]) -> Path:
    """The page of modes; `over` has the eigenvalues by values of the number at `path`, if there is one."""
    kept = [k for k, value in enumerate(modes.eigenvalues) if value != 0 and value.imag >= 0]
    return page_of(folder, "modes.html.j2", scene=scene, values=[_eigenvalue(modes.eigenvalues[k]) for k in kept],
                 zeros=int(np.count_nonzero(modes.eigenvalues == 0)), path=path, curves=_branches(path, over),
                 drawn=_drawn(scene, modes, kept) if kept else None)


def _eigenvalue(value: complex) -> dict[str, object]:
    """What a table says of an eigenvalue."""
    rate, swing = float(value.real), float(value.imag)
    return {"label": f"{rate:.4g} ± {swing:.4g}i" if swing else f"{rate:.4g}", "growth": rate, "swing": swing,
            "period": 2 * np.pi / swing if swing else None, "time": np.log(2) / abs(rate) if rate else None}


def _branches(path: str, over: Mapping[float, np.ndarray]) -> dict[str, object] | None:
    """Curves for Plotly: each eigenvalue goes on straight to the nearest one; those of zero are left out."""
    if not over:
        return None
    rows = [np.array(values) for values in over.values()]
    for k in range(1, len(rows)):
        ahead = 2 * rows[k - 1] - rows[max(k - 2, 0)]
        rows[k] = rows[k][linear_sum_assignment(np.abs(ahead[:, None] - rows[k][None]))[1]]
    table, x = np.array(rows).T, [*over]
    traces = []
    for number, row in enumerate(table[np.abs(table).max(axis=1) > 0]):
        traces.append({"x": x, "y": row.real.tolist(), "branch": number, "name": "growth"})
        if (row.imag > 0).any():
            traces.append({"x": x, "y": np.where(row.imag > 0, row.imag, np.nan).tolist(), "branch": number,
                           "name": "angular frequency"})
    for trace in traces:
        trace["y"] = [value if np.isfinite(value) else None for value in trace["y"]]
    return {"traces": traces, "label": f"{path.replace('.', ' ')} ({unit(path)})" if unit(path) else path}


def _drawn(scene: Scene, modes: Modes, kept: Sequence[int]) -> dict[str, object]:
    """Each shape in motion about the start, with its own growth, as large as can be seen, and joints closed."""
    values = modes.eigenvalues[kept]
    swings, rates = values.imag[values.imag > 0], np.abs(values.real[values.real != 0])
    last = PERIODS * 2 * np.pi / swings.min() if len(swings) else DECAYS / rates.min()
    t = np.linspace(0.0, float(last), PICTURES)
    actors = []
    for k, value in zip(kept, values, strict=True):
        changes = np.real(np.exp(value * t)[:, None] * modes.shapes[:, k]).reshape(PICTURES, scene.n, 6)
        sizes = [float(np.linalg.norm(part, axis=2).max()) for part in np.split(changes, 2, axis=2)]
        changes *= SEEN / max(sizes[0] / (length_of(scene) * scene.n), sizes[1])
        still = np.zeros(6 * scene.n)
        poses = [projected(scene, shifted(scene, np.concatenate([row.ravel(), still]))) for row in changes]
        actors.append({"label": _eigenvalue(value)["label"], **_moves([(pose.x0, pose.R0) for pose in poses])})
    actors.append({"label": "start", **_moves([(scene.x0, scene.R0)] * PICTURES)})
    return {"t": t.tolist(), "drawing": msgspec.to_builtins(drawing(scene)), "actors": actors}


def _moves(poses: list[tuple[np.ndarray, np.ndarray]]) -> dict[str, object]:
    x, R = (np.array(part) for part in zip(*poses, strict=True))
    return {"x": np.moveaxis(x, 0, -1).round(10).tolist(), "q": quaternions(R).round(10).tolist()}


def write_derivatives(folder: Path, scene: Scene, exact: Derivatives, verdicts: Sequence[Verdict],
                      skipped: Mapping[str, str]) -> Path:
    """The page of derivatives: blocks of truth, and each source with error, verdict, cause and cost."""
    along = None if exact.da_dq is not None else tangent_space(scene).changes
    rows: list[dict[str, Any]] = []
    for each in verdicts:
        begun = time.process_time()
        taken(scene, each.source, along)  # again, so that nothing is loaded or compiled in it
        rows.append({"source": each.source, "errors": each.errors, "bound": each.bound, "right": each.right,
                     "cause": each.cause, "worst": max(each.errors.values()),
                     "cost": 1e3 * (time.process_time() - begun)})
    blocks = {name: values for name, values in exact.blocks.items() if name != "matrix"} or exact.blocks
    return page_of(folder, "derivatives.html.j2", scene=scene, exact=exact, blocks=blocks, rows=rows, skipped=skipped,
                 names=[*verdicts[0].errors] if verdicts else [], curve=[
                     {"eps": float(row["source"].partition("@")[2]), **row} for row in rows
                     if "inverseFD@" in row["source"]])
