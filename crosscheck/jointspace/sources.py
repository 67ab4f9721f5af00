"""Derivatives that engines give, in the coordinates of the scene, and what each of them claims."""

from __future__ import annotations

import dataclasses
import functools
import importlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from crosscheck import adapters
from crosscheck.adapters.base import Engine, RunSpec
from crosscheck.adapters.common import open_tree
from crosscheck.errors import ArgumentError, EngineError, Unsupported, unknown
from crosscheck.inspection import probe
from crosscheck.jointspace.motion import NONE, JointSpace, of_coordinates, positions, responses, shifted
from crosscheck.running.attempt import Ran, Way, attempt
from crosscheck.scene.assembly import projected
from crosscheck.scene.coordinates import starting
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import mujoco

    from crosscheck.adapters.pinocchio.dynamics import Dynamics

EPS = 1e-6
"""Step of MuJoCo's finite differences where none is asked for; its own default."""

NEAR, THIRD = 1e-6, np.array([1.0, -3.0, 3.0, -1.0])
"""Step of third differences for noise, whose truncation is 1e-18, and their weights, with squares that add up to 20."""

PROXIMAL = 1e-4
"""Regularisation by which Pinocchio takes dependent rows of loops; its iterations remove the effect. Where rows depend
on each other it divides rounding: on `bricard` 1e-10 leaves 1.7e-5, and 1e-3 to 1e-5 leave 9e-11."""


Where = tuple[np.ndarray, np.ndarray]
"""Which coordinates of the scene those of an engine are, and T of (their rates) = T (rates of the engine)."""


@dataclasses.dataclass(frozen=True)
class Blocks:
    """What a source gives.

    `order` is that of its error in `eps`, its step of differences; None if it is analytic. `rounding` is the spacing of
    its numbers at 1. On loops the coordinates are those that the engine has, `rows` of the scene's, or da_dq has all
    accelerations by the directions of `Tangent`, and da_dv nothing.
    """

    da_dq: np.ndarray
    da_dv: np.ndarray
    da_dtau: np.ndarray | None
    order: int | None = None
    eps: float = 0.0
    rounding: float = 2.0**-52
    rows: np.ndarray | None = None

    @classmethod
    def of(cls, where: Where, da_dq: np.ndarray, da_dv: np.ndarray, da_dtau: np.ndarray | None,
           order: int | None = None, eps: float = 0.0, rounding: float = 2.0**-52) -> Blocks:
        """From those of an engine in its own coordinates, see `signed`."""
        rows, T = where
        return cls(T @ da_dq @ T.T, T @ da_dv @ T.T, None if da_dtau is None else T @ da_dtau @ T.T, order, eps,
                   rounding, rows)


WAYS: dict[str, tuple[str, ...]] = {
    "pinocchio": ("aba", "rnea", "constrained", "differences"), "mujoco": ("inverseFD", "transitionFD", "differences"),
    "exudyn": ("linearised", "differences"), "drake": ("autodiff", "differences"),
    "mjx": ("jacfwd", "jacrev", "differences")}
"""The ways of engines besides "differences", the first by default. One of MuJoCo may end with "@EPS"."""


def condition(mass: np.ndarray) -> float:
    """Condition number of a mass matrix whose coordinates are scaled to equal entries on the diagonal."""
    scaling = 1.0 / np.sqrt(np.diag(mass))
    return float(np.linalg.cond(mass * np.outer(scaling, scaling)))


def allowed(blocks: Blocks, size: float, condition: float, rate: float) -> float:
    """Relative error that a source may have: rounding times conditioning, or that of its differences.

    Differences have the error of their order, with derivatives of the size of the motion, and rounding over the step;
    by a rate of this size they round as its terms do, which are as many times a derivative by it.
    """
    rounding = ROUNDINGS * blocks.rounding * condition
    if blocks.order is None:
        return rounding
    return float(DERIVATIVE * max(1.0, size) ** (blocks.order / 2) * blocks.eps**blocks.order
                 + rounding * max(1.0, rate) / blocks.eps)


ROUNDINGS = 100.0
"""Operations between a state and an entry, each of which adds a rounding: a few hundred a body, as a random walk."""

DERIVATIVE = 10.0
"""Second (third) derivatives of accelerations over first ones, for rates of 1/s: sums of a few products of sines. Rates
of the motion grow as the root of the largest first derivative."""


