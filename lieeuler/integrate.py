"""`integrate` and `prepare`: the entry points to the methods."""

from __future__ import annotations

import dataclasses
import functools
import logging
from typing import Any

import numpy as np

from lieeuler import _kernel
from lieeuler.checks import LARGEST, SMALLEST, real
from lieeuler.errors import ArgumentError
from lieeuler.joint_tree import Node, joint_tree
from lieeuler.laws import Law
from lieeuler.methods import LEVELS, Method, Taylor, named
from lieeuler.pieces import Pieces
from lieeuler.planar import Plane, plane_of
from lieeuler.problem import CLOSED, Problem, raise_own
from lieeuler.reduced import Reduced
from lieeuler.solution import STATUSES, IntegrationError, Interrupted, Solution, Stats, Status
from lieeuler.spin_free import spin_free_frames, symmetric_bodies
from lieeuler.types import ArrayLike, State
from lieeuler.welded import welded_for

log = logging.getLogger("lieeuler")
DOUBLE = np.dtype(float)
WORDS = ("welded", "planar", "axis", "joints", "off")
"""Those of `integrate(reduce=...)`."""

MOST_NODES = 2
"""Joint coordinates pay up to so many nodes a body: measured on bodies in a plane, which have three."""


def integrate(problem: Problem, method: Method | str, step: Any = None, t_eval: ArrayLike | None = None, *,
              spin_free: bool | None = None, reduce: str | None = None, monitor: bool = True,
              events: bool | None = None, **options: Any) -> Solution:
    """Integrate a problem: `integrate(problem, DAE1L_LSE(step=1e-3), t_eval)`, or by the method's name and its options,
    `integrate(problem, "DAE1L_LSE", step=1e-3, t_eval=t_eval)`.

    One line of level INFO goes to the logger "lieeuler".

    Parameters
    ----------
    problem : Problem
    method : Method or str
        With its options, as `lieeuler.methods` lists them; or a name in `lieeuler.METHODS`, whose options are `step`
        and `options`.
    t_eval : (T,)
        Output times, s, increasing; the first is the time of the initial state. After a Method the third argument.
    spin_free : bool, optional
        Integrate symmetric bodies in frames without their spin (`lieeuler.spin_free`). Euler methods do not by default.
    reduce : "welded" | "planar" | "axis" | "joints" | "off", optional
        Integrate welded bodies as one (`lieeuler.welded`), a mechanism in its plane or about fixed axes
        (`lieeuler.planar`), or an open tree in the coordinates of its joints (`lieeuler.joint_tree`, rkmk methods); the
        multipliers are then those of the index-1 system. Default: all that applies, joints only without a plane; of
        the Euler methods a plane for DAE1L_LSE and DAE1H_LSE, whose steps stay the same, and nothing for the others.
        `solution.stats.reduce` says what was done.
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
    if isinstance(problem, Problem) and problem.laws:
        run = _planned(Problem.unchecked(problem, laws=()), method, step, t_eval, spin_free, reduce, monitor, options)
        return _by_pieces(run, problem.laws, events)
    return _planned(problem, method, step, t_eval, spin_free, reduce, monitor, options)()


def _by_pieces(run: PreparedRun, laws: tuple[Law, ...], events: bool | None) -> Solution:
    """The run of a problem with laws; `run` is that of the problem without."""
    method, options, step = run.method, dict(run.options), getattr(run.method, "step", None)
    # Adaptive pieces have few steps, and reductions are planned for each; the multipliers that say which joints rest
    # are those of all rows.
    if options["reduce"] is None and (step is None or method.order == 1):
        options["reduce"] = "off"

    def solve(piece: Problem, times: np.ndarray) -> Solution:
        sized = method if step is None else dataclasses.replace(method, **{"step": float(np.diff(times).max())})
        return PreparedRun(piece, sized, times, **options).unjudged()

    located = method.order != 1 if events is None else events
    problem = Problem.unchecked(run.problem, laws=laws)
    solution = Pieces(problem, solve, run.t, step, located).integrate()
    if any(level in method.held and is_open for level, is_open in zip(LEVELS, opened(run.problem, solution),
                                                                      strict=True)):
        solution.status = Status.CONSTRAINTS_OPEN
    return run.ended(solution)


def opened(problem: Problem, solution: Solution) -> tuple[bool, bool, bool]:
    """Which levels a solution leaves open beyond their bounds (`lieeuler/_core/python/levels.hpp`): of all steps, or of
    the last state if the run was not monitored."""
    if not problem.joints:
        return False, False, False
    duration, maxima = float(solution.t[-1] - solution.t[0]), solution.stats.maxima
    if maxima:
        return _kernel.open_levels(
            problem.kernel, solution.x, solution.v, solution.w, solution.a, solution.alpha, solution.lam,
            maxima["constraint_position"], maxima["constraint_velocity"], maxima["constraint_acceleration"],
            maxima["kinetic"], duration)
    x, R, v, w = (getattr(solution, name)[-1:] for name in "xRvw")
    position, velocity = _kernel.constraint_levels(problem.kernel, x, R, v, w, float(solution.t[-1]), duration)[0]
    return not position <= CLOSED, not velocity <= CLOSED, False


def prepare(problem: Problem, method: Method | str, step: Any = None, t_eval: ArrayLike | None = None, *,
            spin_free: bool | None = None, reduce: str | None = None, monitor: bool = True,
            **options: Any) -> PreparedRun:
    """Check the arguments of `integrate`, plan the run, and return it, ready to be called any number of times.

    The problem keeps its last runs, so that the same arguments give the same run.

    Raises
    ------
    ArgumentError
        An argument is wrong.
    """
    return _planned(problem, method, step, t_eval, spin_free, reduce, monitor, options)


def _planned(problem: Problem, method: Method | str, step: Any, t_eval: ArrayLike | None, spin_free: bool | None,
             reduce: str | None, monitor: bool, options: dict[str, Any]) -> PreparedRun:
    """The run of these arguments of `integrate`; to pass on options by name takes a tenth of a short call."""
    t = step if t_eval is None else t_eval
    if not isinstance(problem, Problem) or type(t) is not np.ndarray or t.dtype is not DOUBLE:
        return PreparedRun(problem, *chosen(method, step, t_eval, options), spin_free, reduce, monitor)
    key = (method, None if t is step else step, spin_free, reduce, monitor, type(step), *options.items(),
           *map(type, options.values()), t.shape, t.tobytes())
    try:
        run: PreparedRun | None = problem.kept.get(key)
    except TypeError:  # an argument that cannot be hashed is wrong, and is named below
        run = None
    return run or problem.keep(key, PreparedRun(problem, *chosen(method, step, t_eval, options), spin_free, reduce,
                                                monitor))


def chosen(method: Method | str, step: Any, t_eval: ArrayLike | None,
           options: dict[str, Any]) -> tuple[Method, ArrayLike | None]:
    """The method of these arguments of `integrate`, and the output times.

    Raises
    ------
    ArgumentError
        There is no such method, or it does not take these options.
    """
    if not isinstance(method, Method):
        return named(method, {"step": step, **options}), t_eval
    if options or (step is not None and t_eval is not None):
        raise ArgumentError(f"the options of {method!r} are its own; leave out {', '.join(options) or 'step'}")
    return method, step if t_eval is None else t_eval


def reductions(problem: Problem, method: Method, wanted: str | None) -> list[Reduced]:
    """What a method leaves out of a problem, the first step first; by default what applies of `Method.reduced`.

    Raises
    ------
    ArgumentError
        The wanted word is not known, or does not apply.
    """
    if not (wanted is None or (isinstance(wanted, str) and wanted in WORDS)):
        raise ArgumentError(f"reduce must be one of {', '.join(WORDS)}, not {wanted!r}")
    words = {wanted} if wanted else {*method.reduced}
    welded = welded_for(problem) if words & {"welded", "joints"} else None
    steps: list[Reduced] = [welded] if welded else []
    if wanted == "welded" and not steps:
        raise ArgumentError("reduce='welded' does not apply: no two bodies are welded, joints are open at the start, "
                            "or a weld, joint or force ties a body to one that it is welded to")
    if words & {"planar", "axis"}:
        plane = plane_of(steps[-1].problem if steps else problem, method.name == "taylor")
        if isinstance(plane, Plane) and wanted == "axis" != plane.word:
            plane = "its bodies do not all turn about axes fixed in the ground"
        if isinstance(plane, Plane):
            steps.append(plane)
        elif wanted:
            raise ArgumentError(f"reduce={wanted!r} does not apply: {plane}")
    return steps


def nodes(problem: Problem, steps: list[Reduced], wanted: str | None, able: bool) -> tuple[Node, ...]:
    """The tree of joints that is integrated: by default one with few nodes, where no plane serves.

    able: whether the run can take joint coordinates.

    Raises
    ------
    ArgumentError
        The tree is wanted, but there is none.
    """
    if wanted not in (None, "joints") or any(step.word != "welded" for step in steps):
        return ()
    tree = joint_tree(problem) if able else ()
    if wanted is None and len(tree) > MOST_NODES * problem.n:
        return ()
    if wanted and not tree:
        raise ArgumentError("reduce='joints' does not apply: it is for explicit Runge-Kutta methods on open trees that "
                            "hang on the ground, of joints that are not driven, do not roll and follow no other")
    return tree


class PreparedRun:
    """A run of one problem by one method over given times: `run()` from the problem's state, `run(x=, R=, v=, w=)` from
    another one.

    Its solutions are those of `integrate`. Where a reduction or a frame without spin depends on the state, a call with
    a state plans anew, unless the state lies in the plane of the first one; it then keeps the axes of that one, and the
    solution is the same to rounding, with `rtol` within its error.
    """

    def __init__(self, problem: Problem, method: Method, t_eval: ArrayLike | None, spin_free: bool | None = None,
                 reduce: str | None = None, monitor: bool = True) -> None:
        if not isinstance(problem, Problem):
            raise ArgumentError(f"problem must be a lieeuler.Problem, not {problem!r}")
        for name, value in (("spin_free", spin_free), ("monitor", monitor)):
            if not (isinstance(value, bool) or (value is None and name == "spin_free")):
                raise ArgumentError(f"{name} must be True or False, not {value!r}")
        if problem.laws:
            raise ArgumentError("runs of problems with laws are not prepared; call integrate")
        self.problem, self.method, self.t = problem, method, output_times(t_eval)
        self.options: dict[str, Any] = {"spin_free": spin_free, "reduce": reduce, "monitor": monitor}
        if problem.custom:
            if isinstance(method, Taylor) or spin_free or reduce not in (None, "off"):
                raise ArgumentError("a CustomForce has no series and no symmetry that is known: taylor, reductions and "
                                    "spin-free frames do not go with it; take rkmk853, and leave out reduce and "
                                    "spin_free")
            spin_free, reduce = False, "off"
        self.compiled, self._step = method.run(self.t, monitor)
        self._begin = float(self.t[0])
        if any(joint.drive for joint in problem.joints) and self._begin != problem.time:
            problem.check_closed(self._begin)
        spin_free = method.spin_free if spin_free is None else spin_free
        steps = reductions(problem, method, reduce)
        within = steps[-1].problem if steps else problem
        frames = spin_free_frames(within) if spin_free else None
        tree = nodes(within, steps, reduce, self.compiled.knows_joints and frames is None)
        for node in tree:
            self.compiled.add_node(*node)
        words = [step.word for step in steps] + ["joints"] * bool(tree)
        self._word = (reduce or ", ".join(words)) if words else "off"
        self._plane: Plane | None = None  # of every state in it, unless spins decide
        if len(steps) == 1 and isinstance(steps[0], Plane):
            turning = Problem.unchecked(within, w=np.tile([0.0, 0.0, 1.0], (within.n, 1)))
            self._plane = None if spin_free and spin_free_frames(turning) else steps[0]
        self._spinning: tuple[int, ...] = ()
        if frames:
            spins = functools.reduce(lambda spins, step: spins[step.body], reversed(steps), frames.spins)
            self._spinning = tuple(np.flatnonzero(spins.any(axis=1)).tolist())
            steps.append(frames)
        for each in steps:
            each.add_to(self.compiled)
            within = each.problem
        self.compiled.fewer_rows = bool(words)
        self.compiled.held = sum(1 << k for k, level in enumerate(LEVELS) if level in method.held)
        self.kernels, self.start = (problem.kernel, within.kernel), (within.x, within.R, within.v, within.w)
        self.compiled.start_from(within.kernel, self.t, *self.start)
        T, n = len(self.t), problem.n
        self._shapes = (5, T, n, 3), (T, n, 3, 3), (T, problem.rows)
        pairs = {(joint.parent, joint.child) for joint in problem.joints}
        whole = not method.reduced if reduce is None else reduce == "off"
        balls = len(pairs) == len(problem.joints) and all(joint.ball for joint in problem.joints)
        self.state_decides = not (whole or balls) or (spin_free and bool(symmetric_bodies(problem)))

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
            solution = self._solved(None)
        else:
            start: State | None = _plain(x, own.x), _plain(R, own.R), _plain(v, own.v), _plain(w, own.w)
            if start and self.state_decides:
                start = self._plane.entered(self._begin, *start) if self._plane else None
            if start:
                solution = self._solved(start)
        if solution is not None:
            return self.ended(solution)
        x, R, v, w = (mine if value is None else value
                      for mine, value in zip((own.x, own.R, own.v, own.w), (x, R, v, w), strict=True))
        return PreparedRun(dataclasses.replace(own, x=x, R=R, v=v, w=w, time=self._begin), self.method, self.t,
                           **self.options)()

    def _solved(self, start: State | None) -> Solution | None:
        """The solution of the kernel, from its own start or another one; None if that is not admissible."""
        vectors, R, lam = map(np.empty, self._shapes)
        result = _kernel.integrate(*self.kernels, self.compiled, start, vectors, R, lam)
        if self.problem.custom:
            raise_own(self.problem)
        if result is None:
            return None
        word, count, t_end, wall_time, counters, maxima = result
        t = self.t.copy()
        if count < len(t):
            vectors, R, lam, t = vectors[:, :count], R[:count], lam[:count], t[:count]
        x, v, w, a, alpha = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]  # quicker than by iteration
        most = _named(*maxima) if self.options["monitor"] else {}
        stats = Stats(*counters, self._step, wall_time, most, self._spinning, self._word)
        if self.problem.custom:
            stats.maxima.pop("energy_error", None)
        return Solution(t, x, R, v, w, a, alpha, lam, STATUSES[word], stats, self.method.name, t_end, (),
                        functools.partial(self._between, start) if self._step is None else None)

    def _between(self, start: State | None, times: np.ndarray) -> Solution:
        """The run from a start of the kernel at other times."""
        t = np.unique(np.concatenate([self.t[:1], times, self.t[-1:]]))
        found = PreparedRun(self.problem, self.method, t, **self.options)._solved(start)
        assert found is not None  # it was admissible before
        rows = np.searchsorted(t, times)
        return dataclasses.replace(found, **{name: getattr(found, name)[rows] for name in (
            "t", "x", "R", "v", "w", "a", "alpha", "lam")})

    def unjudged(self) -> Solution:
        """The solution from the problem's state, also where the run failed."""
        solution = self._solved(None)
        assert solution is not None  # its own start is not refused
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
        if status is Status.MAP_DOMAIN and getattr(self.method, "map", "exp") == "ccsk":
            advice += ", or map='exp'"
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


def output_times(t_eval: ArrayLike | None) -> np.ndarray:
    if t_eval is None:
        raise ArgumentError("t_eval is missing: at least two increasing output times, s")
    t = real(t_eval)
    if t is None or t.ndim != 1 or len(t) < 2 or not np.isfinite(t).all() or not (t[1:] > t[:-1]).all():
        raise ArgumentError("t_eval must hold at least two finite, increasing times")
    if max(-t[0], t[-1]) > LARGEST or np.diff(t).min() < SMALLEST:
        raise ArgumentError(f"t_eval must lie below {LARGEST:g} s, with intervals above {SMALLEST:g} s")
    return t
