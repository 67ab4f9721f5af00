"""Three-vectors, 3x3 matrices and quaternions as nested lists over any number type.

The entries may be floats, arrays over time, or symbolic expressions, so that the same formulas give the symbolic
equations of the Taylor formulation and the accelerations at samples. Quaternions are w, x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Number = Any  # a float, an array over time or a symbolic expression
Vector = list[Number]
Matrix = list[Vector]
ByBody = dict[int, list[Any]]
"""A list for every body; accelerations are lists over the columns of applied wrenches."""
Factors = tuple[Matrix, Vector]
"""L below its diagonal and 1 / D of L D L^T."""


def add(*vectors: Vector) -> Vector:
    """Sum of vectors, entry by entry."""
    return [sum(entries[1:], entries[0]) for entries in zip(*vectors, strict=True)]


def scale(factor: Number, vector: Sequence[Number]) -> Vector:
    """factor times vector."""
    return [factor * entry for entry in vector]


def dot(a: Sequence[Number], b: Sequence[Number]) -> Number:
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Sequence[Number], b: Sequence[Number]) -> Vector:
    """a x b"""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def hat(a: Vector) -> Matrix:
    """The matrix of a x (.)"""
    return [[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]]


def transpose(matrix: Matrix) -> Matrix:
    """Transpose of a 3x3 matrix."""
    return [list(column) for column in zip(*matrix, strict=True)]


def apply(matrix: Matrix, vector: Sequence[Number]) -> Vector:
    """matrix times vector."""
    return [dot(row, vector) for row in matrix]


def apply_transposed(matrix: Matrix, vector: Sequence[Number]) -> Vector:
    """Transpose of matrix, times vector."""
    return apply(transpose(matrix), vector)


def multiply(a: Matrix, b: Matrix) -> Matrix:
    """Product of two 3x3 matrices."""
    return transpose([apply(a, column) for column in transpose(b)])


def factor_symmetric(s: Matrix) -> Factors:
    """L D L^T of a symmetric positive definite matrix of any size: the rows of L below its diagonal, and 1 / D."""
    lower: Matrix = []
    inverse: Vector = []
    for i in range(len(s)):
        row: Vector = []
        pivot = s[i][i]
        scaled: Vector = []  # L_ik D_k
        for j in range(i):
            entry = s[i][j]
            for k in range(j):
                entry = entry - scaled[k] * lower[j][k]
            scaled.append(entry)
            row.append(entry * inverse[j])
            pivot = pivot - entry * row[j]
        lower.append(row)
        inverse.append(1.0 / pivot)
    return lower, inverse


def solve_factored(factors: Factors, rhs: Sequence[Number]) -> Vector:
    """Solution of s x = rhs from `factor_symmetric(s)`."""
    lower, inverse = factors
    x = list(rhs)
    for i, row in enumerate(lower):
        for k, entry in enumerate(row):
            x[i] = x[i] - entry * x[k]
    x = [entry * factor for entry, factor in zip(x, inverse, strict=True)]
    for i in reversed(range(len(x))):
        for k, entry in enumerate(lower[i]):
            x[k] = x[k] - entry * x[i]
    return x


def turn_about(axis: Sequence[Number], angle: Number) -> Vector:
    """Quaternion of the rotation by `angle` about a unit vector of floats."""
    sine = _function("sin", 0.5 * angle)
    return [_function("cos", 0.5 * angle), *(component * sine for component in axis)]


def square_root(value: Number) -> Number:
    """Square root over any number type."""
    return _function("sqrt", value)


def _function(name: str, value: Number) -> Number:
    """An elementary function of a float, an array, or a symbolic expression."""
    if isinstance(value, float | complex | np.ndarray):
        return getattr(np, name)(value)
    import heyoka

    return getattr(heyoka, name)(value)


def quaternion_product(p: Sequence[Number], q: Sequence[Number]) -> Vector:
    """Hamilton product p q."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return [pw * qw - px * qx - py * qy - pz * qz, pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx, pw * qz + px * qy - py * qx + pz * qw]


def conjugate(q: Sequence[Number]) -> Vector:
    """Inverse of a unit quaternion."""
    return [q[0], -q[1], -q[2], -q[3]]


def rotation(q: Sequence[Number]) -> Matrix:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return [[w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z]]
