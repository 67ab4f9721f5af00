"""What results depend on and were made with: versions of engines and libraries, code, machine, commit."""

from __future__ import annotations

import contextlib
import datetime
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path

from crosscheck.adapters.base import version_of
from crosscheck.errors import CrosscheckError, EngineError, install

PACKAGES = ("lieeuler-crosscheck", "numpy", "scipy", "heyoka")
NOT_INSTALLED = "not installed"
ROOMS = ("scene", "references", "adapters", "running", "compare", "judge", "verification")
"""Folders of the package whose code affects results. The code of pages and commands does not."""


def describe(engine_names: Iterable[str]) -> dict[str, object]:
    """The fields of `crosscheck.document.Origin`, ready for JSON.

    These are versions of engines, packages and Python, the machine, the time (UTC) and, in a git checkout, the commit.
    """
    return _fixed(engine_names) | {"time": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
                                   "commit": _commit(Path(__file__).resolve().parents[2])}


def _fixed(engine_names: Iterable[str]) -> dict[str, object]:
    """What results depend on."""
    processor = platform.processor() or "unknown"
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")
    return {
        "engines": {name: engine_version(name) for name in engine_names},
        "packages": {name: of_package(name) for name in PACKAGES},
        "python": platform.python_version(),
        "machine": {"system": f"{platform.system()} {platform.machine()}", "processor": processor,
                    "cores": os.cpu_count()},
    }


def code_digest(engine_names: Iterable[str], more: object) -> str:
    """Digest of all that results depend on: versions, machine, the code of this project with its kernel, and `more`.

    `more` must be a value that can be written as JSON. Results of one study must all have the same digest.
    """
    state = hashlib.sha256(json.dumps([more, _fixed(engine_names)], sort_keys=True).encode())
    state.update(digest((".",)))
    return state.hexdigest()


def _commit(folder: Path) -> str | None:
    """The commit, with "+ changes" when files differ from it; None outside a checkout or without git."""
    if not (folder / ".git").exists():
        return None
    def git(*words: str) -> str | None:
        try:
            # Without this option, `git status` rewrites the index, and on a full disk leaves its lock file behind.
            done = subprocess.run(["git", "--no-optional-locks", "-C", str(folder), *words], capture_output=True,
                                  text=True, timeout=10)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None
    commit = git("rev-parse", "--short=12", "HEAD")
    if commit is None:
        return None
    return commit + (" + changes" if git("status", "--porcelain", "--untracked-files=no") else "")


def versions(engines: Iterable[str]) -> dict[str, str]:
    """Versions by name, of engines and libraries. "code" is a digest of this project's code and kernel."""
    installed = {name: engine_version(name) for name in sorted(set(engines))}
    installed |= {name: of_package(name) for name in PACKAGES[1:]}
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
