"""Files of other programs as tables of columns, by their endings: NumPy, Parquet, MCAP, MATLAB; any other is a text."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import ArgumentError, errors_as, missing
from crosscheck.recordings.tables import Source, Text
from crosscheck.scene.model import Scene

PERIODS = ("fps", "dt", "hz", "frequency", "timestep", "sample_rate")
"""Names of single numbers that give the period of the rows; `dt` and `timestep` in s, the others in 1/s."""


def opened(data: object, scene: Scene) -> Source:
    """The table of a path, data frame or mapping of arrays. Raises `ArgumentError` if it cannot be read."""
    if hasattr(data, "to_parquet"):
        return Source("data frame", _of_frame(data))
    if isinstance(data, Mapping):
        return Source("arrays", _of_arrays(data, scene, "arrays"))
    if not isinstance(data, str | os.PathLike):
        raise ArgumentError(f"recording: a path, a data frame or a mapping of arrays is wanted, not "
                            f"{type(data).__name__}")
    path = Path(data)

    def unreadable(error: Exception) -> ArgumentError:  # each library has errors of its own for a broken file
        if isinstance(error, ImportError):
            return ArgumentError(f"{path}: {missing(error)}")
        return ArgumentError(f"{path}: cannot be read ({error.strerror or error})" if isinstance(error, OSError) else
                             f"{path}: no {path.suffix[1:] or 'CSV'} file that can be read ({error})")

    with errors_as(unreadable):
        if path.is_dir() or not path.exists():
            raise ArgumentError(f"{path}: {'is a folder' if path.is_dir() else 'there is no such file'}; "
                                f"name a file: .csv or another text, {', '.join(READERS)}")
        if path.stat().st_size == 0:
            raise ArgumentError(f"{path}: the file is empty")
        return READERS[path.suffix](path, scene) if path.suffix in READERS else Text(path)


def _npz(path: Path, scene: Scene) -> Source:
    with np.load(path, allow_pickle=False) as stored:
        return Source(str(path), _of_arrays(dict(stored), scene, str(path)))


def _parquet(path: Path, scene: Scene) -> Source:
    import pandas as pd

    return Source(str(path), _of_frame(pd.read_parquet(path)))


def _mat(path: Path, scene: Scene) -> Source:
    """Arrays, and signals in structures with time, as Simulink's To Workspace saves them."""
    from scipy.io import loadmat

    try:
        stored = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise ArgumentError(f"{path}: is of MATLAB's version 7.3; save it with '-v7'") from None
    arrays: dict[str, np.ndarray] = {}

    def take(name: str, value: Any) -> None:
        if isinstance(value, Mapping) and "signals" in value:
            signals = value["signals"] if isinstance(value["signals"], list | np.ndarray) else [value["signals"]]
            for signal in signals:
                label = signal.get("label")
                arrays[label if isinstance(label, str) and label else name] = np.asarray(signal["values"])
            if np.size(value.get("time", ())) > 1:
                arrays.setdefault("time", np.asarray(value["time"]))
        elif isinstance(value, Mapping):
            for key, each in value.items():
                take(key, each)
        elif np.size(value) > 1 and np.asarray(value).dtype.kind in "fiubUO":
            arrays[name] = np.asarray(value)

    for name, value in stored.items():
        if not name.startswith("__"):
            take(name, value)
    if not arrays or any(each.dtype.kind == "O" for each in arrays.values()):
        raise ArgumentError(f"{path}: holds no arrays, or objects such as timeseries; save arrays, or structures with "
                            "time")
    return Source(str(path), _of_arrays(arrays, scene, str(path)))


def _mcap(path: Path, scene: Scene) -> Source:
    """The numbers of all messages of ROS 2 or in JSON, a row a message, at its stamp or when it was logged."""
    import pandas as pd
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    rows: list[tuple[float, dict[str, float]]] = []
    begin: int | None = None
    with open(path, "rb") as stream:
        reader, decoders = make_reader(stream), DecoderFactory()
        for schema, channel, message in reader.iter_messages():
            decoder = decoders.decoder_for(channel.message_encoding, schema)
            if decoder is None and channel.message_encoding != "json":
                continue
            given = _plain(decoder(message.data) if decoder else json.loads(message.data))
            stamp = given.get("header", {}).get("stamp", {}) if isinstance(given, dict) else {}
            at = int(stamp.get("sec", 0)) * 10**9 + int(stamp.get("nanosec", 0)) or message.log_time
            begin = at if begin is None else begin
            rows.append(((at - begin) * 1e-9, dict(_numbers(given, channel.topic))))
    if not any(row for _, row in rows):
        raise ArgumentError(f"{path}: no message of ROS 2 or in JSON holds numbers")
    rows.sort(key=lambda pair: pair[0])
    frame = pd.DataFrame([{"t": t - rows[0][0], **row} for t, row in rows], dtype=float)
    return Source(str(path), _of_frame(frame))


