"""A change by path is the file edited and read again, in derivatives, sweeps and everywhere else."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

import crosscheck
from crosscheck.jointspace.flows import STEP
from crosscheck.scene.building import scene_from
from crosscheck.scene.file import read_scene
from crosscheck.scene.paths import changed, content_of, edited, number_at, numbers, size_at, unit
from crosscheck.sweeps import members, plan

T = 0.2


def rail(**joint):
    """A cart on a sprung and damped rail."""
    return {"schema": 3, "name": "rail_spring", "gravity": [0.0, 0.0, -9.81], "duration": 1.0, "samples": 11,
            "bodies": [{"name": "cart", "mass": 2.0, "inertia": np.diag([0.1] * 3).tolist()}],
            "joints": [{"name": "rail", "type": "prismatic", "parent": "ground", "child": "cart",
                        "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3, "parent_axis": [1.0, 0.0, 0.0],
                        "child_axis": [1.0, 0.0, 0.0], "position": 0.1, "velocity": 0.5, "stiffness": 40.0,
                        "damping": 0.6} | joint]}


def test_the_damping_of_a_slide():
    """q = A e^(-c t / 2m) cos(w t - p) of m q'' + c q' + k q = 0, differentiated by c with a complex step."""
    def end(c):
        m, k, q, v = 2.0, 40.0, 0.1, 0.5
        a, w = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2 + 0j)
        b = (v + a * q) / w
        value = np.exp(-a * T) * (q * np.cos(w * T) + b * np.sin(w * T))
        return np.array([value, -a * value + np.exp(-a * T) * w * (b * np.cos(w * T) - q * np.sin(w * T))])

    wanted = end(0.6 + 1e-30j).imag / 1e-30
    for source, step in (("truth", None), ("lieeuler:taylor", None), ("lieeuler:rkmk853", 1e-2)):
        found = crosscheck.flow_derivative(scene_from(rail(), "rail"), T, source, step,
                                           parameters=("joints.rail.damping",))
        np.testing.assert_allclose(found.parameters[:, 0], wanted, atol=1e-9)


def test_the_anchor_of_a_sprung_slide():
    """A cart 1.5 m from where it hangs on a link: the link's turn carries the anchor, and the spring stays one."""
    content = rail(position=0.4, velocity=0.0)
    content["bodies"].insert(0, {"name": "arm", "mass": 1.0, "inertia": np.diag([0.2] * 3).tolist()})
    content["joints"][0]["parent"] = "arm"
    content["joints"].insert(0, {"name": "pin", "type": "revolute", "parent": "ground", "child": "arm",
                                 "parent_anchor": [0.0] * 3, "child_anchor": [0.0] * 3, "parent_axis": [0.0, 1.0, 0.0],
                                 "child_axis": [0.0, 1.0, 0.0], "position": 0.3, "velocity": 1.0})
    path = "joints.rail.parent_anchor.0"

    def end(q1, u1, q2, u2, a):
        """x = a + q2 along the arm: (J + m x^2) q1' ' = -2 m x u1 u2 + m g x sin.., by RK4 of the two equations."""
        def f(y):
            q1, u1, q2, u2 = y
            x, g, m, J = a + q2, 9.81, 2.0, 0.3
            return np.array([u1, (-2 * m * x * u1 * u2 + m * g * x * np.cos(q1)) / (J + m * x * x),
                             u2, x * u1**2 + g * np.sin(q1) - (40.0 * q2 + 0.6 * u2) / m])

        y, h = np.array([q1, u1, q2, u2], dtype=complex), T / 400
        for _ in range(400):
            k1 = f(y)
            k2 = f(y + h / 2 * k1)
            k3 = f(y + h / 2 * k2)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(y + h * k3))
        return y[[0, 2, 1, 3]]

    wanted = end(0.3, 1.0, 0.4, 0.0, 1e-30j).imag / 1e-30
    found = crosscheck.flow_derivative(scene_from(content, "arm"), T, parameters=(path,))
    np.testing.assert_allclose(found.parameters[:, 0], wanted, atol=1e-8)


def by_hand(content, path, value):
    """The content with another number, written here once more; its symmetric entry goes with it."""
    content = copy.deepcopy(content)
    words = path.split(".")
    for order in ([words] if "inertia" not in words else [words, [*words[:-2], words[-1], words[-2]]]):
        owner = content
        for word in order[:-1]:
            named = [each for each in owner if isinstance(each, dict) and each.get("name") == word]
            owner = named[0] if named else owner[word] if isinstance(owner, dict) else owner[int(word)]
        owner[order[-1] if isinstance(owner, dict) else int(order[-1])] = value
    return content


def readable(content):
    try:
        return scene_from(content, "edited")
    except crosscheck.SceneError:
        return None


def end_of(content, name):
    """q and v of joints without balls at the end, by lieeuler."""
    run = crosscheck.run(scene_from(content, name), "lieeuler", "taylor", duration=T, samples=2, rtol=1e-13)
    q, v = ([np.ravel(getattr(each, key)[-1]) for each in run.joints.values()] for key in ("position", "velocity"))
    return np.concatenate([*q, *v])


