"""Metrics, tolerances and verdicts. They do not depend on how an engine works."""
