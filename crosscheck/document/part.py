"""What all types of the document have in common."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec


class Part(msgspec.Struct, frozen=True):
    """A part of the document. It is never changed: `msgspec.structs.replace` makes another one."""


P = TypeVar("P", bound=Part)


def extended(kind: type[P], part: Part, **more: Any) -> P:
    """What the next stage returns: the fields of `part`, and more."""
    return kind(**{**msgspec.structs.asdict(part), **more})
