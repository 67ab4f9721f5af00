"""The pytest plugin, run by pytest inside pytest."""

pytest_plugins = ["pytester"]


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
    # Other plugins that happen to be installed would load what they like.
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
