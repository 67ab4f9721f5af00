"""The recipes of CONTRIBUTING.md, followed word for word: in a copy of the packages, by commands that run there."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile

import pytest

from crosscheck.scene.joints import JOINT_TYPES
from lieeuler import _kernel
from tests import ROOT
from tests.test_without_extras import DRIVER

TEXT = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
RECIPES = dict(zip(*[iter(re.split(r"^(?:\*\*|## )(A method|A joint type|A scene|An engine|A study|Release)", TEXT,
                                   flags=re.MULTILINE)[1:])] * 2, strict=True))
COMMANDS = {"list": "INDEX2_LE",
            "run single_pendulum --engine lieeuler --method INDEX2_LE --step 1e-3 --duration 2": "pass: error",
            "truth compound_pendulum": "bob: x(2 s)",
            "run single_pendulum --engine scipy --method DOP853 --rtol 1e-9 --duration 0.5": "pass: error",
            "study slowest --engine lieeuler --out slowest": "page: slowest/index.html"}


def blocks(text):
    """Its code blocks."""
    return re.findall(r"^```(?:python|toml|text)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def inserted(path, before, text):
    """Put text into a file before the first line that starts so."""
    whole = path.read_text("utf-8")
    assert whole.count(f"\n{before}") == 1
    path.write_text(whole.replace(f"\n{before}", f"\n{text}{before}"), "utf-8")


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """Exit code, output and errors of each command in a copy of the packages after the recipes."""
    copy = tmp_path_factory.mktemp("copy")
    for name in ("crosscheck", "scenarios"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "lieeuler", copy / "lieeuler", ignore=shutil.ignore_patterns("__pycache__", "_core", "*.so"))
    shutil.copy(_kernel.__file__, copy / "lieeuler")
    inserted(copy / "lieeuler" / "methods.py", "class INDEX1_LE", blocks(RECIPES["A method"])[0])
    inserted(copy / "lieeuler" / "methods.py", "    GeneralizedAlpha, Rattle2", "    INDEX2_LE,\n")
    scene, *_ = blocks((ROOT / "docs" / "adding-a-scene.md").read_text("utf-8"))
    (copy / "scenarios" / "compound_pendulum.toml").write_text(scene, "utf-8")
    shutil.copy(ROOT / "examples" / "scipy_engine.py", copy / "crosscheck" / "adapters")
    inserted(copy / "crosscheck" / "adapters" / "built_in.py", '    "drake":', blocks(RECIPES["An engine"])[0])
    study, page, command = blocks(RECIPES["A study"])
    (copy / "crosscheck" / "studies" / "my_study.py").write_text(study, "utf-8")
    (copy / "crosscheck" / "report" / "templates" / "slowest.html.j2").write_text(page, "utf-8")
    inserted(copy / "crosscheck" / "cli" / "study.py", "def _print_page", f"{command}\n\n")
    libraries = [path for path in sys.path if "site-packages" in path]
    done = subprocess.run([sys.executable, "-P", "-S", "-c", DRIVER, json.dumps([line.split() for line in COMMANDS])],
                          cwd=copy, capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": os.pathsep.join([str(copy), *libraries])})
    assert done.returncode == 0, done.stderr
    return copy, dict(zip(COMMANDS, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("command", COMMANDS)
def test_what_a_recipe_adds_works(said, command):
    code, output, complaints = said[1][command]
    assert code == 0, complaints
    assert COMMANDS[command] in output


def test_the_page_of_the_study_shows_its_runs(said):
    folder = said[0] / "slowest"
    shown = re.findall(r"<th>(lieeuler [^<]+)</th>", (folder / "index.html").read_text("utf-8"))
    assert "lieeuler INDEX2_LE" in shown
    assert len(shown) == len((folder / "slowest.csv").read_text("utf-8").splitlines()) - 1


def test_the_recipe_of_a_joint_names_every_file():
    named = set(re.findall(r"`([\w/]+\.\w+)`", RECIPES["A joint type"]))
    listed = {"tests/scene_making.py", "tests/random_mechanisms.py"}
    files = [path for folder in ("lieeuler", "crosscheck", "docs") for path in (ROOT / folder).rglob("*")
             if path.suffix in (".py", ".pyi", ".hpp", ".cpp", ".js", ".j2") or path.name == "api.md"]
    assert {"point_on_line", "point_on_plane"} <= set(JOINT_TYPES)
    holding = {str(path.relative_to(ROOT)) for path in files
               if re.search("point_on_(line|plane)", path.read_text("utf-8"))}
    assert named == holding | listed
    assert all("point_on_plane" in (ROOT / name).read_text("utf-8") for name in listed)


def test_the_steps_of_a_release(tmp_path, monkeypatch):
    """The heading of the changelog has the version; an sdist of this checkout has all files that a build needs."""
    version = importlib.metadata.version("lieeuler-crosscheck")
    assert re.findall(r"^## \[([^]]+)\] - (?:unreleased|20\d\d-\d\d-\d\d)$", (ROOT / "CHANGELOG.md").read_text("utf-8"),
                      re.MULTILINE)[0] == version
    for named in re.findall(r"`(\.ci/run|[\w.]+\.(?:yml|toml|cff))`", RECIPES["Release"]):
        assert (ROOT / named).exists() or (ROOT / ".github" / "workflows" / named).exists(), named
    build = pytest.importorskip("scikit_build_core.build")
    monkeypatch.chdir(ROOT)
    made = tmp_path / build.build_sdist(str(tmp_path))
    assert made.name == f"lieeuler_crosscheck-{version}.tar.gz"
    with tarfile.open(made) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert {"LICENSE", "README.md", "CMakeLists.txt", "constraints.txt", "scenarios/heavy_top.toml",
            "lieeuler/py.typed", "lieeuler/_core/python/bind.cpp", "crosscheck/report/templates/index.html.j2"} <= held
    assert not [name for name in held if name.startswith(("reports/latest", ".venv", "build/"))]
