"""`crosscheck support`: the joints, forces and systems that the engines can model, and why not the others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from crosscheck.cli.console import console
from crosscheck.cli.tables import figures, key, print_table

if TYPE_CHECKING:
    from crosscheck.running.support import Support


def support(
    engine: Annotated[list[str] | None, typer.Option("--engine", help="a name; may be repeated; default: all")] = None,
    reasons: Annotated[bool, typer.Option(help="give the reasons for what is missing")] = True,
) -> None:
    """Print the joints, forces and systems that each engine can model, in which form, and why not the others."""
    from crosscheck import adapters
    from crosscheck.running.support import matrix

    entries = matrix(engine or None)
    columns = list(dict.fromkeys((entry.engine, entry.form) for entry in entries))
    cells = {(entry.engine, entry.form, entry.kind, entry.item): entry for entry in entries}
    notes: dict[tuple[str, str], int] = {}  # footnote numbers, by engine with form and reason
    for entry in entries:
        if entry.reason is not None:
            notes.setdefault(_note(entry), len(notes) + 1)
    rows, last = [], ""
    for kind, item in dict.fromkeys((entry.kind, entry.item) for entry in entries):
        if kind != last:
            rows.append((f"{kind}:", *("" for _ in columns)))
        row = [cells[name, form, kind, item] for name, form in columns]
        rows.append((f"  {item}", *(_cell(entry, len(adapters.methods(entry.engine)), notes if reasons else {})
                                   for entry in row)))
        last = kind
    terminal = console(160)
    print_table(terminal, [key(""), *figures(*(f"{name} {form or ''}".strip() for name, form in columns))], rows)
    terminal.print("yes: by all methods; a/b: by a of b methods; -: not at all" + ("; [n]: why not" if reasons else ""),
                   markup=False)
    if reasons:
        for (label, reason), number in notes.items():
            terminal.print(f"[{number}] {label}: {reason}", markup=False)


def _note(entry: Support) -> tuple[str, str]:
    label = f"{entry.engine} {entry.form or ''}".strip()
    return label, (entry.reason or "").replace(f"type {entry.item}", "this type")


def _cell(entry: Support, methods: int, notes: dict[tuple[str, str], int]) -> str:
    number = notes.get(_note(entry))
    note = "" if number is None else f" [{number}]"
    if not entry.methods:
        return f"-{note}"
    return f"yes{note}" if len(entry.methods) == methods else f"{len(entry.methods)}/{methods}{note}"
