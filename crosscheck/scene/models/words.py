"""Shortens lists of sentences that say the same about many joints or bodies."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any

from crosscheck.scene.model import LeftOut

MOST_NAMED = 6
"""Largest number of names in the one sentence that stands for many."""


def together(sentences: Iterable[tuple[str, str]]) -> list[str]:
    """Sentences from pairs (sentence, name in it); of those that differ only in the name, the first lists the others.
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for sentence, name in sentences:
        groups.setdefault(sentence.replace(name, "\0") if name else sentence, []).append((sentence, name))
    lines = []
    for (first, _), *rest in groups.values():
        others = [name for _, name in rest if name]
        more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
        listed = ("; " if any(": " in name for name in others) else ", ").join(others[:MOST_NAMED])
        lines += [f"{first}; likewise {listed}{more}"] if others else [first] * (1 + len(rest))
    return lines


def shortened(things: Iterable[LeftOut | str], placed: Callable[[str], str] = str) -> list[str]:
    """Sentences of which those that differ only in one name in quotes with its numbers, or in the line of the file,
    are one. `placed` adds to a sentence where it is in the file."""
    def named(sentence: str) -> str:
        parts = sentence.split("'")
        line = re.search(r"\(line \d+\)", sentence)
        if len(parts) != 3:
            return line[0] if line and len(parts) == 1 else ""
        return f"'{parts[1]}'{parts[2] if parts[2].startswith(': ') else ''}"

    return together((sentence, named(sentence)) for sentence in (placed(str(each)) for each in things))


def distinct(tables: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The tables with a number added to every name that occurred before."""
    names: set[str] = set()
    for table in tables:
        name, count = table["name"], 1
        while table["name"] in names:
            count += 1
            table["name"] = f"{name} {count}"
        names.add(table["name"])
    return tables
