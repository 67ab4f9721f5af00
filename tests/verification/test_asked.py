"""Map, step and duration: what runs takes them, the document keeps them, and the commands repeat them."""

import shlex

import pytest
from typer.testing import CliRunner

from crosscheck import adapters
from crosscheck.cli.app import app
from crosscheck.document import Asked, Way
from crosscheck.errors import ArgumentError
from crosscheck.history.nightly import Wanted
from crosscheck.studies.drift import DriftAsk, DriftStudy
from crosscheck.studies.stability import StabilityAsk
from crosscheck.studies.study import conduct
from crosscheck.studies.work_precision import WorkPrecisionAsk
from crosscheck.verification.cell import run_cell
from crosscheck.verification.job import check_options, labels
from crosscheck.verification.plan import Profile
from crosscheck.verification.scene_truth import prepare_truth
from crosscheck.verification.task import Cell

CCSK = (("coordinate_map", "ccsk"),)
ASKED = Asked(options=CCSK, step=2e-3, duration=0.4)


def record(method, engine="lieeuler", asked=ASKED):
    scene = prepare_truth(("single_pendulum", None, Profile.most_steps), asked)
    way = Way(engine, method).having(adapters.get(engine).takes(asked.options))
    return run_cell(Cell("single_pendulum", way, scene.plan)), scene


def test_a_run_takes_map_step_and_duration_and_its_command_repeats_them():
    run, scene = record("DAE1L_LSE")
    assert run.outcome == "pass"
    assert (run.coordinate_map, run.step, run.duration) == ("ccsk", 2e-3, 0.4)
    assert scene.duration == 0.4
    assert "--step 0.002 --set coordinate_map=ccsk --duration 0.4" in run.command
    assert labels([run]) == ["lieeuler DAE1L_LSE with ccsk"]
    assert run.order.observed == pytest.approx(1.0, abs=0.1)
    exp, _ = record("DAE1L_LSE", asked=Asked(step=2e-3, duration=0.4))
    assert exp.errors["position"].end != run.errors["position"].end
    assert exp.ladder[0].errors != run.ladder[0].errors


def test_methods_that_refuse_a_map_say_so_and_engines_without_maps_run():
    refused, _ = record("rattle4")
    assert refused.outcome == "unsupported"
    assert "ccsk" in refused.message
    other, _ = record("RK4", "mujoco")
    assert (other.outcome, other.coordinate_map) == ("pass", None)


def test_a_coarse_step_is_judged_by_where_finer_ones_go():
    run, _ = record("DAE1L_LSE", asked=Asked(step=0.1))
    assert (run.outcome, run.share) == ("pass", 1.0), run.message
    limit = next(finding for finding in run.findings if finding.kind == "limit position")
    assert limit.value <= limit.bound < 0.1 * run.errors["position"].max


def test_the_step_that_was_made_is_recorded():
    """7 ms do not divide the .4 s that were asked for."""
    run, scene = record("DAE1L_LSE", asked=Asked(step=7e-3, duration=0.4))
    made = 0.4 / (scene.plan.samples - 1)
    assert run.step == pytest.approx(made)
    assert run.steps == scene.plan.samples - 1


def test_a_night_that_asks_for_more_is_told_apart():
    assert shlex.split(Wanted(asked=ASKED).command)[-6:] == [
        "--set", "coordinate_map=ccsk", "--step", "0.002", "--duration", "0.4"]
    assert Asked().words == []


@pytest.mark.parametrize(("study", "ask"), [
    ("drift", DriftAsk(("heavy_top",), methods=("DAE1L_LSE",), step=1e-3, options=CCSK)),
    ("stability", StabilityAsk(("single_pendulum",), jobs=1)),
    ("work-precision", WorkPrecisionAsk(bound=False, repeats=2, duration=0.5, options=(
        ("coordinate_map", "exp"), ("softness", "tight"), ("spin_free", True)))),
])
def test_the_command_of_a_study_asks_for_the_same(study, ask, monkeypatch):
    found = []
    monkeypatch.setattr("crosscheck.studies.study.conduct", lambda _, ask, *__: found.append(ask) or 1 / 0)
    CliRunner().invoke(app, shlex.split(ask.command(study))[1:])
    assert found == [ask]


def test_a_study_runs_under_the_map(tmp_path):
    """A method that works with none but its own map is left out."""
    ccsk, exp = ({run.method: run.energy_band for run in conduct(DriftStudy(), DriftAsk(
        ("single_pendulum",), ("lieeuler",), ("rattle4", "DAE1L_LSE"), step=0.01, steps=20, options=chart),
        tmp_path / str(len(chart)), lambda *_: None).runs} for chart in (CCSK, ()))
    assert set(ccsk) == {"DAE1L_LSE"} < set(exp)
    assert ccsk["DAE1L_LSE"] != exp["DAE1L_LSE"]


def test_a_wrong_map_names_the_right_one():
    done = CliRunner().invoke(app, ["study", "drift", "--set", "coordinate_map=cskk"])
    assert done.exit_code != 0
    assert "did you mean 'ccsk'" in str(done.exception)


def test_an_option_goes_to_the_engines_that_have_it_and_one_that_none_has_is_refused():
    """The softness of MuJoCo's constraints is no option of lieeuler, which runs as it is."""
    own = Asked(options=(("softness", "tight"),), step=2e-3, duration=0.4)
    soft, _ = record("Euler", "mujoco", own)
    assert soft.options == (("softness", "tight"),)
    assert "--set softness=tight" in soft.command
    assert labels([soft]) == ["mujoco Euler with softness tight"]
    assert record("DAE1L_LSE", asked=own)[0].options == ()
    with pytest.raises(ArgumentError, match="did you mean 'softness'"):
        check_options([("softnes", "tight")], ["mujoco", "lieeuler"])
    with pytest.raises(ArgumentError, match="did you mean 'tight'"):
        check_options([("softness", "tigt")], ["mujoco", "lieeuler"])
    with pytest.raises(ArgumentError, match="softness"):
        check_options([("softness", "tight")], ["lieeuler"])
