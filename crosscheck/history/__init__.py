"""Results over time: the store, nightly runs, and what changed since the last good one."""
