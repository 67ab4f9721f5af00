"""PyBullet: joint coordinates of a `btMultiBody`, stepped by Bullet's semi-implicit Euler method in double precision.

Source: E. Coumans and Y. Bai, PyBullet Quickstart Guide; Bullet takes joint accelerations from the articulated-body
algorithm. Its dampings, its motors and its clamp of joint velocities, all of which are on by default, are off here.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np

from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.common import open_tree, stepping, tree
from crosscheck.adapters.common.native import JointStates, Native, Part, assembled, moved
from crosscheck.errors import EngineError
from crosscheck.files import aside
from crosscheck.scene.model import GROUND, Scene, quaternion_from_rotation
from crosscheck.scene.models import source


class PyBullet(open_tree.OpenTree):
    """Adapter of PyBullet, form `tree`."""

    name = "pybullet"
    methods = ("SemiImplicitEuler",)
    package = "pybullet"
    reads = (".urdf", ".sdf", ".world")

    def run(self, scene: Scene, spec: RunSpec) -> RawRun:
        """Integrate; raises `EngineError` if the state becomes infinite or NaN."""
        with aside(1, 2):
            import pybullet
        client = pybullet.connect(pybullet.DIRECT)
        try:
            pybullet.setGravity(*scene.gravity)
            pybullet.setTimeStep(stepping.fixed_step(scene, spec)[1])
            robot, order, axes = build(pybullet, scene)

            def advance(count: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
                q, v = np.empty((count // stride, 7 * scene.n)), np.empty((count // stride, 6 * scene.n))
                for row in range(len(q)):
                    for _ in range(stride):
                        pybullet.stepSimulation()
                    q[row], v[row] = _state(pybullet, robot, order)
                return q, v

            raw = stepping.march(scene, spec, _state(pybullet, robot, order), advance, open_tree.of_poses(scene, axes),
                                 lambda t, q, v: v)
        finally:
            pybullet.disconnect(client)
        raw.form = "tree"
        return raw

    def native(self, path: str, states: JointStates) -> Native:
        """The model that PyBullet makes of a model file by itself."""
        with aside(1, 2):
            import pybullet

            client = pybullet.connect(pybullet.DIRECT)
            try:
                pybullet.setGravity(0.0, 0.0, -9.81)
                return loaded(pybullet, path, states)
            finally:
                pybullet.disconnect(client)


def loaded(pybullet: ModuleType, path: str, states: JointStates) -> Native:
    """The file read by PyBullet, its base held, a URDF without shapes; an SDF keeps them, and may take inertias there.
    """
    model = source.bare(Path(path), sdf=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "model"
        copy.write_text(model.text)
        try:
            robots = pybullet.loadURDF(str(copy), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, useFixedBase=1) if (
                model.is_urdf) else pybullet.loadSDF(path)
        except pybullet.error as error:
            raise EngineError(f"PyBullet cannot read it: {error}") from None
    if not isinstance(robots, int) and len(robots) != 1:
        raise EngineError(f"it has {len(robots)} models, one is compared")
    robot = robots if isinstance(robots, int) else robots[0]
    count, columns = pybullet.getNumJoints(robot), dict[str, int]()
    names = {-1: pybullet.getBodyInfo(robot)[0].decode()}
    kinds = {pybullet.JOINT_REVOLUTE: "revolute", pybullet.JOINT_PRISMATIC: "prismatic"}
    for k in range(count):
        about, body = pybullet.getJointInfo(robot, k), pybullet.getDynamicsInfo(robot, k)
        if about[2] not in (*kinds, pybullet.JOINT_FIXED):
            raise EngineError(f"joint {about[1].decode()!r} has several coordinates, which is not compared")
        if about[2] in kinds:
            pybullet.resetJointState(robot, k, 0.0, 0.0)
            columns[about[1].decode()] = len(columns)
        names[k] = about[12].decode()
    body, at = pybullet.getDynamicsInfo(robot, -1), pybullet.getBasePositionAndOrientation(robot)
    turned, inner = (np.array(pybullet.getMatrixFromQuaternion(each)).reshape(3, 3) for each in (at[1], body[4]))
    free = 6 if body[0] else 0
    parts = {names[-1]: Part("", body[0], np.array(at[0]), turned @ np.diag(body[2]) @ turned.T, turned @ inner.T,
                             free=bool(free))}
    for k in range(count):
        about, body, link = (pybullet.getJointInfo(robot, k), pybullet.getDynamicsInfo(robot, k),
                             pybullet.getLinkState(robot, k, computeForwardKinematics=1))
        turned, frame = (np.array(pybullet.getMatrixFromQuaternion(each)).reshape(3, 3) for each in (link[1], link[5]))
        parts[names[k]] = Part(
            names[about[16]], body[0], np.array(link[0]), turned @ np.diag(body[2]) @ turned.T, frame,
            about[1].decode() if about[2] in kinds else "", np.array(link[4]), turned @ np.array(about[13]),
            kinds.get(about[2], ""), about[6], (about[8], about[9]) if about[8] <= about[9] else None,
            laws={"friction": about[7], "effort": about[10], "velocity limit": about[11]})

    def terms(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position = [*([0.0] * 6 + [1.0] if free else []), *q]
        zero = [0.0] * (free + len(q))
        M = np.array(pybullet.calculateMassMatrix(robot, list(q)))
        bias = pybullet.calculateInverseDynamics(robot, position, zero[:free] + list(v), zero, **(
            {"flags": 1} if free else {}))
        return M[free:, free:], np.array(bias[free:])

    return moved(assembled("pybullet", parts, np.array([0.0, 0.0, -9.81])), states, columns,
                 "calculateInverseDynamics", terms)


def build(pybullet: ModuleType, scene: Scene) -> tuple[int, list[int], np.ndarray]:
    """(the multibody in its initial state, number of each body's link, (n, 3, 3) principal axes of each body).

    The frame of a link is at its joint with the axes of its body, that of its inertia at the centre of mass.
    """
    tree_links = list(tree.links(scene))
    number = {GROUND: 0} | {link.body: k + 1 for k, link in enumerate(tree_links)}  # of parents, the base is 0
    moments, axes = np.linalg.eigh(scene.inertias)
    axes *= np.sign(np.linalg.det(axes))[:, None, None]
    origin = {GROUND: np.zeros(3)} | {link.body: link.child_anchor for link in tree_links}
    robot = pybullet.createMultiBody(
        baseMass=0.0, linkMasses=[scene.masses[link.body] for link in tree_links],
        linkCollisionShapeIndices=[-1] * scene.n, linkVisualShapeIndices=[-1] * scene.n,
        linkPositions=[(link.parent_anchor - origin[link.parent]).tolist() for link in tree_links],
        linkOrientations=[_xyzw(open_tree.zero_attitude(scene, link)) for link in tree_links],
        linkInertialFramePositions=[(-link.child_anchor).tolist() for link in tree_links],
        linkInertialFrameOrientations=[_xyzw(axes[link.body]) for link in tree_links],
        linkParentIndices=[number[link.parent] for link in tree_links],
        linkJointTypes=[getattr(pybullet, f"JOINT_{link.type.upper()}") for link in tree_links],
        linkJointAxis=[link.parts[0].axis.tolist() if link.dofs == 1 else [0, 0, 1] for link in tree_links])
    pybullet.changeDynamics(robot, -1, linearDamping=0.0, angularDamping=0.0)
    for k, link in enumerate(tree_links):
        # inertia in a call of its own: together with the rest PyBullet sets it to zero
        pybullet.changeDynamics(robot, k, localInertiaDiagonal=moments[link.body].tolist())
        pybullet.changeDynamics(robot, k, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
                                maxJointVelocity=1e12)  # by default they are clamped at 100
        q, v = tree.initial_coordinates(scene, link)
        if link.dofs == 1:
            pybullet.resetJointState(robot, k, float(q[0]), float(v[0]))
            pybullet.setJointMotorControl2(robot, k, pybullet.VELOCITY_CONTROL, force=0.0)
        elif link.dofs:  # a ball, whose velocity is in the axes of the inertia
            pybullet.resetJointStateMultiDof(robot, k, [0.0, 0.0, 0.0, 1.0], (axes[link.body].T @ v).tolist())
            pybullet.setJointMotorControlMultiDof(robot, k, pybullet.POSITION_CONTROL, targetPosition=[0, 0, 0, 1],
                                                  positionGain=0.0, velocityGain=0.0, force=[0.0, 0.0, 0.0])
    return robot, [number[body] - 1 for body in range(scene.n)], axes


def _state(pybullet: ModuleType, robot: int, order: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """((7 n,) centre of mass and quaternion of every body's inertia, (6 n,) velocities of both), in world axes."""
    links = pybullet.getLinkStates(robot, order, computeLinkVelocity=1, computeForwardKinematics=1)
    return (np.array([(*link[0], *link[1]) for link in links]).ravel(),
            np.array([(*link[6], *link[7]) for link in links]).ravel())


def _xyzw(R: np.ndarray) -> list[float]:
    made: list[float] = quaternion_from_rotation(R)[[1, 2, 3, 0]].tolist()
    return made
