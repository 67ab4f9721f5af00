"""Measurements of speed, kept apart from the tests: nothing here passes or fails."""
