"""Sweeps: the frame, nothing computed twice, failures as rows, the same bits on every executor."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd  # noqa: TID253 - a test module
import pytest
import sqlalchemy as sql

import crosscheck
from crosscheck.errors import ArgumentError, CrosscheckError
from crosscheck.jobs.table import ROWS, VARIABLE, Table
from crosscheck.running import cluster
from crosscheck.sweeps import cells, job, plan
from tests import saved

SWEEP = {"scenes": ["single_pendulum"], "engines": {"lieeuler": ["rattle2", "taylor"], "mujoco": ["RK4"]},
         "steps": [2e-2], "rtols": [1e-8], "samples": 3, "duration": 0.2,
         "parameters": {"bodies.pendulum.mass": [1.0, 2.0]},
         "perturb": {"angular_velocity": 1e-3, "count": 3, "seed": 1}}
COLUMNS = ["cell", "scene", "engine", "version", "method", "form", "step", "rtol", "member", "bodies.pendulum.mass",
           "status", "position_error", "attitude_error", "velocity_error", "angular_velocity_error", "energy_error",
           "constraint_position", "constraint_velocity", "constraint_acceleration", "orthogonality", "steps",
           "wall_time"]


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    folder = tmp_path_factory.mktemp("local")
    return folder, crosscheck.sweep(SWEEP, workers=2, out=folder)


def test_the_frame(local):
    _, frame = local
    assert list(frame.columns) == COLUMNS
    assert len(frame) == 2 * 3 * 3 == frame["cell"].nunique()
    assert (frame["status"] == "success").all()
    assert frame["wall_time"].isna().all()
    assert frame.attrs["report"]["computed"] == 18
    errors = frame.groupby("method")["position_error"].max()
    assert errors["taylor"] < 1e-8 < errors["rattle2"] < 1e-3
    assert errors["RK4"] < 1e-5
    assert frame.attrs["report"]["disagreements"]
    assert max(frame.attrs["report"]["disagreements"]) < 1e-12


def test_errors_are_those_of_single_runs(local):
    _, frame = local
    asked = plan.read(SWEEP)
    from crosscheck.compare.errors import errors
    from crosscheck.compare.sizes import sizes
    from crosscheck.sweeps import members

    start = next(members.starts(asked))
    scene = next(members.of_start(start, asked.perturbation))
    traj = crosscheck.run(scene, "lieeuler", "rattle2", step=2e-2)
    exact = crosscheck.truth(scene).states
    found = errors(scene, traj, exact)
    row = frame.iloc[0]
    np.testing.assert_allclose(row["position_error"], found["position"].max, rtol=1e-6)  # two truths, 1e-12 apart
    gap = traj.stats["energy_error"] * traj.stats["kinetic_energy"]  # J
    np.testing.assert_allclose(row["energy_error"], gap / sizes(scene, exact)["energy"], rtol=1e-11)


def test_nothing_is_computed_twice(local):
    folder, frame = local
    again = crosscheck.sweep(SWEEP, workers=1, out=folder)
    assert again.attrs["report"]["computed"] == 0
    pd.testing.assert_frame_equal(frame, again)
    other = SWEEP | {"steps": [2e-2, 1e-2]}
    assert crosscheck.sweep(other, out=folder).attrs["report"]["computed"] == 12
    fewer = SWEEP | {"engines": {"lieeuler": ["taylor"]}}
    assert crosscheck.sweep(fewer, out=folder).attrs["report"]["computed"] == 0
    pd.testing.assert_frame_equal(frame, crosscheck.sweep(SWEEP, out=folder))


def test_the_page(local):
    folder, frame = local
    page = (folder / "index.html").read_text()
    assert "Which cells are worst?" in page
    assert frame.sort_values("position_error")["cell"].iloc[-1] in page


def test_a_cell_runs_again(local):
    folder, frame = local
    row = job.one(folder / "request.json", frame["cell"].iloc[4])
    assert row.position_error == frame["position_error"].iloc[4]
    with pytest.raises(ArgumentError, match="no such cell"):
        job.one(folder / "request.json", "0" * 32)


def test_failed_and_unsupported_runs_are_rows(tmp_path):
    frame = crosscheck.sweep({"scenes": ["single_pendulum"], "steps": [2.0], "samples": 2, "duration": 6.0, "engines": {
        "lieeuler": ["DAE1L_LSE", {"method": "DAE1L_LSE", "form": "tree"}]}}, out=tmp_path)
    assert list(frame["status"]) == ["map_domain", "unsupported"]
    assert frame.loc[frame["status"] != "success", "position_error"].isna().all()


def test_a_method_that_kills_its_worker_costs_its_own_cells_alone(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "deadly.py").write_text(
        "import os, signal\nimport lieeuler\nfrom crosscheck.adapters.lieeuler import LieEuler\n"
        "class Deadly(LieEuler):\n    name = 'deadly'\n    def run(self, scene, spec):\n"
        "        if spec.method == 'rattle4':\n            os.kill(os.getpid(), signal.SIGSEGV)\n"
        "        return super().run(scene, spec)\n")
    frame = crosscheck.sweep({"scenes": ["single_pendulum"], "steps": [2e-2], "samples": 2, "duration": 0.1,
                              "engines": {"deadly:Deadly": ["rattle2", "rattle4"]},
                              "perturb": {"attitude": 1e-3, "count": 2}}, out=tmp_path / "out")
    assert list(frame["status"]) == ["success", "crashed"] * 2


def test_timing_only_where_asked(tmp_path):
    frame = crosscheck.sweep({"scenes": ["single_pendulum"], "engines": {"lieeuler": ["rattle2"]}, "steps": [2e-2],
                              "samples": 2, "duration": 0.1, "timing": True}, out=tmp_path)
    assert (frame["wall_time"] > 0).all()
    assert frame.attrs["report"]["workers"] == 1


def test_a_worker_with_other_versions_is_refused():
    asked = plan.read(SWEEP)
    member = cells.Member(asked.origins[0].scene, asked.origins[0].scene, "s", 0, (), asked.ways, False)
    with pytest.raises(CrosscheckError, match=r"numpy .* instead of 1\.0"):
        cells.run(cells.Task((member,), cells.Code(asked.engines, (("numpy", "1.0"),)), False))


def test_an_estimate_counts_what_is_missing(local, tmp_path):
    folder, _ = local
    wider = SWEEP | {"perturb": {"angular_velocity": 1e-3, "count": 4, "seed": 1}}
    count, missing, seconds = job.estimate(wider, folder, 2)
    assert (count, missing) == (24, 6)
    assert seconds > 0


@pytest.mark.parametrize(("scheduler", "words"), [
    ("tcp://127.0.0.1:9", "no scheduler answers there"),
    ("nowhere:factory", "No module named 'nowhere'"),
    ("json:dumps", "json:dumps"),
])
def test_an_unreachable_scheduler_is_one_sentence(scheduler, words, monkeypatch, tmp_path):
    monkeypatch.setattr(cluster, "CONNECT", 1.0)
    with pytest.raises(CrosscheckError) as caught:
        crosscheck.sweep(SWEEP, scheduler=scheduler, out=tmp_path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def executor():
    """A factory for --scheduler."""
    import concurrent.futures

    return concurrent.futures.ThreadPoolExecutor(2)


def test_any_executor_by_its_factory(local, tmp_path):
    frame = crosscheck.sweep(SWEEP, scheduler="tests.sweeps.test_job:executor", out=tmp_path)
    pd.testing.assert_frame_equal(frame, local[1])


def test_a_dask_cluster_gives_the_same_bits_and_survives_a_lost_worker(local, tmp_path):
    import distributed

    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        frame = crosscheck.sweep(SWEEP, scheduler=cluster.scheduler_address, out=tmp_path / "one")
        pd.testing.assert_frame_equal(frame, local[1])
        workers = [nanny.pid for nanny in cluster.workers.values()]
        killed = []

        def kill(done, total, label):
            if not killed:
                killed.append(os.kill(workers[0], signal.SIGKILL))

        frame = crosscheck.sweep(SWEEP, scheduler=cluster.scheduler_address, out=tmp_path / "two", progress=kill,
                                 fresh=True)
        assert killed
        pd.testing.assert_frame_equal(frame, local[1])


def rows_in_the_table():
    with contextlib.closing(Table.opened()) as table, table.engine.connect() as connection:
        return connection.execute(sql.select(sql.func.count(ROWS.c.key.distinct()))).scalar()


def test_a_killed_client_goes_on_where_it_was(local, tmp_path):
    request = saved(tmp_path / "sweep.json", json.dumps(SWEEP))
    command = [sys.executable, "-m", "crosscheck", "study", "sweep", str(request), "-o", str(tmp_path / "out"),
               "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not rows_in_the_table() and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.kill()
    process.wait()
    kept = rows_in_the_table()
    frame = crosscheck.sweep(request, out=tmp_path / "out")
    assert frame.attrs["report"]["computed"] == 18 - kept
    pd.testing.assert_frame_equal(frame, local[1])


@pytest.mark.parametrize("where", ["here", "on Dask"])
def test_a_sweep_of_300_cells_killed_at_thirty_random_moments(where, tmp_path):
    """No cell is computed twice but those at work, and the frame is that of a sweep without kills."""
    asked = SWEEP | {"perturb": SWEEP["perturb"] | {"count": 50}}
    request = saved(tmp_path / "sweep.json", json.dumps(asked))
    with contextlib.ExitStack() as stack:
        words = ["--workers", "2"]
        if where == "on Dask":
            import distributed

            cluster = stack.enter_context(distributed.LocalCluster(n_workers=2, threads_per_worker=1,
                                                                   dashboard_address=None))
            words = ["--scheduler", cluster.scheduler_address]
        command = [sys.executable, "-m", "crosscheck", "study", "sweep", str(request), "-o", str(tmp_path / "out"),
                   *words]
        pause = np.random.default_rng(35).uniform(0.0, 1.5, 30)
        kept = 0
        for extra in pause:
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            began = time.monotonic()  # starting takes seconds; most kills are to fall into the runs
            while rows_in_the_table() == kept and process.poll() is None and time.monotonic() - began < 60:
                time.sleep(0.02)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.3 * extra)
            process.kill()
            process.wait()
            assert rows_in_the_table() >= kept
            kept = rows_in_the_table()
        frame = crosscheck.sweep(request, out=tmp_path / "out")
    assert frame.attrs["report"]["computed"] == 300 - kept
    with contextlib.closing(Table.opened()) as table, table.engine.connect() as connection:
        assert connection.execute(sql.select(sql.func.count(ROWS.c.key))).scalar() == 300  # none twice
    os.environ[VARIABLE] = str(tmp_path / "other.sqlite")
    pd.testing.assert_frame_equal(frame, crosscheck.sweep(asked))


def test_the_cells_of_a_folder_are_taken_into_an_empty_table(local, tmp_path):
    """Of a folder from elsewhere, or in the format of an earlier release: many parts, and what crashed among them."""
    _, frame = local
    rows = frame.rename(columns={"bodies.pendulum.mass": "parameters"})
    rows["parameters"] = [json.dumps({"bodies.pendulum.mass": mass}) for mass in rows["parameters"]]
    rows["message"] = ""
    rows.loc[17, "status"] = "crashed"
    (tmp_path / "parts").mkdir()
    for name, part in (("one", rows[:7]), ("two", rows[5:])):
        part.to_parquet(tmp_path / "parts" / f"{name}.parquet", index=False)
    again = crosscheck.sweep(SWEEP, workers=1, out=tmp_path)
    assert again.attrs["report"]["computed"] == 1
    pd.testing.assert_frame_equal(frame, again)
    assert [path.name for path in (tmp_path / "parts").iterdir()] == ["cells.parquet"]
    assert crosscheck.sweep(SWEEP, workers=1).attrs["report"]["computed"] == 0
    assert crosscheck.sweep(SWEEP, workers=1, fresh=True).attrs["report"]["computed"] == 18
    (tmp_path / "parts" / "cells.parquet").write_text("nothing")
    with pytest.raises(ArgumentError, match="not a part of a sweep"):
        crosscheck.sweep(SWEEP, out=tmp_path)


def test_times_of_one_sweep_belong_together():
    asked = {"scenes": ["single_pendulum"], "engines": {"lieeuler": ["rattle2"]}, "steps": [2e-2], "samples": 2,
             "duration": 0.1, "timing": True}
    first = crosscheck.sweep(asked, workers=1)
    wider = crosscheck.sweep(asked | {"steps": [2e-2, 1e-2]}, workers=1)
    assert wider.attrs["report"]["computed"] == 2
    assert wider["wall_time"][0] != first["wall_time"][0]
    with contextlib.closing(Table.opened()) as table, table.writing() as connection:
        connection.execute(sql.delete(ROWS).where(ROWS.c.key == wider["cell"][0]))
    again = crosscheck.sweep(asked | {"steps": [2e-2, 1e-2]}, workers=1)
    assert again.attrs["report"]["computed"] == 2


BAR = """<robot name="bar"><link name="base"/><link name="bar"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.12" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/><origin xyz="0 0 1" rpy="0 0.4 0"/>
<axis xyz="0 1 0"/></joint></robot>"""


def test_a_model_file_and_its_numbers_by_their_paths(tmp_path):
    (tmp_path / "bar.urdf").write_text(BAR)
    request = tmp_path / "sweep.json"
    request.write_text(json.dumps({"scenes": ["bar.urdf"], "engines": {"lieeuler": ["rattle2"]}, "steps": [1e-2],
                                   "samples": 2, "duration": 0.1, "parameters": {"bodies.bar.mass": [1.0, 1.3]}}))
    frame = crosscheck.sweep(request, scheduler="tests.sweeps.test_job:executor", out=tmp_path / "out")
    assert list(frame["bodies.bar.mass"]) == [1.0, 1.3]
    assert (frame["status"] == "success").all()
    assert 0 < frame["position_error"].max() < 1e-4
    request.write_text(request.read_text().replace("bodies.bar.mass", "bodies.baar.mass"))
    with pytest.raises(ArgumentError, match="did you mean 'bodies"):
        crosscheck.sweep(request)
