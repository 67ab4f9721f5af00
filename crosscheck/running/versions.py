"""What figures depend on besides the scene: versions of engines and libraries, and our own code."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import platform
from collections.abc import Iterable
from pathlib import Path

from crosscheck.errors import CrosscheckError, EngineError, install

NOT_INSTALLED = "not installed"
LIBRARIES = ("numpy", "scipy", "heyoka")
ROOMS = ("scene", "references", "adapters", "running", "judge")
"""Folders of the package whose code makes figures; pages and commands do not."""


def of(engines: Iterable[str]) -> dict[str, str]:
    """Versions by name, "code" among them: a digest of our own code and kernel."""
    found = {name: engine_version(name) for name in sorted(set(engines))}
    found |= {name: of_package(name) for name in LIBRARIES}
    return found | {"python": platform.python_version(), "code": digest(ROOMS).hex()[:12]}


def engine_version(name: str) -> str:
    """Version of an engine, or "not installed" where its package, or a package it needs, is missing."""
    from crosscheck import adapters

    try:
        return adapters.get(name).version()
    except ImportError:  # PackageNotFoundError is one
        return NOT_INSTALLED


def need(engines: Iterable[str]) -> None:
    """Raise `EngineError` for the first engine whose package is missing, with what brings it."""
    for name in engines:
        if engine_version(name) == NOT_INSTALLED:
            raise EngineError(f"engine {name} is not installed; {install(name)}")


def of_package(name: str) -> str:
    """Version of a Python package as installed, or "not installed"."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return NOT_INSTALLED


@functools.cache
def digest(folders: tuple[str, ...], more: tuple[Path, ...] = ()) -> bytes:
    """Digest of folders of crosscheck, of lieeuler with its kernel, and of `more` files.

    Of the files as this process found them first: that is what it has imported, whoever edits them later.
    """
    package, read = Path(__file__).parents[1], hashlib.sha256()
    sources = [path for folder in folders for path in sorted((package / folder).rglob("*.py"))]
    for name in ("lieeuler", "lieeuler._kernel"):
        found = importlib.util.find_spec(name)
        if found is not None and found.origin:
            origin = Path(found.origin)
            sources += sorted(origin.parent.glob("*.py")) if name == "lieeuler" else [origin]
    for source in (*sources, *more):
        read.update(source.read_bytes())
    return read.digest()


def refuse_others(planned: dict[str, str], found: dict[str, str], where: str) -> None:
    """Raise `CrosscheckError` with the difference where versions differ."""
    differ = [f"{name} {found.get(name, 'missing')} instead of {version}" for name, version in planned.items()
              if found.get(name) != version]
    if differ:
        raise CrosscheckError(f"{where} has other versions: {', '.join(differ)}; install the same ones there")
