"""Newton, physics in Warp, on the processor in single precision: four of its solvers for rigid bodies.

Source: https://newton-physics.github.io/newton. `Featherstone` and the `MuJoCo` integrators step in joint coordinates,
`XPBD` and `SemiImplicit` move free bodies, the first with projected joints and the second with joints that are springs.
With the softness "default" both run as Newton sets them up, with "tight" as they come closest to joints that are rigid.
Newton needs a MuJoCo of its own version, and so an environment of its own (`crosscheck.adapters.external.versions`).
"""

from __future__ import annotations

import dataclasses
import functools
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.adapters.common import open_tree, stepping, tree
from crosscheck.adapters.common.held import highest_order
from crosscheck.adapters.common.native import JointStates, Native, Part, assembled, moved
from crosscheck.adapters.common.own_law import OwnLaw
from crosscheck.adapters.mujoco.own_law import default
from crosscheck.errors import EngineError, errors_as
from crosscheck.files import aside
from crosscheck.scene.model import GROUND, Joint, Scene, quaternion_from_rotation, rotation_from_quaternion
from crosscheck.scene.models import source
from crosscheck.scene.states import States
from crosscheck.scene.vectors import shortest_rotation

FORMS = {"Featherstone": "tree", "MuJoCoEuler": "tree", "MuJoCoImplicitfast": "tree", "MuJoCoRK4": "tree",
         "XPBD": "maximal", "SemiImplicit": "maximal"}
"""Each method and the form of its coordinates."""

LAWS = {"Featherstone": ("servo", "soft_limits"), "SemiImplicit": ("servo", "soft_limits"),
        **dict.fromkeys(("MuJoCoEuler", "MuJoCoImplicitfast", "MuJoCoRK4"), ("servo", "dry_friction"))}
"""What each method has of the force laws of joints: `joint_target_ke` and `kd`, `joint_limit_ke` and `kd`, of which the
damper pulls as well, `joint_friction` as MuJoCo's frictionloss. The first two ignore friction and effort limits; limits
of MuJoCo are soft rows whose stiffness hangs on the inertia."""

XYZW = (1, 2, 3, 0)
"""Places of Newton's quaternion entries x, y, z, w in ours."""

SINGLE, UNLIMITED = 3e-5, 1e9
"""Relative bound on what Newton reads, in single precision, and from where on a limit is none."""

