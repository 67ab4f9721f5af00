"""`integrate` and `prepare`: the entry points to the methods."""

from __future__ import annotations

import dataclasses
import difflib
import logging
import operator
from typing import Any, NamedTuple

import numpy as np

from lieeuler import _kernel, held
from lieeuler.checks import LARGEST, SMALLEST, number, positive, real
from lieeuler.errors import ArgumentError, IntegrationError, Interrupted
from lieeuler.methods import COORDINATE_MAPS, CORRECTIONS, METHODS, Method
from lieeuler.pieces import Pieces
from lieeuler.planar import Plane
from lieeuler.problem import Problem
from lieeuler.reduction import nodes, reductions, take_multipliers
from lieeuler.solution import STATUSES, Solution, Stats, Status
from lieeuler.spin_free import spin_free_frames, symmetric_bodies
from lieeuler.types import ArrayLike, State

log = logging.getLogger("lieeuler")

MOST_STEPS = 1e12
"""A run of more steps than this is refused as a mistake: it would take weeks."""

DEFAULT_RTOL = 1e-8
"""Tolerance of an adaptive method that is given neither a step nor a tolerance. It is relative to the size of the
system (m), to one radian, and to their rates. The error is proportional to it, but it is not a strict bound."""

NONE_OPEN = (False, False, False)
KEPT = 16
"""How many planned runs a problem keeps."""

RTOL_RANGE = (1e-14, 0.1)
"""Below the first value rounding would control the steps; above the second the motion is not resolved."""


class Arguments(NamedTuple):
    """What `integrate` is given besides the problem and how its events are treated."""

    method: str
    step: float | None = None
    t_eval: ArrayLike | None = None
    rtol: float | None = None
    coordinate_map: str = "exp"
    alpha: float | None = None
    beta: float | None = None
    spectral_radius: float | None = None
    correction: str = "mass"
    spin_free: bool | None = None
    reduce: str | None = None
    conserve: bool = False
    polish: bool = True
    monitor: bool = True


def integrate(problem: Problem, method: str, step: float | None = None, t_eval: ArrayLike | None = None, *,
              rtol: float | None = None, coordinate_map: str = "exp", alpha: float | None = None,
              beta: float | None = None, spectral_radius: float | None = None, correction: str = "mass",
              spin_free: bool | None = None, reduce: str | None = None, conserve: bool = False, polish: bool = True,
              monitor: bool = True, events: bool | None = None) -> Solution:
    """Integrate a problem with a fixed step, or with steps that follow a tolerance.

    One line of level INFO goes to the logger "lieeuler".

    Parameters
    ----------
    problem : Problem
    method : str
        A name in `lieeuler.METHODS`.
    step : float, optional
        s. A step that does not divide an output interval is shortened to the next one that does.
    t_eval : (T,)
        Output times, s, increasing; the first is the time of the initial state.
    rtol : float, optional
        The wanted error (see `DEFAULT_RTOL`), in place of `step`, for methods that have "rtol" among their controls.
    coordinate_map : "exp" | "cayley" | "ccsk"
        Only for the implicit methods and the compositions. From order two on, ccsk is refused: it is not symmetric.
    alpha, beta : float, optional
        Baumgarte gains of BAUMGARTE_LE, 1/s.
    spectral_radius : float, optional
        Of generalized_alpha, default 0.8: 0 damps motions much faster than the step away, 1 keeps them.
    correction : "mass" | "plain"
        The weight of G_n^T mu, which closes the positions, in DAE2L_LSE, DAE1L_LSE and generalized_alpha: M^-1, which
        costs the least kinetic energy, or none (docs/theory.md, section 4).
    spin_free : bool, optional
        Integrate symmetric bodies in frames without their spin (`lieeuler.spin_free`). Euler methods do not by default.
    reduce : "welded" | "planar" | "axis" | "joints" | "off", optional
        Integrate welded bodies as one (`lieeuler.welded`), a mechanism in its plane or about fixed axes
        (`lieeuler.planar`), or an open tree in the coordinates of its joints (`lieeuler.joint_tree`, rkmk methods); the
        multipliers are then those of the index-1 system. Default: all that applies, joints only without a plane; of
        the Euler methods a plane for DAE1L_LSE and DAE1H_LSE, whose steps stay the same, and nothing for the others.
        `solution.stats.reduce` says what was done.
    conserve : bool
        End every step with the energy and angular momentum that free bodies had at the start, in twice the digits: a
        body that turns over about its middle axis then keeps three to five digits more. For taylor, rkmk54 and
        rkmk853 with `rtol`; for a single body it adds 15, 21 and 11 % to their time.
    polish : bool
        Make attitudes rotations again after every step (docs/theory.md, section 3). Only the Euler methods take False.
    monitor : bool
        Evaluate energy, constraint levels and orthogonality after every step (`stats.maxima`), not only at the end.
    events : bool, optional
        For problems with laws: whether the times at which friction, servos and stops change are solved for. Otherwise
        changes are taken at ends of steps, those at stops excepted. Default: not by the Euler methods.

    Returns
    -------
    Solution
        Its status is SUCCESS, or CONSTRAINTS_OPEN if a constraint level that the method should hold is open.

    Raises
    ------
    ArgumentError
        An argument is wrong.
    IntegrationError, Interrupted
        The run failed, or was interrupted by Ctrl-C; the error holds the trajectory so far.
    """
    if not (events is None or isinstance(events, bool)):
        raise ArgumentError(f"events must be True or False, not {events!r}")
    arguments = Arguments(method, step, t_eval, rtol, coordinate_map, alpha, beta, spectral_radius, correction,
                          spin_free, reduce, conserve, polish, monitor)
    if isinstance(problem, Problem) and problem.laws:
        return _by_pieces(problem, arguments, events)
    return _kept(problem, arguments)()


