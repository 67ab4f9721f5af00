"""What is installed: extras that hold together, files that go with the packages, every command without its extra."""

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
CORE = {"numpy", "scipy", "msgspec", "mpmath", "psutil", "typer", "rich"}


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


def test_the_setup_installs_what_tests_need():
    printed = subprocess.run([sys.executable, ROOT / "tools" / "requirements.py"], capture_output=True, text=True,
                             check=True).stdout
    for package in ("heyoka", "mujoco", "pandas", "plotly", "sqlalchemy", "distributed", "pytest", "scikit-build-core"):
        assert package in printed
    pinned = (ROOT / "constraints.txt").read_text().lower().replace("_", "-")
    for package in names(PROJECT["dependencies"]) | names(PROJECT["optional-dependencies"]["cluster"]):
        assert f"\n{package}==" in pinned


def test_addresses_are_the_same_everywhere():
    home = PROJECT["urls"]["Homepage"]
    assert all(address.startswith(home) for address in PROJECT["urls"].values())
    citation = (ROOT / "CITATION.cff").read_text()
    assert f'url: "{home}"' in citation
    assert f"version: {PROJECT['version']}\n" in citation
    assert "license: BSD-3-Clause" in citation
    assert "BSD-3-Clause" in PROJECT["license"]
    assert "The lieeuler-crosscheck authors" in (ROOT / "LICENSE").read_text()


def test_versions():
    assert crosscheck.__version__ == lieeuler.__version__ == importlib.metadata.version("lieeuler-crosscheck")


def test_both_packages_are_typed():
    for package in ("lieeuler", "crosscheck"):
        assert (ROOT / package / "py.typed").is_file()


BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {modules}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Blocked())
from crosscheck.cli.app import main
sys.argv = ["crosscheck", *{arguments!r}]
main()
"""


def without(modules, arguments, folder):
    code = BLOCKED.format(modules=set(modules), arguments=[str(argument) for argument in arguments])
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder, check=False)


@pytest.mark.parametrize(("modules", "arguments", "extra"), [
    (["mujoco"], ["run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "0.01"], "mujoco"),
    (["pinocchio"], ["run", "single_pendulum", "--engine", "pinocchio", "--method", "RKMK4", "--step", "0.01"],
     "pinocchio"),
    (["exudyn"], ["run", "single_pendulum", "--engine", "exudyn", "--method", "RK44", "--step", "0.01"], "exudyn"),
    (["sqlalchemy"], ["history", "list"], "history"),
    (["pandas"], ["sweep", "sweep.toml", "-o", "out"], "data"),
    (["distributed"], ["sweep", "sweep.toml", "-o", "out", "--scheduler", "tcp://127.0.0.1:9"], "cluster"),
])
def test_a_command_without_its_extra_names_it_in_one_line(modules, arguments, extra, tmp_path):
    (tmp_path / "sweep.toml").write_text(
        'scenes = ["single_pendulum"]\nsteps = [0.01]\nduration = 0.1\nsamples = 2\n'
        '[engines]\nlieeuler = ["rattle2"]\n')
    ended = without(modules, arguments, tmp_path)
    assert ended.returncode == 2
    assert f"lieeuler-crosscheck[{extra}]" in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1


def test_without_heyoka_two_other_formulations_give_the_truth(tmp_path, monkeypatch):
    monkeypatch.setenv("CROSSCHECK_CACHE", str(tmp_path / "cache"))
    text = (ROOT / "scenarios" / "single_pendulum.toml").read_text()
    (tmp_path / "short.toml").write_text(text.replace("duration    = 10.0", "duration    = 0.5"))
    ended = without(["heyoka"], ["truth", "short.toml"], tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "natural coordinates" in ended.stdout
    assert "DOP853" in ended.stdout


def test_verify_without_the_report_writes_results_and_says_so(tmp_path):
    ended = without(["jinja2", "plotly", "matplotlib", "pypdf", "pyarrow", "pandas", "sqlalchemy"], [
        "verify", "--profile", "smoke", "--scene", "single_pendulum", "--engine", "lieeuler", "--jobs", "1", "--out",
        "out"], tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "out" / "results.json").is_file()
    assert not (tmp_path / "out" / "index.html").exists()
    assert "lieeuler-crosscheck[report]" in ended.stderr
