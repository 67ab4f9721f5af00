"""A step allocates no memory: a run of four times as many steps calls malloc as often."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest

import lieeuler
from tests import ROOT


@pytest.fixture(scope="module")
def counts(tmp_path_factory):
    """(allocations, steps) of a short run and of a long one, for each problem and method."""
    compiler = os.environ.get("CXX") or shutil.which("c++")
    library = tmp_path_factory.mktemp("count") / "count.so"
    subprocess.run([compiler, "-std=c++20", "-shared", "-fPIC", ROOT / "tests" / "core" / "count_allocations.cpp",
                    "-o", library], check=True)
    done = subprocess.run([sys.executable, "-m", "tests.lieeuler.count_allocations"], capture_output=True, text=True,
                          cwd=ROOT, env={**os.environ, "LD_PRELOAD": str(library)})
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="the allocator of glibc is watched")
def test_no_allocation_inside_a_step(counts):
    assert {key.split()[1] for key in counts} == set(lieeuler.METHODS)
    for key, ((short, few), (long, many)) in counts.items():
        assert many > few, key
        assert short > 20, key  # set-up and results do allocate, and the count shows it
        assert long == short, key
