"""Write the folder: figures, tables as CSV and LaTeX, states, a LaTeX document with them, bibliography, provenance."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from crosscheck.document import Origin
from crosscheck.files import cell, plain, put
from crosscheck.files import tex as encoded
from crosscheck.running import provenance
from crosscheck.scene.model import Scene
from crosscheck.studies import study
from crosscheck.studies.paper import figures
from crosscheck.studies.paper.figures import tex
from crosscheck.studies.paper.runs import Line, Request, Shown, measure

MARK = "paper.json"
"""The file that shows that a folder was written by this study, so that it may be replaced."""

COLUMNS = {"energy_by_start": r"$\frac{|E - E_0|}{|E_0|}$", "energy_by_kinetic": r"$\frac{|E - E_0|}{\max T}$",
           "position": r"$|\Phi|$ (m)", "velocity": r"$|G u|$ (m/s)", "acceleration": r"$|G a + \gamma|$ (m/s$^2$)",
           "orthogonality": r"$|R^T R - I|$", "unpolished": r"without polish"}
"""Columns of the table of errors by field of `Line`."""
TRUTH = {"error": r"$|x - x_{\mathrm{ref}}|$ (m)", "order": "order"}

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


def write(scenes: Sequence[Scene], out: Path, request: Request, formats: Sequence[str],
          progress: Callable[[str], None]) -> Path:
    """Measure and write everything. Returns the path of the LaTeX document.

    Raises
    ------
    ArgumentError
        The folder holds other files or cannot be written.
    """
    study.check(out, "paper")
    put(out / MARK, "{}\n")
    (out / "figures").mkdir(parents=True, exist_ok=True)
    (out / "data").mkdir(exist_ok=True)
    parts, records = [], []
    for scene in scenes:
        shown = measure(scene, request, progress)
        drawn = figures.write(shown, request.shown, out / "figures", formats)
        text = io.StringIO()
        names = [field.name for field in dataclasses.fields(Line)]
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([cell(getattr(line, name)) for name in names] for line in shown.lines)
        put(out / "data" / f"{scene.name}-table.csv", text.getvalue())
        put(out / f"{scene.name}-table.tex", _table(shown))
        _write_data(shown, out / "data")
        parts.append(_section(shown, drawn, request))
        records.append({"scene": scene.name, "hash": scene.hash, "step": shown.step, "duration": shown.scene.duration,
                        "truth": shown.truth, "lines": shown.lines})
    origin = msgspec.convert(provenance.describe([request.engine]), Origin)
    put(out / "references.bib", BIBLIOGRAPHY)
    put(out / MARK, json.dumps(plain({"provenance": origin, "request": request, "scenes": records}), indent=1))
    document = out / "paper.tex"
    put(document, PREAMBLE + "\n".join(parts) + _origin(origin, request.engine) + "\\end{document}\n")
    return document


def _table(shown: Shown) -> str:
    """Tables 1 and 2 of [P1], with one line per method, map and correction."""
    options = [(title, name) for title, name in (("map", "coordinate_map"), ("correction", "correction"))
               if len({getattr(line, name) for line in shown.lines} - {""}) > 1]
    columns = COLUMNS | (TRUTH if any(line.error is not None for line in shown.lines) else {})
    head = ["method", *(title for title, _ in options), *columns.values()]
    rows = []
    for line in shown.lines:
        cells = [tex(line.method), *(tex(getattr(line, name)) if getattr(line, name) else "" for _, name in options)]
        if line.ended:
            cells.append(rf"\multicolumn{{{len(columns)}}}{{l}}{{{encoded(line.ended)}}}")
        else:
            cells += [_number(getattr(line, name), name == "order") for name in columns]
        rows.append(" & ".join(cells) + r" \\")
    return "\n".join([rf"\begin{{tabular}}{{l{'l' * len(options)}{'r' * len(columns)}}}", r"\toprule",
                      " & ".join(head) + r" \\", r"\midrule", *rows, r"\bottomrule", r"\end{tabular}", ""])


def _number(value: float | None, plain: bool) -> str:
    if value is None:
        return "--"
    if plain:
        return f"{value:.2f}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return "0" if value == 0 else rf"${mantissa}{{\cdot}}10^{{{int(exponent)}}}$"


def _write_data(shown: Shown, folder: Path) -> None:
    """Write states, energies and levels at the output times in full precision, one file per method."""
    for method, traj in shown.runs.items():
        columns: dict[str, np.ndarray] = {"t [s]": traj.t}
        for b, body in enumerate(shown.scene.bodies):
            columns |= {f"{body.name} x_{axis} [m]": traj.x[:, b, k] for k, axis in enumerate("xyz")}
            columns |= {f"{body.name} R_{i + 1}{j + 1}": traj.R[:, b, i, j] for i in range(3) for j in range(3)}
        columns |= {"kinetic energy [J]": traj.kinetic_energy,
                    "potential energy [J]": traj.potential_energy, "total energy [J]": traj.energy,
                    "orthogonality": traj.orthogonality}
        if method in shown.unpolished:
            columns["orthogonality without polish"] = shown.unpolished[method]
        columns |= {f"{level} level [{unit}]": values for level, unit, _ in figures.LEVELS
                    if (values := getattr(traj, f"constraint_{level}")) is not None}
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([cell(title) for title in columns])
        writer.writerows([repr(float(value)) for value in row] for row in zip(*columns.values(), strict=True))
        put(folder / f"{shown.scene.name}-{method}.csv", text.getvalue())


def _section(shown: Shown, drawn: list[tuple[str, str]], request: Request) -> str:
    """The part of the document about one scene."""
    title = encoded(shown.scene.name.replace("_", " "))
    parts = [rf"\section{{{title[0].upper()}{title[1:]}}}", f"{encoded(shown.scene.description)}.", ""]
    parts += [r"\begin{table}[htbp]\centering\small",
              rf"\caption{{Largest errors over every step of {tex(shown.scene.name)}: total energy relative to its "
              r"value at the start and to the largest kinetic energy, the three constraint levels, orthogonality "
              rf"with and without the polish after every step. Step {1e3 * shown.step:g}\,ms, "
              rf"{shown.scene.duration:g}\,s."
              + (r" The error of the mass centres is that at the end, its order that of a brief run." if any(
                  line.error is not None for line in shown.lines) else "") + "}",
              r"\setlength{\tabcolsep}{3pt}",
              rf"\resizebox{{\textwidth}}{{!}}{{\input{{{shown.scene.name}-table}}}}", r"\end{table}", ""]
    for stem, caption in drawn:
        parts += [r"\begin{figure}[htbp]\centering", rf"\includegraphics{{figures/{stem}}}",
                  rf"\caption{{{caption}}}", r"\end{figure}", ""]
    parts += [r"\clearpage", ""]
    return "\n".join(parts)


def _origin(origin: Origin, engine: str) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in origin.packages.items())
    return "\n".join([
        r"\section*{Provenance}",
        f"Computed {origin.time} with {encoded(versions)}, Python {origin.python}, on "
        f"{encoded(origin.machine.processor)}, {encoded(origin.machine.system)}"
        + (f", commit {encoded(origin.commit)}" if origin.commit else "") + ".",
        ("The figures are like those of" if engine != "lieeuler" else "The methods are those of")
        + r" \cite{lie_stabilized_2019} and \cite{lie_euler_2018}"
        + (f", of the methods of {encoded(engine)}." if engine != "lieeuler" else
           r", reconstructed from their prose; the Hamiltonian ones have the form of \cite{bourabee_marsden_2009}.")
        + " The scenes have parameters of this project, not of the papers.",
        r"\bibliographystyle{plain}", r"\bibliography{references}", ""])
