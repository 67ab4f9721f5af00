"""Commands on random arms, logs and engines of the user's own: whatever is typed, none ends in an internal error.

    python -m tests.first_contact 300 --budget 5                    # of each of judge, inspect, run, advise
    python -m tests.first_contact 30 --only verify,truth,convert    # of others

Draws that once ended in one are in `tests/seeds/first_contact.txt`.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import itertools
import json
import math
import os
import re
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from types import SimpleNamespace
from xml.sax.saxutils import quoteattr

from crosscheck.scene import models
from tests import ROOT, SCENARIOS, saved

SEEDS = ROOT / "tests" / "seeds" / "first_contact.txt"
MAIN = ("judge", "inspect", "run", "advise")
OURS = re.compile(r"internal error|Traceback \(most|\b(?:ZeroDivision|Key|Index|Type|Attribute|LinAlg|Assertion|Name|"
                  r"UnboundLocal|Overflow|FloatingPoint|Recursion|NotImplemented)Error\b")
"""What an internal error leaves, also in the words of a command that goes on after it."""
TROUBLED = "a mistake of its own"
"""The words of the errors that engines of these draws raise themselves."""

NUMBERS = (0.0, 1.0, -1.0, 0.1, 1e-12, 1e12, 0.37)
NAMES = ("hip", "knee", "elbow_pitch", "joint 1", "q0", "a.b", "1", "glied-ä", "x_1$", "arm", "world", "t")


# --- arms ---------------------------------------------------------------------------------------------------------


def number(random: Random, low: float = 0.05, high: float = 2.0, strange: float = 0.04) -> float:
    """Mostly of the size of an arm's."""
    if random.random() < strange:
        return random.choice(NUMBERS)
    return float(f"{random.uniform(low, high):.{random.randint(2, 6)}g}")


def triple(random: Random, size: float = 1.0) -> str:
    return " ".join(f"{random.uniform(-size, size) if random.random() < 0.5 else 0:.4g}" for _ in range(3))


def axis(random: Random) -> str:
    return random.choice(("0 0 1", "0 1 0", "1 0 0", "0 -1 0", triple(random), "1 1 0"))


def bounds(random: Random) -> list[float]:
    """Of a joint; one in twenty in the wrong order."""
    return sorted((number(random, -3, 0), number(random, 0, 3)), reverse=random.random() < 0.05)


def names(random: Random, many: int) -> list[str]:
    return random.sample(NAMES, many) if random.random() < 0.3 else [f"joint{k + 1}" for k in range(many)]


def tree(random: Random, many: int) -> list[int]:
    """The parent of each link; -1: the base."""
    return [k - 1 if random.random() < 0.8 else random.randint(-1, k - 1) for k in range(many)]


def urdf(random: Random) -> str:
    """An arm as a URDF with whatever such files hold."""
    many = random.randint(1, 5)
    called, links = names(random, many), []
    text = [f'<?xml version="1.0"?>\n<robot name={quoteattr(random.choice(("arm", "my arm", "r_1")))}>\n'
            '<link name="base"/>']
    for k, parent in enumerate(tree(random, many)):
        mass, moments = number(random), [number(random, 0.02, 0.03, 0.02) for _ in range(3)]
        inertial = "" if random.random() < 0.06 else (
            f'<inertial><origin xyz="{triple(random, 0.3)}" rpy="{triple(random)}"/><mass value="{mass}"/>'
            f'<inertia ixx="{moments[0]}" iyy="{moments[1]}" izz="{moments[2]}" ixy="0" ixz="0" iyz="0"/></inertial>')
        shape = random.choice(('<box size=".1 .1 .3"/>', '<sphere radius=".05"/>',
                               '<cylinder radius=".04" length=".3"/>', '<mesh filename="package://arm/link.stl"/>'))
        collision = (f'<collision><origin xyz="0 0 {number(random, -0.3, 0.3)}"/><geometry>{shape}</geometry>'
                     '</collision>')
        text.append(f'<link name="link{k}">{inertial}{collision if random.random() < 0.4 else ""}</link>')
        kind, = random.choices(("revolute", "continuous", "prismatic", "fixed", "floating", "planar"),
                               (6, 3, 2, 1, 0.3, 0.2))
        low, high = bounds(random)
        limit = (f'<limit lower="{low}" upper="{high}" effort="{number(random, 1, 40)}" '
                 f'velocity="{number(random, 1, 9)}"/>')
        more = [limit] if kind in ("revolute", "prismatic") and random.random() < 0.95 else []
        if random.random() < 0.4:
            more.append(f'<dynamics damping="{number(random)}" friction="{number(random, 0, 0.5)}"/>')
        if k and random.random() < 0.15:
            more.append(f'<mimic joint={quoteattr(called[random.randrange(k)])} multiplier="{number(random)}" '
                        'offset=".1"/>')
        links.append(f'<joint name={quoteattr(called[k])} type="{kind}">'
                     f'<parent link="{"base" if parent < 0 else f"link{parent}"}"/>'
                     f'<child link="link{k}"/><origin xyz="{triple(random)}" rpy="{triple(random)}"/>'
                     f'<axis xyz="{axis(random)}"/>{"".join(more)}</joint>')
    return "\n".join([*text, *links, "</robot>"])


