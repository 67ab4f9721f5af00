"""What `crosscheck verify` prints: the table of verdicts, what is wrong, what to trust, and the headline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import typer

from crosscheck.cli.console import console
from crosscheck.document import Document, Record
from crosscheck.report.headline import OUTCOMES, headline, sentence
from crosscheck.report.overview import worst_first

STYLES = {"fail": "bold red", "error": "bold red", "known": "yellow", "unsupported": "dim"}


def print_verdicts(document: Document, page: Path) -> None:
    """Every run, what is wrong in the groups of the first page, what to trust, the headline, and the report's place."""
    from rich.table import Table

    terminal = console(160)
    table = Table("scene", "run", "verdict", "step or rtol", "order", "position error, m", "bound, m", "judged to",
                  "energy error", "us/step", box=None, pad_edge=False)
    for record in document.records:
        position, fitted = record.errors.get("position"), record.orders.get("position")
        order = fitted.observed if fitted else None
        table.add_row(
            record.scene, record.label, f"{OUTCOMES[record.outcome][0]} {record.word}", _size(record),
            "" if order is None else f"{order:.2f}", _number(position.judged if position else None),
            _number(position.bound if position else None),
            "" if record.judged_until is None else f"{record.judged_until:g} s", _number(record.energy_error),
            "" if record.us_per_step is None else f"{record.us_per_step:.3g}", style=STYLES.get(record.outcome, ""))
    terminal.print(table)
    # Not through Rich from here: what is folded cannot be searched, and a path cannot be clicked or copied.
    for group in worst_first(document.records):
        symbol, word, _ = OUTCOMES[group.outcome]
        loud = word.upper() if group.outcome in ("fail", "error") else word
        typer.echo(f"{symbol} {loud}: {group.engine + ': ' if group.engine else ''}{group.why}")
        for record, _ in group.runs:
            typer.echo(f"    {record.scene}, {record.label}: {sentence(record)}")
    for symbol, message, labels in _left_out(document.records):
        typer.echo(f"{symbol} {message}: {labels}")
    for scene in document.scenes:
        typer.echo(f"{scene.name}: {scene.trust}")
    typer.echo(f"{headline(document)} ({document.meta.seconds:.0f} s)")
    typer.echo(f"report: {page}")


def _left_out(records: Sequence[Record]) -> list[tuple[str, str, str]]:
    """Symbol, reason and names of the runs that an engine cannot make, or that there is no truth for."""
    found: dict[tuple[str, str], list[str]] = {}
    for record in records:
        if record.outcome in ("unsupported", "unjudged"):
            symbol, word, _ = OUTCOMES[record.outcome]
            key = f"{symbol} {word}", f"{record.scene}, {record.message}"
            found.setdefault(key, []).append(record.label)
    return [(symbol, message, ", ".join(labels)) for (symbol, message), labels in found.items()]


def _size(record: Record) -> str:
    return f"{record.step:g} s" if record.step else f"rtol {record.rtol:g}" if record.rtol else ""


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1e}" if value < 0.1 or value >= 1000 else f"{value:.2f}"
