"""Scene files: those that load, and the one clear error for each that does not."""

from __future__ import annotations

import dataclasses
import json
import tomllib

import numpy as np
import pytest

from crosscheck.errors import ArgumentError, SceneError
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.file import load_scene, scene_names
from tests import SCENARIOS
from tests.scene_making import JOINT_TYPES
from tests.wrong_scenes import BOB, GONE, SCENE, WRONG, Z, changed, other_joint

BUILT_IN = ("double_pendulum", "heavy_top", "single_pendulum", "triple_pendulum")
EPS = np.finfo(float).eps
@pytest.fixture
def written(tmp_path):
    def write(data, name="made.json"):
        path = tmp_path / name
        path.write_text(data if isinstance(data, str) else json.dumps(data))
        return path

    return write


# --- what loads ------------------------------------------------------------------------------------------------------


def test_built_in_scenes_are_listed_by_name():
    assert set(BUILT_IN) <= set(scene_names())
    assert list(scene_names()) == sorted(scene_names())


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_scenes_start_closed_and_say_where_they_come_from(name):
    scene = load_scene(name)
    assert scene.name == name
    assert scene.description
    assert scene.source
    constraints = Constraints(scene)
    state = scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None]
    # 50 eps of the largest lengths (4 m) and speeds (150 rad/s at 1 m for the top)
    assert np.abs(constraints.position(*state[:2])).max() <= 50 * EPS * 4
    assert np.abs(constraints.velocity(*state)).max() <= 50 * EPS * 150


def test_scene_a_b_and_c_are_those_of_the_published_figures():
    single, double, top = (load_scene(name) for name in ("single_pendulum", "double_pendulum", "heavy_top"))
    # COM one metre down the body's -z axis, turned by 60 degrees about y
    sine, cosine = np.sin(np.pi / 3), np.cos(np.pi / 3)
    np.testing.assert_allclose(single.x0, [[-sine, 0, -cosine]], rtol=0, atol=4 * EPS)
    np.testing.assert_array_equal(single.w0, [[0.5, 0.3, 1.0]])
    tilt = np.radians(40)
    lower = [-2 * sine, np.sin(tilt), -2 * cosine - np.cos(tilt)]
    np.testing.assert_allclose(double.x0[1], lower, rtol=0, atol=8 * EPS)
    np.testing.assert_array_equal(double.inertias, [np.diag([0.1, 0.2, 0.15])] * 2)
    np.testing.assert_array_equal(top.x0, [[0, 1, 0]])
    np.testing.assert_array_equal(top.w0, [[0, 150, -4.61538]])
    np.testing.assert_array_equal(top.v0, [[4.61538, 0, 0]])
    assert 0.2 in top.t
    assert (single.duration, double.duration, top.duration) == (10, 10, 1)


@pytest.mark.parametrize("name", BUILT_IN)
def test_toml_and_json_give_the_same_scene(name, written):
    path = SCENARIOS / f"{name}.toml"
    again = load_scene(written(tomllib.loads(path.read_text())))
    scene = load_scene(path)
    assert again.hash == scene.hash == load_scene(name).hash
    prose = [(s.name, s.description, s.source, s.tags) for s in (scene, again)]
    assert prose[0] == prose[1]


def test_every_kind_of_entry_loads(written):
    scene = load_scene(written(SCENE))
    assert [force.type for force in scene.forces] == ["linear_spring", "torsional_spring", "constant_force",
                                                      "constant_torque"]
    assert (scene.forces[0].parent, scene.forces[0].child, scene.forces[1].joint) == (-1, 1, "hinge")
    assert scene.forces[0].parameters == {"parent_point": (1.0, 0.0, 0.0), "child_point": (0.0, 0.0, 0.1),
                                          "stiffness": 20.0, "free_length": 0.5, "damping": 0.1}
    assert scene.forces[1].parameters == {"stiffness": 5.0, "rest_angle": 0.4, "damping": 0.0}
    np.testing.assert_allclose(scene.x0, [[-1, 0, 2], [-2, 0, 1]], rtol=0, atol=4 * EPS)
    # the hinge turns at 1.5 rad/s and carries the ball on a circle of 2 m; the bob turns about the ball as well
    np.testing.assert_allclose(scene.v0, [[0, -1.5, 0], [0, -3.0 + 0.3, 0]], rtol=0, atol=20 * EPS)