GEOMS = ('type="capsule" fromto="0 0 0 .3 0 0" size=".03"', 'type="box" size=".05 .05 .2"', 'type="sphere" size=".08"')


def mjcf(random: Random) -> str:
    """An arm as an MJCF with whatever such files hold."""
    many = random.randint(1, 5)
    called, parents = names(random, many), tree(random, many)
    kinds = random.choices(("hinge", "slide", "ball"), (8, 2, 1), k=many)

    def body(k: int) -> str:
        ball = kinds[k] == "ball"
        more = [] if ball else [f'axis="{axis(random)}"']
        values = {"damping": (0.4, number(random)), "frictionloss": (0.3, number(random, 0, 0.5)),
                  "armature": (0.2, number(random, 0, 0.1)), "stiffness": (0.15, number(random, 0, 20)),
                  "springref": (0.1, number(random)), "ref": (0.1, number(random, -1, 1))}
        for key, (chance, value) in values.items():
            if random.random() < chance and not (ball and key in ("springref", "ref")):
                more.append(f'{key}="{value}"')
        if random.random() < 0.3 and not ball:
            low, high = bounds(random)
            more.append(f'range="{low} {high}"')
        joint = f'<joint name={quoteattr(called[k])} type="{kinds[k]}" pos="{triple(random, 0.2)}" {" ".join(more)}/>'
        geom = random.choice(GEOMS)
        contact = "" if random.random() < 0.3 else ' contype="0" conaffinity="0"'
        inner = f'<body name="link{k}" pos="{triple(random)}">{joint}<geom {geom}{contact}/>'
        return inner + "".join(body(c) for c in range(many) if parents[c] == k) + "</body>"

    hinged = [name for name, kind in zip(called, kinds, strict=True) if kind != "ball"]
    drives = "".join(random.choice((
        f'<motor joint={quoteattr(name)} gear="2"/>', f'<position joint={quoteattr(name)} kp="40"/>',
        f'<position joint={quoteattr(name)} kp="40" kv="{number(random)}" forcerange="-2 2" ctrlrange="-1 1"/>',
        f'<velocity joint={quoteattr(name)} kv="2"/>')) for name in hinged if random.random() < 0.2)
    tied = random.sample(hinged, 2) if len(hinged) > 1 and random.random() < 0.15 else []
    pair = " ".join(f"joint{k + 1}={quoteattr(name)}" for k, name in enumerate(tied))
    equality = f"<equality><joint {pair} polycoef='0 {number(random)} 0 0 0'/></equality>" if tied else ""
    qpos = " ".join("1 0 0 0" if kind == "ball" else f"{number(random, -1, 1)}" for kind in kinds)
    keys = f'<keyframe><key name="home" qpos="{qpos}"/></keyframe>' if random.random() < 0.4 else ""
    return (f'<mujoco model="arm"><compiler angle="{random.choice(("radian", "degree"))}"/>'
            f'<option timestep="{random.choice((0.001, 0.002, 0.01))}" '
            f'integrator="{random.choice(("Euler", "RK4", "implicitfast"))}"/>'
            f"<worldbody>{''.join(body(k) for k in range(many) if parents[k] == -1)}</worldbody>"
            f"{equality}<actuator>{drives}</actuator>{keys}</mujoco>")


