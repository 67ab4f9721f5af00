"""The known defects: the runs that they concern, what they excuse, and what happens when one vanishes."""

import dataclasses

import pytest

from crosscheck import adapters
from crosscheck.adapters import built_in
from crosscheck.adapters.common import known
from crosscheck.document import Finding, Plan, Record, Way
from crosscheck.document.known import Known
from crosscheck.document.outcomes import KINDS
from crosscheck.judge.verdict import with_outcome
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests import SCENARIOS

NAIVE = "a ball whose axis of rotation moves"


def about(engine, method, scene, form="tree", version="4.1"):
    """The entries about a run; the environment of the engine is not needed."""
    run = Record(scene=scene, engine=engine, version=version, method=method, form=form, step=1e-3, documented_order=4)
    return known.defects(built_in.ENTRIES[engine.partition("==")[0]].make(), run)


@pytest.mark.parametrize("entry", known.table(), ids=lambda entry: f"{entry.engine} {entry.methods[0]} {entry.where}")
def test_every_entry_says_what_it_is_about(entry):
    assert entry.engine in built_in.ENTRIES
    assert entry.where in ("", *known.WHERE)
    assert entry.rows
    assert all(kind.partition(" ")[0] in KINDS and 0 <= most < 1e3 for kind, most in entry.rows.items())
    assert min(map(len, (entry.reason, entry.evidence))) > 5
    assert entry.versions
    assert entry.methods


@pytest.mark.parametrize("scene", ["single_pendulum", "heavy_top", "chain_8", str(SCENARIOS / "double_pendulum.toml")])
def test_naive_rk4_is_known_wherever_a_ball_joint_turns(scene):
    assert about("pinocchio", "RK4naive", scene)
    assert not about("pinocchio", "RKMK4", scene)


@pytest.mark.parametrize("scene", ["hinge_pendulum", "universal_pendulum", "slider_crank", "no_such_scene"])
def test_naive_rk4_is_not_excused_where_no_joint_turns_on_so3(scene):
    assert not about("pinocchio", "RK4naive", scene)


def test_naive_rk4_need_not_show_where_a_body_may_keep_its_axis():
    """Free bodies and those on a distance joint count as on a ball; bodies that stay in a plane turn about one axis."""
    for scene, form, sure in (("puck_on_plane", "tree", True), ("rod_pendulum", "tree", True),
                              ("iftomm_simple_pendulum", "tree", False), ("four_bar", "maximal", False),
                              ("double_four_bar", "maximal", False), ("universal_pendulum", "maximal", True)):
        entry, = (each for each in about("pinocchio", "RK4naive", scene, form) if "order" in each.rows)
        assert (entry.always, entry.where == NAIVE) == (sure, sure), (scene, form)


def test_mujocos_rk4_is_known_to_be_naive_before_version_4():
    assert about("mujoco==3.3.7", "RK4", "single_pendulum", version="3.3.7")
    for scene, version in (("hinge_pendulum", "3.3.7"), ("single_pendulum", "4.0.0"), ("single_pendulum", "30.1"),
                           ("single_pendulum", "not installed")):
        assert not about("mujoco", "RK4", scene, version=version)


def test_newtons_rk4_is_known_to_be_naive_on_the_fast_top():
    assert about("newton", "MuJoCoRK4", "heavy_top", version="1.8.0")
    for method, scene, version, form in (("XPBD", "heavy_top", "1.8.0", "maximal"),
                                         ("MuJoCoRK4", "hinge_pendulum", "1.8.0", "tree"),
                                         ("MuJoCoRK4", "heavy_top", "1.9.0", "tree")):
        assert not any("order" in each.rows for each in about("newton", method, scene, form, version))


@pytest.mark.parametrize(("scene", "lack", "outcome"), [
    ("single_pendulum", 2.0, "known"), ("hinge_pendulum", 2.0, "fail"), ("hinge_pendulum", 0.0, "pass"),
    ("single_pendulum", 0.0, "fail"), ("single_pendulum", 3.3, "fail")])
def test_naive_rk4_shows_as_known_and_fails_once_it_is_fourth_order(scene, lack, outcome):
    run = Record(scene=scene, engine="pinocchio", version="4.1", method="RK4naive", form="tree", step=1e-3,
                   documented_order=4, share=1.0)
    found = with_outcome(run, [Finding("order", "fail" if lack > 0.5 else "ok", lack, 0.5, "1", "")],
                   about("pinocchio", "RK4naive", scene))
    assert found.outcome == outcome
    assert (found.findings[-1].kind == "asked vanished") == (lack == 0.0 and outcome == "fail")


def test_a_defect_of_another_engine_version_form_scene_or_method_is_not_excused(monkeypatch):
    entry = Known("pinocchio", ("4",), ("RKMK4",), {"limit velocity": 0.1}, "why", "how", ("maximal",),
                  ("light_heavy",))
    monkeypatch.setattr(known, "table", lambda: (entry,))
    given = {"engine": "pinocchio", "method": "RKMK4", "scene": "light_heavy", "form": "maximal", "version": "4.1"}
    assert about(**given) == (entry,)
    for name, value in (("engine", "mujoco"), ("version", "5.0"), ("version", "41"), ("form", "tree"),
                        ("scene", "heavy_light"), ("method", "RKMK2")):
        assert about(**given | {name: value}) == ()


@pytest.mark.parametrize(("gravity", "inertia", "outcome"), [
    (1.0, 1.0, "known"), (1.00001, 1.0, "fail"), (1.0, 1.0001, "fail")])
def test_a_known_defect_hides_no_wrong_model(monkeypatch, gravity, inertia, outcome):
    """Joint velocities are summed as ever; the errors of the model are of the size that this excuses."""
    pinocchio = adapters.get("pinocchio")

    class Wrong:
        def __getattr__(self, name):
            return getattr(pinocchio, name)

        def run(self, scene, spec):
            bodies = tuple(dataclasses.replace(body, inertia=inertia * body.inertia) for body in scene.bodies)
            return pinocchio.run(scene.replace(gravity=gravity * scene.gravity, bodies=bodies), spec)

    monkeypatch.setitem(adapters._LENT, "pinocchio", Wrong())
    plan = Plan({1: 1e-4, 2: 1e-3}, samples=51, duration=1.0)
    assert run_cell(Cell("single_pendulum", Way("pinocchio", "RK4naive"), plan)).outcome == outcome


def test_an_engine_of_the_user_excuses_nothing():
    """The table has engines of the library alone; an engine lent under another name is in none of its rows."""
    run = Record(scene="single_pendulum", engine="own", version="4", method="RK4naive", form="tree")
    assert known.defects(adapters.get("pinocchio"), run) == ()
