"""`crosscheck report`: the pages of a finished run anew, or its report as PDF or its plots as SVG."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

FORMATS = ("html", "pdf", "svg")


def report(
    run: Annotated[Path, typer.Argument(help="folder of a report, or its results.json")] = Path("reports/latest"),
    format_: Annotated[str, typer.Option("--format", help=(
        "html: the pages anew; pdf: all of them in report.pdf, printed by Chromium; svg: the main plots in figures/"
    ))] = "html",
) -> None:
    """Render a finished run again from its results.json, without running anything."""
    from crosscheck import report as site
    from crosscheck.errors import ArgumentError

    folder = run.parent if run.name == "results.json" else run
    if format_ not in FORMATS:
        raise ArgumentError(f"--format {format_!r} is unknown: choose {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")
    if not folder.is_dir():
        raise ArgumentError(f"{run}: no such folder; name one that `crosscheck verify` wrote, such as reports/latest")
    if format_ == "svg":
        from crosscheck.report.figures import write_figures

        written = write_figures(site.load_report(folder), folder / site.FIGURES)
        typer.echo(f"{len(written)} figures: {folder / site.FIGURES}")
    elif format_ == "pdf":
        from crosscheck.report.pdf import find_browser, write_pdf

        browser = find_browser()
        site.render_again(folder)
        typer.echo(f"report: {write_pdf(site.pages_in_order(folder), folder / 'report.pdf', browser)}")
    else:
        typer.echo(f"report: {site.render_again(folder)}")
