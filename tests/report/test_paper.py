"""`crosscheck report --format paper`: the figures, tables and LaTeX of a report, of any engine."""

from __future__ import annotations

import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from crosscheck import report
from crosscheck.cli.app import app
from crosscheck.report.paper import table, write_paper

HOSTILE = r"a_b\input{/etc/passwd}%$x$"
STEM = "scene-single_pendulum"


@pytest.fixture(scope="module")
def paper(folder, tmp_path_factory):
    """The folder of the paper of a report, whose engine is none of ours."""
    copy = shutil.copytree(folder, tmp_path_factory.mktemp("paper") / "latest")
    done = CliRunner().invoke(app, ["report", str(copy), "--format", "paper"])
    assert done.exit_code == 0, done.exception
    assert "paper.tex" in done.output
    assert all(report.is_file_of_report(path) for path in copy.iterdir())
    return copy / "paper"


def test_figures_are_vector_graphics_and_all_in_the_document(paper):
    document = (paper / "paper.tex").read_text("utf-8")
    drawn = {path.stem for path in (paper / "figures").iterdir()}
    assert {f"{STEM}-{end}" for end in ("path", "energies", "rotation-pendulum", "orthogonality", "convergence",
                                        "constraint-position", "position-error")} <= drawn
    for stem in drawn:
        assert len(re.findall(rb"/Type /Page\b", (paper / "figures" / f"{stem}.pdf").read_bytes())) == 1
        picture = ElementTree.parse(paper / "figures" / f"{stem}.svg").getroot()
        assert not list(picture.iter("{http://www.w3.org/2000/svg}image"))
        assert f"{{figures/{stem}}}" in document
    assert rf"\input{{{STEM}-table}}" in document


def test_document_is_well_formed(paper):
    for path in paper.glob("*.tex"):
        text = path.read_text("utf-8")
        bare = re.sub(r"\\[{}]", "", text)
        assert bare.count("{") == bare.count("}")
        begun, ended = (sorted(re.findall(rf"\\{word}\{{(\w+\*?)\}}", text)) for word in ("begin", "end"))
        assert begun == ended
    cited = set(re.findall(r"\\cite\{(\w+)\}", (paper / "paper.tex").read_text("utf-8")))
    assert cited <= set(re.findall(r"@\w+\{(\w+),", (paper / "references.bib").read_text("utf-8")))


@pytest.mark.skipif(shutil.which("pdflatex") is None or shutil.which("bibtex") is None,
                    reason="pdflatex and bibtex are not installed: texlive-latex-recommended has them")
def test_document_compiles(paper, tmp_path):
    out = shutil.copytree(paper, tmp_path / "out")
    done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper"], cwd=out,
                          capture_output=True, text=True, errors="replace")
    assert done.returncode == 0, done.stdout[-2000:]


def test_table_says_what_the_records_say(results):
    """A line for each run, with the errors of its record; one that has none says why."""
    rows = {re.search(r"\\texttt\{(.*?)\}", line)[1]: line for line in table(results.records).splitlines()
            if line.startswith(r"\texttt")}
    assert len(rows) == len(results.records)
    record = next(each for each in results.records if each.method == "Plain")
    error, order = record.errors["position"].end, record.order.observed
    mantissa, exponent = f"{error:.1e}".split("e")
    assert rf"${mantissa}{{\cdot}}10^{{{int(exponent)}}}$ & {order:.2f} \\" in rows["fake Plain"]
    assert "it broke" in rows["fake Broken"]


def test_no_letter_of_a_name_is_a_command(results, tmp_path):
    scene = replace(results.scenes[0], title=HOSTILE, description=HOSTILE)
    runs = [replace(each, label=HOSTILE, message=HOSTILE) for each in results.records]
    document = replace(results, scenes=[scene], records=runs, meta=replace(results.meta, command=HOSTILE, engines={
        HOSTILE: HOSTILE}))
    write_paper(document, tmp_path / "paper")
    for path in (tmp_path / "paper").glob("*.tex"):
        text = path.read_text("utf-8").replace(rf"\input{{{STEM}-table}}", "")
        assert r"\input" not in text
        assert r"a\_b\textbackslash{}input\{/etc/passwd\}\%\$x\$" in text
