"""Commands run in the process of the tests: starting Python for each takes longer than most of them run."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from types import SimpleNamespace
from unittest import mock

from crosscheck import adapters
from crosscheck.cli.app import main
from crosscheck.running import provenance


def crosscheck(*words):
    """Exit code, output and complaints of a command at 200 columns."""
    said, complained, code = io.StringIO(), io.StringIO(), 0
    adapters.renew()  # as a process of its own begins, which would read the code as it is now: keys of rows tell it
    provenance.digest.cache_clear()
    with (mock.patch.object(sys, "argv", ["crosscheck", *words]),
          mock.patch("crosscheck.cli.console.PAUSE", 1e6),  # what is said meanwhile depends on the machine
          mock.patch.dict(os.environ, COLUMNS="200"),
          contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained)):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    return SimpleNamespace(returncode=code, stdout=said.getvalue(), stderr=complained.getvalue())
