"""Known defects of engines, each with its reason and its size. They show as "known" and pass; one that vanishes fails.

An engine declares its own. An entry is written only after its cause is understood or documented by the engine, never to
silence a finding. It excuses no more than about the size that was measured (`crosscheck.judge.known`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Container, Mapping
from typing import Any

STATE = ("position", "attitude", "velocity", "angular velocity")
ORDERS = tuple(f"order {quantity}" for quantity in STATE)


@dataclasses.dataclass(frozen=True)
class Known:
    """A defect: in which runs and findings it shows, how large it was, and why it is there."""

    versions: tuple[str, ...]  # each stands for every version that begins so, as "3" for 3.3.7
    methods: tuple[str, ...]
    scenes: Container[str] | Callable[[Any, str, str | None], bool] | None  # names, or a rule of engine, scene and form
    forms: tuple[str, ...] | None  # None: any form
    kinds: Mapping[str, float]  # of findings: the largest value over its bound that was measured; of orders, the lack
    reason: str
    always: bool = True  # it has to show in every such run: where it does not, it has vanished
    margin: float = 10.0  # times the largest measured size beyond which it excuses nothing: errors move by a few
    rising: bool = False  # of orders it excuses only those of errors that rise as steps shrink
    sizes: Mapping[str, float] = dataclasses.field(default_factory=dict)  # by kind of finding, of the main run with it
