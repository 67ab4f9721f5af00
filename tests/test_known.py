"""The known defects: which runs they are about, and what happens when one vanishes."""

from pathlib import Path

import pytest

from crosscheck import known
from crosscheck.verdict import Finding, Record, settle

SCENARIOS = Path(__file__).parents[1] / "scenarios"


@pytest.mark.parametrize("scene", ["single_pendulum", "heavy_top", "chain_8", str(SCENARIOS / "double_pendulum.toml")])
def test_naive_rk4_is_known_wherever_a_ball_joint_turns(scene):
    assert known.entries("pinocchio", "RK4naive", scene, "tree")
    assert not known.entries("pinocchio", "RKMK4", scene, "tree")


@pytest.mark.parametrize("scene", ["hinge_pendulum", "no_such_scene"])
def test_naive_rk4_is_not_excused_elsewhere(scene):
    assert not known.entries("pinocchio", "RK4naive", scene, "tree")


def _settled(scene, observed):
    record = Record(scene, "pinocchio", "4.1", "RK4naive", "tree", 1e-3, None, 4, "")
    kinds = (*known.STATE, "energy", "momentum")
    record.findings = [Finding(kind, "ok", 1e-6, 1e-5, "", "") for kind in kinds]
    record.findings += [Finding(kind, "ok" if observed > 3.85 else "fail", observed, 3.85, "1", "")
                        for kind in known.ORDERS]
    return settle(record)


def test_naive_rk4_shows_as_known_and_fails_once_it_is_fourth_order():
    assert _settled("single_pendulum", 2.0).outcome == "known"
    assert _settled("hinge_pendulum", 2.0).outcome == "fail"
    assert _settled("hinge_pendulum", 4.0).outcome == "pass"
    mended = _settled("single_pendulum", 4.0)
    assert mended.outcome == "fail"
    assert mended.findings[-1].kind == "vanished"
