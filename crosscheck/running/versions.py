"""What figures depend on besides the scene: versions of engines and libraries, and our own code."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import platform
from collections.abc import Iterable
from pathlib import Path

from crosscheck.errors import CrosscheckError

LIBRARIES = ("numpy", "scipy", "heyoka")
ROOMS = ("scene", "references", "adapters", "running", "judge")
"""Folders of the package whose code makes figures; pages and commands do not."""


def of(engines: Iterable[str]) -> dict[str, str]:
    """Versions by name, "code" among them: a digest of our own code and kernel."""
    from crosscheck.running.provenance import engine_version

    found = {name: engine_version(name) for name in sorted(set(engines))}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found | {"python": platform.python_version(), "code": code()}


@functools.cache
def code() -> str:
    """Digest of the code that makes figures."""
    package = Path(__file__).parents[1]
    sources = [path for room in ROOMS for path in sorted((package / room).rglob("*.py"))]
    for name in ("lieeuler", "lieeuler._kernel"):
        found = importlib.util.find_spec(name)
        if found is not None and found.origin:
            origin = Path(found.origin)
            sources += sorted(origin.parent.glob("*.py")) if name == "lieeuler" else [origin]
    digest = hashlib.sha256()
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


def refuse_others(planned: dict[str, str], found: dict[str, str], where: str) -> None:
    """Raise `CrosscheckError` with the difference where versions differ."""
    differ = [f"{name} {found.get(name, 'missing')} instead of {version}" for name, version in planned.items()
              if found.get(name) != version]
    if differ:
        raise CrosscheckError(f"{where} has other versions: {', '.join(differ)}; install the same ones there")
