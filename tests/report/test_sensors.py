"""Sensors of a scene on its page: curves of their errors."""

from crosscheck.document import Way
from crosscheck.report import exports, pages
from crosscheck.scene.file import read_scene
from crosscheck.scene.models.writing import toml
from crosscheck.verification.cell import run_cell
from crosscheck.verification.plan import Profile
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell
from tests.report_making import document


def test_curves_of_their_errors(tmp_path):
    _, content = read_scene("single_pendulum")
    path = tmp_path / "watched.toml"
    path.write_text(toml(content | {
        "schema": 3, "name": "watched", "duration": 1.0, "samples": 51,
        "sites": [{"name": "imu", "body": content["bodies"][0]["name"], "position": [0.1, 0.0, -0.2]}],
        "sensors": [{"name": "felt", "type": "accelerometer", "site": "imu"},
                    {"name": "turned", "type": "attitude", "site": "imu"}]}))
    scene = prepare_truth((str(path), None, Profile.most_steps))
    record = run_cell(Cell(str(path), Way("lieeuler", "rkmk4"), scene.plan))
    assert record.outcome == "pass"
    results = document([scene], [record], ["lieeuler"])
    page, script = pages.scene(results, results.scenes[0]), exports.curves_script(results, results.scenes[0])
    for name, unit in (("sensor felt", "m/s^2"), ("sensor turned", "rad")):
        assert record.errors[name].unit == unit
        assert 0.0 < record.errors[name].max < 1e-3
        assert f'data-quantity="{name}" data-unit="{unit}"' in page
        assert f'"{name}":' in script
        assert "derived from its states" in record.errors[name].body
