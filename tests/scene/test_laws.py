"""Scenes of version 3: dry friction, limits, servos, shapes, monitors; what a file may not say; the laws' formulas."""

from __future__ import annotations

import copy
import json
import math
import pickle

import numpy as np
import pytest

from crosscheck.errors import SceneError
from crosscheck.references import truth
from crosscheck.scene import mechanics
from crosscheck.scene.file import load_scene, scene_names
from crosscheck.scene.functions import TimeFunction
from crosscheck.scene.laws import DryFriction, Limits, Servo
from crosscheck.scene.model import ELEMENTS, SMOOTH
from crosscheck.scene.starts import restarted
from crosscheck.scene.states import States
from tests.wrong_scenes import GONE, Z

TURN, SLIDE, BALL, BOTH, FOLLOWER, DRIVEN = range(6)


def joint(name, kind, k, **keys):
    axes = {} if kind == "spherical" else {"parent_axis": Z, "child_axis": Z}
    return {"name": name, "type": kind, "parent": "ground", "child": f"b{k}", "parent_anchor": [2.0 * k, 0.0, 0.0],
            "child_anchor": [0.0, 0.0, 0.0], **axes, **keys}


SCENE = {
    "schema": 3, "name": "laws", "gravity": [0.0, 0.0, 0.0], "duration": 1.0, "samples": 3,
    "bodies": [{"name": f"b{k}", "mass": 1.0, "inertia": np.diag([0.1, 0.1, 0.2]).tolist()} for k in range(7)],
    "joints": [joint("turn", "revolute", 0, position=7.0, velocity=-0.5, dry_friction=0.5,
                     limits={"lower": -1.0, "upper": 8.0}),
               joint("slide", "prismatic", 1, dry_friction={"sliding": 0.5, "static": 0.7},
                     limits={"upper": 0.5, "stiffness": 1e3, "damping": 10.0}),
               joint("ball", "spherical", 2),
               joint("both", "cylindrical", 3, position=[0.1, 0.2], velocity=[0.0, 0.0], dry_friction=[0.5, 0.0],
                     limits=[{}, {"lower": 0.0, "restitution": 0.5}]),
               joint("follower", "revolute", 4, mimic={"joint": "turn", "ratio": 2.0}),
               joint("driven", "revolute", 5, drive={"type": "sine", "terms": [[0.1, 2.0, 0.0]]})],
    "forces": [{"type": "servo", "joint": "turn", "proportional": 10.0, "derivative": 1.0, "effort_limit": 4,
                "no_load_speed": 2.0, "target": {"type": "linear", "times": [0.0, 1.0], "values": [6.0, 8.0]}},
               {"type": "servo", "joint": "slide", "feedforward": 0.3, "period": 0.1, "delay": 2,
                "effort_limit": [-1.0, 2]},
               {"type": "joint_force", "joint": "slide", "force": {"type": "hold", "times": [0.0, 0.5],
                                                                   "values": [1.0, 2.0]}}],
    "shapes": [{"name": "foot", "body": "b6", "type": "sphere", "size": [0.02], "position": [0.0, 0.0, -0.2]},
               {"name": "floor", "body": "ground", "type": "plane", "position": [0.0, 0.0, -3.0]}],
    "monitors": [{"type": "touch", "shapes": ["foot", "floor"], "margin": 0.01},
                 {"type": "range", "joint": "turn", "lower": 0.0, "upper": 9.0},
                 {"type": "speed", "joint": "turn", "upper": 3.0},
                 {"type": "effort", "joint": "turn", "lower": -9.0, "upper": 9.0}],
}
SCENE["bodies"][6]["position"] = [0.0, 5.0, 0.0]


def changed(changes):
    data = copy.deepcopy(SCENE)
    for path, value in changes.items():
        *parents, key = [int(part) if part.isdigit() else part for part in path.split(".")]
        node = data
        for part in parents:
            node = node[part]
        if value is GONE:
            del node[key]
        else:
            node[key] = copy.deepcopy(value)
    return data


