"""Names and texts of strangers in every sink: no letter of them is a command there."""

import io
import types

import numpy as np
import pytest

from crosscheck import files, load_scene
from crosscheck.cli import runs
from crosscheck.studies.paper.figures import tex

HOSTILE = r"\input{/etc/passwd}\write18{id}~^_{}$&#%"


@pytest.mark.parametrize("encoder", [files.tex, tex])
def test_no_letter_of_a_name_is_a_command_of_latex(encoder):
    written = encoder(HOSTILE).removeprefix(r"\texttt{").replace(r"\textbackslash{}", "")
    assert r"\input" not in written
    assert r"\write18" not in written
    assert encoder("a\x1bb").isprintable()


@pytest.mark.parametrize("name", ["=cmd()", "+1", "-1", "@sum"])
def test_titles_of_states_are_no_formulas(name, capsys):
    scene = load_scene("single_pendulum")
    body = types.SimpleNamespace(name=name)
    states = types.SimpleNamespace(t=np.zeros(1), x=np.zeros((1, 1, 3)), R=np.zeros((1, 1, 3, 3)),
                                   v=np.zeros((1, 1, 3)), w=np.zeros((1, 1, 3)))
    runs.write_csv(types.SimpleNamespace(bodies=[body], sensors=scene.sensors, n=1), states, "-")
    header = io.StringIO(capsys.readouterr().out).readline()
    assert all(title.startswith(f"'{name}") for title in header.strip().split(",")[1:])
