"""The known defects: the runs that they concern, and what happens when one vanishes."""

import dataclasses

import pytest
from msgspec.structs import replace

from crosscheck import adapters
from crosscheck.adapters.built_in import ENTRIES
from crosscheck.adapters.common.known import NAIVE, SUMMED
from crosscheck.adapters.foreign.own import completed
from crosscheck.adapters.pinocchio.known import LOST
from crosscheck.document import Finding, Plan, Record, Way
from crosscheck.document.known import ORDERS, Known
from crosscheck.judge import known
from crosscheck.judge.plan import halved
from crosscheck.judge.verdict import settle
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests import SCENARIOS


def about(engine, method, scene, form="tree", version="4.1"):
    """The entries about a run."""
    run = Record(scene=scene, engine=engine, version=version, method=method, form=form, step=1e-3, documented_order=4)
    return defects(run)


def defects(run):
    """The known defects of the run's engine that are about it; its environment is not needed."""
    return ENTRIES[run.engine.partition("==")[0]].make().defects(run)


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
        entry, = (each for each in about("pinocchio", "RK4naive", scene, form) if each.reason == NAIVE)
        assert entry.always == sure, (scene, form)


def test_mujocos_rk4_is_known_to_be_naive_before_version_4():
    assert about("mujoco==3.3.7", "RK4", "single_pendulum", version="3.3.7")
    for scene, version in (("hinge_pendulum", "3.3.7"), ("single_pendulum", "4.0.0"), ("single_pendulum", "30.1"),
                           ("single_pendulum", "not installed")):
        assert not about("mujoco", "RK4", scene, version=version)


def test_newtons_rk4_is_known_to_be_naive_on_the_fast_top():
    assert about("newton", "MuJoCoRK4", "heavy_top", version="1.8.0")
    for method, scene, version in (("XPBD", "heavy_top", "1.8.0"), ("MuJoCoRK4", "hinge_pendulum", "1.8.0"),
                                   ("MuJoCoRK4", "heavy_top", "1.9.0")):
        entries = about("newton", method, scene, form="maximal" if method == "XPBD" else "tree", version=version)
        assert NAIVE not in [entry.reason for entry in entries]


def _settled(scene, observed):
    run = Record(scene=scene, engine="pinocchio", version="4.1", method="RK4naive", form="tree", step=1e-3,
                   documented_order=4)
    findings = [Finding(kind, "ok", 1e-6, 1e-5, "", "") for kind in SUMMED if kind not in ORDERS]
    findings += [Finding(kind, "ok" if observed > 3.85 else "fail", observed, 3.85, "1", "")
                 for kind in ORDERS]
    return settle(run, findings, defects(run))


KNOWN = [(name, entry) for name in ENTRIES for entry in ENTRIES[name].make().known_defects]
SIZES = [(name, entry, kind, most) for name, entry in KNOWN for kind, most in entry.kinds.items() if kind != "run"]


@pytest.mark.parametrize(("entry", "kind", "most"), [each[1:] for each in SIZES], ids=[
    f"{name}-{entry.methods[0]}-{kind}" for name, entry, kind, _ in SIZES])
def test_a_known_defect_excuses_the_size_that_was_measured_and_nothing_far_beyond(entry, kind, most):
    documented = most - 1.0 if entry.rising else 3.85

    def excused(size):
        value = documented - size if kind.startswith("order") else size * 1e-6
        bound = documented if kind.startswith("order") else 1e-6
        return known.excuses(entry, Finding(kind, "fail", value, bound, "", ""))

    assert excused(most)
    assert not excused(most + 0.51 if kind.startswith("order") else 1.1 * entry.margin * most)
    assert not excused(float("inf"))
    assert not excused(float("nan"))


