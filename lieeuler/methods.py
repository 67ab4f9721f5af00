"""The methods: a class each, whose attributes are what is known of the method and whose fields are its options.

Sources
-------
[P1] constraint-stabilized implicit methods on Lie group, doi:10.1177/1687814019842406
[P2] Lie group Euler methods for DAEs of multibody dynamics, doi:10.1177/1687814018764154
     This project has the prose of both papers but not their equations. The methods are reconstructed from the prose,
     those with H in the form of [BM]: (4.1) to (4.5) of docs/theory.md; docs/papers.md says what is known.
[BM] Bou-Rabee and Marsden, Hamilton-Pontryagin integrators, doi:10.1007/s10208-008-9030-4
[MK] Munthe-Kaas, High order Runge-Kutta methods on manifolds, doi:10.1016/S0168-9274(98)00030-0
[B]  Baumgarte, Stabilization of constraints, doi:10.1016/0045-7825(72)90018-7
[BCA] Bruels, Cardona and Arnold, Lie group generalized-alpha, doi:10.1016/j.mechmachtheory.2011.07.017; in stabilised
      index-2 form: Arnold, Bruels and Cardona, doi:10.1007/s00211-014-0633-1
"""

from __future__ import annotations

import dataclasses
import difflib
from typing import Annotated, Any, ClassVar

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import Flag, Frozen, NonNegative, Positive, number, one_of, positive
from lieeuler.errors import ArgumentError
from lieeuler.tableaux import DORMAND_PRINCE_5, DORMAND_PRINCE_8, KUTTA_4, Tableau

COORDINATE_MAPS = ("exp", "cayley", "ccsk")
"""Maps from R^3 onto SO(3): exponential, Cayley, canonical coordinates of the second kind."""

CORRECTIONS = ("mass", "plain")
"""Weights of the correction that closes the positions of stabilised Lagrangian methods."""

LEVELS = ("position", "velocity", "acceleration")
"""Of the constraints."""

MOST_STEPS = 1e12
"""A run of more steps than this is refused as a mistake: it would take weeks."""

DEFAULT_RTOL = 1e-8
"""Tolerance of an adaptive method that is given neither a step nor a tolerance. It is relative to the size of the
system (m), to one radian, and to their rates. The error is proportional to it, but it is not a strict bound."""

RTOL_RANGE = (1e-14, 0.1)
"""Below the first value rounding would control the steps; above the second the motion is not resolved."""


def _tolerance(name: str, value: float) -> float:
    if not RTOL_RANGE[0] <= positive(name, value) <= RTOL_RANGE[1]:
        raise ArgumentError(f"{name} must lie between {RTOL_RANGE[0]:g} and {RTOL_RANGE[1]:g}, not {value!r}")
    return float(value)


def _radius(name: str, value: float) -> float:
    if number(name, value, 0.0) > 1:
        raise ArgumentError(f"{name} must lie between 0 and 1, not {value!r}")
    return float(value)


Tolerance = Annotated[float, _tolerance]
Correction = Annotated[str, one_of(*CORRECTIONS)]


