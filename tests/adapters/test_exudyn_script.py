"""A scene as a script for Exudyn: what the script prints is what the adapter's run returns."""

import dataclasses
import io
import subprocess
import sys

import numpy as np
import pytest

import crosscheck
from tests.scene.test_coordinates import body, joint, load

STEP = 1e-3
NEWTON = {"x": 1e-11, "R": 1e-10, "v": 1e-9, "w": 1e-8}
"""Both stop Newton's method at the same residual, but the optimised build of the adapter rounds differently, and a
change of a position is one of velocity over the step. The largest seen on the library: 5e-13, 3e-11, 2e-10, 2e-9."""

SCENES = ("bead_on_line", "branching_tree", "bricard", "chain_8", "cylindrical_pendulum", "damped_pendulum",
          "double_four_bar", "double_pendulum", "driven_double_pendulum", "fixed_pair", "four_bar", "heavy_top",
          "hinge_pendulum", "loaded_pendulum", "planar_slider", "prismatic_slider", "puck_on_plane", "rod_pendulum",
          "single_pendulum", "slider_crank", "spring_pendulum", "sprung_pair", "torsion_wheel", "twisted_pair",
          "universal_pendulum")


@pytest.mark.parametrize("name", SCENES)
def test_the_script_runs_and_moves_as_the_adapter_does(name, tmp_path):
    path, scene = tmp_path / "robot.py", crosscheck.load_scene(name).replace(duration=0.1, samples=3)
    crosscheck.export_model(scene, path)
    told = subprocess.run([sys.executable, str(path), str(STEP)], capture_output=True, text=True, cwd=tmp_path,
                          check=True)
    assert [each.name for each in tmp_path.iterdir()] == ["robot.py"]
    header = told.stdout.splitlines()[0].split(",")
    assert header[:2] == ["t", f"{scene.bodies[0].name} x_x"]
    data = np.loadtxt(io.StringIO(told.stdout), delimiter=",", skiprows=1)
    np.testing.assert_allclose(data[:, 0], scene.t, rtol=1e-15)
    found = np.split(data[:, 1:].reshape(scene.samples, scene.n, 18), [3, 12, 15], axis=2)
    ours = crosscheck.run(scene, "exudyn", "GeneralizedAlpha", step=STEP, form="maximal")
    for values, (key, bound) in zip(found, NEWTON.items(), strict=True):
        np.testing.assert_allclose(values, getattr(ours, key).reshape(values.shape), rtol=0, atol=bound, err_msg=key)


@pytest.mark.parametrize(("scene", "words"), [
    ("driven_cart", "a rest angle that moves"), ("driven_slider_crank", "joint 'motor' has the key drive")])
def test_what_exudyn_cannot_hold_is_named(scene, words, tmp_path):
    with pytest.raises(crosscheck.SceneError, match=words):
        crosscheck.export_model(scene, tmp_path / "robot.py")
    assert not list(tmp_path.iterdir())


def test_a_name_is_never_code(tmp_path, monkeypatch):
    hinge = joint("revolute", np.random.default_rng(1), position=0.1)
    scene = load(tmp_path, [body("a")], [hinge])
    name = '"""\n)\'; raise SystemExit(7) #{x}'
    scene = scene.replace(name=name, bodies=(dataclasses.replace(scene.bodies[0], name=name),))
    crosscheck.export_model(scene, tmp_path / "robot.py")
    monkeypatch.setattr(sys, "argv", ["robot.py"])
    space = {"__name__": "imported"}
    exec(compile((tmp_path / "robot.py").read_text(), "robot.py", "exec"), space)
    space["build"]()
    assert space["SCENE"] == name
    assert space["BODIES"] == [name]
