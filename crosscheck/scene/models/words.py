"""Shortens lists of sentences that say the same about many joints or bodies."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from crosscheck.scene.model import LeftOut

MOST_ALIKE, MOST_NAMED = 3, 6
"""Largest number of like sentences written out, and of names in the one sentence that replaces more of them."""


def together(sentences: Iterable[tuple[str, str]]) -> list[str]:
    """Sentences from pairs (sentence, name in it); of many that differ only in the name, the first lists the others."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for sentence, name in sentences:
        groups.setdefault(sentence.replace(name, "\0") if name else sentence, []).append((sentence, name))
    lines = []
    for group in groups.values():
        if len(group) <= MOST_ALIKE or not group[0][1]:
            lines += [sentence for sentence, _ in group]
            continue
        others = [name for _, name in group[1:]]
        more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
        lines.append(f"{group[0][0]}; likewise {', '.join(others[:MOST_NAMED])}{more}")
    return lines


def shortened(things: Iterable[LeftOut | str], placed: Callable[[str], str] = str) -> list[str]:
    """Sentences of which many may differ only in the one name in quotes, or in the line of the file, that they have.

    Where there are many their numbers are left out. `placed` adds to a sentence where it is in the file.
    """
    def named(sentence: str) -> str:
        parts = sentence.split("'")
        line = re.search(r"\(line \d+\)", sentence)
        return f"'{parts[1]}'" if len(parts) == 3 else line[0] if line and len(parts) == 1 else ""

    listed = [(placed(str(each)), placed(each.sentence if isinstance(each, LeftOut) else each)) for each in things]
    alike = Counter(bare.replace(named(bare) or "\0", "\0") for _, bare in listed)
    return together((whole if alike[bare.replace(named(bare) or "\0", "\0")] <= MOST_ALIKE else bare, named(bare))
                    for whole, bare in listed)


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
