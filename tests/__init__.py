"""The tests mirror the packages: what checks `crosscheck/judge/` is in `tests/judge/`."""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The checkout."""

SCENARIOS = ROOT / "scenarios"


def saved(path: Path, text: str) -> Path:
    """The path of a file that now holds this text."""
    path.write_text(text, encoding="utf-8")
    return path
