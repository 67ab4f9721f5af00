"""Results over time: the store, nightly runs, and the changes since the last good run."""
