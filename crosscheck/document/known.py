"""Known defects of engines, each with its reason and size. They show as "known" and pass; one that vanishes is said.

An entry is written only after its cause is understood or documented by the engine, never to silence a finding.
"""

from __future__ import annotations

import msgspec


class Known(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A defect: in which runs and rows it shows, how large it is, and why it is there."""

    engine: str
    versions: tuple[str, ...]  # each stands for every version that begins so, as "3" for 3.3.7
    methods: tuple[str, ...]
    rows: dict[str, float]  # by kind of finding: the largest value over the size of the quantity; of orders, the lack
    reason: str
    evidence: str  # what was measured
    forms: tuple[str, ...] = ()  # none: any form
    scenes: tuple[str, ...] = ()  # none: any scene
    where: str = ""  # what a scene has that shows it, one of `crosscheck.adapters.common.known.WHERE`
    upstream: str = ""  # address of the engine's own issue
    always: bool = False  # it has to show in every such run: where it does not, it has vanished
