"""Options that several commands share, and figures in their tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, Any

import typer

SceneNames = Annotated[list[str] | None, typer.Option("--scene", help="a built-in name or a path; may be repeated")]
EngineNames = Annotated[list[str] | None, typer.Option("--engine", help=(
    "a name, name==version, or a class of your own as module:Class or path/file.py:Class; may be repeated; "
    "default: all"))]
Engines = Annotated[list[str] | None, typer.Option("--engine", help="may be repeated; default: all")]


def scenes(default: str) -> Any:
    """The argument for scenes; `default` names those that are taken without it."""
    return typer.Argument(help=f"names or paths; default: {default}")


def methods(default: str) -> Any:
    """The option for methods; `default` names those that are taken without it."""
    return typer.Option("--method", help=f"may be repeated; default: {default}")


def time_limit(consequence: str) -> Any:
    """The limit of one run; `consequence` says what becomes of longer ones."""
    return typer.Option(min=1e-3, help=f"s of one run; {consequence}")


def chosen(names: Iterable[str] | None) -> tuple[str, ...] | None:
    """Names as a study takes them: None for all."""
    return tuple(names) if names else None


def figure(value: float | None, missing: str = "") -> str:
    """Three digits of a number."""
    return missing if value is None else f"{value:.3g}"


def figures(values: Iterable[float | None], missing: str = "") -> Iterator[str]:
    """Three digits of each of some numbers."""
    return (figure(value, missing) for value in values)
