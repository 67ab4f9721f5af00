"""The methods, as records.

Sources
-------
[P1] constraint-stabilized implicit methods on Lie group, doi:10.1177/1687814019842406
[P2] Lie group Euler methods for DAEs of multibody dynamics, doi:10.1177/1687814018764154
[BM] Bou-Rabee and Marsden, Hamilton-Pontryagin integrators, doi:10.1007/s10208-008-9030-4
[B]  Baumgarte, Stabilization of constraints, doi:10.1016/0045-7825(72)90018-7
"""

from __future__ import annotations

import dataclasses

COORDINATE_MAPS = ("exp", "cayley", "ccsk")
"""Maps from R^3 onto SO(3): exponential, Cayley, canonical coordinates of the second kind."""


@dataclasses.dataclass(frozen=True)
class Method:
    """A Lie group integrator.

    Attributes
    ----------
    name : str
        What users type.
    formulation : "lagrange" | "hamilton"
        Implicit Euler for the Lagrangian equations, or symplectic Euler for the Hamiltonian ones.
    level : "position" | "velocity" | "stabilised" | "acceleration"
        The constraint equation solved in the step; "stabilised" is position and velocity together.
    index1_output : bool
        Whether (a, lam) are solved from the index-1 system at the new state, which makes them satisfy the
        acceleration constraint exactly.
    held : tuple of "position", "velocity", "acceleration"
        Constraint levels that hold at rounding level by construction.
    order : int
    source : str
    gains : (alpha, beta) or None
        Default Baumgarte gains, 1/s, where the method takes them.
    """

    name: str
    formulation: str
    level: str
    index1_output: bool
    held: tuple[str, ...]
    order: int
    source: str
    gains: tuple[float, float] | None = None


_P1 = "doi:10.1177/1687814019842406"
_P2 = "doi:10.1177/1687814018764154"
_ALL = ("position", "velocity", "acceleration")

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("DAE3L_LE", "lagrange", "position", False, ("position",), 1, f"{_P1}, {_P2}"),
        Method("DAE2L_LE", "lagrange", "velocity", False, ("velocity",), 1, f"{_P1}, {_P2}"),
        Method("DAE2L_LSE", "lagrange", "stabilised", False, ("position", "velocity"), 1, _P1),
        Method("DAE1L_LSE", "lagrange", "stabilised", True, _ALL, 1, _P1),
        Method("DAE3H_LE", "hamilton", "position", False, ("position",), 1, f"{_P1}, {_P2}"),
        Method("DAE2H_LE", "hamilton", "velocity", False, ("velocity",), 1, f"{_P1}, {_P2}"),
        Method("DAE2H_LSE", "hamilton", "stabilised", False, ("position", "velocity"), 1, _P1),
        Method("DAE1H_LSE", "hamilton", "stabilised", True, _ALL, 1, _P1),
        Method("INDEX1_LE", "lagrange", "acceleration", False, ("acceleration",), 1, f"{_P1}, comparator"),
        Method("BAUMGARTE_LE", "lagrange", "acceleration", False, (), 1,
               f"{_P1}, comparator; doi:10.1016/0045-7825(72)90018-7", gains=(5.0, 5.0)),
    )
}  # fmt: skip
"""All methods by name, in the order in which tables list them."""

EULER_METHODS = ("DAE3L_LE", "DAE2L_LE", "DAE2L_LSE", "DAE1L_LSE", "DAE3H_LE", "DAE2H_LE", "DAE2H_LSE", "DAE1H_LSE")
"""The eight methods of [P1]."""
