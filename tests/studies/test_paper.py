"""`crosscheck paper`: every figure and table of the papers, for any scene."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.cli.app import app
from crosscheck.document import EULER, Record
from crosscheck.studies import study
from crosscheck.studies.paper import bundle, runs
from crosscheck.verification.cell import judge_run
from lieeuler import METHODS

FIGURES = ("path", "path-methods", "energy", "levels", "rotation-pendulum", "orthogonality")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("paper") / "out"
    done = CliRunner().invoke(app, ["paper", "single_pendulum", "-o", str(out), "--step", "0.01", "--duration", "1",
                                    "--map", "exp", "--map", "ccsk"])
    assert done.exit_code == 0, done.output
    return out


def lines(folder):
    with (folder / "data" / "single_pendulum-table.csv").open(encoding="utf-8") as file:
        return {(line["method"], line["coordinate_map"]): line for line in csv.DictReader(file)
                if line["correction"] != "plain"}


def test_figures_are_vector_graphics_and_all_in_the_document(folder):
    document = (folder / "paper.tex").read_text("utf-8")
    for name in FIGURES:
        stem = f"single_pendulum-{name}"
        assert len(re.findall(rb"/Type /Page\b", (folder / "figures" / f"{stem}.pdf").read_bytes())) == 1
        drawn = ElementTree.parse(folder / "figures" / f"{stem}.svg").getroot()
        assert not list(drawn.iter("{http://www.w3.org/2000/svg}image"))
        assert f"{{figures/{stem}}}" in document
    assert r"\input{single_pendulum-table}" in document


def test_every_method_is_drawn_and_none_hides_another(folder):
    """Line widths decrease from method to method, so that coinciding curves show as bands."""
    text = (folder / "figures" / "single_pendulum-levels.svg").read_text("utf-8")
    assert all(f">{method}<" in text for method in EULER)
    widths = [float(width) for width in re.findall(r"stroke-width: ([\d.]+)", text)]
    assert len(set(widths)) >= len(EULER)


def test_document_is_well_formed(folder):
    for path in (folder / "paper.tex", folder / "single_pendulum-table.tex"):
        text = path.read_text("utf-8")
        bare = re.sub(r"\\[{}]", "", text)
        assert bare.count("{") == bare.count("}")
        begun, ended = (sorted(re.findall(rf"\\{word}\{{(\w+\*?)\}}", text)) for word in ("begin", "end"))
        assert begun == ended
        outside = re.sub(r"\$[^$]*\$|\\\w+(\[[^]]*\])?\{[^}]*\}", "", text)
        assert not re.search(r"(?<!\\)_", outside)
    cited = set(re.findall(r"\\cite\{(\w+)\}", (folder / "paper.tex").read_text("utf-8")))
    assert cited <= set(re.findall(r"@\w+\{(\w+),", (folder / "references.bib").read_text("utf-8")))


@pytest.mark.skipif(shutil.which("pdflatex") is None or shutil.which("bibtex") is None,
                    reason="pdflatex and bibtex are not installed: texlive-latex-recommended has them")
def test_document_compiles(folder, tmp_path):
    """A page for figures and tables, every citation found, nothing beyond the margins."""
    out = shutil.copytree(folder, tmp_path / "out")
    for words in (["pdflatex"], ["bibtex"], ["pdflatex"], ["pdflatex"]):
        more = ["-interaction=nonstopmode", "-halt-on-error"] if words == ["pdflatex"] else []
        done = subprocess.run([*words, *more, "paper"], cwd=out, capture_output=True, text=True, errors="replace")
        assert done.returncode == 0, done.stdout[-2000:]
    log = (out / "paper.log").read_text("utf-8", errors="replace")
    assert not re.findall(r"Overfull .*|.*undefined.*|LaTeX Warning: .*", log)
    listed = (out / "paper.aux").read_text("utf-8")
    assert [listed.count(f"\\contentsline {{{kind}}}") for kind in ("figure", "table")] == [len(FIGURES), 1]
    assert r"\bibitem" in (out / "paper.bbl").read_text("utf-8")


def test_table_has_every_method_with_every_map(folder):
    table = lines(folder)
    assert set(table) == {(method, name) for method in EULER for name in ("exp", "ccsk")}
    tex = (folder / "single_pendulum-table.tex").read_text("utf-8")
    plain = tex.count(r"\texttt{plain}")
    assert plain == tex.count(r"\texttt{mass}") == 2 * sum(METHODS[method].corrects for method in EULER) > 0
    assert tex.count(r"\\") == len(table) + plain + 1


def test_both_corrections_are_compared(folder):
    """One body on a ball: the weights differ, and both close the positions that index 2 leaves open."""
    with (folder / "data" / "single_pendulum-table.csv").open(encoding="utf-8") as file:
        pair = {line["correction"]: line for line in csv.DictReader(file)
                if line["method"] == "DAE2L_LSE" and line["coordinate_map"] == "exp"}
    assert pair["mass"]["error"] != pair["plain"]["error"]
    for line in pair.values():
        assert float(line["position"]) < 1e-12  # roundings of a metre, and what Newton leaves
        assert float(line["order"]) == pytest.approx(1, abs=0.1)


def test_the_methods_of_any_engine(tmp_path):
    done = CliRunner().invoke(app, ["paper", "single_pendulum", "--engine", "mujoco", "--step", "0.01", "--duration",
                                    "0.2", "--format", "svg", "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert {method for method, _ in lines(tmp_path / "out")} == set(crosscheck.methods("mujoco"))
    text = (tmp_path / "out" / "paper.tex").read_text("utf-8")
    assert "of the methods of mujoco" in text
    assert "reconstructed" not in text


def test_table_says_what_the_runs_say(folder):
    """The two energy errors by their definitions, from the states of the run."""
    scene = crosscheck.load_scene("single_pendulum")
    traj = crosscheck.run(scene, "lieeuler", "DAE2L_LE", step=0.01, duration=1.0, samples=101)
    gap = np.abs(traj.energy - traj.energy[0]).max()  # every step is a sample
    line = lines(folder)["DAE2L_LE", "exp"]
    # Both sum the same terms in another order: some roundings of energies of a few J, of a gap of 0.1 J.
    assert float(line["energy_by_start"]) == pytest.approx(gap / abs(traj.energy[0]), rel=1e-12)
    assert float(line["energy_by_kinetic"]) == pytest.approx(gap / traj.kinetic_energy.max(), rel=1e-12)
    asked = Record(scene="single_pendulum", engine="lieeuler", version="", method="DAE2L_LE", form=None, step=0.01,
                documented_order=1)
    judged = judge_run(asked, traj.scene, traj, frozenset({"velocity"}))
    assert judged.energy_error_by_start == pytest.approx(gap / abs(traj.energy[0]), rel=1e-12)
    assert float(line["position"]) == pytest.approx(traj.constraint_position.max(), rel=1e-12)
    assert float(line["order"]) == pytest.approx(1, abs=0.1)  # the project's band of first-order methods


def test_maps_differ(folder):
    one, other = (float(lines(folder)["DAE1L_LSE", name]["error"]) for name in ("exp", "ccsk"))
    assert abs(one - other) > 1e-6  # m: four digits above what rounding and Newton leave of 100 steps


def test_a_map_that_ends_the_run_is_said_in_the_table():
    scene = crosscheck.load_scene("heavy_top")  # 150 rad/s: ccsk leaves its domain above 0.01 s
    shown = runs.measure(scene, runs.Request(("DAE1L_LSE",), ("ccsk",), step=0.02, duration=0.2), lambda what: None)
    assert [line.ended for line in shown.lines] == ["map_domain at 0 s"]
    assert "map\\_domain at 0 s" in bundle._table(shown)


def test_data_are_those_of_the_runs(folder):
    with (folder / "data" / "single_pendulum-DAE1L_LSE.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        parts = float(row["kinetic energy [J]"]) + float(row["potential energy [J]"])
        assert parts == pytest.approx(float(row["total energy [J]"]), rel=1e-14)
    record = json.loads((folder / "paper.json").read_text("utf-8"))
    assert record["scenes"][0]["hash"] == crosscheck.load_scene("single_pendulum").hash


def test_the_end_is_opposite_the_joint():
    ends = runs.ends(crosscheck.load_scene("double_pendulum"))
    assert list(ends) == [1]
    assert ends[1] == pytest.approx([0, 0, -1])
    assert runs.ends(crosscheck.load_scene("four_bar")) == {}  # each rod is held at both ends


@pytest.mark.parametrize(("words", "said"), [
    (["--method", "DAE1L_LES"], "did you mean 'DAE1L_LSE'"), (["--map", "cayly"], "did you mean 'cayley'"),
    (["--format", "png"], "--format"), (["--show", "rattle"], "--show")])
def test_wrong_words_are_answered(tmp_path, words, said):
    done = CliRunner().invoke(app, ["paper", "single_pendulum", "-o", str(tmp_path / "out"), *words])
    assert said in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_other_folders_are_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine", "utf-8")
    with pytest.raises(crosscheck.ArgumentError, match="something else"):
        study.check(tmp_path, "paper")
    assert (tmp_path / "mine.txt").read_text("utf-8") == "mine"
