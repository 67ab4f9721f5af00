"""Pinocchio models of a scene: joint coordinates on a tree, and rigid constraints for the joints that are cut.

`tree`: a spanning tree of the scene, with every joint an exact composite of turns, slides and balls. `maximal`: every
body free, every joint closed by a constraint. A free body is a translation in the world and a ball, so that its
velocities are those of `crosscheck.scene.states`.

Pinocchio's rigid constraints hold points (3D) and frames (6D). The first closes a spherical joint, the second a fixed
one. For all other joints the child is cut instead: a second part of it, with its share of the inertia, hangs on the
joint and is welded to the child. (A hinge held at two points of its axis would have one row too many, which locks a
rotation as soon as the axes drift apart: on the branching tree this causes an error of 0.02 m within a second.)
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.adapters.common import links as links_module
from crosscheck.adapters.common import tree
from crosscheck.adapters.common.links import Link, free, unfold
from crosscheck.adapters.pinocchio import mimics
from crosscheck.scene.model import GROUND, Joint, Scene, rotation_from_quaternion
from crosscheck.scene.states import States

if TYPE_CHECKING:
    import pinocchio

RANK_TOLERANCE = 1e-9
"""Singular values of the constraint Jacobian below this fraction of the largest count as redundant rows."""


@dataclasses.dataclass
class Model:
    """A `pinocchio.Model` and its relation to the scene.

    `frames[body]` is the joint that carries a body, and the placement of the body's frame (centre of mass, its axes) in
    it; `slots` are the slices of each link's coordinates in q and v, `armature` (nv,) goes with them; `balls` are the
    slices of v of balls. Second parts of bodies are numbered after the bodies: link.body >= n is a part of
    `parts[link.body]`. Where joints follow others, `model` and `balls` have the independent coordinates only.
    """

    scene: Scene
    links: tuple[Link, ...]
    parts: dict[int, int]
    cut: tuple[Joint, ...]  # closed by a point or frame constraint, without a second part
    model: pinocchio.Model
    frames: dict[int, tuple[int, pinocchio.SE3]]
    slots: list[tuple[slice, slice]]
    balls: list[slice]
    armature: np.ndarray
    mimics: mimics.Mimics | None = None

    def positions(self, q: np.ndarray) -> np.ndarray:
        """Position coordinates (..., nq) of all joints from those of `model`."""
        return q if self.mimics is None else q @ self.mimics.Q.T + self.mimics.offset

    def rates(self, v: np.ndarray) -> np.ndarray:
        """Velocities or accelerations (..., nv) of all joints from those of `model`."""
        return v if self.mimics is None else v @ self.mimics.V.T

    def initial_state(self, scene: Scene | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(q, v) of the scene at t = 0, or of the same scene in another state; quaternions x, y, z, w."""
        q, v = (np.zeros(max((slot.stop for slot in each), default=0)) for each in zip(*self.slots, strict=True))
        for link, (at_q, at_v) in zip(self.links, self.slots, strict=True):
            scalar_first, v[at_v] = tree.initial_coordinates(
                scene or self.scene, dataclasses.replace(link, body=self.parts.get(link.body, link.body)))
            q[at_q] = _rolled(link, scalar_first[None], -1)[0]
        return (q, v) if self.mimics is None else (q[self.mimics.kept[0]], v[self.mimics.kept[1]])

    def states(self, t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None) -> States:
        """States of the bodies from histories (T, nq), (T, nv), (T, nv)."""
        q, v, a = self.positions(q), self.rates(v), None if a is None else self.rates(a)
        motions = [tree.motion(link, _rolled(link, q[:, at_q], 1), v[:, at_v], None if a is None else a[:, at_v])
                   for link, (at_q, at_v) in zip(self.links, self.slots, strict=True)]
        bodies, n = tree.forward(self.links, motions, t, a is not None), self.scene.n
        linear, alpha = (None if values is None else values[:, :n] for values in (bodies.a, bodies.alpha))
        tree_links = [dataclasses.replace(link, body=self.parts.get(link.body, link.body)) for link in self.links]
        return States(t, bodies.x[:, :n], bodies.R[:, :n], bodies.v[:, :n], bodies.w[:, :n], linear, alpha,
                      hinges=tree.hinges(self.scene, tree_links, [at_q.start for at_q, _ in self.slots], q))