def changed_scene(random: Random) -> str:
    """A scene file of the library with a number changed."""
    text = random.choice(sorted(SCENARIOS.glob("*.toml"))).read_text(encoding="utf-8")
    place = random.choice(list(re.finditer(r"(?<== )-?\d+\.?\d*", text)))
    changed = number(random, strange=0.3) if "." in place[0] else random.choice((0, 1, 3, int(place[0]) + 1))
    return text[:place.start()] + str(changed) + text[place.end():]


def scene_file(random: Random) -> str:
    """An arm as a scene file with laws on its joints, or one of the library's with a number changed."""
    if random.random() < 0.25:
        return changed_scene(random)
    many = random.choice((1, 2, 2, 3, 5))
    lines = ["schema = 3", 'name = "arm"', 'description = "an arm"', f"duration = {random.choice((0.1, 0.5, 2.0))}",
             f"samples = {random.choice((2, 11, 101))}", "gravity = [0.0, 0.0, -9.81]"]
    for k in range(many):
        lines += ["[[bodies]]", f'name = "b{k}"', f"mass = {number(random)}",
                  f"inertia = [[{number(random, 0.1, 0.12, 0)}, 0, 0], [0, 0.11, 0], [0, 0, 0.1]]",
                  f"position = [{0.5 + k}, 0.0, 0.0]"]
        if random.random() < 0.3:
            lines.append(f"angular_velocity = [0.0, {number(random, -3, 3)}, 0.0]")
    served: list[str] = []
    for k in range(many):
        kind = random.choice(("revolute", "revolute", "prismatic", "spherical", "universal"))
        lines += ["[[joints]]", f'name = "j{k}"', f'type = "{kind}"', f'parent = "{f"b{k - 1}" if k else "ground"}"',
                  f'child = "b{k}"', f"parent_anchor = [{'0.5' if k else '0.0'}, 0.0, 0.0]",
                  "child_anchor = [-0.5, 0.0, 0.0]"]
        if kind != "spherical":
            lines += ["parent_axis = [0.0, 1.0, 0.0]",
                      f"child_axis = [0.0, {'0.0, 1.0' if kind == 'universal' else '1.0, 0.0'}]"]
        if kind in ("revolute", "prismatic"):
            laws = [f"damping = {number(random)}", f"stiffness = {number(random, 0, 30)}",
                    f"dry_friction = {number(random, 0, 3)}",
                    f"limits = {{ lower = {number(random, -2, -0.1)}, upper = {number(random, 0.1, 2)}, "
                    f"restitution = {random.choice((0.0, 0.5))} }}", f"armature = {number(random, 0, 0.2)}"]
            lines += random.sample(laws, random.choice((0, 0, 1, 2)))
            if random.random() < 0.2:
                served += ["[[forces]]", 'type = "servo"', f'joint = "j{k}"',
                           f"proportional = {number(random, 1, 90)}", f"derivative = {number(random, 0, 5)}",
                           f"target = {number(random, -1, 1)}", *random.sample(
                               ["effort_limit = 3.0", "feedforward = 1.0", "delay = 1", "period = 0.01"],
                               random.randint(0, 2))]
    return "\n".join(lines + served)


ARMS = {"urdf": urdf, "xml": mjcf, "toml": scene_file}


def arm(random: Random, folder: Path) -> Path:
    """The file of an arm; one in twenty is cut or lacks a line."""
    kind = random.choice(tuple(ARMS))
    text = ARMS[kind](random)
    if random.random() < 0.05:
        text = random.choice((text[:random.randrange(len(text))],
                              text.replace(random.choice(text.splitlines()), "", 1), ""))
    return saved(folder / f"{random.choice(('arm', 'my arm', 'arm-2'))}.{kind}", text)


# --- logs ---------------------------------------------------------------------------------------------------------


