"""Import every robot model under some folders, let every engine read those that come in, and count what became of them.

    python tools/survey.py FOLDER ... [--native]

A line a file, then a table. "whole" is as it is, with monitors and actuators; "free" is with a free base, "balance"
with inertias replaced, "root" a part of it, "within" with files of the whole folder, as messages offer it; "bare" is
with `drop=True`. Of each the accelerations at three seeded states are within 1e-8 of those of MuJoCo, or differ, by
what is named. Parts that only stand in other files, and XML of other kinds, are not counted. SDF and USD are read by
the engines that take them; with `--native` all that are installed read each file that came in by themselves, too.
"""

from __future__ import annotations

import re
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from crosscheck.errors import CrosscheckError
from crosscheck.inspection.native import inspect
from crosscheck.scene.models import import_model
from crosscheck.scene.models.checking import unlike

ROOTS = {"mujoco": (".xml", ".mjcf"), "robot": (".urdf", ".xml"), "sdf": (".sdf", ".world")}
OTHER_FORMATS = (".sdf", ".world", ".usd", ".usda", ".usdc")
IMPORTED = ("whole", "free", "balance", "root", "within", "bare")
UNLIKE = {"that it is ill-conditioned": "differ, ill-conditioned", "a comparison of": "not compared: too many bodies"}
"""What a note on accelerations begins with."""


def models(folder: Path) -> Iterator[Path]:
    """The model files below a folder, by their first element."""
    for path in sorted(folder.rglob("*")):
        suffix = path.suffix.lower()
        if suffix.startswith(".usd") and path.is_file():
            yield path
        elif suffix in {ending for endings in ROOTS.values() for ending in endings} and path.is_file():
            head = re.sub(r"<!--.*?-->", "", path.read_bytes()[:200_000].decode(errors="replace"), flags=re.DOTALL)
            first = re.search(r"<([A-Za-z:_]+)", head)
            if first and suffix in ROOTS.get(first[1], ()):
                yield path


def kind(words: str) -> str:
    """A reason without names, numbers and places, so that like ones count as one."""
    words = re.sub(r" \((line \d+[^)]*)\)|, likewise .*| and \d+ more|(, )?'[^']*'", "", words)
    return " ".join(re.sub(r"[-+.\d]+(e[-+]\d+)?", "#", words).split())[:110]


def said(error: Exception, path: Path) -> list[str]:
    """The reasons in an error."""
    words = str(error).removeprefix(f"{path}: ")
    held = re.match(r"a scene cannot hold (.*); give --drop", words)
    return (held[1] if held else words.partition("; give")[0]).split("; ")


def outcome(path: Path, folder: Path) -> tuple[str, list[str]]:
    """("whole", "free", "balance", "root", "bare", "still", "refused" or "other format", reasons or what is told)."""
    if path.suffix.lower() in OTHER_FORMATS:
        try:
            read = inspect(path)
        except CrosscheckError as error:
            return f"{path.suffix.lower()} not read", said(error, path)
        return f"{path.suffix.lower()} read by {' and '.join(native.engine for native in read.native)}", [
            *map(str, read.differences), *(f"{name}: {words}" for name, words in read.refused.items())]
    options: dict[str, Any] = {}
    first: list[str] = []
    while True:  # with what the message offers, and without all that a scene cannot hold at last
        try:
            left_out = import_model(path, **options).left_out
        except CrosscheckError as error:
            words, offered = said(error, path), re.search("give --root (.*) for a part", str(error))
            first = first or words
            if "nothing in it moves" in words[0] and "base" not in options:
                options["base"] = "free"
            elif "--balance" in str(error) and "balance" not in options:
                options["balance"] = True
            elif "--within" in str(error) and "within" not in options:
                options["within"] = folder
            elif offered and "root" not in options:
                options["root"] = offered[1]
            elif "drop" not in options:
                first, options["drop"] = words, True
            else:
                return "still" if "base" in options else "refused", first  # without mass to be freed
        else:
            name = "bare" if "drop" in options else "free" if "base" in options else next(iter(options), "whole")
            return name, first if name == "bare" else list(map(str, left_out))


def accelerations(what: str, left_out: list[str]) -> str:
    """How those of an imported file are to those of MuJoCo at three seeded states."""
    for begin, words in UNLIKE.items():
        if any(each.startswith(begin) for each in left_out):
            return words
    return "differ by what is left out" if what == "bare" and any(map(unlike, left_out)) else "within 1e-8"


def main() -> None:
    """Print a line a file and the counts."""
    native, folders = "--native" in sys.argv, [Path(each) for each in sys.argv[1:] if not each.startswith("--")]
    tables: dict[str, Counter[str]] = {}
    reasons: dict[str, Counter[str]] = {}
    compared: Counter[str] = Counter()
    for folder in folders:
        tables[folder.name] = table = Counter()
        for path in models(folder):
            began = time.process_time()
            what, words = outcome(path, folder)
            table[what] += 1
            if what in IMPORTED:
                compared[accelerations(what, words)] += 1
            if native and what in IMPORTED:
                try:
                    result = inspect(path)
                    table["every engine reads the same" if result.agree else "engines differ, named"] += 1
                except CrosscheckError as error:
                    words.append(f"inspect: {error}")
            reasons.setdefault(what, Counter()).update({kind(each) for each in words})
            print(f"{what}\t{path}\t{time.process_time() - began:.1f}\t{'; '.join(words)[:1500]}", flush=True)
    for name, table in tables.items():
        print(f"{name}: {table.total()} results: {', '.join(f'{each} {n}' for each, n in table.most_common())}")
    print("all:", ", ".join(f"{each} {n}" for each, n in sum(tables.values(), Counter()).most_common()))
    print("accelerations:", ", ".join(f"{each} {n}" for each, n in compared.most_common()))
    for what, counted in reasons.items():
        for words, n in counted.most_common(25):
            print(f"{what}: {n} x {words}")


if __name__ == "__main__":
    main()
