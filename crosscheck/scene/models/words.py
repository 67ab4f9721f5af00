"""Many sentences that say the same of many joints or bodies, as few."""

from __future__ import annotations

from collections.abc import Iterable

MOST_ALIKE, MOST_NAMED = 3, 6
"""Sentences of one kind that are written out, and names in the one that stands for more of them."""


def together(sentences: Iterable[tuple[str, str]]) -> list[str]:
    """(sentence, name in it) in turn: where more than a few differ in the name only, the first one names the others."""
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


def quoted(sentence: str) -> tuple[str, str]:
    """The sentence with the first name in it that stands between quotes."""
    parts = sentence.split("'")
    return sentence, f"'{parts[1]}'" if len(parts) == 3 else ""
