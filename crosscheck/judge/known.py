"""What a known defect of an engine excuses: findings of its rows, up to about the size that was measured."""

from __future__ import annotations

from crosscheck.document import Finding
from crosscheck.document.known import Known

MARGIN = 1.5
"""Times the listed size up to which it excuses: the size moves with version, machine and step."""


def excuses(entry: Known, finding: Finding) -> bool:
    """Whether a failing finding is of a row and a size that the defect explains."""
    if finding.value is None:
        return finding.kind in entry.rows and finding.about == "asked"
    return covers(entry, finding.kind, finding.value, finding.size)


def covers(entry: Known, kind: str, value: float, size: float | None) -> bool:
    """Whether a defect explains this value of a row, of a quantity of this size."""
    most = entry.rows.get(kind)
    return most is not None and value <= MARGIN * most * (size or 1.0)