@pytest.fixture
def written(tmp_path):
    def write(changes):
        path = tmp_path / "laws.json"
        path.write_text(json.dumps(changed(changes)))
        return path

    return write


def test_everything_of_version_3_loads(written):
    scene = load_scene(written({}))
    turn, slide, _, both, *_ = scene.joints
    assert turn.dry_friction == (DryFriction(0.5, 0.5),)
    assert slide.dry_friction == (DryFriction(0.5, 0.7),)
    assert both.dry_friction == (DryFriction(0.5, 0.5), None)
    assert turn.limits == (Limits(-1.0, 8.0),)
    assert slide.limits == (Limits(-math.inf, 0.5, 0.0, 1e3, 10.0),)
    assert both.limits == (None, Limits(0.0, math.inf, 0.5))
    first, second = (servo for _, servo in scene.servos.values())
    assert (first.effort_limit, first.period, first.delay) == ((-4.0, 4.0), None, 0)
    assert (second.effort_limit, second.period, second.delay) == ((-1.0, 2.0), 0.1, 2)
    assert isinstance(first.target_velocity, TimeFunction)
    assert first.target_velocity(0.3) == 2.0  # the derivative of the target
    assert scene.breaks == (0.5,)
    assert scene.timed
    assert scene.worked_on
    assert [monitor.name for monitor in scene.monitors] == ["foot and floor", "range of turn", "speed of turn",
                                                            "effort of turn"]
    assert scene.coordinates == (
        *(f"b6.{part}" for part in ("x", "y", "z", "rx", "ry", "rz")), "turn", "slide", "ball.rx", "ball.ry", "ball.rz",
        "both.angle", "both.slide", "follower", "driven")
    assert pickle.loads(pickle.dumps(scene)).hash == scene.hash


@pytest.mark.parametrize("changes", [
    {"joints.0.dry_friction": 0.6}, {"joints.1.dry_friction.static": 0.8}, {"joints.0.limits.upper": 8.5},
    {"joints.1.limits.damping": 11.0}, {"joints.3.limits.1.restitution": 0.4}, {"forces.0.proportional": 11.0},
    {"forces.1.delay": 1}, {"forces.1.effort_limit": [-1.0, 3.0]}, {"forces.2.force.values.1": 3.0},
    {"shapes.0.size": [0.03]}, {"monitors.0.margin": 0.0}, {"monitors.1.upper": 8.0},
    {"forces.0.target_velocity": 0.0}], ids=str)
def test_the_key_sees_every_number_of_a_law(changes, written):
    assert load_scene(written(changes)).key != load_scene(written({})).key


def test_scenes_without_laws_do_not_name_them():
    """Their hashes are those of older releases."""
    for name in scene_names():
        content = json.dumps(load_scene(name)._content())
        assert not {"dry_friction", "limits", "shapes", "monitors", "phase", "held"} & set(content.split('"'))


