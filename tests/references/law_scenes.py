"""Scenes with force laws for the tests of truth across events."""

import dataclasses
import json

import numpy as np

from crosscheck.scene.file import load_scene

INERTIA = np.diag([0.02, 0.03, 0.025]).tolist()


def scene(folder, bodies, joints, forces=(), gravity=(0.0, 0.0, 0.0), duration=1.0, samples=11, **more):
    """A scene of version 3 from its entries."""
    content = {"schema": 3, "name": "laws", "gravity": list(gravity), "duration": duration, "samples": samples,
               "bodies": bodies, "joints": joints, "forces": list(forces), **more}
    path = folder / "laws.json"
    path.write_text(json.dumps(content))
    return load_scene(path)


def hinge(name, parent, child, here, there, **keys):
    """A hinge about y."""
    return {"name": name, "type": "revolute", "parent": parent, "child": child, "parent_anchor": here,
            "child_anchor": there, "parent_axis": [0, 1, 0], "child_axis": [0, 1, 0], "position": 0.0, "velocity": 0.0,
            **keys}


def slide(folder, joint=(), mass=1.0, **keys):
    """A body on a slide along x, without weight unless gravity is given."""
    guide = {"name": "s", "type": "prismatic", "parent": "ground", "child": "b", "parent_anchor": [0, 0, 0],
             "child_anchor": [0, 0, 0], "parent_axis": [1, 0, 0], "child_axis": [1, 0, 0], "position": 0.0,
             "velocity": 0.0, **dict(joint)}
    return scene(folder, [{"name": "b", "mass": mass, "inertia": INERTIA}], [guide], **keys)


def pendulum(folder, joint=(), **keys):
    """A hinge pendulum: 1 kg at .5 m, .27 kg m^2 about the hinge."""
    body = {"name": "b", "mass": 1.0, "inertia": (0.02 * np.eye(3)).tolist()}
    return scene(folder, [body], [hinge("h", "ground", "b", [0, 0, 0], [0, 0, 0.5], **dict(joint))],
                 gravity=(0.0, 0.0, -9.81), **keys)


def arm(folder, first=(), second=(), **keys):
    """Two hinges."""
    bodies = [{"name": name, "mass": mass, "inertia": INERTIA} for name, mass in (("a", 1.0), ("b", 0.7))]
    return scene(folder, bodies,
                 [hinge("j1", "ground", "a", [0, 0, 0], [0, 0, 0.3], **dict(first)),
                  hinge("j2", "a", "b", [0, 0, -0.3], [0, 0, 0.25], **dict(second))],
                 **{"gravity": (0.0, 0.0, -9.81), **keys})


def with_laws(name, joint, duration, **laws):
    """A scene of the library with laws of one joint."""
    given = load_scene(name)
    joints = tuple(dataclasses.replace(each, **laws) if each.name == joint else each for each in given.joints)
    return given.replace(joints=joints, duration=duration, samples=6)


def servo(joint, **keys):
    """A servo with a target of 1."""
    return {"type": "servo", "joint": joint, "target": 1.0, "proportional": 30.0, "derivative": 3.0, **keys}