def taken(scene: Scene, source: object, along: np.ndarray | None = None) -> tuple[str, Blocks]:
    """The label of a source, and its blocks; `along` as of `differences`."""
    if not isinstance(source, str):
        return str(getattr(source, "name", type(source).__name__)), _own(scene, source, along)
    name, _, way = source.partition(":")
    if name not in WAYS and way and name not in adapters.names():  # module:Class
        return source, _own(scene, adapters.get(source), along)
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
        return f"{name}:{way}", differences(scene, adapters.get(name), None if way == "differences" else way, along)
    except ModuleNotFoundError as error:
        raise EngineError(f"{name} cannot be imported: {error}") from error


def signed(scene: Scene, unit: States, who: str) -> Where:
    """From the velocities of a unit rate of the engine at each time of `unit`; joints that close loops follow."""
    T = of_coordinates(scene, unit).T
    signs = np.round(T)
    rows = np.flatnonzero((np.abs(T - signs).max(axis=1, initial=0.0) < NONE) & (np.abs(signs).sum(axis=1) == 1))
    if len(rows) != len(unit.t) or not np.array_equal(np.abs(signs[rows]).sum(axis=0), np.ones(len(rows))):
        raise Unsupported(f"{who} on {scene.name!r}: its coordinates turn against those of the scene")
    return rows, signs[rows]


def pinocchio_at(scene: Scene) -> tuple[Dynamics, np.ndarray, np.ndarray, Where]:
    """Its dynamics, q and v at the start, and what `signed` gives."""
    from crosscheck.adapters.pinocchio.dynamics import Dynamics
    from crosscheck.adapters.pinocchio.models import build

    _require("pinocchio", scene)
    made = build(scene, "tree")
    q, v = made.initial_state()
    count = len(v)
    dynamics = Dynamics(made)
    one = {joint.name for joint in scene.joints if joint.kind.has_one}
    if made.parts and one == {link.joint for link in made.links}:
        T = np.zeros((len(scene.joints), count))  # a body in two parts shows the rates of one
        for row, joint in zip(T, scene.joints, strict=True):
            _, at_v, sign, _ = dynamics.coordinate(joint)
            row[at_v] = sign
        return dynamics, q, v, (np.arange(len(T)), T)
    unit = made.states(np.zeros(count), np.tile(q, (count, 1)), np.eye(count), None)
    return dynamics, q, v, signed(scene, unit, "pinocchio")


def mujoco_at(scene: Scene) -> tuple[mujoco.MjModel, mujoco.MjData, Where]:
    """Its model and data at the start, after `mj_forward`, and what `signed` gives."""
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
    v, w = np.zeros((2, model.nv, scene.n, 3))
    for k in range(scene.n):
        body, motions = model.body(str(k)).id, np.zeros((2, 3, model.nv))
        mujoco.mj_jacBodyCom(model, data, *motions, body)
        v[:, k], w[:, k] = motions[0].T, motions[1].T @ data.xmat[body].reshape(3, 3)
    x, R = (np.broadcast_to(each, (model.nv, *each.shape)) for each in (scene.x0, scene.R0))
    return model, data, signed(scene, States(np.zeros(model.nv), x, R, v, w), "mujoco")


def pinocchio_given(scene: Scene, way: str) -> Blocks:
    """`computeABADerivatives`, or those of `rnea` divided by the mass matrix, or those of closed loops.

    Springs are torques from outside to it, whose derivatives are added by the chain rule; dampers are its own
    `model.damping`, which those of closed loops do not take.
    """
    import pinocchio

    dynamics, q, v, where = pinocchio_at(scene)
    model, data, loops = dynamics.model.model, dynamics.data, dynamics.closure
    if dynamics._forces or (loops is None) == (way == "constrained") or dynamics.model.mimics is not None:
        raise Unsupported(f"pinocchio:{way} on {scene.name!r}: " + (
            f"derivatives of {dynamics._forces[0].type} are not its own" if dynamics._forces else
            "it is for closed loops" if loops is None else "it is for trees"))
    damping, springs = np.zeros(model.nv), np.zeros(model.nv)
    for force, _, _, at_v, *_ in dynamics._along:
        if force.is_spring:
            damping[at_v] += force.parameters["damping"]
            springs[at_v] += force.parameters["stiffness"]
    tau, _ = dynamics._applied(0.0, q, v)
    if loops is not None:
        settings = pinocchio.ProximalSettings(1e-14, PROXIMAL, 20)  # as it needs for dependent rows
        pinocchio.constraintDynamics(model, data, q, v, tau, loops.models, loops.workspaces, settings)
        pinocchio.computeConstraintDynamicsDerivatives(model, data, loops.models, loops.workspaces, settings)
        inverse, by_q, by_v = data.ddq_dtau, data.ddq_dq, data.ddq_dv - data.ddq_dtau @ np.diag(damping)
    elif way == "rnea":
        model.damping = damping
        pinocchio.computeRNEADerivatives(model, data, q, v, dynamics(q, v))
        inverse = np.linalg.inv(dynamics.mass_matrix(q))
        by_q, by_v = -inverse @ data.dtau_dq, -inverse @ data.dtau_dv
    else:
        model.damping = damping
        pinocchio.computeABADerivatives(model, data, q, v, tau)
        upper = np.triu(data.Minv)
        inverse, by_q, by_v = upper + np.triu(upper, 1).T, data.ddq_dq, data.ddq_dv
    return Blocks.of(where, by_q - inverse @ np.diag(springs), by_v, inverse)


