"""`crosscheck paper`: figures and tables like those in the papers, for any scene."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated

import typer

from crosscheck.cli import options
from crosscheck.cli.console import progress_bar
from crosscheck.errors import ArgumentError, unknown


def paper(
    scene: Annotated[list[str], typer.Argument(help="names or paths")],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder of figures, tables, data")] = Path("reports/paper"),
    engine: Annotated[str, typer.Option(help="whose methods")] = "lieeuler",
    method: Annotated[list[str] | None, options.methods("of fixed step; of lieeuler the eight Euler methods")] = None,
    coordinate_map: options.CoordinateMaps = None,
    correction: Annotated[list[str] | None, typer.Option(
        help="mass or plain: weight of the correction of stabilised methods; may be repeated; default: both")] = None,
    shown: Annotated[str | None, typer.Option("--show", help="the method in figures of a single method")] = None,
    step: options.Step = None,
    duration: options.Duration = None,
    formats: Annotated[list[str] | None, typer.Option("--format", help="pdf or svg; may be repeated; default: both")
                       ] = None,
) -> None:
    """Write figures and tables like those in the papers for any scenes: vector graphics, LaTeX, BibTeX and the data."""
    from crosscheck import adapters
    from crosscheck.adapters.base import CHOICES
    from crosscheck.document import EULER
    from crosscheck.scene.file import load_scene
    from crosscheck.studies.paper import bundle
    from crosscheck.studies.paper.figures import FORMATS
    from crosscheck.studies.paper.runs import Request

    known = adapters.get(engine).fixed_step_methods
    methods = tuple(dict.fromkeys(method or (EULER if engine == "lieeuler" else known)))
    maps, kinds = tuple(coordinate_map or ("exp",)), tuple(formats or FORMATS)
    corrections = tuple(correction or CHOICES["correction"])
    for option, names, allowed in (("--method", methods, known), ("--show", (shown,) if shown else (), known),
                                   ("--format", kinds, FORMATS), ("--correction", corrections, CHOICES["correction"])):
        for name in names:
            if name not in allowed:
                raise ArgumentError(unknown(option, name, allowed))
    scenes = [load_scene(name) for name in scene]
    importlib.import_module("matplotlib")  # where it is not installed, all runs would be for nothing
    with progress_bar() as progress:
        request = Request(methods, maps, shown or "DAE1L_LSE", step, duration, engine, corrections)
        document = bundle.write(scenes, out, request, kinds, lambda what: progress(0, None, what))
    typer.echo(f"document: {document}")
    typer.echo(f"tables: {', '.join(f'{each.name}-table.tex' for each in scenes)}; figures and data beside them")