READERS: dict[str, Callable[[Path, Scene], Source]] = {".npz": _npz, ".parquet": _parquet, ".mat": _mat, ".mcap": _mcap}
"""By the ending of a file."""


def _plain(message: Any) -> Any:
    """A decoded message as dicts, lists and numbers."""
    if hasattr(message, "__slots__"):
        return {name: _plain(getattr(message, name)) for name in message.__slots__}
    return [_plain(each) for each in message] if isinstance(message, list | tuple) else message


def _numbers(given: Any, name: str) -> Iterator[tuple[str, float]]:
    """(name, number) of all numbers in a message; those of a joint state bear the names of their joints."""
    if isinstance(given, Mapping):
        names = given.get("name", given.get("joint_names"))
        for key, value in given.items():
            if isinstance(names, list) and isinstance(value, list) and len(value) == len(names) and value != names:
                for owner, each in zip(names, value, strict=True):
                    yield from _numbers(each, f"{name}/{owner}/{key}")
            elif key != "header":
                yield from _numbers(value, f"{name}/{key}")
    elif isinstance(given, int | float) and not isinstance(given, bool):
        yield name, float(given)
    elif not isinstance(given, str | bytes) and hasattr(given, "__len__"):
        for k, each in enumerate(given):
            yield from _numbers(each, f"{name}[{k}]")


def _of_frame(frame: Any) -> dict[str, np.ndarray]:
    if frame.index.name is not None:
        frame = frame.reset_index()
    return {str(name): frame[name].to_numpy() for name in frame}


def _of_arrays(arrays: Mapping[str, object], scene: Scene, where: str) -> dict[str, np.ndarray]:
    """Columns of arrays: (T,) as it is; (T, k) as name[0] ...; x, v, w (T, n, 3), q and R of all bodies by body.

    Lists of names, as Isaac Lab saves them, give the columns of arrays with as many the names of their joints; a
    dimension of one environment does not count, and a single number that is a rate or a period gives the times.
    """
    given = {name: np.asarray(array) for name, array in arrays.items()}
    names: list[Any] = next((array.tolist() for name, array in given.items() if array.dtype.kind in "US" and (
        "joint" in name or "dof" in name)), [])
    names = [name.decode() if isinstance(name, bytes) else name for name in names]
    columns: dict[str, np.ndarray] = {}
    rates = {}
    for name, array in given.items():
        if array.size == 1 and name.lower() in PERIODS and array.dtype.kind in "fiu":
            rates[name.lower()] = float(array.reshape(-1)[0])
            continue
        if array.dtype.kind in "US" and names:
            continue
        if array.ndim == 0:
            raise ArgumentError(f"{where}: {name!r} is a single number; one row a time is wanted")
        if array.ndim == 3 and names and array.shape[2] == len(names):
            if array.shape[1] > 1:
                raise ArgumentError(f"{where}: {name!r} holds {array.shape[1]} environments; save those of one")
            array = array[:, 0]
        if array.ndim == 2 and names and array.shape[1] == len(names):
            owned = {f"{owner}.{name}": array[:, k] for k, owner in enumerate(names)}
        elif array.ndim > 2 and array.shape[1] == scene.n:
            owned = {f"{body.name}.{name}": array[:, b] for b, body in enumerate(scene.bodies)}
        else:
            owned = {name: array}
        for title, part in owned.items():
            flat = part.reshape(len(part), -1)
            columns |= {title: part} if part.ndim == 1 else {f"{title}[{k}]": one for k, one in enumerate(flat.T)}
    counts = {len(column) for column in columns.values()}
    if len(counts) > 1:
        raise ArgumentError(f"{where}: the arrays have different lengths, {sorted(counts)}; one row a time is wanted")
    if len(rates) == 1 and counts and not {"t", "time"} & {*columns}:
        (word, rate), = rates.items()
        if not 0.0 < rate < np.inf:
            raise ArgumentError(f"{where}: {word!r} is {rate:g}; a number > 0 is wanted")
        columns["t"] = np.arange(counts.pop()) * (rate if word in ("dt", "timestep") else 1.0 / rate)
    return columns
