"""Servos, dry friction and stops against closed forms, on a slide and on a hinge of the same inertia."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

import lieeuler
from lieeuler import Law, Servo, Stops

INERTIA = 2.0  # kg or kg m^2
T = np.linspace(0.0, 2.0, 41)
AXIS = np.array([0.6, 0.0, 0.8])


def one(kind, q0, rate, springs=0.0, **law):
    """A body of inertia 2 on a slide or a hinge of the ground, without gravity, and a spring to 0 on its coordinate."""
    if springs:
        law["servos"] = (*law.get("servos", ()), Servo(proportional=springs))
    if kind == "slide":
        joint = lieeuler.prismatic_joint(-1, 0, [0, 0, 0], [0, 0, 0], AXIS, AXIS, np.eye(3))
        coordinate, x, R = lieeuler.Coordinate(AXIS, AXIS), q0 * AXIS, np.eye(3)
        v, w = rate * AXIS, np.zeros(3)
    else:
        joint = lieeuler.revolute_joint(-1, 0, [0, 0, 0], [0, 0, 0], AXIS, AXIS)
        hat = np.cross(np.eye(3), AXIS)
        R = np.eye(3) + np.sin(q0) * hat + (1 - np.cos(q0)) * hat @ hat
        coordinate, x = lieeuler.Coordinate(AXIS, AXIS, np.eye(3)), np.zeros(3)
        v, w = np.zeros(3), rate * AXIS
    body = lieeuler.Body(INERTIA, INERTIA * np.eye(3))
    return lieeuler.Problem([body], [joint], [0, 0, 0], [x], [R], [v], [w], laws=(Law(0, coordinate, q0, **law),))


def coordinates(problem, solution):
    """The coordinate and its rate at the output times."""
    law = problem.laws[0]
    if law.coordinate.relative is None:
        return solution.x[:, 0] @ AXIS, solution.v[:, 0] @ AXIS
    p = solution.R[:, 0] @ law.coordinate.measured[5]
    q = np.unwrap(np.arctan2(p @ law.coordinate.measured[4], p @ law.coordinate.measured[3]))
    return q + 2 * np.pi * round((law.start - q[0]) / (2 * np.pi)), solution.w[:, 0] @ AXIS


def half_waves(k, c, q0):
    """A mass on a spring with dry friction from rest: half waves about +-c/k, each extreme 2 c/k nearer."""
    w, extremes = np.sqrt(k / INERTIA), [q0]
    while abs(extremes[-1]) > c / k:
        extremes.append(-np.sign(extremes[-1]) * (abs(extremes[-1]) - 2 * c / k))
    number = np.minimum((T * w / np.pi).astype(int), len(extremes) - 1)
    start = np.array(extremes)[number]
    middle = np.sign(start) * c / k
    q = middle + (start - middle) * np.cos(w * T - np.pi * number)
    events = [(np.pi / w * (j + 1), "reverses") for j in range(len(extremes) - 2)]
    events.append((np.pi / w * (len(extremes) - 1), "sticks"))
    return np.where(number == len(extremes) - 1, extremes[-1], q), events


def braked(c, rate):
    end = INERTIA * rate / c
    t = np.minimum(T, end)
    return rate * t - 0.5 * c / INERTIA * t ** 2, [(end, "sticks")]


def bounces(rate, edge, e):
    """Between stops at +-edge from the middle, without forces."""
    q, events, here, t0, when = np.empty_like(T), [], 0.0, 0.0, edge / rate
    for j, t in enumerate(T):
        while t > when:
            here, t0, rate = np.sign(rate) * edge, when, -e * rate
            events.append((when, "hits_lower" if rate > 0 else "hits_upper"))
            when += 2 * edge / abs(rate)
        q[j] = here + rate * (t - t0)
    return q, events


def saturated(k, cut, target):
    """From rest at 0: the force `cut` until k (target - q) is below it, then an arc about the target, to -cut."""
    w, room = np.sqrt(k / INERTIA), cut / k
    leave = np.sqrt(2 * (target - room) * INERTIA / cut)
    speed = cut / INERTIA * leave
    phase = np.arctan2(-room, speed / w)
    amplitude = np.hypot(room, speed / w)
    over = leave + (np.arcsin(room / amplitude) - phase) / w
    arc = target + amplitude * np.sin(w * (T - leave) + phase)
    q = np.select([leave > T, over > T], [0.5 * cut / INERTIA * T ** 2, arc], np.nan)
    return q, [(leave, "unsaturates"), (over, "saturates")]


def motor(torque, top):
    """From rest: the whole torque falls in a straight line to 0 at the speed `top`."""
    rate = torque / (INERTIA * top)
    return top * (T - (1 - np.exp(-rate * T)) / rate), []


def soft(rate, edge, k, d):
    """One pass into a spring and damper beyond `edge` until it stops pushing; NaN from there on."""
    when = edge / rate
    A = np.array([[0, 1], [-k / INERTIA, -d / INERTIA]])
    q = np.array([rate * t if t < when else edge + (expm(A * (t - when)) @ [0, rate])[0] for t in T])
    force = np.array([0.0 if t < when else k * (expm(A * (t - when)) @ [0, rate])[0] + d * (
        expm(A * (t - when)) @ [0, rate])[1] for t in T])
    q[np.argmax((when < T) & (force < 0)):] = np.nan
    return q, [(when, "hits_upper")]


CASES = {
    "half waves": (half_waves(20.0, 2.0, 0.83), {
        "q0": 0.83, "rate": 0.0, "springs": 20.0, "sliding": 2.0, "static": 2.0}),
    "braked": (braked(3.0, 1.1), {"q0": 0.0, "rate": 1.1, "sliding": 3.0, "static": 3.0}),
    "braked back": ((-braked(3.0, 1.1)[0], braked(3.0, 1.1)[1]), {
        "q0": 0.0, "rate": -1.1, "sliding": 3.0, "static": 3.0}),
    "bounces": (bounces(1.3, 0.3, 0.5), {"q0": 0.0, "rate": 1.3, "stops": Stops(-0.3, 0.3, 0.5)}),
    "elastic": (bounces(1.3, 0.3, 1.0), {"q0": 0.0, "rate": 1.3, "stops": Stops(-0.3, 0.3, 1.0)}),
    "saturated": (saturated(8.0, 3.0, 1.0), {"q0": 0.0, "rate": 0.0, "servos": (
        Servo(proportional=8.0, target=1.0, lower=-3.0, upper=3.0),)}),
    "motor": (motor(5.0, 1.5), {"q0": 0.0, "rate": 0.0, "servos": (
        Servo(feedforward=50.0, lower=-5.0, upper=5.0, no_load_speed=1.5),)}),
    "soft": (soft(0.9, 0.4, 300.0, 9.0), {
        "q0": 0.0, "rate": 0.9, "stops": Stops(upper=0.4, stiffness=300.0, damping=9.0)}),
}
METHODS = {"taylor": ({"rtol": 1e-13}, 2e-12), "rkmk853": ({"rtol": 1e-12}, 2e-11), "rattle6": ({"step": 5e-3}, 1e-9)}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["slide", "turn"])
@pytest.mark.parametrize("case", CASES)
def test_closed_forms(case, kind, method):
    (q, events), given = CASES[case]
    options, near = METHODS[method]
    problem = one(kind, **given)
    solution = lieeuler.integrate(problem, method, t_eval=T, **options)
    known = np.isfinite(q)
    assert np.abs(coordinates(problem, solution)[0] - q)[known].max() < near
    told = [(t, what) for t, _, what in solution.events if t < T[-1]][:len([e for e in events if e[0] < T[-1]])]
    assert [what for _, what in told] == [what for t, what in events if t < T[-1]]
    assert np.abs([a[0] - b[0] for a, b in zip(told, events, strict=False)] or [0.0]).max() < 10 * near


def slides(q, rates, stops, weight, rides, masses=(1.0, 2.0)):
    """Two slides along x, both on the ground, or the second one on the first."""
    x = np.array([1.0, 0.0, 0.0])
    bodies = [lieeuler.Body(mass, 0.1 * np.eye(3)) for mass in masses]
    joints = [lieeuler.prismatic_joint(-1, 0, [0, 0, 0], [0, 0, 0], x, x, np.eye(3)),
              lieeuler.prismatic_joint(0 if rides else -1, 1, [0, 1, 0], [0, 0, 0], x, x, np.eye(3))]
    places, speeds = ([each[0], each[1] + each[0] * rides] for each in (q, rates))
    laws = tuple(Law(k, lieeuler.Coordinate(x, x), q[k], stops=stop) for k, stop in enumerate(stops))
    return lieeuler.Problem(bodies, joints, [-weight, 0, 0], [places[0] * x, places[1] * x + [0, 1, 0]],
                            [np.eye(3)] * 2, [speed * x for speed in speeds], np.zeros((2, 3)), laws=laws)


STOPPED = {"taylor": ({"rtol": 1e-13}, 1e-12), "rattle2": ({"step": 0.01}, 1e-12), "rkmk4": ({"step": 0.1}, 1e-12),
           "DAE1L_LSE": ({"step": 1e-3}, 4e-3)}  # of constant accelerations all but the last one are exact


@pytest.mark.parametrize("method", STOPPED)
def test_a_weight_bounces_while_another_rests(method):
    """It falls half a metre at 1 m/s^2 and leaves its stop at half its speed: .5 u - u^2 / 2 at u = t - 1."""
    options, near = STOPPED[method]
    problem = slides([0.0, 0.5], [0.0, 0.0], [Stops(0.0), Stops(0.0, restitution=0.5)], 1.0, rides=False)
    solution = lieeuler.integrate(problem, method, t_eval=np.linspace(0.0, 1.9, 20), **options)
    u = np.maximum(solution.t - 1.0, 0.0)
    exact = np.where(u > 0, 0.5 * u - 0.5 * u ** 2, 0.5 - 0.5 * solution.t ** 2)
    assert np.abs(solution.x[:, 1, 0] - exact).max() < near
    assert not solution.x[:, 0].any()
    assert [event[1:] for event in solution.events] == [(1, "hits_lower")]


@pytest.mark.parametrize("method", STOPPED)
def test_a_weight_that_rests_on_its_stop_is_kicked_off(method):
    """The second slide, on the first, meets its upper stop at sqrt(8) m/s and takes it along at two thirds of that.

    They fly for 2 v / g; the first lands, and the second goes on down as fast as it was.
    """
    options, near = STOPPED[method]
    problem = slides([0.0, 0.0], [0.0, 3.0], [Stops(0.0), Stops(upper=0.5)], 1.0, rides=True)
    solution = lieeuler.integrate(problem, method, t_eval=np.linspace(0.0, 4.2, 43), **options)
    v, hit = 2 / 3 * np.sqrt(8.0), 3.0 - np.sqrt(8.0)
    u, after = solution.t - hit, solution.t - hit - 2 * v
    flight = np.where((u > 0) & (after < 0), v * u - 0.5 * u ** 2, 0.0)
    rider = np.select([u < 0, after < 0], [3.0 * solution.t - 0.5 * solution.t ** 2, 0.5 + flight],
                      0.5 - v * after - 0.5 * after ** 2)
    assert np.abs(solution.x[:, :, 0] - np.stack([flight, rider], axis=1)).max() < near
    assert [event[1:] for event in solution.events] == [(1, "hits_upper"), (0, "leaves_lower"), (0, "hits_lower"),
                                                        (1, "leaves_upper")]


@pytest.mark.parametrize("method", STOPPED)
@pytest.mark.parametrize(("q", "rates", "weight"), [
    ([0.5, 0.5], [-1.0, -1.0], 0.0), ([0.5, 0.5], [0.0, 0.1], 1.0), ([0.5, 0.2], [0.0, -0.1], 1.0),
    ([0.5, 0.25], [0.0, 0.0], 1.0)])
def test_two_slides_one_on_the_other_end_on_their_stops(method, q, rates, weight):
    problem = slides(q, rates, [Stops(0.0, 2.0), Stops(0.0, 2.0)], weight, rides=True)
    solution = lieeuler.integrate(problem, method, t_eval=np.linspace(0.0, 3.0, 20), **STOPPED[method][0])
    assert solution.success
    assert {event[1:] for event in solution.events} == {(0, "hits_lower"), (1, "hits_lower")}
    assert np.abs(solution.x[-1, :, 0]).max() < 1e-13
    assert np.abs(solution.v[-1]).max() < 1e-15


@pytest.mark.parametrize("method", STOPPED)
@pytest.mark.parametrize("rests", [False, True], ids=["both are hit", "one is hit, one carries"])
def test_coupled_stops_of_which_one_bounces_end_the_run(method, rests):
    """Which of them acts first decides what follows, and nothing decides that."""
    both = [Stops(0.0, restitution=0.0 if rests else 0.5), Stops(0.0, restitution=0.5)]
    problem = slides([0.0 if rests else 0.5, 0.5], [0.0 if rests else -1.0, -1.0], both, float(rests), rides=True)
    with pytest.raises(lieeuler.IntegrationError, match="act on each other") as caught:
        lieeuler.integrate(problem, method, t_eval=np.linspace(0.0, 1.0, 21), **STOPPED[method][0])
    when = np.sqrt(2.0) - 1.0 if rests else 0.5
    assert caught.value.status is lieeuler.Status.NOT_UNIQUE
    assert caught.value.solution.t_end == pytest.approx(when, abs=0.05)
    assert caught.value.solution.events[0][0] == pytest.approx(when, abs=2e-3)


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("kind", ["slide", "turn"])
def test_sampled_control_is_exact(kind, delay):
    """A PD law evaluated every 50 ms and held: the motion of a double integrator between is a parabola."""
    kp, kd, period, target = 9.0, 4.0, 0.05, 0.7
    problem = one(kind, 0.2, -0.4, servos=(Servo(kp, kd, target, lower=-2.0, upper=2.0, period=period, delay=delay),))
    solution = lieeuler.integrate(problem, "rkmk4", 0.02, T)
    q, rate, waiting, path = 0.2, -0.4, [0.0] * delay, [0.2]
    for _ in range(40):
        waiting.append(np.clip(kp * (target - q) - kd * rate, -2.0, 2.0))
        a = waiting.pop(0) / INERTIA
        q, rate = q + rate * period + 0.5 * a * period ** 2, rate + a * period
        path.append(q)
    assert np.abs(coordinates(problem, solution)[0] - path).max() < 2e-14 * 40


def test_friction_holds_at_rest_for_ever():
    """A hinge that friction holds under its weight does not creep, at any step, by any kind of method."""
    problem = one("turn", 0.4, 0.0, servos=(Servo(feedforward=0.9),), sliding=0.8, static=1.0)
    for method, options in (("DAE1L_LSE", {"step": 0.1}), ("DAE2H_LE", {"step": 0.01}), ("rattle2", {"step": 0.1}),
                            ("taylor", {"rtol": 1e-9})):
        solution = lieeuler.integrate(problem, method, t_eval=np.linspace(0, 100.0, 11), **options)
        assert np.ptp(solution.R, axis=0).max() < 1e-14
        assert solution.events == ()


def test_breakaway_above_the_sliding_value():
    """A torque that grows with time: at rest up to the static value, then against the sliding one."""
    ramp = lieeuler.TimeFunction([[0.0, 1.0]])
    problem = one("turn", 0.0, 0.0, servos=(Servo(feedforward=ramp),), sliding=0.8, static=1.0)
    solution = lieeuler.integrate(problem, "taylor", t_eval=T, rtol=1e-13)
    t = np.maximum(T - 1.0, 0.0)
    assert np.abs(coordinates(problem, solution)[0] - (0.5 * 0.2 * t ** 2 + t ** 3 / 6) / INERTIA).max() < 1e-12
    assert [(round(when, 12), what) for when, _, what in solution.events] == [(1.0, "slips")]


@pytest.mark.parametrize("method", ["taylor", "rkmk54", "seulex"])
@pytest.mark.parametrize("later", [-2e-13, 0.0, 2e-13, 3e-12])
def test_an_output_time_beside_an_event_has_its_row(method, later):
    """A body that meets a stop at .5 s: the output times next to it are neither lost nor doubled."""
    t = np.array([0.0, 0.5 + later, 0.75, 1.0])
    problem = one("slide", 0.5, -1.0, stops=Stops(lower=0.0, restitution=0.5))
    solution = lieeuler.integrate(problem, method, t_eval=t, rtol=1e-10)
    assert np.array_equal(solution.t, t)
    assert np.abs(coordinates(problem, solution)[0] - [0.5, 0.0, 0.125, 0.25]).max() < 1e-11


@pytest.mark.parametrize(("method", "order"), [("rattle2", 2), ("rkmk4", 4), ("rattle4", 4)])
def test_order_is_kept_across_events_and_lost_without(method, order):
    problem = pendulum(sliding=0.5, static=0.5)
    t = np.linspace(0.0, 3.5, 8)
    exact = lieeuler.integrate(problem, "taylor", t_eval=t, rtol=1e-13).R
    errors = {events: [np.abs(lieeuler.integrate(problem, method, h, t, events=events).R - exact).max()
                       for h in (0.02, 0.01, 0.005)] for events in (True, False)}
    slope = {events: np.polyfit(np.log([4, 2, 1]), np.log(each), 1)[0] for events, each in errors.items()}
    assert slope[True] == pytest.approx(order, abs=0.25)
    assert slope[False] < 1.7


def pendulum(**law):
    """A hinge pendulum of 1 kg at half a metre, from rest at 1.2 rad."""
    c, s = np.cos(1.2), np.sin(1.2)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    joint = lieeuler.revolute_joint(-1, 0, [0, 0, 0], [0, 0, 0.5], [0, 1, 0], [0, 1, 0])
    coordinate = lieeuler.Coordinate([0, 1, 0], [0, 1, 0], np.eye(3))
    return lieeuler.Problem([lieeuler.Body(1.0, 0.02 * np.eye(3))], [joint], [0, 0, -9.81], [R @ [0, 0, -0.5]], [R],
                            [[0, 0, 0]], [[0, 0, 0]], laws=(Law(0, coordinate, 1.2, **law),))


def test_turns_of_the_friction_pendulum():
    """The times of a 30-digit integration: four turns, then at rest."""
    solution = lieeuler.integrate(pendulum(sliding=0.5, static=0.5), "taylor", t_eval=np.linspace(0, 4, 41), rtol=1e-13)
    assert [what for *_, what in solution.events] == ["reverses"] * 4 + ["sticks"]
    turns = [0.7976058331, 1.5708796875, 2.3278585004, 3.0743638557, 3.8150671359]
    assert np.abs([t for t, *_ in solution.events] - np.array(turns)).max() < 5.1e-11  # their printed digits


def test_euler_methods_take_events_at_steps():
    problem = pendulum(sliding=0.5, static=0.5)
    t = np.linspace(0.0, 4.0, 5)
    exact = lieeuler.integrate(problem, "taylor", t_eval=t, rtol=1e-12)
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        solution = lieeuler.integrate(problem, "DAE1L_LSE", h, t)
        errors.append(np.abs(solution.R - exact.R).max())
        assert [what for *_, what in solution.events][-1] == "sticks"
    assert np.polyfit(np.log([4, 2, 1]), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.2)


def arm(cs, q, rates, static=1.0):
    """A chain of hinges about y with dry friction, 1 kg and half a metre each."""
    axis, x, at, w, v = np.array([0.0, 1.0, 0.0]), np.zeros(3), 0.0, 0.0, np.zeros(3)
    bodies, joints, laws, states = [], [], [], []
    for k, (c, turn, rate) in enumerate(zip(cs, q, rates, strict=True)):
        at, w = at + turn, w + rate
        R = np.array([[np.cos(at), 0, np.sin(at)], [0, 1, 0], [-np.sin(at), 0, np.cos(at)]])
        arm = R @ [0, 0, -0.25]
        spin = w * axis
        states.append((x + arm, R, v + np.cross(spin, arm), spin))
        x, v = x + 2 * arm, v + np.cross(spin, 2 * arm)
        bodies.append(lieeuler.Body(1.0, np.diag([0.02, 0.03, 0.025])))
        joints.append(lieeuler.revolute_joint(k - 1, k, [0, 0, -0.25 * (k > 0)], [0, 0, 0.25], axis, axis))
        laws.append(Law(k, lieeuler.Coordinate(axis, axis, np.eye(3)), turn, sliding=c, static=static * c))
    return lieeuler.Problem(bodies, joints, [0, 0, -9.81], *zip(*states, strict=True), laws=tuple(laws))


@pytest.mark.parametrize("events", [False, True])
@pytest.mark.parametrize(("method", "step"), [("rkmk4", 0.03), ("DAE1L_LSE", 0.01), ("DAE3H_LE", 0.01)])
def test_joints_that_stick_and_slip_together_run_through(method, step, events):
    """Friction of one joint moves the others: the method and the index-1 system may disagree on which one rests."""
    t = np.linspace(0.0, 2.0, 6)
    for cs, q, rates, static in (([1.2, 0.6], [1.0, -0.5], [0.0, 2.0], 1.0), ([1.032, 0.2317], [0.494, 1.107],
                                 [0.678, 2.504], 1.3), ([0.383, 0.163], [1.421, 1.445], [2.259, -0.169], 1.3),
                                 ([0.46, 0.1, 0.6, 0.3], [0.3, -0.4, 0.9, 0.6], [1.0, -1.0, 2.0, -2.0], 1.0)):
        solution = lieeuler.integrate(arm(cs, q, rates, static), method, step, t, events=events)
        assert len(solution.t) == len(t)
        energy = (0.5 * np.sum(solution.v ** 2, axis=(1, 2)) + 9.81 * solution.x[:, :, 2].sum(axis=1)
                  + 0.5 * np.sum(solution.w ** 2 * [0.02, 0.03, 0.025], axis=(1, 2)))
        assert energy[-1] < energy[0]  # friction only brakes


@pytest.mark.parametrize("law", [{"sliding": 0.5, "static": 0.5}, {"stops": Stops(-0.5, 2.0)},
                                 {"servos": (Servo(30.0),)}], ids=["friction", "stops", "servo"])
def test_a_mass_beyond_all_sense_ends_with_a_status(law):
    problem = pendulum(**law)
    problem = dataclasses.replace(problem, bodies=(lieeuler.Body(1e100, 0.02e100 * np.eye(3)),))
    with pytest.raises(lieeuler.IntegrationError):
        lieeuler.integrate(problem, "rkmk4", 0.1, [0.0, 1.0])


def test_a_run_that_fails_in_its_first_step_says_so():
    problem = pendulum(sliding=0.5, static=0.5)
    w = np.array([0.0, 1e5, 0.0])
    with pytest.raises(lieeuler.IntegrationError, match="coordinate map") as caught:
        lieeuler.integrate(dataclasses.replace(problem, v=np.cross(w, problem.x), w=[w]), "DAE1L_LSE", 0.1, [0.0, 1.0])
    assert caught.value.status is lieeuler.Status.MAP_DOMAIN


def test_ensembles_refuse_laws():
    with pytest.raises(lieeuler.ArgumentError, match="take no laws"):
        lieeuler.integrate_ensemble(pendulum(sliding=0.5, static=0.5), "rkmk4", 0.1, [0, 1], x=np.zeros((2, 1, 3)))


@pytest.mark.parametrize(("changes", "word"), [
    ({"joint": 3}, "no joint 3"), ({"sliding": 1.0, "static": 0.5}, "sliding <= static"),
    ({"stops": Stops(-2.0, 0.5)}, "beyond its stop")])
def test_wrong_laws_are_refused(changes, word):
    def run():
        problem = pendulum()
        law = dataclasses.replace(problem.laws[0], **changes)
        return lieeuler.integrate(dataclasses.replace(problem, laws=(law,)), "rkmk4", 0.1, [0, 1])

    with pytest.raises(lieeuler.ArgumentError, match=word):
        run()


@pytest.mark.parametrize(("make", "word"), [
    (lambda: Stops(1.0, 0.0), "below upper"), (lambda: Stops(0.0, 1.0, 1.5), "restitution"),
    (lambda: Servo(period=0.0), "period"), (lambda: Servo(lower=1.0), "around 0"), (lambda: Servo(delay=-1), "delay"),
    (lambda: Servo(proportional=-1.0), "proportional")])
def test_wrong_records_are_refused(make, word):
    with pytest.raises(lieeuler.ArgumentError, match=word):
        make()


@pytest.mark.parametrize("method", ["DAE1L_LSE", "DAE2H_LSE"])
@pytest.mark.parametrize("kind", ["slide", "turn"])
def test_a_million_steps_of_stick_and_slip_do_not_drift(kind, method):
    """A sine beyond the static friction: in every period it slips forth, rests, slips back and rests."""
    push = lieeuler.TimeFunction(terms=[(1.3, 2 * np.pi, 0.0)])
    problem = one(kind, 0.4, 0.0, servos=(Servo(feedforward=push),), sliding=0.8, static=1.0)
    solution = lieeuler.integrate(problem, method, 1 / 2000, np.linspace(0, 500, 2001))
    assert solution.stats.steps >= 1_000_000
    assert [what for *_, what in solution.events[-4:]].count("slips") == 2
    assert len(solution.events) == pytest.approx(2000, abs=4)
    q, _ = coordinates(problem, solution)
    assert np.ptp(q) > 0.01
    assert np.ptp(q[4::4]) < 5e-12  # 45 eps a period of 3,200 steps; measured 1.2e-14 m and 1.6e-12 rad
