"""Each adapter's model is the scene and nothing else; its states are in the common convention."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters
from crosscheck.adapters.base import RawRun, RunSpec
from crosscheck.adapters.exudyn import adapter as exudyn_adapter
from crosscheck.adapters.pinocchio import models
from crosscheck.errors import EngineError
from crosscheck.scene import mechanics
from crosscheck.scene.model import Scene
from crosscheck.scene.monitor import Monitor
from tests.adapters.scenes import full_inertia, mixed_tree, off_the_equations, off_the_start, relative

NAMES = ("single_pendulum", "double_pendulum", "heavy_top", "triple_pendulum")
TREE_MODES = [("mujoco", "Euler", "tree"), ("mujoco", "discrete", "tree"), ("pinocchio", "SymplecticEuler", "tree"),
              ("exudyn", "RK44", "tree")]
ALL_MODES = [*TREE_MODES, ("exudyn", "GeneralizedAlpha", "maximal"), ("exudyn", "TrapezoidalIndex2", "maximal")]

ROUNDING = 1e-13  # some hundred roundings of numbers of size 1, relative


def _with_full_inertia(scene: Scene) -> Scene:
    """The scene with inertias that have no zero, so that a swapped or dropped component shows."""
    return scene.replace(bodies=tuple(dataclasses.replace(body, inertia=full_inertia()) for body in scene.bodies))


def _short(scene: Scene, steps: int = 4) -> Scene:
    return scene.replace(duration=1e-3 * steps, samples=steps + 1)


def _raw(scene: Scene, engine: str, method: str, form: str, **options: object) -> RawRun:
    spec = RunSpec(method, step=1e-3, form=form, **options)
    adapter = adapters.get(engine)
    assert adapter.unsupported(scene, spec) is None
    return adapter.run(scene, spec)


@pytest.mark.parametrize("name", NAMES)
def test_pinocchio_model_is_the_scene_and_nothing_else(name: str) -> None:
    import pinocchio

    scene = _with_full_inertia(crosscheck.load_scene(name))
    own = models.build(scene)
    model = own.model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, *own.initial_state())
    for index in range(scene.n):
        joint = model.getJointId(str(index))
        inertia, placement = model.inertias[joint], data.oMi[joint]
        assert inertia.mass == scene.masses[index]
        assert relative(inertia.inertia, scene.inertias[index]) < ROUNDING  # about the centre of mass
        assert relative(placement.act(inertia.lever), scene.x0[index]) < ROUNDING
        assert relative(placement.rotation, scene.R0[index]) < ROUNDING
        spin = pinocchio.getVelocity(model, data, joint, pinocchio.ReferenceFrame.LOCAL)
        assert relative(spin.angular, scene.w0[index]) < ROUNDING
    assert model.gravity.linear.tolist() == scene.gravity.tolist()
    assert not np.any(model.gravity.angular)
    assert not np.any(model.armature)
    assert model.nbodies == scene.n + 1


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("engine", "method", "form"), ALL_MODES)
def test_initial_state_round_trip(name: str, engine: str, method: str, form: str) -> None:
    scene = _short(crosscheck.load_scene(name))
    states = _raw(scene, engine, method, form).states
    assert states.t.tolist() == scene.t.tolist()
    assert all(getattr(states, name).shape[:2] == (scene.samples, scene.n) for name in "xRvw")
    assert off_the_start(scene, states) < ROUNDING


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("engine", "method", "form"), TREE_MODES)
def test_accelerations_are_those_of_the_scene(name: str, engine: str, method: str, form: str) -> None:
    """At every sample the engine's own accelerations solve the equations of motion at the engine's own state."""
    scene = _short(_with_full_inertia(crosscheck.load_scene(name)))
    states = _raw(scene, engine, method, form).states
    first = 1 if engine == "exudyn" else 0  # Exudyn's explicit solvers give none at the start
    assert np.isnan(states.a[:first]).all()
    # 1e-10: conditioning of two different eliminations of the same system
    assert off_the_equations(scene, states, first) < 1e-10


@pytest.mark.parametrize("name", ["single_pendulum", "heavy_top"])
def test_pivot_accelerations_are_those_of_the_scene(name: str) -> None:
    scene = _short(_with_full_inertia(crosscheck.load_scene(name)))
    states = _raw(scene, "exudyn", "RK44", "pivot").states
    assert off_the_equations(scene, states, 1) < 1e-10  # as above


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("method", ["GeneralizedAlpha", "TrapezoidalIndex2"])
def test_maximal_initial_accelerations_are_those_of_the_scene(name: str, method: str) -> None:
    moving = _short(_with_full_inertia(crosscheck.load_scene(name)))
    resting = moving.replace(bodies=tuple(
        dataclasses.replace(body, velocity=np.zeros(3), angular_velocity=np.zeros(3)) for body in moving.bodies))
    # moving: Exudyn takes the velocity-dependent part from one-sided differences of relative size 1e-7
    for scene, bound in ((resting, 1e-10), (moving, 1e-6)):
        states = _raw(scene, "exudyn", method, "maximal").states
        a, alpha, _ = mechanics.index1(scene, scene.x0[None], scene.R0[None], scene.v0[None], scene.w0[None])
        assert relative(states.a[:1], a) < bound
        assert relative(states.alpha[:1], alpha) < bound


@pytest.mark.parametrize(("engine", "method"), [("mujoco", "RK4"), ("pinocchio", "RKMK4")])
def test_hinges_and_sliders(engine: str, method: str) -> None:
    scene = _short(mixed_tree())
    states = _raw(scene, engine, method, "tree").states
    assert relative(states.x[0], scene.x0) < ROUNDING
    assert off_the_equations(scene, states) < 1e-10  # as above


def test_mujoco_fixed_joint() -> None:
    """The lower body of the double pendulum welded to the upper one."""
    scene = crosscheck.load_scene("double_pendulum")
    upper, lower = (_with_full_inertia(scene)).bodies
    weld = dataclasses.replace(scene.joints[1], type="fixed")
    arm = weld.parent_anchor - weld.child_anchor
    lower = dataclasses.replace(
        lower, attitude=upper.attitude, angular_velocity=upper.angular_velocity,
        position=upper.position + scene.R0[0] @ arm,
        velocity=upper.velocity + scene.R0[0] @ np.cross(upper.angular_velocity, arm))
    welded = _short(scene.replace(bodies=(upper, lower), joints=(scene.joints[0], weld)))
    states = _raw(welded, "mujoco", "RK4", "tree").states
    assert off_the_equations(welded, states) < 1e-10  # as above
    assert relative(states.x[:, 1] - states.x[:, 0], states.R[:, 0] @ arm) < ROUNDING


def test_two_engines_agree_on_hinges_and_sliders() -> None:
    scene = mixed_tree()
    first = crosscheck.run(scene, "mujoco", "RK4", step=1e-3, monitor=False)
    second = crosscheck.run(scene, "pinocchio", "RKMK8", step=1e-2, monitor=False)
    finer = crosscheck.run(scene, "mujoco", "RK4", step=5e-4, monitor=False)
    # the error of an order-4 run is 16/15 of the change when its step is halved; twice that covers the higher terms
    assert np.abs(first.x - second.x).max() < 2 * np.abs(first.x - finer.x).max()


@pytest.mark.parametrize(("engine", "method", "form"), ALL_MODES)
def test_monitor_sees_every_step(engine: str, method: str, form: str) -> None:
    """Maxima with two samples equal those of a run that samples every step; states do not depend on monitoring."""
    scene = crosscheck.load_scene("double_pendulum").replace(duration=0.5, samples=2)
    seldom = _raw(scene, engine, method, form)
    unwatched = _raw(scene, engine, method, form, monitor=False)
    always = crosscheck.run(scene, engine, method, step=1e-3, form=form, samples=501)
    kinetic = mechanics.kinetic_energy(scene, always).max()
    assert seldom.steps == always.steps == 500
    assert unwatched.maxima is None
    assert np.abs(unwatched.states.x - seldom.states.x).max() < ROUNDING
    assert seldom.maxima["energy_error"] == pytest.approx(np.abs(always.energy - always.energy[0]).max() / kinetic,
                                                          rel=1e-9, abs=ROUNDING)  # sums in another order
    if "constraint_acceleration" in always.stats:
        assert seldom.maxima["constraint_acceleration"] == pytest.approx(
            always.stats["constraint_acceleration"], rel=1e-9, abs=ROUNDING)
    velocity = always.constraint_velocity.max()
    assert seldom.maxima["constraint_velocity"] == pytest.approx(velocity, rel=1e-9, abs=ROUNDING)


@pytest.mark.parametrize(("engine", "method"), [("mujoco", "RK4"), ("pinocchio", "RKMK4")])
def test_accelerations_of_every_step_are_watched(engine: str, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The monitor sees each step's acceleration, at that step's state; unmonitored runs evaluate the samples only."""
    seen = []
    update = Monitor.update

    def spy(self: Monitor, *states: np.ndarray) -> np.ndarray:
        seen.append(states)
        return update(self, *states)

    monkeypatch.setattr(Monitor, "update", spy)
    scene = crosscheck.load_scene("double_pendulum").replace(duration=0.5, samples=2)
    found = crosscheck.run(scene, engine, method, step=1e-2)
    x, R, v, w, a, alpha = (np.concatenate([states[k] for states in seen]) for k in range(6))
    assert len(a) == found.steps + 1  # the start too
    wanted = mechanics.index1(scene, x, R, v, w)
    assert relative(a, wanted[0]) < 1e-10  # conditioning of two different eliminations of the same system
    assert relative(alpha, wanted[1]) < 1e-10


