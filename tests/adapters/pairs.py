"""Two bodies on a random joint of each type, under every force that goes with it, for tests of the adapters."""

import numpy as np

from crosscheck.scene.model import GROUND, Force, Scene
from tests.scene_making import JOINT_TYPES, drawn, make_scene, random_body, random_joint

SPRUNG = ("revolute", "cylindrical")


def loads() -> list[Force]:
    """Damped springs to the ground and between the bodies; loads off the centre of mass, in world and body axes."""
    return [
        Force("linear_spring", GROUND, 1, None, {"parent_point": (0.5, -1.0, 2.0), "child_point": (0.3, 0.1, 0.2),
                                                 "stiffness": 20.0, "free_length": 0.4, "damping": 0.5}),
        Force("linear_spring", 0, 1, None, {"parent_point": (1.5, 1.0, 2.0), "child_point": (-0.3, 2.1, 0.2),
                                            "stiffness": 10.0, "free_length": 0.7, "damping": 0.3}),
        Force("constant_force", None, 1, None, {"child_point": (0.1, 0.2, 0.3), "frame": "body",
                                                "force": (1.0, -2.0, 0.5)}),
        Force("constant_force", None, 0, None, {"child_point": (-0.3, 0.1, 0.2), "frame": "world",
                                                "force": (0.7, 0.4, -1.5)}),
        Force("constant_torque", None, 0, None, {"frame": "world", "torque": (0.4, 0.1, -0.3)}),
        Force("constant_torque", None, 1, None, {"frame": "body", "torque": (-0.2, 0.5, 0.1)}),
    ]


def torsion() -> Force:
    """A damped torsional spring about the joint called "joint"."""
    return Force("torsional_spring", None, None, "joint", {"stiffness": 3.0, "rest_angle": 0.4, "damping": 0.2})


def loaded_pair(kind: str, inward: bool = False, spring: bool = True) -> Scene:
    """A body on a ball joint to the ground and a second one on a joint of type `kind`, moving and loaded.

    `inward`: the outer body is the joint's parent. `spring`: adds a torsional spring if the joint type takes one.
    """
    rng = np.random.default_rng(100 + JOINT_TYPES.index(kind))
    ends = (1, 0) if inward else (0, 1)
    forces = [*loads(), *([torsion()] if spring and kind in SPRUNG else [])]

    def draw() -> Scene:
        bodies = [random_body(rng, "first"), random_body(rng, "second")]
        joints = [random_joint(rng, "spherical", GROUND, 0, "base"), random_joint(rng, kind, *ends)]
        return make_scene(bodies, joints, forces)

    return drawn(draw)
