"""Print requirements, one argument each for pip: of the groups that are named, which are `build` and extras."""

import re
import sys
import tomllib
from pathlib import Path

file = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())
project = file["project"]
extras = project["optional-dependencies"]


def of(group: str) -> list[str]:
    """Requirements of a group; `all` are those of the package and of every extra that it names."""
    if group == "build":
        return [*file["build-system"]["requires"], "cmake", "ninja"]
    if group == "all":
        return [*project["dependencies"], *(each for extra in re.search(r"\[(.*)\]", extras["all"][0])[1].split(",")
                                            for each in extras[extra])]
    return extras[group]


print(" ".join(each for group in sys.argv[1:] for each in of(group)))
