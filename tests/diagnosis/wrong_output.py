"""Engines whose output is wrong, or from a time on: builders of the mistakes in `tests.diagnosis.mistakes`."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation

from crosscheck import adapters
from crosscheck.diagnosis import of_output
from crosscheck.diagnosis.observe import scale_of, window
from crosscheck.diagnosis.of_run import restarted
from crosscheck.references.maximal import Maximal
from crosscheck.scene import altered, mechanics
from tests.engines.stepper import Misbuilt


def told(change):
    """An engine that reports its states wrongly; `change(rng, scene, states)` -> states."""
    def build(rng, scene):
        seed = int(rng.integers(1 << 30))

        def report(given, raw):
            raw.states = change(np.random.default_rng(seed), given, raw.states)
            raw.states.a = raw.states.alpha = None
            return raw
        return Misbuilt(adapters.get("lieeuler"), (), (report,))
    return build


def with_states(states, **changes):
    """States with some of x, R, v, w replaced."""
    return dataclasses.replace(states, **changes)


def at_joint(speed):
    """Positions, and velocities too, of the joints."""
    def change(rng, scene, states):
        levers = altered.levers(scene)
        x = states.x + np.einsum("tnij,nj->tni", states.R, levers)
        v = states.v + np.einsum("tnij,tnj->tni", states.R, np.cross(states.w, levers)) if speed else states.v
        return with_states(states, x=x, v=v)
    return change


def elsewhere(rng, scene, states):
    """Positions of points of the bodies that nothing is said about."""
    s = rng.uniform(-0.2, 0.2, (scene.n, 3))
    return with_states(states, x=states.x + np.einsum("tnij,nj->tni", states.R, s))


def each(change):
    """The same done to x, R, v and w."""
    return lambda rng, scene, states: with_states(states, **{name: change(rng, getattr(states, name))
                                                             for name in ("x", "R", "v", "w")})


def retimed(times):
    """True states at other times than those asked for."""
    return told(lambda rng, scene, states: of_output.at_times(scene, times(scene)))


def finite(change):
    """What goes away with the step: `change(scene, raw)` -> states."""
    def build(rng, scene):
        def report(given, raw):
            raw.states = change(given, raw)
            return raw
        return Misbuilt(adapters.get("lieeuler"), (), (report,))
    return build


def between(scene, raw):
    """True states on straight lines between those of steps that do not end on the output times."""
    h = 1.3 * raw.step
    k = np.floor(scene.t / h)
    # Rounded: truth cannot step between times that differ by their roundings.
    one, two = (of_output.at_times(scene, np.round((k + more) * h, 12)) for more in (0, 1))
    part = (scene.t / h - k)[:, None, None]

    def line(name):
        early, late = (getattr(states, name).reshape(len(k), scene.n, -1) for states in (one, two))
        return ((1 - part) * early + part * late).reshape(getattr(one, name).shape)
    return with_states(one, t=scene.t, **{name: line(name) for name in ("x", "R", "v", "w")})


def spoilt(**changes):
    """Reported accelerations that are those of another state, or in other axes."""
    def build(rng, scene):
        def report(given, raw):
            raw.states = with_states(raw.states, **{name: change(given, raw.states) for name, change in
                                                    changes.items()})
            return raw
        return Misbuilt(adapters.get("lieeuler"), (), (report,))
    return build


def unrepeatable(rng, scene):
    """Noise that differs from run to run."""
    def report(given, raw):
        raw.states = each(lambda _, values: values + 1e-8 * np.random.default_rng().normal(size=values.shape))(
            None, given, raw.states)
        return raw
    return Misbuilt(adapters.get("lieeuler"), (), (report,))


def later(change, part=0.4):
    """What begins after a part of the scene's whole duration: true motion before, of an altered scene after."""
    def build(rng, scene):
        begin = part * scene.duration

        def report(given, raw):
            after = raw.states.t > begin
            if after.any():
                raw.states = change(given, raw.states, after, begin)
                raw.states.a = raw.states.alpha = None
            return raw
        return Misbuilt(adapters.get("lieeuler"), (), (report,))
    return build


def gravity_off(given, states, after, begin):
    """Another gravity from a time on."""
    return onward(given, states, after, begin, lambda scene: scene.replace(gravity=0.97 * given.gravity))


def kicked(given, states, after, begin):
    """All velocities are less by a fiftieth, once."""
    return onward(given, states, after, begin, lambda scene: scene.replace(bodies=tuple(dataclasses.replace(
        body, velocity=0.98 * body.velocity, angular_velocity=0.98 * body.angular_velocity) for body in scene.bodies)))


def onward(given, states, after, begin, change):
    """The true motion of a changed scene from a time on."""
    start = Maximal(given).run(np.linspace(0.0, begin, 50))  # with its turns
    wrong = change(restarted(given, start, 49, 1.0))
    grid = np.concatenate([[0.0], states.t[after] - begin])
    found = Maximal(wrong).run(grid)
    return with_states(states, **{name: np.concatenate([getattr(states, name)[~after], getattr(found, name)[1:]])
                                  for name in ("x", "R", "v", "w")})


def stuck(given, states, after, begin):
    """An angular velocity that stays as large as it is."""
    w = states.w.copy()
    w[after, 0, 0] = w[after, 0, 0][0]
    return with_states(states, w=w)


def jumped(given, states, after, begin):
    """Attitudes of the other sign of the angle."""
    R = states.R.copy()
    R[after, 0] = np.swapaxes(R[after, 0], -1, -2)
    return with_states(states, R=R)


def shifted_later(given, states, after, begin):
    """Positions off by a thousandth of a metre."""
    return with_states(states, x=np.where(after[:, None, None], states.x + 1e-3, states.x))


def filtered(*names):
    """Velocities v - tau a."""
    def build(rng, scene, states):
        angles = mechanics.torsion_angles(scene, states)
        a, alpha, _ = mechanics.index1(scene, states.x, states.R, states.v, states.w, angles, states.t)
        return with_states(states, **{name: getattr(states, name) - 2e-3 * {"v": a, "w": alpha}[name]
                                      for name in names})
    return build


def turned_attitude(rng, scene, states):
    """The attitude of the last body, turned by a constant."""
    R = states.R.copy()
    R[:, -1] = R[:, -1] @ Rotation.from_rotvec([0.1, 0.2, -0.3]).as_matrix()
    return with_states(states, R=R)


def mirrored(rng, scene, states):
    """y with the other sign in attitudes."""
    S = np.diag([1.0, -1.0, 1.0])
    return with_states(states, R=S @ states.R @ S)


def dropped(rng, scene, states):
    """One sample repeats the one before."""
    places = np.arange(len(states.t))
    places[len(places) // 2] -= 1
    return with_states(states, **{name: getattr(states, name)[places] for name in "xRvw"})


def straight(rng, scene, states):
    """Straight lines between every fifth sample."""
    chosen = np.unique(np.append(np.arange(0, len(states.t), 5), len(states.t) - 1))
    return with_states(states, **{name: interp1d(chosen, getattr(states, name)[chosen], axis=0)(
        np.arange(len(states.t))) for name in "xRvw"})


def early(rng, scene):
    """A limit of angular velocities that is reached within the first radian."""
    sizes = np.abs(Maximal(window(scene, scale_of(scene))).run().w).max(axis=(1, 2))
    return float(0.9 * sizes[0] + 0.1 * sizes.max())
