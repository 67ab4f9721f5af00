"""Settings shared by all tests."""

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
def _rows_of_the_session(tmp_path_factory):
    """Tests leave no rows to users and take none of theirs; what a module prepares is in one table."""
    os.environ[table.VARIABLE] = str(tmp_path_factory.mktemp("rows") / "rows.sqlite")


@pytest.fixture(autouse=True)
def _rows_of_the_test(monkeypatch, tmp_path_factory):
    """Every test begins with an empty table."""
    monkeypatch.setenv(table.VARIABLE, str(tmp_path_factory.mktemp("rows") / "rows.sqlite"))


@pytest.fixture(scope="module")
def truth(scene, crosscheck_truth):
    """Truth of the scene of a test module that has a fixture `scene`."""
    return crosscheck_truth(scene)
