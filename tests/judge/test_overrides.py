"""Bounds set by the user: from a file, from options, in the verdict, and one clear error for wrong input."""

import pytest

from crosscheck.document import Finding, Plan, Way
from crosscheck.errors import ArgumentError
from crosscheck.judge import overrides, tolerances
from crosscheck.judge.overrides import BY_USER
from crosscheck.judge.plan import halved
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.fake_engine import FakeEngine, install

PLAN = Plan(0.5, {1: 1e-3}, {1: halved(4e-3)}, samples=26)


def test_every_constant_and_every_bound_has_its_reason():
    import tomllib

    content = tomllib.loads(tolerances.FILE.read_text(encoding="utf-8"))
    for entry in content["constant"].values():
        assert set(entry) == {"value", "why"}
        assert len(entry["why"]) > 20
    for entry in content["bound"].values():
        assert set(entry) == {"unit", "rule", "why"}
    assert tolerances.HELD["position"] == content["constant"]["held_position"]["value"]


def test_a_file_and_options_are_read_and_options_go_first(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text('position = 1e-3\n"level position" = 1e-6\n'
                    'energy = { value = 0.1, why = "the sensor is no better" }')
    found = {name: (value, why) for name, value, why in overrides.read(path, ["position=2e-3", "reset=1"])}
    assert found["position"] == (2e-3, BY_USER)
    assert found["level position"] == (1e-6, BY_USER)
    assert found["energy"] == (0.1, f"{BY_USER}: the sensor is no better")
    assert found["reset"] == (1.0, BY_USER)


def test_a_sensor_has_a_bound_by_its_name(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text('imu = 1e-3\n"sensor position" = 1e-6')
    own = overrides.read(path, ["hip=2.0"], ["imu", "hip", "position"])
    assert {name: value for name, value, _ in own} == {"sensor imu": 1e-3, "sensor position": 1e-6, "sensor hip": 2.0}
    with pytest.raises(ArgumentError, match="--tol imuu"):
        overrides.read(None, ["imuu=1.0"], ["imu"])
    findings = [Finding("sensor imu", "ok", 1e-5, 1e-4, "m", "", ""),
                Finding("sensor hip", "unresolved", 1.0, None, "N", "", "")]
    judged = overrides.override(findings, own, {"sensor imu": (2e-3, "t = 3 s")})
    assert [(each.status, each.value) for each in judged] == [("fail", 2e-3), ("ok", 1.0)]


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


def _record(monkeypatch, *options, **flaws):
    install(monkeypatch, FakeEngine(**flaws))
    return run_cell(Cell("single_pendulum", Way("fake", "Plain"), PLAN, overrides=overrides.read(None, options)))


def test_a_verdict_follows_the_users_bound_and_says_so(monkeypatch):
    assert _record(monkeypatch).outcome == "pass"
    strict = _record(monkeypatch, "position=1e-12")
    assert strict.outcome == "fail"
    (finding,) = (each for each in strict.findings if each.kind == "position")
    assert (finding.status, finding.bound, finding.why) == ("fail", 1e-12, BY_USER)
    assert strict.errors["position"].why == BY_USER


def test_a_generous_bound_lets_pass_what_the_documentation_does_not(monkeypatch):
    flaw = {"claimed_order": 2, "real_order": 1, "size": 1e-3}
    assert _record(monkeypatch, **flaw).outcome == "fail"
    kind = ["position", "attitude", "velocity", "angular velocity"]
    orders = [f"order {name}=0.9" for name in (*kind, "intervals")]
    rest = [f"{name}=1" for name in (*kind, "energy", "momentum")]
    assert _record(monkeypatch, *orders, *rest, **flaw).outcome == "pass"


def test_a_known_defect_neither_excuses_the_users_bound_nor_vanishes_by_it(monkeypatch):
    from crosscheck.document.known import STATE, Known

    orders = tuple(f"order {name}" for name in (*STATE, "intervals"))
    entry = Known(("1",), ("Plain",), ("single_pendulum",), None, dict.fromkeys(orders, 1.0), "documented")
    monkeypatch.setattr(FakeEngine, "known_defects", (entry,))
    flaw = {"claimed_order": 2, "real_order": 1, "size": 1e-6}
    assert _record(monkeypatch, **flaw).outcome == "known"
    assert _record(monkeypatch, "order position=1.5", **flaw).outcome == "fail"
    assert _record(monkeypatch, *(f"{name}=0.9" for name in orders), **flaw).outcome == "pass"
