"""The sentence that answers a name nobody knows."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def unknown(what: str, given: object, allowed: Iterable[str]) -> str:
    """One sentence: what was wrong, the nearest allowed name if there is a near one, and all allowed names."""
    allowed = list(allowed)
    lower = {name.lower(): name for name in allowed}
    near = difflib.get_close_matches(str(given).lower(), lower, n=1)
    guess = f"; did you mean {lower[near[0]]!r}?" if near else ";"
    return f"{what}: {given!r} is not known{guess} allowed: {', '.join(allowed)}"
