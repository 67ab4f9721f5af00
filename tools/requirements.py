"""Print the build, run-time and development requirements of pyproject.toml, one argument each for pip."""

import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())
requirements = [*project["build-system"]["requires"], "cmake", "ninja", *project["project"]["dependencies"],
                *project["project"]["optional-dependencies"]["dev"]]
print(" ".join(requirements))