def motion(path: Path, random: Random) -> tuple[list[str], list[list[float]]]:
    """Names and rows: MuJoCo's motion of the arm where it reads the file, else waves."""
    rows, step = random.choice((1, 2, 5, 50, 200)), random.choice((0.001, 0.005, 0.01))
    try:
        import mujoco

        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        model.opt.timestep = min(step, 0.002)
        kept = []
        for k in range(rows):
            while data.time < k * step - 1e-9:
                mujoco.mj_step(model, data)
            kept.append([k * step, *data.qpos, *data.qvel])
        joints = [model.joint(k).name for k in range(model.njnt)]
        if model.nq == model.nv == model.njnt:
            return ["time", *(f"{name}.position" for name in joints), *(f"{name}.velocity" for name in joints)], kept
        return ["time", *(f"q{k}" for k in range(model.nq)), *(f"v{k}" for k in range(model.nv))], kept
    except Exception:
        called = random.choice((["j0.position"], ["j0.position", "j0.velocity"], ["j0.position", "j1.position"],
                                ["b0.x", "b0.y", "b0.z"], ["joint1"]))
        return ["time", *called], [[k * step, *(math.sin(k * step + c) for c in range(len(called)))]
                                   for k in range(rows)]


WRONG_CELLS = ("", "nan", "inf", "-", "1e400", "true", "12:30", "0.01 sec")
UNITS = ((1e3, "mm"), (57.29577951308232, "deg"), (1e6, "us"), (1.0, "furlong"))
ABOVE = (["nRows=2", "inDegrees=yes", "endheader"], ["# a log"], [""], ["Robot log of today", "rate,100"])


def spoil(random: Random, heads: list[str], cells: list[list[str]], rows: list[list[float]], form: str) -> None:
    """One change of a table of texts, in the ways of the field; `rows` are its numbers."""
    row, column = random.randrange(len(cells)), random.randrange(len(heads))

    def put(values: Iterator[str]) -> None:
        """Other texts in the column, as far as there are any."""
        cells[:] = [[*each[:column], value, *each[column + 1:]] for each, value in zip(cells, values, strict=False)]

    change = random.randrange(19)
    if change == 0:
        del cells[row]
    elif change == 1:
        cells[row][column] = random.choice(WRONG_CELLS)
    elif change == 2:
        cells.insert(row, cells[row])
    elif change == 3:
        heads[column] = random.choice(
            ("", "time", "t [ms]", "elbow [deg]", "position", heads[0], "q1", "x y", "pos_x", "#"))
    elif change == 4:
        del heads[column]
        cells[:] = [each[:column] + each[column + 1:] for each in cells]
    elif change == 5:
        cells[row] = cells[row][:column]
    elif change == 6:
        put(itertools.repeat("0"))
    elif change == 7:
        cells.reverse()
    elif change == 8:
        put(form.format(value[column] * 1.01 + 0.001) for value in rows)
    elif change == 9:
        del heads[1:]
    elif change == 10:
        cells[:] = [["" if random.random() < 0.2 else cell for cell in each] for each in cells]
    elif change == 11:
        cells[:] = [[str(1.7e9 + k * 0.01), *each[1:]] for k, each in enumerate(cells)]
    elif change == 12:
        heads += heads[1:]
        cells[:] = [[*each, *each[1:]] for each in cells]
    elif change == 13:
        cells[:] = [[f"{value[0] * 1e3:.0f}", *each[1:]] for each, value in zip(cells, rows, strict=False)]
    elif change == 14:
        cells[:] = [[str(float(value[0]) + random.uniform(-4e-4, 4e-4)), *each[1:]]
                    for value, each in zip(rows, cells, strict=False)]
    elif change == 15:
        factor, unit = random.choice(UNITS)
        heads[column] += random.choice((" [{}]", "_{}", " ({})")).format(unit)
        put(form.format(factor * value[column]) for value in rows)
    elif change == 16:
        heads[:] = [head.replace("position", random.choice(("pos", "angle", "q", "effort"))) for head in heads]
    elif change == 17:
        heads[:] = [random.choice((head, head.upper(), f"/robot/{head}", f"wrong_{head}")) for head in heads]


