"""What a known defect of an engine excuses: findings of its kinds, up to about the size that was measured."""

from __future__ import annotations

from collections.abc import Sequence

from crosscheck.document import Finding
from crosscheck.document.known import Known

ORDER_MARGIN = 0.5
"""An order may fall short by so much more than was measured."""

SIZE_MARGIN = 2.0
"""Times the errors of the main run that were measured with a defect, beyond which it excuses nothing at all."""

RISING = -0.25
"""Orders below it are those of errors that rise as steps shrink. What a wrong model leaves does not: its order is 0."""

RISES = "errors rise as steps shrink, as rounding does that adds up from step to step"


def excuses(entry: Known, finding: Finding) -> bool:
    """Whether a failing finding is of a kind and a size that the defect explains."""
    most = entry.kinds.get(finding.kind)
    if most is None or finding.value is None or finding.bound is None:
        return most is not None
    if finding.kind.startswith("order"):
        if entry.rising and not finding.value <= RISING:
            return False
        return finding.bound - finding.value <= most + ORDER_MARGIN
    return finding.value <= entry.margin * most * finding.bound


def alike(entry: Known, findings: Sequence[Finding]) -> bool:
    """Whether the errors of a run are about as large as with this defect alone, as far as these were measured.

    A defect that hides the orders of errors would otherwise hide a wrong model, too.
    """
    return not any(finding.value is not None and not finding.value <= SIZE_MARGIN * entry.sizes[finding.kind]
                   for finding in findings if finding.kind in entry.sizes)