def test_held_levels_are_held() -> None:
    scene = crosscheck.load_scene("double_pendulum")
    # rounding levels of the issue over 10 s
    bounds = {"position": 1e-12, "velocity": 1e-11, "acceleration": 1e-9}
    for name in ("mujoco", "pinocchio", "exudyn"):
        adapter = adapters.get(name)
        for method in adapter.methods:
            run = crosscheck.run(scene, name, method, step=1e-2)
            held = adapter.held_levels(scene, RunSpec(method))
            for level, bound in bounds.items():
                assert (run.stats[f"constraint_{level}"] < bound) == (level in held), (name, method, level)


def test_cardan_order_stays_clear_of_gimbal_lock() -> None:
    runs = {name: _raw(crosscheck.load_scene(name), "exudyn", "RK44", "tree") for name in NAMES}
    chosen = {name: run.stats["cardan_order"] for name, run in runs.items()}
    assert chosen["heavy_top"] == "XZY"  # there the angles XYZ pass within 2 degrees of gimbal lock
    assert {chosen[name] for name in NAMES if name != "heavy_top"} == {"XYZ"}
    assert all(run.stats["gimbal_clearance"] > exudyn_adapter.CLEARANCE for run in runs.values())


@pytest.mark.parametrize(("engine", "method", "step", "words"), [
    ("mujoco", "RK4", 0.5, "MuJoCo warned|diverged"), ("pinocchio", "RK4naive", 0.1, "diverged"),
    ("exudyn", "RK44", 0.1, "diverged|stopped"),
])
def test_explicit_divergence_is_an_engine_error(engine: str, method: str, step: float, words: str) -> None:
    """At 150 rad/s the top turns by many radians in such a step, far outside any explicit method's stability."""
    scene = crosscheck.load_scene("heavy_top").replace(duration=200.0, samples=3)
    with pytest.raises(EngineError, match=words):
        crosscheck.run(scene, engine, method, step=step, monitor=False)