def log(random: Random, path: Path, folder: Path) -> Path:
    """A record of the arm's motion, spoilt once or twice."""
    heads, rows = motion(path, random)
    form = random.choice(("{:.17g}", "{:.17g}", "{:.6f}", "{:.3f}", "{:e}"))
    cells = [[form.format(value) for value in row] for row in rows]
    for _ in range(random.choice((0, 0, 1, 1, 2))):
        spoil(random, heads, cells, rows, form)
        if not cells or len(heads) < 2:
            break
    between = random.choice((",", ",", ",", ";", "\t", " "))
    lines = [between.join(f'"{head}"' if between in head else head for head in heads), *map(between.join, cells)]
    if random.random() < 0.05:
        lines = [*random.choice(ABOVE), *lines]
    file = folder / random.choice(("log.csv", "log.csv", "log.csv", "log.sto", "log.npz", "log.txt"))
    if file.suffix == ".npz":
        import numpy as np

        columns = ([row[k] if k < len(row) else 0.0 for row in rows] for k in range(len(heads)))
        with open(file, "wb") as target:
            np.savez(target, **{head or "x": np.array(column) for head, column in zip(heads, columns, strict=True)})
    else:
        file.write_text("\n".join(lines) + random.choice(("\n", "")), encoding=random.choice(("utf-8", "utf-8-sig")))
    return file


# --- engines ------------------------------------------------------------------------------------------------------

RETURNS = (*["states"] * 3, "RawRun(states, 1e-3, 10, spec.step)", "RawRun(states, float('nan'), -1, None)", "None",
           "[1.0]", "States(scene.t[:-1], x[:-1], R[:-1], v[:-1], w[:-1])", "States(scene.t, x[:, :0], R, v, w)",
           "States(scene.t, x * np.nan, R, v, w)", "States(scene.t, x, R * 1.1, v, w)",
           "States(scene.t, x.astype(object), R, v, w)", "States(scene.t, x + 1e-9, R, v, w)", "(x, R, v, w)",
           "States(scene.t, x.tolist(), R, v, w)", "States(scene.t, x.astype('f4'), R, v, w)",
           "States(scene.t, x * 1e300, R, v * 1e300, w)")
BEFORE = (*[""] * 3, f'raise ValueError("{TROUBLED}")', "h = spec.step * 1", "print('step', spec.step)",
          "np.log(-np.ones(9))", f'raise SystemExit("{TROUBLED}")', "while True: pass",
          "import os; os.write(1, b'\\xff' * 9)", "import sys; sys.stdout.close()", "scene.x0[:] = 0")
OTHERS = (*[""] * 40, 'orders = {"Go": 1}', 'orders = {"Go": 0}', "orders = {}", 'forms = ("tree", "maximal")',
          "forms = ()", "versions = 3", 'version = "2.1"', 'orders = {"Go": None}', 'orders = {"Stop": 2}',
          'controls = {"Go": "rtol"}')
METHODS = (*['("Go",)'] * 40, '["Go", "Stop"]', "()", '"Go"', "(1, 2)", '("a b", "<i>")')
REASONS = (*["None"] * 40, "'not this one'", "''", "True", "scene.joints[9].name")


OWN = """
import numpy as np
from crosscheck.adapters.base import RawRun
from crosscheck.scene.states import States

class {name}:
    name = {told}
    methods = {methods}
    {other}

    def unsupported(self, scene, spec):
        return {reason}

    def run(self, scene, spec):
        {before}
        t = scene.t[:, None, None]
        x = scene.x0 + t * scene.v0 + t**2 / 2 * scene.gravity
        v = scene.v0 + t * scene.gravity
        R, w = (np.repeat(each[None], len(scene.t), 0) for each in (scene.R0, scene.w0))
        states = States(scene.t, x, R, v, w)
        return {answer}
"""
"""A class of the user's own: bodies that fly on through their joints, or worse."""