@dataclasses.dataclass(frozen=True)
class Method(Frozen):
    """A Lie group integrator with its options, which are the fields of its class; None stands for a default.

    Attributes
    ----------
    name : str
        What users type; the class's own name where none is given.
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
    composition : tuple of float
        Weights of the stages of a composition of RATTLE steps, equations (9.1) and (9.2) of docs/theory.md.
    tableau : Tableau or None
        The coefficients of an explicit Runge-Kutta method.
    maps : tuple of str
        The coordinate maps with which the method has its order.
    controls : tuple of "step", "rtol"
        How the user sets the accuracy: a fixed step (s), a relative tolerance, or either.
    """

    name: ClassVar[str]
    formulation: ClassVar[str] = "index1"
    level: ClassVar[str] = "stabilised"
    index1_output: ClassVar[bool] = True
    held: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")
    order: ClassVar[int | None] = None
    source: ClassVar[str] = ""
    composition: ClassVar[tuple[float, ...]] = ()
    tableau: ClassVar[Tableau | None] = None
    maps: ClassVar[tuple[str, ...]] = ("exp",)
    controls: ClassVar[tuple[str, ...]] = ("step",)

    def __init_subclass__(cls, **facts: object) -> None:
        super().__init_subclass__()
        cls.name = cls.__name__
        for name, value in facts.items():
            setattr(cls, name, value)

    @classmethod
    def options(cls) -> tuple[str, ...]:
        """The names of the options."""
        return tuple(field.name for field in dataclasses.fields(cls))

    @classmethod
    def refused_map(cls, coordinate_map: str) -> str | None:
        """Why the method does not work with this map of `COORDINATE_MAPS`, or None if it does."""
        if coordinate_map in cls.maps:
            return None
        if cls.formulation == "index1":
            return f"{cls.name} works with the exponential map; leave map out"
        return f"{cls.name} would fall to order 1 with {coordinate_map}, which is not symmetric; use exp or cayley"

    @property
    def spin_free(self) -> bool:
        """The default of this argument of `integrate`."""
        return self.order != 1

    @property
    def reduced(self) -> tuple[str, ...]:
        """What `integrate(reduce=None)` may leave out."""
        return "welded", "planar", "axis", "joints"

    def run(self, t: np.ndarray, monitor: bool) -> tuple[_kernel.Run, float | None]:
        """What the kernel runs over output times (s), and the largest step (s), None if the method chooses its steps.

        Raises
        ------
        ArgumentError
            The run would take too many steps.
        """
        if (step := getattr(self, "step", None)) is None:
            return self._planned((t - t[0]).tolist(), getattr(self, "rtol"), monitor), None  # noqa: B009
        steps, counts = output_steps(t, step)
        return self._planned(steps, counts, monitor), max(steps)

    def _planned(self, *given: Any) -> _kernel.Run:
        """The run by steps and their counts, or by output times from 0 and a tolerance; and whether it is monitored."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class Implicit(Method):
    """Steps of fixed size (s), solved for by Newton's iteration, with a coordinate map.

    A step that does not divide an output interval is shortened to the next one that does.
    """

    step: Positive
    map: Annotated[str, one_of(*COORDINATE_MAPS)] = "exp"

    def __post_init__(self) -> None:
        super().__post_init__()
        if refused := self.refused_map(self.map):
            raise ArgumentError(refused)

    def _planned(self, *given: Any) -> _kernel.Run:
        known = {"alpha": 0.0, "beta": 0.0, "spectral_radius": None, "polish": True, "correction": "mass", **vars(self)}
        rule = _kernel.Method(_kernel.Formulation[self.formulation], _kernel.Level[self.level], self.index1_output,
                              known["alpha"], known["beta"], self.composition, known["spectral_radius"],
                              known["polish"], _kernel.Correction[known["correction"]])
        return _kernel.implicit(_kernel.CoordinateMap[self.map], rule, *given)


@dataclasses.dataclass(frozen=True)
class Euler(Implicit, order=1, index1_output=False, maps=COORDINATE_MAPS):
    """Methods of order one. polish: make attitudes rotations again after every step, (3.2) of docs/theory.md."""

    polish: Flag = True

    @property
    def reduced(self) -> tuple[str, ...]:
        """Only what changes no step and no multiplier: in a plane all maps but ccsk turn by the same angle in any axes;
        multipliers have to be those of index 1."""
        return ("planar", "axis") if self.index1_output and self.map != "ccsk" else ()


@dataclasses.dataclass(frozen=True)
class CorrectedEuler(Euler, formulation="lagrange"):
    """correction: the weight of G_n^T mu, which closes the positions: "mass" is M^-1, which costs the least kinetic
    energy, "plain" is none: (4.1) of docs/theory.md."""

    correction: Correction = "mass"


_P1 = "reconstructed from doi:10.1177/1687814019842406"
_P2 = "doi:10.1177/1687814018764154"
_BM = "doi:10.1007/s10208-008-9030-4"
_MK = "doi:10.1016/S0168-9274(98)00030-0"
_LE, _LE_BM, _LSE_BM = f"{_P1}, {_P2}", f"{_P1}, {_P2}, in the form of {_BM}", f"{_P1}, in the form of {_BM}"
_POSITION, _VELOCITY = ("position",), ("velocity",)


class DAE3L_LE(Euler, formulation="lagrange", level="position", held=_POSITION, source=_LE): ...
class DAE2L_LE(Euler, formulation="lagrange", level="velocity", held=_VELOCITY, source=_LE): ...
class DAE2L_LSE(CorrectedEuler, held=_POSITION + _VELOCITY, source=_P1): ...
class DAE1L_LSE(CorrectedEuler, index1_output=True, source=_P1): ...
class DAE3H_LE(Euler, formulation="hamilton", level="position", held=_POSITION, source=_LE_BM): ...
class DAE2H_LE(Euler, formulation="hamilton", level="velocity", held=_VELOCITY, source=_LE_BM): ...
class DAE2H_LSE(Euler, formulation="hamilton", held=_POSITION + _VELOCITY, source=_LSE_BM): ...
class DAE1H_LSE(Euler, formulation="hamilton", index1_output=True, source=_LSE_BM): ...
class INDEX1_LE(Euler, formulation="lagrange", level="acceleration", held=("acceleration",),
                source=f"{_P2}, comparator"): ...


@dataclasses.dataclass(frozen=True)
class BAUMGARTE_LE(Euler, formulation="lagrange", level="acceleration", held=(),
                   source=f"{_P1}, comparator; doi:10.1016/0045-7825(72)90018-7"):
    """alpha, beta: Baumgarte gains, 1/s."""

    alpha: NonNegative = 5.0
    beta: NonNegative = 5.0


@dataclasses.dataclass(frozen=True)
class GeneralizedAlpha(Implicit, name="generalized_alpha", formulation="lagrange", order=2, maps=("exp", "cayley"),
                       source="doi:10.1016/j.mechmachtheory.2011.07.017, doi:10.1007/s00211-014-0633-1"):
    """spectral_radius: at infinite frequency; 0 damps motions much faster than the step away, 1 keeps them.
    correction: as in `CorrectedEuler`."""

    spectral_radius: Annotated[float, _radius] = 0.8
    correction: Correction = "mass"


def _symmetric(*half: float) -> tuple[float, ...]:
    """Weights g_1 .. g_m, 1 - 2 (g_1 + .. + g_m), g_m .. g_1 of a symmetric composition."""
    return (*half, 1 - 2 * sum(half), *reversed(half))


# Published weights. They sum to one, which fixes the middle one. METHODS has for each order those of least error at
# equal cost: rattle4 a tenth of the error of Forest and Ruth's, doi:10.1016/0167-2789(90)90019-L, and half that of
# MCLACHLAN_4, rattle6 0.3 times that of Yoshida's solution A, doi:10.1016/0375-9601(90)90092-3, rattle8 that of Kahan
# and Li's with 17 stages.
SUZUKI_4 = _symmetric(*2 * (1 / (4 - 4 ** (1 / 3)),))
"""Order 4, 5 stages; Suzuki, doi:10.1016/0375-9601(90)90962-N."""
MCLACHLAN_4 = _symmetric(0.28, 0.62546642846767004501)
"""Order 4, 5 stages; McLachlan, doi:10.1137/0916010."""
KAHAN_LI_6 = _symmetric(0.39216144400731413928, 0.33259913678935943860, -0.70624617255763935981,
                        0.08221359629355080023)
"""Order 6, 9 stages; Kahan and Li, doi:10.1090/S0025-5718-97-00873-9."""
SUZUKI_UMENO_8 = _symmetric(0.74167036435061295345, -0.40910082580003159400, 0.19075471029623837995,
                            -0.57386247111608226666, 0.29906418130365592384, 0.33462491824529818378,
                            0.31529309239676659663)
"""Order 8, 15 stages; Suzuki and Umeno 1993, also McLachlan, doi:10.1137/0916010."""


class Rattle(Implicit, formulation="hamilton", maps=("exp", "cayley")):
    """Compositions of RATTLE steps."""


class Rattle2(Rattle, name="rattle2", order=2, composition=(1.0,), source=_BM): ...
class Rattle4(Rattle, name="rattle4", order=4, composition=SUZUKI_4,
              source=f"{_BM}, doi:10.1016/0375-9601(90)90962-N"): ...
class Rattle6(Rattle, name="rattle6", order=6, composition=KAHAN_LI_6,
              source=f"{_BM}, doi:10.1090/S0025-5718-97-00873-9"): ...
class Rattle8(Rattle, name="rattle8", order=8, composition=SUZUKI_UMENO_8, source=f"{_BM}, doi:10.1137/0916010"): ...


@dataclasses.dataclass(frozen=True)
class RungeKutta(Method):
    """Explicit Munthe-Kaas Runge-Kutta with steps of fixed size, s."""

    step: Positive

    def _planned(self, *given: Any) -> _kernel.Run:
        return _kernel.runge_kutta(self.tableau.kernel, *given)  # type: ignore[union-attr]


@dataclasses.dataclass(frozen=True)
class EmbeddedRungeKutta(Method, controls=("step", "rtol")):
    """Explicit Munthe-Kaas Runge-Kutta with a step (s), or steps that follow a tolerance (see `DEFAULT_RTOL`).

    conserve: with rtol, end every step with the energy and angular momentum that free bodies had at the start, in
    twice the digits: a body that turns over about its middle axis then keeps three to five digits more.
    """

    step: Positive | None = None
    rtol: Tolerance | None = None
    conserve: Flag = False

    def __post_init__(self) -> None:
        if self.step is not None and (self.rtol is not None or self.conserve is True):
            raise ArgumentError("give step or rtol, not both; conserve=True is for runs with rtol")
        if self.step is None and self.rtol is None:
            object.__setattr__(self, "rtol", DEFAULT_RTOL)
        super().__post_init__()

    def _planned(self, *given: Any) -> _kernel.Run:
        first, second, monitor = given
        tableau = self.tableau.kernel  # type: ignore[union-attr]
        return (_kernel.adaptive_runge_kutta(tableau, first, second, monitor, self.conserve) if self.step is None else
                _kernel.runge_kutta(tableau, first, second, monitor))


class RKMK4(RungeKutta, name="rkmk4", order=4, tableau=KUTTA_4, source=f"{_MK}, doi:10.1007/978-3-540-78862-1"): ...
class RKMK54(EmbeddedRungeKutta, name="rkmk54", order=5, tableau=DORMAND_PRINCE_5,
             source=f"{_MK}, doi:10.1016/0771-050X(80)90013-3"): ...
class RKMK853(EmbeddedRungeKutta, name="rkmk853", order=8, tableau=DORMAND_PRINCE_8,
              source=f"{_MK}, doi:10.1007/978-3-540-78862-1"): ...


@dataclasses.dataclass(frozen=True)
class Seulex(Method, name="seulex", controls=("rtol",),
             source=f"{_P1}; extrapolated, doi:10.1007/978-3-642-05221-7"):
    """Extrapolated implicit Euler; rtol as in `DEFAULT_RTOL`."""

    rtol: Tolerance = DEFAULT_RTOL

    def _planned(self, *given: Any) -> _kernel.Run:
        return _kernel.seulex(*given)


@dataclasses.dataclass(frozen=True)
class Taylor(Method, name="taylor", controls=("rtol",), source="doi:10.1080/10586458.2005.10128904"):
    """Taylor series; rtol as in `DEFAULT_RTOL`, conserve as in `EmbeddedRungeKutta`."""

    rtol: Tolerance = DEFAULT_RTOL
    conserve: Flag = False

    def _planned(self, *given: Any) -> _kernel.Run:
        times, rtol, monitor = given
        return _kernel.taylor(times, rtol, monitor, self.conserve)


METHODS: dict[str, type[Method]] = {method.name: method for method in (
    DAE3L_LE, DAE2L_LE, DAE2L_LSE, DAE1L_LSE, DAE3H_LE, DAE2H_LE, DAE2H_LSE, DAE1H_LSE, INDEX1_LE, BAUMGARTE_LE,
    GeneralizedAlpha, Rattle2, Rattle4, Rattle6, Rattle8, RKMK4, RKMK54, RKMK853, Seulex, Taylor)}
"""All methods by name, in the order in which tables list them."""

EULER_METHODS = tuple(METHODS)[:8]
"""The eight methods of [P1], reconstructed: equations (4.1), (4.2) and (4.4) of docs/theory.md."""


def named(name: str, options: dict[str, Any]) -> Method:
    """The method of a name with these options; None is the default of each.

    Raises
    ------
    ArgumentError
        There is no such method, it does not have the option, or a value is wrong.
    """
    if not isinstance(name, str) or name not in METHODS:
        near = difflib.get_close_matches(str(name), METHODS, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise ArgumentError(f"method must be one of {', '.join(METHODS)}, not {name!r}{hint}")
    method, given = METHODS[name], {option: value for option, value in options.items() if value is not None}
    for option, value in given.items():
        if option not in method.options():
            able = ", ".join(other for other, each in METHODS.items() if option in each.options())
            raise ArgumentError(f"{option}={value!r} is for {able or 'no method'}; leave it out with {name}, whose "
                                f"options are {', '.join(method.options())}")
    if "rtol" not in method.controls:
        given.setdefault("step", None)
    return method(**given)


def output_steps(t: np.ndarray, step: float) -> tuple[list[float], list[int]]:
    """Step size and number of steps of every output interval; intervals that differ by rounding share one step size."""
    if (t[-1] - t[0]) / step > MOST_STEPS:
        raise ArgumentError(f"step {step!r} s would take more than {MOST_STEPS:g} steps for {t[-1] - t[0]:g} s")
    intervals = np.diff(t)
    mean = (t[-1] - t[0]) / len(intervals)
    if np.allclose(intervals, mean, rtol=1e-9, atol=0):
        intervals = np.full(len(intervals), mean)
    counts = np.maximum(1, np.ceil(intervals / step * (1 - 1e-12))).astype(int)
    return (intervals / counts).tolist(), counts.tolist()
