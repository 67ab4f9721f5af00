"""What holds without any oracle, on scenes of the library and on random ones.

Each of them takes one view of a scene and another that has to show the same.
"""

from __future__ import annotations

import copy
import functools
import tomllib
from pathlib import Path

import numpy as np
import pytest

import crosscheck
from crosscheck.scene.starts import restarted
from tests.oracle_values.cases import FOLDER, NAMES, loaded
from tests.oracle_values.links import edited, matrix, number, quaternion, shortest, turn

LIBRARY = Path(__file__).parents[2] / "scenarios"
RTOL = 1e-11
LEFT = {"chain_64", "fast_top_1500", "squeezer",  # a second and more each
        "parallelogram"}  # passes a singular position, where rounding decides how it goes on
FLAT = {"double_four_bar"}
"""Passes a position in one line, which a run passes that starts closed to the last digit, and no other."""
SCENES = tuple(sorted({path.stem for path in LIBRARY.glob("*.toml")} - LEFT)) + NAMES
SPINS = ("wound_wheel", "sprung_slide", "driven_hinge", "far_start", "winding_servo", "pushed_slide", "geared_wheels",
         "torsion_wheel", "geared_arm", "coupled_arm")
MANY = 41
"""Output times of a run."""
CLOSE = 1e-7
"""Of the largest value: two runs at 1e-11 whose steps end elsewhere, in motions that multiply errors a hundredfold."""


def content(name):
    folder = FOLDER if name in NAMES else LIBRARY
    return tomllib.loads((folder / f"{name}.toml").read_text())


def random_arm(seed):
    """A chain of one to three bodies on hinges, slides and balls with springs and dampers, some turning fast."""
    rng = np.random.default_rng(seed)
    bodies, joints = [], []
    for k in range(rng.integers(1, 4)):
        root = rng.normal(size=(3, 3))
        J = 0.05 * root @ root.T
        J = J + (0.05 + np.trace(J)) * np.eye(3)
        kind = rng.choice(["revolute", "prismatic", "cylindrical", "spherical"])
        axis = rng.normal(size=3).tolist()
        joint = {"name": f"j{k}", "type": kind, "parent": f"b{k - 1}" if k else "ground", "child": f"b{k}",
                 "parent_anchor": rng.normal(size=3).tolist(), "child_anchor": rng.normal(size=3).tolist()}
        count = {"cylindrical": 2, "spherical": 0}.get(kind, 1)
        if count:
            joint |= {"parent_axis": axis, "child_axis": axis}
            for key, low, high in (("position", -3, 9), ("velocity", -15, 15), ("stiffness", 0, 5), ("damping", 0, 0.5),
                                   ("rest_position", -1, 1)):
                values = rng.uniform(low, high, count).tolist()
                joint[key] = values if count == 2 else values[0]
        else:
            joint |= {"position": rng.normal(size=4).tolist(), "velocity": rng.normal(size=3).tolist()}
        bodies.append({"name": f"b{k}", "mass": rng.uniform(0.5, 2), "inertia": (0.5 * (J + J.T)).tolist()})
        joints.append(joint)
    return {"schema": 3, "name": f"arm_{seed}", "gravity": [0.0, 0.0, -9.81], "duration": 1.0, "samples": 3,
            "bodies": bodies, "joints": joints}


def loaded_arm(seed):
    """An arm with forces and torques that depend on time, one of which jumps."""
    rng, arm = np.random.default_rng(1000 + seed), random_arm(seed)
    last = arm["bodies"][-1]["name"]
    sine = {"type": "sine", "terms": [[rng.uniform(1, 5), rng.uniform(2, 9), rng.uniform(0, 3)]]}
    held = {"type": "hold", "times": [0.0, 0.3, 0.55], "values": rng.uniform(-3, 3, 3).tolist()}
    arm["forces"] = [{"type": "constant_force", "child": last, "child_point": rng.normal(size=3).tolist(),
                      "frame": "world", "force": [sine, 0.0, 0.0]},
                     {"type": "constant_torque", "child": last, "frame": "body", "torque": rng.normal(size=3).tolist()}]
    arm["forces"] += [{"type": "joint_torque", "joint": joint["name"], "torque": held} for joint in arm["joints"]
                      if joint["type"] == "revolute"]
    return arm


