"""A report as the material of a paper: its figures as PDF and SVG, tables, a LaTeX document with both, BibTeX.

Names and texts of scenes, engines and methods are text in it: no letter of them is a command of LaTeX.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from crosscheck.document import Document, Record, Scene
from crosscheck.files import put, tex
from crosscheck.report import pages
from crosscheck.report.figures import drawn, style

FORMATS = ("pdf", "svg")

COLUMNS: dict[str, Callable[[Record], float | None]] = {
    r"$\frac{|E - E_0|}{|E_0|}$": lambda run: run.energy_error_by_start,
    r"$\frac{|E - E_0|}{\max T}$": lambda run: run.energy_error,
    r"$|\Phi|$ (m)": lambda run: _level(run, "position"), r"$|G u|$ (m/s)": lambda run: _level(run, "velocity"),
    r"$|G a + \gamma|$ (m/s$^2$)": lambda run: _level(run, "acceleration"),
    r"$|R^T R - I|$": lambda run: run.orthogonality,
    r"$|x - x_{\mathrm{ref}}|$ (m)": lambda run: run.errors["position"].end if "position" in run.errors else None}
"""Columns of tables 1 and 2 of doi:10.1177/1687814019842406, and the error of the mass centres at the end."""

CAPTIONS = {
    "path": "Paths of the mass centres and of the end, the point opposite the joint; a dot marks the start.",
    "energies": "Kinetic, potential and total energy; the potential is zero at the origin.",
    "rotation": "The nine elements of a rotation matrix, from body to world axes.",
    "position-error": "Errors of position against truth.", "energy-error": "Errors of the total energy.",
    "constraint-position": "The constraints at the level of position.",
    "constraint-velocity": "The constraints at the level of velocity.",
    "constraint-acceleration": "The constraints at the level of acceleration.",
    "orthogonality": "Orthogonality of the rotation matrices.",
    "speed": "Largest error against stepping time.", "convergence": "Largest error against the step."}
"""By the beginning of the last part of a figure's file name."""

BIBLIOGRAPHY = """@article{lie_stabilized_2019,
  title   = {Constraint-stabilized implicit methods on {Lie} group for differential-algebraic equations of multibody
             system dynamics},
  journal = {Advances in Mechanical Engineering},
  year    = {2019},
  doi     = {10.1177/1687814019842406},
  key     = {Lie group methods 1}
}

@article{lie_euler_2018,
  title   = {{Lie} group {Euler} methods for differential-algebraic equations of multibody system dynamics},
  journal = {Advances in Mechanical Engineering},
  year    = {2018},
  doi     = {10.1177/1687814018764154},
  key     = {Lie group methods 2}
}

@article{bourabee_marsden_2009,
  author  = {Bou-Rabee, Nawaf and Marsden, Jerrold E.},
  title   = {{Hamilton}-{Pontryagin} integrators on {Lie} groups, part {I}: introduction and structure-preserving
             properties},
  journal = {Foundations of Computational Mathematics},
  volume  = {9},
  number  = {2},
  pages   = {197--219},
  year    = {2009},
  doi     = {10.1007/s10208-008-9030-4}
}
"""

PREAMBLE = r"""\documentclass[a4paper]{article}
\usepackage[margin=20mm]{geometry}
\usepackage{graphicx,booktabs,amsmath}
\begin{document}
"""


def write_paper(document: Document, folder: Path) -> Path:
    """Write paper.tex, a table for each scene, references.bib and the figures; return the path of paper.tex.

    Runs of all engines of the document are in it, those of the user's own too.
    """
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    parts = []
    with style():
        for scene in (each for each in document.scenes if not each.failure):
            runs = [run for run in document.records if run.scene == scene.name and run.outcome != "unsupported"]
            stem = Path(pages.scene_file(scene)).stem
            put(folder / f"{stem}-table.tex", table(runs))
            parts.append(_section(scene, stem, runs, list(drawn(scene, runs, folder / "figures", FORMATS))))
    put(folder / "references.bib", BIBLIOGRAPHY)
    put(folder / "paper.tex", PREAMBLE + "\n".join(parts) + _origin(document) + "\\end{document}\n")
    return folder / "paper.tex"


