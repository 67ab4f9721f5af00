"""Metrics, tolerances and verdicts. Nothing here knows the inside of an engine."""