WRONG = [  # changes, words of entry and problem, words of the mend
    ({"schema": 2}, "shapes: is a key of version 3", "schema = 3"),
    ({"schema": 2, "shapes": GONE, "monitors": GONE}, 'joints[0] "turn": dry_friction: is a key of version 3',
     "schema = 3"),
    ({"joints.0.limits.lower": 8.0}, 'joints[0] "turn": limits: lower: 8 is not below upper 8', "smaller one as lower"),
    ({"joints.0.limits": {}}, 'joints[0] "turn": limits: lower: missing, and upper too', "at least one"),
    ({"joints.0.limits.loewr": 0.0}, 'joints[0] "turn": limits', "write a table"),
    ({"joints.0.dry_friction": -0.5}, 'joints[0] "turn": dry_friction: -0.5 is negative', "a number >= 0"),
    ({"joints.0.dry_friction": "much"}, 'joints[0] "turn": dry_friction: ', "a number >= 0"),
    ({"joints.1.dry_friction.static": 0.4}, 'joints[1] "slide": dry_friction: static 0.4 is below sliding 0.5',
     "not smaller"),
    ({"joints.3.limits.1.restitution": 1.5}, 'joints[3] "both": limits[1]: restitution: 1.5 is not between',
     "from 0 to 1"),
    ({"joints.1.limits.restitution": 0.5}, 'limits: restitution: a stop with a spring and damper has none',
     "remove it"),
    ({"joints.1.limits.stiffness": -1.0}, 'limits: stiffness: -1 is negative', "a number >= 0"),
    ({"joints.1.limits.stiffness": GONE}, 'limits: stiffness: missing, beside damping', "a number > 0"),
    ({"joints.3.dry_friction": 0.5}, 'joints[3] "both": dry_friction: 1 given', "a list of 2"),
    ({"joints.2.dry_friction": 0.5}, 'joints[2] "ball": dry_friction: a spherical joint cannot have it', "revolute"),
    ({"joints.5.dry_friction": 0.5}, 'joints[5] "driven": dry_friction: the drive', "remove it"),
    ({"joints.5.limits": {"upper": 1.0}}, 'joints[5] "driven": limits: the drive', "remove it"),
    ({"joints.5.drive": {"type": "hold", "times": [0.0], "values": [0.0]}}, 'joints[5] "driven": drive: the rate',
     "spline"),
    ({"joints.0.limits.upper": 6.9}, 'joints[0] "turn": limits: the start, 7, is beyond [-1, 6.9]', "start inside"),
    ({"joints.1.limits.upper": -0.1}, 'joints[1] "slide": limits: the start, 0, is beyond', "start inside"),
    ({"forces.0.joint": "ball"}, 'forces[0] (servo): joint: "ball" is a spherical joint', "revolute"),
    ({"forces.0.joint": "follower"}, 'forces[0] (servo): joint: "follower" has a mimic', "the one that it follows"),
    ({"forces.0.joint": "driven"}, 'forces[0] (servo): joint: "driven" has a drive', "moves by itself"),
    ({"forces.0.joint": "tuurn"}, 'forces[0] (servo): joint: no joint is named "tuurn"', 'did you mean "turn"'),
    ({"forces.0.proportional": -1.0}, "forces[0] (servo): proportional: -1 is negative", ">= 0"),
    ({"forces.0.derivative": -1.0}, "forces[0] (servo): derivative: -1 is negative", ">= 0"),
    ({"forces.0.effort_limit": 0.0}, "forces[0] (servo): effort_limit: 0 is not positive", "> 0"),
    ({"forces.1.effort_limit": [2.0, 1.0]}, "forces[1] (servo): effort_limit: lower 2 is not below upper 1",
     "[lower, upper]"),
    ({"forces.0.no_load_speed": 0.0}, "forces[0] (servo): no_load_speed: 0 is not positive", "> 0"),
    ({"forces.0.effort_limit": GONE}, "forces[0] (servo): no_load_speed: there is no limit", "effort_limit"),
    ({"forces.1.period": 0.0}, "forces[1] (servo): period: 0 is not positive", "> 0"),
    ({"forces.1.period": GONE}, "forces[1] (servo): delay: counts periods", "add period"),
    ({"forces.1.delay": 0.5}, "forces[1]: delay: expected a whole number", "whole number >= 0"),
    ({"forces.1.delay": -1}, "forces[1] (servo): delay: -1 is negative", "a whole number >= 0"),
    ({"forces.1.gain": 1.0}, 'forces[1]: gain: unknown key "gain"', '"proportional"'),
    ({"forces.2.force.times": [0.5, 0.5]}, "forces[2] (joint_force): force: times: do not increase", "in order"),
    ({"forces.2.force.values": [1.0]}, "forces[2] (joint_force): force: values: 1 given for 2 times", "as many values"),
    ({"forces.0.target.times": [0.0, -1.0]}, "forces[0] (servo): target: times: do not increase", "in order"),
    ({"shapes.0.type": "spheer"}, "unknown type 'spheer'", 'did you mean "sphere"'),
    ({"shapes.0.size": [0.02, 1.0]}, 'shapes[0] "foot": size: 2 given, a sphere has 1', "[radius]"),
    ({"shapes.0.size": [-0.02]}, 'shapes[0] "foot": size: -0.02 m is not positive', "> 0"),
    ({"shapes.0.body": "b9"}, 'shapes[0] "foot": body: no body is named "b9"', '"b6"'),
    ({"shapes.1.name": "foot"}, 'shapes[1] "foot": name: shapes[0] has the same name', "its own name"),
    ({"shapes.1": {"name": "floor", "body": "ground", "type": "mesh"}}, 'shapes[1] "floor": file: a mesh has a file',
     "points"),
    ({"shapes.1": {"name": "floor", "body": "ground", "type": "mesh", "file": "none.stl"}}, 'file: ', "an STL or OBJ"),
    ({"monitors.0.shapes": ["foot", "floorr"]}, 'monitors[0] (touch): shapes: no shape is named "floorr"', '"floor"'),
    ({"monitors.0.shapes": ["foot", "foot"]}, 'monitors[0] (touch): shapes: both are of "b6"', "two bodies"),
    ({"monitors.0.margin": -0.1}, "monitors[0] (touch): margin: -0.1 m is negative", ">= 0"),
    ({"monitors.1.joint": "ball"}, 'monitors[1] (range): joint: "ball" is a spherical joint', "revolute"),
    ({"monitors.1.lower": 9.0}, "monitors[1] (range): lower: 9 is not below upper 9", "smaller one"),
    ({"monitors.1.upper": 6.0}, 'monitors[1] (range): "turn" starts with 7, beyond [0, 6]', "start inside"),
    ({"monitors.2.upper": -1.0}, 'monitors[2] (speed): "turn" starts with -0.5, beyond', "start inside"),
    ({"monitors.3.lower": -2.5}, 'monitors[3] (effort): "turn" starts with -3, beyond', "start inside"),
    ({"monitors.3.joint": "follower"}, 'monitors[3] (effort): joint: "follower" has no servo', "with an actuator"),
]


