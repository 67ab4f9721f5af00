"""Packed curves as arrays, for the figures that are no page's."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from crosscheck.document import PACKED_MISSING, PACKED_STEPS


def unpack(curve: dict[str, Any] | str | None) -> np.ndarray:
    """The values (T,) of a curve that `crosscheck.verification.curves.pack` made; NaN where one is missing.

    The word "truth" has to be looked up before.
    """
    if not isinstance(curve, dict):
        raise TypeError(f"a packed curve is a dictionary, not {curve!r}")
    if "n" in curve:
        return np.full(curve["n"], curve["lo"])
    codes = np.frombuffer(base64.b64decode(curve["q"]), dtype="<u2").astype(float)
    values = curve["lo"] + (codes - 1) / (PACKED_STEPS - 1) * (curve["hi"] - curve["lo"])
    if curve.get("log"):
        values = np.where(codes == 0, 0.0, 10.0**values)
    return np.where(codes == PACKED_MISSING, np.nan, values)
