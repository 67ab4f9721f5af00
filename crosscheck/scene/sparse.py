"""Sparse algebra for the states of large scenes, with time and memory proportional to the number of bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_SHIFT = 1e-12
"""Added to the (unit) diagonal of W W^T, so that redundant rows can be factored; refinement removes its effect."""

_REFINEMENTS = 30


def block_diagonal(blocks: np.ndarray) -> csr_array:
    """The matrix (kn, kn) with the blocks (n, k, k) on its diagonal."""
    from scipy.sparse import bsr_array

    return bsr_array((blocks, np.arange(len(blocks)), np.arange(len(blocks) + 1))).tocsr()


def least_norm(W: csr_array, rhs: np.ndarray) -> np.ndarray:
    """The shortest z with W z = rhs; rows may be redundant as long as they agree.

    z = W^T lam with (W W^T) lam = rhs, factored with a small shift and refined to rounding level. Each refinement
    reduces the error for an eigenvalue s by shift / (s + shift); errors in the null space of W^T do not change z.
    """
    from scipy.sparse import diags_array, eye_array
    from scipy.sparse.linalg import splu

    sizes = np.sqrt(W.multiply(W).sum(axis=1))
    scale = 1 / np.where(sizes > 0, sizes, 1.0)
    W, rhs = (diags_array(scale) @ W).tocsr(), scale * rhs
    factors = splu((W @ W.T + _SHIFT * eye_array(len(rhs))).tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                   options={"SymmetricMode": True})
    z, best, left = np.zeros(W.shape[1]), np.inf, rhs
    for _ in range(_REFINEMENTS):
        z = z + W.T @ factors.solve(left)
        left = rhs - W @ z
        gap = float(np.abs(left).max())
        if not gap < 0.5 * best:
            break
        best = gap
    return z
