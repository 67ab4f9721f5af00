"""States over time as CSV, to a file or to the terminal."""

from __future__ import annotations

import contextlib
import csv
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from crosscheck.errors import ArgumentError
from crosscheck.files import cell, replacing


def write_csv(scene: Any, states: Any, target: str) -> None:
    """Write states as CSV, one line per output time, in full precision; `target` is a path, or - for the terminal."""
    from crosscheck.scene.sensors import columns, unit  # here: `crosscheck --help` does without NumPy

    header = ["t [s]"]
    for body in scene.bodies:
        header += [f"{body.name} x_{axis} [m]" for axis in "xyz"]
        header += [f"{body.name} R_{row}{column}" for row in "123" for column in "123"]
        header += [f"{body.name} v_{axis} [m/s]" for axis in "xyz"]
        header += [f"{body.name} w_{axis} [rad/s]" for axis in "xyz"]
    extra = {"kinetic_energy": "kinetic energy [J]", "potential_energy": "potential energy [J]",
             "energy": "energy [J]", "constraint_position": "constraint position",
             "constraint_velocity": "constraint velocity", "constraint_acceleration": "constraint acceleration",
             "orthogonality": "orthogonality"}
    series = {title: getattr(states, name) for name, title in extra.items() if getattr(states, name, None) is not None}
    units = {sensor.name: unit(scene, sensor) for sensor in scene.sensors}
    read = getattr(states, "sensors", None) or {}
    series |= {f"{column} [{units[name]}]": values for name in read
               for column, values in columns({name: read[name]}).items()}
    with _stream(target) as stream:
        writer = csv.writer(stream)
        writer.writerow([cell(title) for title in (*header, *series)])
        for k, time in enumerate(states.t):
            row = [time]
            for i in range(scene.n):
                row += [*states.x[k, i], *states.R[k, i].ravel(), *states.v[k, i], *states.w[k, i]]
            writer.writerow([repr(float(value)) for value in [*row, *(values[k] for values in series.values())]])


@contextlib.contextmanager
def _stream(target: str) -> Iterator[IO[str]]:
    """The terminal, a file that appears when it is complete, or an existing pipe or device."""
    if target == "-":
        yield sys.stdout
        return
    path = Path(target)
    whole = contextlib.nullcontext(path) if path.exists() and not path.is_file() else replacing(path)
    try:
        with whole as aside, open(aside, "w", newline="", encoding="utf-8") as stream:
            yield stream
    except OSError as error:
        raise ArgumentError(f"--csv {target}: cannot be written ({error.strerror})") from None
