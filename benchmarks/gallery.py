"""Models that others wrote: which become scenes, which do not and why, and whether they move as in engines themselves.

    python -m benchmarks.gallery FOLDER ... [--run]

FOLDER: a file, or searched for .xml and .urdf, say the site-packages of an environment with gymnasium, dm_control and
example-robot-data. With --run every scene is integrated for a second from a seeded state, under `taylor` (the truth
takes its place where lieeuler lacks an element), beside what the engines make of the file that they load themselves:

- MuJoCo: RK4 at two steps, extrapolated; contacts, limits, friction, controls and the medium off, and without what
  `left_out` says that the scene has not.
- Pinocchio, of a URDF: `aba` in joint coordinates under SciPy's DOP853, with the torque of the dampers, which `aba`
  does not apply.
- A URDF is also written as MJCF and read again.

Two motions agree where |dx| (m) and |dR| stay within max(1e-9, 1e-13 x growth) at every output time; growth: of a
nudge of the start over the run.
"""

from __future__ import annotations

import argparse
import collections
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import crosscheck
from crosscheck.errors import CrosscheckError
from crosscheck.scene.coordinates import at_start
from crosscheck.scene.model import Scene
from crosscheck.scene.models import compiling, neutral, reading, second, source

DURATION, SAMPLES, STEPS = 1.0, 11, (2e-4, 1e-4, 5e-5, 2.5e-5)
NUDGE = 1e-8
KEPT_BY_MUJOCO = ("tendon", "equality", "flexible", "plugins", "nonlinear", "stiffness of joint", "mimic")
"""How what is left out of a scene begins where it stays in MuJoCo's model here."""

Motion = tuple[np.ndarray, np.ndarray]
"""x (T, n, 3), R (T, n, 3, 3) of the bodies of a scene."""


def main() -> None:
    """One line a model, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--run", action="store_true")
    parser.add_argument("--largest", type=int, default=24, help="bodies of a scene that truth is asked for")
    given = parser.parse_args()
    counts: collections.Counter[str] = collections.Counter()
    for path in sorted(path for folder in given.folders for path in (folder.rglob("*") if folder.is_dir() else [folder])
                       if path.suffix in (".xml", ".urdf")):
        head = path.read_text(errors="replace")[:5000]
        if "<mujoco" not in head and "<robot" not in head:
            continue
        label = "/".join(path.parts[-2:])
        try:
            scene = crosscheck.import_model(path, drop=True, duration=DURATION, samples=SAMPLES)
        except CrosscheckError as error:
            counts["refused"] += 1
            print(f"- {label}: {str(error).removeprefix(str(path) + ': ')}", flush=True)
            continue
        counts["imported"] += 1
        line = f"+ {label}: {scene.n} bodies"
        if given.run:
            line += "; " + "; ".join(_compared(path, given.largest, counts))
        print(line + (f"; left out: {'; '.join(scene.left_out)}" if scene.left_out else ""), flush=True)
    print(", ".join(f"{value} {key}" for key, value in counts.items()))


def _compared(path: Path, largest: int, counts: collections.Counter[str]) -> list[str]:
    """What the comparisons of one model found, in words; `counts` is added to."""
    import mujoco

    began = time.perf_counter()
    file = source.read(path)
    model = compiling.compiled(file)
    rng = np.random.default_rng(0)
    q, v = model.qpos0.copy(), 0.3 * rng.normal(size=model.nv)
    mujoco.mj_integratePos(model, q, 0.2 * rng.normal(size=model.nv), 1.0)
    reading.follow(file, model, q, v)
    try:
        scene = crosscheck.import_model(path, drop=True, qpos=q, qvel=v, duration=DURATION, samples=SAMPLES)
    except (CrosscheckError, ValueError) as error:
        return [f"not compared: {error}"]
    words, motion = _own(scene, largest, counts)
    if motion is not None:
        words.append("MuJoCo " + _beside_mujoco(path, scene, motion, q, v, counts))
        if path.suffix == ".urdf":
            words.append("Pinocchio " + _beside_pinocchio(path, scene, motion, counts))
            words.append(_through_mjcf(scene, motion, counts))
    return [*words, f"{time.perf_counter() - began:.1f} s"]


def _own(scene: Scene, largest: int, counts: collections.Counter[str]) -> tuple[list[str], Motion | None]:
    """The motion under `taylor`, or that of the truth, and what was said on the way."""
    words: list[str] = []
    found: Motion | None = None
    try:
        traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
        found = traj.x, traj.R
    except (CrosscheckError, ValueError) as error:
        words.append("taylor: " + str(error).rpartition(": ")[2])
    if scene.n > largest:
        return [*words, f"truth not asked for, {scene.n} bodies"], found
    try:
        reference = crosscheck.truth(scene)
    except (CrosscheckError, ValueError) as error:
        return [*words, f"no truth: {str(error)[:160]}"], found
    counts["truth"] += 1
    there = reference.states.x, reference.states.R
    if found is None:
        return [*words, f"truth to {reference.error:.1e}"], there
    gap = _gap(found, there)
    counts["taylor is the truth"] += gap <= 10 * reference.error
    return [*words, f"taylor against truth {gap:.1e} (truth to {reference.error:.1e})"], found


def _gap(one: Motion, other: Motion) -> float:
    return max(float(np.abs(a - b).max()) for a, b in zip(one, other, strict=True))


def _judged(engine: str, gap: float, own: float, growth: float, counts: collections.Counter[str]) -> str:
    """One comparison in words; `own` is what the engine's own integration is wrong by."""
    bound = max(1e-9, 1e-13 * growth)
    told = f"max |dx|, |dR| {gap:.1e}, allowed {bound:.1e} (growth {growth:.1e}, its own step error {own:.1e})"
    if gap > bound and own > bound:  # the extrapolated rollout is better than that, but not known to be
        counts[f"{engine} unresolved"] += 1
        return f"not judged: {told}"
    counts[f"{engine} compared"] += 1
    counts[f"{engine} agrees"] += gap <= bound
    return told + ("" if gap <= bound else " DIFFERS")


