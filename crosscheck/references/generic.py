"""Three-vectors, 3x3 matrices and quaternions as nested lists over any number type.

The entries may be floats, arrays over time, or symbolic expressions: the Taylor formulation is written once with these
and serves both for its symbolic equations and for evaluating accelerations at samples. Quaternions are w, x, y, z.
"""

from __future__ import annotations


def add(*vectors):
    """Sum of vectors, entry by entry."""
    return [sum(entries[1:], entries[0]) for entries in zip(*vectors, strict=True)]


def scale(factor, vector):
    """factor times vector."""
    return [factor * entry for entry in vector]


def dot(a, b):
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    """a x b"""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def hat(a):
    """The matrix of a x (.)"""
    return [[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]]


def transpose(matrix):
    """Transpose of a 3x3 matrix."""
    return [list(column) for column in zip(*matrix, strict=True)]


def apply(matrix, vector):
    """matrix times vector."""
    return [dot(row, vector) for row in matrix]


def apply_transposed(matrix, vector):
    """Transpose of matrix, times vector."""
    return apply(transpose(matrix), vector)


def multiply(a, b):
    """Product of two 3x3 matrices."""
    return transpose([apply(a, column) for column in transpose(b)])


def combine(a, factor, b):
    """a + factor b of 3x3 matrices, factor a float."""
    return [[x + factor * y for x, y in zip(row_a, row_b, strict=True)] for row_a, row_b in zip(a, b, strict=True)]


def congruent(rotation, symmetric):
    """rotation symmetric rotation^T; the lower half is mirrored, which keeps symbolic results small."""
    half = multiply(rotation, symmetric)
    upper = {(i, j): dot(half[i], rotation[j]) for i in range(3) for j in range(i, 3)}
    return [[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)]


def factor_symmetric(s):
    """L D L^T of a symmetric positive definite 3x3 matrix: (l10, l20, l21, 1/d0, 1/d1, 1/d2)."""
    i0 = 1.0 / s[0][0]
    l10, l20 = s[1][0] * i0, s[2][0] * i0
    i1 = 1.0 / (s[1][1] - l10 * s[1][0])
    rest = s[2][1] - l20 * s[1][0]
    l21 = rest * i1
    return l10, l20, l21, i0, i1, 1.0 / (s[2][2] - l20 * s[2][0] - l21 * rest)


def solve_factored(factors, rhs):
    """Solution of s x = rhs from `factor_symmetric(s)`."""
    l10, l20, l21, i0, i1, i2 = factors
    y1 = rhs[1] - l10 * rhs[0]
    z2 = (rhs[2] - l20 * rhs[0] - l21 * y1) * i2
    z1 = y1 * i1 - l21 * z2
    return [rhs[0] * i0 - l10 * z1 - l20 * z2, z1, z2]


def quaternion_product(p, q):
    """Hamilton product p q."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return [pw * qw - px * qx - py * qy - pz * qz, pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx, pw * qz + px * qy - py * qx + pz * qw]


def conjugate(q):
    """Inverse of a unit quaternion."""
    return [q[0], -q[1], -q[2], -q[3]]


def rotation(q):
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return [[w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z]]
