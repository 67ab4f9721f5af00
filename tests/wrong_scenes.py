"""A scene with every kind of entry, and every mistake in it with the words of its error."""

from __future__ import annotations

import copy

Z = [0.0, 0.0, 1.0]

ARM = {"name": "arm", "mass": 2.0, "inertia": [[0.3, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.2]],
       "angular_velocity": [0.0, 0.0, 1.5]}
BOB = {"name": "bob", "mass": 1.0, "inertia": [[0.1, 0.01, 0.0], [0.01, 0.2, 0.0], [0.0, 0.0, 0.15]],
       "angular_velocity": [0.3, 0.0, 0.0]}
HINGE = {"name": "hinge", "type": "revolute", "parent": "ground", "child": "arm", "parent_anchor": [0.0, 0.0, 2.0],
         "child_anchor": [1.0, 0.0, 0.0], "parent_axis": Z, "child_axis": Z}
BALL = {"name": "ball", "type": "spherical", "parent": "arm", "child": "bob", "parent_anchor": [-1.0, 0.0, 0.0],
        "child_anchor": Z}
SPRING = {"type": "linear_spring", "parent": "ground", "child": "bob", "parent_point": [1.0, 0.0, 0.0],
          "child_point": [0.0, 0.0, 0.1], "stiffness": 20.0, "free_length": 0.5, "damping": 0.1}
TORSION = {"type": "torsional_spring", "joint": "hinge", "stiffness": 5.0, "rest_angle": 0.4}
PUSH = {"type": "constant_force", "child": "bob", "child_point": [0.0, 0.0, 0.1], "frame": "world", "force": Z}
TWIST = {"type": "constant_torque", "child": "arm", "frame": "body", "torque": Z}
SCENE = {"schema": 1, "name": "arm", "description": "prose", "source": "own", "tags": ["made"],
         "gravity": [0.0, 0.0, -9.81], "duration": 2.0, "samples": 21, "bodies": [ARM, BOB], "joints": [HINGE, BALL],
         "forces": [SPRING, TORSION, PUSH, TWIST]}
GONE = object()


def changed(changes):
    """A copy of SCENE in which values at dotted paths are replaced, added or (GONE) removed."""
    data = copy.deepcopy(SCENE)
    for path, value in changes.items():
        *parents, key = [int(part) if part.isdigit() else part for part in path.split(".")]
        node = data
        for part in parents:
            node = node[part]
        if value is GONE:
            del node[key]
        elif isinstance(node, list) and key == len(node):
            node.append(value)
        else:
            node[key] = value
    return data


def other_joint(kind, **keys):
    """The change that makes the ball another type of joint."""
    return {"joints.1": {**BALL, "type": kind, **keys}}


