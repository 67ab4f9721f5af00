"""What all types of the document have in common."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec


class Part(msgspec.Struct, frozen=True):
    """A part of the document. It cannot be changed; `msgspec.structs.replace` makes a changed copy."""


P = TypeVar("P", bound=Part)


def extended(kind: type[P], part: Part, **more: Any) -> P:
    """A value of the next stage's type, with the fields of `part` and `more`."""
    return kind(**{**msgspec.structs.asdict(part), **more})
