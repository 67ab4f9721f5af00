"""The command line: its output, and its answers to mistakes."""

import ast
import csv
import importlib.metadata
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from crosscheck.cli.app import app
from crosscheck.scene.file import load_scene
from tests import ROOT, saved
from tests.commands import crosscheck

QUICK = ("--profile", "smoke", "--scene", "single_pendulum", "--engine", "mujoco")


@pytest.fixture(scope="module")
def verified(tmp_path_factory):
    """A run of verify, and the same again as JSON."""
    out = tmp_path_factory.mktemp("verify") / "latest"
    return (subprocess.run([sys.executable, "-m", "crosscheck", "verify", *QUICK, "--out", str(out)], text=True,
                           capture_output=True, timeout=120, env={**os.environ, "COLUMNS": "200"}),
            out, crosscheck("verify", *QUICK, "--json", "--out", str(out)))


def test_verify_folds_passes_to_a_line_and_says_where_the_report_is(verified):
    done, out, _ = verified
    assert done.returncode == 0, done.stdout + done.stderr
    first, second = done.stdout.splitlines()[:2]
    assert first.startswith("pass: All 5 runs pass (")
    assert second == "engines: mujoco 4.0.0"
    assert "✓ single_pendulum, mujoco: 5 runs behave as documented, least error" in done.stdout
    assert done.stdout.splitlines()[-1] == f"report: {out / 'index.html'}"
    assert "single_pendulum: Trust mujoco" in done.stdout
    assert (out / "index.html").is_file()


def test_verify_as_json(verified):
    *_, done = verified
    document = json.loads(done.stdout)
    assert document["exit_code"] == done.returncode == 0
    assert {record["outcome"] for record in document["records"]} == {"pass"}
    assert document["report"].endswith("index.html")


def test_list_names_scenes_engines_and_methods():
    done = crosscheck("list")
    assert done.returncode == 0
    for word in ("heavy_top", "triple_pendulum", "lieeuler", "DAE1H_LSE", "mujoco", "pinocchio", "exudyn", "RK67"):
        assert word in done.stdout


