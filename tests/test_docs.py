"""Every path, module and name that a document mentions exists."""

from __future__ import annotations

import dataclasses
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.built_in import ENTRIES
from crosscheck.adapters.common import known
from crosscheck.document.outcomes import KINDS
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.laws import SIZES
from crosscheck.scene.model import Body, Force, Joint
from crosscheck.scene.schema import FORCE_ENTRIES
from crosscheck.scene.sensors import SENSOR_TYPES
from tests import ROOT

DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
PACKAGES = ("lieeuler", "crosscheck")
FOLDERS = (ROOT, ROOT / "docs", ROOT / "lieeuler" / "_core", ROOT / "crosscheck", ROOT / "lieeuler")
"""Folders in which a path in a document may start."""
WRITTEN = ("reports/", "results/", "build/", ".venv/", ".github/", "my_")
"""Paths that a run, a build or the reader makes."""
CODE = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
ANCHOR = re.compile(r"\]\(([^)#:\s]*)#([^)\s]+)\)")
PATH = re.compile(r"[\w.-]+(?:/[\w.*{},-]+)+/?|\w+\.(?:py|hpp|cpp)")
MODULE = re.compile(r"(?:lieeuler|crosscheck)(?:\.\w+)+")
NAME = re.compile(r"_?[A-Z]\w*[a-z]\w*[A-Z]\w*|[A-Z][a-z]\w*(?:::\w+)+|\w+(?:::\w+)*\([^)]*\)")
"""CamelCase, C++ names, and calls: what a reader would look for in the sources."""


def spans(document: Path, pattern: re.Pattern[str]) -> set[str]:
    """Code spans of the prose, and the words of shell blocks, that match the pattern as a whole."""
    text = document.read_text("utf-8")
    fences = re.findall(r"^```(\S*)[^\n]*\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    blocks = [content for language, content in fences if language in ("", "sh", "bash")]
    prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    words = {word for block in blocks for word in block.split()} if pattern is PATH else set()
    return {span for span in words | set(CODE.findall(prose)) if pattern.fullmatch(span)}


@functools.cache
def sources() -> str:
    """All code of the checkout that a document may mention."""
    files = [file for folder in (*PACKAGES, "tests", "benchmarks", "examples", "tools", "scenarios")
             for kind in ("py", "pyi", "hpp", "cpp", "toml", "js") for file in (ROOT / folder).rglob(f"*.{kind}")
             if file.name != "test_docs.py"]
    return "\n".join(file.read_text("utf-8") for file in files)


def missing_paths(document: Path) -> set[str]:
    """Paths in code spans, shell blocks and links that lead nowhere."""
    text = document.read_text("utf-8")
    links = {link for link in LINK.findall(text) if not (document.parent / link).exists()}
    paths = {path for path in spans(document, PATH) if not path.startswith(WRITTEN)
             and (path.split("/")[0] in {entry.name for folder in FOLDERS for entry in folder.iterdir()}
                  or path.endswith((".py", ".hpp", ".cpp")))}
    return links | {path for path in paths if not any(list(folder.glob(path.rstrip("/"))) for folder in FOLDERS)}


def missing_anchors(document: Path) -> set[str]:
    """Headings to which links lead and that are not there."""
    def slugs(path: Path) -> set[str]:
        headings = re.findall(r"^#+ (.*)$", path.read_text("utf-8"), re.MULTILINE)
        return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}

    return {anchor for name, anchor in ANCHOR.findall(document.read_text("utf-8"))
            if (path := document.parent / name if name else document).suffix == ".md" and path.exists()
            and anchor not in slugs(path)}


def missing_modules(document: Path) -> set[str]:
    """Dotted names of our packages of which no part beyond the package is a module or stands in the sources."""
    missing = set()
    for dotted in spans(document, MODULE):
        package, *rest = dotted.split(".")
        here = ROOT / package
        while rest and ((here / rest[0]).is_dir() or (here / f"{rest[0]}.py").is_file()):
            here /= rest.pop(0)
        if any(not re.search(rf"\b{name}\b", sources()) for name in rest):
            missing.add(dotted)
    return missing


def missing_names(document: Path) -> set[str]:
    """Classes and functions of which the last part stands nowhere in the sources."""
    return {name for name in spans(document, NAME)
            if not re.search(rf"\b{re.escape(re.split('::', name.partition('(')[0])[-1])}\b", sources())}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_what_a_document_names_exists(document):
    assert not (missing_paths(document) | missing_anchors(document) | missing_modules(document)
                | missing_names(document))


def test_what_is_missing_is_found(tmp_path):
    """A seeded document: missing things are named, existing ones are not."""
    (tmp_path / "there.md").write_text("# What `it` is\n", "utf-8")
    document = tmp_path / "wrong.md"
    document.write_text("`tests/nowhere.py` `tests/mutants.py` `nowhere.hpp` `model/joints.hpp` [a](gone.md)\n"
                        "`lieeuler.not_there` `lieeuler.integrate` `crosscheck.judge.not_there` [b](there.md)\n"
                        "[c](there.md#what-it-is) [d](there.md#what-it-was) [e](#nowhere)\n"
                        "`GoneStepper` `NewtonStepper` `gone_hook(z)` `residual(z, r)` `reports/latest/index.html`\n"
                        "```sh\n.venv/bin/python -m pytest tests/lieeuler/test_gone.py\n```\n", "utf-8")
    assert missing_paths(document) == {"tests/nowhere.py", "nowhere.hpp", "gone.md", "tests/lieeuler/test_gone.py"}
    assert missing_anchors(document) == {"what-it-was", "nowhere"}
    assert missing_modules(document) == {"lieeuler.not_there", "crosscheck.judge.not_there"}
    assert missing_names(document) == {"GoneStepper", "gone_hook(z)"}


