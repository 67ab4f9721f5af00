"""The installation: consistent extras, and the files that belong to the packages."""

from __future__ import annotations

import importlib.metadata
import re
import subprocess
import sys
import tomllib

import pytest

import crosscheck
import lieeuler
from crosscheck import errors
from tests import ROOT

FILE = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = FILE["project"]
CORE = {"numpy", "scipy", "msgspec", "psutil", "typer", "rich", "sqlalchemy"}


def names(requirements):
    return {re.match(r"[A-Za-z0-9_-]+", requirement)[0].lower() for requirement in requirements}


def test_the_core_is_small():
    assert names(PROJECT["dependencies"]) == CORE


def test_every_extra_named_in_a_message_exists_and_no_package_is_in_two():
    extras = {name: names(content) for name, content in PROJECT["optional-dependencies"].items() if name != "all"}
    assert set(errors.EXTRAS.values()) <= set(extras)
    runtime = {name: content for name, content in extras.items() if name != "dev"}
    everything = [package for content in runtime.values() for package in content]
    assert len(everything) == len(set(everything))
    assert not CORE & set(everything)
    (everything_together,) = PROJECT["optional-dependencies"]["all"]
    assert set(everything_together.partition("[")[2].rstrip("]").split(",")) <= set(extras)


@pytest.mark.parametrize(("group", "some"), [
    ("build", ["scikit-build-core", "cmake"]), ("docs", ["sphinx"]), ("dev", ["pytest", "mypy"]),
    ("all", ["numpy", "heyoka", "mujoco", "pandas", "plotly", "sqlalchemy", "distributed"])])
def test_the_setup_installs_what_is_needed(group, some):
    printed = subprocess.run([sys.executable, ROOT / "tools" / "requirements.py", group], capture_output=True,
                             text=True, check=True).stdout
    assert names(some) <= names(printed.split())


def test_the_core_is_pinned():
    pinned = (ROOT / "constraints.txt").read_text().lower().replace("_", "-")
    for package in CORE | names(PROJECT["optional-dependencies"]["cluster"]):
        assert f"\n{package}==" in pinned


def test_version_and_licence_are_the_same_everywhere():
    citation = (ROOT / "CITATION.cff").read_text()
    assert "example.org" not in citation + (ROOT / "pyproject.toml").read_text()  # no address before there is a site
    assert f"version: {PROJECT['version']}\n" in citation
    assert "license: BSD-3-Clause" in citation
    assert "BSD-3-Clause" in PROJECT["license"]
    assert "The lieeuler-crosscheck authors" in (ROOT / "LICENSE").read_text()


def test_versions():
    assert crosscheck.__version__ == lieeuler.__version__ == importlib.metadata.version("lieeuler-crosscheck")


def test_both_packages_are_typed():
    for package in ("lieeuler", "crosscheck"):
        assert (ROOT / package / "py.typed").is_file()
