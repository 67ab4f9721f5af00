"""What a known defect of an engine excuses: findings of its rows, up to about the size that was measured."""

from __future__ import annotations

from crosscheck.document import Finding
from crosscheck.document.known import Known

MARGIN = 1.5
"""Times the listed size up to which it excuses: the size moves with version, machine and step."""


def excuses(entry: Known, finding: Finding) -> bool:
    """Whether a failing finding is of a row and a size that the defect explains."""
    most = entry.rows.get(finding.kind)
    if most is None or finding.value is None:
        return most is not None and finding.about == "asked"
    return finding.value <= MARGIN * most * (finding.size or 1.0)
