"""Calls of the kernel's entry points with odd arguments: good systems and options, a few things of them changed."""

from __future__ import annotations

import contextlib
import fractions
import functools
import inspect
import signal
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import numpy as np

import lieeuler
from tests.lieeuler.systems import SYSTEMS, spring_chain

EXTREME = (0.0, -0.0, 5e-324, 1e-310, 1e-200, 1e-60, 1e60, 1e99, 1e101, 1e200, 1e300, -1e300, 1.7e308, np.nan, np.inf,
           -np.inf)
ODD = (None, "abc", "1", b"1", [], {}, True, 1j, 10**400, fractions.Fraction(1, 3), np.float32(0.25), object(),
       [[1.0], [2.0, 3.0]], np.datetime64("2020-01-01"), np.ma.masked, np.zeros((0, 3)))
PROBLEMS = (*(make() for make in SYSTEMS.values()), spring_chain(3))
JOINTS = (lieeuler.spherical_joint, lieeuler.universal_joint, lieeuler.revolute_joint, lieeuler.cylindrical_joint,
          lieeuler.prismatic_joint, lieeuler.planar_joint, lieeuler.fixed_joint, lieeuler.distance_joint,
          lieeuler.point_on_line_joint, lieeuler.point_on_plane_joint)
FORCES = (lieeuler.LinearSpring, lieeuler.TorsionalSpring, lieeuler.ConstantLoad)
METHODS = tuple(sorted(lieeuler.METHODS))


FIELDS = ("x", "R", "v", "w", "a", "alpha", "lam")
"""Arrays of a solution."""


def judged(make: Callable[[], lieeuler.Problem], **options: Any) -> lieeuler.Solution | None:
    """A run's solution, None where an argument was refused. What was sampled must be finite, however the run ended."""
    try:
        solution = lieeuler.integrate(make(), **options)
    except lieeuler.ArgumentError:
        return None
    except (lieeuler.IntegrationError, lieeuler.Interrupted) as ended:
        solution = ended.solution
    assert all(np.isfinite(getattr(solution, name)).all() for name in FIELDS), solution.status
    assert not any(np.isnan(value) for value in solution.stats.maxima.values()), solution.status
    return solution


@contextlib.contextmanager
def patience(seconds: float) -> Iterator[None]:
    """After so much computing a call is interrupted: odd numbers may ask for any number of steps.

    Not by the clock: on a busy machine that time may pass before the call has begun.
    """
    before = signal.signal(signal.SIGPROF, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_PROF, seconds, seconds)  # again, in case the first is lost in a callback
    try:
        yield
    except KeyboardInterrupt:  # before or after the run, which answers with its solution
        pass
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def case(random: Random) -> tuple[Callable[[], lieeuler.Problem], dict[str, Any]]:
    """A function that makes a problem, which may be refused, and the arguments of `integrate`."""
    problem = random.choice(PROBLEMS)
    fields = {name: functools.partial(getattr, problem, name)
              for name in ("bodies", "joints", "gravity", "x", "R", "v", "w", "forces")}
    if random.random() < 0.4:  # at rest, where a joint that is closed holds in velocity too
        fields["v"] = fields["w"] = lambda: np.zeros((problem.n, 3))
    method = random.choice(METHODS)
    control = {"step": random.choice((1e-2, 1e-3))} if "step" in lieeuler.METHODS[method].controls else {}
    options = {"method": method, "t_eval": np.linspace(0, 0.1, 3), **control}
    for _ in range(random.randint(1, 3)):
        change = random.choice((_change_state, _change_body, _add_joint, _add_force, _change_option))
        change(random, problem, fields, options)
    return lambda: lieeuler.Problem(**{name: make() for name, make in fields.items()}), options


def layouts(values: np.ndarray) -> tuple[Any, ...]:
    """The same numbers, laid out or typed differently in memory."""
    spread = np.zeros((2 * values.shape[0], *values.shape[1:]))
    spread[::2] = values
    read_only = values.copy()
    read_only.setflags(write=False)
    return (np.asfortranarray(values), spread[::2], read_only, values.astype(object), values.tolist(),
            values[::-1].copy()[::-1], values.astype(">f8"))


