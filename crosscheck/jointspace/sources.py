"""Derivatives that engines give, in the coordinates of the scene, and what each of them claims."""

from __future__ import annotations

import dataclasses
import functools
import importlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.common import open_tree
from crosscheck.errors import ArgumentError, EngineError, Unsupported, unknown
from crosscheck.inspection import probe
from crosscheck.jointspace.motion import JointSpace, of_coordinates, positions, starting
from crosscheck.running.attempt import Ran, Way, attempt
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

EPS = 1e-6
"""Step of MuJoCo's finite differences where none is asked for; its own default."""

NEAR, MOST_DIRECTIONS = 1e-8, 3
"""Step of second differences for noise, whose truncation is 1e-16, and in how many directions."""

SAME = 1e-9
"""Largest entry by which rates of an engine may differ from signed rates of the scene."""


@dataclasses.dataclass(frozen=True)
class Blocks:
    """What a source gives.

    `order` is that of its error in `eps`, its step of differences; None if it is analytic. `rounding` is the spacing of
    its numbers at 1.
    """

    da_dq: np.ndarray
    da_dv: np.ndarray
    da_dtau: np.ndarray | None
    order: int | None = None
    eps: float = 0.0
    rounding: float = 2.0**-52


WAYS: dict[str, tuple[str, ...]] = {
    "pinocchio": ("aba", "differences"), "mujoco": ("inverseFD", "transitionFD", "differences"),
    "exudyn": ("linearised", "differences"), "drake": ("autodiff", "differences"),
    "mjx": ("jacfwd", "jacrev", "differences")}
"""The ways of engines besides "differences", the first by default. One of MuJoCo may end with "@EPS"."""


def condition(mass: np.ndarray) -> float:
    """Condition number of a mass matrix whose coordinates are scaled to equal entries on the diagonal."""
    scaling = 1.0 / np.sqrt(np.diag(mass))
    return float(np.linalg.cond(mass * np.outer(scaling, scaling)))


def allowed(blocks: Blocks, size: float, condition: float) -> float:
    """Relative error that a source may have: rounding times conditioning, or that of its differences.

    Differences have the error of their order, with derivatives of the size of the motion, and rounding over the step.
    """
    rounding = ROUNDINGS * blocks.rounding * condition
    if blocks.order is None:
        return rounding
    return float(DERIVATIVE * max(1.0, size) ** (blocks.order / 2) * blocks.eps**blocks.order + rounding / blocks.eps)


ROUNDINGS = 100.0
"""Operations between a state and an entry, each of which adds a rounding: a few hundred a body, as a random walk."""

DERIVATIVE = 10.0
"""Second (third) derivatives of accelerations over first ones, for rates of 1/s: sums of a few products of sines. Rates
of the motion grow as the root of the largest first derivative."""


def taken(scene: Scene, source: Any) -> tuple[str, Blocks]:
    """The label of a source, and its blocks."""
    if not isinstance(source, str):
        return str(getattr(source, "name", type(source).__name__)), _own(scene, source)
    name, _, way = source.partition(":")
    if name not in WAYS and way and name not in adapters.names():  # module:Class
        return source, _own(scene, adapters.get(source))
    ways = WAYS.get(name, ("differences",))
    way, _, step = (way or ways[0]).partition("@")
    if way not in ways and way not in adapters.methods(name):
        raise ArgumentError(unknown(f"way of {name}", way, (*ways, *adapters.methods(name))))
    try:
        eps = float(step or EPS)
    except ValueError:
        eps = 0.0
    if not 0 < eps < 1:
        raise ArgumentError(f"source: {source!r}: after @ a step between 0 and 1 is wanted, such as @1e-6")
    try:
        if way in ("inverseFD", "transitionFD"):
            return f"mujoco:{way}@{eps:g}", mujoco_differences(scene, way, eps)
        if way in GIVEN:
            return f"{name}:{way}", GIVEN[way](scene)
        return f"{name}:{way}", differences(scene, adapters.get(name), None if way == "differences" else way)
    except ModuleNotFoundError as error:
        raise EngineError(f"{name} cannot be imported: {error}") from error


