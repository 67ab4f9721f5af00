"""Trajectories in other tools: one-line texts, and every bit of the numbers."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
from crosscheck.scene.model import Sensor


@pytest.fixture(scope="module")
def traj():
    return crosscheck.run("double_pendulum", "lieeuler", "rattle2", step=1e-2, duration=1.0, samples=11)


def test_texts_are_one_short_line(traj):
    problem = build_problem(traj.scene)
    solution = lieeuler.integrate(problem, "rattle2", 1e-2, [0.0, 0.1])
    for value in (traj, traj.scene, problem, solution):
        text = repr(value)
        assert text.startswith(type(value).__name__ + "(")
        assert "\n" not in text
        assert len(text) < 200
    assert "<table>" in traj._repr_html_()


def test_a_frame_survives_parquet_bit_for_bit(traj, tmp_path):
    import pandas as pd

    frame = traj.to_frame()
    np.testing.assert_array_equal(frame.index, traj.t)
    np.testing.assert_array_equal(frame["lower.x_z"], traj.x[:, 1, 2])
    np.testing.assert_array_equal(frame["upper.R_23"], traj.R[:, 0, 1, 2])
    np.testing.assert_array_equal(frame["lam_5"], traj.lam[:, 5])
    np.testing.assert_array_equal(frame["energy"], traj.energy)
    frame.to_parquet(tmp_path / "run.parquet")
    pd.testing.assert_frame_equal(frame, pd.read_parquet(tmp_path / "run.parquet"), check_exact=True)


def test_a_dataset_has_names_and_units(traj):
    data = traj.to_xarray()
    np.testing.assert_array_equal(data["x"].sel(body="lower", axis="z"), traj.x[:, 1, 2])
    np.testing.assert_array_equal(data["R"], traj.R)
    assert data["w"].attrs["units"] == "rad/s"
    assert data.attrs["engine"] == "lieeuler"


def test_sensors_leave_every_other_column_as_it_is():
    """Sensors may have any name, those of series among them."""
    scene = crosscheck.load_scene("hinge_pendulum")
    joint = scene.joints[0].name
    named = scene.replace(sensors=tuple(Sensor(name, "joint_position", joint=joint)
                                        for name in ("energy", "t", "x", "q")))
    traj = crosscheck.run(named, "lieeuler", "rattle2", step=1e-2, duration=0.1, samples=3)
    frame, data = traj.to_frame(), traj.to_xarray()
    for table in (frame, data):
        np.testing.assert_array_equal(table["energy"], traj.energy)
        for column in ("sensor.energy", "sensor.t", "q"):
            np.testing.assert_array_equal(table[column], traj.sensors["energy"])
    np.testing.assert_array_equal(data["x"], traj.x)
    np.testing.assert_array_equal(data["t"], traj.t)
    np.testing.assert_array_equal(data["sensor.x"], traj.sensors["x"])


def test_a_recording_has_every_body_and_figure(traj, tmp_path):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    traj.to_rerun(tmp_path / "run.rrd")
    chunks = {chunk.entity_path: chunk.to_record_batch().to_pydict()
              for chunk in RrdReader(tmp_path / "run.rrd").stream().to_chunks()}
    assert {"/bodies/upper", "/bodies/lower/shape", "/paths/lower", "/figures/energy"} <= set(chunks)
    lower = chunks["/bodies/lower"]
    # Single precision; matrices are stored column by column.
    np.testing.assert_allclose(np.reshape(lower["Transform3D:translation"], (11, 3)), traj.x[:, 1], atol=1e-6)
    columns = np.reshape(lower["Transform3D:mat3x3"], (11, 3, 3))
    np.testing.assert_allclose(columns.swapaxes(1, 2), traj.R[:, 1], atol=1e-6)
    np.testing.assert_array_equal(np.ravel(chunks["/figures/energy"]["Scalars:scalars"]), traj.energy)
    np.testing.assert_allclose([each.total_seconds() for each in lower["t"]], traj.t, atol=1e-6)
    # The ellipsoid has the body's moments of inertia.
    shape = chunks["/bodies/lower/shape"]
    squares = np.ravel(shape["Ellipsoids3D:half_sizes"]) ** 2
    axes = np.reshape(shape["Transform3D:mat3x3"], (3, 3)).T
    inertia = axes @ np.diag(traj.scene.masses[1] / 5 * (squares.sum() - squares)) @ axes.T
    np.testing.assert_allclose(inertia, traj.scene.inertias[1], atol=1e-6)


def test_recordings_that_cannot_be_written_are_one_line(traj, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(crosscheck.ArgumentError, match=r"to_rerun: .*lieeuler-crosscheck\[rerun\]"):
        traj.to_rerun(tmp_path / "run.rrd")
    monkeypatch.delitem(sys.modules, "rerun")
    pytest.importorskip("rerun")
    with pytest.raises(crosscheck.ArgumentError, match=r"to_rerun .*run\.rrd: the file cannot be written"):
        traj.to_rerun(tmp_path / "no folder" / "run.rrd")


def test_a_plot_shows_every_body(traj, tmp_path):
    figure = traj.plot()
    assert [line.get_label() for line in figure.axes[0].lines] == ["upper", "lower"]
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_ydata(), traj.x[:, 1, 2])
    figure.savefig(tmp_path / "run.png")
