"""Bounds that the user sets instead of the computed ones: in a TOML file, or as quantity=value."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from crosscheck.document import Finding
from crosscheck.errors import ArgumentError, unknown
from crosscheck.judge.tolerances import BOUNDS, BY_USER

Overrides = tuple[tuple[str, float, str], ...]
"""(kind of finding, bound in its unit, reason)."""


def read(path: str | os.PathLike[str] | None, options: Sequence[str] = (), sensors: Sequence[str] = ()) -> Overrides:
    """Bounds from a file and from options "quantity=value". Options replace bounds of the file.

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
    if name in BOUNDS:
        return name
    if name.removeprefix("sensor ") in sensors:
        return f"sensor {name.removeprefix('sensor ')}"
    raise ArgumentError(f"{where}: {unknown('quantity', name, [*BOUNDS, *sensors])}")


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


def override(findings: Sequence[Finding], overrides: Overrides, whole: Mapping[str, tuple[float, str]] | None = None
             ) -> list[Finding]:
    """The findings of a run, judged by the user's bounds if there are any.

    `whole` has, by kind of finding, the largest value over all of the time for which there is truth, and where it is: a
    bound of the user holds there, however far computed bounds reach.

    Values without a computed bound are judged, too. If the user set bounds of position and attitude, the finding that
    the step is too coarse for the computed bounds is removed.
    """
    bounds = {name: (value, why) for name, value, why in overrides}
    if {"position", "attitude"} <= set(bounds):
        findings = [finding for finding in findings if finding.kind != "step"]
    changed = []
    for finding in findings:
        if finding.kind in bounds and finding.value is not None:
            bound, why = bounds[finding.kind]
            if finding.kind in (whole or {}):
                most, where = (whole or {})[finding.kind]
                finding = replace(finding, value=most, detail=where)
            value = finding.value or 0.0
            good = value >= bound if finding.kind.startswith("order") else value <= bound
            finding = replace(finding, bound=bound, why=why, status="ok" if good else "fail")
        changed.append(finding)
    return changed
