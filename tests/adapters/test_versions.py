"""Engines of a chosen version: the protocol with an environment that borrows what is installed, and once with pip."""

import os
import subprocess
import sys

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.external import versions
from crosscheck.errors import ArgumentError
from crosscheck.running import provenance
from crosscheck.verification import job

SCENE = "single_pendulum"


@pytest.fixture(scope="module")
def borrowed(tmp_path_factory):
    """The name of an "other version" of MuJoCo whose environment finds the packages of the present one."""
    before = os.environ.get("CROSSCHECK_CACHE")
    os.environ["CROSSCHECK_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    version = provenance.engine_version("mujoco")
    place = versions.folder("mujoco", version)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
    site, = place.glob("lib/python*/site-packages")
    (site / "borrowed.pth").write_text(os.path.dirname(os.path.dirname(np.__file__)) + "\n", encoding="utf-8")
    yield f"mujoco=={version}"
    adapters._MADE.clear()
    if before is None:
        del os.environ["CROSSCHECK_CACHE"]
    else:
        os.environ["CROSSCHECK_CACHE"] = before


def test_the_same_version_in_another_process_gives_the_same_bits(borrowed):
    here = crosscheck.run(SCENE, "mujoco", "RK4", step=1e-2)
    there = crosscheck.run(SCENE, borrowed, "RK4", step=1e-2)
    assert there.engine == borrowed
    for name in ("t", "x", "R", "v", "w", "a", "alpha"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))
    assert there.stats["own_environment"]
    assert adapters.get(borrowed).version() == provenance.engine_version("mujoco")
    assert adapters.get(borrowed).methods == adapters.methods("mujoco")


def test_a_version_spelt_otherwise_than_it_is_installed_is_refused(borrowed):
    """Pip takes "4" for 4.0.0; the labels of a report name the version that ran."""
    version = provenance.engine_version("mujoco")
    other = f"{version}.0"
    versions.folder("mujoco", other).symlink_to(versions.folder("mujoco", version))
    with pytest.raises(ArgumentError) as caught:
        adapters.get(f"mujoco=={other}")
    assert f"this is version {version}; write mujoco=={version}" in str(caught.value)


def test_errors_come_through_as_they_are(borrowed):
    with pytest.raises(crosscheck.ArgumentError, match="needs a fixed step"):
        crosscheck.run(SCENE, borrowed, "RK4")
    with pytest.raises(crosscheck.Unsupported, match="form pivot"):
        crosscheck.run(SCENE, borrowed, "RK4", step=1e-2, form="pivot")
    fast = crosscheck.load_scene("heavy_top")
    with pytest.raises(crosscheck.EngineError):
        crosscheck.run(fast, borrowed, "RK4", step=0.5, duration=1e4)


def test_an_engine_that_dies_there_is_told_and_started_again(borrowed):
    adapter = adapters.get(borrowed)
    with pytest.raises(crosscheck.EngineError, match=r"^mujoco==.*died while it ran this: SIGABRT"):
        adapter._process.call(os.abort)
    assert crosscheck.run(SCENE, borrowed, "RK4", step=1e-2).status == "success"


def test_it_is_judged_but_its_times_are_compared_with_nothing(borrowed):
    results = job.verify("smoke", [SCENE], [borrowed, "mujoco"], 1, methods=["RK4"])
    there = [record for record in results.records if record.engine == borrowed]
    here = [record for record in results.records if record.engine == "mujoco"]
    assert [record.outcome for record in there] == ["pass"] * len(there) == [record.outcome for record in here]
    assert all(record.own_environment and record.us_per_step is None for record in there)
    assert all(record.us_per_step is None for record in there)
    assert not any(record.own_environment for record in here)
    assert {record.version for record in there} == {provenance.engine_version("mujoco")}
    assert all(record.ladder for record in there)
    assert all(record.us_per_step is not None for record in here)