def number(random: Random) -> float:
    """Mostly of a usual size; now and then any double."""
    return random.choice(EXTREME) if random.random() < 0.2 else random.gauss(0, 1) * 10.0 ** random.randint(-8, 8)


def _change_state(random: Random, problem: lieeuler.Problem, fields: dict, options: dict) -> None:
    name = random.choice(("gravity", "x", "R", "v", "w"))
    values = getattr(problem, name).copy()
    if random.random() < 0.6:
        values.flat[random.randrange(values.size)] = number(random)
    others = (*ODD, values.ravel(), values[:0]) if random.random() < 0.2 else layouts(values)
    changed = random.choice(others)
    fields[name] = lambda: changed


def _change_body(random: Random, problem: lieeuler.Problem, fields: dict, options: dict) -> None:
    place, mass, moment = random.randrange(problem.n), abs(number(random)), abs(number(random))
    inertia = np.diag([moment * random.choice((1.0, 1.5)), moment, moment * random.choice((0.5, 1e-6))])
    before = fields["bodies"]
    fields["bodies"] = lambda: [lieeuler.Body(mass, inertia) if k == place else body
                                for k, body in enumerate(before())]


def _arguments(function: Callable[..., Any], random: Random, known: dict[str, Any]) -> dict[str, Any]:
    """One value for every parameter: a known one, one of the kind that its name tells, or anything."""
    def value(name: str) -> Any:
        if random.random() < 0.05:
            return random.choice(ODD)
        if name in known:
            return known[name]
        if name in ("parent", "child"):
            return random.choice((-1, 0, 1, 2, 2**40))
        if name == "frame":
            return random.choice(("world", "body"))
        if name in ("length", "stiffness", "free_length", "rest_angle", "damping"):
            return abs(number(random))
        return [number(random) for _ in range(3)]

    return {name: value(name) for name in inspect.signature(function).parameters}


def _add_joint(random: Random, problem: lieeuler.Problem, fields: dict, options: dict) -> None:
    """Between a body and the ground, closed where the body stands: it makes rows redundant, or the system stiff."""
    body, make = random.randrange(problem.n), random.choice(JOINTS)
    R, anchor, offset = problem.R[body], np.array([random.gauss(0, 1) for _ in range(3)]), np.array([0.3, 0.0, 0.4])
    axis = np.eye(3)[random.randrange(3)]
    known = {"parent": -1, "child": body, "child_anchor": anchor, "parent_anchor": problem.x[body] + R @ anchor,
             "parent_axis": axis, "child_axis": R.T @ axis, "relative": R.T, "length": 0.5}
    if make is lieeuler.distance_joint:
        known["parent_anchor"] = known["parent_anchor"] + offset
    if make is lieeuler.universal_joint:
        known["child_axis"] = R.T @ np.roll(axis, 1)
    arguments, before = _arguments(make, random, known), fields["joints"]
    fields["joints"] = lambda: [*before(), make(**arguments)]


def _add_force(random: Random, problem: lieeuler.Problem, fields: dict, options: dict) -> None:
    make = random.choice(FORCES)
    known = {"parent": -1, "child": random.randrange(problem.n)} if random.random() < 0.8 else {}
    arguments, before = _arguments(make, random, known), fields["forces"]
    fields["forces"] = lambda: [*before(), make(**arguments)]


def _change_option(random: Random, problem: lieeuler.Problem, fields: dict, options: dict) -> None:
    name = random.choice(("method", "step", "t_eval", "rtol", "map", "alpha", "beta", "spin_free",
                          "monitor"))
    usual = {"method": METHODS, "map": ("exp", "cayley", "ccsk"), "spin_free": (True, False, None),
              "monitor": (True, False), "t_eval": ([0, 1e-3], [0.0, number(random), number(random)])}
    options[name] = random.choice(ODD if random.random() < 0.1 else usual.get(name, (abs(number(random)),)))
