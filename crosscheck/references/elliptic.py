"""Jacobi elliptic functions and the elliptic integral of the third kind in multiprecision, and frames for their users.

At a turning point the phase of sn has only half the digits, and near a pole of Euler angles precession and spin are
large numbers of opposite sign. With DIGITS digits, sixteen are correct there too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpmath.ctx_mp import MPContext

from crosscheck.references import generic

DIGITS = 50


def context() -> Any:
    """A separate mpmath context with numbers of `DIGITS` digits."""
    mp = MPContext()
    mp.dps = DIGITS
    return mp


def frame(mp: Any, along: Sequence[Any]) -> Any:
    """A right-handed orthonormal frame (columns) whose third vector points along the given one."""
    norm = mp.norm(mp.matrix(list(along)))
    third = [mp.mpf(entry) / norm for entry in along]
    least = int(np.argmin([abs(entry) for entry in third]))
    second = generic.cross(third, [float(k == least) for k in range(3)])
    size = mp.sqrt(generic.dot(second, second))
    second = [entry / size for entry in second]
    return mp.matrix([generic.cross(second, third), second, third]).T


def attitude(mp: Any, quaternion: np.ndarray) -> Any:
    """The rotation of a quaternion to all digits: an error of 1e-16 here would cause one of 1e-8 in a phase."""
    q = mp.matrix(quaternion.tolist())
    return mp.matrix(generic.rotation([component / mp.norm(q) for component in q]))


def euler(mp: Any, theta: Any, phi: Any, psi: Any) -> Any:
    """Rz(phi) Rx(theta) Rz(psi)."""
    (st, ct), (sf, cf), (sp, cp) = ((mp.sin(angle), mp.cos(angle)) for angle in (theta, phi, psi))
    return mp.matrix([[cf * cp - sf * ct * sp, -cf * sp - sf * ct * cp, sf * st],
                      [sf * cp + cf * ct * sp, -sf * sp + cf * ct * cp, -cf * st],
                      [st * sp, st * cp, ct]])


def pose_in_doubles(world: Any, E: Any, axes: Any, w: Any) -> tuple[np.ndarray, np.ndarray]:
    """world E axes^T (3, 3) and axes w (3,), rounded to doubles."""
    return (np.array((world * E * axes.T).tolist(), dtype=float), np.array((axes * w).T.tolist()[0], dtype=float))


class Jacobi:
    """sn, cn, dn of parameter m, and the integral of 1 / (1 - n sn^2) from an argument `start` on."""

    def __init__(self, mp: Any, m: Any, start: Any, characteristics: Sequence[Any]) -> None:
        self.mp, self.m, self.start = mp, m, start
        self.quarter = mp.ellipk(m)
        self._complete = {n: mp.ellippi(n, m) for n in characteristics}
        self._at_start = {n: self._from_zero(n, start) for n in characteristics}

    def functions(self, tau: Any) -> tuple[Any, ...]:
        """sn, cn, dn."""
        return tuple(self.mp.ellipfun(kind, tau, m=self.m) for kind in ("sn", "cn", "dn"))

    def third_kind(self, n: Any, tau: Any) -> Any:
        """Integral of 1 / (1 - n sn^2) from the start to tau."""
        return self._from_zero(n, tau) - self._at_start[n]

    def _from_zero(self, n: Any, tau: Any) -> Any:
        """The same integral from 0, continued over any number of half periods of sn^2."""
        mp = self.mp
        turns = mp.nint(tau / (2 * self.quarter))
        within = tau - 2 * self.quarter * turns
        return 2 * turns * self._complete[n] + mp.ellippi(n, mp.asin(mp.ellipfun("sn", within, m=self.m)), self.m)
