"""The support matrix is right: a supported scene runs and moves as it must."""

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.running import support
from crosscheck.running.support import Minimal, Support
from crosscheck.scene import mechanics
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.model import Scene

MODES = [(name, form) for name in ("lieeuler", "mujoco", "pinocchio", "exudyn") for form in adapters.get(name).forms]

# Over T = 1 ms the mean of the accelerations at both ends misses the mean acceleration by T^2/12 of its second
# derivative, here below 1e3 times the acceleration: 1e-4. First-order methods are off by half a step of its first
# derivative, below 30 times: 4e-3. A missing joint or force, or one of a wrong size, is off by more than that.
SMOOTH, FIRST_ORDER = 1e-4, 4e-3
CLOSED = 1e-6  # m: drift over four steps; MuJoCo's soft constraints are the loosest


def _cases(engine: str, form: str) -> list[tuple[Minimal, Support]]:
    entries = {(entry.kind, entry.item): entry for entry in support.matrix([engine]) if entry.form == form}
    return [(minimal, entries[minimal.kind, minimal.item]) for minimal in support.minimal_scenes()]


def _along_joints(scene: Scene, rates: np.ndarray) -> np.ndarray:
    """What is left of accelerations (6n,) without the part that constraint forces can give, M^-1 G^T f.

    MuJoCo's soft constraints settle with a time constant of two steps, half of T: their forces are not those of the
    scene yet. Whatever they are, they act along G^T only.
    """
    G = Constraints(scene).jacobian(scene.x0[None], scene.R0[None])[0]
    inverse = mechanics.inverse_mass(scene)
    forces = np.linalg.lstsq(G @ inverse @ G.T, G @ rates, rcond=1e-12)[0]
    return rates - inverse @ G.T @ forces


@pytest.mark.parametrize(("engine", "form"), MODES)
def test_supported_scenes_run_and_accelerate_as_they_must(engine: str, form: str) -> None:
    adapter = adapters.get(engine)
    wrong = []
    for minimal, entry in _cases(engine, form):
        if not entry.methods:
            continue
        orders = {method: adapter.documented_order(minimal.scene, support.spec(adapter, method, form)) or 9
                  for method in entry.methods}
        method = max(orders, key=orders.__getitem__)
        spec = support.spec(adapter, method, form)
        run = crosscheck.run(minimal.scene, engine, method, step=spec.step, rtol=spec.rtol, form=form, monitor=False)
        a, alpha, _ = mechanics.index1(minimal.scene, run.x, run.R, run.v, run.w)
        gaps = np.concatenate([np.diff(speed, axis=0)[0] / support.DURATION - rate.mean(axis=0)
                               for speed, rate in ((run.v, a), (run.w, alpha))], axis=1).ravel()
        if "softness" in run.stats:
            gaps = _along_joints(minimal.scene, gaps)
        gap = np.abs(gaps).max() / max(np.abs(a).max(), np.abs(alpha).max(), 1.0)  # a fixed body does not move
        closed = np.abs(Constraints(minimal.scene).position(run.x, run.R)).max(initial=0.0)
        bound = FIRST_ORDER if orders[method] == 1 else SMOOTH
        if not (gap < bound and closed < CLOSED):
            wrong.append((minimal.kind, minimal.item, method, gap, closed))
    assert not wrong


@pytest.mark.parametrize(("engine", "form"), MODES)
def test_what_is_not_supported_has_a_reason_and_raises_it(engine: str, form: str) -> None:
    for minimal, entry in _cases(engine, form):
        missing = set(adapters.methods(engine)) - set(entry.methods)
        assert bool(missing) == (entry.reason is not None)
        for method in missing:
            spec = support.spec(adapters.get(engine), method, form)
            with pytest.raises(crosscheck.Unsupported, match=r"\w+ \w+"):
                crosscheck.run(minimal.scene, engine, method, step=spec.step, rtol=spec.rtol, form=form)


def test_every_joint_and_force_of_the_scene_format_is_asked_for() -> None:
    scenes = support.minimal_scenes()
    between = [kind for kind in support.JOINTS if not JOINT_TYPES[kind].slips]  # what rolls does so on the ground
    for kind, items in (("joint to the ground", list(support.JOINTS)), ("joint between bodies", between)):
        assert [minimal.item for minimal in scenes if minimal.kind == kind] == items
    assert {force.type for minimal in scenes for force in minimal.scene.forces} == set(support.FORCES)


def test_pinocchio_and_lieeuler_model_everything() -> None:
    """Composite joints and cut bodies omit nothing, except rows of velocities alone in Pinocchio."""
    for entry in support.matrix(["lieeuler", "pinocchio"]):
        if entry.engine == "pinocchio" and entry.item in JOINT_TYPES and JOINT_TYPES[entry.item].slips:
            assert "velocities alone" in entry.reason
        else:
            assert entry.reason is None, entry
