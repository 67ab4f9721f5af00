"""The tests mirror the packages: what checks `crosscheck/judge/` is in `tests/judge/`."""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The checkout."""

SCENARIOS = ROOT / "scenarios"
