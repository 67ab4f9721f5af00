"""The known defects: the runs that they concern, and what happens when one vanishes."""


import pytest

from crosscheck import adapters
from crosscheck.document import Finding, Measured
from crosscheck.judge import known
from crosscheck.judge.verdict import settle
from tests import SCENARIOS


@pytest.mark.parametrize("scene", ["single_pendulum", "heavy_top", "chain_8", str(SCENARIOS / "double_pendulum.toml")])
def test_naive_rk4_is_known_wherever_a_ball_joint_turns(scene):
    assert known.entries("pinocchio", "RK4naive", scene, "tree", adapters.turning)
    assert not known.entries("pinocchio", "RKMK4", scene, "tree", adapters.turning)


@pytest.mark.parametrize("scene", ["hinge_pendulum", "universal_pendulum", "slider_crank", "no_such_scene"])
def test_naive_rk4_is_not_excused_where_no_joint_turns_on_so3(scene):
    assert not known.entries("pinocchio", "RK4naive", scene, "tree", adapters.turning)


def test_naive_rk4_need_not_show_where_a_body_may_keep_its_axis():
    """Free bodies and those on a distance joint count as on a ball; bodies that stay in a plane turn about one axis."""
    for scene, form, sure in (("puck_on_plane", "tree", True), ("rod_pendulum", "tree", True),
                              ("iftomm_simple_pendulum", "tree", False), ("four_bar", "maximal", False),
                              ("double_four_bar", "maximal", False), ("universal_pendulum", "maximal", True)):
        entry, = (each for each in known.entries("pinocchio", "RK4naive", scene, form, adapters.turning)
                  if each.reason == known.NAIVE)
        assert entry.always == sure, (scene, form)


def test_mujocos_rk4_is_known_to_be_naive_before_version_4():
    assert known.entries("mujoco==3.3.7", "RK4", "single_pendulum", "tree", adapters.turning)
    for engine, scene in (("mujoco==3.3.7", "hinge_pendulum"), ("mujoco==4.0.0", "single_pendulum"),
                          ("mujoco", "single_pendulum"), ("mujoco==30.1", "single_pendulum")):
        assert not known.entries(engine, "RK4", scene, "tree", adapters.turning)


def _settled(scene, observed):
    run = Measured(scene=scene, engine="pinocchio", version="4.1", method="RK4naive", form="tree", step=1e-3,
                   documented_order=4)
    kinds = (*known.STATE, *known.INTERVALS, "energy", "momentum")
    findings = [Finding(kind, "ok", 1e-6, 1e-5, "", "") for kind in kinds]
    findings += [Finding(kind, "ok" if observed > 3.85 else "fail", observed, 3.85, "1", "")
                 for kind in known.ORDERS]
    return settle(run, findings, adapters.turning)


@pytest.mark.parametrize(("engine", "method", "scene", "form"), [
    ("exudyn", "RK44", "thrown_double", "tree"), ("pinocchio", "RKMK4", "double_four_bar", "tree"),
    ("exudyn", "GeneralizedAlpha", "chain_64", "tree")])
def test_a_known_defect_excuses_only_its_size(engine, method, scene, form):
    run = Measured(scene=scene, engine=engine, version="1", method=method, form=form, step=1e-3, documented_order=4)
    for excess, outcome in ((1e3, "known"), (1e9, "fail")):
        findings = [Finding(kind, "fail", excess * 1e-6, 1e-6, "", "") for kind in known.STATE]
        assert settle(run, findings, adapters.turning).outcome == outcome


def test_naive_rk4_shows_as_known_and_fails_once_it_is_fourth_order():
    assert _settled("single_pendulum", 2.0).outcome == "known"
    assert _settled("hinge_pendulum", 2.0).outcome == "fail"
    assert _settled("hinge_pendulum", 4.0).outcome == "pass"
    mended = _settled("single_pendulum", 4.0)
    assert mended.outcome == "fail"
    assert mended.findings[-1].kind == "vanished"