def mujoco_differences(scene: Scene, way: str, eps: float) -> Blocks:
    """`mjd_inverseFD`, forward differences, or `mjd_transitionFD`, central ones of a step of semi-implicit Euler."""
    import mujoco

    model, data, where = mujoco_at(scene)
    n, h = model.nv, model.opt.timestep
    if way == "inverseFD":
        Dq, Dv, Da = np.zeros((3, n, n))
        mujoco.mjd_inverseFD(model, data, eps, 1, Dq, Dv, Da, None, None, None, None)
        inverse = np.linalg.inv(Da.T)
        return Blocks.of(where, -inverse @ Dq.T, -inverse @ Dv.T, inverse, order=1, eps=eps)
    A = np.zeros((2 * n, 2 * n))
    mujoco.mjd_transitionFD(model, data, eps, 1, A, None, None, None)
    # The velocity after a step is v + h a, so that rounding of v is divided by h too.
    return Blocks.of(where, A[n:, :n] / h, (A[n:, n:] - np.eye(n)) / h, None, order=2, eps=eps, rounding=2.0**-52 / h)


def exudyn_linearised(scene: Scene) -> Blocks:
    """M, K and D of `ComputeLinearizedSystem` of a kinematic tree; K and D are forward differences of the forces."""
    from crosscheck.adapters.exudyn import kinematic_tree, solving

    _refuse_balls(scene, "exudyn")
    _require("exudyn", scene, "tree")
    exudyn, space = solving.load(), JointSpace(scene)
    model, linearised = kinematic_tree.kinematic_tree(scene, "XYZ"), importlib.import_module("exudyn.solver")
    M, K, D = (np.array(part) for part in linearised.ComputeLinearizedSystem(model.system))
    q, one = np.atleast_1d(model.system.GetSensorValues(model.sensors[0])), np.eye(space.size)
    where = signed(scene, model.convert(np.zeros(len(q)), [np.tile(q, (len(q), 1)), one, 0 * one]), "exudyn")
    inverse = np.linalg.inv(M)
    how = exudyn.SimulationSettings().timeIntegration.newton.numericalDifferentiation
    steps = how.relativeEpsilon * (how.minimumCoordinateSize + np.array([0.0, np.abs([q, space.rates]).max()]))
    return Blocks.of(where, -inverse @ K, -inverse @ D, inverse, order=1, eps=steps[1],
                     rounding=2.0**-52 * steps[1] / steps[0])


def _require(name: str, scene: Scene, form: str | None = None) -> None:
    """Raise unless an engine has a method for the scene."""
    engine = adapters.get(name)
    reasons = [engine.unsupported(scene, RunSpec(method, step=1e-3, form=form)) for method in engine.methods]
    if None not in reasons:
        raise Unsupported(f"{name} on {scene.name!r}: {reasons[0]}")


def _refuse_balls(scene: Scene, who: str) -> None:
    """Rates of angles are not those of small turns, but a function of the angles too, which moves the derivatives."""
    for joint in scene.joints:
        if joint.kind.is_ball:
            raise Unsupported(f"{who} on {scene.name!r}: its ball joint {joint.name!r} has three angles, which are not "
                              "the coordinates of the scene")


def drake_autodiff(scene: Scene) -> Blocks:
    """The plant over `AutoDiffXd`, forward mode."""
    from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

    from crosscheck.adapters import drake

    _require("drake", scene)
    _refuse_balls(scene, "drake")
    model = drake.Model(scene)
    model.start(scene, model.bench)
    q, v = (np.array(get(model.bench)) for get in (model.plant.GetPositions, model.plant.GetVelocities))
    convert = open_tree.converter(scene, model.set_state, model.body_state)
    where = signed(scene, convert(np.zeros(len(q)), np.tile(q, (len(q), 1)), np.eye(len(q)), None), "drake")
    plant = model.plant.ToAutoDiffXd()
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, InitializeAutoDiff(np.concatenate([q, v])))
    slopes = ExtractGradient(plant.EvalTimeDerivatives(context).get_generalized_velocity().CopyToVector())
    return Blocks.of(where, slopes[:, :len(q)], slopes[:, len(q):], None)


