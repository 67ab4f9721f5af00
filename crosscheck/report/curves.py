"""Packed curves of a document as arrays."""

from __future__ import annotations

import base64

import numpy as np

from crosscheck.document.curves import PACKED_MISSING, PACKED_STEPS, Curve, Packed


def unpack(curve: Curve, exact: Curve = None) -> np.ndarray:
    """The values (T,) of a curve from `crosscheck.verification.curves.pack`. Missing values are NaN.

    `exact` is the true curve. It replaces the word "truth", and differences are added to it.
    """
    if curve == "truth":
        return unpack(exact)
    if not isinstance(curve, Packed):
        raise TypeError(f"a packed curve is wanted, not {curve!r}")
    if curve.n is not None:
        values = np.full(curve.n, curve.lo)
        return values + unpack(exact) if curve.over else values
    codes = np.frombuffer(base64.b64decode(curve.q or ""), dtype="<u2").astype(float)
    values = curve.lo + (codes - 1) / (PACKED_STEPS - 1) * (curve.hi - curve.lo)
    if curve.log:
        values = np.where(codes == 0, 0.0, 10.0**values)
    values = np.where(codes == PACKED_MISSING, np.nan, values)
    return values + unpack(exact) if curve.over else values
