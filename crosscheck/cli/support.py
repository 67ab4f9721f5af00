"""`crosscheck support`: which joints, forces and systems the engines can model, in which form, and why not the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from crosscheck.cli.console import console

if TYPE_CHECKING:
    from crosscheck.running.support import Support


def support(
    engine: Annotated[list[str] | None, typer.Option("--engine", help="a name; may be repeated; default: all")] = None,
    reasons: Annotated[bool, typer.Option(help="say why what is missing is missing")] = True,
) -> None:
    """Which joints, forces and systems each engine can model, in which form, and why not the rest."""
    from rich.table import Table

    from crosscheck import adapters
    from crosscheck.running.support import matrix

    found = matrix(engine or None)
    columns = list(dict.fromkeys((entry.engine, entry.form) for entry in found))
    cells = {(entry.engine, entry.form, entry.kind, entry.item): entry for entry in found}
    table = Table("", "", *(f"{name}\n{form or ''}" for name, form in columns), box=None)
    last = ""
    for kind, item in dict.fromkeys((entry.kind, entry.item) for entry in found):
        row = [cells[name, form, kind, item] for name, form in columns]
        table.add_row(kind if kind != last else "", item, *(_cell(entry, len(adapters.methods(entry.engine)))
                                                            for entry in row))
        last = kind
    terminal = console(160)
    terminal.print(table)
    terminal.print("yes: by all methods; a / b: by a of b methods")
    if reasons:
        for line in _reasons(found):
            terminal.print(line, markup=False)


def _cell(entry: Support, methods: int) -> str:
    if not entry.methods:
        return "-"
    return "yes" if len(entry.methods) == methods else f"{len(entry.methods)} / {methods}"


def _reasons(found: tuple[Support, ...]) -> list[str]:
    """One line for every engine, form and reason, with the items it holds for."""
    items: dict[tuple[str, str], list[str]] = {}
    for entry in found:
        if entry.reason is not None:
            label = f"{entry.engine} {entry.form or ''}".strip()
            items.setdefault((label, entry.reason.replace(f"type {entry.item}", "this type")), []).append(entry.item)
    return [f"{label}, {', '.join(dict.fromkeys(names))}: {reason}" for (label, reason), names in items.items()]
