"""`crosscheck report`: writes the pages of a finished run again, or its report as PDF, or its plots as SVG."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

FORMATS = ("html", "pdf", "svg")


def report(
    run: Annotated[Path, typer.Argument(help="folder of a report, or its results.json")] = Path("reports/latest"),
    format_: Annotated[str, typer.Option("--format", help=(
        "html: write the pages again; pdf: a summary and the overview in report.pdf, printed by Chromium; svg: the "
        "main plots in figures/"))] = "html",
    appendix: Annotated[bool, typer.Option("--appendix", help="pdf: add all other pages")] = False,
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
        from crosscheck.files import put
        from crosscheck.report.pages import cover
        from crosscheck.report.pdf import find_browser, write_pdf
        from crosscheck.report.schema import read_document

        browser = find_browser()
        site.render_again(folder)
        document = read_document(folder / "results.json")
        put(folder / "summary.html", cover(document))
        pages = [folder / "summary.html", *site.pages_in_order(folder)[:None if appendix else 1]]
        try:
            write_pdf(pages, folder / "report.pdf", browser, f"crosscheck, {document.meta.time[:10]}")
        finally:
            (folder / "summary.html").unlink()
        typer.echo(f"report: {folder / 'report.pdf'}")
    else:
        typer.echo(f"report: {site.render_again(folder)}")
