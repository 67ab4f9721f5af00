"""A pytest plugin of `make test-lieeuler`: what imports crosscheck, an engine or heyoka fails."""

import sys

import pytest

FORBIDDEN = ("crosscheck", "mujoco", "pinocchio", "exudyn", "pydrake", "dartpy", "pybullet", "newton", "sapien", "warp",
             "heyoka")


def pytest_configure() -> None:
    """An import of what is None in `sys.modules` raises."""
    early = [name for name in FORBIDDEN if name in sys.modules]
    if early:
        raise pytest.UsageError(f"imported before any test: {', '.join(early)}; add -p no:crosscheck")
    sys.modules.update(dict.fromkeys(FORBIDDEN))  # type: ignore[arg-type]
