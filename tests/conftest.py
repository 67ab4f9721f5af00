"""Settings shared by all tests."""

import itertools
import os
import signal

import pytest
from hypothesis import settings

from crosscheck.jobs import table, threads
from tests.databases import postgresql_server, url  # noqa: F401 - fixtures

threads.limit()

# Shared machines stall: an example is never late. CI draws the same examples every time, a developer new ones.
settings.register_profile("house", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("house")
os.environ.pop("CI", None)  # under which commands start afresh: a test that wants it says so

# A shell starts background jobs with Ctrl-C ignored, which they pass on: what is to be interrupted would run on.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _tables(tmp_path_factory):
    """Tests leave no rows to users and take none of theirs; what a module prepares is in one table."""
    folder = tmp_path_factory.mktemp("rows")  # one folder for all: making a thousand reads the names of a thousand
    os.environ[table.VARIABLE] = str(folder / "rows.sqlite")
    return (str(folder / f"{number}.sqlite") for number in itertools.count())


@pytest.fixture(autouse=True)
def _rows_of_the_test(monkeypatch, _tables):
    """Every test begins with an empty table."""
    monkeypatch.setenv(table.VARIABLE, next(_tables))


@pytest.fixture(scope="module")
def truth(scene, crosscheck_truth):
    """Truth of the scene of a test module that has a fixture `scene`."""
    return crosscheck_truth(scene)
