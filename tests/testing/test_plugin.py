"""The pytest plugin, run by pytest inside pytest."""

import crosscheck
from tests import ROOT

pytest_plugins = ["pytester"]

EXAMPLE = ROOT / "examples" / "my_engine.py"


def test_each_engine_run_and_truth_happens_once_a_session(pytester):
    pytester.makepyfile(
        test_one="""
        def test_first(crosscheck_run, crosscheck_truth):
            from crosscheck import load_scene
            traj = crosscheck_run("single_pendulum", "mujoco", "RK4", step=1e-2)
            crosscheck_run.first = traj
            assert crosscheck_run(load_scene("single_pendulum"), "mujoco", "RK4", step=1e-2) is traj
            assert crosscheck_run("single_pendulum", "mujoco", "RK4", step=2e-2) is not traj
            assert crosscheck_run("single_pendulum", "mujoco", "Euler", step=1e-2) is not traj
            crosscheck_truth.first = crosscheck_truth("single_pendulum")
        """,
        test_two="""
        import pytest

        def test_second(crosscheck_run, crosscheck_truth):
            assert crosscheck_run("single_pendulum", "mujoco", "RK4", step=1e-2) is crosscheck_run.first
            assert crosscheck_truth("single_pendulum") is crosscheck_truth.first

        def test_shared_arrays_cannot_be_spoilt(crosscheck_run, crosscheck_truth):
            with pytest.raises(ValueError, match="read-only"):
                crosscheck_run("single_pendulum", "mujoco", "RK4", step=1e-2).x[0] = 0.0
            with pytest.raises(ValueError, match="read-only"):
                crosscheck_truth("single_pendulum").states.x[0] = 0.0
        """)
    pytester.runpytest_subprocess("-p", "no:cacheprovider").assert_outcomes(passed=3)


def test_the_plugin_costs_a_test_session_nothing(pytester):
    pytester.makepyfile("""
        import sys

        def test_light():
            assert not {"mujoco", "pinocchio", "exudyn", "heyoka", "lieeuler", "scipy"} & set(sys.modules)
        """)
    # Other installed plugins could load anything.
    pytester.runpytest_subprocess("-p", "no:hypothesispytest", "-p", "no:benchmark").assert_outcomes(passed=1)


def test_a_failed_run_is_tried_again(pytester):
    pytester.makepyfile("""
        import pytest
        import crosscheck

        @pytest.mark.parametrize("attempt", [1, 2])
        def test_refused(crosscheck_run, crosscheck_truth, attempt):
            with pytest.raises(crosscheck.ArgumentError, match="step"):
                crosscheck_run("single_pendulum", "mujoco", "RK4")
            with pytest.raises(crosscheck.ArgumentError, match="^engine: .*not list"):
                crosscheck_run("single_pendulum", ["mujoco"], "RK4")
            with pytest.raises(crosscheck.ArgumentError, match="^scene: .*not int"):
                crosscheck_truth(3)
        """)
    pytester.runpytest_subprocess().assert_outcomes(passed=2)


MARKED = """
import pytest

@pytest.mark.crosscheck(scene="single_pendulum", step=2e-3, duration=0.5, samples=6)
def test_close(crosscheck_run, crosscheck_truth, crosscheck_check):
    traj = crosscheck_run()
    assert traj.t[-1] == 0.5
    assert crosscheck_truth().t.tolist() == traj.t.tolist()
    assert crosscheck_truth(traj) is crosscheck_truth()
    crosscheck_check(traj)
"""


def test_a_marked_test_runs_once_per_engine_that_was_asked_for(pytester):
    pytester.makepyfile(test_marked=MARKED, mine=EXAMPLE.read_text(encoding="utf-8"))
    result = pytester.runpytest_subprocess("-v", "--crosscheck-engine", "mujoco", "--crosscheck-engine",
                                           "mine.py:PivotRK4")
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(["*test_close[[]mujoco[]] PASSED*", "*test_close[[]mine.py:PivotRK4[]] PASSED*"])