def signed(space: JointSpace, motions: np.ndarray, who: str) -> np.ndarray:
    """T of (rates of the scene) = T (rates of an engine) from its body velocities of unit rates, (6n, nv)."""
    T = np.linalg.pinv(space.motions) @ motions
    signs = np.round(T)
    square = T.shape[0] == T.shape[1]
    if not square or np.abs(T - signs).max() > SAME or not np.array_equal(np.abs(signs).sum(axis=0), np.ones(len(T))):
        raise Unsupported(f"{who} on {space.scene.name!r}: its coordinates turn against those of the scene")
    return np.asarray(signs)


def pinocchio_at(scene: Scene) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    """Its dynamics, q and v at the start, and T of `signed`."""
    from crosscheck.adapters.pinocchio.dynamics import Dynamics
    from crosscheck.adapters.pinocchio.models import build

    made = build(scene, "tree")
    q, v = made.initial_state()
    count = len(v)
    unit = made.states(np.zeros(count), np.tile(q, (count, 1)), np.eye(count), None)
    return Dynamics(made), q, v, signed(JointSpace(scene), _motions(unit), "pinocchio")


def _motions(unit: States) -> np.ndarray:
    """(6n, count): body velocities of unit rates, each of which is a time of the states."""
    return np.concatenate([unit.v, unit.w], axis=2).reshape(len(unit.v), -1).T


def mujoco_at(scene: Scene) -> tuple[Any, Any, np.ndarray]:
    """Its model and data at the start, after `mj_forward`, and T of `signed`."""
    import mujoco

    from crosscheck.adapters.mujoco import models

    if reason := models.obstacle(scene, "tree"):
        raise Unsupported(f"mujoco on {scene.name!r}: {reason}")
    model = models.build(scene, "Euler", 1e-3, "tree")
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    data = mujoco.MjData(model)
    models.set_initial_state(scene, model, data)
    if control := models.controls(scene):
        control(model, data)
    mujoco.mj_forward(model, data)
    motions = np.zeros((scene.n, 6, model.nv))
    for k in range(scene.n):
        body = model.body(str(k)).id
        mujoco.mj_jacBodyCom(model, data, motions[k, :3], motions[k, 3:], body)
        motions[k, 3:] = data.xmat[body].reshape(3, 3).T @ motions[k, 3:]
    return model, data, signed(JointSpace(scene), motions.reshape(6 * scene.n, -1), "mujoco")


def pinocchio_aba(scene: Scene) -> Blocks:
    """`computeABADerivatives`. Springs are torques from outside to it, whose derivatives are added by the chain rule;
    dampers are its own `model.damping`.
    """
    import pinocchio

    dynamics, q, v, T = pinocchio_at(scene)
    model, data = dynamics.model.model, dynamics.data
    if dynamics._forces:
        raise Unsupported(f"pinocchio on {scene.name!r}: derivatives of {dynamics._forces[0].type} are not its own")
    damping, springs = np.zeros(model.nv), np.zeros(model.nv)
    for force, _, at_v, _ in dynamics._turns:
        if force.type == "torsional_spring":
            damping[at_v] += force.parameters["damping"]
            springs[at_v] += force.parameters["stiffness"]
    model.damping = damping
    tau, _ = dynamics._applied(0.0, q, v)
    pinocchio.computeABADerivatives(model, data, q, v, tau)
    upper = np.triu(data.Minv)
    inverse = upper + np.triu(upper, 1).T
    return Blocks(T @ (data.ddq_dq - inverse @ np.diag(springs)) @ T.T, T @ data.ddq_dv @ T.T, T @ inverse @ T.T)


