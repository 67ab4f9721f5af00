"""Large scenes and absurd files: sparse algebra agrees with dense, and every limit has a clear message."""

import os
import re

import numpy as np
import pytest

from crosscheck.errors import SceneError
from crosscheck.scene import assembly, file
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.file import load_scene
from crosscheck.scene.starts import Configuration

EPS = np.finfo(float).eps


def chain(n, kind="revolute", places=None, change=0.0):
    """The text of a chain that hangs along z, turning in its plane; with places given to `places` digits."""
    lines = ['schema = 1\nname = "chain"\ngravity = [0.0, 0.0, -9.81]\nduration = 1.0\nsamples = 2']
    for k in range(n):
        lines.append(f'[[bodies]]\nname = "b{k}"\nmass = 1.0\ninertia = [[0.1,0.0,0.0],[0.0,0.2,0.0],[0.0,0.0,0.15]]\n'
                     f'angular_velocity = [0.0, {0.3 if k == 0 else 0.0}, 0.0]')
        if places is not None:
            lines.append(f"position = [{change * np.sin(k):.{places}f}, 0.0, {-0.5 - k:.{places}f}]")
    if kind == "free":
        return "\n".join(lines)
    for k in range(n):
        parent, anchor = ("ground", 0.0) if k == 0 else (f"b{k - 1}", -0.5)
        lines.append(f'[[joints]]\nname = "j{k}"\ntype = "{kind}"\nparent = "{parent}"\nchild = "b{k}"\n'
                     f"parent_anchor = [0.0, 0.0, {anchor}]\nchild_anchor = [0.0, 0.0, 0.5]")
        if kind == "revolute":
            lines.append("parent_axis = [0.0, 1.0, 0.0]\nchild_axis = [0.0, 1.0, 0.0]")
    return "\n".join(lines)


def loaded(tmp_path, text, name="scene.toml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


def gaps(scene):
    constraints = Constraints(scene)
    state = (each[None] for each in (scene.x0, scene.R0, scene.v0, scene.w0))
    x, R, v, w = state
    return np.abs(constraints.position(x, R)).max(), np.abs(constraints.velocity(x, R, v, w)).max()


@pytest.mark.parametrize("places", [None, 9])
def test_a_chain_of_three_thousand_bodies_is_closed_to_rounding(tmp_path, places):
    scene = loaded(tmp_path, chain(3000, places=places, change=1e-9))
    position, velocity = gaps(scene)
    assert position < 50 * EPS * 3e3  # of the coordinates' size, m
    assert velocity < 50 * EPS * 3e3  # times rad/s below one


def test_three_thousand_free_bodies_are_loaded(tmp_path):
    assert loaded(tmp_path, chain(3000, "free", places=3)).n == 3000


@pytest.mark.parametrize("name", ["four_bar", "bricard", "slider_crank", "branching_tree", "rod_pendulum", "chain_8"])
def test_sparse_algebra_closes_the_joints_as_dense_does(name, monkeypatch):
    scene = load_scene(name)
    rng = np.random.default_rng(7)
    near = [each + 1e-6 * rng.normal(size=each.shape) for each in (scene.x0, scene.v0, scene.w0)]
    q = np.array([body.attitude for body in scene.bodies])
    q = q + 1e-6 * rng.normal(size=q.shape)
    guess = Configuration(near[0], q / np.linalg.norm(q, axis=1)[:, None], *near[1:])
    found = []
    for large in (10**9, 0):
        monkeypatch.setattr(assembly, "_LARGE", large)
        closed = assembly._close_positions(Constraints(scene), guess)
        found.append(assembly._close_velocities(Constraints(scene), closed))
    for field in ("x", "q", "v", "w"):
        dense, sparse = (getattr(each, field) for each in found)
        # settled to 1e-12 of lengths up to 3 m; the velocities of a graded loop magnify the states' difference
        np.testing.assert_allclose(sparse, dense, rtol=0, atol=1e-11 * max(1.0, np.abs(dense).max()))


def test_the_sparse_jacobian_is_the_dense_one():
    for name in ("four_bar", "slider_crank", "taut_chain", "puck_on_plane", "universal_pendulum"):
        scene = load_scene(name)
        constraints = Constraints(scene)
        np.testing.assert_array_equal(constraints.sparse_jacobian(scene.x0[None], scene.R0[None]).toarray(),
                                      constraints.jacobian(scene.x0[None], scene.R0[None])[0])


@pytest.mark.parametrize("text", ["a" + ".a" * 50_000 + " = 1", "x = {" + "b . " * 50_000 + "b = 1}",
                                  "[" + '"c".' * 50_000 + "c]", "[[" + "'d'." * 50_000 + "d]]"],
                         ids=["bare", "inline", "table", "array of tables"])
def test_a_key_of_many_dots_is_refused(tmp_path, text):
    with pytest.raises(SceneError, match=rf"line 1: a key has more than {file.MOST_DOTS} dots"):
        loaded(tmp_path, text)


def test_dots_elsewhere_are_no_keys(tmp_path):
    prose = f'description = "{"a." * 100} {"1." * 99}"\n# {"b." * 99}'
    text = chain(2).replace('name = "chain"', f'name = "chain"\n{prose}')
    assert loaded(tmp_path, text).n == 2


def test_a_file_beyond_the_cap_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(file, "MOST_BYTES", 1 << 20)
    with pytest.raises(SceneError, match="is larger than 1 MB"):
        loaded(tmp_path, chain(2) + "\n#" + "x" * (1 << 20))
    with pytest.raises(SceneError, match="is larger than 1 MB"):
        loaded(tmp_path, "[" * (1 << 20) + "]", "scene.json")


@pytest.mark.parametrize("suffix", ["toml", "json"])
def test_pipes_and_devices_are_refused(tmp_path, suffix):
    os.mkfifo(tmp_path / f"pipe.{suffix}")
    (tmp_path / f"zero.{suffix}").symlink_to("/dev/zero")
    for name in ("pipe", "zero"):
        with pytest.raises(SceneError, match="is not a regular file"):
            load_scene(tmp_path / f"{name}.{suffix}")


@pytest.mark.parametrize("text", ["x = " + "[" * 100_000, "x = " + "{a=" * 50_000], ids=["rows", "tables"])
def test_deep_nesting_is_refused(tmp_path, text):
    with pytest.raises(SceneError, match="syntax"):
        loaded(tmp_path, text)


def test_a_wrong_name_among_thousands_is_one_short_line(tmp_path):
    text = chain(3000).replace('parent = "b1500"', 'parent = "b15oo"')
    with pytest.raises(SceneError, match=re.escape('no body is named "b15oo"')) as caught:
        loaded(tmp_path, text)
    assert len(str(caught.value)) < 1000
