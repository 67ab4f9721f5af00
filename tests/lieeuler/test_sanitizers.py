"""Every family of steppers under AddressSanitizer and UndefinedBehaviorSanitizer, without Python."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

import lieeuler
from tests import ROOT

METHODS = (*lieeuler.EULER_METHODS, "INDEX1_LE", "BAUMGARTE_LE", "generalized_alpha", "rattle4", "rkmk_fixed",
           "rkmk_adaptive", "seulex", "taylor")
pytestmark = pytest.mark.slow  # the program takes a minute of a core to compile

WATCHED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O0")


@pytest.fixture(scope="session")
def watched_driver(tmp_path_factory):
    """The kernel's headers compiled into a program that ends at the first fault; Eigen's assertions are on."""
    import cmeel  # its prefix holds the Eigen headers the kernel is built with

    compiler = os.environ.get("CXX") or shutil.which("c++")
    folder = tmp_path_factory.mktemp("sanitized")
    probe = folder / "probe.cpp"
    probe.write_text("int main() { return 0; }\n")
    if subprocess.run([compiler, *WATCHED, probe, "-o", folder / "probe"], capture_output=True).returncode:
        pytest.skip(f"{compiler} has no sanitizers")
    eigen = Path(cmeel.__file__).parents[1] / "cmeel.prefix" / "include" / "eigen3"
    source = ROOT / "tests" / "core" / "watched_driver.cpp"
    program = folder / "watched_driver"
    subprocess.run([compiler, "-std=c++20", *WATCHED, "-I", eigen, "-I", ROOT / "lieeuler" / "_core", source,
                    "-o", program], check=True)
    return program


def run(program, *arguments):
    """The output of the program, if it finds no fault."""
    done = subprocess.run([program, *arguments], capture_output=True, text=True,
                          env={**os.environ, "ASAN_OPTIONS": "detect_leaks=1"})
    assert "runtime error" not in done.stderr, done.stderr
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("system", ["1", "2", "20", "parallelogram", "stiff_parallelogram", "sprung"])
def test_no_fault_in_a_run(watched_driver, system, method):
    assert run(watched_driver, system, method).startswith("status 0 ")


@pytest.mark.parametrize("step", ["1e-3", "1e-2"])
@pytest.mark.parametrize("method", METHODS[:11])
def test_no_fault_where_rows_depend_on_others_only_with_joints_closed(watched_driver, method, step):
    status = run(watched_driver, "bricard", method, step).split()[1]
    assert status != "2", "singular_matrix"


@pytest.mark.parametrize(("system", "method"), [("tree", "rkmk_joints_adaptive"), ("tree", "rkmk_joints_fixed"),
                                                ("pins", "turning")])
def test_no_fault_where_constraints_are_left_out(watched_driver, system, method):
    assert run(watched_driver, system, method).startswith("status 0 ")
    # The same motion, to the tolerance, with them.
    whole = run(watched_driver, system, "rkmk_fixed" if method.endswith("fixed") else "rkmk_adaptive")
    assert float(run(watched_driver, system, method).split()[-1]) == pytest.approx(float(whole.split()[-1]), abs=1e-4)


@pytest.mark.parametrize("method", [*lieeuler.EULER_METHODS, "INDEX1_LE", "BAUMGARTE_LE", "rattle4", "rkmk_fixed"])
def test_no_fault_where_the_first_step_fails(watched_driver, method):
    """Newton's iteration tries again from the start of the run: there is no step before to guess from."""
    status = run(watched_driver, "2", method, "1e3").split()[1]
    assert status in {"1", "2", "3", "4"}, status  # newton_failed, singular_matrix, map_domain, non_finite
