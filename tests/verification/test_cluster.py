"""`verify` elsewhere: the same document from any executor, scenes of the user by their content, a lost scheduler."""

from __future__ import annotations

import concurrent.futures
import os
import shutil

import pytest

from crosscheck.errors import ArgumentError, CrosscheckError
from crosscheck.jobs.drive import run_tasks
from crosscheck.verification import job
from tests import ROOT

ASKED = {"profile": "smoke", "engines": ["lieeuler"], "methods": ["rattle2"]}


def elsewhere():
    """An executor whose processes have no file of ours beside them."""
    return concurrent.futures.ProcessPoolExecutor(1, initializer=os.chdir, initargs=("/",))


def lost():
    """An executor whose scheduler goes away: nothing handed to it ever ends."""
    class Lost(concurrent.futures.Executor):
        def submit(self, function, /, *arguments, **named):
            future = concurrent.futures.Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future
    return Lost()


def test_a_scene_of_ones_own_travels_by_its_content(tmp_path, monkeypatch):
    shutil.copy(ROOT / "scenarios" / "single_pendulum.toml", tmp_path / "mine.toml")
    monkeypatch.chdir(tmp_path)
    far = job.verify(scenes=["mine.toml"], scheduler="tests.verification.test_cluster:elsewhere", **ASKED)
    assert [(record.scene, record.outcome) for record in far.records] == [("mine.toml", "pass")]


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_records(tmp_path, monkeypatch):
    import distributed

    here = job.verify(scenes=["double_pendulum"], **ASKED)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        far = job.verify(scenes=["double_pendulum"], scheduler=cluster.scheduler_address, **ASKED)
    assert far.records[0].errors == here.records[0].errors
    assert far.records[0].levels == here.records[0].levels
    assert far.scenes[0].hash == here.scenes[0].hash


def test_a_lost_or_missing_scheduler_is_one_line():
    with pytest.raises(CrosscheckError, match="the scheduler was lost"):
        run_tasks(abs, [1, 2], executor=lost())
    with pytest.raises(ArgumentError, match="scheduler nowhere:made"):
        job.verify(scenes=["single_pendulum"], scheduler="nowhere:made", **ASKED)
