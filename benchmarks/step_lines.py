"""Headers and lines of the kernel that one step of a method executes, counted by gcov.

    python -m benchmarks.step_lines DAE1L_LSE [--system 2] [--show methods solve]

A run of eleven steps less one of ten. `--show` prints the executed lines of the headers in these folders: the step as
it stands in the code.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import lieeuler
from benchmarks import driver

STEPS, ACCURACY = 10, 1e-3


def counts(program: Path, method: str, system: str, steps: int) -> dict[tuple[str, int], int]:
    """How often a run executes each line, by header and number."""
    folder = program.parent
    for data in folder.glob("*.gcda"):
        data.unlink()
    command = [program, *driver.arguments(folder, method, system, steps, ACCURACY)]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    output = subprocess.run(["gcov", "--json-format", "--stdout", *folder.glob("*.gcda")], cwd=folder, text=True,
                            capture_output=True, check=True).stdout
    found: dict[tuple[str, int], int] = defaultdict(int)
    for file in (file for text in output.splitlines() for file in json.loads(text)["files"]):
        path = Path(file["file"])
        if path.is_relative_to(driver.HEADERS):
            for line in file["lines"]:
                found[str(path.relative_to(driver.HEADERS)), line["line_number"]] += line["count"]
    return found


def step_lines(program: Path, method: str, system: str) -> dict[str, list[int]]:
    """The lines of every header that a step executes."""
    short, long = (counts(program, method, system, steps) for steps in (STEPS, STEPS + 1))
    lines: dict[str, list[int]] = defaultdict(list)
    for (header, number), count in sorted(long.items()):
        if count > short[header, number]:
            lines[header].append(number)
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.step_lines", description=__doc__.splitlines()[0])
    parser.add_argument("method", choices=lieeuler.METHODS)
    parser.add_argument("--system", default="2", help="bodies of a chain, or a scene; default: a double pendulum")
    parser.add_argument("--show", nargs="*", default=(), metavar="FOLDER", help="whose headers' lines are printed")
    options = parser.parse_args(arguments)
    if why := driver.missing_tool("gcov", "c++"):
        parser.error(why)
    with tempfile.TemporaryDirectory() as folder:
        program = driver.build(Path(folder), "-O0", "--coverage")
        lines = step_lines(program, options.method, options.system)
    for header, numbers in lines.items():
        print(f"{header:32}{len(numbers):5} lines")
        if header.split("/")[0] in options.show:
            source = (driver.HEADERS / header).read_text().splitlines()
            print("\n".join(f"{number:5} {source[number - 1]}" for number in numbers))
    print(f"a step of {options.method} on {options.system}: {len(lines)} headers, "
          f"{sum(map(len, lines.values()))} lines")


if __name__ == "__main__":
    main()
