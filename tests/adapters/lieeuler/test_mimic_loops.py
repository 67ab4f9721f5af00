"""Mimics in loops: one that takes one of two freedoms, and one that takes the last."""

import dataclasses
import json
import math

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.coordinates import at_start
from tests.adapters.lieeuler.test_mimic import followed


def five_bar(folder, ratio):
    """Two cranks of .3 m, .4 m apart, and two couplers of .5 m that meet above; one crank follows the other."""
    low, high = (-0.2, 0.0), (-0.2 - 0.3 * math.cos(0.9), 0.3 * math.sin(0.9))
    top = (0.0, high[1] + math.sqrt(0.25 - high[0] ** 2))
    bars, half = [], {}
    for name, (x1, z1), (x2, z2) in (("left", low, high), ("left coupler", high, top),
                                     ("right", (-low[0], 0.0), (-high[0], high[1])),
                                     ("right coupler", (-high[0], high[1]), top)):
        length, turn = math.hypot(x2 - x1, z2 - z1), -math.atan2(z2 - z1, x2 - x1) / 2
        half[name] = [length / 2, 0.0, 0.0]
        bars.append({"name": name, "mass": length, "inertia": np.diag(
            [0.01 * length, length**3 / 12 + 0.01 * length, length**3 / 12]).tolist(),
            "position": [(x1 + x2) / 2, 0.0, (z1 + z2) / 2], "attitude": [math.cos(turn), 0.0, math.sin(turn), 0.0]})

    def hinge(name, parent, at, child, there):
        return {"name": name, "type": "revolute", "parent": parent, "parent_anchor": at, "child": child,
                "child_anchor": there, "parent_axis": [0.0, 1.0, 0.0], "child_axis": [0.0, 1.0, 0.0]}

    back = {name: [-values[0], 0.0, 0.0] for name, values in half.items()}
    content = {"schema": 2, "name": "five_bar", "gravity": [0.0, 0.0, -9.81], "duration": 0.25, "samples": 6,
               "description": "two cranks and two couplers", "source": "own", "bodies": bars, "joints": [
                   hinge("a", "ground", [low[0], 0.0, 0.0], "left", back["left"]),
                   hinge("b", "left", half["left"], "left coupler", back["left coupler"]),
                   hinge("c", "ground", [-low[0], 0.0, 0.0], "right", back["right"]),
                   hinge("d", "right", half["right"], "right coupler", back["right coupler"]),
                   hinge("e", "left coupler", half["left coupler"], "right coupler", half["right coupler"])]}
    path = folder / "five_bar.json"
    path.write_text(json.dumps(content))
    return followed(crosscheck.load_scene(path), "c", "a", ratio)


@pytest.mark.parametrize("ratio", [-1.0, -0.5])
def test_a_mimic_takes_one_of_two_freedoms(ratio, tmp_path):
    """With -1 the cranks move in mirror image, with -.5 they do not."""
    scene = five_bar(tmp_path, ratio)
    truth = crosscheck.truth(scene).states
    run = crosscheck.run(scene, engine="lieeuler", method="taylor", rtol=1e-12)
    assert np.ptp(run.joints["a"].position) > 0.5
    assert max(np.abs(getattr(run, name) - getattr(truth, name)).max() for name in "xRvw") < 1e-11
    assert run.stats["redundant_rows"] == 3  # those of a loop in its plane
    with pytest.raises(crosscheck.Unsupported, match="constraintDynamics, which takes no mimic joints"):
        crosscheck.run(scene, engine="pinocchio", method="RKMK4", step=1e-3)


@pytest.mark.parametrize("method", ["DAE1L_LSE", "DAE2H_LE", "rattle2", "taylor"])
def test_a_mimic_that_takes_the_last_freedom_holds_the_mechanism(method):
    loop = crosscheck.load_scene("four_bar")
    held = followed(loop, "rocker pin", "crank pivot", 0.37).replace(duration=0.5, samples=3)
    control = {"rtol": 1e-10} if method == "taylor" else {"step": 1e-2}
    run = crosscheck.run(held, engine="lieeuler", method=method, **control)
    assert np.abs(run.x - run.x[0]).max() < 1e-14
    joints = tuple(dataclasses.replace(joint, mimic=other.mimic)
                   for joint, other in zip(loop.joints, held.joints, strict=True))
    assert any(at_start(loop)["crank pivot"][1])
    with pytest.raises(crosscheck.ArgumentError, match="violates the velocity constraints"):
        crosscheck.run(loop.replace(joints=joints), engine="lieeuler", method=method, **control)
