"""`crosscheck diff`: what differs between two models."""

from __future__ import annotations

from typing import Annotated

import typer

from crosscheck.cli.console import say


def diff(
    a: Annotated[str, typer.Argument(help="a model (.xml, .urdf), a scene file, or the name of a scene")],
    b: Annotated[str, typer.Argument(help="another one")],
) -> None:
    """Compare two models by their trees, whatever their names, order and format: what differs, where, and the motion.

    Exit code 0: the same motion; 1: something differs; 2: one of them cannot be read.
    """
    from crosscheck.inspection.diff import diff as compare

    report = compare(a, b)
    for line in report.lines:
        say(line)
    raise typer.Exit(0 if report.same else 1)
