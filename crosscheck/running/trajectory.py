"""Trajectories: the states of a run, and what follows from them by the same formulas for all engines."""

from __future__ import annotations

import dataclasses
import functools
import html
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from crosscheck.adapters.base import RawRun, Stats
from crosscheck.errors import ArgumentError, needing
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.coordinates import JointHistory, histories
from crosscheck.scene.events import events as happened
from crosscheck.scene.model import Scene
from crosscheck.scene.monitor import MAXIMA, level_norms
from crosscheck.scene.sensors import Readings, readings
from crosscheck.scene.sensors import columns as sensor_columns
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from crosscheck.document import Record

VECTORS = {"x": "m", "v": "m/s", "w": "rad/s", "a": "m/s^2", "alpha": "rad/s^2"}
SERIES = {"energy": "J", "kinetic_energy": "J", "momentum_vertical": "kg m^2/s", "orthogonality": "1",
          "constraint_position": "m", "constraint_velocity": "m/s", "constraint_acceleration": "m/s^2"}


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A run at its output times: T samples of n bodies, in SI units, with the frames of `crosscheck.scene.states`.

    `a`, `alpha` and `constraint_acceleration` are None if the engine gives no accelerations, `lam` and `reactions` if
    it gives no multipliers. At t = 0 they are computed from the initial state by the index-1 equations.
    """

    scene: Scene
    engine: str
    method: str
    form: str | None
    t: np.ndarray  # (T,)
    x: np.ndarray  # (T, n, 3) world
    R: np.ndarray  # (T, n, 3, 3) body to world
    v: np.ndarray  # (T, n, 3) world
    w: np.ndarray  # (T, n, 3) body axes
    a: np.ndarray | None  # (T, n, 3) world
    alpha: np.ndarray | None  # (T, n, 3) body axes
    lam: np.ndarray | None  # (T, m)
    energy: np.ndarray  # (T,) J
    kinetic_energy: np.ndarray  # (T,) J, a part of `energy`
    momentum_vertical: np.ndarray  # (T,) kg m^2/s, about the upward vertical through the origin
    orthogonality: np.ndarray  # (T,) max-norm of R^T R - I
    constraint_position: np.ndarray  # (T,) max-norm of Phi
    constraint_velocity: np.ndarray  # (T,) max-norm of G u
    constraint_acceleration: np.ndarray | None  # (T,) max-norm of G du/dt + gamma
    reactions: dict[str, tuple[np.ndarray, np.ndarray]] | None  # force, torque (T, 3) on the child at its anchor, world
    wall_time: float  # s, stepping only
    steps: int
    status: str
    stats: Stats  # counters of the run, "step" (s), and the maxima over every step under the keys of MAXIMA
    own_sensors: Mapping[str, np.ndarray] | None = None  # readings that the engine made itself
    events: tuple[tuple[float, str, str], ...] = ()  # time (s), joint or monitor, and what happened there
    hinges: np.ndarray | None = None  # (T, h) rad, as of `crosscheck.scene.states.States`
    judge: Callable[[Trajectory, str, float], Record | None] | None = None  # of `verdict`; None for an engine object

    @functools.cached_property
    def work(self) -> np.ndarray:
        """Work of loads, dampers, drives, laws and impacts since the start, (T,) J; see `crosscheck.running.work`."""
        from crosscheck.running.work import work

        return work(self.scene, self)

    def __repr__(self) -> str:
        until = f"{self.t[-1]:.6g} s" if len(self.t) else "its start"
        return (f"Trajectory({self.scene.name}: {self.engine} {self.method}{f', {self.form}' if self.form else ''}, "
                f"{self.status}, {len(self.t)} samples to {until}, {self.steps} steps)")

    def _repr_html_(self) -> str:
        """A small HTML table of the run's main figures, for a notebook."""
        rows = {"scene": self.scene.name, "engine": f"{self.engine} {self.method}", "form": self.form or "",
                "status": self.status, "until": f"{self.t[-1]:g} s" if len(self.t) else "", "steps": str(self.steps),
                "stepping": f"{1e3 * self.wall_time:.3g} ms",
                "change of energy": f"{np.ptp(self.energy):.3g} J" if len(self.t) else "",
                "largest joint gap": f"{np.max(self.constraint_position, initial=0.0):.3g} m"}
        lines = "".join(f"<tr><th>{name}</th><td>{html.escape(value)}</td></tr>" for name, value in rows.items())
        return f"<table>{lines}</table>"

    def verdict(self, name: str = "", need: float = 1.0) -> Record | None:
        """The verdict of `crosscheck run`: the engine is run again by parts, at the asked and at smaller steps.

        `.outcome`, `.findings`, `.errors` by quantity, `.order`, `.resolution` and `.share` are as in results.json;
        `name` is that of the scene in it, `need` the share of its time over which the motion has to be judged for it to
        pass. None where the run has neither a step nor a tolerance that could be made smaller.

        Raises
        ------
        ArgumentError
            The engine was given as an object, so that nothing says how to run it again.
        """
        if self.judge is None:
            raise ArgumentError("verdict: the engine is run again by its name; give crosscheck.run a name, "
                                "module:Class or path/file.py:Class, no object")
        return self.judge(self, name or self.scene.name, need)

    def to_frame(self) -> pd.DataFrame:
        """A `pandas.DataFrame` with one row per output time, indexed by `t` (s); needs the extra `data`.

        The columns are "BODY.x_x" ... "BODY.R_33" ... "BODY.w_z" for every body, then energies, constraint levels,
        multipliers, and sensors as "NAME" or "NAME.x", all in SI units; "sensor.NAME" where that is taken.
        """
        with needing("to_frame"):
            import pandas as pd
        columns: dict[str, np.ndarray] = {}
        for k, body in enumerate(self.scene.bodies):
            for name in ("x", "R", *tuple(VECTORS)[1:]):
                values = getattr(self, name)
                if values is None:
                    continue
                if name == "R":
                    columns |= {f"{body.name}.R_{i + 1}{j + 1}": values[:, k, i, j] for i in range(3) for j in range(3)}
                else:
                    columns |= {f"{body.name}.{name}_{axis}": values[:, k, i] for i, axis in enumerate("xyz")}
        columns |= {name: getattr(self, name) for name in SERIES if getattr(self, name) is not None}
        if self.lam is not None:
            columns |= {f"lam_{row}": self.lam[:, row] for row in range(self.lam.shape[1])}
        columns |= _under_free_names(sensor_columns(self.sensors), {*columns, "t"})
        made = pd.DataFrame(columns, index=pd.Index(self.t, name="t"))
        made.attrs = self._attributes()
        return made

    def to_xarray(self) -> xr.Dataset:
        """An `xarray.Dataset` over t, body and axis, with units as attributes (needs the extra `data`).

        A sensor has its name, or "sensor.NAME" where that is taken.
        """
        with needing("to_xarray"):
            import xarray as xr
        axis = list("xyz")
        arrays: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {
            name: (("t", "body", "axis"), getattr(self, name), {"units": unit})
            for name, unit in VECTORS.items() if getattr(self, name) is not None}
        arrays["R"] = (("t", "body", "axis", "body_axis"), self.R,
                       {"units": "1", "long_name": "attitude, body to world"})
        arrays |= {name: (("t",), getattr(self, name), {"units": unit}) for name, unit in SERIES.items()
                   if getattr(self, name) is not None}
        if self.lam is not None:
            arrays["lam"] = (("t", "row"), self.lam, {})
        coordinates = {"t": ("t", self.t, {"units": "s"}), "body": [body.name for body in self.scene.bodies],
                       "axis": axis, "body_axis": axis}
        arrays |= _under_free_names({
            name: (("t", f"{name} part")[:values.ndim], values, {"source": self.sensors.source[name]})
            for name, values in self.sensors.items()}, {*arrays, *coordinates, "row"})
        return xr.Dataset(arrays, coordinates, self._attributes())

    def plot(self) -> Figure:
        """A matplotlib figure of heights, angular speeds, energy and constraint levels (needs the extra `report`)."""
        with needing("plot"):
            from matplotlib.figure import Figure
        made = Figure(figsize=(9, 6), layout="constrained")
        heights, speeds, energy, levels = made.subplots(2, 2, sharex=True).ravel()
        for k, body in enumerate(self.scene.bodies):
            heights.plot(self.t, self.x[:, k, 2], label=body.name)
            speeds.plot(self.t, np.linalg.norm(self.w[:, k], axis=1), label=body.name)
        energy.plot(self.t, self.energy - self.energy[0])
        for name in ("constraint_position", "constraint_velocity", "constraint_acceleration"):
            values = getattr(self, name)
            if values is not None:
                levels.semilogy(self.t, np.maximum(values, np.finfo(float).tiny),
                                label=name.removeprefix("constraint_"))
        for axes, title in ((heights, "z (m)"), (speeds, "|w| (rad/s)"), (energy, "energy - start (J)"),
                            (levels, "constraint levels (SI)")):
            axes.set_ylabel(title)
        for axes in (energy, levels):
            axes.set_xlabel("t (s)")
        heights.legend(frameon=False)
        levels.legend(frameon=False)
        made.suptitle(f"{self.scene.name}: {self.engine} {self.method}")
        return made

    def to_rerun(self, path: str | os.PathLike[str]) -> None:
        """Write bodies, paths and energies for the rerun viewer (.rrd, single precision; needs the extra `rerun`).

        A body is drawn as the ellipsoid of uniform density that has its mass and principal moments of inertia.
        """
        with needing("to_rerun"):
            import rerun as rr
        recording = rr.RecordingStream(f"crosscheck {self.scene.name}", send_properties=False)
        try:
            recording.save(os.fspath(path))
        except (OSError, RuntimeError) as error:
            raise ArgumentError(f"to_rerun {os.fspath(path)}: the file cannot be written ({error})") from None
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        times = [rr.TimeColumn("t", duration=self.t)]
        for k, body in enumerate(self.scene.bodies):
            moments, axes = np.linalg.eigh(self.scene.inertias[k])
            # An ellipsoid with semi-axes a, b, c has the moments m (b^2 + c^2) / 5 and so on.
            # Hence a^2 = 5 (sum of the moments / 2 - its own moment) / m.
            half = np.sqrt(np.maximum(2.5 * (moments.sum() - 2 * moments), 0.0) / (body.mass or 1.0))
            axes[:, 0] *= np.linalg.det(axes)  # a rotation, not a reflection
            recording.send_columns(f"bodies/{body.name}", times, rr.Transform3D.columns(
                translation=self.x[:, k], mat3x3=self.R[:, k]))
            recording.log(f"bodies/{body.name}/shape", rr.Transform3D(mat3x3=axes), rr.Ellipsoids3D(
                half_sizes=[half], labels=[body.name]), static=True)
            recording.log(f"paths/{body.name}", rr.LineStrips3D([self.x[:, k]]), static=True)
        for name in SERIES:
            if (values := getattr(self, name)) is not None:
                recording.send_columns(f"figures/{name}", times, rr.Scalars.columns(scalars=values))
        recording.disconnect()

    def _attributes(self) -> dict[str, str | int | float]:
        return {"scene": self.scene.name, "scene_hash": self.scene.hash, "engine": self.engine, "method": self.method,
                "form": self.form or "", "status": self.status, "steps": int(self.steps),
                "wall_time": float(self.wall_time)}

    @functools.cached_property
    def joints(self) -> dict[str, JointHistory]:
        """`.position` and `.velocity` over time, by name, of the joints that have coordinates.

        An angle is NaN from where the engine has not counted its turns and the samples do not tell them.
        """
        return histories(self.scene, self)

    @functools.cached_property
    def sensors(self) -> Readings:
        """Readings of the scene's sensors by name, (T, 3), (T, 4) or (T,); `.source` says who made each."""
        states = States(self.t, self.x, self.R, self.v, self.w, self.a, self.alpha, hinges=self.hinges)
        return readings(self.scene, states, self.own_sensors)

    @property
    def maxima(self) -> dict[str, float]:
        """The maxima over every step under the keys of `crosscheck.scene.monitor.MAXIMA`; empty if monitor=False."""
        return {key: value for key, value in self.stats.items() if key in MAXIMA and isinstance(value, float | int)}

    @property
    def potential_energy(self) -> np.ndarray:
        """(T,) J. It is zero if all mass centres are at the origin and all springs at rest."""
        potential: np.ndarray = self.energy - self.kinetic_energy
        return potential


