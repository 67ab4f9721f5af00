"""Settings shared by all tests."""

import itertools
import os
import signal
import sys

import pytest
from hypothesis import settings

from tests.databases import postgresql_server, url  # noqa: F401 - fixtures
from tools.marks import Marks

# Matrices are so small that more threads take ten times as long. It counts only before NumPy is first imported.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Shared machines stall: an example is never late. All draw the same; `--hypothesis-profile explore` draws others.
settings.register_profile("house", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile("house")
TABLE = "CROSSCHECK_TABLE"  # the tests of lieeuler run without crosscheck
# Under CI commands start afresh, and the others colour what they print: a test that wants it says so.
for name in ("CI", "GITHUB_ACTIONS", "FORCE_COLOR", "PY_COLORS"):
    os.environ.pop(name, None)

# A shell starts background jobs with Ctrl-C ignored, which they pass on: what is to be interrupted would run on.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark tests by what they cost; `tools/marks.py` tells how."""
    marks = Marks()
    for item in items:
        for name in marks.of(item.nodeid):
            item.add_marker(name)


@pytest.fixture(scope="session", autouse=True)
def _tables(tmp_path_factory):
    """Tests leave no rows to users and take none of theirs; what a module prepares is in one table."""
    folder = tmp_path_factory.mktemp("rows")  # one folder for all: making a thousand reads the names of a thousand
    os.environ[TABLE] = str(folder / "rows.sqlite")
    return (str(folder / f"{number}.sqlite") for number in itertools.count())


@pytest.fixture(autouse=True)
def _rows_of_the_test(monkeypatch, _tables):
    """Every test begins with an empty table."""
    monkeypatch.setenv(TABLE, next(_tables))


@pytest.fixture(scope="module", autouse=True)
def _engines_end():
    """Engines of files that a module wrote end with it: each keeps a process of 40 MB until it is made anew."""
    yield
    if adapters := sys.modules.get("crosscheck.adapters"):
        adapters.renew()


@pytest.fixture(scope="module")
def truth(scene, crosscheck_truth):
    """Truth of the scene of a test module that has a fixture `scene`."""
    return crosscheck_truth(scene)
