"""Writes a script that needs an engine and NumPy alone and prints the error of the engine against independent truth."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from crosscheck.adapters.mujoco.models import INTEGRATORS, SOLVER_TOLERANCE, TIGHT
from crosscheck.compare.sizes import sizes
from crosscheck.document import QUANTITIES
from crosscheck.errors import ArgumentError, Unsupported, unknown
from crosscheck.running.run import truth
from crosscheck.scene.file import as_scene
from crosscheck.scene.model import Scene
from crosscheck.scene.models import import_model, is_model, source
from crosscheck.scene.models.words import shortened
from crosscheck.scene.models.writing import mjcf

ENGINES = ("mujoco",)
"""Engines with an integrator and a file format of their own, in which a script can hold the model."""

MOST_INTERVALS, MOST_NUMBERS, HALVINGS = 20, 3000, 3
"""Largest number of compared times after the start, and of numbers in all of them, so that a tracker of issues takes
the script; and how often it halves the step."""

NUMBERS = 18
"""Of a body at one time: position, rotation matrix, velocity, angular velocity."""

OFF = ("CONTACT", "AUTORESET")
OFF_IN_MODELS = ("LIMIT", "FRICTIONLOSS", "ACTUATION")
"""What is switched off in MuJoCo, and what besides in a model file of which the scene has left something out."""

SCRIPT = '''"""{title}

    python THIS_FILE [STEP]

prints the largest error of {bodies} at {times} times, each quantity over its size, for STEP and its halvings, with the
observed order. It needs mujoco and numpy. Expected: {source}.{without}
Written by crosscheck run --script.
"""

import sys

import mujoco
import numpy as np

MODEL = {model}
INTEGRATOR, STEP = {integrator!r}, {step!r}
KEYFRAME, QPOS, QVEL = {keyframe!r}, {qpos!r}, {qvel!r}
OFF = {off!r}
BODIES = {names!r}
TIMES = np.linspace(0.0, {end!r}, {times})
SIZES = {sizes!r}  # m, rad, m/s, rad/s
UNITS = dict(zip(SIZES, ("m", "rad", "m/s", "rad/s")))
# Of the mass centre and the axes of a body: position (m), rotation matrix, velocity (m/s), all in the world,
# and angular velocity (rad/s) in the body.
EXPECTED = np.array({expected}).reshape(len(TIMES), len(BODIES), 18)


def motion(step, nudge=0.0):
    """States (times, bodies, 18) as EXPECTED; bodies that are welded together are one. A nudge lengthens the step."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    model.opt.integrator = getattr(mujoco.mjtIntegrator, INTEGRATOR)
    for flag in OFF:
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, "mjDSBL_" + flag, 0))
    steps = int(np.ceil((TIMES[1] - TIMES[0]) / step * (1 - 1e-9)))
    model.opt.timestep = (TIMES[1] - TIMES[0]) / steps
    model.opt.timestep *= 1 + nudge
    model.opt.tolerance = {tolerance!r}
    model.eq_solref[:] = 2 * model.opt.timestep, 1.0  # the stiffest constraints that MuJoCo allows
    model.eq_solimp[:, :2] = {tight!r}
    data = mujoco.MjData(model)
    if KEYFRAME is not None:
        mujoco.mj_resetDataKeyframe(model, data, model.key(KEYFRAME).id)
    data.qpos[:] = data.qpos if QPOS is None else QPOS
    data.qvel[:] = data.qvel if QVEL is None else QVEL
    seen = []
    for k in range(len(TIMES)):
        if k:
            mujoco.mj_step(model, data, nstep=steps)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        for name in BODIES:
            own = model.body(name).id
            group = np.flatnonzero(model.body_weldid == model.body_weldid[own])
            centre = model.body_mass[group] @ data.xipos[group] / model.body_mass[group].sum()
            R, turning, moving = data.xmat[own].reshape(3, 3), data.cvel[own, :3], data.cvel[own, 3:]
            arm = centre - data.subtree_com[model.body_rootid[own]]
            seen.append(np.hstack([centre, R.ravel(), moving + np.cross(turning, arm), R.T @ turning]))
    return np.reshape(seen, EXPECTED.shape)


def errors(states):
    """Errors (times, bodies) by quantity, in SI."""
    (x, R, v, w), (y, S, u, o) = (np.split(each, (3, 12, 15), axis=-1) for each in (states, EXPECTED))
    D = np.swapaxes(R.reshape(*R.shape[:2], 3, 3), -1, -2) @ S.reshape(*S.shape[:2], 3, 3)
    twice_sine = np.linalg.norm([D[..., k - 1, k - 2] - D[..., k - 2, k - 1] for k in range(3)], axis=0)
    angle = np.arctan2(twice_sine, np.trace(D, axis1=-2, axis2=-1) - 1)
    return dict(zip(SIZES, (np.linalg.norm(x - y, axis=-1), angle, np.linalg.norm(v - u, axis=-1),
                            np.linalg.norm(w - o, axis=-1))))


def worst(states):
    """(largest error over its size, the same in words)."""
    found = {{name: np.where(np.isfinite(each), each, np.inf) for name, each in errors(states).items()}}
    name = max(found, key=lambda each: found[each].max() / SIZES[each])
    error = found[name].max()
    k, body = np.unravel_index(np.argmax(found[name]), found[name].shape)
    return error / SIZES[name], f"{{name}} {{error:.3e}} {{UNITS[name]}} of {{BODIES[body]}} at t = {{TIMES[k]:g}} s"