def lawful_arm(seed):
    """An arm with dry friction, soft stops and servos on its hinges and slides."""
    rng, arm = np.random.default_rng(2000 + seed), random_arm(seed)
    arm["forces"] = []
    for k, joint in enumerate(joint for joint in arm["joints"] if joint["type"] in ("revolute", "prismatic")):
        if (k + seed // 4) % 3 == 0:
            joint["dry_friction"] = rng.uniform(0.2, 2.0)
        elif (k + seed // 4) % 3 == 1:
            joint["limits"] = {"upper": joint["position"] + rng.uniform(0.1, 1.0), "stiffness": 200.0, "damping": 0.5}
        else:
            arm["forces"].append({"type": "servo", "joint": joint["name"], "target": rng.uniform(-1, 9),
                                  "proportional": 5.0, "derivative": 0.5, "effort_limit": 8.0})
    return arm


def looped_arm(seed):
    """An arm at rest whose last body hangs on a rod."""
    rng, arm = np.random.default_rng(3000 + seed), random_arm(seed)
    for joint in arm["joints"]:
        joint.pop("velocity", None)
    scene, point, base = loaded(arm), rng.normal(size=3), rng.normal(size=3) + 3.0
    reach = scene.x0[-1] + scene.R0[-1] @ point - base
    rod = {"name": "rod", "type": "distance", "parent": "ground", "child": arm["bodies"][-1]["name"],
           "parent_anchor": base.tolist(), "child_anchor": point.tolist(), "length": float(np.linalg.norm(reach))}
    return arm | {"joints": [*arm["joints"], rod]}


KINDS = (random_arm, loaded_arm, looped_arm, lawful_arm)
ALL = SCENES + tuple(f"random_{seed}" for seed in range(100))


def some(names):
    """Cases of a test, of which some are quick: of random scenes the first of each kind without laws."""
    return [pytest.param(name, marks=pytest.mark.slow) if name.startswith("random_") and
            int(name.removeprefix("random_")) >= KINDS.index(lawful_arm) else name for name in names]


def data_of(name):
    if name.startswith("random_"):
        seed = int(name.removeprefix("random_"))
        data = KINDS[seed % len(KINDS)](seed)
    else:
        data = content(name)
    data = {key: value for key, value in data.items() if key not in ("monitors", "published", "tags")}
    return data | {"duration": min(2.0 if name in NAMES else 1.0, data["duration"]), "samples": 3}


def ran(scene, samples=MANY, **options):
    """The run, or a skip where the engine refuses the scene."""
    try:
        return crosscheck.run(scene, engine="lieeuler", method="rkmk853", rtol=RTOL, monitor=False, samples=samples,
                              **options)
    except crosscheck.Unsupported as refused:
        pytest.skip(str(refused))


@functools.cache
def whole(name):
    """The run of a scene that all of its tests compare with."""
    return ran(loaded(data_of(name)))


def figures(run):
    """Series over time that are compared, by name."""
    out = {"x": run.x, "R": run.R, "v": run.v, "w": run.w, "energy": run.energy}
    for name, joint in run.joints.items():
        position = np.asarray(joint.position)
        out[f"position of {name}"] = position * np.where(position[:, :1] < 0, -1, 1) if position.ndim > 1 and (
            position.shape[1] == 4) else position
        out[f"rate of {name}"] = np.asarray(joint.velocity)
    return out | {f"sensor {name}": np.asarray(value) for name, value in run.sensors.items()}


def same(one, other):
    for key, value in one.items():
        if np.isnan(value).any() or np.isnan(other[key]).any():
            continue
        size = max(1.0, np.abs(value).max(initial=0.0))
        off = np.abs(value - other[key]).max(initial=0.0) / size
        assert off < CLOSE, f"{key}: {off:.1e} apart, {value.ravel()[-4:]} and {other[key].ravel()[-4:]}"


@pytest.mark.parametrize("name", some(ALL))
def test_values_do_not_depend_on_the_times_asked_for(name):
    few = figures(ran(loaded(data_of(name)), samples=2))
    same(few, {key: value[::40] for key, value in figures(whole(name)).items()})


@pytest.mark.parametrize("name", some(name for name in ALL if name in SPINS or name.startswith("random_")))
def test_half_a_run_is_the_first_half(name):
    scene = loaded(data_of(name))
    half = figures(ran(scene, samples=3, duration=scene.duration / 2))
    same(half, {key: value[:21:10] for key, value in figures(whole(name)).items()})


@pytest.mark.parametrize("name", some(name for name in ALL if name not in FLAT))
def test_a_run_goes_on_from_any_of_its_states(name):
    """From the middle of the run, and with it the turns of hinges and the phases of functions of time."""
    scene = loaded(data_of(name))
    if any(servo.period is not None for _, servo in scene.servos.values()):
        pytest.skip("a state does not tell what a sampled servo holds")
    later = ran(restarted(scene, whole(name), 20, scene.duration / 2), samples=3)
    same(figures(later), {key: value[20::10] for key, value in figures(whole(name)).items()})


ORIGIN = "0.1 -0.2 0.3"
ROBOT = [("turn", "0 0 0", "0 1 0", 0.1), ("slide", ORIGIN, "0.6 0 0.8", 0.4), ("turn", "0.2 0 -0.4", "1 0 0", 0.0)]


def spellings(seed):
    """A robot as URDF and as MJCF."""
    rng = np.random.default_rng(seed)
    links, joints, bodies = ['<link name="base"/>'], [], []
    for k, (kind, origin, axis, damping) in enumerate(ROBOT):
        root = rng.normal(size=(3, 3))
        J = 0.1 * (root @ root.T + np.trace(root @ root.T) * np.eye(3))
        mass, com = rng.uniform(0.5, 2.0), " ".join(f"{value:.17g}" for value in rng.normal(size=3))
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": f"{J[i, j]:.17g}" for i, j in (
            (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))}
        inertia = " ".join(f'{key}="{value}"' for key, value in entries.items())
        links.append(f'<link name="b{k}"><inertial><origin xyz="{com}"/><mass value="{mass:.17g}"/>'
                     f'<inertia {inertia}/></inertial></link>')
        what, limit = ("continuous", "") if kind == "turn" else (
            "prismatic", '<limit lower="-9" upper="9" effort="9" velocity="9"/>')
        joints.append(f'<joint name="j{k}" type="{what}"><parent link="{f"b{k - 1}" if k else "base"}"/>'
                      f'<child link="b{k}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>{limit}'
                      f'<dynamics damping="{damping}"/></joint>')
        bodies.append(f'<body name="b{k}" pos="{origin}"><joint name="j{k}" axis="{axis}" damping="{damping}" '
                      f'type="{"hinge" if kind == "turn" else "slide"}"/><inertial pos="{com}" mass="{mass:.17g}" '
                      f'fullinertia="{" ".join(entries.values())}"/>')
    nested = "".join(bodies) + "</body>" * len(bodies)
    return (f'<robot name="r">{"".join(links + joints)}</robot>',
            f'<mujoco model="r"><option gravity="0 0 -9.81"/><worldbody>{nested}</worldbody></mujoco>')