def _by_pieces(problem: Problem, arguments: Arguments, events: bool | None) -> Solution:
    """The run of a problem with laws."""
    without = PreparedRun(Problem.unchecked(problem, laws=()), arguments)  # checks the arguments
    method, step, t = arguments[:3]
    # Adaptive pieces have few steps, and reductions are planned for each; the multipliers that say which joints rest
    # are those of all rows.
    if arguments.reduce is None and (step is None or METHODS[arguments.method].order == 1):
        arguments = arguments._replace(reduce="off")

    def solve(piece: Problem, times: np.ndarray) -> Solution:
        size = None if step is None else float(np.diff(times).max())
        return PreparedRun(piece, arguments._replace(step=size, t_eval=times)).unjudged()

    def start(piece: Problem, times: np.ndarray) -> Solution:
        return PreparedRun(piece, Arguments("INDEX1_LE", float(times[1] - times[0]), times, reduce="off",
                                            monitor=False)).unjudged()

    located = METHODS[method].order != 1 if events is None else events
    solution = Pieces(problem, solve, start, np.asarray(t, dtype=float), step, located).integrate()
    return without.ended(without.closed(solution))


def prepare(problem: Problem, method: str, step: float | None = None, t_eval: ArrayLike | None = None, *,
            rtol: float | None = None, coordinate_map: str = "exp", alpha: float | None = None,
            beta: float | None = None, spectral_radius: float | None = None, correction: str = "mass",
            spin_free: bool | None = None, reduce: str | None = None, conserve: bool = False, polish: bool = True,
            monitor: bool = True) -> PreparedRun:
    """Check the arguments of `integrate`, plan the run, and return it, ready to be called any number of times.

    Raises
    ------
    ArgumentError
        An argument is wrong.
    """
    return PreparedRun(problem, Arguments(method, step, t_eval, rtol, coordinate_map, alpha, beta, spectral_radius,
                                          correction, spin_free, reduce, conserve, polish, monitor))


