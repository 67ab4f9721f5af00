"""Tolerances of the user, in a TOML file or as quantity=value: rows against truth over the whole run."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Sequence

from crosscheck.document import LEVELS, QUANTITIES, Finding, Record
from crosscheck.errors import ArgumentError, unknown

Overrides = tuple[tuple[str, float, str], ...]
"""(quantity, tolerance in its unit, reason)."""

ENERGY = "energy"
OF_TRUTH = {**QUANTITIES, ENERGY: "1", "momentum": "kg m^2/s"}
"""Rows that truth is needed for, with their units; the energy is over the largest kinetic energy."""
OF_RUN = {**{f"level {level}": unit for level, unit in LEVELS.items()}, "orthogonality": "1"}
"""Rows that the run has by itself."""
BY_USER = "set by the user"


def read(path: str | os.PathLike[str] | None, options: Sequence[str] = (), sensors: Sequence[str] = ()) -> Overrides:
    """Tolerances from a file and from options "quantity=value". Options replace those of the file.

    `sensors` are names that count as quantities too; "sensor NAME" is meant where a quantity has the same name.

    Raises
    ------
    ArgumentError
        The message names the file or option and the entry, and says how to correct it.
    """
    bounds: dict[str, tuple[float, str]] = {}
    if path is not None:
        for name, value in _table(path).items():
            bounds[_known(f"{path}: {name}", name, sensors)] = _bound(f"{path}: {name}", value)
    for option in options:
        name, separator, value = option.partition("=")
        if not separator:
            raise ArgumentError(f"--tol {option}: write quantity=value, such as --tol position=1e-3")
        try:
            number = float(value)
        except ValueError:
            raise ArgumentError(f"--tol {option}: {value!r} is no number") from None
        bounds[_known(f"--tol {option}", name.strip(), sensors)] = _bound(f"--tol {option}", number)
    return tuple((name, value, why) for name, (value, why) in bounds.items())


def _table(path: str | os.PathLike[str]) -> dict[str, object]:
    try:
        with open(path, "rb") as stream:
            return tomllib.load(stream)
    except OSError as error:
        raise ArgumentError(f"--tolerances {path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ArgumentError(f"--tolerances {path}: not TOML: {error}") from None


def _known(where: str, name: str, sensors: Sequence[str]) -> str:
    if name in OF_TRUTH or name in OF_RUN:
        return name
    if name.removeprefix("sensor ") in sensors:
        return f"sensor {name.removeprefix('sensor ')}"
    raise ArgumentError(f"{where}: {unknown('quantity', name, [*OF_TRUTH, *OF_RUN, *sensors])}")


def _bound(where: str, value: object) -> tuple[float, str]:
    why = BY_USER
    if isinstance(value, dict):
        extra = sorted(set(value) - {"value", "why"})
        if extra or "value" not in value:
            raise ArgumentError(f"{where}: {extra[0] + ' is not known' if extra else 'value is missing'}; "
                                'write { value = 1e-3, why = "..." }')
        if not isinstance(value.get("why", ""), str):
            raise ArgumentError(f"{where}: why is text")
        why = f"{BY_USER}: {value['why']}" if value.get("why") else BY_USER
        value = value["value"]
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value) or value < 0:
        raise ArgumentError(f"{where}: {value!r} is no bound; write a number that is not negative")
    return float(value), why


def tolerated(overrides: Overrides, run: Record, horizon: float | None) -> tuple[list[Finding], dict[str, float]]:
    """The findings on the tolerances that the user asked for, and the share of the run's time in which each could be
    judged: truth reaches to its `horizon` (s), None without truth.
    """
    findings, shares = list[Finding](), dict[str, float]()
    whole = run.duration or horizon
    reach = 0.0 if horizon is None or whole is None else 1.0 if math.isclose(horizon, whole) else min(
        1.0, horizon / whole)
    for name, bound, why in overrides:
        error = run.errors.get(name)
        level = run.levels.get(name.removeprefix("level "))
        value, unit = ((error.max, error.unit) if error is not None else
                       (level.max, level.unit) if name.startswith("level ") and level is not None else
                       ({ENERGY: run.energy_error, "momentum": run.momentum_error,
                         "orthogonality": run.orthogonality}.get(name), (OF_TRUTH | OF_RUN).get(name, "1")))
        where = "" if error is None else f"body {error.body}, t = {error.time:.4g} s"
        if value is None:
            shares[f"tolerance {name}"] = 0.0
            findings.append(Finding(f"tolerance {name}", "unresolved", None, bound, unit, f"{why}; it is not known"))
            continue
        shares[f"tolerance {name}"] = 1.0 if name in OF_RUN else reach
        findings.append(Finding(f"tolerance {name}", "ok" if value <= bound else "fail", value, bound, unit, why,
                                where, None if error is None else error.size))
    return findings, shares
