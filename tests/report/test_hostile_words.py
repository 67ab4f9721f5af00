"""Texts of engines and scenes reach every file of a report as plain text, and no file is lost.

An engine that says such words is among those of tests/jobs/test_isolation.py.
"""

import csv
import json
import xml.etree.ElementTree as ElementTree

import pytest
from msgspec.structs import replace

from crosscheck import report as folder_of_report
from crosscheck.files import readable
from crosscheck.report import load_report
from crosscheck.verification import job
from tests.report_making import small_results

WORDS = "half \ud800 of a character, \ufffe, \x00\x1b[31m <img src=x onerror=alert(1)> `code` | column"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    whole = small_results()
    first, *others = whole.records
    formulas = [replace(record, message=f"{'=+-@'[k % 4]}cmd|' /C calc'!A0") for k, record in enumerate(others)]
    spoilt = [replace(first, outcome="error", message=WORDS), *formulas]
    document = job.document(whole.meta, whole.scenes, spoilt)
    return folder_of_report.write(document, tmp_path_factory.mktemp("report") / "out").parent


def test_the_report_is_whole(folder):
    assert json.loads((folder / "results.json").read_text(encoding="utf-8"))["records"][0]["message"] == readable(WORDS)
    assert load_report(folder).records[0].message == readable(WORDS)
    assert ElementTree.parse(folder / "junit.xml").getroot().tag == "testsuites"
    for path in folder.iterdir():
        if path.suffix in (".html", ".md", ".csv", ".xml", ".json"):
            assert not {"\x00", "\x1b", "\ufffe"} & set(path.read_text(encoding="utf-8"))


def test_no_cell_is_a_formula(folder):
    with open(folder / "results.csv", encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    for row in rows:
        for title, cell in zip(header, row, strict=True):
            try:
                float(cell)  # a negative number is one
            except ValueError:
                assert not cell.startswith(("=", "+", "-", "@", "\t", "\r")), title


def test_the_markdown_holds_no_html_and_no_code_of_others(folder):
    text = (folder / "summary.md").read_text(encoding="utf-8")
    assert r"\<img" in text
    assert "<img" not in text.replace(r"\<", "")
    assert r"\`code\` \| column" in text