class Newton(Engine):
    """Adapter of Newton: form `tree` or `maximal`, as the method has it."""

    name = "newton"
    methods = tuple(FORMS)
    forms = ("tree", "maximal")
    options = frozenset({"form", "softness"})
    orders = MappingProxyType({"MuJoCoRK4": 4})  # the others are first order
    package = "newton"
    eps = 2.0**-23
    pace = 4
    reads = (".urdf", ".xml", ".usd", ".usda", ".usdc")

    def held_levels(self, scene: Scene, spec: RunSpec) -> frozenset[str]:
        """All three by joint coordinates, none by free bodies."""
        return tree.LEVELS if FORMS[spec.method] == "tree" else frozenset()

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        """Why Newton cannot run this here, or None."""
        if spec.form not in (None, FORMS[spec.method]):
            return f"{spec.method} has form {FORMS[spec.method]} only"
        both = {name for name, _ in scene.servos.values()} & {joint.name for joint in scene.joints if any(joint.limits)}
        if both:
            return f"joint {min(both)!r} has limits and a servo, which Newton takes away beyond the range"
        return open_tree.springless(scene) or open_tree.unsupported(
            scene, dataclasses.replace(spec, form=None), LAWS.get(spec.method, "XPBD takes targets and limits as "
            "compliant rows of joints, which its iterations do not solve"))

    def documented_order(self, scene: Scene, spec: RunSpec) -> int | None:
        """That of the method, as far as the forces are smooth: nothing locates events."""
        return min(order := self.orders.get(spec.method, 1), highest_order(scene) or order)

    def own_law(self, scene: Scene, spec: RunSpec) -> States | None:
        """That of MuJoCo's dry friction at its default softness, which Newton's MuJoCo methods leave as it is."""
        own = spec.method.startswith("MuJoCo") and any(any(joint.dry_friction) for joint in scene.joints)
        return OwnLaw(scene, default, self.name).states() if own else None

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` if the state becomes infinite or NaN."""
        warp = silent_warp()
        h = stepping.fixed_step(scene, spec)[1]
        with warp.ScopedDevice("cpu"):
            import newton

            model, order = build(scene), _order(scene)
            solver = _solver(scene, model, spec, h)
            now, then = model.state(), model.state()
            now.body_q.assign(_poses(scene)[order])
            # of the mass centres, in world axes
            now.body_qd.assign(np.concatenate([scene.v0, np.einsum("nij,nj->ni", scene.R0, scene.w0)], axis=1)[order])
            newton.eval_ik(model, now, now.joint_q, now.joint_qd)
            control, back = model.control(), np.argsort(order)

            def state() -> tuple[np.ndarray, np.ndarray]:
                return tuple(each.numpy()[back].astype(float).ravel() for each in (now.body_q, now.body_qd))

            start = state()

            def step(source: Any, target: Any) -> None:
                source.clear_forces()
                solver.step(source, target, control, None, h)

            step(model.state(), then)  # compile before the clock runs; a step may change its input
            forth, other = (recorded(warp, functools.partial(step, *pair)) for pair in ((now, then), (then, now)))

            def advance(count: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
                nonlocal now, then, forth, other
                q, v = np.empty((count // stride, 7 * scene.n)), np.empty((count // stride, 6 * scene.n))
                for row in range(len(q)):
                    for _ in range(stride):
                        forth()
                        now, then, forth, other = then, now, other, forth
                    q[row], v[row] = state()
                return q, v

            raw = stepping.march(scene, spec, start, advance, open_tree.of_poses(scene), lambda t, q, v: v)
        raw.form = FORMS[spec.method]
        if raw.form == "maximal":
            raw.stats["softness"] = spec.softness or "tight"
        return raw


    def native(self, path: str, states: JointStates) -> Native:
        """The model that Newton makes of a model file by itself; for USD it needs pxr and Newton's schemas."""
        warp = silent_warp()
        with aside(1, 2), warp.ScopedDevice("cpu"), warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
            warnings.simplefilter("ignore")  # of meshes and of what its importers do not take
            import newton

            builder, add = newton.ModelBuilder(), "usd"
            if not Path(path).suffix.lower().startswith(".usd"):
                model = source.bare(Path(path))
                add = "urdf" if model.is_urdf else "mjcf"
            if add == "urdf":  # without its shapes, whose meshes may be anywhere
                path = f"{folder}/model.urdf"
                Path(path).write_text(model.text)
            with errors_as(lambda error: EngineError(f"Newton cannot read it: {' '.join(str(error).split())}")):
                getattr(builder, f"add_{add}")(path)
            return loaded(warp, newton, builder, states)


def loaded(warp: Any, newton: Any, builder: Any, states: JointStates) -> Native:
    """What stands in a `newton.ModelBuilder`, in single precision."""
    kinds = {newton.JointType.REVOLUTE: "revolute", newton.JointType.PRISMATIC: "prismatic"}
    names, joints = ([label.rpartition("/")[2] for label in labels]
                     for labels in (builder.body_label, builder.joint_label))
    held = dict(zip(builder.joint_child, range(len(joints)), strict=False))
    for j, kind in enumerate(builder.joint_type):
        if held[builder.joint_child[j]] != j:
            raise EngineError(f"joint {joints[j]!r} closes a loop, which is not compared")
        if kind not in (*kinds, newton.JointType.FIXED, newton.JointType.FREE):
            raise EngineError(f"joint {joints[j]!r} has several coordinates, which is not compared")
    model = builder.finalize(device="cpu")
    state, q, v = model.state(), model.joint_q.numpy(), model.joint_qd.numpy()
    moving = {joints[j]: (builder.joint_q_start[j], builder.joint_qd_start[j])
              for j, kind in enumerate(builder.joint_type) if kind in kinds}
    columns, rows = {name: k for k, name in enumerate(moving)}, [row for _, row in moving.values()]

    def placed(position: Any, velocity: Any) -> None:
        q[[at for at, _ in moving.values()]], v[rows] = position, velocity
        state.joint_q.assign(q), state.joint_qd.assign(v)
        newton.eval_fk(model, state.joint_q, state.joint_qd, state)

    placed(0.0, 0.0)
    poses = {-1: (np.zeros(3), np.eye(3))} | {k: _pose(pose) for k, pose in enumerate(state.body_q.numpy())}
    parts: dict[str, Part] = {}
    for k in sorted(range(len(names)), key=lambda k: held.get(k, -1)):  # joints come parents first
        (x, R), mass = poses[k], float(builder.body_mass[k])
        j = held.get(k, -1)  # -1: on no joint, it is free
        kind, parent = (builder.joint_type[j], builder.joint_parent[j]) if j >= 0 else (newton.JointType.FREE, -1)
        more: dict[str, Any] = {"free": kind == newton.JointType.FREE}
        if kind in kinds:
            (outer, turned), (anchor, axes), dof = poses[parent], _pose(builder.joint_X_p[j]), builder.joint_qd_start[j]
            ends = float(builder.joint_limit_lower[dof]), float(builder.joint_limit_upper[dof])
            more = {"joint": joints[j], "anchor": outer + turned @ anchor, "kind": kinds[kind],
                    "axis": turned @ axes @ np.array(builder.joint_axis[dof], dtype=float),
                    "damping": float(builder.joint_damping[dof]), "armature": float(builder.joint_armature[dof]),
                    "limits": ends if max(map(abs, ends)) < UNLIMITED else None}
        inertia = np.array(builder.body_inertia[k], dtype=float).reshape(3, 3)
        parts[names[k]] = Part(names[parent] if parent >= 0 else "", mass,
                               x + R @ np.array(builder.body_com[k], dtype=float), R @ inertia @ R.T, R, **more)

    def terms(position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        placed(position, velocity)
        M = newton.eval_mass_matrix(model, state).numpy()[0].astype(float)
        found = {key: warp.zeros_like(model.joint_qd) for key in ("gravity_force", "coriolis_force")}
        newton.eval_inverse_dynamics_passive(model, state, **found)
        return M[np.ix_(rows, rows)], np.sum([each.numpy()[rows] for each in found.values()], axis=0, dtype=float)

    gravity = np.array(model.gravity.numpy(), dtype=float).reshape(-1, 3)[0]
    read = dataclasses.replace(assembled("newton", parts, gravity), tolerance=SINGLE)
    return moved(read, states, columns, "eval_inverse_dynamics_passive", terms)


def _pose(transform: Any) -> tuple[np.ndarray, np.ndarray]:
    """Position and attitude of a transform of Warp."""
    values = np.array(transform, dtype=float)
    return values[:3], rotation_from_quaternion(values[[6, 3, 4, 5]])


def recorded(warp: Any, step: Callable[[], None]) -> Callable[[], None]:
    """The kernels that a step launches, replayed without Python, to the same bits in a sixtieth of the time.

    Warp before 1.19 records nothing on a processor; there the step itself is returned.
    """
    try:
        with warp.ScopedCapture(device="cpu") as capture:
            step()
    except RuntimeError:
        return step
    return functools.partial(warp.capture_launch, capture.graph)


def silent_warp() -> Any:
    """Warp without a word about the graphics card that it does not find and what it compiles."""
    with aside(1, 2):
        import warp

        warp.config.log_level = warp.LOG_ERROR
        warp.init()
    return warp


def build(scene: Scene) -> Any:
    """The scene as a `newton.Model`, whose body frames are at the centres of mass."""
    import newton
    import warp

    builder = newton.ModelBuilder(gravity=tuple(scene.gravity))
    builder.balance_inertia = False
    poses, order = _poses(scene), _order(scene)
    place = {body: k for k, body in enumerate(order)} | {GROUND: -1}
    for body, pose in ((scene.bodies[k], poses[k]) for k in order):
        builder.add_link(xform=warp.transform(*pose), mass=body.mass, inertia=warp.mat33(*body.inertia.ravel()),
                         label=body.name)
    joints = []
    for link in tree.links(scene):
        axial = link.type in ("revolute", "prismatic")
        # Of a joint's axes XPBD holds those at right angles to its motion, so that one of them has to be along it.
        turn = shortest_rotation(np.eye(3)[0], link.parts[0].axis) if axial else np.eye(3)
        outer, own = quaternion_from_rotation(np.array([open_tree.zero_attitude(scene, link) @ turn, turn]))
        ends = {"parent_xform": warp.transform(*link.parent_anchor, *outer[list(XYZW)]),
                "child_xform": warp.transform(*link.child_anchor, *own[list(XYZW)])}
        if axial:
            ends |= {"axis": warp.vec3(1.0, 0.0, 0.0), **_laws(scene, link)}
        add = getattr(builder, "add_joint_ball" if link.type == "spherical" else f"add_joint_{link.type}")
        joints.append(add(place[link.parent], place[link.body], **ends))
    builder.add_articulation(joints)
    return builder.finalize(device="cpu")


def _laws(scene: Scene, link: tree.Link) -> dict[str, float]:
    """What a hinge or slide has of dry friction, soft limits and servos, as Newton names it."""
    _, sign, zero = tree.coordinate(scene, link)
    law, gains = scene.joint(link.joint), dict[str, float]()
    for friction in filter(None, law.dry_friction):
        gains["friction"] = friction.sliding
    for limits in filter(None, law.limits):
        gains |= dict(zip(("limit_lower", "limit_upper"), tree.ends(limits, sign, zero, 1e9), strict=True))
        gains |= {"limit_ke": limits.stiffness or 0.0, "limit_kd": limits.damping}
    for servo in (servo for name, servo in scene.servos.values() if name == link.joint):
        gains |= {"target_ke": servo.proportional, "target_kd": servo.derivative,
                  "target_q": open_tree.rest(servo, sign, zero)}
    return gains


XPBD = {"iterations": 8, "joint_linear_relaxation": 0.4, "joint_angular_relaxation": 0.4}
"""Newton's own factors, 0.7 and 0.4, take different shares of the linear and the angular part of an impulse, as if a
body had another inertia: then no step and no number of iterations leads to the motion of the scene. Every iteration
turns roundings of positions over the step into velocities: 20 a step leave four times what 8 do."""

SPRING = 0.3
"""Stiffness h^2 / m and damping h / m of joint springs, m the mass that a joint moves; steps diverge near 4 and 2."""


HEAVY = 2000.0
"""Mass times mobility above which joint springs bend by more than the method errs otherwise."""


def _solver(scene: Scene, model: Any, spec: RunSpec, h: float) -> Any:
    """A solver without the damping of angular velocities that Newton has by default."""
    from newton import solvers

    tight = spec.softness != "default"
    if spec.method.startswith("MuJoCo"):
        with warnings.catch_warnings():  # of an order of joints that is not MuJoCo's; Newton goes from one to the other
            warnings.simplefilter("ignore", UserWarning)
            return solvers.SolverMuJoCo(model, integrator=spec.method.removeprefix("MuJoCo").lower(),
                                        disable_contacts=True, kinematic_switchable_roots=False)
    if spec.method == "XPBD":
        return solvers.SolverXPBD(model, angular_damping=0.0, **(XPBD if tight else {}))
    if spec.method == "SemiImplicit":
        share = SPRING / max(_mobility(scene, joint) for joint in scene.joints)
        stiff = {"joint_attach_ke": share / h**2, "joint_attach_kd": share / h} if tight else {}
        return solvers.SolverSemiImplicit(model, angular_damping=0.0, **stiff)
    return solvers.SolverFeatherstone(model, angular_damping=0.0)


def _mobility(scene: Scene, joint: Joint) -> float:
    """The most that a unit force, or torque if the joint holds attitudes, accelerates its ends (1/kg, 1/(kg m^2))."""
    total = 0.0
    for body, anchor in ((joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor)):
        if body != GROUND:
            lever = max(float(anchor @ anchor), 0.0 if joint.type == "spherical" else 1.0)
            total += 1.0 / scene.masses[body] + lever / float(np.linalg.eigvalsh(scene.inertias[body])[0])
    return total


def _order(scene: Scene) -> list[int]:
    """Bodies in the order of their joints: Featherstone's mass matrix takes a joint's number for that of its body."""
    return [link.body for link in tree.links(scene)]


def _poses(scene: Scene) -> np.ndarray:
    """(n, 7) positions and quaternions x, y, z, w at the start."""
    return np.concatenate([scene.x0, np.array([body.attitude for body in scene.bodies])[:, XYZW]], axis=1)