def test_without_the_option_it_runs_for_every_engine(pytester):
    pytester.makepyfile(MARKED)
    result = pytester.runpytest_subprocess("--collect-only")
    from crosscheck import adapters

    result.stdout.fnmatch_lines([f"*test_close[[]{name}[]]*" for name in adapters.names()])


def test_an_engine_that_is_not_installed_skips_a_test_that_leaves_it_open(pytester):
    pytester.makepyfile(MARKED)
    pytester.makeconftest('import sys; sys.modules["pinocchio"] = None')
    result = pytester.runpytest_subprocess("-rs", "-k", "pinocchio")
    result.assert_outcomes(skipped=1, deselected=len(crosscheck.engines()) - 1)
    result.stdout.fnmatch_lines(["*pinocchio cannot be imported*lieeuler-crosscheck[[]pinocchio[]]*"])
    asked = pytester.runpytest_subprocess("--crosscheck-engine", "pinocchio")
    asked.assert_outcomes(errors=1)


def test_a_failed_check_says_what_by_how_much_why_when_and_where(pytester):
    pytester.makepyfile("""
        import pytest

        @pytest.mark.crosscheck(scene="double_pendulum", engine="mujoco", method="RK4", step=1e-2, duration=1.0,
                                samples=11)
        def test_tight(crosscheck_run, crosscheck_check):
            crosscheck_check(crosscheck_run(), tol={"attitude": 1e-12})

        @pytest.mark.crosscheck(scene="single_pendulum", engine="mine.py:Heavier", method="RK4", step=1e-3,
                                duration=1.0)
        def test_documented_order(crosscheck_run, crosscheck_check):
            crosscheck_check(crosscheck_run())
        """, mine=f"""{EXAMPLE.read_text(encoding="utf-8")}

class Heavier(PivotRK4):
    def run(self, scene, spec):
        return super().run(scene.replace(gravity=scene.gravity * (1 + 1e-6)), spec)
""")
    result = pytester.runpytest_subprocess("--tb=short")
    result.assert_outcomes(failed=2)
    result.stdout.re_match_lines([
        r"E +AssertionError: fail: double_pendulum: mujoco RK4 \(.*\) and truth disagree in attitude by \S+ rad, "
        r"allowed 1e-12 rad \(given by the caller\); first beyond it at t = 0\.1 s, worst in body '\w+' at t = \S+ s",
        r"E +AssertionError: fail: single_pendulum: \S+ RK4 \(.*step=0.001\): \w+ .* \S+, allowed \S+ .*\(CC10[24]\)"])
    assert "agreement.py" not in result.stdout.str()  # the reader does not need the steps before it


def test_arguments_come_before_the_marker_and_what_is_missing_is_said(pytester):
    pytester.makepyfile("""
        import pytest
        import crosscheck

        @pytest.mark.crosscheck(scene="single_pendulum", engine="mujoco", method="RK4", step=1e-2, samples=6)
        def test_mixed(crosscheck_run):
            traj = crosscheck_run(method="Euler", step=5e-3, duration=0.5)
            assert (traj.method, traj.stats["step"], len(traj.t), traj.t[-1]) == ("Euler", 5e-3, 6, 0.5)
            other = crosscheck_run("heavy_top", engine="lieeuler", method="rattle2", duration=0.01, step=1e-4)
            assert (other.engine, other.t[-1], len(other.t)) == ("lieeuler", 0.01, 6)

        def test_words(crosscheck_run, crosscheck_truth, crosscheck_check):
            with pytest.raises(crosscheck.ArgumentError, match=r"^scene: name it as an argument, or with the marker"):
                crosscheck_truth()
            with pytest.raises(crosscheck.ArgumentError, match=r"^engine: a name or an object .* wanted, not NoneType"):
                crosscheck_run("single_pendulum", step=1e-2)
            with pytest.raises(crosscheck.ArgumentError, match=r"^crosscheck_check: a trajectory of crosscheck_run"):
                crosscheck_check(crosscheck.run("single_pendulum", "mujoco", "RK4", step=1e-2))
        """)
    pytester.runpytest_subprocess().assert_outcomes(passed=2)


