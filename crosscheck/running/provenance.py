"""What results were made with: versions, machine and commit."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path

from crosscheck.running.versions import NOT_INSTALLED as NOT_INSTALLED
from crosscheck.running.versions import digest, of_package
from crosscheck.running.versions import engine_version as engine_version

PACKAGES = ("lieeuler-crosscheck", "numpy", "scipy", "heyoka")


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
