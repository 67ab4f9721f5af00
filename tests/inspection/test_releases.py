"""Scripts that show an engine's error without this project, and the search for the release that changed an answer."""

import re
import subprocess
import sys

import numpy as np
import pytest

import crosscheck
from crosscheck.compare.errors import differences
from crosscheck.errors import EngineError
from crosscheck.inspection import bisect as releases
from crosscheck.inspection.reproduce import Reproduction, reproduce
from tests import saved
from tests.scene.models.model_files import ARM_URDF

ALIKE = 1e-3  # relative; both are errors of one method at one step, from starts that differ by rounding


def printed(script, tmp_path):
    """The errors over their sizes that a script prints, in an interpreter that cannot import this project."""
    path = saved(tmp_path / "script.py", script.text)
    barred = "import sys; sys.modules['crosscheck'] = sys.modules['lieeuler'] = None; "
    code = f"{barred}import runpy; sys.argv = ['x']; runpy.run_path({str(path)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return [float(value) for value in re.findall(r"error (\S+) of its size", done.stdout)], done.stdout


@pytest.mark.parametrize(("scene", "method", "step"), [
    ("heavy_top", "RK4", 1e-3), ("double_pendulum", "Euler", 1e-2), ("geared_arm", "implicit", 1e-2),
    ("cylindrical_pendulum", "RK4", 1e-2)])
def test_the_script_prints_the_error_of_the_run(scene, method, step, tmp_path):
    script = reproduce(scene, "mujoco", method, step, duration=0.5)
    errors, text = printed(script, tmp_path)
    assert len(errors) == 4
    traj = crosscheck.run(script.scene, "mujoco", method, step=step, samples=len(script.expected))
    true = crosscheck.truth(script.scene.replace(samples=len(script.expected))).states
    gap = max(float(each.max()) / script.sizes[name] for name, each in differences(traj, true).items())
    assert errors[0] == pytest.approx(gap, rel=ALIKE, abs=1e-12)
    assert "order" in text


def test_a_model_file_is_read_by_the_engine_itself(tmp_path):
    path = saved(tmp_path / "arm.urdf", ARM_URDF)
    script = reproduce(path, "mujoco", "RK4", 1e-3, duration=0.5)
    assert '<joint name="elbow" type="continuous">' in script.text
    assert printed(script, tmp_path)[0][0] < 1e-6


def test_what_a_script_leaves_out_of_a_model_stands_in_it(tmp_path):
    rubbing = ARM_URDF.replace('<dynamics damping="0.5"/>', '<dynamics damping="0.5" friction="0.3"/>')
    script = reproduce(saved(tmp_path / "arm.urdf", rubbing), "mujoco", "RK4", 1e-3, duration=0.5)
    assert script.left_out[0].startswith("dry friction of joint 'shoulder': 0.3")
    assert "Without dry friction of joint 'shoulder': 0.3" in script.text.partition("import sys")[0]


@pytest.mark.parametrize(("scene", "arguments", "words"), [
    ("heavy_top", ("pinocchio", "RKMK4", 1e-3), "scripts are written for mujoco"),
    ("heavy_top", ("mujoco", "RK5", 1e-3), "did you mean 'RK4'"), ("heavy_top", ("mujoco", "RK4", 0.0), "above 0"),
    ("driven_cart", ("mujoco", "RK4", 1e-3), "no function of time"),
    ("four_bar", ("mujoco", "RK4", 1e-3), "closes a loop")])
def test_what_no_script_can_hold_is_refused(scene, arguments, words):
    with pytest.raises(crosscheck.CrosscheckError, match=words):
        reproduce(scene, *arguments)


LISTED = [f"3.{minor}.{patch}" for minor in range(3) for patch in range(8)]


@pytest.mark.parametrize(("changed", "broken"), [
    ([], []), (["3.1.2"], []), (["3.0.2", "3.2.0"], []),
    (["3.0.1"], ["3.1.0"]), (["3.1.0", "3.2.1"], []), (["3.2.3"], ["3.2.2", "3.2.1"])])