@pytest.mark.parametrize(("excess", "outcome"), [(0.9, "known"), (1.1, "fail")])
def test_a_run_beyond_the_cap_fails(excess, outcome):
    run = Record(scene="parallelogram", engine="pinocchio", version="4.1", method="RKMK8", form="tree", step=1e-2,
                   documented_order=8)
    beyond = excess * Known.margin * LOST["velocity"]
    findings = [Finding("velocity", "fail", beyond * 1e-6, 1e-6, "", ""), Finding("energy", "ok", 0.0, 1.0, "", "")]
    assert settle(run, findings, defects(run)).outcome == outcome


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
    plan = Plan(1.0, {1: 1e-4, 2: 1e-3}, {4: halved(2e-2)}, samples=51, duration=1.0)
    assert run_cell(Cell("single_pendulum", Way("pinocchio", "RK4naive"), plan, whole=False)).outcome == outcome


def test_a_defect_of_another_version_form_or_kind_is_not_excused():
    run = Record(scene="light_heavy", engine="pinocchio", version="4.1", method="RKMK4", form="maximal", step=1e-3,
                   documented_order=4)
    for changes, kind, outcome in (({}, "level acceleration", "known"),
                                   ({"version": "5.0"}, "level acceleration", "fail"),
                                   ({"form": "tree"}, "level acceleration", "fail"), ({}, "level velocity", "fail")):
        finding, changed = Finding(kind, "fail", 1.5e-6, 1e-6, "", ""), replace(run, **changes)
        assert settle(changed, [finding], defects(changed)).outcome == outcome


RISING = [entry for _, entry in KNOWN if entry.rising]


@pytest.mark.parametrize("entry", RISING, ids=[
    f"{entry.methods[0]}-{'everywhere' if callable(entry.scenes) else ','.join(entry.scenes)}" for entry in RISING])
def test_rounding_that_adds_up_excuses_neither_a_wrong_model_nor_a_lower_order(entry):
    """A wrong model leaves an error that no step changes, and a method of a lower order one that falls."""
    kinds = [kind for kind in entry.kinds if kind.startswith("order")]
    assert kinds
    for kind in kinds:
        found = {observed: known.excuses(entry, Finding(kind, "fail", observed, 0.9, "1", ""))
                 for observed in (-1.0, -0.1, 0.0, 0.1, 0.5, float("nan"))}
        assert [observed for observed, excused in found.items() if excused] == [-1.0]
    assert not known.excuses(entry, Finding("limit position", "fail", 1.1e-3, 1e-3, "m", ""))


@pytest.mark.parametrize(("factor", "outcome"), [(1.0, "known"), (1.9, "known"), (2.1, "fail"), (float("nan"), "fail")])
def test_errors_larger_than_those_of_rounding_alone_are_not_excused_by_it(factor, outcome):
    """A gravity wrong by 3 % is 6e-3 m on the fast top, and the orders are those of rounding as before."""
    run = Record(scene="heavy_top", engine="newton", version="1.8.0", method="SemiImplicit", form="maximal",
                   step=5e-6, documented_order=1)
    findings = [Finding("order attitude", "fail", -1.04, 0.9, "1", ""),
                Finding("position", "ok", 1.6e-4 * factor, 0.32, "m", "")]
    assert settle(run, findings, defects(run)).outcome == outcome


def test_naive_rk4_shows_as_known_and_fails_once_it_is_fourth_order():
    assert _settled("single_pendulum", 2.0).outcome == "known"
    assert _settled("hinge_pendulum", 2.0).outcome == "fail"
    assert _settled("hinge_pendulum", 4.0).outcome == "pass"
    mended = _settled("single_pendulum", 4.0)
    assert mended.outcome == "fail"
    assert mended.findings[-1].kind == "vanished"


def test_an_engine_of_the_user_excuses_nothing():
    """It would pass whatever it does by declaring that as a known defect."""
    entry = Known(("",), ("RKMK4",), None, None, {"position": 1e9}, "because")

    class Excused(type(adapters.get("pinocchio"))):
        known_defects = (entry,)

        def defects(self, run):
            return self.known_defects

    run = Record(scene="single_pendulum", engine="own", version="1", method="RKMK4", form=None)
    assert Excused().defects(run) == (entry,)
    assert completed(Excused(), "own", "1").defects(run) == ()