def decompose(scene: Scene, form: str) -> tuple[tuple[Link, ...], dict[int, int], tuple[Joint, ...]]:
    """(links with those of second parts, the body each part belongs to, joints closed directly) in `form`."""
    if form == "maximal":
        tree_links, cut = tuple(free(body) for body in range(scene.n)), scene.joints
    else:
        tree_links, cut = unfold(scene)
    bridged = [joint for joint in cut if joint.kind.motion and not joint.kind.is_ball]
    parts = {scene.n + k: joint.child for k, joint in enumerate(bridged)}
    hung = [dataclasses.replace(links_module.link(scene, joint), body=part)
            for part, joint in zip(parts, bridged, strict=True)]
    return links_module.depth_first([*tree_links, *hung]), parts, tuple(joint for joint in cut if joint not in bridged)


def build(scene: Scene, form: str = "tree") -> Model:
    """The model of a scene in form "tree" or "maximal", with joint frames at the outer bodies' anchors and axes."""
    made = assemble(scene, *decompose(scene, form))
    if all(joint.mimic is None for joint in scene.joints):
        return made
    mimicking, coupling = mimics.coupled(scene, made.model, made.links, made.slots, made.initial_state()[0])
    firsts = np.searchsorted(coupling.kept[1], [ball.start for ball in made.balls])
    balls = [slice(first, first + 3) for first in firsts]
    return dataclasses.replace(made, model=mimicking, mimics=coupling, balls=balls)


def assemble(scene: Scene, links: tuple[Link, ...], parts: dict[int, int], cut: tuple[Joint, ...]) -> Model:
    """The model of the given links, which must be ordered subtree by subtree."""
    import pinocchio

    model = pinocchio.Model()
    model.gravity.linear = np.array(scene.gravity)
    frames = {GROUND: (0, pinocchio.SE3.Identity())}
    shares = {body: 1.0 / (1 + list(parts.values()).count(body)) for body in range(scene.n)}
    for link in links:
        joint, inner = frames[link.parent]
        body = parts.get(link.body, link.body)
        placement = inner * pinocchio.SE3(rotation_from_quaternion(link.zero), np.array(link.parent_anchor))
        frame = pinocchio.SE3(np.eye(3), -link.child_anchor)
        if link.parts:
            joint = model.addJoint(joint, _joint_model(link), placement, str(link.body))
        else:  # one rigid body with its parent
            frame = placement * frame
        inertia = pinocchio.Inertia(shares[body] * scene.masses[body], np.zeros(3), shares[body] * scene.inertias[body])
        model.appendBodyToJoint(joint, inertia, frame)
        frames[link.body] = joint, frame
    slots, balls = [], []
    armature, joints = np.array(model.armature), {joint.name: joint for joint in scene.joints}
    for link in links:
        joint = model.getJointId(str(link.body)) if link.parts else 0
        q, v = (model.idx_qs[joint], model.idx_vs[joint]) if link.parts else (0, 0)
        slots.append((slice(q, q + sum(part.coordinates for part in link.parts)), slice(v, v + link.dofs)))
        values = joints[link.joint].armature if link.joint else ()
        if values:  # a cylindrical joint is a slide and then a turn, the opposite of the scene's order
            armature[slots[-1][1]] = values[::-1] if len(values) == 2 else values
        for part in link.parts:
            if part.kind == "ball":
                balls.append(slice(v, v + part.dofs))
            v += part.dofs
    model.armature = armature
    return Model(scene, links, parts, cut, model, frames, slots, balls, armature)


def _joint_model(link: Link) -> pinocchio.JointModel:
    import pinocchio

    made = {"ball": lambda part: pinocchio.JointModelSpherical(),
            "turn": lambda part: pinocchio.JointModelRevoluteUnaligned(part.axis),
            "slide": lambda part: pinocchio.JointModelPrismaticUnaligned(part.axis)}
    if len(link.parts) == 1:
        return made[link.parts[0].kind](link.parts[0])
    composite = pinocchio.JointModelComposite()
    for part in link.parts:
        composite.addJoint(made[part.kind](part), pinocchio.SE3(np.eye(3), part.offset))
    return composite