@pytest.mark.parametrize(("changes", "entry", "mend"), WRONG, ids=[case[1] for case in WRONG])
def test_a_contradiction_is_answered_with_file_entry_and_mend(changes, entry, mend, written):
    path = written(changes)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert entry in text
    assert mend in text[text.index(entry) + len(entry):]
    assert "\n" not in text


def test_a_mesh_file_gives_its_corners(tmp_path, written):
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    (tmp_path / "foot.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\n")
    triangles = np.zeros((4, 50), np.uint8)
    for row, skipped in zip(triangles, range(4), strict=True):
        kept = np.array([corner for k, corner in enumerate(corners) if k != skipped], "<f4")
        row[12:48] = np.frombuffer(kept.tobytes(), np.uint8)
    (tmp_path / "foot.stl").write_bytes(bytes(80) + (4).to_bytes(4, "little") + triangles.tobytes())
    for name in ("foot.obj", "foot.stl"):
        scene = load_scene(written({"shapes.0": {"name": "foot", "body": "b6", "type": "mesh", "file": name}}))
        assert sorted(scene.shapes[0].points) == sorted(corners)


@pytest.mark.parametrize(("element", "kept"), [  # all other laws removed
    ("dry_friction", {"joints.0.limits": GONE}), ("limits", {"joints.0.dry_friction": GONE}),
    ("servo", {"joints.0.dry_friction": GONE, "joints.0.limits": GONE}),
], ids=["dry_friction", "limits", "servo"])
def test_an_engine_refuses_by_name_what_it_does_not_declare(element, kept, written):
    bare = {"joints": SCENE["joints"][:1], "forces": SCENE["forces"][:1] if element == "servo" else [],
            "bodies": SCENE["bodies"][:1], "shapes": [], "monitors": []}
    scene = load_scene(written({**bare, **kept}))
    reason = scene.beyond(SMOOTH)
    assert "turn" in reason
    assert {"dry_friction": "dry_friction", "limits": "rigid stops", "servo": "servo"}[element] in reason
    assert scene.beyond(ELEMENTS) is None
    if element == "servo":
        assert "effort_limit" in scene.beyond((*SMOOTH, "servo"))
        assert "no_load_speed" in scene.beyond((*SMOOTH, "servo", "effort_limit"))


