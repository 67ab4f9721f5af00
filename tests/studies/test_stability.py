"""The largest usable steps: read off made-up ladders, from real ones by the command, and after a kill."""

import csv

import pytest
from typer.testing import CliRunner

from crosscheck.cli.app import app
from crosscheck.errors import ArgumentError
from crosscheck.studies import stability, study
from crosscheck.studies.stability import Stability, StabilityAsk, lines
from crosscheck.studies.study import conduct
from crosscheck.verification import advice
from crosscheck.verification.ladder import Ladder, Rung


def ladder(**errors):
    """A ladder at steps .4, .2, .1, ... s; None: the run failed."""
    rungs = [Rung("engine", method, 0.4 / 2**place, scene="scene", label=f"engine {method}", order=2, error=error,
                  wall_ms=10.0, reason="" if error else "it diverged")
             for method, own in errors.items() for place, error in enumerate(own)]
    return Ladder(scene="scene", engine="engine", until=1.0, interval=0.2, rungs={str(place): each for place, each in
                                                                     enumerate(rungs)})


@pytest.mark.parametrize(("errors", "step", "breaks_at", "reason"), [
    ([0.05, 0.01], 0.4, None, ""),
    ([None, 0.5, 0.09, 0.02], 0.1, 0.2, "an error of 0.5 of the size"),
    ([0.5, None, 0.09], 0.1, 0.2, "it diverged"),
    ([0.05, None, 0.09], 0.1, 0.2, "it diverged"),  # a coarse run that is right by chance does not count
    ([0.5, 0.2], None, 0.2, "an error of 0.2 of the size")])
def test_no_run_finer_than_the_largest_usable_step_is_useless(errors, step, breaks_at, reason):
    line, other = lines(ladder(one=errors, other=[0.01]))
    assert (line.step, line.breaks_at, line.reason) == (step, breaks_at, reason)
    assert line.error == (None if step is None else 0.09 if step == 0.1 else 0.05)
    assert (other.method, other.step, other.milliseconds) == ("other", 0.4, 10.0)


def walked(monkeypatch, seen):
    """Ladders are climbed in this process, for a second."""
    monkeypatch.setattr(advice, "BUDGET", 1.0)

    def here(function, tasks, jobs, done, limits):
        for place, task in enumerate(tasks):
            seen.append(task)
            done(place, function(task))

    monkeypatch.setattr(stability, "run_tasks", here)


def test_the_command_and_its_page(tmp_path, monkeypatch):
    walked(monkeypatch, [])
    done = CliRunner().invoke(app, ["study", "stability", "single_pendulum", "--engine", "mujoco",
                                    "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader((tmp_path / "stability.csv").open()))
    found = {row["method"]: row for row in rows}
    assert float(found["Euler"]["step"] or 0) < float(found["RK4"]["step"])  # of order 1 and 4
    assert "mujoco RK4" in (tmp_path / "index.html").read_text()


def test_a_killed_study_goes_on_where_it_was(tmp_path, monkeypatch):
    # an edit of the package between the two changes the code, so that the study starts afresh
    monkeypatch.setattr(study.provenance, "code_digest", lambda *_: 64 * "0")
    seen = []
    walked(monkeypatch, seen)
    request = StabilityAsk(("single_pendulum", "heavy_top"), ("lieeuler",))

    class Killed(BaseException):
        pass

    def progress(done, total, label):
        raise Killed

    with pytest.raises(Killed):
        conduct(Stability(), request, tmp_path, progress)
    document = conduct(Stability(), request, tmp_path, lambda *_: None)
    assert seen == [("single_pendulum", "lieeuler", None), ("heavy_top", "lieeuler", None)]
    assert {line.scene for line in document.lines} == {"single_pendulum", "heavy_top"}


def test_folders_of_other_things_are_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(ArgumentError, match="something else"):
        conduct(Stability(), StabilityAsk(("single_pendulum",)), tmp_path, lambda *_: None)