def derive(scene: Scene, engine: str, method: str, raw: RawRun) -> Trajectory:
    """The trajectory of an engine's raw run, with energies, constraint levels and reactions computed from its states.

    If the engine gives accelerations or multipliers, their first values are replaced by those of the index-1 equations,
    which hold where no joint rests on friction or a stop.
    """
    s = raw.states
    a, alpha, lam = s.a, s.alpha, s.lam
    constraints = Constraints(scene)
    with np.errstate(over="ignore", invalid="ignore"):
        if len(s.t) and (a is not None or lam is not None) and not scene.has_laws:
            start = mechanics.index1(scene, s.x[:1], s.R[:1], s.v[:1], s.w[:1], t=s.t[:1])
            a, alpha, lam = (None if values is None else np.concatenate([first, values[1:]])
                             for values, first in zip((a, alpha, lam), start, strict=True))
        levels = level_norms(constraints, s.x, s.R, s.v, s.w, a, alpha, s.t,
                             constraints.leaders_at(s) if constraints.followers else None)
        return Trajectory(
            scene=scene, engine=engine, method=method, form=raw.form, t=s.t, x=s.x, R=s.R, v=s.v, w=s.w,
            a=a, alpha=alpha, lam=lam, energy=mechanics.energy(scene, s),
            kinetic_energy=mechanics.kinetic_energy(scene, s),
            momentum_vertical=mechanics.momentum_vertical(scene, s), orthogonality=mechanics.orthogonality(s.R),
            reactions=None if lam is None else constraints.reactions(s.x, s.R, lam), wall_time=raw.wall_time,
            steps=raw.steps, status=raw.status,
            stats=cast(Stats, {**raw.stats, "step": raw.step, **(raw.maxima or {})}), own_sensors=s.sensors,
            events=raw.events or happened(scene, s), hinges=s.hinges, **levels)


def _under_free_names(sensors: Mapping[str, Any], taken: set[str]) -> dict[str, Any]:
    """Sensors by names that are not taken."""
    return {f"sensor.{name}" if name in taken else name: value for name, value in sensors.items()}