class PreparedRun:
    """A run of one problem by one method over given times: `run()` from the problem's state, `run(x=, R=, v=, w=)` from
    another one.

    Its solutions are those of `integrate`. Where a reduction or a frame without spin depends on the state, a call with
    a state plans anew, unless the state lies in the plane of the first one; it then keeps the axes of that one, and the
    solution is the same to rounding, with `rtol` within its error.
    """

    def __init__(self, problem: Problem, arguments: Arguments) -> None:
        self._arguments, method, reduce = arguments, arguments.method, arguments.reduce
        if isinstance(problem, Problem) and problem.laws:
            raise ArgumentError("runs of problems with laws are not prepared; call integrate")
        self._plan = plan = plan_run(problem, arguments)
        if any(joint.drive for joint in problem.joints) and plan.t[0] != problem.time:
            problem.check_closed(float(plan.t[0]))
        self.problem, self.method = problem, method
        self._steps = reductions(problem, METHODS[method], reduce, arguments.coordinate_map)
        within = self._steps[-1].problem if self._steps else problem
        self._frames = spin_free_frames(within) if plan.spin_free else None
        tree = nodes(within, self._steps, reduce, plan.run.knows_joints and self._frames is None)
        for node in tree:
            node.add_to(plan.run)
        words = [step.word for step in self._steps] + ["joints"] * bool(tree)
        self._word = (reduce or ", ".join(words)) if words else "off"
        self._kernel, w = (within.kernel, within.w) if self._frames is None else (self._frames.kernel, self._frames.w)
        self._start = within.x, within.R, within.v, w
        T, n = len(plan.t), within.n
        self._shapes = (5, T, n, 3), (T, n, 3, 3), (T, within.rows), (T, self._kernel.angles)
        self._begin, self._restored = float(plan.t[0]), bool(self._steps) or self._frames is not None
        self._held = [level in METHODS[method].held for level in ("position", "velocity", "acceleration")]
        record, pairs = METHODS[method], {(joint.parent, joint.child) for joint in problem.joints}
        leaves_nothing_out = not record.reduced(arguments.coordinate_map) if reduce is None else reduce == "off"
        balls = len(pairs) == len(problem.joints) and all(joint.ball for joint in problem.joints)
        self._plane: Plane | None = None  # of every state in it, unless spins decide
        if len(self._steps) == 1 and isinstance(plane := self._steps[0], Plane):
            turning = Problem.unchecked(within, w=np.tile([0.0, 0.0, 1.0], (n, 1)))
            self._plane = None if plan.spin_free and spin_free_frames(turning) else plane
        self._state_decides = not (leaves_nothing_out or balls) or (plan.spin_free and bool(symmetric_bodies(problem)))

    def __call__(self, x: Any = None, R: Any = None, v: Any = None, w: Any = None) -> Solution:
        """Integrate from the problem's state, of which each part may be replaced; arrays as in `Problem`.

        Raises
        ------
        ArgumentError
            The state is not one of numbers, rotations and closed joints.
        IntegrationError, Interrupted
            As in `integrate`.
        """
        own, solution = self.problem, None
        if x is None and R is None and v is None and w is None:
            solution = self._solved(self._start, False)
        else:
            start: State | None = _plain(x, own.x), _plain(R, own.R), _plain(v, own.v), _plain(w, own.w)
            if start and self._state_decides:
                start = self._plane.entered(self._begin, *start) if self._plane else None
            if start:
                solution = self._solved(start, True)
        if solution is not None:
            return self.ended(solution)
        x, R, v, w = (mine if value is None else value
                      for mine, value in zip((own.x, own.R, own.v, own.w), (x, R, v, w), strict=True))
        return PreparedRun(dataclasses.replace(own, x=x, R=R, v=v, w=w, time=self._begin), self._arguments)()

    def _solved(self, start: State, checks: bool) -> Solution | None:
        """The solution of the kernel, with welds, planes and spins put back; None if the start is not admissible."""
        plan, (of_vectors, of_R, of_lam, of_angles) = self._plan, self._shapes
        vectors, R, lam, angles = np.empty(of_vectors), np.empty(of_R), np.empty(of_lam), np.empty(of_angles)
        result = _kernel.integrate(self._kernel, plan.run, *start, checks, vectors, R, lam, angles)
        if result is None:
            return None
        status, count, reached, wall_time, counters, maxima, opened = result
        t = plan.t.copy()
        if count < len(t):
            vectors, R, lam, angles, t = vectors[:, :count], R[:count], lam[:count], angles[:count], t[:count]
        x, v, w, a, alpha = vectors
        stats = Stats(*counters, plan.step, wall_time, _named(*maxima) if self._arguments.monitor else {})
        solution = Solution(t, x, R, v, w, a, alpha, lam, STATUSES[status], stats, self.method,
                            self._begin + reached)
        if self._frames is not None:
            self._frames.restore(t, solution.R, solution.w, solution.alpha)
            stats.spin_free = self._frames.bodies
        for step in reversed(self._steps):
            angles = step.restore(solution, angles)
        if self._word != "off":
            take_multipliers(self.problem, solution, angles)
            stats.reduce = self._word
        return self.closed(solution, None if self._restored else opened)

    def closed(self, solution: Solution, opened: tuple[bool, bool, bool] | None = None) -> Solution:
        """The solution, whose status says whether a level that the method holds is open, which may be known."""
        if solution.status is Status.SUCCESS:
            if opened is None:
                opened = held.opened(self.problem, solution)
            if opened != NONE_OPEN and any(map(operator.and_, self._held, opened)):
                solution.status = Status.CONSTRAINTS_OPEN
        return solution

    def unjudged(self) -> Solution:
        """The solution from the problem's state, also where the run failed."""
        solution = self._solved(self._start, checks=False)
        assert solution is not None  # only a start that is checked may be refused
        return solution

    def ended(self, solution: Solution) -> Solution:
        """The solution, logged; raises if the trajectory is not complete."""
        log.info("%s", solution)
        status = solution.status
        if status is Status.SUCCESS or status is Status.CONSTRAINTS_OPEN:
            return solution
        if status is Status.INTERRUPTED:
            raise Interrupted(solution)
        advice = status.advice
        if status is Status.MAP_DOMAIN and self._arguments.coordinate_map == "ccsk":
            advice += ", or coordinate_map='exp'"
        raise IntegrationError(status, advice, solution)


