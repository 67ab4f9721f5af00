"""The cache of references: hits, corruption, concurrency, folders that cannot be written."""

import dataclasses
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

import crosscheck.references as references
from crosscheck.files import cache_folder
from crosscheck.references import cache
from crosscheck.references.dense_output import Truth


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CROSSCHECK_CACHE", str(tmp_path / "kept"))
    return tmp_path / "kept"


@pytest.fixture(scope="module")
def single(build):
    body = (1.0, np.diag([0.1, 0.2, 0.15]), [0.9, 0.1, 0.3, 0.0], [0.5, 0.3, 1.0])
    return build([body], [(-1, 0, [0, 0, 0], [0, 0, 1])], duration=0.2, samples=3, name="single")


@pytest.fixture
def counted(monkeypatch):
    """Integrations of a truth, from (s) and to (s); what a process keeps in memory is forgotten."""
    calls, original = [], Truth.prolong

    def prolong(truth, until):
        begin = truth.reach
        worked = original(truth, until)
        if worked:
            calls.append((begin, until))
        return worked

    monkeypatch.setattr(references, "_kept", {})
    monkeypatch.setattr(Truth, "prolong", prolong)
    return calls


def same(one, other):
    for name in ("t", "x", "R", "v", "w", "a", "alpha"):
        np.testing.assert_array_equal(getattr(one.states, name), getattr(other.states, name))
    for field in dataclasses.fields(one):
        if field.name != "states":
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


PLAIN = "def double(x):\n    return 2 * x\n"


@pytest.mark.parametrize("same", [
    '"""Doubles."""\n\n' + PLAIN, PLAIN + '"Twice."',
    "def double(x):  # x: a number\n    return (2\n            * x)\n",
    'def double(x):\n    """Twice."""\n    return 2 * x'])
def test_what_only_explains_is_no_part_of_the_key(same):
    assert cache.meaning(same) == cache.meaning(PLAIN)


@pytest.mark.parametrize("other", [PLAIN.replace("2", "3"), PLAIN.replace("* x", "* x * 1"), "LIMIT = 1\n" + PLAIN,
                                   PLAIN.replace("return", "y ="), PLAIN.replace("2 * x", "'2 * x'")])
def test_what_it_does_is_part_of_the_key(other):
    assert cache.meaning(other) != cache.meaning(PLAIN)


@pytest.mark.parametrize("stored", [None, "", "0" * 63, "\udcff"])
def test_what_is_kept_of_the_meaning_is_the_meaning(folder, tmp_path, stored):
    source = tmp_path / "module.py"
    source.write_text(PLAIN)
    found = cache._meaning([source])
    kept, = folder.glob("meaning-*")
    if stored is not None:
        kept.write_bytes(stored.encode("utf-8", "surrogateescape"))
    assert cache._meaning([source]) == found
    source.write_text("# a comment\n" + PLAIN)
    assert cache._meaning([source]) == found
    source.write_text(PLAIN.replace("2", "3"))
    assert cache._meaning([source]) != found


def test_hit_does_not_compute(folder, single, counted):
    first = references.truth(single)
    references._kept.clear()
    second = references.truth(single)
    assert counted == [(0.0, 0.2)]
    same(first, second)
    assert type(second.source) is str
    assert type(second.allowed) is float


def test_prose_hits_and_physics_misses(folder, single, counted):
    references.truth(single)
    references.truth(single.replace(name="other", description="other words"))
    assert len(counted) == 1
    references.truth(single.replace(gravity=[0, 0, -9.80665]))
    assert len(counted) == 2
    references.truth(single.replace(samples=5))
    references.truth(single.replace(duration=0.1, samples=2))
    assert len(counted) == 2


def test_a_longer_time_prolongs(folder, single, counted):
    """Two times one after the other give what one computation gives, whether memory or the file has the first."""
    at_once = references.compute(single.replace(duration=2.0, samples=9))
    counted.clear()
    references.truth(single)
    references.truth(single.replace(duration=1.0))
    references._kept.clear()
    found = references.truth(single.replace(duration=2.0, samples=9))
    assert [begin for begin, _ in counted] == sorted(begin for begin, _ in counted)
    assert counted[0][0] == 0.0 < counted[-1][0]
    same(found, at_once)
    assert len(list(folder.glob("*.*"))) == 1