def mujoco_differences(scene: Scene, way: str, eps: float) -> Blocks:
    """`mjd_inverseFD`, forward differences, or `mjd_transitionFD`, central ones of a step of semi-implicit Euler."""
    import mujoco

    model, data, T = mujoco_at(scene)
    n, h = model.nv, model.opt.timestep
    if way == "inverseFD":
        Dq, Dv, Da = np.zeros((3, n, n))
        mujoco.mjd_inverseFD(model, data, eps, 1, Dq, Dv, Da, None, None, None, None)
        inverse = np.linalg.inv(Da.T)
        return Blocks(-T @ inverse @ Dq.T @ T.T, -T @ inverse @ Dv.T @ T.T, T @ inverse @ T.T, 1, eps)
    A = np.zeros((2 * n, 2 * n))
    mujoco.mjd_transitionFD(model, data, eps, 1, A, None, None, None)
    # The velocity after a step is v + h a, so that rounding of v is divided by h too.
    return Blocks(T @ A[n:, :n] @ T.T / h, T @ (A[n:, n:] - np.eye(n)) @ T.T / h, None, 2, eps, 2.0**-52 / h)


def exudyn_linearised(scene: Scene) -> Blocks:
    """M, K and D of `ComputeLinearizedSystem` of a kinematic tree; K and D are forward differences of the forces."""
    from crosscheck.adapters.exudyn import kinematic_tree, solving

    exudyn, space = solving.load(), JointSpace(scene)
    model, linearised = kinematic_tree.kinematic_tree(scene, "XYZ"), importlib.import_module("exudyn.solver")
    M, K, D = (np.array(part) for part in linearised.ComputeLinearizedSystem(model.system))
    q, one = np.atleast_1d(model.system.GetSensorValues(model.sensors[0])), np.eye(space.size)
    T = signed(space, _motions(model.convert(np.zeros(len(q)), [np.tile(q, (len(q), 1)), one, 0 * one])), "exudyn")
    inverse = np.linalg.inv(M)
    how = exudyn.SimulationSettings().timeIntegration.newton.numericalDifferentiation
    steps = how.relativeEpsilon * (how.minimumCoordinateSize + np.array([0.0, np.abs([q, space.speeds]).max()]))
    return Blocks(-T @ inverse @ K @ T.T, -T @ inverse @ D @ T.T, T @ inverse @ T.T, 1, steps[1],
                  2.0**-52 * steps[1] / steps[0])


def drake_autodiff(scene: Scene) -> Blocks:
    """The plant over `AutoDiffXd`, forward mode."""
    from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

    from crosscheck.adapters import drake

    engine, space = drake.Drake(), JointSpace(scene)
    reason = engine.unsupported(scene, RunSpec(engine.methods[0]))
    if reason or any(JOINT_TYPES[joint.type].coordinates == ("ball",) for joint in scene.joints):
        raise Unsupported(f"drake on {scene.name!r}: {reason or 'its ball joint has angles'}")
    model = drake.Model(scene)
    model.start(scene, model.bench)
    q, v = (np.array(get(model.bench)) for get in (model.plant.GetPositions, model.plant.GetVelocities))
    convert = open_tree.converter(scene, model.set_state, model.body_state)
    T = signed(space, _motions(convert(np.zeros(len(q)), np.tile(q, (len(q), 1)), np.eye(len(q)), None)), "drake")
    plant = model.plant.ToAutoDiffXd()
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, InitializeAutoDiff(np.concatenate([q, v])))
    slopes = ExtractGradient(plant.EvalTimeDerivatives(context).get_generalized_velocity().CopyToVector())
    return Blocks(T @ slopes[:, :len(q)] @ T.T, T @ slopes[:, len(q):] @ T.T, None)


def mjx_jacobian(scene: Scene, mode: str) -> Blocks:
    """The accelerations of MJX, differentiated by JAX, `jacfwd` or `jacrev`."""
    import jax

    from crosscheck.adapters.mjx import library

    mjx = library(True)
    built, start, T = mujoco_at(scene)
    if built.nq != built.nv:
        raise Unsupported(f"mjx on {scene.name!r}: its positions are quaternions")
    model, data = mjx.put_model(built), mjx.put_data(built, start)

    def accelerated(q: Any, v: Any) -> Any:
        return mjx.forward(model, data.replace(qpos=q, qvel=v)).qacc

    da_dq, da_dv = (np.asarray(part) for part in jax.jit(getattr(jax, mode)(accelerated, (0, 1)))(data.qpos, data.qvel))
    return Blocks(T @ da_dq @ T.T, T @ da_dv @ T.T, None)