def test_every_change_is_found_between_its_neighbours(changed, broken, monkeypatch):
    order = sorted(LISTED)

    def run(script, engine, version):
        if version in broken:
            raise EngineError(f"{version} has no wheel")
        steps = sum(order.index(version) >= order.index(each) for each in changed)
        states = np.full((2, 3), float(steps) + 1e-13 * order.index(version))
        return releases.Release(version, states, states + 1e-13, 1.0, 0.25)

    monkeypatch.setattr(releases, "released", lambda engine, span: order)
    monkeypatch.setattr(releases, "_run", run)
    script = Reproduction("text", None, "title", "truth", 1e-3, np.zeros((2, 1, 18)), {})
    result = releases.bisect(script, "mujoco", "3.0.0..3.2.7")
    assert [each.after.version for each in result.changes] == changed
    for change in result.changes:
        between = order[order.index(change.before.version) + 1:order.index(change.after.version)]
        assert set(between) <= set(broken)
        assert change.size == pytest.approx(1.0)
        assert change.after.order == pytest.approx(2.0)
    assert len(result.tried) < len(order)
    text = releases.issue(script, "mujoco", result)
    assert all(each in text for each in (*changed, "```python", "| version | error over its size |"))


def test_a_run_that_does_not_stay_finite_is_a_state_of_a_release():
    """Two that are lost at the same time are one answer; a change is told by its states and never as NaN."""
    def release(version, lost, nudged=None, error=np.inf):
        own, other = (np.arange(12.0).reshape(4, 3) for _ in range(2))
        own[lost:], other[lost if nudged is None else nudged:] = np.nan, np.nan
        return releases.Release(version, own, other, error, error / 4)

    late, early, whole = release("1", 3), release("2", 1), release("3", 4, error=1e-3)
    assert (releases.Change(late, late).size, releases.Change(late, late).ends) == (0.0, False)
    for change in (releases.Change(late, early), releases.Change(early, whole)):
        assert (change.size, change.ends) == (0.0, True)
    assert str(releases.Change(early, whole)) == (
        "3 changed the answer of 2: its numbers do not stay finite; then error 0.001 of its size, order 2.00")
    assert not releases.Change(late, release("4", 2, nudged=4)).ends  # rounding decides when it ends


def test_a_broken_end_and_a_wrong_span_are_one_line(monkeypatch):
    monkeypatch.setattr(releases.versions, "environment", lambda *given: sys.executable)
    script = Reproduction("raise ValueError('no such model')", None, "t", "s", 1e-3, np.zeros((2, 1, 18)), {})
    monkeypatch.setattr(releases, "released", lambda engine, span: ["3.0.0", "4.0.0"])
    with pytest.raises(EngineError, match="does not run the script: ValueError: no such model; take another end"):
        releases.bisect(script, "mujoco", "3.0.0..4.0.0")
    monkeypatch.undo()
    for span, words in (("3.0.0", "write the first and the last"), ("4.0.0..3.0.0", "not older"),
                        ("3.x..4.0.0", "is no version")):
        with pytest.raises(crosscheck.ArgumentError, match=words):
            releases.released("mujoco", span)


def test_the_commands_write_the_script_and_the_text_to_file(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from crosscheck.cli.app import app

    told = CliRunner().invoke(app, ["run", "heavy_top", "--script", "--engine", "mujoco", "--method", "RK4", "--step",
                                    "1e-3", "--issue", str(tmp_path / "issue.md")])
    assert told.exit_code == 0, told.output
    assert "import mujoco" in told.output
    assert "```python" in (tmp_path / "issue.md").read_text()
    monkeypatch.setattr(releases.versions, "environment", lambda *given: sys.executable)
    monkeypatch.setattr(releases, "released", lambda engine, span: ["4.0.0", "4.0.1"])
    told = CliRunner().invoke(app, ["bisect", "heavy_top", "--versions", "4.0.0..4.0.1"])
    assert told.exit_code == 0, told.output
    assert "no release changed the answer beyond rounding" in told.output


def test_one_version_is_run_by_its_script(monkeypatch):
    monkeypatch.setattr(releases.versions, "environment", lambda *given: sys.executable)
    script = reproduce("heavy_top", "mujoco", "RK4", 1e-3)
    monkeypatch.setattr(releases, "released", lambda engine, span: ["4.0.0", "4.0.1"])
    result = releases.bisect(script, "mujoco", "4.0.0..4.0.1")
    assert result.changes == ()
    traj, true = crosscheck.run(script.scene, "mujoco", "RK4", step=1e-3), crosscheck.truth(script.scene).states
    assert result.tried[0].error == pytest.approx(
        max(float(each.max()) / script.sizes[name] for name, each in differences(traj, true).items()), rel=1e-2)
    assert result.tried[0].order == pytest.approx(4.0, abs=0.2)
