"""Trajectories for other tools: pandas, xarray, matplotlib, the rerun viewer, and HTML for a notebook."""

from __future__ import annotations

import html
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.errors import ArgumentError, missing

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

Trajectory = Any
"""A `crosscheck.Trajectory`. Not imported here: its methods call these functions, so that it imports this module."""

VECTORS = {"x": "m", "v": "m/s", "w": "rad/s", "a": "m/s^2", "alpha": "rad/s^2"}
SERIES = {"energy": "J", "kinetic_energy": "J", "momentum_vertical": "kg m^2/s", "orthogonality": "1",
          "constraint_position": "m", "constraint_velocity": "m/s", "constraint_acceleration": "m/s^2"}


def frame(traj: Trajectory) -> pd.DataFrame:
    """One row per output time, indexed by `t` (s).

    The columns are "BODY.x_x" ... "BODY.R_33" ... "BODY.w_z" for every body, then energies, constraint levels and
    multipliers, all in SI units.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise ArgumentError(f"to_frame: {missing(error)}") from None
    columns: dict[str, np.ndarray] = {}
    for k, body in enumerate(traj.scene.bodies):
        for name in ("x", "R", *tuple(VECTORS)[1:]):
            values = getattr(traj, name)
            if values is None:
                continue
            if name == "R":
                columns |= {f"{body.name}.R_{i + 1}{j + 1}": values[:, k, i, j] for i in range(3) for j in range(3)}
            else:
                columns |= {f"{body.name}.{name}_{axis}": values[:, k, i] for i, axis in enumerate("xyz")}
    columns |= {name: getattr(traj, name) for name in SERIES if getattr(traj, name) is not None}
    if traj.lam is not None:
        columns |= {f"lam_{row}": traj.lam[:, row] for row in range(traj.lam.shape[1])}
    made = pd.DataFrame(columns, index=pd.Index(traj.t, name="t"))
    made.attrs = _attributes(traj)
    return made


def dataset(traj: Trajectory) -> xr.Dataset:
    """The trajectory's arrays over t, body and axis, with their units as attributes."""
    try:
        import xarray as xr
    except ImportError as error:
        raise ArgumentError(f"to_xarray: {missing(error)}") from None
    axis = list("xyz")
    arrays: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {
        name: (("t", "body", "axis"), getattr(traj, name), {"units": unit})
        for name, unit in VECTORS.items() if getattr(traj, name) is not None}
    arrays["R"] = (("t", "body", "axis", "body_axis"), traj.R, {"units": "1", "long_name": "attitude, body to world"})
    arrays |= {name: (("t",), getattr(traj, name), {"units": unit}) for name, unit in SERIES.items()
               if getattr(traj, name) is not None}
    if traj.lam is not None:
        arrays["lam"] = (("t", "row"), traj.lam, {})
    coordinates = {"t": ("t", traj.t, {"units": "s"}), "body": [body.name for body in traj.scene.bodies], "axis": axis,
                   "body_axis": axis}
    return xr.Dataset(arrays, coordinates, _attributes(traj))


def figure(traj: Trajectory) -> Figure:
    """Plot heights, angular speeds, change of energy and constraint levels over time."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ArgumentError(f"plot: {missing(error)}") from None
    made = Figure(figsize=(9, 6), layout="constrained")
    heights, speeds, energy, levels = made.subplots(2, 2, sharex=True).ravel()
    for k, body in enumerate(traj.scene.bodies):
        heights.plot(traj.t, traj.x[:, k, 2], label=body.name)
        speeds.plot(traj.t, np.linalg.norm(traj.w[:, k], axis=1), label=body.name)
    energy.plot(traj.t, traj.energy - traj.energy[0])
    for name in ("constraint_position", "constraint_velocity", "constraint_acceleration"):
        values = getattr(traj, name)
        if values is not None:
            levels.semilogy(traj.t, np.maximum(values, np.finfo(float).tiny), label=name.removeprefix("constraint_"))
    for axes, title in ((heights, "z (m)"), (speeds, "|w| (rad/s)"), (energy, "energy - start (J)"),
                        (levels, "constraint levels (SI)")):
        axes.set_ylabel(title)
    for axes in (energy, levels):
        axes.set_xlabel("t (s)")
    heights.legend(frameon=False)
    levels.legend(frameon=False)
    made.suptitle(f"{traj.scene.name}: {traj.engine} {traj.method}")
    return made


def record(traj: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a recording (.rrd): moving bodies, paths of their mass centres, energies and constraint levels over `t`.

    A body is drawn as the ellipsoid of uniform density that has its mass and principal moments of inertia.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise ArgumentError(f"to_rerun: {missing(error)}") from None
    recording = rr.RecordingStream(f"crosscheck {traj.scene.name}", send_properties=False)
    try:
        recording.save(os.fspath(path))
    except (OSError, RuntimeError) as error:
        raise ArgumentError(f"to_rerun {os.fspath(path)}: the file cannot be written ({error})") from None
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    times = [rr.TimeColumn("t", duration=traj.t)]
    for k, body in enumerate(traj.scene.bodies):
        moments, axes = np.linalg.eigh(traj.scene.inertias[k])
        # An ellipsoid with semi-axes a, b, c has the moments m (b^2 + c^2) / 5 and so on.
        # Hence a^2 = 5 (sum of the moments / 2 - its own moment) / m.
        half = np.sqrt(np.maximum(2.5 * (moments.sum() - 2 * moments), 0.0) / body.mass)
        axes[:, 0] *= np.linalg.det(axes)  # a rotation, not a reflection
        recording.send_columns(f"bodies/{body.name}", times, rr.Transform3D.columns(
            translation=traj.x[:, k], mat3x3=traj.R[:, k]))
        recording.log(f"bodies/{body.name}/shape", rr.Transform3D(mat3x3=axes), rr.Ellipsoids3D(
            half_sizes=[half], labels=[body.name]), static=True)
        recording.log(f"paths/{body.name}", rr.LineStrips3D([traj.x[:, k]]), static=True)
    for name in SERIES:
        if (values := getattr(traj, name)) is not None:
            recording.send_columns(f"figures/{name}", times, rr.Scalars.columns(scalars=values))
    recording.disconnect()


def table(traj: Trajectory) -> str:
    """A small HTML table of the run's main figures, for a notebook."""
    rows = {"scene": traj.scene.name, "engine": f"{traj.engine} {traj.method}", "form": traj.form or "",
            "status": traj.status, "until": f"{traj.t[-1]:g} s" if len(traj.t) else "", "steps": str(traj.steps),
            "stepping": f"{1e3 * traj.wall_time:.3g} ms",
            "change of energy": f"{np.ptp(traj.energy):.3g} J" if len(traj.t) else "",
            "largest joint gap": f"{np.max(traj.constraint_position, initial=0.0):.3g} m"}
    lines = "".join(f"<tr><th>{name}</th><td>{html.escape(value)}</td></tr>" for name, value in rows.items())
    return f"<table>{lines}</table>"


def _attributes(traj: Trajectory) -> dict[str, str | int | float]:
    return {"scene": traj.scene.name, "scene_hash": traj.scene.hash, "engine": traj.engine, "method": traj.method,
            "form": traj.form or "", "status": traj.status, "steps": int(traj.steps),
            "wall_time": float(traj.wall_time)}