sys.path.insert(0, str(ROOT / "docs"))
import reference  # noqa: E402


@pytest.mark.parametrize(("made", "names"), [
    (reference.scene_files, {*JOINT_TYPES, *FORCE_ENTRIES, *SENSOR_TYPES, *SIZES, "rolling_disk"}),
    (reference.engines, {*ENTRIES, *(entry.reason for entry in known.table())}),
    (reference.methods, lieeuler.METHODS.keys()), (reference.verdicts, {kind.code for kind in KINDS.values()}),
    (reference.declarations, {"held_levels", "eps", *FORCE_ENTRIES, "no_load_speed"}.union(
        *([field.name for field in dataclasses.fields(kind)] for kind in (RunSpec, Body, Joint, Force))))])
def test_the_reference_has_all_that_the_code_has(made, names):
    text = made()
    assert {name for name in names if name not in text} == set()


@pytest.mark.parametrize("package", [crosscheck, lieeuler])
def test_every_public_name_is_in_the_reference(package):
    text = (ROOT / "docs" / "api.md").read_text("utf-8")
    listed = set(re.findall(rf":: {package.__name__}\.(\w+)$", text, re.MULTILINE))
    assert listed == set(package.__all__)


def cited_equations(text: str) -> set[str]:
    """The numbers of equations before "of docs/theory.md": (1.1), (1.2) or (1.4); (1.1) to (1.4)."""
    text = re.sub(r"\s*\n\s*(?://|#)? ?", " ", text)
    found = set[str]()
    for run in re.findall(r"((?:\(\d+\.\d+\)[^.;()]{0,60}?)+) ?of docs/theory\.md", text):
        numbers = re.findall(r"\((\d+)\.(\d+)\)( to (?=\())?", run)
        for (section, first, upto), (_, last, _) in zip(numbers, [*numbers[1:], ("", "0", "")], strict=True):
            found |= {f"{section}.{k}" for k in range(int(first), int(last) + 1 if upto else int(first) + 1)}
    return found


def test_equations_are_numbered_once_and_cited():
    theory = (ROOT / "docs" / "theory.md").read_text("utf-8")
    tags = re.findall(r"\\tag\{([\d.]+)\}|\| \((\d+\.\d+)\) \|$", theory, re.MULTILINE)
    numbers = [tag or row for tag, row in tags]
    assert len(numbers) == len(set(numbers)) == theory.count("```math") + theory.count("$$") // 2 + 4
    within = set(re.findall(r"\((\d+\.\d+)\)", theory))
    assert set(numbers) == cited_equations(sources())
    assert within <= set(numbers)
    assert not re.search(r"docs/theory\.md, section", sources())


def test_citations_are_read():
    assert cited_equations("(1.1) to (1.3), and (2.1) of docs/theory.md") == {"1.1", "1.2", "1.3", "2.1"}
    assert cited_equations("// (4.1), (4.2)\n// and (4.4) of docs/theory.md. (9.9) is none") == {"4.1", "4.2", "4.4"}


def test_the_bibliography_is_whole():
    """Every key once, every cited key and every DOI of the repository there, every key cited or its DOI named."""
    text = (ROOT / "docs" / "references.bib").read_text("utf-8")
    entries = {entry[1]: entry[0] for entry in re.finditer(r"^@\w+\{(\w+),.*?^\}", text, re.DOTALL | re.MULTILINE)}
    assert len(entries) == text.count("\n@")
    dois = {key: match[1] for key, entry in entries.items() if (match := re.search(r"doi\s*= \{([^}]+)\}", entry))}
    written = sources() + "".join(document.read_text("utf-8") for document in DOCUMENTS)
    cited = set(re.findall(r"\[([a-z_]+_\d{4})(?:, [^\]]+)?\]", written))
    assert cited <= set(entries)
    named = set(re.findall(r"10\.\d{4,5}/[\w.()/:-]+\w", written))
    assert {doi for doi in named if doi not in dois.values()} == set()
    assert {key for key in entries if key not in cited and dois.get(key) not in named} == set()


def test_the_site_is_built_without_warnings_and_asks_no_network(tmp_path):
    pytest.importorskip("sphinx")
    done = subprocess.run([sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", ROOT / "docs", tmp_path],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for page in tmp_path.rglob("*.html"):
        text = page.read_text("utf-8")
        assert not re.findall(r"<(?:script|link)[^>]+(?:src|href)=\"(?:https?:)?//[^\"]+", text), page.name
    for tutorial in (ROOT / "docs" / "tutorials").glob("*.md"):
        ran = (tmp_path / "tutorials" / f"{tutorial.stem}.html").read_text("utf-8")
        assert ran.count('class="cell docutils') == tutorial.read_text("utf-8").count("```{code-cell}")
        assert "Traceback" not in ran
    theory = (tmp_path / "theory.html").read_text("utf-8")
    assert theory.count("<math") > 300
    assert "(4.1)" in theory