SCENES = ("hinge_pendulum", "cylindrical_pendulum", "torsion_wheel", "driven_double_pendulum", "universal_pendulum",
          "planar_slider", "driven_cart")


@pytest.mark.parametrize("name", SCENES)
def test_a_derivative_is_the_difference_of_edited_files(name):
    _, content = read_scene(name)
    content |= {"duration": T, "samples": 2}
    rng = np.random.default_rng(5)
    every = [each for each in numbers(content) if not each.startswith(("schema", "samples", "duration"))]
    moved = 0
    for each in rng.permutation(every)[:4].tolist():
        value, size = number_at(content, each), size_at(content, each)

        def end(shift, each=each, value=value, size=size):
            return end_of(by_hand(content, each, value + shift * size), name)

        try:
            found = crosscheck.flow_derivative(name, T, "lieeuler:taylor", parameters=(each,), rtol=1e-13)
        except crosscheck.ArgumentError as refused:
            said = str(refused)
            assert said.startswith(f"{each} = ")
            assert not all(readable(by_hand(content, each, value + k * STEP * size)) for k in range(-4, 5))
            continue
        h = 1e-3
        wanted = (8 * (end(h) - end(-h)) - (end(2 * h) - end(-2 * h))) / (12 * h * size)
        np.testing.assert_allclose(found.parameters[:, 0], wanted, rtol=0, atol=3e-7 * max(1.0, np.abs(wanted).max()))
        moved += bool(wanted.any())
    assert moved


@pytest.mark.parametrize(("name", "path"), [("hinge_pendulum", "bodies.0.position.0"),
                                            ("prismatic_slider", "bodies.0.position.1")])
def test_the_position_of_a_jointed_body_is_refused_by_name(name, path):
    content = content_of(crosscheck.load_scene(name))
    content["bodies"][0]["position"] = crosscheck.load_scene(name).x0[0].tolist()
    with pytest.raises(crosscheck.ArgumentError, match=rf"{path}.* not to be changed by itself: .*violates it"):
        crosscheck.flow_derivative(scene_from(content, name), T, "lieeuler:taylor", parameters=(path,))


def test_a_scene_that_left_its_file_has_no_paths():
    scene = scene_from(rail(), "rail")
    assert changed(scene.replace(duration=3.0), {"joints.rail.damping": 0.7}).duration == 3.0
    with pytest.raises(crosscheck.ArgumentError, match="was changed in Python"):
        changed(scene.replace(gravity=np.zeros(3)), {"joints.rail.damping": 0.7})


def test_both_entries_of_an_inertia_go_together():
    content = edited(rail(), {"bodies.cart.inertia.0.1": 0.01, "bodies.0.inertia.2.1": 0.02})
    np.testing.assert_array_equal(content["bodies"][0]["inertia"], [[0.1, 0.01, 0], [0.01, 0.1, 0.02], [0, 0.02, 0.1]])
    assert json.dumps(rail()) == json.dumps(edited(rail(), {}))


def sweep(content, tmp_path, **more):
    (tmp_path / "scene.json").write_text(json.dumps(content))
    return plan.read({"scenes": [str(tmp_path / "scene.json")], "engines": {"lieeuler": ["rattle2"]}, "steps": [1e-2],
                      **more})


def test_a_sweep_takes_the_same_paths(tmp_path):
    asked = sweep(rail(), tmp_path, parameters={"bodies.cart.inertia.0.1": [0.01], "joints.rail.damping": [0.7]})
    (start,) = members.starts(asked)
    assert start.scene.bodies[0].inertia[1, 0] == 0.01
    assert start.scene.key == scene_from(edited(rail(), {"bodies.cart.inertia.0.1": 0.01, "joints.rail.damping": 0.7}),
                                         "rail").key


@pytest.mark.parametrize(("path", "said"), [
    ("bodies.cart.attitude", "is a direction"), ("joints.rail.parent_axis", "is a direction"),
    ("joints.rail.parent_axis.0", "is a direction"), ("gravity.0", "is 0 in")])
def test_perturbations_that_change_nothing_are_refused(path, said, tmp_path):
    content = rail()
    content["bodies"][0]["attitude"] = [1.0, 0.0, 0.0, 0.0]
    with pytest.raises(crosscheck.ArgumentError, match=said):
        sweep(content, tmp_path, perturb={path: 0.1, "count": 2})


def test_a_perturbed_inertia_stays_symmetric(tmp_path):
    content = edited(rail(), {"bodies.cart.inertia.0.1": 0.01})
    asked = sweep(content, tmp_path, perturb={"bodies.cart.inertia": 0.01, "count": 3})
    for scene in members.of_start(next(members.starts(asked)), asked.perturbation):
        J = scene.bodies[0].inertia
        np.testing.assert_array_equal(J, J.T)
        assert J[0, 1] not in (0.0, 0.01)


@pytest.mark.parametrize(("path", "wanted"), [("joints.rail.position", ""), ("bodies.cart.position.0", "m"),
                                              ("bodies.cart.mass", "kg")])
def test_units(path, wanted):
    assert unit(path) == wanted