def test_run_writes_its_trajectory(tmp_path):
    target = tmp_path / "run.csv"
    done = crosscheck("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2", "--csv",
                      str(target), "--samples", "11")
    assert done.returncode == 0, done.stderr
    with open(target, newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 11
    assert float(rows[-1]["t [s]"]) == 10.0
    radius = [sum(float(row[f"pendulum x_{axis} [m]"]) ** 2 for axis in "xyz") for row in rows]
    # The centre of mass hangs one metre from the origin; MuJoCo's ball joint holds that to rounding.
    assert radius == pytest.approx([1.0] * 11, abs=1e-14)


def test_run_without_a_method_takes_the_fastest_in_house_one_and_names_those_of_other_engines():
    done = crosscheck("run", "single_pendulum", "--duration", "1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("pass: error against truth: position ")
    assert "\nlieeuler taylor (maximal): " in done.stdout
    assert "\npendulum: x(1 s) = (" in done.stdout
    refused = crosscheck("run", "single_pendulum", "--engine", "mujoco")
    assert refused.returncode == 2
    assert "mujoco has Euler" in refused.stderr


def test_run_prints_csv_alone_on_request():
    done = crosscheck("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2", "--csv", "-",
                      "--samples", "3")
    assert done.stdout.splitlines()[0].startswith("t [s],pendulum x_x [m]")
    assert len(done.stdout.splitlines()) == 4


def test_truth_tells_its_source_and_doubt():
    done = crosscheck("truth", "heavy_top")
    assert done.returncode == 0, done.stderr
    assert "Taylor series" in done.stdout
    assert "checked against: index-1 equations" in done.stdout
    assert "x(1 s) = (0.17334396409" in done.stdout  # known from another computation


def test_truth_is_printed_up_to_a_horizon_before_the_first_output(monkeypatch):
    from crosscheck import references

    original, asked = references.truth, []

    def chaotic(scene):
        asked.append(scene)
        if len(asked) == 1:
            raise references.Chaotic("it ends at 1.5 s", 1.5)
        return original(load_scene("heavy_top"))

    monkeypatch.setattr(references, "truth", chaotic)
    done = CliRunner().invoke(app, ["truth", "heavy_top"])
    assert done.exit_code == 0
    assert "it ends at 1.5 s. The following" in done.output
    assert 1.4 < asked[1].duration < 1.5


@pytest.mark.parametrize(("words", "message"), [
    (("run", "no_such_scene", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2"), "no_such_scene"),
    (("run", "single_pendulum", "--engine", "mojoco", "--method", "RK4", "--step", "1e-2"), "did you mean 'mujoco'"),
    (("run", "single_pendulum", "--engine", "mujoco", "--method", "RK5", "--step", "1e-2"), "RK4"),
    (("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4"), "step"),
    (("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "-1"), "step: a positive"),
    (("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2", "--set", "softnes=tight"),
     "did you mean 'softness'"),
    (("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2", "--set", "reduce=off"),
     "reduce: mujoco does not have this option; it has form, softness"),
    (("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2", "--set", "form=tree"),
     "commands in which it can be chosen, such as run, take --form"),
    (("run", "single_pendulum", "--set", "reduce"), "is not KEY=VALUE"),
    (("verify", "--engine", "mujoco", "--set", "reduce=off"), "allowed: softness"),
    (("verify", "--engine", "lieeuler", "--set", "reduce=of"), "did you mean 'off'"),
    (("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2", "--csv",
      "no/such/folder/run.csv"), "cannot be written"),
    (("verify", "--profile", "quick"), "default or smoke"),
    (("verify", "--engine", "bullet"), "bullet"),
    (("verify", "--scene", "no_such_scene"), "no_such_scene"),
    (("verify", "--jobs", "0"), "at least 1"),
    (("verify", "--engine", "mujoco", "--method", "RK5"), "did you mean 'RK4'"),
])
def test_a_mistake_gets_one_clear_line(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = crosscheck(*words)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_importing_the_package_is_light():
    heavy = ("numpy", "scipy", "mujoco", "pinocchio", "exudyn", "heyoka", "plotly", "pandas", "lieeuler")
    code = f"import sys, crosscheck, crosscheck.cli.app; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_public_names():
    import crosscheck as package

    assert set(package.__all__) >= {"load_scene", "run", "methods", "engines", "scenes", "truth", "assert_agree",
                                    "SceneError", "Unsupported", "EngineError", "ArgumentError", "Trajectory"}
    for name in package.__all__:
        assert callable(getattr(package, name))
    assert package.engines()[:4] == ("lieeuler", "mujoco", "pinocchio", "exudyn")  # then what else is installed
    assert "DAE1L_LSE" in package.methods("lieeuler")
    assert set(package.scenes()) >= {"single_pendulum", "double_pendulum", "heavy_top", "triple_pendulum"}
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # noqa: B018


def test_type_checkers_see_every_public_name_where_it_is():
    import crosscheck as package

    stub = ast.parse((ROOT / "crosscheck" / "__init__.pyi").read_text())
    seen = {each.asname or each.name: (node.module.removeprefix("crosscheck."), each.name)
            for node in stub.body if isinstance(node, ast.ImportFrom) for each in node.names}
    assert seen == package._HOMES
    listed, = (ast.literal_eval(node.value) for node in stub.body if isinstance(node, ast.Assign))
    assert listed == package.__all__


def files_below(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("holding", [{"thesis.tex": "years of work"},
                                     {"results.json": '{"meta": {"command": "make thesis"}}'},
                                     {"results.json": '{"meta": {"command": "crosscheck verify"}}', "mine.txt": "x"}])
def test_a_folder_that_is_no_report_is_never_replaced(tmp_path, holding):
    for name, text in holding.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    before = files_below(tmp_path)
    done = crosscheck("verify", *QUICK, "--out", str(tmp_path))
    assert done.returncode == 2
    assert "holds something else than a report" in done.stderr
    assert files_below(tmp_path) == before


def test_a_place_that_cannot_hold_a_report_is_refused_before_anything_runs(tmp_path):
    taken = saved(tmp_path / "taken", "a file")
    for out, message in ((taken, "a file is there"), (taken / "below", "cannot be written"),
                         (Path("/proc/nowhere/latest"), "cannot be written")):
        done = crosscheck("verify", *QUICK, "--out", str(out))
        assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1)
        assert message in done.stderr
    assert taken.read_text(encoding="utf-8") == "a file"


def test_an_older_report_is_replaced(verified):
    _, out, _ = verified
    from crosscheck import report as folder
    from crosscheck.errors import ArgumentError

    folder.check_out(out)
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(ArgumentError, match="something else"):
        folder.check_out(out)
    (out / "notes.txt").unlink()


def test_an_unforeseen_error_is_one_line_and_not_the_exit_code_of_a_verdict():
    code = ("from crosscheck.cli import app\nfrom crosscheck.running import run\n"
            "def broken(*a, **k): raise RuntimeError('two\\nlines')\n"
            "run.run = broken\napp.main()")
    words = ("run", "single_pendulum", "--engine", "mujoco", "--method", "RK4", "--step", "1e-2")
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 70
    assert done.stderr.startswith("crosscheck: internal error")
    assert "RuntimeError: two lines" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_an_engine_that_is_not_installed_is_listed_as_such(monkeypatch, capsys):
    from crosscheck.adapters import get
    from crosscheck.cli import engines
    from crosscheck.document import Way
    from crosscheck.running import provenance
    from crosscheck.verification.cell import run_cell
    from crosscheck.verification.plan import PENDING
    from crosscheck.verification.task import Cell

    def missing(self):
        raise importlib.metadata.PackageNotFoundError("mujoco")

    monkeypatch.setattr(type(get("mujoco")), "version", missing)
    engines.list_()
    assert "not installed" in next(line for line in capsys.readouterr().out.splitlines() if "mujoco" in line)
    assert provenance.describe(["mujoco"])["engines"] == {"mujoco": "not installed"}
    record = run_cell(Cell("single_pendulum", Way("mujoco", "RK4"), PENDING))
    assert (record.outcome, record.message) == ("unsupported", "not installed")


def running_in_session(session):
    """Processes of a session that still run; one that ended but is not yet collected by its parent does not."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, its_session = stat.read_text(encoding="utf-8").rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if its_session == str(session) and state != "Z":
            found.append(stat.parent.name)
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="tells running processes by /proc")
def test_an_interrupt_ends_the_workers_and_says_so(tmp_path):
    process = subprocess.Popen([sys.executable, "-m", "crosscheck", "verify", "--scene", "double_pendulum",
                                "--engine", "pinocchio", "--out", str(tmp_path / "out")], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    time.sleep(5)  # while it computes its cells, which takes a minute
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 130
    assert said.strip().splitlines()[-1] == "crosscheck: interrupted; the same command goes on from here"
    if (begun := tmp_path / "out" / "results.json").exists():  # the page fills as runs end, and says that some are left
        assert json.loads(begun.read_text("utf-8"))["meta"]["left"] > 0
    for _ in range(50):  # the workers were told to end before their parent did; give them a moment to do so
        left = running_in_session(process.pid)
        if not left:
            break
        time.sleep(0.1)
    assert left == []


def test_a_run_beyond_the_end_of_truth_says_up_to_where_its_error_is_known():
    done = crosscheck("run", "thrown_double", "--engine", "mujoco", "--method", "RK4", "--step", "0.02")
    assert "error against truth up to 10.1 s, where it ends: position" in done.stdout.splitlines()[0]


def test_a_folder_in_place_of_a_file_is_called_one(tmp_path):
    done = crosscheck("truth", str(tmp_path))
    assert (done.returncode, "it is a folder; name a scene or model file in it" in done.stderr) == (2, True)
