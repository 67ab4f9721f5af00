"""Tolerances set by the user: from a file, from options, in the verdict, and one clear error for wrong input."""

import pytest

from crosscheck.document import Errors, Level, Plan, Record, Way
from crosscheck.document.known import Known
from crosscheck.errors import ArgumentError
from crosscheck.judge import overrides
from crosscheck.judge.overrides import BY_USER, tolerated
from crosscheck.verification import cell
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.fake_engine import FakeEngine, install


def test_a_file_and_options_are_read_and_options_go_first(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text('position = 1e-3\n"level position" = 1e-6\n'
                    'energy = { value = 0.1, why = "the sensor is no better" }')
    found = {name: (value, why) for name, value, why in overrides.read(path, ["position=2e-3", "orthogonality=1"])}
    assert found["position"] == (2e-3, BY_USER)
    assert found["level position"] == (1e-6, BY_USER)
    assert found["energy"] == (0.1, f"{BY_USER}: the sensor is no better")
    assert found["orthogonality"] == (1.0, BY_USER)


def test_a_sensor_has_a_bound_by_its_name(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text('imu = 1e-3\n"sensor position" = 1e-6')
    own = overrides.read(path, ["hip=2.0"], ["imu", "hip", "position"])
    assert {name: value for name, value, _ in own} == {"sensor imu": 1e-3, "sensor position": 1e-6, "sensor hip": 2.0}
    with pytest.raises(ArgumentError, match="--tol imuu"):
        overrides.read(None, ["imuu=1.0"], ["imu"])


@pytest.mark.parametrize(("text", "words"), [
    ("place = 1e-3", ["place", "position"]),
    ("position = -1", ["position", "not negative"]),
    ("position = true", ["position", "True"]),
    ('position = "small"', ["position", "'small'"]),
    ("position = { why = \"x\" }", ["position", "value is missing"]),
    ("position = { value = 1, reason = \"x\" }", ["reason is not known"]),
    ("position = [1", ["not TOML"]),
    ("energy = inf", ["energy", "inf"]),
])
def test_a_wrong_file_is_one_clear_error(tmp_path, text, words):
    path = tmp_path / "my.toml"
    path.write_text(text)
    with pytest.raises(ArgumentError) as error:
        overrides.read(path)
    assert "my.toml" in str(error.value)
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize("option", ["position", "position=much", "nothing=1", "position=nan"])
def test_a_wrong_option_is_one_clear_error(option):
    with pytest.raises(ArgumentError, match=f"--tol {option}"):
        overrides.read(None, [option])


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ArgumentError, match=r"none\.toml: cannot be read"):
        overrides.read(tmp_path / "none.toml")


def run(**more):
    """A run of 2 s with an error, a level and an energy, all off by 1e-3."""
    return Record(scene="single_pendulum", engine="fake", version="1", method="Plain", duration=2.0, energy_error=1e-3,
                  errors={name: Errors(unit="m", end=1e-3, max=1e-3, time=0.7, body="bob", size=0.1)
                          for name in ("position", "sensor imu")},
                  levels={"position": Level(max=1e-3, held=False, unit="m")}, **more)


@pytest.mark.parametrize("name", ["position", "sensor imu", "level position", "energy"])
@pytest.mark.parametrize(("tolerance", "status"), [(1.1e-3, "ok"), (0.9e-3, "fail")])
def test_the_largest_value_of_the_run_is_compared(name, tolerance, status):
    (found,), shares = tolerated(((name, tolerance, BY_USER),), run(), 2.0)
    assert (found.kind, found.status, found.value, found.bound) == (f"tolerance {name}", status, 1e-3, tolerance)
    assert shares == {f"tolerance {name}": 1.0}


def test_it_is_judged_as_far_as_truth_reaches():
    for name, horizon, share in (("position", 0.5, 0.25), ("position", None, 0.0), ("level position", None, 1.0),
                                 ("momentum", 2.0, 0.0)):
        _, shares = tolerated(((name, 1.0, BY_USER),), run(), horizon)
        assert shares == {f"tolerance {name}": pytest.approx(share)}
    (found,), _ = tolerated((("momentum", 1.0, BY_USER),), run(), 2.0)
    assert found.status == "unresolved"


def _record(monkeypatch, *options, **flaws):
    install(monkeypatch, FakeEngine(**flaws))
    return run_cell(Cell("single_pendulum", Way("fake", "Plain"), Plan({1: 1e-3}, samples=26),
                         overrides=overrides.read(None, options)))


def test_a_verdict_follows_the_users_tolerance_and_says_so(monkeypatch):
    assert _record(monkeypatch).outcome == "pass"
    strict = _record(monkeypatch, "position=1e-12")
    assert strict.outcome == "fail"
    (finding,) = (each for each in strict.findings if each.kind == "tolerance position")
    assert (finding.status, finding.bound, finding.why) == ("fail", 1e-12, BY_USER)


def test_a_generous_tolerance_excuses_no_lower_order(monkeypatch):
    flaw = {"claimed_order": 2, "real_order": 1, "size": 1e-3}
    assert _record(monkeypatch, "position=1", **flaw).outcome == "fail"


def test_a_known_defect_does_not_excuse_the_users_tolerance(monkeypatch):
    flaw = {"claimed_order": 2, "real_order": 1, "size": 1e-3}
    kinds = {each.kind for each in _record(monkeypatch, **flaw).findings if each.status == "fail"}
    entry = Known("fake", ("1",), ("Plain",), dict.fromkeys(kinds, 1.0), "documented", "measured")
    monkeypatch.setattr(cell, "defects", lambda *_: (entry,))
    assert _record(monkeypatch, **flaw).outcome == "known"
    assert _record(monkeypatch, "position=1e-12", **flaw).outcome == "fail"