@pytest.mark.parametrize("seed", range(3))
def test_a_urdf_and_an_mjcf_of_one_robot_are_one(tmp_path, seed):
    runs = []
    for text, name in zip(spellings(seed), ("r.urdf", "r.xml"), strict=True):
        (tmp_path / name).write_text(text)
        runs.append(ran(crosscheck.import_model(tmp_path / name, limits="drop").replace(duration=1.0), samples=3))
    one, other = runs
    same({key: getattr(one, key) for key in ("x", "v", "energy", "work")},
         {key: getattr(other, key) for key in ("x", "v", "energy", "work")})
    assert list(one.joints) == list(other.joints)
    for name, joint in one.joints.items():
        same({"position": joint.position, "rate": joint.velocity},
             {"position": other.joints[name].position, "rate": other.joints[name].velocity})
    assert np.abs(one.joints["j1"].velocity).max() > 0.5


def renamed(data):
    """Other names of bodies and joints, in the same order."""
    names = {table: {entry["name"]: f"{table}{k} new" for k, entry in enumerate(data.get(table, []))}
             for table in ("bodies", "joints")}

    def walk(entry, table):
        if isinstance(entry, list):
            return [walk(value, table) for value in entry]
        if not isinstance(entry, dict):
            return entry
        new = {key: walk(value, key) for key, value in entry.items()}
        for key, kind in (("parent", "bodies"), ("child", "bodies"), ("body", "bodies"), ("joint", "joints")):
            if key in new:
                new[key] = names[kind].get(new[key], new[key])
        if table in names:
            new["name"] = names[table][new["name"]]
        return new

    return walk(data, "")


@pytest.mark.parametrize("name", some(ALL))
def test_renaming_changes_nothing(name):
    one, other = whole(name), ran(loaded(renamed(data_of(name))))
    for key in ("x", "R", "v", "w", "energy"):
        np.testing.assert_array_equal(getattr(one, key), getattr(other, key))


def turned(data, R, shift):
    """The file with the whole world turned, then shifted: what is fixed to the ground goes along."""
    scene, data = loaded(data), copy.deepcopy(data)
    data["gravity"] = (R @ data["gravity"]).tolist()
    for k, body in enumerate(data["bodies"]):
        body |= {"attitude": quaternion(R @ scene.R0[k]).tolist(), "position": (R @ scene.x0[k] + shift).tolist(),
                 "velocity": (R @ scene.v0[k]).tolist(), "angular_velocity": scene.w0[k].tolist()}
    for joint in data.get("joints", []):
        if joint["parent"] == "ground":
            axes = [np.asarray(joint[key], float) for key in ("child_axis", "parent_axis") if key in joint]
            zero = shortest(*(axis / np.linalg.norm(axis) for axis in axes)) if joint["type"] in (
                "revolute", "cylindrical") else np.eye(3)
            zero = matrix(joint["reference_attitude"]) if "reference_attitude" in joint else zero
            if joint["type"] in ("revolute", "cylindrical", "universal", "spherical"):
                joint["reference_attitude"] = quaternion(R @ zero).tolist()
            joint["parent_anchor"] = (R @ joint["parent_anchor"] + shift).tolist()
            if "parent_axis" in joint:
                joint["parent_axis"] = (R @ joint["parent_axis"]).tolist()
    for force in data.get("forces", []):
        for end in ("parent", "child"):
            if force.get(end) == "ground" and f"{end}_point" in force:
                force[f"{end}_point"] = (R @ force[f"{end}_point"] + shift).tolist()
        key = force["type"].removeprefix("constant_")
        if force.get("frame") == "world":
            force[key] = (R @ force[key]).tolist()
    return data | {"schema": 3}