def test_truth_models_all_of_it_at_once(written):
    reference = truth(load_scene(written({})).replace(monitors=(), duration=0.25))
    assert reference.error <= 1e-11
    assert {event[1] for event in reference.events} <= {"turn", "slide", "both"}


def test_the_servo_is_cut_at_its_limit_and_motor_line():
    servo = Servo(1.0, 0.5, 0.25, 10.0, 2.0, (-4.0, 3.0), 2.0)
    assert servo.effort(0.0, 0.9, 0.1) == pytest.approx(10 * 0.1 + 2 * 0.4 + 0.25, abs=1e-15)
    rates = np.array([-3.0, -1.0, 0.0, 1.0, 3.0])
    np.testing.assert_array_equal(servo.effort(0.0, -9.0, rates), [3.0, 3.0, 3.0, 1.5, 0.0])
    np.testing.assert_array_equal(servo.effort(0.0, 9.0, rates), [0.0, -2.0, -4.0, -4.0, -4.0])


def test_a_soft_limit_pushes_and_never_pulls():
    limits = Limits(-1.0, 2.0, 0.0, 100.0, 10.0)
    q, rate = np.array([-1.1, -1.1, 0.0, 2.1, 2.1]), np.array([-1.0, 5.0, 9.0, 1.0, -5.0])
    np.testing.assert_allclose(limits.force(q, rate), [20.0, 0.0, 0.0, -20.0, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(limits.energy(np.array([-1.1, 0.0, 2.2])), [0.5, 0.0, 2.0], rtol=0, atol=1e-12)


def test_forces_power_and_energy_of_the_laws(written):
    """On the hinge (q = 7, rate -.5) and the slide, moved 0.1 m beyond its soft stop at 2 m/s."""
    scene = load_scene(written({"forces.1.period": GONE, "forces.1.delay": GONE}))
    x, R, v, w = scene.x0[None].copy(), scene.R0[None], scene.v0[None].copy(), scene.w0[None]
    x[0, 1, 2], v[0, 1, 2] = 0.6, 2.0
    f = mechanics.applied_forces(scene, x, R, v, w).reshape(1, -1, 6)
    # servo cut to -4 (1 - .25), friction + .5 against the rate; the gyroscopic part is along the axis and so zero
    assert f[0, 0, 5] == pytest.approx(-3.0 + 0.5, abs=1e-12)
    # friction -.5, spring -100 and damper -20, motor .3, held force 1
    assert f[0, 1, 2] == pytest.approx(-0.5 - 120.0 + 0.3 + 1.0, abs=1e-11)
    states = States(np.zeros(1), x, R, v, w)
    potential = mechanics.energy(scene, states) - mechanics.kinetic_energy(scene, states)
    assert potential[0] == pytest.approx(5.0, abs=1e-12)


def test_a_scene_that_goes_on_keeps_whole_turns_and_the_phase_of_its_controls(written):
    scene = load_scene(written({}))
    states = States(np.array([0.0, 0.25]), *(np.repeat(values[None], 2, axis=0) for values in (scene.x0, scene.R0,
                                                                                              scene.v0, scene.w0)))
    later = restarted(scene, states, 1, 0.5)
    assert later.joints[TURN].start == pytest.approx((7.0,), abs=1e-12)
    assert later.servos[1][1].phase == pytest.approx(0.05, abs=1e-15)  # samples at .3, .4, ...
    assert later.servos[0][1].target(0.0) == pytest.approx(6.5, abs=1e-15)
