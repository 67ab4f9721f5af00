"""The support matrix says what is so: what it calls supported runs and moves as the scene must."""

import numpy as np
import pytest

import crosscheck
from crosscheck import engines, mechanics, support
from crosscheck.constraints import Constraints
from crosscheck.support import Minimal, Support

MODES = [(name, form) for name in ("lieeuler", "mujoco", "pinocchio", "exudyn") for form in engines.get(name).forms]

# Over T = 1 ms the mean of the accelerations at both ends misses the mean acceleration by T^2/12 of its second
# derivative, here below 1e3 times the acceleration: 1e-4. First-order methods are off by half a step of its first
# derivative, below 30 times: 4e-3. A missing joint or force, or one of a wrong size, is off by more than that.
SMOOTH, FIRST_ORDER = 1e-4, 4e-3
# MuJoCo's soft constraints settle with a time constant of two steps, half of T; until then they miss what the motion
# adds to a constraint's acceleration, here some hundredths of the whole. A missing force is a tenth and more.
SOFT = 5e-2
CLOSED = 1e-6  # m: drift over four steps; MuJoCo's soft constraints are the loosest


def _cases(engine: str, form: str) -> list[tuple[Minimal, Support]]:
    entries = {(entry.kind, entry.item): entry for entry in support.matrix([engine]) if entry.form == form}
    return [(minimal, entries[minimal.kind, minimal.item]) for minimal in support.minimal_scenes()]


@pytest.mark.parametrize(("engine", "form"), MODES)
def test_supported_scenes_run_and_accelerate_as_they_must(engine: str, form: str) -> None:
    adapter = engines.get(engine)
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
        gaps = [np.abs(np.diff(speed, axis=0)[0] / support.DURATION - rate.mean(axis=0)).max()
                for speed, rate in ((run.v, a), (run.w, alpha))]
        gap = max(gaps) / max(np.abs(a).max(), np.abs(alpha).max(), 1.0)  # a body fixed to the ground does not move
        closed = np.abs(Constraints(minimal.scene).position(run.x, run.R)).max(initial=0.0)
        bound = SOFT if "softness" in run.stats else FIRST_ORDER if orders[method] == 1 else SMOOTH
        if not (gap < bound and closed < CLOSED):
            wrong.append((minimal.kind, minimal.item, method, gap, closed))
    assert not wrong


@pytest.mark.parametrize(("engine", "form"), MODES)
def test_what_is_not_supported_has_a_reason_and_raises_it(engine: str, form: str) -> None:
    for minimal, entry in _cases(engine, form):
        missing = set(engines.methods(engine)) - set(entry.methods)
        assert bool(missing) == (entry.reason is not None)
        for method in missing:
            spec = support.spec(engines.get(engine), method, form)
            with pytest.raises(crosscheck.Unsupported, match=r"\w+ \w+"):
                crosscheck.run(minimal.scene, engine, method, step=spec.step, rtol=spec.rtol, form=form)


def test_every_joint_and_force_of_the_scene_format_is_asked_for() -> None:
    scenes = support.minimal_scenes()
    for kind in ("joint to the ground", "joint between bodies"):
        assert [minimal.item for minimal in scenes if minimal.kind == kind] == list(support.JOINTS)
    assert {force.type for minimal in scenes for force in minimal.scene.forces} == set(support.FORCES)


def test_pinocchio_and_lieeuler_model_everything() -> None:
    """Composite joints and cut bodies leave nothing out."""
    for entry in support.matrix(["lieeuler", "pinocchio"]):
        assert entry.reason is None, entry
