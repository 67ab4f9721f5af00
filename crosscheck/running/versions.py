"""What results depend on besides the scene: versions of engines and libraries, and the code of this project."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import platform
from collections.abc import Iterable
from pathlib import Path

from crosscheck.adapters.base import version_of
from crosscheck.errors import CrosscheckError, EngineError, install

NOT_INSTALLED = "not installed"
LIBRARIES = ("numpy", "scipy", "heyoka")
ROOMS = ("scene", "references", "adapters", "running", "compare", "judge", "verification")
"""Folders of the package whose code affects results. The code of pages and commands does not."""


def of(engines: Iterable[str]) -> dict[str, str]:
    """Versions by name. "code" is a digest of this project's code and kernel."""
    installed = {name: engine_version(name) for name in sorted(set(engines))}
    installed |= {name: of_package(name) for name in LIBRARIES}
    return installed | {"python": platform.python_version(), "code": digest(ROOMS).hex()[:12]}


def engine_version(name: str) -> str:
    """Version of an engine, or "not installed" if its package, or one that it needs, is missing."""
    from crosscheck import adapters

    try:
        return adapters.get(name).version()
    except ImportError:  # PackageNotFoundError is one
        return NOT_INSTALLED


def need(engines: Iterable[str]) -> None:
    """Raise `EngineError` for the first engine whose package is missing; the message says how to install it."""
    for name in engines:
        if engine_version(name) == NOT_INSTALLED:
            raise EngineError(f"engine {name} is not installed; {install(name)}")


def of_package(name: str) -> str:
    """Version of an installed Python package, or "not installed"."""
    try:
        return version_of(name)
    except importlib.metadata.PackageNotFoundError:
        return NOT_INSTALLED


@functools.cache
def digest(folders: tuple[str, ...]) -> bytes:
    """Digest of folders of crosscheck and of lieeuler with its kernel.

    The result is kept for the life of the process, because later edits of the files do not change the imported code.
    """
    package, read = Path(__file__).parents[1], hashlib.sha256()
    sources = [path for folder in folders for path in sorted((package / folder).rglob("*.py"))]
    for name in ("lieeuler", "lieeuler._kernel"):
        module = importlib.util.find_spec(name)
        if module is not None and module.origin:
            origin = Path(module.origin)
            sources += sorted(origin.parent.glob("*.py")) if name == "lieeuler" else [origin]
    for source in sources:
        read.update(source.read_bytes())
    return read.digest()


def refuse_others(planned: dict[str, str], there: dict[str, str], where: str) -> None:
    """Raise `CrosscheckError` with a list of the differences if any version differs."""
    differ = [f"{name} {there.get(name, 'missing')} instead of {version}" for name, version in planned.items()
              if there.get(name) != version]
    if differ:
        raise CrosscheckError(f"{where} has other versions: {', '.join(differ)}; install the same ones there")
