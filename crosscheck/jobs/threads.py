"""One thread for linear algebra: the matrices of scenes are so small that more threads take ten times as long."""

from __future__ import annotations

import os

ONE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a process with one thread. It counts only before NumPy is first imported."""


def limit() -> None:
    """Give this process one thread, unless its environment asks for another number."""
    for name, number in ONE.items():
        os.environ.setdefault(name, number)
