"""Right and wrong recordings: what they are of, how they are written, and what a judge should say of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.recordings.motions import (
    SCENES,
    TIMES,
    arm,
    by_exudyn,
    by_mujoco,
    by_pinocchio,
    imu,
    lawful,
    sled,
    slider,
    top,
    tumbler,
    two,
)

Columns = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Right:
    """A recording of the right motion."""

    scene: str
    make: Callable[[], Columns]
    keep: str = ""  # the names of its columns contain this
    style: str = "csv"
    tolerance: float = 1e-6
    start: str = "scene"


@dataclasses.dataclass(frozen=True)
class Wrong:
    """A recording with a mistake, and the names that a judge may give it."""

    kind: str
    scene: str
    make: Callable[[], Columns]
    names: tuple[str, ...]
    mapping: Any = None


UNEVEN = np.sort(np.concatenate([[0.0], np.random.default_rng(3).uniform(0.001, 2.0, 150)]))
LATE = np.linspace(0.5, 2.0, 151)

CONTINUOUS = (-0.5, 30.0, 1.0, 6.0, None, 0)
SAMPLED = (-0.5, 30.0, 1.0, 6.0, 0.02, 1)
LAWS = {"rough": {"friction": (1.5, 1.5)}, "bounce": {"stop": 0.9, "bounce": 0.5}, "stop": {"stop": 0.9},
        "soft": {"soft": (0.9, 60.0, 0.4)}, "servo": {"servo": CONTINUOUS}, "sampled": {"servo": SAMPLED}}
"""What makes the motions of the scenes with laws of a hinge."""

FEW = np.linspace(0.0, 2.0, 41)
"""Rows 0.05 s apart: several impacts, and samples of a servo, in one interval."""


def _law(scene: str, t: np.ndarray = TIMES, **changes: Any) -> Callable[[], Columns]:
    return lambda: lawful(t, **(LAWS[scene] | changes))


RIGHT = [
    *(Right(scene, make, keep, style) for scene, make, keep in (
        ("arm", arm, ""), ("two", two, ""), ("tumbler", tumbler, ""), ("top", top, ""), ("slider", slider, ""))
      for style in ("csv", "semicolon", "npz", "mapped")),
    *(Right("two", two, keep, style) for keep, style in (
        ("position", "csv"), ("elbow", "tab"), ("velocity", "frame"), ("fore.q", "parquet"), ("upper.v", "matrix"))),
    Right("tumbler", tumbler, "", "matrix"), Right("tumbler", tumbler, "brick.q", "parquet"),
    Right("tumbler", tumbler, "", "digits6"), Right("arm", arm, "pivot", "digits3"), Right("top", top, "", "digits6"),
    Right("arm", lambda: arm(UNEVEN), "", "csv"), Right("top", lambda: top(UNEVEN), "", "frame"),
    Right("two", lambda: two(LATE), "", "csv"), Right("tumbler", lambda: tumbler(np.linspace(0, 3.0, 301)), "", "tab"),
    Right("arm", lambda: arm(angle=0.5, rate=1.0), "", "csv", start="recorded"),
    Right("two", lambda: two(angle=(0.3, -0.6)), "", "npz", start="recorded"),
    Right("two", by_mujoco, "", "csv"), Right("two", lambda: by_mujoco("Euler", 1e-3), "", "tab", 0.5),
    Right("two", by_pinocchio, "", "npz"), Right("tumbler", by_exudyn, "", "csv"),
    Right("imu", imu, "", "csv"), Right("imu", imu, "acceleration", "parquet"), Right("imu", imu, "rate", "digits6"),
    Right("sled", sled, "", "csv"), Right("sled", sled, "position", "digits6"),
    *(Right(scene, _law(scene, t), keep, style) for scene in LAWS
      for t, keep, style in ((TIMES, "", "csv"), (FEW, "pivot", "digits6"))),
]


def written(columns: Columns, style: str, path: Any) -> tuple[Any, Any]:
    """(what to judge, its mapping) of columns in a style."""
    import pandas as pd

    columns = dict(columns)
    if style == "matrix":
        for name in [name[:-3] for name in columns if name.endswith(".qw")]:
            q = np.stack([columns.pop(f"{name}.q{axis}") for axis in "wxyz"], axis=1)
            R = Rotation.from_quat(q, scalar_first=True).as_matrix()
            columns |= {f"{name}.R{i}{j}": R[:, i, j] for i in range(3) for j in range(3)}
    frame, file = pd.DataFrame(columns), path / f"run.{style}.csv"
    if style == "frame":
        return frame, None
    if style == "parquet":
        frame.to_parquet(path / "run.parquet")
        return path / "run.parquet", None
    if style == "npz":
        np.savez(path / "run.npz", **columns)
        return path / "run.npz", None
    if style.startswith("digits"):
        frame.to_csv(file, index=False, float_format=f"%.{style[6:]}f")
        return file, None
    if style == "semicolon":
        frame.to_csv(file, index=False, sep=";", decimal=",")
        return file, None
    if style == "tab":
        file.write_text("# made by hand\n# second line\n" + frame.to_csv(index=False, sep="\t"))
        return file, None
    if style == "mapped":
        return _mapped(columns, file)
    frame.to_csv(file, index=False)
    return file, None


def _mapped(columns: Columns, file: Any) -> tuple[Any, Any]:
    """Other names, degrees, millimetres, quaternions with w last, velocities in body axes."""
    import pandas as pd

    made: Columns = {"Time [ms]": 1e3 * columns["t"]}
    rows: dict[str, Any] = {"Time [ms]": {"is": "t", "unit": "ms"}}
    for name, values in columns.items():
        owner, _, part = name.partition(".")
        if part in ("position", "velocity"):
            slide = owner == "rail"
            unit, factor = (("mm", 1e3) if slide else ("deg", 180 / np.pi))
            title = f"{owner} {part} raw"
            made[title] = factor * values + 3.0
            rows[title] = {"is": name, "unit": unit + ("/s" if part == "velocity" else ""), "offset": -3.0}
        elif part in ("x", "y", "z"):
            made[f"{owner} {part} (mm)"] = 1e3 * values
            rows[f"{owner} {part} (mm)"] = {"is": name}
    for owner in [name[:-3] for name in columns if name.endswith(".qw")]:
        q = np.stack([columns[f"{owner}.q{axis}"] for axis in "xyzw"], axis=1)
        made |= {f"{owner} q{k}": q[:, k] for k in range(4)}
        rows[f"{owner} quat"] = {"is": f"{owner}.q", "columns": [f"{owner} q{k}" for k in range(4)], "order": "xyzw"}
        R = Rotation.from_quat(q).as_matrix()
        v, w = (np.stack([columns[f"{owner}.{part}{axis}"] for axis in "xyz"], axis=1) for part in "vw")
        v, w = np.einsum("tji,tj->ti", R, v), np.einsum("tij,tj->ti", R, w)
        made |= {f"{owner} v{k}": v[:, k] for k in range(3)} | {f"{owner} w{k}": w[:, k] for k in range(3)}
        rows[f"{owner} vel"] = {"is": f"{owner}.v", "columns": [f"{owner} v{k}" for k in range(3)], "frame": "body"}
        rows[f"{owner} omega"] = {"is": f"{owner}.w", "columns": [f"{owner} w{k}" for k in range(3)], "frame": "world"}
    pd.DataFrame(made).to_csv(file, index=False)
    return file, rows


# --- mistakes of the output -------------------------------------------------------------------------------------------


def only(columns: Columns, *parts: str) -> Columns:
    """The columns whose names contain one of these, and the times."""
    return {name: values for name, values in columns.items() if name == "t" or any(part in name for part in parts)}


def scaled(columns: Columns, factor: float, *ends: str) -> Columns:
    return {name: factor * values if name.endswith(ends) else values for name, values in columns.items()}


def shifted(columns: Columns, off: float, *ends: str) -> Columns:
    return {name: values + off if name.endswith(ends) else values for name, values in columns.items()}


def rows(columns: Columns, index: Any) -> Columns:
    """Other rows at the times of the first ones."""
    count = len(np.arange(len(columns["t"]))[index])
    return {name: values[:count] if name == "t" else values[index] for name, values in columns.items()}


def vectors(columns: Columns, name: str, part: str, change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Columns:
    """One vector (T, 3) changed; `change` also takes the attitudes (T, 3, 3)."""
    R = Rotation.from_quat(np.stack([columns[f"{name}.q{axis}"] for axis in "wxyz"], axis=1),
                           scalar_first=True).as_matrix()
    values = change(np.stack([columns[f"{name}.{part}{axis}"] for axis in "xyz"], axis=1), R)
    return columns | {f"{name}.{part}{axis}": values[:, k] for k, axis in enumerate("xyz")}


def quaternions(columns: Columns, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Columns:
    q = change(np.stack([columns[f"{name}.q{axis}"] for axis in "wxyz"], axis=1))
    return columns | {f"{name}.q{axis}": q[:, k] for k, axis in enumerate("wxyz")}


def each(columns: Columns, change: Callable[[np.ndarray], np.ndarray]) -> Columns:
    return {name: values if name == "t" else change(values) for name, values in columns.items()}


def low_pass(values: np.ndarray, tau: float = 0.04) -> np.ndarray:
    keep, out = np.exp(-0.01 / tau), [values[0]]
    for value in values[1:]:
        out.append(keep * out[-1] + (1 - keep) * value)
    return np.array(out)


def axes_up(columns: Columns, name: str) -> Columns:
    """World axes with y up."""
    Q = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    columns = vectors(columns, name, "", lambda x, R: x @ Q.T)
    turned = vectors(columns, name, "v", lambda v, R: v @ Q.T)
    q = Rotation.from_quat(np.stack([columns[f"{name}.q{axis}"] for axis in "wxyz"], axis=1), scalar_first=True)
    new = (Rotation.from_matrix(Q) * q).as_quat(scalar_first=True)
    return turned | {f"{name}.q{axis}": new[:, k] for k, axis in enumerate("wxyz")}


def exchanged(columns: Columns) -> Columns:
    other = {"upper": "fore", "fore": "upper", "shoulder": "elbow", "elbow": "shoulder"}
    return {(name if name == "t" else f"{other[name.partition('.')[0]]}.{name.partition('.')[2]}"): values
            for name, values in columns.items()}


def wrapped(columns: Columns, *ends: str) -> Columns:
    return {name: (values + np.pi) % (2 * np.pi) - np.pi if name.endswith(ends) else values
            for name, values in columns.items()}


NOISE = np.random.default_rng(11)
INERTIA = ("inertia", "mass", "gravity", "anchors")  # on a hinge they make the same motion


def _spike(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[[50, 120]] += 0.3
    return values


def fast(t: np.ndarray = TIMES) -> Columns:
    """The bar with more than a full turn."""
    return arm(t)


WRONG = [
    Wrong("gravity size", "two", lambda: two(g=9.7), ("gravity",)),
    Wrong("gravity size", "top", lambda: top(g=(0, 0, -9.7)), ("gravity",)),
    Wrong("gravity sign", "tumbler", lambda: tumbler(g=(0, 0, 9.81)), ("gravity sign",)),
    Wrong("gravity sign", "top", lambda: top(g=(0, 0, 9.81)), ("gravity sign",)),
    Wrong("no gravity", "two", lambda: two(g=0.0), ("gravity",)),
    Wrong("no gravity", "arm", lambda: arm(g=0.0), ("gravity",)),
    Wrong("gravity axis", "tumbler", lambda: tumbler(g=(0, -9.81, 0)), ("gravity axis", "axes")),
    Wrong("gravity axis", "top", lambda: top(g=(0.3, 0, -9.805)), ("gravity axis",)),
    Wrong("mass", "two", lambda: two(m=(1.3, 0.7)), ("mass",)),
    Wrong("mass", "two", lambda: two(m=(1.2, 0.75)), ("mass",)),
    Wrong("mass", "slider", lambda: slider(m=2.1), ("mass", "spring stiffness")),
    Wrong("inertia", "arm", lambda: arm(J=0.05), INERTIA),
    Wrong("inertia", "tumbler", lambda: tumbler(J=(0.03, 0.052, 0.07)), ("inertia",)),
    Wrong("inertia", "two", lambda: two(J=(0.03, 0.02)), ("inertia",)),
    Wrong("inertia point", "two", lambda: two(J=(0.03 + 1.2 * 0.16, 0.012)), ("inertia",)),
    Wrong("inertia point", "top", lambda: top(J=((0.02 + 0.375, 0, 0), (0, 0.03 + 0.375, 0), (0, 0, 0.015))),
          ("inertia",)),
    Wrong("products of inertia", "top", lambda: top(J=((0.02, 0, 0.004), (0, 0.03, 0), (0.004, 0, 0.015))),
          ("inertia",)),
    Wrong("child anchor", "top", lambda: top(s=(0.0, 0.0, 0.48)), ("anchors",)),
    Wrong("child anchor", "two", lambda: two(l=(0.4, 0.8, 0.32)), ("anchors",)),
    Wrong("parent anchor", "arm", lambda: arm(anchor=(0.1, 0.0, 0.25)), ("anchors", "origin")),
    Wrong("parent anchor", "two", lambda: two(l=(0.4, 0.75, 0.3)), ("anchors",)),
    Wrong("spring stiffness", "slider", lambda: slider(k=84.0), ("spring stiffness", "mass")),
    Wrong("free length", "slider", lambda: slider(free=0.93), ("spring free length",)),
    Wrong("damping", "slider", lambda: slider(c=0.8), ("damping", "extra damping")),
    Wrong("damping", "slider", lambda: slider(c=0.0), ("missing damper", "damping", "extra damping")),
    Wrong("extra damping", "two", lambda: two(damping=0.05), ("extra damping",)),
    Wrong("missing damping", "arm", lambda: arm(damping=0.0), ("missing damper", "damping")),
    Wrong("drag", "tumbler", lambda: tumbler(drag=0.1), ("extra damping",)),
    Wrong("gyroscopic term", "tumbler", lambda: tumbler(gyroscopic=0.0), ("gyroscopic term",)),
    Wrong("quadratic drag", "arm", lambda: arm(square=0.05), ("quadratic drag",)),
    Wrong("start angle", "two", lambda: two(angle=(0.41, -0.7)), ("start",)),
    Wrong("start angle", "arm", lambda: arm(angle=0.45), ("start",)),
    Wrong("start velocity", "tumbler", lambda: tumbler(w=(1.0, 2.45, -0.6)), ("start",)),
    Wrong("start velocity", "top", lambda: top(w=(0.5, -0.3, 5.9)), ("start",)),
    Wrong("quaternion order", "tumbler", lambda: quaternions(tumbler(), "brick", lambda q: np.roll(q, 1, axis=1)),
          ("quaternion order",)),
    Wrong("quaternion order", "top", lambda: quaternions(top(), "top", lambda q: np.roll(q, -1, axis=1)),
          ("quaternion order",)),
    Wrong("conjugate", "tumbler", lambda: quaternions(tumbler(), "brick", lambda q: q * [1, -1, -1, -1]),
          ("quaternion conjugated",)),
    Wrong("conjugate", "top", lambda: quaternions(top(), "top", lambda q: q * [1, -1, -1, -1]),
          ("quaternion conjugated",)),
    Wrong("velocity in body axes", "tumbler", lambda: vectors(tumbler(), "brick", "v", lambda v, R: np.einsum(
        "tji,tj->ti", R, v)), ("velocity frame",)),
    Wrong("velocity in body axes", "two", lambda: vectors(two(), "fore", "v", lambda v, R: np.einsum(
        "tji,tj->ti", R, v)), ("velocity frame",)),
    Wrong("spin in world axes", "top", lambda: vectors(top(), "top", "w", lambda w, R: np.einsum(
        "tij,tj->ti", R, w)), ("velocity frame",)),
    Wrong("spin in world axes", "tumbler", lambda: vectors(tumbler(), "brick", "w", lambda w, R: np.einsum(
        "tij,tj->ti", R, w)), ("velocity frame",)),
    Wrong("degrees", "arm", lambda: scaled(only(arm(), "pivot"), 180 / np.pi, "position"), ("units",)),
    Wrong("degrees", "two", lambda: scaled(only(two(), "position"), 180 / np.pi, "position"), ("units",)),
    Wrong("millimetres", "slider", lambda: scaled(slider(), 1e3, "block.x"), ("units",)),
    Wrong("millimetres", "tumbler", lambda: scaled(tumbler(), 1e3, ".x", ".y", ".z"), ("units",)),
    Wrong("scale", "two", lambda: scaled(two(), 1.02, "elbow.velocity"), ("scale",)),
    Wrong("sign", "two", lambda: scaled(only(two(), "position"), -1.0, "elbow.position"), ("sign",)),
    Wrong("sign", "slider", lambda: scaled(slider(), -1.0, "rail.position", "rail.velocity"), ("sign", "joint axis")),
    Wrong("offset", "arm", lambda: shifted(arm(), 0.1, "pivot.position"), ("offset",)),
    Wrong("offset", "two", lambda: shifted(two(), -0.05, "elbow.position"), ("offset",)),
    Wrong("origin", "tumbler", lambda: shifted(tumbler(), 0.2, ".z"), ("origin", "start")),
    Wrong("another point", "tumbler", lambda: vectors(tumbler(), "brick", "", lambda x, R: x + R @ [0.1, 0.02, 0.0]),
          ("position of another point",)),
    Wrong("another point", "top", lambda: vectors(top(), "top", "", lambda x, R: x + R @ [0.0, 0.0, -0.5]),
          ("position of the joint",)),
    Wrong("axes", "tumbler", lambda: axes_up(tumbler(), "brick"), ("axes",)),
    Wrong("axes", "top", lambda: axes_up(top(), "top"), ("axes",)),
    Wrong("exchanged", "two", lambda: exchanged(two()), ("exchanged",)),
    Wrong("exchanged", "two", lambda: exchanged(only(two(), "position", "velocity")), ("exchanged",)),
    Wrong("late sample", "two", lambda: rows(two(), [0, *range(200)]), ("late sample", "time shift")),
    Wrong("late sample", "tumbler", lambda: tumbler(TIMES - 0.01) | {"t": TIMES}, ("late sample", "start")),
    Wrong("early sample", "arm", lambda: rows(arm(), slice(1, None)), ("early sample", "start")),
    Wrong("early sample", "top", lambda: rows(top(), slice(2, None)), ("early sample", "start")),
    Wrong("time shift", "two", lambda: two(TIMES + 0.0037) | {"t": TIMES}, ("time shift", "start")),
    Wrong("time scale", "two", lambda: two(1.01 * TIMES) | {"t": TIMES}, ("time scale",)),
    Wrong("time scale", "top", lambda: top(0.98 * TIMES) | {"t": TIMES}, ("time scale",)),
    Wrong("dropped sample", "two", lambda: rows(two(), [*range(80), *range(81, 201)]), ("dropped sample",)),
    Wrong("dropped sample", "tumbler", lambda: rows(tumbler(), [*range(120), *range(123, 201)]), ("dropped sample",)),
    Wrong("repeated sample", "arm", lambda: rows(arm(), [*range(80), 79, *range(80, 200)]), ("repeated sample",)),
    Wrong("held sample", "two", lambda: each(two(), lambda v: v[np.arange(201) // 5 * 5]), ("held sample",)),
    Wrong("held sample", "top", lambda: each(top(), lambda v: v[np.arange(201) // 4 * 4]), ("held sample",)),
    Wrong("interpolated", "two", lambda: each(only(two(), "position", "velocity"), lambda v: np.interp(
        TIMES, TIMES[::10], v[::10])), ("interpolated output",)),
    Wrong("interpolated", "slider", lambda: each(only(slider(), "rail"), lambda v: np.interp(
        TIMES, TIMES[::20], v[::20])), ("interpolated output",)),
    Wrong("filtered", "two", lambda: each(only(two(), "position", "velocity"), low_pass), ("filtered",)),
    Wrong("filtered", "slider", lambda: each(only(slider(), "rail"), low_pass), ("filtered",)),
    Wrong("clamp", "two", lambda: {n: np.clip(v, -3, 3) if "velocity" in n else v for n, v in two().items()},
          ("clamp",)),
    Wrong("clamp", "tumbler", lambda: {n: np.clip(v, -2, 2) if ".w" in n else v for n, v in tumbler().items()},
          ("clamp",)),
    Wrong("noise", "two", lambda: each(only(two(), "position"), lambda v: v + 1e-3 * NOISE.normal(size=len(v))),
          ("noise",)),
    Wrong("noise", "slider", lambda: each(only(slider(), "rail"), lambda v: v + 1e-3 * NOISE.normal(size=len(v))),
          ("noise",)),
    Wrong("outliers", "two", lambda: each(only(two(), "position"), _spike), ("outliers",)),
    Wrong("wrapped angle", "arm", lambda: wrapped(arm(np.linspace(0, 2, 201), rate=9.0), "pivot.position"), ()),
    Wrong("acceleration without gravity", "imu", lambda: imu() | {
        "acceleration.x": imu()["acceleration.x"] + 9.81 * np.sin(arm()["pivot.position"]),
        "acceleration.z": imu()["acceleration.z"] - 9.81 * np.cos(arm()["pivot.position"])}, ("gravity",)),
    Wrong("lever of an accelerometer", "imu", lambda: imu(s=(0.0, 0.0, 0.0)), ("lever",)),
    Wrong("accelerometer in g", "imu", lambda: scaled(imu(), 1 / 9.80665, "acceleration.x", "acceleration.z"),
          ("units",)),
    Wrong("gyroscope late", "imu", lambda: rows(only(imu(), "rate"), [0, *range(200)]), ("late sample", "time shift")),
    Wrong("sign of a gyroscope", "imu", lambda: scaled(imu(), -1.0, "rate.y"), ("sign", "scale")),
    Wrong("gravity", "imu", lambda: imu(g=9.7), ("gravity",)),
    Wrong("dry friction", "sled", lambda: sled(friction=2.3), ("dry friction", "mass")),
    Wrong("jump", "sled", lambda: {name: values + 0.05 * (name == "rail.position") * (TIMES > 1.0)
                                   for name, values in sled().items()}, ()),
    *(Wrong(kind, scene, _law(scene, **changes), names) for kind, scene, names, changes in (
        ("friction on the way there", "rough", (), {"friction": (1.515, 1.5)}),
        ("friction on the way back", "rough", (), {"friction": (1.5, 1.515)}),
        ("dry friction", "rough", ("dry friction",), {"friction": (1.4, 1.4)}),
        ("restitution", "bounce", ("stop restitution",), {"bounce": 0.51}),
        ("place of a stop", "bounce", ("stop upper",), {"stop": 0.905}),
        ("load before an impact", "bounce", (), {"late": lambda t: 0.02 * (t < 0.1)}),
        ("load after an impact", "bounce", (), {"late": lambda t: 0.02 * (t > 0.25)}),
        ("a stop that bounces", "stop", ("stop restitution",), {"bounce": 0.05}),
        ("no stop", "stop", ("no limits",), {"stop": None}),
        ("soft stop", "soft", ("stop stiffness",), {"soft": (0.9, 61.0, 0.4)}),
        ("soft stop", "soft", ("stop damping",), {"soft": (0.9, 60.0, 0.42)}),
        ("gain of a servo", "servo", ("servo proportional",), {"servo": (-0.5, 30.3, *CONTINUOUS[2:])}),
        ("limit of a servo", "servo", ("servo effort limit",), {"servo": (*CONTINUOUS[:3], 5.9, None, 0)}),
        ("delay of a servo", "sampled", ("servo delay",), {"servo": (*SAMPLED[:5], 0)}),
        ("delay of a servo", "sampled", ("servo delay",), {"servo": (*SAMPLED[:5], 2)}),
        ("period of a servo", "sampled", ("sampling",), {"servo": (*SAMPLED[:4], 0.01, 1)}),
        ("load late in a servo's run", "sampled", (), {"late": lambda t: 0.01 * (t > 1)}))),
    Wrong("relative spin", "two", lambda: vectors(two(), "fore", "w", lambda w, R: w - np.outer(
        two()["shoulder.velocity"], [0, 1, 0])), ("velocity frame",)),
]
assert set(SCENES) >= {one.scene for one in (*RIGHT, *WRONG)}
