"""Scenes of this folder with every sensor, their motion by `mechanics`, and by a source of crosscheck."""

from __future__ import annotations

import functools
import json
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

import crosscheck
from tests.oracle_values.figures import Figures, watched
from tests.oracle_values.mechanics import Mechanism
from tests.oracle_values.motion import motion

FOLDER = Path(__file__).parent / "scenes"
NAMES = tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))
TOLERANCE = 3e-9
"""Of the largest value over the run: own integration and that of the source at 1e-11, through motions that double an
error up to eight times."""


def loaded(data: dict[str, Any]) -> Any:
    """The scene of a file's content, read as a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{data['name']}.json"
        path.write_text(json.dumps(data))
        return crosscheck.load_scene(path)


@functools.cache
def content(name: str) -> dict[str, Any]:
    return watched(tomllib.loads((FOLDER / f"{name}.toml").read_text()))


@functools.cache
def mechanism(name: str) -> Mechanism:
    return Mechanism(content(name))


@functools.cache
def scene(name: str) -> Any:
    return loaded(content(name))


@functools.cache
def figures(name: str) -> tuple[Figures, ...]:
    """At the times of the scene."""
    data, mech = content(name), mechanism(name)
    return tuple(Figures(mech, state) for state in motion(mech, np.linspace(0, data["duration"], data["samples"])))


@functools.cache
def source(name: str, who: str) -> Any:
    """Truth, or the run of an engine."""
    if who == "truth":
        return crosscheck.truth(scene(name))
    return crosscheck.run(scene(name), engine="lieeuler", method="rkmk853", rtol=1e-11)


TREES = tuple(name for name in NAMES if not mechanism(name).loops)
OPEN = tuple(name for name in TREES if not any(link.turned or "drive" in link.entry or "mimic" in link.entry
                                               for link in mechanism(name).links))
"""Those whose coordinates are all free."""


def close(value: Any, wanted: Any, what: str, tolerance: float = TOLERANCE) -> None:
    """The same to a part of the largest; one value may come as a list of one."""
    wanted = np.asarray(wanted, float)
    value = np.asarray(value, float).reshape(wanted.shape)
    off = np.abs(value - wanted).max(initial=0.0) / max(1.0, np.abs(wanted).max(initial=0.0))
    assert off <= tolerance, f"{what}: {off:.1e} off, {value.ravel()[-6:]}, right {wanted.ravel()[-6:]}"
