"""Commands and tests leave linear algebra one thread, unless the user asks for more."""

import os
import subprocess
import sys

import pytest

from crosscheck.jobs import threads

TELL = "import crosscheck.cli.app, os, sys; print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)"


@pytest.mark.parametrize("asked", [None, "3"])
def test_a_command_has_one_thread_unless_the_user_asks_for_more(asked):
    """NumPy is not loaded yet, or the number would come too late."""
    rest = {name: value for name, value in os.environ.items() if name not in threads.ONE}
    chosen = {} if asked is None else dict.fromkeys(threads.ONE, asked)
    told = subprocess.run([sys.executable, "-c", TELL], env=rest | chosen, capture_output=True, text=True, check=True)
    assert told.stdout.split() == [asked or "1", "False"]
