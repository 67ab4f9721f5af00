"""Names and texts of strangers in every sink: no letter of them is a command there."""

import ast
import dataclasses
import io
import types

import numpy as np
import pytest

from crosscheck import files, load_scene
from crosscheck.adapters.exudyn.script import script
from crosscheck.cli import runs
from crosscheck.inspection.reproduce import reproduce
from crosscheck.report.paper import typed

HOSTILE = r"\input{/etc/passwd}\write18{id}~^_{}$&#%"


@pytest.mark.parametrize("encoder", [files.tex, typed])
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


@pytest.mark.parametrize("name", ["=cmd()", "@sum"])
def test_titles_of_an_exported_script_are_no_formulas(name):
    scene = load_scene("single_pendulum")
    text = script(scene.replace(bodies=(dataclasses.replace(scene.bodies[0], name=name),)))
    assert f'["\'{name}"]' in text


@pytest.mark.parametrize("native", [False, True])
def test_no_letter_of_a_model_is_python_in_the_script_that_reproduces_it(native, tmp_path):
    hostile = 'a""";called();b="""'
    scene = load_scene("hinge_pendulum").replace(name=hostile, duration=0.1, samples=3)
    if native:
        scene = tmp_path / "model.xml"
        scene.write_text(f"<mujoco><option timestep='1e-3'/><worldbody><body name='{hostile}' pos='0 0 1'>"
                         '<joint axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></worldbody></mujoco>')
    text = reproduce(scene, "mujoco", "RK4", 1e-3, duration=0.1).text
    assert "called" in text
    assert not any(isinstance(node, ast.Name) and node.id == "called" for node in ast.walk(ast.parse(text)))
