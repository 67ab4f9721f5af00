"""A golden file of results, and the differences between two of them, which show what a change of the code changes.

    python tools/golden.py record FILE [--revision REV] [--scene NAME] [--part NAME]    # all take about an hour
    python tools/golden.py compare BEFORE AFTER

What is recorded are the answers of public commands, each with an empty table of rows: `verify --profile smoke` over all
scenes with its order ladders, `explain` over a corpus, a sweep, the ladders of the study work-precision. Times and what
depends on them are left out. With a revision, its checkout is made and set up in a temporary folder. A comparison
lists outcomes that changed, and for every kind of figure how many values changed and by how much.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ENGINES = ("lieeuler", "mujoco", "pinocchio", "exudyn")
METHODS = ("DAE1L_LSE", "DAE2H_LE", "rattle2", "rkmk4", "taylor", "generalized_alpha", "Euler", "implicitfast", "RK4",
           "RKMK4", "RK44", "GeneralizedAlpha", "SemiImplicitEuler")
"""Of every family and engine one or two. The names that an engine lacks are left out."""

EXPLAINED = (("single_pendulum", "mujoco", "RK4"), ("single_pendulum", "pinocchio", "RKMK4"),
             ("double_pendulum", "mujoco", "implicitfast"))
"""Quick ones, some with a cause and some without."""

SWEEP = {"scenes": ["single_pendulum", "heavy_top", "double_pendulum"], "steps": [1e-2, 3e-3], "rtols": [1e-6],
         "engines": {"lieeuler": ["DAE1L_LSE", "rattle2", "rkmk853"], "mujoco": ["RK4"]}, "duration": 1.0,
         "samples": 11, "perturb": {"angular_velocity": 1e-3, "count": 4}}

PARTS = ("verify", "explain", "sweep", "ladders")

LADDERS = ("single_pendulum", "heavy_top", "four_bar")

SWEPT = """
import json, sys, crosscheck
frame = crosscheck.sweep(json.loads(sys.argv[1]), workers=1)
print(json.dumps(frame.to_dict(orient="records")))
"""

TIMES = re.compile(r"seconds|wall|ratio|speed|us_per|calibration|timing|^time$|repeats|setup|_ms|trust|recommended|best"
                   r"|command|meta|report|advice|version|frontier|^cell$|reused|engines|cost|code|elapsed")
"""Keys of values that are times, follow from times, or name versions."""

NAMES = ("scene", "label", "name", "engine", "method", "form", "kind", "step", "rtol", "member")
"""Keys by which an entry of a list is told from others."""

LONG = 200
"""Longer texts, such as packed curves, are recorded as digests."""


def answer(python: str, words: list[str], folder: Path, allowed: tuple[int, ...] = (0, 1, 2)) -> str:
    """What a command prints. Its table of rows is empty before it."""
    own = {"CROSSCHECK_TABLE": str(folder / "rows.sqlite"), "OMP_NUM_THREADS": "1"}
    (folder / "rows.sqlite").unlink(missing_ok=True)
    done = subprocess.run([python, *words], capture_output=True, text=True, env=os.environ | own, cwd=folder)
    if done.returncode not in allowed or not done.stdout.strip():
        raise SystemExit(f"{' '.join(words)[:200]}: exit code {done.returncode}\n{done.stderr[-2000:]}")
    return done.stdout


def record(python: str, scenes: list[str], parts: list[str]) -> dict[str, Any]:
    """All values of a golden file by their paths. `python` is that of the checkout; no scenes or parts are all."""
    found: dict[str, Any] = {}
    crosscheck = ["-m", "crosscheck"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        listed = json.loads(answer(python, ["-c", "import json, crosscheck; print(json.dumps([crosscheck.scenes(), "
                                            f"[crosscheck.methods(name) for name in {ENGINES!r}]]))"], folder))
        chosen = (scenes or listed[0]) if "verify" in parts else []
        methods = [method for method in METHODS if any(method in each for each in listed[1])]
        for scene in chosen:
            words = [word for option, names in (("--engine", ENGINES), ("--method", methods)) for each in names
                     for word in (option, each)]
            text = answer(python, [*crosscheck, "verify", "--profile", "smoke", "--scene", scene, "--jobs", "1",
                                   "--json", "--out", "report", *words], folder)
            found |= flat("verify", json.loads(text))
            print(f"{scene}: {len(found)} values", file=sys.stderr, flush=True)
        for scene, engine, method in EXPLAINED if "explain" in parts else ():
            text = answer(python, [*crosscheck, "explain", scene, "--engine", engine, "--method", method, "--json"],
                          folder)
            found |= flat(f"explain/{scene}/{engine}/{method}", json.loads(text))
        if "sweep" in parts:
            found |= flat("sweep", json.loads(answer(python, ["-c", SWEPT, json.dumps(SWEEP)], folder)))
        if "ladders" not in parts:
            return found
        answer(python, [*crosscheck, "study", "work-precision", *LADDERS, "--repeats", "1", "--time-limit", "0.1",
                        "--no-bound", *(word for each in ENGINES for word in ("--engine", each)), "--out", "ladders"],
               folder)
        found |= flat("ladders", json.loads((folder / "ladders" / "work-precision.json").read_text()))
    return found


def flat(path: str, content: Any) -> dict[str, Any]:
    """Every value by its path, in which entries of lists are named where they have names. Times are left out."""
    return dict(_flat(path, content))


def _flat(path: str, content: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(content, dict):
        for key, value in content.items():
            if not TIMES.search(key):
                yield from _flat(f"{path}/{key}", value)
    elif isinstance(content, list) and content and all(isinstance(each, dict) for each in content):
        count: dict[str, int] = {}
        for each in content:
            own = "+".join(str(each[key]) for key in NAMES if each.get(key) not in (None, ""))
            count[own] = count.get(own, 0) + 1
            yield from _flat(f"{path}/{own}" + (f"#{count[own]}" if count[own] > 1 else ""), each)
    elif isinstance(content, list):
        for index, each in enumerate(content):
            yield from _flat(f"{path}/{index}", each)
    elif isinstance(content, str) and len(content) > LONG:
        yield path, hashlib.sha256(content.encode()).hexdigest()[:16]
    else:
        yield path, None if isinstance(content, float) and math.isnan(content) else content


def kind_of(path: str) -> str:
    """What a value is: the command, and its name without numbers, scenes and runs."""
    words = path.split("/")
    return f"{words[0]} {'/'.join(word for word in words[-2:] if not re.search('[0-9+ ]', word))}"


def compare(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """The lines of a table of all differences; none if every value is the same bit for bit."""
    lines = [f"{len(names)} values only {where}, for one {min(names)}" for where, names in (
        ("before", before.keys() - after.keys()), ("after", after.keys() - before.keys())) if names]
    kinds: dict[str, list[tuple[float, str]]] = {}
    totals: dict[str, int] = {}
    for path in sorted(before.keys() & after.keys()):
        old, new, kind = before[path], after[path], kind_of(path)
        totals[kind] = totals.get(kind, 0) + 1
        if old == new and type(old) is type(new):
            continue
        numbers = [value for value in (old, new) if isinstance(value, int | float) and not isinstance(value, bool)]
        apart = abs(old - new) / max(abs(old), abs(new)) if len(numbers) == 2 else math.inf
        kinds.setdefault(kind, []).append((apart, path))
        if path.endswith(("/outcome", "/status", "/word", "/verdict", "/cause")):
            lines.append(f"{path}: {old} -> {new}")
    for kind, changed in sorted(kinds.items()):
        most, where = max(changed)
        lines.append(f"{kind:50} {len(changed):>7} of {totals[kind]:>7} differ, at most by "
                     f"{'a text or None' if math.isinf(most) else format(most, '.1e')}: {where}: "
                     f"{before[where]!r} -> {after[where]!r}")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--revision", help="record this commit, in a checkout of its own")
    parser.add_argument("--scene", action="append", default=[], help="only these; default: all")
    parser.add_argument("--part", action="append", choices=PARTS, help="only these; default: all")
    options = parser.parse_args()
    parts = options.part or list(PARTS)
    if options.what == "compare":
        before, after = (json.loads(path.read_text()) for path in options.files)
        print("\n".join(lines := compare(before, after)) or f"{len(before)} values, the same bit for bit")
        return int(bool(lines))
    python, root = sys.executable, Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory() as name:
        if options.revision:
            git = ["git", "-C", str(root), "worktree"]
            subprocess.run([*git, "add", "--detach", name, options.revision], check=True)
            try:
                subprocess.run(["make", "-s", "-C", name, "setup"], check=True)
                found = record(f"{name}/.venv/bin/python", options.scene, parts)
            finally:
                subprocess.run([*git, "remove", "--force", name], check=True)
        else:
            found = record(python, options.scene, parts)
    options.files[0].write_text(json.dumps(found, indent=0))
    print(f"{len(found)} values")
    return 0


if __name__ == "__main__":
    sys.exit(main())
