"""Measurements of speed, kept apart from the tests: nothing here passes or fails."""

from crosscheck.jobs import threads

threads.limit()