def engine(random: Random, folder: Path) -> str:
    """A built-in engine, or a class of the user's own."""
    if random.random() < 0.5:
        return random.choice((*["lieeuler", "mujoco", "mujoco", "pinocchio", "exudyn"] * 4, "lieuler"))
    name = random.choice(("Own", "Own", "own_engine"))
    text = OWN.format(name=name, told=random.choice((*['"own"'] * 20, '"mujoco"', '"my engine"', '""', "7")),
                      methods=random.choice(METHODS), other=random.choice(OTHERS), reason=random.choice(REASONS),
                      before=random.choice(BEFORE), answer=random.choice(RETURNS))
    return f"{saved(folder / 'own.py', text)}:{name}"


# --- commands -----------------------------------------------------------------------------------------------------


def maybe(random: Random, *choices: tuple[float, tuple[str, ...]]) -> list[str]:
    return [word for chance, words in choices if random.random() < chance for word in words]


def model_options(random: Random, path: Path) -> list[str]:
    return [] if path.suffix == ".toml" else maybe(random, (0.6, ("--drop",)), (0.15, ("--keyframe", "home")))


METHODS_OF = {"lieeuler": ("taylor", "rkmk4", "DAE1L_LSE", "DAE2H_LE", "rkmk54", "generalized_alpha"),
              "mujoco": ("RK4", "Euler", "implicitfast"), "pinocchio": ("RK4naive", "SymplecticEuler", "RKMK4"),
              "exudyn": ("RK67", "generalized_alpha")}


def method_of(random: Random, name: str) -> list[str]:
    words = maybe(random, (0.9, ("--method", random.choice(METHODS_OF.get(name, ("Go",))))))
    return words + random.choice((*[["--step", "1e-2"]] * 6,
                                  ["--step", random.choice(("1e-3", "1e-2", ".1", "3", "1e-4"))],
                                  ["--rtol", random.choice(("1e-6", "1e-9", "1"))], []))


def judge(random: Random, path: Path, folder: Path) -> list[str]:
    if random.random() < 0.1:
        return [str(path), str(log(random, path, folder)), "--suggest", *model_options(random, path)]
    logs = [str(log(random, path, folder)) for _ in range(random.choice((1, 1, 1, 2)))]
    return [str(path), *logs, *model_options(random, path), *maybe(
        random, (0.5, ("--start", "recorded")),
        (0.6, ("--tol", random.choice(("position=1e-3", "joint_position=1e-3", "attitude=.1", "x=1")))),
        (0.1, ("--step", "1e-3")), (0.1, ("--order", random.choice("0129"))), (0.3, ("--json",)),
        (0.1, ("--out", str(folder / "page"))))]


def inspect(random: Random, path: Path, folder: Path) -> list[str]:
    return [str(path), *maybe(
        random, (0.4, ("--engine", engine(random, folder))),
        (0.2, ("--form", random.choice(("tree", "maximal", "pivot")))), (0.3, ("--states", random.choice("0159"))),
        (0.1, ("--torques",)), (0.1, (str(random.choice((path, "double_pendulum"))),)))]


def run(random: Random, path: Path, folder: Path) -> list[str]:
    name = engine(random, folder)
    return [str(path), "--engine", name, *method_of(random, name), *model_options(random, path), *maybe(
        random, (0.2, ("--duration", random.choice(("1e-6", ".1", "3")))),
        (0.2, ("--samples", random.choice(("0", "1", *["2", "11", "33"] * 5)))),
        (0.1, ("--form", random.choice(("tree", "maximal", "pivot", "x")))), (0.1, ("--csv", "-")),
        (0.1 if path.suffix != ".toml" else 0, ("--limits", "keep")),
        (0.2, ("--set", random.choice(("reduce=off", "reduce=x", "softness=tight", "alpha=-1", "x", "x=", "=1")))),
        (0.1, ("--script",)), (0.05, ("--script", "--issue", "issue.md")))]


def advise(random: Random, path: Path, folder: Path) -> list[str]:
    return [str(path), "--engine", engine(random, folder), "--error",
            random.choice((*["1e-3", "1e-6", "position=1e-4"] * 5, "0", "-1", "1", "nan")),
            *model_options(random, path), *maybe(random, (0.2, ("--json",)))]


def verify(random: Random, path: Path, folder: Path) -> list[str]:
    return ["--scene", str(path), "--engine", engine(random, folder), "--profile", "smoke", "--out",
            str(folder / "page"), *model_options(random, path), *maybe(
                random, (0.3, ("--duration", ".1")), (0.2, ("--step", ".01")), (0.2, ("--json",)),
                (0.1, ("--tol", "position=1")))]


