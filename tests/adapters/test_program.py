"""A program in any language as an engine: it reads a scene from a file and writes the states to another."""

import dataclasses
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.external.program import Program
from tests import saved

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_engine.cpp"

FALLING = """
import json, sys
import numpy as np

scene, step, out = json.load(open(sys.argv[1])), float(sys.argv[2]), sys.argv[3]
if scene["joints"]:
    print("it knows no joints", file=sys.stderr)
    sys.exit(3)
if step > 1.0:
    sys.exit("the step is too large")
t = np.linspace(0.0, scene["duration"], scene["samples"])[:, None]
x, v, q = [], [], []
for body in scene["bodies"]:
    start, rate = np.array(body["position"]), np.array(body["velocity"])
    x.append(start + rate * t + np.multiply(scene["gravity"], 0.5) * t**2)
    v.append(rate + np.multiply(scene["gravity"], 1.0) * t)
    q.append(np.tile(body["attitude"], (len(t), 1)))
x, v, q = (np.stack(each, axis=1) for each in (x, v, q))
arrays = {"t": t[:, 0], "x": x, "v": v, "w": np.zeros_like(x), "q": q}
if step < 1e-4:
    del arrays["v"]
if step < 1e-5:
    open(out, "w").write("t,a\\n0,1\\n")
elif step < 2e-5:
    pass
else:
    np.savez(out, **arrays)
"""


@pytest.fixture(scope="module")
def hinge(tmp_path_factory):
    """The example of the documents, compiled."""
    program = tmp_path_factory.mktemp("program") / "hinge"
    compiler = os.environ.get("CXX") or shutil.which("c++") or "g++"
    subprocess.run([compiler, "-O1", "-std=c++17", "-o", str(program), str(EXAMPLE)], check=True)
    return f"order=4 {program} {{scene}} {{step}} {{out}}"


@pytest.fixture
def falling(tmp_path):
    path = saved(tmp_path / "falling.py", FALLING)
    return f"name=falling {sys.executable} {path} {{scene}} {{step}} {{out}}"


def test_the_example_in_cpp_converges_at_its_order(hinge):
    coarse, fine = (crosscheck.run("hinge_pendulum", hinge, "fixed", step=step, duration=1.0, samples=101)
                    for step in (0.01, 0.005))
    known = crosscheck.truth(crosscheck.load_scene("hinge_pendulum").replace(duration=1.0, samples=101)).states
    off = [np.abs(run.x - known.x).max() for run in (coarse, fine)]
    assert off[1] < 1e-8
    assert 14.0 < off[0] / off[1] < 18.0
    assert np.abs(fine.w - known.w).max() < 1e-7


def test_a_program_refuses_what_it_does_not_know(hinge):
    with pytest.raises(crosscheck.Unsupported, match="one body on a hinge"):
        crosscheck.run("double_pendulum", hinge, "fixed", step=1e-3)


def test_a_free_body_by_npz(falling, tmp_path):
    """Position, velocity and attitude arrive where they belong."""
    scene = crosscheck.load_scene("nesc_brick")
    still = scene.replace(bodies=tuple(resting(body) for body in scene.bodies), duration=0.5, samples=11)
    run = crosscheck.run(still, falling, "fixed", step=0.01)
    assert np.allclose(run.x[-1, 0], still.x0[0] + still.v0[0] * 0.5 + still.gravity * 0.125)
    assert np.allclose(run.R, still.R0)
    assert run.steps == 50


def resting(body):
    return dataclasses.replace(body, angular_velocity=np.zeros(3))


@pytest.mark.parametrize(("step", "words"), [
    (2.0, "ended with 1: the step is too large"), (5e-5, "has no 'v'"), (1.5e-5, "wrote no file"),
    (5e-6, "has no 'pendulum x_x'")])
def test_errors_of_a_program_are_told_in_one_line(falling, step, words):
    scene = crosscheck.load_scene("nesc_brick").replace(duration=2.0, samples=2)
    name = scene.bodies[0].name
    with pytest.raises(crosscheck.EngineError) as caught:
        crosscheck.run(scene, falling, "fixed", step=step)
    assert words.replace("pendulum", name) in str(caught.value)


def test_mjcf_is_written_for_programs_that_read_it(tmp_path):
    seen = tmp_path / "seen.xml"
    script = saved(tmp_path / "copy.sh", f"#!/bin/sh\ncp \"$1\" {seen}\nexit 1\n")
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    with pytest.raises(crosscheck.EngineError, match="ended with 1: it says nothing"):
        crosscheck.run("single_pendulum", f"{script} {{mjcf}} {{rtol}} {{out}}", "adaptive", rtol=1e-6)
    assert seen.read_text(encoding="utf-8").startswith("<mujoco")


@pytest.mark.parametrize(("command", "words"), [
    ("./none {scene} {step} {out}", "there is no program './none'"), ("ls {scene} {out}", "{step} or {rtol}"),
    ("ls {step} {out}", "{scene} or {mjcf}"), ("order=x ls {scene} {step} {out}", "order and eps"),
    ("elements=wings ls {scene} {step} {out}", "elements: wings"), ("'ls {scene} {step} {out}", "No closing quotation"),
    ("order=2 {scene} {step} {out}", "there is no program")])
def test_a_wrong_command_is_told(command, words):
    with pytest.raises(crosscheck.ArgumentError) as caught:
        adapters.get(command)
    assert words in str(caught.value)


def test_what_a_command_declares(hinge):
    engine = adapters.get(hinge)
    assert (engine.name, engine.methods, dict(engine.orders)) == ("hinge", ("fixed",), {"fixed": 4})
    assert adapters.is_own(hinge)
    assert adapters.split(hinge) == (hinge, "")
    assert engine.version().startswith("code ")
    assert adapters.sources([hinge]) == {}
    assert Program("eps=1e-7 elements=function ls {scene} {step} {out}").eps == 1e-7