@pytest.mark.parametrize(("name", "words"), [
    ("bullet==3.2", "a version can be chosen for mujoco, pinocchio, exudyn"),
    ("lieeuler==0.1", "a version can be chosen for mujoco, pinocchio, exudyn"),
    ("mujoco==", "'' is no version; write it like mujoco==1.2.3"),
    ("mujoco==../../x", "is no version"),
    *((f"mujoco=={version}", "is no version") for version in (
        "3..7", "3.3.", "3.3-7", "v3.3", "3.*", "03.3", "3.3.7+x..y", "3.3.7RC1", "3.3.7+", "!3", "3.0 rc1", "3.3.7a")),
    ("mujoco==3.3.7 --index-url", "is no version"),
])
def test_what_is_no_version_is_said_before_anything_is_made(name, words, tmp_path, monkeypatch):
    monkeypatch.setenv("CROSSCHECK_CACHE", str(tmp_path / "cache"))
    with pytest.raises(crosscheck.ArgumentError) as caught:
        adapters.get(name)
    assert words in str(caught.value)
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize(("said", "words"), [
    ("ERROR: Could not find a version that satisfies the requirement mujoco==9.9 (from versions: 3.3.6, 3.3.7)\n"
     "ERROR: No matching distribution found for mujoco==9.9", "versions there are: 3.3.6, 3.3.7"),
    ("ERROR: Could not find a version that satisfies the requirement mujoco==9.9 (from versions: none)\n"
     "ERROR: No matching distribution found for mujoco==9.9", "cannot be fetched: is there a network?"),
    ("WARNING: Retrying after connection broken by 'NewConnectionError'", "cannot be fetched: is there a network?"),
    ("ERROR: disk quota exceeded", "cannot be installed; pip said: disk quota exceeded"),
])
def test_a_failed_installation_is_one_clear_error(said, words, tmp_path, monkeypatch):
    def failing(command, **options):
        return subprocess.CompletedProcess(command, int("pip" in command), "", said)

    monkeypatch.setenv("CROSSCHECK_CACHE", str(tmp_path))
    monkeypatch.setattr(versions.subprocess, "run", failing)
    with pytest.raises(crosscheck.EngineError) as caught:
        adapters.get("mujoco==9.9")
    assert str(caught.value).startswith("mujoco==9.9: ")
    assert words in str(caught.value)
    assert list((tmp_path / "engines").iterdir()) == []  # nothing half made is left for the next time


def test_a_cache_that_cannot_be_written(monkeypatch):
    monkeypatch.setenv("CROSSCHECK_CACHE", "/proc/nowhere")
    with pytest.raises(crosscheck.EngineError, match="set CROSSCHECK_CACHE to a folder that can be written"):
        adapters.get("mujoco==9.9")


def test_its_environment_gets_all_that_the_adapters_import():
    code = ("import sys, crosscheck.adapters.external.remote\n"
            "from crosscheck import adapters\n"
            f"[adapters.get(name) for name in {sorted(versions.PACKAGES)} if name in adapters.names()]\n"
            "print(*{name.partition('.')[0] for name in sys.modules})")
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert {"numpy", "scipy", "msgspec", "mpmath", "psutil", "typer", "rich"} & set(loaded) <= set(versions.NEEDED)


def test_what_changed_in_mujoco_between_two_releases():
    """RK4 on a ball joint: 3.3.7 adds the velocities of the stages before it turns the body, 4.0.0 does not."""
    old, new = "mujoco==3.3.7", "mujoco==4.0.0"
    try:
        found = [adapters.get(name).version() for name in (old, new)]
    except crosscheck.EngineError as error:
        pytest.skip(str(error))
    assert found == ["3.3.7", "4.0.0"]
    results = job.verify("smoke", [SCENE, "heavy_top"], [old, new], 1)
    orders = {(record.engine, record.scene): record.order.observed
              for record in results.records if record.method == "RK4"}
    for scene in (SCENE, "heavy_top"):
        assert orders[old, scene] == pytest.approx(2.0, abs=0.15)
        assert orders[new, scene] == pytest.approx(4.0, abs=0.15)
    absent, = {record.message for record in results.records if (record.engine, record.method) == (old, "discrete")}
    assert absent.endswith("MuJoCo 3.3.7 has no integrator discrete")