def test_a_shorter_truth_does_not_replace_a_longer_one(folder, single, counted):
    """Two commands at once: the one that asked for less is the last to write."""
    references.truth(single.replace(duration=2.0))
    kept = cache.path(single).read_bytes()
    short = Truth(single)
    short.prolong(0.2)
    cache.store(short)
    assert cache.path(single).read_bytes() == kept
    assert len(list(folder.glob("*.*"))) == 1


def test_new_formulas_miss(folder, single, counted, monkeypatch):
    references.truth(single)
    monkeypatch.setattr(cache, "formula_version", lambda: "0123456789abcdef")
    references.truth(single)
    assert len(counted) == 2


@pytest.mark.parametrize("damage", ["truncated", "empty", "text", "flipped", "entry missing"])
def test_damaged_file_is_computed_anew(folder, single, counted, damage):
    first = references.truth(single)
    file = cache.path(single)
    content = bytearray(file.read_bytes())
    if damage == "entry missing":
        with np.load(file) as stored:
            kept = {name: stored[name] for name in stored.files if name != "sizes"}
        np.savez(file, **kept)
    elif damage == "flipped":
        content[content.index(b"\x93NUMPY") + 130] ^= 0xFF  # the first array starts at 128; the archive has a checksum
        file.write_bytes(content)
    else:
        file.write_bytes({"truncated": content[:len(content) // 2], "empty": b"", "text": b"not an archive"}[damage])
    with pytest.warns(UserWarning, match="computed anew"):
        same(first, references.truth(single))
    assert len(counted) == 2
    same(first, references.truth(single))  # and the file is whole again
    assert len(counted) == 2


WRONG = {"a number that is none": ("coefficients", lambda c: np.where(c == c.max(), np.nan, c)),
         "of another number of pieces": ("sizes", lambda part: part[:-1]),
         "of a motion that starts elsewhere": ("coefficients", lambda c: np.roll(c, 1, axis=1)),
         "of integers": ("growth", lambda part: part.astype(int))}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_file_that_was_changed_is_computed_anew(folder, single, counted, wrong):
    first = references.truth(single)
    name, change = WRONG[wrong]
    with np.load(cache.path(single)) as stored:
        content = {each: stored[each] for each in stored.files}
    content[name] = np.asarray(change(content[name]))
    np.savez(cache.path(single), **content)
    with pytest.warns(UserWarning, match="computed anew"):
        same(first, references.truth(single))
    assert len(counted) == 2
    references._kept.clear()


def test_folder_that_cannot_be_made_is_a_warning(tmp_path, monkeypatch, single, counted):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    monkeypatch.setenv("CROSSCHECK_CACHE", str(blocked / "below"))
    with pytest.warns(UserWarning, match="set CROSSCHECK_CACHE"):
        assert references.truth(single).states.x.shape == (3, 1, 3)


def test_nothing_is_left_of_a_failed_write(folder, single, counted, monkeypatch):
    def full(file, **content):
        file.write(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(cache.np, "savez", full)
    with pytest.warns(UserWarning, match="no space left"):
        references.truth(single)
    assert list(folder.glob("*.*")) == []


def test_two_processes_at_once(folder):
    """Both compute, both succeed, one whole file remains."""
    code = ("from crosscheck.references import truth; from crosscheck.scene.file import load_scene;"
            "print(repr(truth(load_scene('heavy_top').replace(samples=3, duration=0.05)).states.x.tolist()))")
    environment = {**os.environ, "CROSSCHECK_CACHE": str(folder)}
    racing = [subprocess.Popen([sys.executable, "-W", "error", "-c", code], env=environment, text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE) for _ in range(2)]
    results = [process.communicate(timeout=120) for process in racing]
    assert [process.returncode for process in racing] == [0, 0], results
    assert results[0][0] == results[1][0]
    assert [file.suffix for file in folder.glob("*.*")] == [".npz"]


def test_default_folder_is_the_users(monkeypatch, tmp_path):
    monkeypatch.delenv("CROSSCHECK_CACHE", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "crosscheck"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(pathlib.Path, "home", lambda: tmp_path)
    assert cache_folder() == tmp_path / ".cache" / "crosscheck"
