"""Names, kinds of findings, outcomes and headings use the terms of docs/glossary.md, and no private words."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

import crosscheck
import lieeuler
from crosscheck.document.outcomes import KINDS, Outcome
from tests import ROOT

PRIVATE = {"told", "tell", "seen", "again", "beside", "walk", "walks", "walked", "course", "courses", "shown", "settle",
           "settled", "foreign", "claim", "claims", "claimed", "chain", "chains"}
"""Words that say nothing to a reader who knows solvers, multibody dynamics and verification."""

GLOSSARY = (ROOT / "docs" / "glossary.md").read_text("utf-8")
ROWS = re.findall(r"^\| (.*?) \|$", GLOSSARY.partition("| symbol")[0], re.MULTILINE)
TERMS = [cells.split(" | ") for cells in ROWS[1:]]


def words(name: str) -> set[str]:
    """The words of a name in snake or camel case."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def names(text: str) -> Iterator[str]:
    """Names of functions, classes, their parameters and their annotated fields."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
            yield from (each.target.id for each in node.body if isinstance(node, ast.ClassDef)
                        and isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name))
        elif isinstance(node, ast.arg):
            yield node.arg


def private(file: Path) -> set[str]:
    """The names of a module that have a private word, its own among them."""
    return {name for name in (file.stem, *names(file.read_text("utf-8"))) if words(name) & PRIVATE}


@pytest.mark.parametrize("room", sorted({
    file.parent for package in ("lieeuler", "crosscheck") for file in (ROOT / package).rglob("*.py")}),
    ids=lambda room: str(room.relative_to(ROOT)))
def test_names_have_no_private_words(room):
    assert {file.name: found for file in room.glob("*.py") if (found := private(file))} == {}
    assert not words(room.name) & PRIVATE


def test_a_private_word_is_found(tmp_path):
    file = tmp_path / "walks.py"
    file.write_text("class WasSeen:\n    again: int\n    def f(self, told, other): ...\n", "utf-8")
    assert private(file) == {"walks", "WasSeen", "again", "told"}
    assert words("from_records") == {"from", "records"}


def test_the_glossary_has_few_terms_and_those_of_the_verdict():
    terms = {term for term, *_ in TERMS}
    assert len(TERMS) == len(terms) <= 60
    assert all(len(cells) >= 2 and len(cells[1]) > 10 for cells in TERMS)
    explained = terms | set(re.findall(r"\w+", " ".join(cells[1] for cells in TERMS if cells[0] == "verdict")))
    explained |= {word for term in terms for word in re.findall(r"\w+", term)}
    assert {*KINDS, *get_args(Outcome)} - {"unresolved"} <= explained
    assert "unresolved" in GLOSSARY


@pytest.mark.parametrize("package", [crosscheck, lieeuler])
def test_public_names_have_no_private_words(package):
    assert [name for name in package.__all__ if words(name) & PRIVATE] == []


def test_headings_and_findings_have_no_private_words():
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    headings = {heading for page in pages for heading in re.findall(r"^##* (.*)$", page.read_text("utf-8"), re.M)}
    assert {heading for heading in headings if words(heading) & PRIVATE} == set()
    assert not words(" ".join(KINDS)) & PRIVATE


def test_all_documents_together_are_short():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    assert sum(len(page.read_text("utf-8").split()) for page in pages) <= 25_000
