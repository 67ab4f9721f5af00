"""A badge for a README: a small SVG with the numbers of runs that pass, pass partly and fail."""

from __future__ import annotations

from crosscheck.document import Document
from crosscheck.report.headline import state

LETTER = 7
"""Width of a letter in pixels. `textLength` stretches the text to it, whatever the font."""

COLOURS = {0: "#1a7f37", 1: "#b3261e"}
"""Colour by exit code. White letters on both have a contrast above 4.5."""


def badge(document: Document) -> str:
    """The text of the SVG."""
    failing = sum(record.outcome in ("fail", "error") for record in document.records)
    passing = sum(state(record) in ("pass", "known") for record in document.records)
    part = sum(state(record) == "partly" for record in document.records)
    counts = {"pass": passing, "partly": part, "fail": failing}
    told = ", ".join(f"{count} {word}" for word, count in counts.items() if count) or "nothing ran"
    colour = COLOURS.get(document.exit_code, "#5f6368") if any(counts.values()) else "#5f6368"
    left, right = (LETTER * len(word) + 12 for word in ("crosscheck", told))
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{left + right}" height="20" role="img" '
            f'aria-label="crosscheck: {told}"><title>crosscheck: {told}</title>'
            f'<rect width="{left}" height="20" fill="#444"/><rect x="{left}" width="{right}" height="20" '
            f'fill="{colour}"/><g fill="#fff" font-family="Verdana,sans-serif" font-size="11">'
            f'<text x="6" y="14" textLength="{left - 12}">crosscheck</text>'
            f'<text x="{left + 6}" y="14" textLength="{right - 12}">{told}</text></g></svg>\n')
