"""`crosscheck study sweep`: what it says before and after."""

from typer.testing import CliRunner

from crosscheck.cli.app import app

SWEEP = """scenes = ["single_pendulum"]
steps = [1e-2]
samples = 2
duration = 0.1
[engines]
lieeuler = ["rattle2"]
[perturb]
attitude = 1e-3
count = {count}
"""


def said(*words):
    told = CliRunner().invoke(app, ["study", "sweep", "masses.toml", *words])
    assert told.exit_code == 0, told.output
    return " ".join(told.stdout.split())


def test_a_dry_run_counts_what_is_finished_already(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "masses.toml").write_text(SWEEP.format(count=2))
    assert said("--dry-run").startswith("2 cells, of which 0 finished and 2 to be computed")
    assert not (tmp_path / "reports").exists()
    assert "2 cells, 2 computed" in said("--workers", "1")
    (tmp_path / "masses.toml").write_text(SWEEP.format(count=3))
    assert said("--dry-run").startswith("3 cells, of which 2 finished and 1 to be computed")
    assert said("--dry-run", "-o", "elsewhere").startswith("3 cells, of which 2 finished")  # rows are of the user
