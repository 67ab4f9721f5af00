"""Any content of a scene file gives a scene or one clear error."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.scene_mutations import judged, scene_file


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(random=st.randoms(use_true_random=False))
def test_a_file_is_a_scene_or_one_scene_error(folder, random):
    judged(folder, *scene_file(random))


@pytest.mark.parametrize("text", ['{"schema": 1, "name": "\\ud800"}', '{"\\udfff": 1}', '{"\\udc00": 1, "\\udc00": 2}'])
def test_half_a_character_is_refused(folder, text):
    assert judged(folder, ".json", text.encode()) is None


@pytest.mark.parametrize("name", ["a\\u0000b", "a\\nb", "\\u202eb", "\\u2028"])
def test_names_that_do_not_print_are_escaped_in_messages(folder, name):
    content = f'{{"schema": 1, "bodies": [{{"name": "{name}", "masss": 1.0}}]}}'
    assert judged(folder, ".json", content.encode()) is None


def test_the_mutations_reach_both_ends(folder):
    random = Random(7)
    loaded = sum(judged(folder, *scene_file(random)) is not None for _ in range(300))
    assert 10 < loaded < 290, "a fuzzer that only loads, or only refuses, looks at half of the loader"