def table(runs: Sequence[Record]) -> str:
    """The largest errors of runs as a LaTeX table, a line for each; one that did not end has what it said."""
    lines = []
    for run in runs:
        values = [_number(read(run)) for read in COLUMNS.values()]
        order = None if run.order is None else run.order.observed
        lines.append(" & ".join([typed(run.label), *values, "--" if order is None else f"{order:.2f}"]
                                if run.steps is not None else
                                [typed(run.label), rf"\multicolumn{{{len(COLUMNS) + 1}}}{{l}}{{{tex(run.message)}}}"]))
    return "\n".join([rf"\begin{{tabular}}{{l{'r' * (len(COLUMNS) + 1)}}}", r"\toprule",
                      " & ".join(["run", *COLUMNS, "order"]) + r" \\", r"\midrule", *(f"{line} \\\\" for line in lines),
                      r"\bottomrule", r"\end{tabular}", ""])


def typed(name: str) -> str:
    """A name in typewriter type."""
    return r"\texttt{" + tex(name) + "}"


def _level(run: Record, name: str) -> float | None:
    return run.levels[name].max if name in run.levels else None


def _number(value: float | None) -> str:
    if value is None:
        return "--"
    mantissa, exponent = f"{value:.1e}".split("e")
    return "0" if value == 0 else rf"${mantissa}{{\cdot}}10^{{{int(exponent)}}}$"


def _section(scene: Scene, stem: str, runs: Sequence[Record], figures: Sequence[tuple[str, str]]) -> str:
    """The part of the document about one scene; `figures` are stems of files and the last parts of their names."""
    steps = sorted({run.step for run in runs if run.step})
    sizes = f" Steps of {1e3 * steps[0]:g} to {1e3 * steps[-1]:g}\\,ms." if steps else ""
    parts = [rf"\section{{{tex(scene.title)}}}", f"{tex(scene.description)}.", "",
             r"\begin{table}[htbp]\centering\small",
             rf"\caption{{Largest errors over {scene.duration:g}\,s of {typed(scene.title)}: total energy relative to "
             r"its value at the start and to the largest kinetic energy, the three constraint levels, orthogonality, "
             rf"the error of the mass centres at the end, and the observed order.{sizes}}}",
             r"\setlength{\tabcolsep}{3pt}",
             rf"\resizebox{{\textwidth}}{{!}}{{\input{{{stem}-table}}}}", r"\end{table}", ""]
    for file, end in figures:
        caption = next(words for start, words in CAPTIONS.items() if end.startswith(start))
        parts += [r"\begin{figure}[htbp]\centering", rf"\includegraphics[width=\textwidth,height=0.4\textheight,"
                  rf"keepaspectratio]{{figures/{file}}}", rf"\caption{{{typed(scene.title)}. {caption}}}",
                  r"\end{figure}", ""]
    return "\n".join([*parts, r"\clearpage", ""])


def _origin(document: Document) -> str:
    meta = document.meta
    versions = ", ".join(f"{name} {version}" for name, version in (meta.packages | meta.engines).items())
    lines = [r"\section*{Provenance}",
             f"Computed {tex(meta.time)} by {typed(meta.command)} with {tex(versions)}, Python {tex(meta.python)}, on "
             f"{tex(meta.machine.processor)}, {tex(meta.machine.system)}"
             + (f", commit {tex(meta.commit)}" if meta.commit else "") + "."]
    if "lieeuler" in meta.engines:
        lines.append(r"The Euler methods of lieeuler are those of \cite{lie_stabilized_2019} and "
                     r"\cite{lie_euler_2018}, reconstructed from their prose; the Hamiltonian ones have the form of "
                     r"\cite{bourabee_marsden_2009}. The scenes have parameters of this project, not of the papers.")
        lines += [r"\bibliographystyle{plain}", r"\bibliography{references}"]
    return "\n".join([*lines, ""])