def _plain(value: np.ndarray | None, own: np.ndarray) -> np.ndarray:
    """The array as the kernel takes it, by default `own`; the kernel checks the values."""
    if value is None:
        return own
    if type(value) is np.ndarray and value.dtype == own.dtype and value.shape == own.shape and value.flags.c_contiguous:
        return value
    found = real(value)
    return np.full_like(own, np.nan) if found is None or found.shape != own.shape else found


def _named(energy_error: float, kinetic: float, position: float, velocity: float, acceleration: float,
           orthogonality: float) -> dict[str, float]:
    """The maxima of the kernel by name; that of the energy's error over that of the kinetic energy."""
    if 0 < kinetic < np.inf:
        energy_error /= kinetic
    return {"energy_error": energy_error, "kinetic": kinetic, "constraint_position": position,
            "constraint_velocity": velocity, "constraint_acceleration": acceleration, "orthogonality": orthogonality}


def _kept(problem: Problem, arguments: Arguments) -> PreparedRun:
    """The run of these arguments, planned once and kept with the problem."""
    t_eval = arguments.t_eval
    if not isinstance(problem, Problem) or type(t_eval) is not np.ndarray or t_eval.dtype != float:
        return PreparedRun(problem, arguments)
    known: dict[object, PreparedRun] = vars(problem).setdefault("_runs", {})
    key = (arguments[:2], arguments[3:], tuple(map(type, arguments)), t_eval.shape, t_eval.tobytes())
    try:
        run = known.get(key)
    except TypeError:  # an argument that cannot be hashed is wrong, and is named below
        return PreparedRun(problem, arguments)
    if run is None:
        run = PreparedRun(problem, arguments)
        if len(known) >= KEPT:
            known.pop(next(iter(known)))
        known[key] = run
    return run


@dataclasses.dataclass(frozen=True)
class Plan:
    """A method with all its arguments checked.

    Attributes
    ----------
    run : what the kernel runs
    t : (T,) output times, s
    step : the largest step used, s; None if the method chooses its steps
    spin_free : whether to integrate symmetric bodies in spin-free frames
    """

    run: _kernel.Run
    t: np.ndarray
    step: float | None
    spin_free: bool


def plan_run(problem: Problem, arguments: Arguments) -> Plan:
    """Check the arguments of a run, which `integrate` describes, and make the kernel's run of them."""
    (method, step, t_eval, rtol, coordinate_map, alpha, beta, spectral_radius, correction, spin_free, _, conserve,
     polish, monitor) = arguments
    if not isinstance(problem, Problem):
        raise ArgumentError(f"problem must be a lieeuler.Problem, not {problem!r}")
    for name, value in (("spin_free", spin_free), ("conserve", conserve), ("polish", polish), ("monitor", monitor)):
        if not (isinstance(value, bool) or (value is None and name == "spin_free")):
            raise ArgumentError(f"{name} must be True or False, not {value!r}")
    record = _method(method)
    if not isinstance(coordinate_map, str) or coordinate_map not in COORDINATE_MAPS:
        raise ArgumentError(f"coordinate_map must be one of {', '.join(COORDINATE_MAPS)}, not {coordinate_map!r}")
    if refused := record.refused_map(coordinate_map):
        raise ArgumentError(refused)
    if not polish and (record.order != 1 or record.formulation == "index1"):
        raise ArgumentError(f"{method} always polishes its attitudes; polish=False is for the Euler methods")
    if not isinstance(correction, str) or correction not in CORRECTIONS:
        raise ArgumentError(f"correction must be one of {', '.join(CORRECTIONS)}, not {correction!r}")
    if correction != "mass" and not record.corrects:
        able = ", ".join(name for name, other in METHODS.items() if other.corrects)
        raise ArgumentError(f"correction={correction!r} is for {able}; leave it out with {method}")
    gains, radius = _options(record, alpha, beta, spectral_radius)
    t = _output_times(t_eval)
    tolerance = _tolerance(record, step, rtol)
    if conserve and (tolerance is None or not record.conserves):
        able = ", ".join(name for name, other in METHODS.items() if other.conserves)
        raise ArgumentError(f"conserve=True is for {able} with rtol; leave it out")
    spins = ("rtol" in record.controls or record.order != 1) if spin_free is None else spin_free
    if tolerance is not None:
        given = [(t - t[0]).tolist(), tolerance, monitor, *([conserve] if record.conserves else [])]
        run = (_kernel.adaptive_runge_kutta(record.tableau.kernel, *given) if record.tableau else
               getattr(_kernel, method)(*given))
        run.begin = float(t[0])
        return Plan(run, t, None, spins)
    assert step is not None  # _tolerance raises without step and rtol
    steps, counts = _steps(t, step)
    if record.tableau is not None:
        run = _kernel.runge_kutta(record.tableau.kernel, steps, counts, monitor)
    else:
        rule = _kernel.Method(_kernel.Formulation[record.formulation], _kernel.Level[record.level],
                              record.index1_output, *gains, record.composition, radius, polish,
                              _kernel.Correction[correction])
        run = _kernel.implicit(_kernel.CoordinateMap[coordinate_map], rule, steps, counts, monitor)
    run.begin = float(t[0])
    return Plan(run, t, max(steps), spins)