@pytest.mark.parametrize("kind", sorted({*JOINT_TYPES} - {"revolute", "spherical"}))
def test_every_type_of_joint_loads(kind, written):
    axes = {"parent_axis": Z, "child_axis": [1.0, 0.0, 0.0] if kind == "universal" else Z}
    keys = {"fixed": {}, "distance": {"length": 0.7}, "point_on_line": {"parent_axis": Z},
            "point_on_plane": {"parent_axis": Z}}.get(kind, axes)
    still = {"bodies.0.angular_velocity": GONE, "bodies.1.angular_velocity": GONE}
    scene = load_scene(written(changed({**other_joint(kind, **keys), **still})))
    state = scene.x0[None], scene.R0[None]
    assert np.abs(Constraints(scene).position(*state)).max() <= 50 * EPS * 4


def test_axes_and_attitudes_are_normalised(written):
    scene = load_scene(written(changed({"bodies.1.attitude": [3.0, 0.0, 4.0, 0.0],
                                        "joints.0.parent_axis": [0.0, 0.0, 1e-200]})))
    np.testing.assert_allclose(scene.bodies[1].attitude, [0.6, 0, 0.8, 0], rtol=2 * EPS)
    np.testing.assert_array_equal(scene.joints[0].parent_axis, Z)


def test_whole_numbers_and_a_byte_order_mark_are_fine(written):
    data = changed({"bodies.0.mass": 2, "duration": 2})
    assert load_scene(written("\ufeff" + json.dumps(data))).hash == load_scene(written(SCENE)).hash


def test_an_inertia_asymmetric_by_rounding_is_made_symmetric(written):
    scene = load_scene(written(changed({"bodies.1.inertia.0.1": 0.01 + 2e-17})))
    np.testing.assert_array_equal(scene.inertias[1], scene.inertias[1].T)


def test_a_body_without_a_joint_is_free(written):
    free = {**BOB, "name": "stone", "position": [5.0, 6.0, 7.0]}
    scene = load_scene(written(changed({"bodies.2": free})))
    np.testing.assert_array_equal([scene.x0[2], scene.v0[2]], [[5, 6, 7], [0, 0, 0]])


PHYSICAL = ["gravity.2", "duration", "bodies.0.mass", "bodies.1.inertia.2.2", "bodies.1.angular_velocity.0",
            "joints.0.parent_anchor.2", "joints.1.child_anchor.2", "forces.0.stiffness", "forces.0.child_point.2",
            "forces.1.rest_angle", "forces.2.force.2", "forces.3.torque.2"]


@pytest.mark.parametrize("path", PHYSICAL)
def test_the_hash_sees_one_unit_in_the_last_place(path, written):
    value = SCENE
    for part in path.split("."):
        value = value[int(part) if part.isdigit() else part]
    other = load_scene(written(changed({path: float(np.nextafter(value, np.inf))})))
    assert other.hash != load_scene(written(SCENE)).hash


def test_the_hash_sees_samples_and_types(written):
    first = load_scene(written(SCENE)).hash
    assert load_scene(written(changed({"samples": 22}))).hash != first
    assert load_scene(written(changed({"forces.3.frame": "world"}))).hash != first


def test_the_hash_does_not_see_prose(written):
    prose = {"name": "other", "description": "other", "source": "other", "tags": []}
    assert load_scene(written(changed(prose))).hash == load_scene(written(SCENE)).hash


def test_assemble_closes_the_given_states(written):
    guess = {"assemble": True, "bodies.0.position": [-0.9, 0.1, 2.1], "bodies.1.position": [-2, 0, 1]}
    scene = load_scene(written(changed(guess)))
    assert np.abs(Constraints(scene).position(scene.x0[None], scene.R0[None])).max() <= 50 * EPS * 4


# --- what does not, and what it answers ------------------------------------------------------------------------------

@pytest.mark.parametrize(("changes", "entry", "mend"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG])
def test_a_wrong_file_is_answered_with_file_entry_and_mend(changes, entry, mend, written):
    path = written(changed(changes))
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert entry in text
    assert mend in text[text.index(entry) + len(entry):]  # after the problem, in one line
    assert "\n" not in text
    assert "`" not in text
    assert "$" not in text