def test_the_smoke_profile_shortens_what_is_left_open(pytester):
    pytester.makepyfile("""
        def test_short(crosscheck_run, crosscheck_truth):
            assert crosscheck_run("single_pendulum", "mujoco", "RK4", step=1e-2).t[-1] == 1.0
            assert crosscheck_truth("single_pendulum").t[-1] == 1.0
            assert crosscheck_run("single_pendulum", "mujoco", "RK4", step=1e-2, duration=2.0).t[-1] == 2.0
        """)
    pytester.runpytest_subprocess("--crosscheck-profile", "smoke").assert_outcomes(passed=1)
    result = pytester.runpytest_subprocess("--crosscheck-profile", "quick")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*ArgumentError: profile 'quick' is unknown*"])


def test_an_engine_that_cannot_run_an_open_test_skips_it(pytester):
    pytester.makepyfile("""
        import pytest

        @pytest.mark.crosscheck(scene="double_pendulum", step=1e-2, form="pivot")
        def test_open(crosscheck_run):
            crosscheck_run(method="RK44")

        @pytest.mark.crosscheck(scene="double_pendulum", engine="exudyn", step=1e-2, form="pivot")
        def test_named(crosscheck_run):
            crosscheck_run(method="RK44")

        def test_by_hand(crosscheck_run, crosscheck_engine):
            crosscheck_run("double_pendulum", crosscheck_engine, "RK44", step=1e-2, form="pivot")
        """)
    result = pytester.runpytest_subprocess("-rs", "--crosscheck-engine", "exudyn")
    result.assert_outcomes(skipped=2, failed=1)
    result.stdout.fnmatch_lines(["SKIPPED*unsupported: exudyn RK44 on scene*"])


OUTCOMES = """
import dataclasses
import numpy as np
import pytest
from crosscheck import load_scene

@pytest.mark.crosscheck(scene="single_pendulum", engine="pinocchio", method="RK4naive", step=1e-3, duration=1.0)
def test_known(crosscheck_run, crosscheck_check):
    crosscheck_check(crosscheck_run())

def test_beyond_truth(crosscheck_run, crosscheck_check):
    chaotic = load_scene("double_pendulum").replace(duration=25.0, samples=101)
    crosscheck_check(crosscheck_run(chaotic, "mujoco", "RK4", step=1e-3), tol=10.0)

def test_at_rest(crosscheck_run, crosscheck_check):
    hanging = load_scene("single_pendulum").replace(duration=1.0, samples=11)
    still = dataclasses.replace(hanging.bodies[0], velocity=np.zeros(3), angular_velocity=np.zeros(3))
    hanging = hanging.replace(gravity=np.zeros(3), bodies=(still,))
    crosscheck_check(crosscheck_run(hanging, "mujoco", "RK4", step=1e-2), tol=10.0)

def test_falls_over(crosscheck_run):
    crosscheck_run("single_pendulum", "falling.py:Falling", "RK4", step=1e-2)
"""


def test_tests_end_by_the_outcomes_of_every_command(pytester):
    pytester.makepyfile(test_outcomes=OUTCOMES, falling=f"""{EXAMPLE.read_text(encoding="utf-8")}

class Falling(PivotRK4):
    def run(self, scene, spec):
        raise RuntimeError("it fell over")
""")
    result = pytester.runpytest_subprocess("-v", "--tb=short", "--junitxml=told.xml")
    result.assert_outcomes(passed=1, failed=2, errors=1)
    result.stdout.fnmatch_lines([
        "*test_known known: *", "*test_falls_over ERROR*", "*ERROR at call of test_falls_over*",
        "*unresolved: double_pendulum: compared over * % of its 25 s, since truth ends there*",
        "*unresolved: single_pendulum: compared over 0 % of its 1 s, since nothing moves*"])
    assert 'name="crosscheck" value="known: ' in (pytester.path / "told.xml").read_text(encoding="utf-8")
    less = pytester.runpytest_subprocess("-v", "-k", "beyond_truth", "--crosscheck-need", "0.01")
    less.assert_outcomes(passed=1, deselected=3)
