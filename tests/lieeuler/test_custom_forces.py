"""Forces of one's own: as the spring that they copy, in every method but taylor; errors and compiled functions."""

from __future__ import annotations

import ctypes
import dataclasses

import numpy as np
import pytest

import lieeuler
from tests.lieeuler.systems import SYSTEMS, spring_chain

T = np.linspace(0, 0.2, 3)
OTHERS = [name for name in lieeuler.METHODS if name != "taylor"]


def sprung(stiffness=10.0, damping=0.1, length=0.5):
    """A chain on a spring of the kernel, and the same with that spring as a function."""
    chain = spring_chain(2)
    anchor = chain.forces[0].parent_point
    built_in = lieeuler.LinearSpring(-1, 1, anchor, np.array([0.1, 0, 0.2]), stiffness, length, damping)

    def pull(t, x, R, v, w):
        s = built_in.child_point
        d, speed = x[1] + R[1] @ s - anchor, v[1] + R[1] @ np.cross(w[1], s)
        size = np.linalg.norm(d)
        force = -(stiffness * (size - length) + damping * (d @ speed) / size) * d / size
        return [[0] * 6, [*force, *np.cross(s, R[1].T @ force)]]

    own = dataclasses.replace(chain, forces=(), custom=(lieeuler.CustomForce(pull),))
    return dataclasses.replace(chain, forces=(built_in,)), own


@pytest.mark.parametrize("method", OTHERS)
def test_a_spring_by_a_function_is_the_spring(method):
    """Both solve the same steps to rounding; steps that follow a tolerance differ by their noise."""
    control = {"step": 1e-2} if "step" in lieeuler.METHODS[method].controls else {"rtol": 1e-9}
    kernel, own = (lieeuler.integrate(p, method, t_eval=T, reduce="off", spin_free=False, **control) for p in sprung())
    for name in ("x", "R", "v", "w"):
        # of sizes of 1 m and some rad/s
        assert np.abs(getattr(own, name) - getattr(kernel, name)).max() < (1e-11 if "step" in control else 1e-8)
    assert "energy_error" not in own.stats.maxima
    assert "energy_error" in kernel.stats.maxima


@pytest.mark.parametrize("method", ["DAE1L_LSE", "DAE2L_LE", "DAE1H_LSE", "rattle2", "generalized_alpha"])
def test_newton_knows_the_derivative(method):
    """Of a spring and a damper of a step's own rate: without their derivatives the iteration would not converge."""
    kernel, own = (lieeuler.integrate(p, method, 1e-2, T, reduce="off") for p in sprung(1e4, 500.0, 0.0))
    assert np.abs(own.x - kernel.x).max() < 1e-10
    assert own.stats.newton_iterations <= 1.2 * kernel.stats.newton_iterations


def test_a_compiled_function_gets_its_argument():
    seen = []

    @ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_int, *[ctypes.POINTER(ctypes.c_double)] * 5, ctypes.c_void_p)
    def push(t, n, x, R, v, w, out, user):
        seen.append(user)
        for k in range(6 * n):
            out[k] = 0.0
        out[2] = 9.81 * 15.0  # the weight of the top

    top = SYSTEMS["heavy_top"]()
    lifted = dataclasses.replace(top, custom=[lieeuler.CustomForce(ctypes.cast(push, ctypes.c_void_p).value, 17)])
    free = dataclasses.replace(top, gravity=[0, 0, 0])
    one, other = (lieeuler.integrate(p, "rkmk4", 1e-3, T / 10, spin_free=None if p is lifted else False)
                  for p in (lifted, free))
    assert np.abs(one.x - other.x).max() < 1e-13
    assert set(seen) == {17}


def test_time_is_that_of_the_problem():
    times = []
    body = lieeuler.Body(2.0, np.eye(3))
    ball = lieeuler.Problem([body], [], [0, 0, 0], [[0, 0, 0]], [np.eye(3)], [[0, 0, 0]], [[0, 0, 0]], time=3.0,
                            custom=[lieeuler.CustomForce(lambda t, *_: times.append(t) or [[6 * t, 0, 0, 0, 0, 0]])])
    run = lieeuler.integrate(ball, lieeuler.RKMK4(step=0.1), [3.0, 4.0])
    assert run.v[-1, 0, 0] == pytest.approx(1.5 * (16 - 9), rel=1e-14)
    assert (min(times), max(times)) == (3.0, pytest.approx(4.0, abs=1e-14))


def failing(t, *_):
    if t > 0.1:
        raise ZeroDivisionError("at last")
    return np.zeros((1, 6))


def test_what_the_function_raises_comes_through():
    problem = dataclasses.replace(SYSTEMS["single_pendulum"](), custom=[lieeuler.CustomForce(failing)])
    for method in (lieeuler.DAE1L_LSE(1e-2), lieeuler.RKMK853(rtol=1e-6)):
        with pytest.raises(ZeroDivisionError, match="at last"):
            lieeuler.integrate(problem, method, T)
        with pytest.raises(ZeroDivisionError, match="at last"):
            lieeuler.integrate_ensemble(problem, method, T, x=np.repeat(problem.x[None], 3, axis=0), threads=2)
        assert lieeuler.integrate(problem, method, T / 4).success


@pytest.mark.parametrize(("make", "words"), [
    (lambda: lieeuler.CustomForce(3.0), "callable"), (lambda: lieeuler.CustomForce(True), "callable"),
    (lambda: dataclasses.replace(SYSTEMS["single_pendulum"](), custom=[lieeuler.CustomForce(lambda *_: [1, 2])]),
     r"shape \(1, 6\)"),
    (lambda: dataclasses.replace(SYSTEMS["single_pendulum"](), custom=[len]), r"custom\[0\]"),
])
def test_wrong_functions_are_named(make, words):
    with pytest.raises(lieeuler.ArgumentError, match=words):
        make()


@pytest.mark.parametrize(("method", "options"), [("taylor", {}), ("rkmk853", {"reduce": "planar"}),
                                                 ("rkmk853", {"spin_free": True})])
def test_what_needs_more_than_values_is_refused_by_name(method, options):
    with pytest.raises(lieeuler.ArgumentError, match="taylor, reductions and spin-free frames"):
        lieeuler.integrate(sprung()[1], method, t_eval=T, **options)
    if "reduce" not in options:
        with pytest.raises(lieeuler.ArgumentError, match="taylor, reductions and spin-free frames"):
            lieeuler.integrate_ensemble(sprung()[1], method, t_eval=T, x=sprung()[1].x[None], **options)
