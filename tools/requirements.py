"""Print the requirements of build, of every extra in `all`, of `docs` and of development, one argument each for pip."""

import re
import tomllib
from pathlib import Path

file = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())
project = file["project"]
extras = project["optional-dependencies"]
chosen = re.search(r"\[(.*)\]", extras["all"][0])[1].split(",")
requirements = [*file["build-system"]["requires"], "cmake", "ninja", *project["dependencies"],
                *(each for extra in chosen for each in extras[extra]), *extras["docs"], *extras["dev"]]
print(" ".join(requirements))
