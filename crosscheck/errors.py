"""The errors of crosscheck, and the sentence that answers an unknown name.

Two more errors live where they arise: `crosscheck.TruthError`, in `crosscheck.references.base`, and
`lieeuler.IntegrationError`, which carries the trajectory so far.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

FAILED = "✗ "
"""The beginning of the label of a task that failed: the terminal shows it at once, and keeps it."""


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


EXTRAS = {
    "mujoco": "mujoco", "pinocchio": "pinocchio", "pin": "pinocchio", "exudyn": "exudyn", "pydrake": "drake",
    "dartpy": "dart", "heyoka": "truth", "pandas": "data", "pyarrow": "data", "xarray": "data", "jinja2": "report",
    "plotly": "report", "matplotlib": "report", "pypdf": "report", "sqlalchemy": "history", "psycopg": "history",
    "distributed": "cluster", "dask": "cluster", "rerun": "rerun", "drake": "drake", "dart": "dart",
}
"""The extra of pyproject.toml that brings a module or an engine."""


def install(name: str) -> str:
    """How to get what brings a module or an engine."""
    extra = EXTRAS.get(name.partition(".")[0])
    return f"pip install 'lieeuler-crosscheck[{extra}]'" if extra else f"pip install {name}"


def missing(error: ImportError) -> str:
    """One sentence: which module is missing, and the extra that brings it."""
    name = error.name or str(error)
    return f"{name.partition('.')[0]} is not installed; {install(name)}" if error.name else str(error)


def unknown(what: str, given: object, allowed: Iterable[str]) -> str:
    """One sentence: what was wrong, the nearest allowed name if there is a near one, and all allowed names."""
    allowed = list(allowed)
    lower = {name.lower(): name for name in allowed}
    near = difflib.get_close_matches(str(given).lower(), lower, n=1)
    guess = f"; did you mean {lower[near[0]]!r}?" if near else ";"
    return f"{what}: {given!r} is not known{guess} allowed: {', '.join(allowed)}"


def said(error: BaseException) -> str:
    """What an error says, in one line; its name where it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__