def mjx_jacobian(scene: Scene, mode: str) -> Blocks:
    """The accelerations of MJX, differentiated by JAX, `jacfwd` or `jacrev`."""
    import jax

    from crosscheck.adapters.mjx import library

    mjx = library(True)
    built, start, where = mujoco_at(scene)
    if built.nq != built.nv:
        raise Unsupported(f"mjx on {scene.name!r}: its positions are quaternions")
    model, data = mjx.put_model(built), mjx.put_data(built, start)

    def accelerated(q: object, v: object) -> Any:
        return mjx.forward(model, data.replace(qpos=q, qvel=v)).qacc

    da_dq, da_dv = (np.asarray(part) for part in jax.jit(getattr(jax, mode)(accelerated, (0, 1)))(data.qpos, data.qvel))
    return Blocks.of(where, da_dq, da_dv, None)


GIVEN: dict[str, Callable[[Scene], Blocks]] = {
    "linearised": exudyn_linearised, "autodiff": drake_autodiff,
    **{way: functools.partial(pinocchio_given, way=way) for way in ("aba", "rnea", "constrained")},
    **{mode: functools.partial(mjx_jacobian, mode=mode) for mode in ("jacfwd", "jacrev")}}
"""Derivatives that an engine has by a way of its own, without a step to choose."""


def acceleration(scene: Scene, engine: Engine, method: str | None = None) -> np.ndarray:
    """What an engine says at the start, see `responses`: of its model, or else of a method's first step."""
    if method is None and engine.name in adapters.built_in.ENTRIES:
        start = starting(scene)
        said = probe(engine, scene, start)
        if said.a is not None and said.alpha is not None:
            return np.asarray(responses(scene, dataclasses.replace(start, a=said.a, alpha=said.alpha), True)[0])
    h = 1e-6
    for name in (method,) if method else engine.methods:
        outcome = attempt(scene.replace(duration=h, samples=2), Way(engine.name, name, h), engine, monitor=False)
        if isinstance(outcome, Ran) and outcome.raw.states.a is not None:
            return np.asarray(responses(scene, outcome.raw.states, True)[0])
    raise Unsupported(f"{engine.name} gives no accelerations on {scene.name!r}")


@runtime_checkable
class Deriving(Protocol):
    """An engine that gives derivatives of its own."""

    def derivatives(self, scene: Scene, state: tuple[np.ndarray, np.ndarray]) -> Any: ...


def differences(scene: Scene, engine: Engine, method: str | None = None, along: np.ndarray | None = None) -> Blocks:
    """Central differences of the accelerations that an engine gives at the start of changed scenes.

    The step is the cube root of the rounding that they show, at which rounding and truncation are alike. `along`
    (12n, m): directions, where joints close loops.
    """
    def accelerated(change: np.ndarray) -> np.ndarray:
        if along is None:
            return acceleration(JointSpace(scene).moved(*np.split(change, 2)), engine, method)
        return acceleration(projected(scene, shifted(scene, along @ change)), engine, method)

    count = 2 * JointSpace(scene).size if along is None else along.shape[1]
    # one side of the start and all directions at once: where noise is odd about the start, or in one alone, it is seen
    aside = NEAR * np.random.default_rng(count).uniform(0.5, 1.0, count)
    near = np.array([accelerated(k * aside) for k in range(1, 5)])
    eps = max(engine.eps, float(np.abs(THIRD @ near).max() / np.sqrt(20.0) / max(1.0, np.abs(near).max(initial=0.0))))
    step = eps ** (1 / 3)
    slopes = np.array([(accelerated(row) - accelerated(-row)) / (2 * step) for row in step * np.eye(count)]).T
    cut = count // 2 if along is None else count
    return Blocks(slopes[:, :cut], slopes[:, cut:], None, 2, step, eps)


def _own(scene: Scene, engine: Any, along: np.ndarray | None) -> Blocks:
    """Those of an engine's `derivatives(scene, state)`, or differences of its accelerations."""
    space = JointSpace(scene) if along is None else None
    given = (engine.derivatives(scene, (positions(scene), space.rates))
             if space is not None and isinstance(engine, Deriving) else None)
    if given is None or space is None:
        return differences(scene, adapters.get(engine), along=along)
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