GIVEN: dict[str, Callable[[Scene], Blocks]] = {
    "aba": pinocchio_aba, "linearised": exudyn_linearised, "autodiff": drake_autodiff,
    **{mode: functools.partial(mjx_jacobian, mode=mode) for mode in ("jacfwd", "jacrev")}}
"""Derivatives that an engine has by a way of its own, without a step to choose."""


def differences(scene: Scene, engine: Any, method: str | None = None) -> Blocks:
    """Central differences of the accelerations that an engine gives at the start of changed scenes.

    The step is the cube root of the rounding that they show, at which rounding and truncation are alike.
    """
    space = JointSpace(scene)
    names = (method,) if method else engine.methods
    known = method is None and engine.name in adapters.built_in.ENTRIES
    zero = np.zeros(space.size)

    def accelerated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        changed = space.moved(q, v)
        if known:  # what its model says at a state, without a step
            start = starting(changed)
            said = probe(engine, changed, start)
            if said.a is not None and said.alpha is not None:
                return of_coordinates(changed, dataclasses.replace(start, a=said.a, alpha=said.alpha))
        h = 1e-6
        for name in names:
            outcome = attempt(changed.replace(duration=h, samples=2), Way(engine.name, name, h), engine, monitor=False)
            if isinstance(outcome, Ran):
                s = outcome.raw.states
                if s.a is not None and s.alpha is not None:
                    return of_coordinates(changed, s)
        raise Unsupported(f"{engine.name} gives no accelerations on {scene.name!r}")

    eps = max(float(getattr(engine, "eps", 2.0**-52)), _noise(accelerated, space.size))
    step = eps ** (1 / 3)
    columns = [[(accelerated(*(zero + step * sign * row if part == k else zero for k in range(2))))
                for sign in (1, -1)] for part in range(2) for row in np.eye(space.size)]
    found = np.array([(up - down) / (2 * step) for up, down in columns]).T
    return Blocks(found[:, :space.size], found[:, space.size:], None, 2, step, eps)


def _noise(accelerated: Callable[[np.ndarray, np.ndarray], np.ndarray], size: int) -> float:
    """Relative noise of accelerations: of second differences so small that they have nothing else."""
    zero = np.zeros(size)
    begin, noise = accelerated(zero, zero), 0.0
    for row in np.eye(size)[:MOST_DIRECTIONS]:
        ends = [accelerated(sign * NEAR * row, zero) for sign in (1.0, -1.0)]
        noise = max(noise, float(np.abs(ends[0] - 2.0 * begin + ends[1]).max()) / 2.0)
    return noise / max(1.0, float(np.abs(begin).max()))


def _own(scene: Scene, engine: Any) -> Blocks:
    """Those of an engine's `derivatives(scene, state)`, or differences of its accelerations."""
    give: Callable[..., Any] | None = getattr(engine, "derivatives", None)
    space = JointSpace(scene)
    given = None if give is None else give(scene, (positions(scene), space.speeds))
    if given is None:
        return differences(scene, adapters.get(engine))
    who, shape = f"derivatives of {getattr(engine, 'name', engine)!r}", (space.size, space.size)
    if not isinstance(given, Mapping) or not {"da_dq", "da_dv"} <= set(given):
        raise EngineError(f"{who}: give a dict with da_dq, da_dv and da_dtau")
    order, eps = given.get("order"), float(given.get("eps", 0.0))
    if order is not None and not (order in (1, 2, 4) and 0 < eps < 1):
        raise EngineError(f"{who}: order and eps are those of differences: 1, 2 or 4, and a step between 0 and 1")
    blocks = {key: np.asarray(given[key], dtype=float) for key in ("da_dq", "da_dv", "da_dtau")
              if given.get(key) is not None}
    for key, value in blocks.items():
        if value.shape != shape or not np.isfinite(value).all():
            raise EngineError(f"{who}: {key} is not finite or of shape {value.shape}, not {shape}")
    return Blocks(blocks["da_dq"], blocks["da_dv"], blocks.get("da_dtau"), order, eps)