def _method(name: str) -> Method:
    if not isinstance(name, str) or name not in METHODS:
        near = difflib.get_close_matches(str(name), METHODS, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise ArgumentError(f"method must be one of {', '.join(METHODS)}, not {name!r}{hint}")
    return METHODS[name]


def _options(method: Method, alpha: float | None, beta: float | None,
             spectral_radius: float | None) -> tuple[tuple[float, float], float | None]:
    """The gains and the spectral radius for a method; raises if they are given to a method without them."""
    if method.gains is None and (alpha is not None or beta is not None):
        raise ArgumentError(f"alpha and beta belong to BAUMGARTE_LE; {method.name} has no gains")
    if method.spectral_radius is None and spectral_radius is not None:
        raise ArgumentError(f"spectral_radius belongs to generalized_alpha; {method.name} has none")
    first, second = method.gains or (0.0, 0.0)
    gains = (first if alpha is None else number("alpha", alpha, lowest=0.0),
             second if beta is None else number("beta", beta, lowest=0.0))
    radius = method.spectral_radius
    if spectral_radius is not None:
        radius = number("spectral_radius", spectral_radius, lowest=0.0)
        if radius > 1:
            raise ArgumentError(f"spectral_radius must lie between 0 and 1, not {spectral_radius!r}")
    return gains, radius


def _tolerance(method: Method, step: float | None, rtol: float | None) -> float | None:
    """The tolerance of an adaptive run, None for a fixed step."""
    if step is not None and rtol is not None:
        raise ArgumentError("give step or rtol, not both")
    if step is not None:
        if "step" not in method.controls:
            raise ArgumentError(f"{method.name} chooses its steps; give rtol in place of step")
        return None
    if "rtol" not in method.controls:
        raise ArgumentError(f"step must be a number, s: {method.name} does not follow a tolerance")
    value = positive("rtol", DEFAULT_RTOL if rtol is None else rtol)
    if not RTOL_RANGE[0] <= value <= RTOL_RANGE[1]:
        raise ArgumentError(f"rtol must lie between {RTOL_RANGE[0]:g} and {RTOL_RANGE[1]:g}, not {value!r}")
    return value


def _output_times(t_eval: ArrayLike | None) -> np.ndarray:
    if t_eval is None:
        raise ArgumentError("t_eval is missing: at least two increasing output times, s")
    t = real(t_eval)
    if t is None or t.ndim != 1 or len(t) < 2 or not np.isfinite(t).all() or not (t[1:] > t[:-1]).all():
        raise ArgumentError("t_eval must hold at least two finite, increasing times")
    if max(-t[0], t[-1]) > LARGEST or np.diff(t).min() < SMALLEST:
        raise ArgumentError(f"t_eval must lie below {LARGEST:g} s, with intervals above {SMALLEST:g} s")
    return t


def _steps(t: np.ndarray, step: float) -> tuple[list[float], list[int]]:
    """Step size and number of steps of every output interval; intervals that differ by rounding share one step size."""
    step = positive("step", step)
    if (t[-1] - t[0]) / step > MOST_STEPS:
        raise ArgumentError(f"step {step!r} s would take more than {MOST_STEPS:g} steps for {t[-1] - t[0]:g} s")
    intervals = np.diff(t)
    mean = (t[-1] - t[0]) / len(intervals)
    if np.allclose(intervals, mean, rtol=1e-9, atol=0):
        intervals = np.full(len(intervals), mean)
    counts = np.maximum(1, np.ceil(intervals / step * (1 - 1e-12))).astype(int)
    return (intervals / counts).tolist(), counts.tolist()
