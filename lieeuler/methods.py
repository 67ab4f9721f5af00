"""The methods, as records.

Sources
-------
[P1] constraint-stabilized implicit methods on Lie group, doi:10.1177/1687814019842406
[P2] Lie group Euler methods for DAEs of multibody dynamics, doi:10.1177/1687814018764154
     This project has the prose of both papers but not their equations. The methods are reconstructed from the prose,
     those with H in the form of [BM]; docs/theory.md, section 4, has the equations, docs/papers.md what is known.
[BM] Bou-Rabee and Marsden, Hamilton-Pontryagin integrators, doi:10.1007/s10208-008-9030-4
[MK] Munthe-Kaas, High order Runge-Kutta methods on manifolds, doi:10.1016/S0168-9274(98)00030-0
[B]  Baumgarte, Stabilization of constraints, doi:10.1016/0045-7825(72)90018-7
[BCA] Bruels, Cardona and Arnold, Lie group generalized-alpha, doi:10.1016/j.mechmachtheory.2011.07.017; in stabilised
      index-2 form: Arnold, Bruels and Cardona, doi:10.1007/s00211-014-0633-1
"""

from __future__ import annotations

import dataclasses

from lieeuler.tableaux import DORMAND_PRINCE_5, DORMAND_PRINCE_8, KUTTA_4, Tableau

COORDINATE_MAPS = ("exp", "cayley", "ccsk")
"""Maps from R^3 onto SO(3): exponential, Cayley, canonical coordinates of the second kind."""

CORRECTIONS = ("mass", "plain")
"""Weights of the correction that closes the positions of stabilised Lagrangian methods."""


@dataclasses.dataclass(frozen=True)
class Method:
    """A Lie group integrator.

    Attributes
    ----------
    name : str
        What users type.
    formulation : "lagrange" | "hamilton" | "index1"
        Implicit steps of the Lagrangian equations, symplectic Euler for the Hamiltonian ones, or accelerations solved
        from the index-1 system.
    level : "position" | "velocity" | "stabilised" | "acceleration"
        The constraint equation solved in the step; "stabilised" is position and velocity together.
    index1_output : bool
        Whether (a, lam) are solved from the index-1 system at the new state, which makes them satisfy the
        acceleration constraint exactly.
    held : tuple of "position", "velocity", "acceleration"
        Constraint levels that hold at rounding level by construction.
    order : int or None
        None if the method chooses its order itself.
    source : str
    gains : (alpha, beta) or None
        Default Baumgarte gains, 1/s; None if the method takes none.
    composition : tuple of float
        Weights of the stages of a composition of RATTLE steps, equation (9.1) of docs/theory.md.
    spectral_radius : float or None
        Default spectral radius at infinite frequency of generalized-alpha; None for other methods.
    tableau : Tableau or None
        The coefficients of an explicit Runge-Kutta method.
    controls : tuple of "step", "rtol"
        How the user sets the accuracy: a fixed step (s), a relative tolerance, or either.
    conserves : bool
        Whether steps that follow a tolerance can keep energy and angular momentum of free bodies in twice the digits.
    """

    name: str
    formulation: str
    level: str
    index1_output: bool
    held: tuple[str, ...]
    order: int | None
    source: str
    gains: tuple[float, float] | None = None
    composition: tuple[float, ...] = ()
    spectral_radius: float | None = None
    tableau: Tableau | None = None
    controls: tuple[str, ...] = ("step",)
    conserves: bool = False

    @property
    def corrects(self) -> bool:
        """Whether the weight of the correction of xi is an option: in the stabilised Lagrangian methods."""
        return self.formulation == "lagrange" and self.level == "stabilised"

    def reduced(self, coordinate_map: str) -> tuple[str, ...]:
        """What `integrate(reduce=None)` may leave out: for an Euler method only what changes no step and no multiplier.

        In a plane all maps but ccsk turn by the same angle in any axes; multipliers have to be those of index 1.
        """
        if self.order != 1:
            return "welded", "planar", "axis", "joints"
        return ("planar", "axis") if self.index1_output and coordinate_map != "ccsk" else ()

    def refused_map(self, coordinate_map: str) -> str | None:
        """Why the method does not work with this map of `COORDINATE_MAPS`, or None if it does."""
        if self.formulation != "index1" and self.order != 1 and coordinate_map == "ccsk":
            return f"{self.name} would fall to order 1 with ccsk, which is not symmetric; use exp or cayley"
        if self.formulation == "index1" and coordinate_map != "exp":
            return f"{self.name} works with the exponential map; leave coordinate_map out"
        return None


def _symmetric(*half: float) -> tuple[float, ...]:
    """Weights g_1 .. g_m, 1 - 2 (g_1 + .. + g_m), g_m .. g_1 of a symmetric composition."""
    return (*half, 1 - 2 * sum(half), *reversed(half))


# Published weights. They sum to one, which fixes the middle one. METHODS uses for each order the weights of least error
# at equal cost: rattle4 has a tenth of the error of FOREST_RUTH_4 and half that of MCLACHLAN_4, rattle6 0.3 times that
# of YOSHIDA_6, rattle8 that of KAHAN_LI_8 (docs/theory.md, section 9).
FOREST_RUTH_4 = _symmetric(1 / (2 - 2 ** (1 / 3)))
"""Order 4, 3 stages; Forest and Ruth, doi:10.1016/0167-2789(90)90019-L."""
SUZUKI_4 = _symmetric(*2 * (1 / (4 - 4 ** (1 / 3)),))
"""Order 4, 5 stages; Suzuki, doi:10.1016/0375-9601(90)90962-N."""
MCLACHLAN_4 = _symmetric(0.28, 0.62546642846767004501)
"""Order 4, 5 stages; McLachlan, doi:10.1137/0916010."""
YOSHIDA_6 = _symmetric(0.784513610477560, 0.235573213359357, -1.17767998417887)
"""Order 6, 7 stages, solution A; Yoshida, doi:10.1016/0375-9601(90)90092-3."""
KAHAN_LI_6 = _symmetric(0.39216144400731413928, 0.33259913678935943860, -0.70624617255763935981,
                        0.08221359629355080023)
