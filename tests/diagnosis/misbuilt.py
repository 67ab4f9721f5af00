"""Engines built wrongly on purpose, one cause each, and random scenes to catch them on; everything is seeded."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from crosscheck.diagnosis.misreadings import placed
from crosscheck.diagnosis.variants import close
from crosscheck.scene.model import GROUND, Body, Force, Joint, Scene, rotation_from_quaternion
from tests.engines.equations import Flaws
from tests.engines.stepper import Misbuilt, Stepper
from tests.scene_making import unit

# --- random scenes ----------------------------------------------------------------------------------------------------


def _quaternion(rng):
    x, y, z, w = Rotation.random(random_state=rng).as_quat()
    return np.array([w, x, y, z])


def random_scene(rng, springs=True):
    """One to three bodies in a chain or a branch, on spherical and revolute joints, with springs; T = 1 s."""
    n = int(rng.integers(1, 4))
    bodies, joints, forces = [], [], []
    for k in range(n):
        parent = k - 1 if rng.random() < 0.7 or k == 0 else GROUND
        kind = "spherical" if rng.random() < 0.65 else "revolute"
        moments = rng.uniform(0.05, 0.3, size=3)
        turn = Rotation.random(random_state=rng).as_matrix()
        inertia = turn @ np.diag(moments.sum() - moments) @ turn.T
        attitude = _quaternion(rng)
        bodies.append(Body(f"body {k}", rng.uniform(0.5, 2.0), (inertia + inertia.T) / 2, attitude,
                           rng.uniform(-2, 2, 3), np.zeros(3), np.zeros(3)))
        anchor = rng.uniform(0.3, 0.8) * unit(rng) if parent != GROUND else rng.uniform(-0.5, 0.5, 3)
        axes = (None, None)
        if kind == "revolute":
            world = unit(rng)
            before = np.eye(3) if parent == GROUND else rotation_from_quaternion(bodies[parent].attitude)
            axes = before.T @ world, rotation_from_quaternion(attitude).T @ world
        joints.append(Joint(f"joint {k}", kind, parent, k, anchor, rng.uniform(0.3, 0.8) * unit(rng), *axes))
        if springs and rng.random() < 0.6:
            forces.append(_spring(rng, joints[-1]))
    gravity = np.array([0.0, 0.0, -9.81])
    scene = Scene(f"random {n}", tuple(bodies), tuple(joints), tuple(forces), gravity, 1.0, 11)
    return close(_placed(scene))


def _spring(rng, joint):
    damping = rng.uniform(0.2, 1.0) if rng.random() < 0.5 else 0.0
    if joint.type == "revolute" and rng.random() < 0.5:
        return Force("torsional_spring", None, None, joint.name,
                     {"stiffness": rng.uniform(2, 10), "rest_angle": rng.uniform(-0.5, 0.5), "damping": damping})
    return Force("linear_spring", GROUND, joint.child, None,
                 {"parent_point": tuple(rng.uniform(-1.5, 1.5, 3)), "child_point": tuple(rng.uniform(-0.4, 0.4, 3)),
                  "stiffness": rng.uniform(10, 50), "free_length": rng.uniform(0.2, 0.6), "damping": damping})


def _placed(scene):
    """Positions and velocities from the joints; a hinge keeps only the turning about it."""
    x, v, w = np.zeros((scene.n, 3)), np.zeros((scene.n, 3)), scene.w0.copy()
    for joint in scene.joints:
        k, p, R = joint.child, joint.parent, scene.R0
        point, speed, spin = joint.parent_anchor, np.zeros(3), np.zeros(3)
        if p != GROUND:
            point = x[p] + R[p] @ joint.parent_anchor
            speed = v[p] + R[p] @ np.cross(w[p], joint.parent_anchor)
            spin = R[k].T @ R[p] @ w[p]
        if joint.type == "revolute":
            w[k] = spin + ((w[k] - spin) @ joint.child_axis) * joint.child_axis
        x[k] = point - R[k] @ joint.child_anchor
        v[k] = speed - R[k] @ np.cross(w[k], joint.child_anchor)
    bodies = tuple(dataclasses.replace(body, position=x[k], velocity=v[k], angular_velocity=w[k])
                   for k, body in enumerate(scene.bodies))
    return scene.replace(bodies=bodies)


# --- alterations of the scene -----------------------------------------------------------------------------------------


def replaced(scene, joints):
    """The scene with these joints, and its bodies where they put them; None if they put them nowhere else."""
    if all(np.array_equal(one.parent_anchor, other.parent_anchor)
           and np.array_equal(one.child_anchor, other.child_anchor)
           for one, other in zip(scene.joints, joints, strict=True)):
        return None
    return placed(scene.replace(joints=joints))


def _bodies(scene, change):
    return scene.replace(bodies=tuple(change(k, body) for k, body in enumerate(scene.bodies)))


def _reopened(scene, R, w):
    """The scene from other attitudes and angular velocities, positions and velocities from the joints."""
    bodies = []
    for k, body in enumerate(scene.bodies):
        x, y, z, real = Rotation.from_matrix(R[k]).as_quat()
        bodies.append(dataclasses.replace(body, attitude=np.array([real, x, y, z]), angular_velocity=w[k]))
    return _placed(scene.replace(bodies=tuple(bodies)))


def _relative(scene, attitude=None, spin=None):
    """Misread attitudes and spins joint by joint, in joint coordinates; hinges keep their angle and rate."""
    R, w = scene.R0.copy(), scene.w0.copy()
    for joint in scene.joints:
        k, p = joint.child, joint.parent
        old, new = (np.eye(3) if p == GROUND else frame[p] for frame in (scene.R0, R))
        between = old.T @ scene.R0[k]
        carried = np.zeros(3) if p == GROUND else between.T @ scene.w0[p]
        own = scene.w0[k] - carried
        if joint.type == "spherical" and attitude is not None:
            between = attitude(between)
        R[k] = new @ between
        w[k] = own + (0.0 if p == GROUND else between.T @ w[p])
        if joint.type == "spherical" and spin is not None:
            w[k] = spin(scene.w0[k], R[k], carried)
    return _reopened(scene, R, w)


def quaternion_order(R):
    """The rotation of x, y, z, w read as w, x, y, z."""
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    w, x, y, z = np.roll(np.array([w, x, y, z]), 1)
    return Rotation.from_quat([x, y, z, w]).as_matrix()


def gravity(change):
    """Another gravity."""
    return lambda scene: scene.replace(gravity=change(scene.gravity))


def inertia(change, only=None):
    """Another inertia; `change(scene, body index)`."""
    return lambda scene: _bodies(scene, lambda k, body: dataclasses.replace(body, inertia=change(scene, k))
                                 if only is None or k == only % scene.n else body)


def steiner(part):
    """The inertia with a part of m (s^2 - s s^T) added."""
    def change(scene, k):
        s = scene.joints[k].child_anchor
        return scene.inertias[k] + part * scene.masses[k] * (s @ s * np.eye(3) - np.outer(s, s))
    return change


def scaled_body(factor, which):
    """Mass and inertia of one body times a factor."""
    return lambda scene: _bodies(scene, lambda k, body: dataclasses.replace(
        body, mass=factor * body.mass, inertia=factor * body.inertia) if k == which % scene.n else body)


def spring(which, **changes):
    """Parameters of one spring times factors, or plus for its rest; `which` is the force itself."""
    def changed(force):
        if force != which:
            return force
        p = dict(force.parameters)
        rest = "free_length" if force.type == "linear_spring" else "rest_angle"
        for name, value in changes.items():
            p[rest if name == "rest" else name] = p[rest] + value if name == "rest" else p[name] * value
        return dataclasses.replace(force, parameters=p)
    return lambda scene: scene.replace(forces=tuple(changed(force) for force in scene.forces))


def without_spring(which):
    """One spring-damper left out."""
    return lambda scene: scene.replace(forces=tuple(force for force in scene.forces if force != which))


def frozen_leaf(scene, raw):
    """A body that was not there is reported where it was at the start."""
    states = raw.states
    for name in ("x", "R", "v", "w"):
        values = getattr(states, name)
        setattr(states, name, np.concatenate([values, np.broadcast_to(values[:1, :1] * 0, (len(values), 1,
                                                                      *values.shape[2:]))], axis=1))
    states.a = states.alpha = states.lam = None
    states.x[:, -1], states.R[:, -1] = scene.x0[-1], scene.R0[-1]
    return raw


def without_last_body(scene):
    """The scene without its last body, which nothing hangs on, and all that belongs to it."""
    last = scene.n - 1
    joints = tuple(joint for joint in scene.joints if joint.child != last)
    gone = {joint.name for joint in scene.joints if joint.child == last}
    forces = tuple(force for force in scene.forces if force.child != last and force.joint not in gone)
    return scene.replace(bodies=scene.bodies[:-1], joints=joints, forces=forces)


def world_spins(scene, raw):
    """Angular velocities reported in world axes."""
    raw.states.w = np.einsum("tnij,tnj->tni", raw.states.R, raw.states.w)
    return raw


# --- the suite --------------------------------------------------------------------------------------------------------

@dataclasses.dataclass(frozen=True)
class Case:
    """One cause with a magnitude: alterations of the scene, of the report, or flaws of the stepper."""

    name: str
    magnitude: str
    alter: tuple = ()
    report: tuple = ()
    flaws: dict | None = None


def factor(rng, low=0.03, high=0.5):
    """A factor off one, to either side, by a size uniform in its logarithm."""
    size = np.exp(rng.uniform(np.log(low), np.log(high)))
    return 1 + size if rng.random() < 0.5 else 1 - size


def make(name, rng, scene):
    """A case of a cause with random magnitude on a scene; None where the scene has nothing to get wrong."""
    springs = [force for force in scene.forces if force.type.endswith("spring")]
    which = springs[rng.integers(len(springs))] if springs else None
    damped = [force for force in springs if force.parameters["damping"]]
    match name:
        case "gravity size":
            s = factor(rng)
            return Case(name, f"{s:.3f}", (gravity(lambda g: s * g),))
        case "gravity sign":
            return Case(name, "-1", (gravity(lambda g: -g),))
        case "gravity axis":
            turn = (1, 2) if rng.random() < 0.5 else (2, 0)
            return Case(name, str(turn), (gravity(lambda g: np.roll(g, turn[0])),))
        case "inertia point":
            part = rng.uniform(0.05, 1.0)
            return Case(name, f"{part:.3f}", (inertia(steiner(part)),))
        case "inertia frame":
            if rng.random() < 0.5:
                return Case(name, "R J R^T", (inertia(lambda s, k: s.R0[k] @ s.inertias[k] @ s.R0[k].T),))
            only, Q = int(rng.integers(3)), Rotation.from_rotvec(rng.uniform(0.1, 1.0) * unit(rng)).as_matrix()
            return Case(name, f"turned, body {only}", (inertia(lambda s, k: Q @ s.inertias[k] @ Q.T, only),))
        case "mass":
            # the motion of a body that touches no other one tells its mass only by springs, which may be all too soft
            tied = sorted({k for joint in scene.joints if joint.parent != GROUND for k in (joint.parent, joint.child)})
            s = factor(rng)
            return Case(name, f"{s:.3f}", (scaled_body(s, int(rng.choice(tied))),)) if tied else None
        case "missing body":
            if scene.n == 1 or any(joint.parent == scene.n - 1 for joint in scene.joints):
                return None
            return Case(name, "absent", (without_last_body,), (frozen_leaf,))
        case "quaternion order":
            return Case(name, "", (lambda s: _relative(s, attitude=quaternion_order),))
        case "quaternion conjugated":
            return Case(name, "", (lambda s: _relative(s, attitude=lambda R: R.T),))
        case "velocity frame":
            if rng.random() < 0.5:
                return Case(name, "world", (lambda s: _relative(s, spin=lambda w, R, p: R.T @ w),))
            return Case(name, "reported in world axes", (), (world_spins,))
        case "spring stiffness":
            s = factor(rng)
            return which and Case(name, f"{s:.3f}", (spring(which, stiffness=s),))
        case "spring free length":
            d = rng.choice([-1, 1]) * rng.uniform(0.02, 0.2)
            return which and Case(name, f"{d:.3f}", (spring(which, rest=d),))
        case "missing spring":
            return which and Case(name, "", (without_spring(which),))
        case "missing damper":
            if not damped:
                return None
            return Case(name, "", (spring(damped[0], damping=0.0),))
        case "extra damping":
            c = np.exp(rng.uniform(np.log(0.01), np.log(0.5)))
            return Case(name, f"{c:.3f}", flaws={"joint_damping" if rng.random() < 0.6 else "drag": c})
        case "soft constraint":
            k = np.exp(rng.uniform(np.log(2e3), np.log(2e4)))
            return Case(name, f"{k:.0f} N/m", flaws={"softness": (k, rng.uniform(5, 50))})
        case "stabilisation gain":
            alpha = rng.uniform(1, 20)
            return Case(name, f"{alpha:.2f}", flaws={"gain": (alpha, alpha)})
        case "group update":
            return Case(name, "", flaws={"naive": True})
        case "hidden sub-steps":
            k = int(rng.integers(2, 7))
            return Case(name, str(k), flaws={"substeps": k})
    raise ValueError(name)


def build(cases, base=None):
    """The engine that has all these flaws; causes of the scene alone can sit on another base engine."""
    flaws = {key: value for case in cases for key, value in (case.flaws or {}).items()}
    alter = tuple(change for case in cases for change in case.alter)
    report = tuple(change for case in cases for change in case.report)
    return Misbuilt(Stepper(Flaws(**flaws)) if flaws or base is None else base, alter, report)


def reframed(scene):
    """Components of loads in body axes taken in world axes, and the reverse."""
    other = {"world": "body", "body": "world"}
    return scene.replace(forces=tuple(dataclasses.replace(force, parameters={
        **force.parameters, "frame": other[force.parameters["frame"]]}) for force in scene.forces))
