"""`verify` elsewhere: the same document from any executor, scenes of the user by their content, a lost scheduler."""

from __future__ import annotations

import concurrent.futures
import os
import shutil

import pytest

import crosscheck
from crosscheck.errors import ArgumentError, CrosscheckError
from crosscheck.jobs.drive import Place, run_tasks
from crosscheck.verification import job
from tests import ROOT

ASKED = {"profile": "smoke", "engines": ["lieeuler"], "methods": ["rattle2"]}


def elsewhere():
    """An executor whose processes have no file of ours beside them."""
    return concurrent.futures.ProcessPoolExecutor(1, initializer=os.chdir, initargs=("/",))


def own_engine(folder, monkeypatch):
    """What to ask for: an engine in the current folder, which has a package beside it."""
    (folder / "pack").mkdir()
    (folder / "pack" / "__init__.py").write_text("METHODS = ('rattle2',)\n", "utf-8")
    (folder / "engine.py").write_text("import pack\nfrom crosscheck.adapters.lieeuler import LieEuler\n\n\n"
                                      "class Mine(LieEuler):\n    methods = pack.METHODS\n", "utf-8")
    monkeypatch.chdir(folder)
    return {**ASKED, "engines": ["lieeuler", "engine.py:Mine"]}


def lost():
    """An executor whose scheduler goes away: nothing handed to it ever ends."""
    class Lost(concurrent.futures.Executor):
        def submit(self, function, /, *arguments, **named):
            future = concurrent.futures.Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future
    return Lost()


def test_scenes_and_engines_of_ones_own_travel_by_their_contents(tmp_path, monkeypatch):
    shutil.copy(ROOT / "scenarios" / "single_pendulum.toml", tmp_path / "mine.toml")
    asked = own_engine(tmp_path, monkeypatch)
    far = job.verify(scenes=["mine.toml"], scheduler="tests.verification.test_cluster:elsewhere", **asked)
    assert [(record.scene, record.engine, record.outcome) for record in far.records] == [
        ("mine.toml", "lieeuler", "pass"), ("mine.toml", "engine.py:Mine", "pass")]
    assert far.records[0].errors == far.records[1].errors
    assert far.records[1].version == far.meta.engines["engine.py:Mine"]
    frame = crosscheck.sweep({"scenes": ["single_pendulum"], "steps": [0.1], "samples": 3, "duration": 0.2, "engines": {
        "engine.py:Mine": ["rattle2"]}}, scheduler="tests.verification.test_cluster:elsewhere", out=tmp_path / "kept")
    assert list(frame.status) == ["success"]


def test_a_dask_cluster_gives_the_same_records(tmp_path, monkeypatch):
    import distributed

    here = job.verify(scenes=["double_pendulum"], **ASKED)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        asked = own_engine(tmp_path, monkeypatch)  # the workers stay in their folder
        far = job.verify(scenes=["double_pendulum"], scheduler=cluster.scheduler_address, **asked)
    for record in far.records:
        assert record.errors == here.records[0].errors
        assert record.levels == here.records[0].levels
    assert far.scenes[0].hash == here.scenes[0].hash


def test_a_lost_or_missing_scheduler_is_one_line():
    with pytest.raises(CrosscheckError, match="the scheduler was lost"), Place(2, lost()) as place:
        run_tasks(abs, [1, 2], place=place)
    with pytest.raises(ArgumentError, match="scheduler nowhere:made"):
        job.verify(scenes=["single_pendulum"], scheduler="nowhere:made", **ASKED)