def _beside_mujoco(path: Path, scene: Scene, motion: Motion, q: np.ndarray, v: np.ndarray,
                   counts: collections.Counter[str]) -> str:
    import mujoco

    unlike = [words for words in scene.left_out if words.startswith(KEPT_BY_MUJOCO)
              and "which is part of" not in words]
    if unlike or len(scene.joints) > scene.n or any(joint.mimic is not None for joint in scene.joints):
        return f"not compared: {'; '.join(unlike) or 'its loops and mimics are soft'}"
    with compiling.listening():
        try:
            model = mujoco.MjModel.from_xml_path(str(path.resolve()))
            how = ""
        except Exception:  # a file that it cannot find, of a mesh or texture that no motion needs
            model, how = compiling.compiled(source.read(path)), " (its meshes are missing)"
        if model.nq != len(q):
            return "not compared: its model has other coordinates"
        _strip(model, scene)
        coarse = _rollout(model, scene, q, v, STEPS[0])
        side = NUDGE * np.random.default_rng(1).choice([-1.0, 1.0], size=model.nv)
        growth = _gap(_rollout(model, scene, q, v + side, STEPS[0]), coarse) / NUDGE
        for step in STEPS[1:]:
            fine = _rollout(model, scene, q, v, step)
            own = _gap(coarse, fine) / 15  # RK4 is of order 4
            native = tuple(b + (b - a) / 15 for a, b in zip(coarse, fine, strict=True))
            if own < 1e-10:
                break
            coarse = fine
    return _judged("MuJoCo", _gap(motion, (native[0], native[1])), own, growth, counts) + how


def _strip(model: Any, scene: Scene) -> None:
    """Switch off what a scene has not: contacts, limits, friction, controls, medium, springs of composite joints."""
    import mujoco

    off = mujoco.mjtDisableBit
    model.opt.disableflags |= (off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
                               | off.mjDSBL_ACTUATION)
    model.opt.density = model.opt.viscosity = 0.0
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    kept = {scene.bodies[joint.child].name for joint in scene.joints
            if joint.type in ("revolute", "prismatic", "cylindrical")}
    for dof in range(model.nv):
        if (model.body(model.dof_bodyid[dof]).name or f"body {model.dof_bodyid[dof]}") not in kept:
            model.dof_armature[dof] = model.dof_damping[dof] = 0.0
            model.jnt_stiffness[model.dof_jntid[dof]] = 0.0


