"""The errors of crosscheck, and the sentence that answers an unknown name.

Two more errors live where they arise: `crosscheck.TruthError`, in `crosscheck.references.base`, and
`lieeuler.IntegrationError`, which carries the trajectory so far.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class CrosscheckError(Exception):
    """Base of all errors of crosscheck: the message is written for the user."""


class SceneError(CrosscheckError):
    """A scene file is wrong. The message names the file, the entry and the mend."""


class Unsupported(CrosscheckError):
    """An engine cannot model this scene, or not in this form or with this method; the message is the reason."""


class EngineError(CrosscheckError):
    """An engine failed while it ran; the message carries what it said."""


class ArgumentError(CrosscheckError, ValueError):
    """A wrong argument to a public function; the message names it and lists what is allowed."""


def unknown(what: str, given: object, allowed: Iterable[str]) -> str:
    """One sentence: what was wrong, the nearest allowed name if there is a near one, and all allowed names."""
    allowed = list(allowed)
    lower = {name.lower(): name for name in allowed}
    near = difflib.get_close_matches(str(given).lower(), lower, n=1)
    guess = f"; did you mean {lower[near[0]]!r}?" if near else ";"
    return f"{what}: {given!r} is not known{guess} allowed: {', '.join(allowed)}"