def explain(random: Random, path: Path, folder: Path) -> list[str]:
    return [str(path), "--engine", engine(random, folder), *model_options(random, path),
            *maybe(random, (0.3, ("--step", ".01")))]


def _scene_alone(*choices: tuple[float, tuple[str, ...]]) -> Callable[[Random, Path, Path], list[str]]:
    return lambda random, path, folder: [str(path), *model_options(random, path), *maybe(random, *choices)]


def linearise(random: Random, path: Path, folder: Path) -> list[str]:
    plain = [str(path), *model_options(random, path), *maybe(
        random, (0.3, ("--source", "mujoco")), (0.3, ("--json",)))]
    if random.random() < 0.5:
        return plain
    return [str(path), *model_options(random, path), *maybe(random, (0.4, (
        "--over", random.choice(("bodies.b0.mass=1:2", "gravity=0:1", "x=1:2", "bodies.b0.mass=0:0")),
        "--points", "2")))]


def import_(random: Random, path: Path, folder: Path) -> list[str]:
    return [str(path), "--out", str(folder / "scene.toml"), *model_options(random, path), *maybe(
        random, (0.2, ("--base", "free")), (0.2, ("--balance",)),
        (0.2, ("--limits", random.choice(("keep", "drop")))), (0.1, ("--root", "link1")),
        (0.2, ("--start", random.choice(("random", "3", "x")))), (0.1, ("--samples", "1")),
        (0.1, ("--actuators", "drop")), (0.1, ("--friction", "drop")), (0.1, ("--control", "joint1=.3")))]


def export(random: Random, path: Path, folder: Path) -> list[str]:
    return [str(path), "--out", str(folder / f"out.{random.choice(('xml', 'urdf', 'py', 'txt'))}")]


def sweep(random: Random, path: Path, folder: Path) -> list[str]:
    own = {engine(random, folder): "Go", "lieeuler": "rattle2", "mujoco": "RK4", "pinocchio": "RKMK4"}
    name = random.choice([*own])
    file = saved(folder / "sweep.toml", (
        f"scenes = [{str(path)!r}]\nsteps = [{random.choice(('0.01', '1e-2, 1e-3', '0', '-1'))}]\nduration = 0.1\n"
        f'[engines]\n{json.dumps(name)} = ["{own[name]}"]\n')
        + random.choice(("", "[perturb]\ncount = 3\n", '[parameters]\n"bodies.b0.mass" = [1.0, 2.0]\n')))
    return ["sweep", str(file), "--out", str(folder / "page"), *maybe(random, (0.2, ("--dry-run",)))]


def history(random: Random, path: Path, folder: Path) -> list[str]:
    store = folder / "store.sqlite"
    if random.random() < 0.5:
        store.write_bytes(random.choice((b"", b"SQLite format 3\0" + bytes(99), random.randbytes(4096))))
    words = random.choice((["list"], ["show"], ["show", "x"], ["compare", "a", "b"], ["accept"],
                           ["page", "--out", str(folder / "page")], ["add", str(path)],
                           ["trend", "position error", "--scene", "a", "--engine", "b", "--method", "c"]))
    return [*words, "--store", str(store)]


def study(random: Random, path: Path, folder: Path) -> list[str]:
    return [random.choice(("work-precision", "drift", "stability", "x")), str(path), "--engine",
            engine(random, folder), "--out", str(folder / "page")]


COMMANDS: dict[str, Callable[[Random, Path, Path], list[str]]] = {
    "judge": judge, "inspect": inspect, "run": run, "advise": advise, "verify": verify, "explain": explain,
    "truth": _scene_alone((0.3, ("--floor",)), (0.1, ("--csv", "-"))),
    "convert": lambda random, path, folder: random.choice((import_, export))(random, path, folder),
    "linearise": linearise, "history": history,
    "study": lambda random, path, folder: random.choice((study, sweep))(random, path, folder),
    "report": lambda random, path, folder: [str(random.choice((path, folder))), *maybe(
        random, (0.5, ("--format", random.choice(("paper", "csv", "junit")))))],
    "bisect": lambda random, path, folder: [str(path), "--versions", random.choice(("a..b", "3.1", "..", ""))]}


