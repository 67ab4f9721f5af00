"""Whatever a scene file holds, it is a scene or one clear error."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import crosscheck
from crosscheck.scene import Scene
from tests.scene_mutations import scene_file


def load(folder, suffix, content):
    """The scene of a file, or the message that refuses it; both judged."""
    path = folder / f"fuzzed{suffix}"
    path.write_bytes(content)
    try:
        scene = crosscheck.load_scene(path)
    except crosscheck.SceneError as error:
        name, entry, mend = str(error).partition(": ")[0], str(error).partition(": ")[2], str(error).partition("; ")[2]
        assert str(error).encode(), "the message can be printed"
        assert name == str(path), "the message names the file"
        assert entry, "the message names the entry"
        assert mend, "the message says what to write"
        return None
    assert isinstance(scene, Scene)
    assert all(np.isfinite(values).all() for values in (scene.x0, scene.R0, scene.v0, scene.w0))
    return scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(random=st.randoms(use_true_random=False))
def test_a_file_is_a_scene_or_one_scene_error(folder, random):
    load(folder, *scene_file(random))


@pytest.mark.parametrize("text", ['{"schema": 1, "name": "\\ud800"}', '{"\\udfff": 1}', '{"\\udc00": 1, "\\udc00": 2}'])
def test_half_a_character_is_refused(folder, text):
    assert load(folder, ".json", text.encode()) is None


def test_the_mutations_reach_both_ends(folder):
    from random import Random

    random = Random(7)
    loaded = sum(load(folder, *scene_file(random)) is not None for _ in range(300))
    assert 10 < loaded < 290, "a fuzzer that only loads, or only refuses, looks at half of the loader"