def turnable(name):
    """Whether all that is tied to the ground has axes that a turn of the world leaves defined."""
    data = data_of(name)
    if any(force["type"] == "torsional_spring" for force in data.get("forces", [])):  # its zero is that of the axes
        return False
    return not any(joint["child"] == "ground" or (joint["parent"] == "ground" and joint["type"] in (
        "prismatic", "fixed", "planar")) for joint in data.get("joints", [])) and not any(
        force.get("frame") == "world" and any(isinstance(part, dict) for part in force[
            force["type"].removeprefix("constant_")]) for force in data.get("forces", []))


@pytest.mark.parametrize("name", [name for name in SCENES if turnable(name)])
def test_turning_and_shifting_change_nothing(name):
    data = data_of(name)
    R, shift = turn(np.array([0.6, 0.0, 0.8]), 2.0), np.array([0.3, -2.0, 1.1])
    one, other = whole(name), ran(loaded(turned(data, R, shift)))
    here = figures(one) | {"energy": one.energy - one.energy[0]}
    there = figures(other) | {"energy": other.energy - other.energy[0], "x": (other.x - shift) @ R,
                              "R": R.T @ other.R, "v": other.v @ R}
    same(here, there)


@pytest.mark.parametrize("name", [name for name in NAMES if any(
    joint["type"] == "revolute" and "stiffness" in joint for joint in content(name).get("joints", []))])
def test_a_joint_spring_is_a_torsional_spring(name):
    data, springs = data_of(name), []
    other = copy.deepcopy(data)
    for joint in other["joints"]:
        if joint["type"] == "revolute" and "stiffness" in joint:
            springs.append({"type": "torsional_spring", "joint": joint["name"], "stiffness": joint.pop("stiffness"),
                            "rest_angle": joint.pop("rest_position", 0.0), "damping": joint.pop("damping", 0.0)})
    other["forces"] = other.get("forces", []) + springs
    same(figures(whole(name)), figures(ran(loaded(other))))


@pytest.mark.parametrize("name", some(name for name in ALL if name in SPINS or name.startswith("random_")))
def test_energy_changes_by_the_work(name):
    run = whole(name)
    left = run.energy - run.energy[0] - run.work
    assert np.isfinite(run.work).all()
    assert np.abs(left).max() < CLOSE * max(1.0, np.abs(run.energy).max(), np.abs(run.work).max()), left


def numbers(data):
    """Paths of numbers of a file, of each kind one or two."""
    for joint in data.get("joints", []):
        for key in ("stiffness", "damping", "rest_position", "armature"):
            if isinstance(joint.get(key), float):
                yield f"joints.{joint['name']}.{key}"
        yield from (f"joints.{joint['name']}.{anchor}.{k}" for anchor, k in (("child_anchor", 0), ("parent_anchor", 2)))
    for body in data["bodies"]:
        yield from (f"bodies.{body['name']}.{end}" for end in ("mass", "inertia.0.1", "inertia.2.2"))


OF_FILES = {name: tuple(numbers(data_of(name))) for name in (
    "sprung_slide", "wound_wheel", "torsion_wheel", "random_24", "random_36")}


@functools.cache
def derivatives(name, duration):
    """Of the state after this time, by all numbers of a file."""
    return crosscheck.flow_derivative(loaded(data_of(name)), duration, source="lieeuler:rkmk853", rtol=RTOL,
                                      parameters=OF_FILES[name]).parameters


@pytest.mark.parametrize(("name", "path"), [(name, path) for name, paths in OF_FILES.items() for path in paths])
def test_a_derivative_is_the_difference_of_edited_files(name, path):
    data, duration, h = data_of(name), 0.1, 2e-5
    at, found = number(data, path), derivatives(name, duration)[:, OF_FILES[name].index(path)]

    def after(step):
        run = ran(loaded(edited(data, path, at + step)), duration=duration, samples=2)
        joints = run.joints.values()
        return np.array([joint.position[-1] for joint in joints] + [joint.velocity[-1] for joint in joints])

    wanted = (after(h) - after(-h)) / (2 * h)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5 * max(1.0, np.abs(wanted).max()))