"""Order 6, 9 stages; Kahan and Li, doi:10.1090/S0025-5718-97-00873-9."""
SUZUKI_UMENO_8 = _symmetric(0.74167036435061295345, -0.40910082580003159400, 0.19075471029623837995,
                            -0.57386247111608226666, 0.29906418130365592384, 0.33462491824529818378,
                            0.31529309239676659663)
"""Order 8, 15 stages; Suzuki and Umeno 1993, also McLachlan, doi:10.1137/0916010."""
KAHAN_LI_8 = _symmetric(0.13020248308889008088, 0.56116298177510838456, -0.38947496264484728641,
                        0.15884190655515560090, -0.39590389413323757734, 0.18453964097831570709,
                        0.25837438768632204729, 0.29501172360931029887)
"""Order 8, 17 stages; Kahan and Li, doi:10.1090/S0025-5718-97-00873-9."""

_P1 = "reconstructed from doi:10.1177/1687814019842406"
_P2 = "doi:10.1177/1687814018764154"
_BM = "doi:10.1007/s10208-008-9030-4"
_MK = "doi:10.1016/S0168-9274(98)00030-0"
_BCA = "doi:10.1016/j.mechmachtheory.2011.07.017, doi:10.1007/s00211-014-0633-1"
_ALL = ("position", "velocity", "acceleration")


def _rattle(name: str, order: int, weights: tuple[float, ...], source: str) -> Method:
    return Method(name, "hamilton", "stabilised", True, _ALL, order, source, composition=weights)


def _runge_kutta(name: str, tableau: Tableau, source: str) -> Method:
    controls = ("step", "rtol") if tableau.errors else ("step",)
    return Method(name, "index1", "stabilised", True, _ALL, tableau.order, f"{_MK}, {source}", tableau=tableau,
                  controls=controls, conserves="rtol" in controls)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("DAE3L_LE", "lagrange", "position", False, ("position",), 1, f"{_P1}, {_P2}"),
        Method("DAE2L_LE", "lagrange", "velocity", False, ("velocity",), 1, f"{_P1}, {_P2}"),
        Method("DAE2L_LSE", "lagrange", "stabilised", False, ("position", "velocity"), 1, _P1),
        Method("DAE1L_LSE", "lagrange", "stabilised", True, _ALL, 1, _P1),
        Method("DAE3H_LE", "hamilton", "position", False, ("position",), 1, f"{_P1}, {_P2}, in the form of {_BM}"),
        Method("DAE2H_LE", "hamilton", "velocity", False, ("velocity",), 1, f"{_P1}, {_P2}, in the form of {_BM}"),
        Method("DAE2H_LSE", "hamilton", "stabilised", False, ("position", "velocity"), 1,
               f"{_P1}, in the form of {_BM}"),
        Method("DAE1H_LSE", "hamilton", "stabilised", True, _ALL, 1, f"{_P1}, in the form of {_BM}"),
        Method("INDEX1_LE", "lagrange", "acceleration", False, ("acceleration",), 1, f"{_P2}, comparator"),
        Method("BAUMGARTE_LE", "lagrange", "acceleration", False, (), 1,
               f"{_P1}, comparator; doi:10.1016/0045-7825(72)90018-7", gains=(5.0, 5.0)),
        Method("generalized_alpha", "lagrange", "stabilised", True, _ALL, 2, _BCA, spectral_radius=0.8),
        _rattle("rattle2", 2, (1.0,), _BM),
        _rattle("rattle4", 4, SUZUKI_4, f"{_BM}, doi:10.1016/0375-9601(90)90962-N"),
        _rattle("rattle6", 6, KAHAN_LI_6, f"{_BM}, doi:10.1090/S0025-5718-97-00873-9"),
        _rattle("rattle8", 8, SUZUKI_UMENO_8, f"{_BM}, doi:10.1137/0916010"),
        _runge_kutta("rkmk4", KUTTA_4, "doi:10.1007/978-3-540-78862-1"),
        _runge_kutta("rkmk54", DORMAND_PRINCE_5, "doi:10.1016/0771-050X(80)90013-3"),
        _runge_kutta("rkmk853", DORMAND_PRINCE_8, "doi:10.1007/978-3-540-78862-1"),
        Method("seulex", "index1", "stabilised", True, _ALL, None,
               f"{_P1}; extrapolated, doi:10.1007/978-3-642-05221-7", controls=("rtol",)),
        Method("taylor", "index1", "stabilised", True, _ALL, None, "doi:10.1080/10586458.2005.10128904",
               controls=("rtol",), conserves=True),
    )
}  # fmt: skip
"""All methods by name, in the order in which tables list them."""

EULER_METHODS = ("DAE3L_LE", "DAE2L_LE", "DAE2L_LSE", "DAE1L_LSE", "DAE3H_LE", "DAE2H_LE", "DAE2H_LSE", "DAE1H_LSE")
"""The eight methods of [P1], reconstructed: equations (4.1), (4.2) and (4.4) of docs/theory.md."""