def _rolled(link: Link, q: np.ndarray, shift: int) -> np.ndarray:
    """q (T, nq) with the order of every quaternion changed from x, y, z, w to w, x, y, z (shift 1) or back (-1)."""
    if all(part.kind != "ball" for part in link.parts):
        return q
    q, at = q.copy(), 0
    for part in link.parts:
        if part.kind == "ball":
            q[:, at:at + 4] = np.roll(q[:, at:at + 4], shift, axis=1)
        at += part.coordinates
    return q


@dataclasses.dataclass
class Closure:
    """Constraint models for `constraintDynamics`, each with the joint it closes, or None for a weld.

    `rank` is the rank of their rows at t = 0; `redundant`: it is less than their number.
    """

    models: pinocchio.StdVec_RigidConstraintModel
    workspaces: pinocchio.StdVec_RigidConstraintData
    settings: pinocchio.ProximalSettings
    joints: list[Joint | None]
    bodies: list[tuple[int, int]]  # bodies or second parts of the first and second end
    rank: int
    redundant: bool


def closure(model: Model, data: object, alpha: float, beta: float) -> Closure:
    """Constraints for the cut joints, with Baumgarte's G a + gamma + 2 alpha G u + beta^2 Phi = 0.

    Overwrites `data`, the workspace of the model, because a second one takes gigabytes for a long chain.
    """
    import pinocchio

    here = pinocchio.SE3.Identity()
    # joint, type, and (body, place in its frame) of both ends
    wanted: list[tuple[Joint | None, str, list[tuple[int, pinocchio.SE3]]]] = []
    for joint in model.cut:
        zero, kind = np.eye(3), "CONTACT_3D"
        if not joint.kind.motion:
            zero = rotation_from_quaternion(links_module.relative_attitude(model.scene, joint.parent, joint.child))
            kind = "CONTACT_6D"
        wanted.append((joint, kind, [(joint.child, pinocchio.SE3(np.eye(3), np.array(joint.child_anchor))),
                                     (joint.parent, pinocchio.SE3(zero, np.array(joint.parent_anchor)))]))
    wanted += [(None, "CONTACT_6D", [(body, here), (part, here)]) for part, body in model.parts.items()]
    models, bodies = pinocchio.StdVec_RigidConstraintModel(), []
    for _, kind, ends in wanted:
        carriers = [(model.frames[body][0], model.frames[body][1] * placement) for body, placement in ends]
        held = pinocchio.RigidConstraintModel(getattr(pinocchio.ContactType, kind), model.model, *carriers[0],
                                              *carriers[1], pinocchio.ReferenceFrame.LOCAL)
        gains = held.m_baumgarte_parameters
        gains.Kd, gains.Kp = 2 * alpha, beta**2
        held.setBaumgarteCorrectorParameters(gains)
        models.append(held)
        bodies.append((ends[0][0], ends[1][0]))
    workspaces = pinocchio.StdVec_RigidConstraintData()
    for held in models:
        workspaces.append(held.createData())
    rank, rows = _rank(model, data, models, workspaces)
    return Closure(models, workspaces, pinocchio.ProximalSettings(1e-16, 0.0, 1),
                   [joint for joint, _, _ in wanted], bodies, rank, rank < rows)


def _rank(model: Model, data: pinocchio.Data, models: pinocchio.StdVec_RigidConstraintModel,
          workspaces: pinocchio.StdVec_RigidConstraintData) -> tuple[int, int]:
    """(rank, number) of the constraint rows at t = 0."""
    import pinocchio

    q, _ = model.initial_state()
    pinocchio.computeJointJacobians(model.model, data, q)
    for held, workspace in zip(models, workspaces, strict=True):  # the Jacobian uses the points computed here
        held.calc(model.model, data, workspace)
    jacobian = np.atleast_2d(pinocchio.getConstraintsJacobian(model.model, data, models, workspaces))
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    return int(np.count_nonzero(sizes > RANK_TOLERANCE * sizes[0])), len(jacobian)
