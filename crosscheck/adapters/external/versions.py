"""Engines in a separate Python environment, run there by the same adapter: of a chosen version, as "mujoco==3.3.7",
and those that cannot share one with the others, as "mjx".

pip makes the environment on first use of a version, in the cache folder. A worker process in it takes scenes and
returns raw runs. Its times belong to another interpreter and other libraries, so they are not compared with others.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from crosscheck.adapters import built_in
from crosscheck.adapters.base import Engine, RawRun, RunSpec, StandIn
from crosscheck.adapters.common.native import JointStates, Native
from crosscheck.adapters.external import remote
from crosscheck.adapters.external.apart import Process
from crosscheck.adapters.external.remote import T
from crosscheck.errors import ArgumentError, EngineError, install
from crosscheck.files import cache_folder
from crosscheck.scene.model import Scene

PACKAGES = {name: entry.package.split() for name, entry in built_in.ENTRIES.items() if entry.package}
"""Engines whose version can be chosen, and their packages, which all have that version."""

_NUMBER = r"(?:0|[1-9][0-9]*)"
_VERSION = re.compile(rf"({_NUMBER}!)?{_NUMBER}(\.{_NUMBER})*((a|b|rc){_NUMBER})?(\.post{_NUMBER})?(\.dev{_NUMBER})?"
                      r"(\+[a-z0-9]+(\.[a-z0-9]+)*)?")
"""Versions in the canonical form of PEP 440."""

NEEDED = ("numpy", "scipy", "msgspec")
"""The packages that adapters import besides their engine."""

LONGEST = 900.0
"""Longest time to make an environment, s."""


class Versioned(StandIn):
    """An engine in an environment of its own; an `Engine` like the others.

    What its adapter says without the engine is asked here, and the rest there.
    """

    def __init__(self, name: str) -> None:
        self._home, _, version = name.partition("==")
        if "==" in name:
            split(name)
        super().__init__(built_in.ENTRIES[self._home].make())
        self.name = name
        self._python = environment(self._home, version) if version else None
        self._process: Process | None = None
        if version and version != self.version():  # "3" installs 3.0.0, and reports must name the version that ran
            raise ArgumentError(f"engine: {name!r}: this is version {self.version()}; write "
                                f"{self._home}=={self.version()}")

    def native(self, path: str, states: JointStates) -> Native:
        """The model that the engine makes of a model file in its own environment."""
        return self._ask(remote.native, path, states)

    def version(self) -> str:
        """Version of the engine in its environment; raises `PackageNotFoundError` if there is none."""
        if self._python is None and present(self._home) is None:
            raise importlib.metadata.PackageNotFoundError(self._home)
        return self._ask(functools.partial(remote.asked, Engine.version))

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate in the engine's own environment."""
        raw = self._ask(remote.run, scene, spec).raw()
        raw.stats["own_environment"] = True
        return raw

    def _ask(self, function: Callable[..., T], *arguments: object) -> T:
        python = self._python or present(self._home)
        if python is None:
            raise EngineError(f"engine {self.name} is not installed; {install(self.name)}")
        if self._process is None:
            self._process = Process(self.name, python)
        answer: T = self._process.call(function, self._home, *arguments)
        return answer


def split(name: str) -> tuple[str, str]:
    """(engine, version) of "engine==version"; raises `ArgumentError` for anything else."""
    engine, _, version = name.partition("==")
    if engine not in PACKAGES:
        raise ArgumentError(f"engine: {name!r}: a version can be chosen for {', '.join(PACKAGES)}; other engines run "
                            "as they are installed")
    if not _VERSION.fullmatch(version):
        raise ArgumentError(f"engine: {name!r}: {version!r} is no version; write it like {engine}==1.2.3")
    return engine, version


def folder(engine: str, version: str, needed: Sequence[str] = NEEDED) -> Path:
    """The folder of the environment of this version with the packages that are `needed` besides."""
    python = f"{platform.python_implementation().lower()}{sys.version_info[0]}.{sys.version_info[1]}"
    digest = hashlib.sha256(" ".join(needed).encode()).hexdigest()[:6]  # so that other packages make a new one
    return cache_folder() / "engines" / f"{PACKAGES[engine][0].partition('[')[0]}-{version}-{python}-{digest}"


