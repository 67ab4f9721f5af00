"""Runs that are killed and go on: the rows they left, and their results without times."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import time

from crosscheck.jobs import table

TIMES = {"time", "advice", "started", "seconds", "wall_time", "us_per_step", "seconds_per_second", "seconds_deviation",
         "speed", "timing", "recommended", "trust", "text", "calibration", "compared_with", "changes", "commit"}
"""Keys that hold times, or what depends on them: trust and advice name the fastest method and its time. The commit has
a mark when somebody edits a file while the tests run."""


def results(folder):
    """The document of a report."""
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def timeless(value):
    """A document without what times decide."""
    if isinstance(value, dict):
        return {key: timeless(each) for key, each in value.items() if key not in TIMES}
    return [timeless(each) for each in value] if isinstance(value, list) else value


def rows():
    """(key, session) of the rows that are in the table."""
    with sqlite3.connect(os.environ[table.VARIABLE], timeout=60) as connection:
        try:
            return connection.execute("SELECT key, session FROM rows_1").fetchall()
        except sqlite3.OperationalError:  # it is not made yet
            return []


def killed(command, moment, later=0.0):
    """Start a run and kill it `later` (s) than the table has so many rows; whether it was still at work.

    `command`: the arguments of `subprocess.run`.
    """
    process = subprocess.Popen(**command)
    while process.poll() is None:
        if len(rows()) >= moment:
            time.sleep(later)
            process.send_signal(signal.SIGKILL)
            break
        time.sleep(0.01)
    process.communicate(timeout=60)
    return process.returncode == -signal.SIGKILL
