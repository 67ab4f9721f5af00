"""What the commands of studies share: their options, and how their tables look."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

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


def console(width: int) -> Console:
    """The terminal; where there is none, so many columns: Rich would fold tables at 80, which no log needs."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else width, highlight=False)


def figure(value: float | None, missing: str = "") -> str:
    """Three digits of a number."""
    return missing if value is None else f"{value:.3g}"


def figures(values: Iterable[float | None], missing: str = "") -> Iterator[str]:
    """Three digits of each of some numbers."""
    return (figure(value, missing) for value in values)