def kept(engine: str) -> set[str]:
    """The versions of which there is an environment."""
    name = PACKAGES[engine][0].partition("[")[0]
    return {each.name.split("-")[-3] for each in (cache_folder() / "engines").glob(f"{name}-*-*-*")}


def present(engine: str) -> str | None:
    """The Python interpreter of an engine that always has its own environment; None if it does not exist.

    It is the one that a variable such as CROSSCHECK_MJX_PYTHON names, else that of the version the adapter is for.
    """
    own = os.environ.get(f"CROSSCHECK_{engine.partition('-')[0].upper()}_PYTHON")
    python = Path(own) if own else folder(engine, built_in.ENTRIES[engine].version) / "bin" / "python"
    return str(python) if python.exists() else None


def environment(engine: str, version: str, needed: Sequence[str] = NEEDED) -> str:
    """The Python interpreter of the environment of this version, which is made if it does not exist yet.

    It holds the packages that are `needed` besides. Raises `EngineError` if it cannot be made; the message says what
    to do.
    """
    place = folder(engine, version, needed)
    for there in (place, folder(engine, version)):  # one that holds more will do
        if (python := there / "bin" / "python").exists():
            return str(python)
    python = place / "bin" / "python"
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent, prefix=f".{place.name}.") as holder:
            aside = Path(holder) / "environment"
            _make(engine, version, aside, needed)
            try:
                aside.rename(place)  # complete or not at all; an environment finds its files by its own path
            except OSError:
                if not python.exists():  # unless another process has made it meanwhile
                    raise
    except OSError as error:
        raise EngineError(f"{engine}=={version}: its environment cannot be kept in {place.parent} "
                          f"({error.strerror or error}); set CROSSCHECK_CACHE to a folder that can be written"
                          ) from error
    return str(python)


def _make(engine: str, version: str, place: Path, needed: Sequence[str]) -> None:
    wanted = [f"{package}=={version}" for package in PACKAGES[engine]]
    python = place / "bin" / "python"
    # Only wheels: compiling an engine takes an hour, or needs tools that are not installed.
    packages = ["--quiet", "--only-binary", ":all:", *wanted, *needed,
                *built_in.ENTRIES[engine].extras.split()]
    if uv := shutil.which("uv"):
        steps = [[uv, "venv", "--quiet", "--python", sys.executable, str(place)],
                 [uv, "pip", "install", "--python", str(python), *packages]]
    else:
        steps = [[sys.executable, "-m", "venv", str(place)],
                 [str(python), "-I", "-m", "pip", "install", "--disable-pip-version-check", "--no-input",
                  "--retries", "2", *packages]]
    for words in steps:
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=LONGEST,
                                  env={**os.environ, "PYTHONPATH": ""})
        except subprocess.TimeoutExpired:
            raise EngineError(f"{engine}=={version}: installing it took longer than {LONGEST:g} s; try again, or check "
                              "the connection") from None
        if done.returncode:
            raise EngineError(f"{engine}=={version}: {_explained(wanted[0], (done.stderr or done.stdout).strip())}")


def _explained(wanted: str, said: str) -> str:
    """The reason of a failed installation, from pip's output."""
    lines = [line.removeprefix("ERROR: ") for line in said.splitlines() if line.strip()]
    listed = re.search(r"\(from versions: ([^)]*)\)", said)
    if listed and listed[1] != "none":
        known = [each.strip() for each in listed[1].split(",")]
        return (f"there is no {wanted} for Python {platform.python_version()} on this machine; versions there are: "
                f"{', '.join(known)}")
    if listed or re.search(r"connection|resolve|timed out|network", said, re.IGNORECASE):
        return (f"{wanted} cannot be fetched: is there a network? Once it is installed it is kept, and needs none; "
                f"pip said: {lines[-1] if lines else 'nothing'}")
    return f"{wanted} cannot be installed; pip said: {lines[-1] if lines else 'nothing'}"
