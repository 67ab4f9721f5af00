"""Vector algebra of the maximal formulation, over all bodies at once.

Constant tensors keep the number of NumPy calls low, which dominates the time for a few bodies.
"""

from __future__ import annotations

import dataclasses

import numpy as np

_EPSILON = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _EPSILON[_i, _k, _j], _EPSILON[_i, _j, _k] = 1.0, -1.0
_FORM = np.zeros((4, 4, 3, 3))  # R = q q : _FORM = (w^2 - p.p) I + 2 p p^T + 2 w p^ for a unit q = (w, p)
_FORM[0, 0] = np.eye(3)
for _i in range(3):
    _FORM[_i + 1, _i + 1] = -np.eye(3)
    _FORM[0, _i + 1] += 2.0 * _EPSILON[_i]
    for _j in range(3):
        _FORM[_i + 1, _j + 1, _i, _j] += 2.0
HAT, QUADRATIC = _EPSILON.reshape(3, 9), _FORM.reshape(16, 9)  # a @ HAT is the matrix of a x (.)


@dataclasses.dataclass(frozen=True)
class Motion:
    """State with the ground appended: x, v, w (n + 1, 3), R (n + 1, 3, 3), and angles of hinges if needed.

    Angular velocities: w in body axes, omega in world axes.
    """

    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray
    hinges: np.ndarray | None = None  # from the start, over any number of turns
    t: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "omega", turned(self.R, self.w))

    omega: np.ndarray = dataclasses.field(init=False)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b of arrays (k, 3); several times faster than numpy.cross for a few vectors."""
    product: np.ndarray = np.matmul((a @ HAT).reshape(-1, 3, 3), b[:, :, None])[:, :, 0]
    return product


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a . b of arrays (k, 3), (k,)."""
    products: np.ndarray = (a * b).sum(axis=1)
    return products


def turned(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """R s of arrays (k, 3, 3) and (k, 3)."""
    carried: np.ndarray = np.matmul(R, vectors[:, :, None])[:, :, 0]
    return carried


def back(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """R^T s of arrays (k, 3, 3) and (k, 3)."""
    carried: np.ndarray = np.matmul(vectors[:, None, :], R)[:, 0]
    return carried


def rotation(q: np.ndarray) -> np.ndarray:
    """Attitudes (n, 3, 3) of quaternions (n, 4) of any nonzero length."""
    products = (q[:, :, None] * q[:, None, :]).reshape(-1, 16)
    matrices: np.ndarray = ((products @ QUADRATIC) / products[:, ::5].sum(axis=1)[:, None]).reshape(-1, 3, 3)
    return matrices


def centripetal(omega: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """omega x (omega x lever), world axes."""
    return cross(omega, cross(omega, lever))
