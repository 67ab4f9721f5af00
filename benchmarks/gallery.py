"""Models that others wrote: which become scenes, which do not and why, and whether they move as in MuJoCo itself.

    python -m benchmarks.gallery FOLDER ... [--run]

FOLDER: searched for .xml and .urdf, for example the site-packages of an environment with gymnasium, dm_control and
example-robot-data. With --run, every scene that lieeuler has is run for a second under `taylor` beside a native rollout
of MuJoCo by RK4 at two steps, extrapolated, contacts, limits, friction and controls off, from a seeded state.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import crosscheck
from crosscheck.errors import CrosscheckError
from crosscheck.scene.models import compiling, source

DURATION, SAMPLES, STEP = 1.0, 11, 2e-4
ALIKE = ("limits of", "dry friction", "contacts of", "actuator")
"""What is left out of a scene and switched off in the native rollout as well."""


def main() -> None:
    """One line a model, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--run", action="store_true")
    given = parser.parse_args()
    counts = {"imported": 0, "refused": 0, "compared": 0, "agree": 0, "unresolved": 0}
    for path in sorted(path for folder in given.folders for path in folder.rglob("*")
                       if path.suffix in (".xml", ".urdf")):
        head = path.read_text(errors="replace")[:5000]
        if "<mujoco" not in head and "<robot" not in head:
            continue
        label = "/".join(path.parts[-2:])
        try:
            scene = crosscheck.import_model(path, drop=True, duration=DURATION, samples=SAMPLES)
        except CrosscheckError as error:
            counts["refused"] += 1
            print(f"- {label}: {str(error).removeprefix(str(path) + ': ')[:220]}", flush=True)
            continue
        counts["imported"] += 1
        line = f"+ {label}: {scene.n} bodies"
        if given.run:
            line += ", " + _compared(path, list(scene.left_out), counts)
        print(line + (f"; left out: {'; '.join(scene.left_out)}" if scene.left_out else ""), flush=True)
    print(", ".join(f"{value} {key}" for key, value in counts.items()))


def _compared(path: Path, left_out: list[str], counts: dict[str, int]) -> str:
    """The difference of the two motions in words; `counts` is added to."""
    if not all(words.startswith(ALIKE) for words in left_out):
        return "not compared: what is left out cannot be switched off in MuJoCo"
    import mujoco

    model = compiling.compiled(source.read(path))
    rng = np.random.default_rng(0)
    q = model.qpos0.copy()
    mujoco.mj_integratePos(model, q, 0.2 * rng.normal(size=model.nv), 1.0)
    v = 0.3 * rng.normal(size=model.nv)
    began = time.perf_counter()
    try:
        scene = crosscheck.import_model(path, drop=True, qpos=q, qvel=v, duration=DURATION, samples=SAMPLES)
        traj = crosscheck.run(scene, "lieeuler", "taylor", rtol=1e-13)
    except (CrosscheckError, ValueError) as error:
        return f"not compared: {str(error)[:120]}"
    names = [body.name for body in scene.bodies]
    coarse, fine = (_rollout(model, names, q, v, h) for h in (STEP, STEP / 2))
    nudge = 1e-8
    moved = _rollout(model, names, q, v + nudge * rng.choice([-1.0, 1.0], size=model.nv), STEP)
    growth = float(np.abs(moved - coarse).max()) / nudge
    native = fine + (fine - coarse) / 15  # RK4 is of order 4
    gap, bound = float(np.abs(traj.R - native).max()), max(1e-9, 1e-13 * growth)
    own = float(np.abs(fine - coarse).max()) / 15
    if own > bound:  # the extrapolated rollout is no better than a part of that
        counts["unresolved"] += 1
        return f"not judged: MuJoCo's own step error is {own:.1e}, max |dR| {gap:.1e}"
    counts["compared"] += 1
    counts["agree"] += gap <= bound
    return (f"max |dR| against native {gap:.1e}, allowed {bound:.1e} (growth {growth:.1e}; MuJoCo's own step error "
            f"{own:.1e}){'' if gap <= bound else ' DIFFERS'}, "
            f"{time.perf_counter() - began:.1f} s")


def _rollout(model: Any, names: list[str], q: np.ndarray, v: np.ndarray, h: float) -> np.ndarray:
    import mujoco

    off = mujoco.mjtDisableBit
    model.opt.disableflags |= (off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
                               | off.mjDSBL_ACTUATION)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, h
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    bodies = [model.body(name).id if not name.startswith("body ") else int(name.split()[1])
              for name in names]
    found = np.empty((SAMPLES, len(names), 3, 3))
    with compiling.listening():
        for sample in range(SAMPLES):
            mujoco.mj_kinematics(model, data)
            found[sample] = data.xmat[bodies].reshape(-1, 3, 3)
            mujoco.mj_step(model, data, nstep=round(DURATION / (SAMPLES - 1) / h))
    return found


if __name__ == "__main__":
    main()