@pytest.mark.parametrize("monitor", [True, False])
def test_mujoco_warning_is_told_and_leaves_no_log_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
                                                       monitor: bool) -> None:
    monkeypatch.chdir(tmp_path)
    scene = crosscheck.load_scene("heavy_top").replace(duration=200.0, samples=3)
    with pytest.raises(EngineError, match=r"MuJoCo warned: Nan, Inf or huge value in QVEL .* Try a smaller step"):
        crosscheck.run(scene, "mujoco", "RK4", step=0.5, monitor=monitor)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("method", ["RKMK4", "RKMK8"])
def test_infinite_rotation_vectors_are_told_as_divergence(method: str) -> None:
    with pytest.raises(EngineError, match=f"{method} diverged"):
        crosscheck.run("stiff_damped", "pinocchio", method, step=0.1, monitor=False)


def test_newton_failure_carries_the_engine_words() -> None:
    with pytest.raises(EngineError, match=r"Exudyn GeneralizedAlpha stopped at t = .* s: .*minimum step size"):
        crosscheck.run(crosscheck.load_scene("heavy_top"), "exudyn", "GeneralizedAlpha", step=5e-3)


def test_newton_tolerance_yields_to_rounding_near_rest() -> None:
    """At rest the residual is small from the start and cannot drop by 1e-13; the run tells which tolerance it took."""
    moving = crosscheck.load_scene("double_pendulum")
    resting = moving.replace(bodies=tuple(
        dataclasses.replace(body, velocity=np.zeros(3), angular_velocity=np.zeros(3)) for body in moving.bodies))
    tolerances = [_raw(scene.replace(duration=4e-4, samples=5), "exudyn", "GeneralizedAlpha", "maximal")
                  .stats["newton_tolerance"] for scene in (moving, resting)]
    assert tolerances[0] == exudyn_adapter.NEWTON_TOLERANCES[0] < tolerances[1]


def test_unsupported_reasons() -> None:
    scene = crosscheck.load_scene("double_pendulum")
    cases = [
        ("mujoco", "RK4", "pivot", scene, "form pivot"),
        ("pinocchio", "RKMK4", "pivot", scene, "form pivot"),
        ("exudyn", "RK44", "pivot", scene, "one body"), ("exudyn", "RK44", "maximal", scene, "explicit"),
    ]
    for engine, method, form, odd, words in cases:
        reason = adapters.get(engine).unsupported(odd, RunSpec(method, step=1e-2, form=form))
        assert reason is not None, (engine, method, form)
        assert words in reason


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio", "exudyn"])
def test_version_is_the_pinned_one(engine: str) -> None:
    pinned = {"mujoco": "4.0.", "pinocchio": "4.1.", "exudyn": "1.13."}
    assert adapters.get(engine).version().startswith(pinned[engine])