def drawn(command: str, seed: int, folder: Path) -> list[str]:
    """The words of a case, whose files are written to the folder."""
    random = Random(f"{command} {seed}")
    return [command, *COMMANDS[command](random, arm(random, folder), folder)]


def outcome(words: list[str], folder: Path, budget: float) -> SimpleNamespace:
    """Exit code and words of a command in a process of its own, None where `budget` s of its processor time ran out."""
    with open(folder / "said", "w+b") as said:
        child = os.fork()
        if child == 0:
            _run(words, folder, said.fileno(), budget)
        began, status = time.monotonic(), None
        while status is None:
            ended, code = os.waitpid(child, os.WNOHANG)
            if ended:
                status = code
            elif time.monotonic() - began > 30 + 6 * budget:
                os.kill(child, signal.SIGKILL)
            time.sleep(0.01)
        said.seek(0)
        text = said.read().decode("utf-8", "replace")
    late = os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
    return SimpleNamespace(code=None if late else os.waitstatus_to_exitcode(status), text=text)


def _run(words: list[str], folder: Path, said: int, budget: float) -> None:
    """In the child: the command, which ends the process."""
    code = 99
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(said, 1)
        os.dup2(said, 2)
        os.chdir(folder)
        os.environ["COLUMNS"] = "200"
        used = resource.getrusage(resource.RUSAGE_SELF)
        resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime + budget) + 1,) * 2)
        from crosscheck.cli.app import main

        sys.argv = ["crosscheck", *words]
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def wrong(result: SimpleNamespace) -> str:
    """What is internal in how a command ended; "" if nothing is."""
    if result.code is not None and (result.code < 0 or result.code not in (0, 1, 2, 3)):
        return f"exit code {result.code}: {result.text[-700:]}"
    lines = [line for line in result.text.splitlines() if OURS.search(line) and "own.py" not in line]
    return lines[0][:700] if lines else ""


def case(command: str, seed: int, budget: float) -> tuple[list[str], SimpleNamespace]:
    with tempfile.TemporaryDirectory(prefix="arm-") as name:
        words = drawn(command, seed, Path(name))
        return words, outcome(words, Path(name), budget)


def seeds() -> list[tuple[str, int]]:
    """Command and seed of the cases that once ended in an internal error."""
    lines = (line.partition("#")[0].split() for line in SEEDS.read_text(encoding="utf-8").splitlines())
    return [(words[0], int(words[1])) for words in lines if words]


def main() -> None:
    reads = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reads.add_argument("number", type=int, help="of draws of each command")
    reads.add_argument("--first", type=int, default=0, help="seed of the first draw")
    reads.add_argument("--budget", type=float, default=5.0, help="s of processor time of each")
    reads.add_argument("--only", default=",".join(MAIN), help="commands; all: every one")
    given = reads.parse_args()
    for name in ("runs", "engines", "models", "verify", "study", "history"):
        __import__(f"crosscheck.cli.{name}")
    for name in ("mujoco", "pinocchio", "exudyn", "scipy.optimize", "scipy.integrate", "crosscheck.recordings",
                 "crosscheck.scene.models.reading", "crosscheck.verification.solution", "crosscheck.diagnosis"):
        with contextlib.suppress(ImportError):
            __import__(name)
    models.apart = lambda function, task, path: function(task)  # each command has a process of its own already
    bad = 0
    for command in COMMANDS if given.only == "all" else given.only.split(","):
        ends: collections.Counter[object] = collections.Counter()
        for seed in range(given.first, given.first + given.number):
            words, result = case(command, seed, given.budget)
            ends["over budget" if result.code is None else result.code] += 1
            if trouble := wrong(result):
                bad += 1
                print(f"{command} {seed}  # {trouble}\n    {' '.join(words)}", flush=True)
        print(f"{command}: {dict(ends)}", flush=True)
    raise SystemExit(bool(bad))


if __name__ == "__main__":
    main()
