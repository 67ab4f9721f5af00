"""Settings shared by all tests."""

import os
import signal

import pytest
from hypothesis import settings

from crosscheck.jobs import threads

threads.limit()

# Shared machines stall: an example is never late. CI draws the same examples every time, a developer new ones.
settings.register_profile("house", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("house")

# A shell starts background jobs with Ctrl-C ignored, which they pass on: what is to be interrupted would run on.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module")
def truth(scene, crosscheck_truth):
    """Truth of the scene of a test module that has a fixture `scene`."""
    return crosscheck_truth(scene)
