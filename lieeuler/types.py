"""Conventions of all arrays.

Units are SI. `n` bodies, `m` constraint rows, `T` output times.

=========  ==============  ====================================================================================
name       shape           meaning
=========  ==============  ====================================================================================
x          (T, n, 3)       centres of mass, world axes
R          (T, n, 3, 3)    attitudes, body axes to world axes
v          (T, n, 3)       velocities of the centres of mass, world axes
w          (T, n, 3)       angular velocities, body axes:  dR/dt = R hat(w)
a          (T, n, 3)       accelerations of the centres of mass, world axes
alpha      (T, n, 3)       dw/dt, body axes
lam        (T, m)          multipliers; the generalized constraint force is -G^T lam
=========  ==============  ====================================================================================

The quasi-velocities of a body are u = (v, w); G is the constraint Jacobian with respect to them, dPhi/dt = G u.
Quaternions, where they occur, are ordered w, x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

ArrayLike = np.ndarray | Sequence[Any]

State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""x, R, v, w"""

Measured = tuple[bool, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""A joint's coordinate as the kernel takes it: whether it turns, its axis in parent and child, two normals of
the parent's, the first one as the child sees it at zero."""

GROUND = -1
"""Body index of the ground."""