@pytest.mark.parametrize(("name", "text", "entry", "mend"), [
    ("bad.toml", "schema = 1\nname = \n", "syntax: not TOML, Invalid value (at line 2, column 8)", "write TOML there"),
    ("bad.json", '{"schema": 1,}', "syntax: not JSON, ", "write JSON there"),
    ("twice.toml", "schema = 1\nschema = 1\n", "syntax: not TOML, Cannot overwrite a value", "write TOML there"),
    ("twice.json", '{"schema": 1, "name": "a", "name": "b"}', "name: written twice", "keep one of the two"),
    ("list.json", "[1]", "the file: holds a list", "write one JSON object"),
    ("deep.json", "[" * 100_000, "syntax: nested too deeply", "rows of numbers only"),
    ("empty.toml", "", "schema: missing", "add schema = 1"),
    ("long.toml", f"schema = {'1' * 5000}\n", "syntax: a whole number has thousands of digits", "1.5e6"),
    ("long.json", f'{{"schema": {"1" * 5000}}}', "syntax: a whole number has thousands of digits", "1.5e6"),
])
def test_a_broken_file_is_answered_with_file_entry_and_mend(name, text, entry, mend, written):
    path = written(text, name)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert str(caught.value).startswith(f"{path}: {entry}")
    assert mend in str(caught.value)


def test_a_file_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "made.toml"
    path.write_bytes(b"name = \"\xff\"")
    with pytest.raises(SceneError, match=r"made\.toml: the file: byte 8 is not UTF-8; save the file as UTF-8 text"):
        load_scene(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(SceneError, match=r"none\.toml: the file: cannot be read, no such file.*; check the path"):
        load_scene(tmp_path / "none.toml")
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    with pytest.raises(SceneError, match=r"folder\.toml: it is a folder; name a scene"):
        load_scene(folder)


@pytest.mark.parametrize("name", ["a\0.toml", "a\ud800.json"])
def test_a_path_no_file_can_have_is_refused_in_printable_words(name):
    with pytest.raises(SceneError, match="the name of the file: no file can have it; correct it") as caught:
        load_scene(name)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("outcome", [np.linalg.LinAlgError("SVD did not converge"), OverflowError(), np.nan])
def test_what_doubles_cannot_solve_is_refused(written, monkeypatch, outcome):
    """Odd numbers with which closing the joints fails or gives NaN."""
    def completed(draft):
        if isinstance(outcome, Exception):
            raise outcome
        return draft.scene.replace(bodies=tuple(dataclasses.replace(body, velocity=[outcome] * 3)
                                                for body in draft.scene.bodies))

    monkeypatch.setattr("crosscheck.scene.assembly.completed", completed)
    with pytest.raises(SceneError, match=r"made\.json: bodies: .* differ too much in size .*; bring masses"):
        load_scene(written(SCENE))


def test_an_unknown_name_leads_to_the_nearest_three():
    with pytest.raises(SceneError) as caught:
        load_scene("single_pendulm")
    text = str(caught.value)
    assert text.startswith('"single_pendulm": ')
    assert 'did you mean "single_pendulum"?' in text
    assert sum(f'"{name}"' in text for name in scene_names()) == 3
    assert "crosscheck list" in text
    assert ".toml, .json, .xml or .urdf" in text
    with pytest.raises(SceneError, match="nearest") as caught:
        load_scene("x" * 10**6)
    assert len(str(caught.value)) < 400


def test_other_files_and_other_things_are_refused(tmp_path):
    with pytest.raises(SceneError, match=r"made\.yaml: .* ends in \.toml or \.json; rename it"):
        load_scene(tmp_path / "made.yaml")
    with pytest.raises(ArgumentError, match=r"not by int.*single_pendulum"):
        load_scene(3)


def test_every_field_of_a_scene_survives_replacement():
    scene = load_scene("double_pendulum")
    longer = scene.replace(duration=20.0)
    assert longer.t[-1] == 20.0
    assert longer.hash != scene.hash
    assert dataclasses.replace(longer, duration=10.0).hash == scene.hash
