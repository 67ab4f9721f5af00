"""Finds the releases of an engine that changed its answer, by the script of `crosscheck.inspection.reproduce`."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from crosscheck.adapters.external import versions
from crosscheck.document import QUANTITIES
from crosscheck.errors import ArgumentError, EngineError
from crosscheck.inspection.reproduce import Reproduction

LONGEST = 600.0
"""Time limit of a run of the script, s."""

NUDGE, BEYOND = 1e-14, 100.0
"""Relative change of the step by which rounding is estimated, and how many times its effect counts as no change."""

PROBES = 8
"""Parts of equal size into which a span is divided before the search, so that a change and its undoing are seen."""

NEEDED = ("numpy",)
"""The packages beside the engine that the script needs."""

RUN = f"""
import json, runpy, sys
script, step = runpy.run_path(sys.argv[1]), float(sys.argv[2])
own, nudged, halved = script["motion"](step), script["motion"](step, {NUDGE!r}), script["motion"](step / 2)
print(json.dumps([own.tolist(), nudged.tolist(), script["worst"](own)[0], script["worst"](halved)[0]]))
"""


@dataclasses.dataclass(frozen=True)
class Release:
    """The answer of one version, each quantity over its size: with a nudged step what rounding may make of it, and the
    largest errors against truth with the step and with half of it, infinite where a run does not stay finite."""

    version: str
    states: np.ndarray  # (times, numbers)
    nudged: np.ndarray
    error: float
    halved: float

    @property
    def order(self) -> float:
        """The observed order."""
        usual = 0 < self.error < math.inf and 0 < self.halved < math.inf
        return math.log2(self.error / self.halved) if usual else math.nan

    @property
    def noise(self) -> np.ndarray:
        """(times, 1) what rounding may make up to each time."""
        apart = np.abs(self.nudged - self.states) + np.finfo(float).eps * np.abs(self.states)
        return BEYOND * np.maximum.accumulate(np.nan_to_num(apart, posinf=0.0).max(axis=1, keepdims=True))

    @property
    def finite(self) -> np.ndarray:
        """(times,) 1 where it is finite, 0 where it is not, NaN where rounding decides."""
        own, other = (np.isfinite(each).all(axis=1) for each in (self.states, self.nudged))
        return np.where(own == other, own, np.nan)

    def __str__(self) -> str:
        return (f"error {self.error:.3g} of its size, order {self.order:.2f}" if math.isfinite(self.error) else
                "its numbers do not stay finite")


@dataclasses.dataclass(frozen=True)
class Change:
    """Two neighbouring releases with different answers."""

    before: Release
    after: Release

    @property
    def noise(self) -> np.ndarray:
        """(times, 1) what rounding may make of the difference."""
        return np.asarray(np.maximum(self.before.noise, self.after.noise))

    @property
    def gaps(self) -> np.ndarray:
        """(times,) largest difference of a number over its size, 0 where one of the two is not finite."""
        return np.asarray(np.nan_to_num(np.abs(self.after.states - self.before.states), posinf=0.0).max(axis=1))

    @property
    def size(self) -> float:
        """The largest difference of those that rounding does not explain; 0 if there is none."""
        return float(np.where(self.gaps > self.noise[:, 0], self.gaps, 0.0).max())

    @property
    def ends(self) -> bool:
        """Whether one of the two, and whatever rounding does, is not finite where the other is."""
        return bool((np.abs(self.before.finite - self.after.finite) == 1.0).any())

    def __str__(self) -> str:
        at = int(np.argmax(np.where(self.gaps > self.noise[:, 0], self.gaps, 0.0)))
        by = f" by {self.size:.3g} of its size (rounding explains {self.noise[at, 0]:.1g})" if self.size else ""
        return f"{self.after.version} changed the answer of {self.before.version}{by}: {self.before}; then {self.after}"


@dataclasses.dataclass(frozen=True)
class Bisection:
    """All changes that were found, the releases that were run, those that could not be, and the time it took, s."""

    changes: tuple[Change, ...]
    tried: tuple[Release, ...]
    failed: dict[str, str]
    count: int  # releases in the range
    seconds: float


def released(engine: str, span: str) -> list[str]:
    """The released versions of an engine in "first..last", oldest first, both ends included."""
    first, dots, last = span.partition("..")
    if not dots:
        raise ArgumentError(f"versions: {span!r}; write the first and the last as 3.1.0..4.0.0")
    for end in (first, last):
        versions.split(f"{engine}=={end}")
    if _key(first) >= _key(last):
        raise ArgumentError(f"versions: {span!r}: the first is not older than the last; exchange them")
    package = versions.PACKAGES[engine][0]
    asked = subprocess.run([sys.executable, "-I", "-m", "pip", "index", "versions", package,
                            "--disable-pip-version-check", "--no-input"], capture_output=True, text=True,
                           timeout=LONGEST)
    listed = re.search(r"Available versions: (.*)", asked.stdout)
    known = set(listed[1].replace(",", " ").split()) if listed else versions.kept(engine)
    inside = {each for each in known if re.fullmatch(r"[0-9.]+", each) and _key(first) < _key(each) < _key(last)}
    return sorted({first, last, *inside}, key=_key)


def bisect(script: Reproduction, engine: str, span: str, echo: Callable[[str], object] = lambda words: None,
           progress: Callable[[int, int | None, str], object] = lambda *_: None) -> Bisection:
    """Find the changes between the releases of `span`; an environment is made for each release that is run, and kept.

    A few releases over the whole span are run first, and every part whose two ends differ is searched. So changes are
    missed only where later ones undo them inside one part. A release that cannot be installed or run is passed over in
    favour of its neighbour. Raises `EngineError` if an end fails.
    """
    began, names, failed = time.monotonic(), released(engine, span), dict[str, str]()
    done: dict[int, Release | None] = {}

    def at(index: int) -> Release | None:
        if index not in done:
            progress(len(done), len(names), f"installing and running {engine}=={names[index]}")
            try:
                done[index] = release = _run(script, engine, names[index])
                echo(f"{release.version}: {release}")
            except EngineError as error:
                done[index], failed[names[index]] = None, str(error)
                echo(f"{names[index]} is passed over: {error}")
        return done[index]

    def changes(low: int, high: int) -> list[Change]:
        one, other = at(low), at(high)
        assert one is not None
        assert other is not None
        change = Change(one, other)
        if not change.size and not change.ends:
            return []
        between = sorted(range(low + 1, high), key=lambda index: abs(index - (low + high) / 2))
        middle = next((index for index in between if at(index) is not None), None)
        return [change] if middle is None else [*changes(low, middle), *changes(middle, high)]

    for end in (0, len(names) - 1):
        if at(end) is None:
            raise EngineError(f"{failed[names[end]]}; take another end of --versions than {names[end]}")
    probes = np.unique(np.linspace(0, len(names) - 1, PROBES + 1).round().astype(int)).tolist()
    posts = [index for index in probes if at(index) is not None]
    every = tuple(change for low, high in itertools.pairwise(posts) for change in changes(low, high))
    tried = tuple(release for _, release in sorted(done.items()) if release is not None)
    return Bisection(every, tried, failed, len(names), time.monotonic() - began)


def _run(script: Reproduction, engine: str, version: str) -> Release:
    """The answer of one version; raises `EngineError` if it cannot be installed or does not run the script."""
    python = versions.environment(engine, version, NEEDED)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "script.py"
        path.write_text(script.text, encoding="utf-8")
        try:
            ended = subprocess.run([python, "-c", RUN, str(path), repr(script.step)], capture_output=True, text=True,
                                   timeout=LONGEST, cwd=folder)
        except subprocess.TimeoutExpired:
            raise EngineError(f"{engine}=={version}: the script took longer than {LONGEST:g} s") from None
    try:
        own, nudged, error, halved = json.loads(ended.stdout.splitlines()[-1])
    except (ValueError, IndexError):
        said = (ended.stderr.strip().splitlines() or ["nothing"])[-1]
        raise EngineError(f"{engine}=={version} does not run the script: {said[:300]}") from None
    sizes = np.repeat([script.sizes[name] for name in QUANTITIES], (3, 9, 3, 3))
    states, other = ((np.array(each) / sizes).reshape(len(script.expected), -1) for each in (own, nudged))
    return Release(version, states, other, error, halved)


def _key(version: str) -> tuple[int, ...]:
    """Of a released version, to sort by."""
    return tuple(int(part) for part in re.findall(r"[0-9]+", version))


def issue(script: Reproduction, engine: str, result: Bisection | None = None) -> str:
    """A text ready to file: what was expected and observed, versions, an order plot and the script."""
    lines = [f"# {script.title}: {'the answer changed between releases' if result else 'error against truth'}", "",
             f"Expected: {script.source}.", "", *(f"Without {each}.\n" for each in script.left_out)]
    if result is not None:
        lines += [*(f"- {engine} {change}." for change in result.changes), *([] if result.changes else [
            "- No release in the range changed the answer beyond rounding."]), "",
            f"Observed ({platform.system()} {platform.machine()}, Python {platform.python_version()}):", "",
            "| version | error over its size | with half the step | order |", "|---|---|---|---|",
            *(f"| {each.version} | {each.error:.3e} | {each.halved:.3e} | {each.order:.2f} |" for each in result.tried),
            "",
            "Error over its size with the step h and with h/2, one # for a factor of two above the smallest:",
            "", "```text",
            *_bars(result.tried), "```", ""]
    return "\n".join([*lines, "## Script", "", "```python", script.text.rstrip("\n"), "```", ""])


def _bars(releases: Sequence[Release]) -> list[str]:
    values = [(each.version, which, value) for each in releases for which, value in (("h", each.error),
                                                                                   ("h/2", each.halved))]
    least = min((value for *_, value in values if 0 < value < math.inf), default=1.0)
    return [f"{version:>10} {which:<4}{value:.2e} " + ("#" * (1 + round(math.log2(max(value, least) / least)))
                                                   if math.isfinite(value) else "does not stay finite")
            for version, which, value in values]