def main():
    step, before = float(sys.argv[1]) if len(sys.argv) > 1 else STEP, None
    for halving in range({halvings} + 1):
        error, where = worst(motion(step / 2**halving))
        order = "" if before is None else f"; order {{np.log2(before / error):.2f}}"
        print(f"mujoco {{mujoco.__version__}} {{INTEGRATOR}}, step {{step / 2**halving:g}} s: "
              f"error {{error:.3e}} of its size: {{where}}{{order}}")
        before = error


if __name__ == "__main__":
    main()
'''


@dataclasses.dataclass(frozen=True)
class Reproduction:
    """A script, and what it is to show."""

    text: str
    scene: Scene
    title: str
    source: str  # of the expected motion
    step: float  # s
    expected: np.ndarray  # (times, bodies, 18), as `motion` of the script
    sizes: dict[str, float]  # of the quantities
    left_out: tuple[str, ...] = ()  # of the model, both in the script and in what it expects


def reproduce(scene: Scene | str | os.PathLike[str], engine: str, method: str, step: float,
              duration: float | None = None, keyframe: str | None = None, qpos: Sequence[float] | None = None,
              qvel: Sequence[float] | None = None) -> Reproduction:
    """The script for one way of one engine; a model file is kept as it is, so that the engine's own reader counts.

    `keyframe`, `qpos` and `qvel` are those of `crosscheck.import_model`, of a model file.

    Raises
    ------
    ArgumentError, SceneError, Unsupported
        An argument is wrong, the scene cannot be read, or no script can hold it.
    """
    name = engine.partition("==")[0]
    if name not in ENGINES:
        raise ArgumentError(f"engine: {engine!r}: scripts are written for {', '.join(ENGINES)}; other engines have no "
                            "integrator or no model format of their own, crosscheck convert writes one for Exudyn")
    if method not in INTEGRATORS:
        raise ArgumentError(unknown("method", method, tuple(INTEGRATORS)))
    if not step > 0:
        raise ArgumentError(f"step: {step} s; it is above 0")
    native = not isinstance(scene, Scene) and is_model(scene)
    start: dict[str, Any] = {"keyframe": keyframe, "qpos": qpos, "qvel": qvel}
    if not native and any(each is not None for each in start.values()):
        raise ArgumentError("start: keyframe, qpos and qvel go with a model file, .xml or .urdf; a scene has its start")
    held = as_scene(scene) if isinstance(scene, Scene) or not native else import_model(
        scene, drop=True, limits="drop", contacts="drop", **start)
    if duration is not None:
        held = held.replace(duration=duration)
    if held.timed and not native:
        raise Unsupported(f"{held.name}: a script holds no function of time")
    if not isinstance(scene, Scene) and native:
        model = _native(scene)
    else:
        ElementTree.indent(root := mjcf(held))
        model = ElementTree.tostring(root, encoding="unicode")
    reference = truth(held)
    most = max(1, min(MOST_INTERVALS, MOST_NUMBERS // (NUMBERS * held.n) - 1))
    intervals = next(count for count in range(most, 0, -1) if (held.samples - 1) % count == 0)
    every = (held.samples - 1) // intervals
    states = reference.states
    expected = np.concatenate([part[::every].reshape(intervals + 1, held.n, -1)
                               for part in (states.x, states.R, states.v, states.w)], axis=-1)
    size = {name: value for name, value in sizes(held, states).items() if name in QUANTITIES}
    where = " and ".join(held.bodies[k].name for k in range(held.n)) if held.n < 3 else f"{held.n} bodies"
    title = f"{held.name} in MuJoCo, {method}, step {step:g} s"
    origin = f"independent truth of crosscheck ({reference.source}), known to {reference.error:.1e} m"
    left_out = tuple(shortened(held.left_out))
    without = "".join(f"\nWithout {_words(each)}." for each in left_out)
    return Reproduction(SCRIPT.format(
        title=_words(title), without=without, bodies=_words(where), times=intervals + 1, source=origin,
        model=_raw(model),
        integrator=INTEGRATORS[method], step=step, keyframe=keyframe if native else "start",
        qpos=qpos, qvel=qvel,
        names=[body.name for body in held.bodies],
        off=(*OFF, *(OFF_IN_MODELS if held.left_out else ())), end=float(held.t[every * intervals]),
        expected=np.array2string(expected.ravel(), separator=", ", threshold=10**9, max_line_width=118,
                                 formatter={"float_kind": lambda value: repr(float(value))}),
        tolerance=SOLVER_TOLERANCE, tight=TIGHT, halvings=HALVINGS, sizes=size),
        held, title, origin, step, expected, size, left_out)


def _words(text: str) -> str:
    """A text within a docstring, which none of its letters ends."""
    return text.replace("\\", "/").replace('"', "'")


def _raw(text: str) -> str:
    """A text as Python writes it, with its lines where none of its letters ends it."""
    return repr(text) if '"""' in text or text.endswith(('"', "\\")) else f'r"""{text}"""'


def _native(path: str | os.PathLike[str]) -> str:
    """The text of a model file without the shapes of its links, whose meshes no script can hold."""
    model = source.bare(Path(path))
    if not model.is_urdf and next(source.files(model), None) is not None:
        raise Unsupported(f"{model.path}: refers to other files, which a script cannot hold; give inertials and leave "
                          "the meshes out")
    return model.text