WRONG = [  # name, changes, words of entry and problem, words of the mend
    # the top of the file
    ("no version", {"schema": GONE}, "schema: missing", "add schema = 1"),
    ("newer version", {"schema": 4}, "schema: version 4", "write schema = 1"),
    ("version as text", {"schema": "1"}, "schema: version '1'", "write schema = 1"),
    ("version as truth", {"schema": True}, "schema: version True", "write schema = 1"),
    ("key misspelt", {"duraton": 1.0}, 'duraton: unknown key "duraton"', 'did you mean "duration"?'),
    ("no gravity", {"gravity": GONE}, "gravity: missing", "add gravity: three numbers in m/s^2"),
    ("plane gravity", {"gravity": [0.0, -9.81]}, "gravity: expected a list of length 3, got 2", "three numbers"),
    ("negative duration", {"duration": -1.0}, "duration: -1 s is not positive", "of s > 0"),
    ("no duration", {"duration": 0}, "duration: 0 s is not positive", "of s > 0"),
    ("infinite duration", {"duration": float("inf")}, "duration: inf is not a finite number", "write a finite number"),
    ("duration as text", {"duration": "10 s"}, "duration: expected a number, got text", "a number of seconds > 0"),
    ("one sample", {"samples": 1}, "samples: 1 is too few", "a whole number >= 2"),
    ("samples beyond memory", {"samples": 10**30}, f"samples: {10**30} is too many", "<= 10000000"),
    ("samples by the million", {"samples": 10**7 + 1}, "samples: 10000001 is too many", "<= 10000000"),
    ("duration of nothing", {"duration": 5e-324}, "duration: 4.94066e-324 s is out of range", "above 1e-100"),
    ("name with a slash", {"name": "../up"}, "name: '../up' cannot be part of a file's name", "leave out slashes"),
    ("name with a backslash", {"name": "a\\b"}, "cannot be part of a file's name", "leave out slashes"),
    ("name with a zero", {"name": "a\0"}, "cannot be part of a file's name", "control characters"),
    ("name of dots", {"name": ".."}, "name: '..' cannot be part of a file's name", "add a letter"),
    ("half a sample", {"samples": 10.5}, "samples: expected a whole number, got a number", "a whole number >= 2"),
    ("empty name", {"name": " "}, "name: is empty", "give the scene a name"),
    ("no bodies", {"bodies": [], "joints": [], "forces": []}, "bodies: the scene has none", "[[bodies]]"),
    ("bodies as one table", {"bodies": ARM}, "bodies: expected a list, got a table", "[[bodies]] table"),
    ("tags as text", {"tags": "smooth"}, "tags: expected a list, got text", 'a list of words, ["smooth"]'),
    ("assemble as text", {"assemble": "yes"}, "assemble: expected true or false, got text", "true or false"),
    # bodies
    ("body key misspelt", {"bodies.1.masss": 1.0}, 'bodies[1] "bob": masss: unknown key', 'did you mean "mass"?'),
    ("unknown body key", {"bodies.1.zq": 1}, 'bodies[1] "bob": zq: unknown key', 'known here are "name", "mass"'),
    ("no mass", {"bodies.1.mass": GONE}, 'bodies[1] "bob": mass: missing', "add mass: a number of kg > 0"),
    ("zero mass", {"bodies.1.mass": 0.0}, 'bodies[1] "bob": mass: 0 kg is not positive', "kg > 0"),
    ("mass not a number", {"bodies.0.mass": float("nan")}, 'bodies[0] "arm": mass: nan is not', "a finite number"),
    ("mass beyond floats", {"bodies.0.mass": 10**400}, 'bodies[0] "arm": mass: number out of range', "below 1e+100"),
    ("mass of nothing", {"bodies.0.mass": 1e-320}, 'bodies[0] "arm": mass: 9.99989e-321 kg is out of range',
     "above 1e-100"),
    ("inertia beyond squares", {"bodies.0.inertia.1.1": 1e308},
     'bodies[0] "arm": inertia[1][1]: 1e+308 is out of range', "below 1e+100"),
    ("inertia of nothing", {"bodies.0.inertia": [[1e-320, 0, 0], [0, 1e-320, 0], [0, 0, 1e-320]]},
     'bodies[0] "arm": inertia: principal moments', "above 1e-100"),
    ("mass as truth", {"bodies.0.mass": True}, 'bodies[0] "arm": mass: expected a number, got true or false', "kg > 0"),
    ("inertia as diagonal", {"bodies.1.inertia": [1.0, 1.0, 1.0]}, 'bodies[1] "bob": inertia[0]: expected a list',
     "three rows of three numbers"),
    ("short inertia row", {"bodies.1.inertia.2": [0.0, 1.0]},
     'bodies[1] "bob": inertia[2]: expected a list of length 3, got 2', "three rows of three numbers"),
    ("infinite inertia", {"bodies.1.inertia.2.2": float("inf")}, 'bodies[1] "bob": inertia[2][2]: inf is not',
     "a finite number"),
    ("asymmetric inertia", {"bodies.1.inertia.0.1": 0.02},
     'bodies[1] "bob": inertia: not symmetric, entry [0][1] is 0.02 and entry [1][0] is 0.01',
     "the same number in both"),
    ("indefinite inertia", {"bodies.1.inertia.0.0": -0.1}, 'bodies[1] "bob": inertia: not positive definite',
     "principal moments are all > 0"),
    ("flat inertia", {"bodies.0.inertia.0.0": 0.0}, 'bodies[0] "arm": inertia: not positive definite',
     "principal moments are all > 0"),
    ("triangle", {"bodies.0.inertia.1.1": 0.51}, 'bodies[0] "arm": inertia: principal moments 0.2, 0.3, 0.51',
     "at most the sum of the other two"),
    ("zero attitude", {"bodies.1.attitude": [0.0] * 4}, 'bodies[1] "bob": attitude: all its numbers are zero',
     "write a quaternion w, x, y, z"),
    ("attitude of angles", {"bodies.1.attitude": [0.1, 0.2, 0.3]},
     'bodies[1] "bob": attitude: expected a list of length 4, got 3', "a quaternion of four numbers"),
    ("body twice", {"bodies.1.name": "arm"}, 'bodies[1] "arm": name: bodies[0] has the same name', "its own name"),
    ("body called ground", {"bodies.1.name": "ground"}, 'bodies[1] "ground": name: "ground" is the fixed world',
     "give the body another name"),
    ("nameless body", {"bodies.1.name": ""}, "bodies[1]: name: is empty", "a name of its own"),
    ("body name a number", {"bodies.1.name": 7},
     "bodies[1]: name: expected text, got a whole number", "a name in quotes"),
    ("body is a number", {"bodies.1": 7},
     "bodies[1]: expected a table, got a whole number", "at least one [[bodies]] table"),
    ("free body nowhere", {"bodies.2": {**BOB, "name": "stone"}}, 'bodies[2] "stone": position: missing',
     "add position = three numbers in m"),
    # joints
    ("joint type misspelt", {"joints.1.type": "sphericl"}, "joints[1] \"ball\": type: unknown type 'sphericl'",
     'did you mean "spherical"?'),
    ("joint without type", {"joints.1.type": GONE}, 'joints[1] "ball": type: missing', 'add type = one of "spherical"'),
    ("joint key misspelt", {"joints.1.child_achor": Z}, 'joints[1] "ball": child_achor: unknown key',
     'did you mean "child_anchor"?'),
    ("joint twice", {"joints.1.name": "hinge"}, 'joints[1] "hinge": name: joints[0] has the same name', "its own name"),
    ("unknown parent", {"joints.1.parent": "amr"}, 'joints[1] "ball": parent: no body is named "amr"',
     'did you mean "arm"? write one of "ground", "arm", "bob"'),
    ("unknown child", {"joints.1.child": "x"}, 'joints[1] "ball": child: no body is named "x"',
     'write one of "arm", "bob"'),
    ("ground as child", {"joints.0.child": "ground", "joints.0.parent": "arm"},
     'joints[0] "hinge": child: the ground cannot be the child', "swap parent and child"),
    ("to itself", {"joints.1.child": "arm"}, 'joints[1] "ball": child: joins the body "arm" to itself',
     "name two different bodies"),
    ("no anchor", {"joints.1.child_anchor": GONE}, 'joints[1] "ball": child_anchor: missing',
     "add child_anchor: three numbers in m"),
    ("no parent axis", {"joints.0.parent_axis": GONE}, 'joints[0] "hinge": parent_axis: missing, a revolute joint',
     "add parent_axis = [0.0, 0.0, 1.0]"),
    ("no child axis", {"joints.0.child_axis": GONE}, 'joints[0] "hinge": child_axis: missing, a revolute joint',
     "add child_axis = [0.0, 0.0, 1.0]"),
    ("no line", other_joint("point_on_line"), 'joints[1] "ball": parent_axis: missing, a point_on_line joint',
     "add parent_axis"),
    ("axis on a line's child", other_joint("point_on_line", parent_axis=Z, child_axis=Z),
     'joints[1] "ball": child_axis: a point_on_line joint has none', "remove it"),
    ("axis on a ball", {"joints.1.parent_axis": Z}, 'joints[1] "ball": parent_axis: a spherical joint has none',
     "remove it, or change the type"),
    ("zero axis", {"joints.0.child_axis": [0, 0, 0]}, 'joints[0] "hinge": child_axis: all its numbers are zero',
     "write the axis's direction"),
    ("no length", other_joint("distance"), 'joints[1] "ball": length: missing, a distance joint',
     "add length = 1.0 (m)"),
    ("length on a ball", {"joints.1.length": 1.0}, 'joints[1] "ball": length: a spherical joint has none', "remove it"),
    ("zero length", other_joint("distance", length=0.0), 'joints[1] "ball": length: 0 m is not positive', "m > 0"),
    ("length of nothing", other_joint("distance", length=1e-320),
     'joints[1] "ball": length: 9.99989e-321 m is out of range', "above 1e-100"),
    # forces
    ("force type misspelt", {"forces.0.type": "linear_sprong"}, "forces[0]: type: unknown type 'linear_sprong'",
     'did you mean "linear_spring"?'),
    ("force without type", {"forces.0.type": GONE}, "forces[0]: type: missing", 'add type = one of "linear_spring"'),
    ("force key of another type", {"forces.3.child_point": Z}, "forces[3]: child_point: unknown key",
     'the keys known here are "type", "child", "frame", "torque"'),
    ("no stiffness", {"forces.1.stiffness": GONE}, "forces[1]: stiffness: missing", "add stiffness: a number >= 0"),
    ("negative stiffness", {"forces.1.stiffness": -1.0}, "forces[1] (torsional_spring): stiffness: -1 is negative",
     "a number >= 0"),
    ("negative damping", {"forces.0.damping": -1.0}, "forces[0] (linear_spring): damping: -1 is negative",
     "a number >= 0"),
    ("negative free length", {"forces.0.free_length": -0.1}, "forces[0] (linear_spring): free_length: -0.1 is",
     "a number >= 0"),
    ("force on nobody", {"forces.2.child": "bib"}, 'forces[2] (constant_force): child: no body is named "bib"',
     'did you mean "bob"?'),
    ("force on the ground", {"forces.2.child": "ground"}, "forces[2] (constant_force): child: the ground cannot",
     'name a body: "arm", "bob"'),
    ("spring to itself", {"forces.0.parent": "bob"}, "forces[0] (linear_spring): child: joins a body to itself",
     "name two different bodies"),
    ("unknown frame", {"forces.2.frame": "wrld"}, "forces[2]: frame: invalid enum value 'wrld'", '"world" or "body"'),
    ("spring in no joint", {"forces.1.joint": "hing"}, 'forces[1] (torsional_spring): joint: no joint is named "hing"',
     'did you mean "hinge"?'),
    ("spring in a ball", {"forces.1.joint": "ball"}, 'forces[1] (torsional_spring): joint: "ball" is a spherical joint',
     'type "revolute", "cylindrical"'),
    # the state
    ("position off", {"bodies.1.position": [-2.0, 0.0, 1.1]},
     'joints[1] "ball": the given state violates it in position by 0.1 m (allowed 2e-08)', "leave position out"),
    ("velocity off", {"bodies.0.velocity": [0.0, -1.0, 0.0]},
     'joints[0] "hinge": the given state violates it in velocity by 0.5 m/s (allowed 3e-08)', "assemble = true"),
    ("spin across the hinge", {"bodies.0.angular_velocity": [0.2, 0.0, 1.5]},
     'joints[0] "hinge": the given state violates it in velocity by 0.2', "angular_velocity"),
    ("opposite axes", {"joints.0.child_axis": [0.0, 0.0, -1.0]},
     'joints[0] "hinge": child_axis: points opposite to parent_axis in the world', "reverse one of the two"),
    ("attitude upside down", {"bodies.0.attitude": [0.0, 1.0, 0.0, 0.0]},
     'joints[0] "hinge": child_axis: points opposite to parent_axis in the world', 'the attitude of "arm"'),
    ("cannot close", {"assemble": True, "joints.2": {**BALL, "name": "far", "parent": "ground",
                                                     "parent_anchor": [0.0, 0.0, 90.0]}},
     "the joints cannot be closed together, this one keeps the largest gap", "check its anchors"),
]