def _rollout(model: Any, scene: Scene, q: np.ndarray, v: np.ndarray, h: float) -> Motion:
    import mujoco

    model.opt.timestep = h
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    x, R = np.empty((SAMPLES, scene.n, 3)), np.empty((SAMPLES, scene.n, 3, 3))
    for sample in range(SAMPLES):
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        found = {body.name: body for body in neutral.bodies(model, data).values()}
        for k, body in enumerate(scene.bodies):
            x[sample, k], R[sample, k] = found[body.name].centre, found[body.name].R
        mujoco.mj_step(model, data, nstep=round(DURATION / (SAMPLES - 1) / h))
    return x, R


def _beside_pinocchio(path: Path, scene: Scene, motion: Motion, counts: collections.Counter[str]) -> str:
    import pinocchio

    try:
        model = pinocchio.buildModelFromUrdf(str(path))
    except Exception as error:  # several kinds, of its own and of urdfdom
        return f"not compared: it refuses the file: {' '.join(str(error).split())[:120]}"
    joints = {joint.name: joint for joint in scene.joints}
    names = [model.names[joint] for joint in range(1, model.njoints)]
    if any(model.nvs[joint] != 1 for joint in range(1, model.njoints)) or any(
            joint.mimic is not None for joint in scene.joints):
        return "not compared: mimic joints, or joints of several coordinates"
    moving = second.links(model)
    if len(scene.joints) != model.nv or not joints.keys() >= set(names) or not moving.keys() >= {
            body.name for body in scene.bodies}:
        return "not compared: its model has other joints or links"
    damping = np.array([(joints[name].damping or (0.0,))[0] for name in names])
    found = at_start(scene)
    start, rates = (np.array([found[name][k][0] for name in names]) for k in (0, 1))
    links = [moving[body.name] for body in scene.bodies]
    fine = _integrated(model, links, damping, start, rates, 1e-13)
    own = _gap(fine, _integrated(model, links, damping, start, rates, 1e-12))
    nudged = _integrated(model, links, damping, start, rates + NUDGE, 1e-13)
    return _judged("Pinocchio", _gap(motion, fine), own, _gap(nudged, fine) / NUDGE, counts)


def _through_mjcf(scene: Scene, motion: Motion, counts: collections.Counter[str]) -> str:
    """The motion of the URDF written as MJCF and read again, in words."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        try:
            crosscheck.export_model(scene, path)
            again = crosscheck.import_model(path, keyframe="start", duration=DURATION, samples=SAMPLES)
            traj = crosscheck.run(again, "lieeuler", "taylor", rtol=1e-13)
        except (CrosscheckError, ValueError) as error:
            return f"not through MJCF: {error}"
    order = [[body.name for body in again.bodies].index(body.name) for body in scene.bodies]
    gap = _gap(motion, (traj.x[:, order], traj.R[:, order]))
    counts["MJCF and URDF are one motion"] += gap <= 1e-9
    return f"as MJCF {gap:.1e}"


def _integrated(model: Any, links: list[int], damping: np.ndarray, angles: np.ndarray, rates: np.ndarray,
                rtol: float) -> Motion:
    """The motion of the bodies on the joints `links` under `aba`, joint coordinates integrated by DOP853."""
    import pinocchio
    from scipy.integrate import solve_ivp

    data = model.createData()

    def coordinates(angles: np.ndarray) -> np.ndarray:
        q = np.empty(model.nq)
        for joint in range(1, model.njoints):
            at, angle = model.idx_qs[joint], angles[model.idx_vs[joint]]
            q[at:at + model.nqs[joint]] = [np.cos(angle), np.sin(angle)] if model.nqs[joint] == 2 else angle
        return q

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        angles, rates = np.split(y, 2)
        return np.concatenate([rates, pinocchio.aba(model, data, coordinates(angles), rates, -damping * rates)])

    t = np.linspace(0.0, DURATION, SAMPLES)
    solved = solve_ivp(slope, (0.0, DURATION), np.concatenate([angles, rates]), "DOP853", t, rtol=rtol, atol=rtol)
    x, R = np.empty((SAMPLES, len(links), 3)), np.empty((SAMPLES, len(links), 3, 3))
    for sample, y in enumerate(solved.y.T):
        pinocchio.forwardKinematics(model, data, coordinates(y[:model.nv]))
        for k, joint in enumerate(links):
            at = data.oMi[joint]
            x[sample, k], R[sample, k] = at.act(model.inertias[joint].lever), at.rotation
    return x, R


if __name__ == "__main__":
    main()
