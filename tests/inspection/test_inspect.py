"""The static cross-check passes what is right, and names the quantity and the body of what is not."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

import crosscheck
from crosscheck.adapters import get
from crosscheck.adapters.base import Engine
from crosscheck.cli import app
from crosscheck.inspection import Inspection, Probe, admissible, inspect, probe
from crosscheck.inspection.base import LOOSEST, QUANTITIES
from crosscheck.inspection.reference import deviations, reference
from crosscheck.running.support import minimal_scenes
from crosscheck.scene.constraints import Constraints
from crosscheck.scene.file import scene_names
from crosscheck.scene.laws import DryFriction
from crosscheck.scene.model import Scene
from crosscheck.scene.states import States
from tests.adapters.test_laws import arm

ENGINES = ("lieeuler", "mujoco", "pinocchio", "exudyn")
SMALL = ("branching_tree", "slider_crank", "loaded_pendulum", "prismatic_slider", "torsion_wheel", "bricard")


def _body(scene: Scene, index: int, **changes: object) -> Scene:
    return scene.replace(bodies=tuple(dataclasses.replace(body, **changes) if k == index else body
                                      for k, body in enumerate(scene.bodies)))


def _force(scene: Scene, **changes: object) -> Scene:
    return scene.replace(forces=tuple(dataclasses.replace(force, parameters={**force.parameters, **changes})
                                      for force in scene.forces))


class MisBuilt(Engine):
    """MuJoCo on another scene than the one it is given, in the states of the one it is given."""

    name, methods, forms = "misbuilt", ("RK4",), ("tree",)

    def __init__(self, change: object) -> None:
        self._change = change

    def unsupported(self, scene: Scene, spec: object) -> str | None:
        return None

    def probe(self, scene: Scene, states: States, form: str | None = None) -> Probe:
        found = probe(get("mujoco"), self._change(scene), states, form)
        return dataclasses.replace(found, engine=self.name)


@pytest.mark.parametrize("name", SMALL)
def test_all_engines_agree_with_truth(name: str) -> None:
    found = inspect(crosscheck.load_scene(name), ENGINES)
    assert found.agree, "; ".join(map(str, found.offenders))
    assert {one.engine for one in found.probes} == set(ENGINES)


@pytest.mark.parametrize("name", sorted(set(scene_names()) - set(SMALL)))
def test_all_engines_agree_with_truth_on_every_scene(name: str) -> None:
    found = inspect(crosscheck.load_scene(name), ENGINES)
    assert found.agree, "; ".join(map(str, found.offenders))


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_every_joint_and_force(engine: str) -> None:
    for minimal in minimal_scenes():
        found = inspect(minimal.scene, [engine], count=0)
        assert found.agree, f"{minimal.kind} {minimal.item}: {found.offenders[0]}"
        assert bool(found.probes) != minimal.item.startswith(("knife", "rolling"))  # which these engines refuse


@pytest.mark.parametrize("name", ["driven_cart", "driven_slider_crank", "geared_arm", "coupled_arm"])
def test_driven_and_geared_scenes_agree_with_truth(name: str) -> None:
    found = inspect(crosscheck.load_scene(name), ENGINES)
    assert found.agree, "; ".join(map(str, found.offenders))
    assert found.probes
    assert not any("Error" in reason for reason in found.skipped.values()), found.skipped


@pytest.mark.parametrize(("most", "telling"), [(0.3, ["lieeuler", "mujoco"]), (3.0, ["lieeuler"]), (
    20.0, ["lieeuler"])], ids=["both slip", "one is held", "both are held"])
def test_friction_at_rest_is_truth_and_laws_of_an_engines_own_are_not_compared(most: float, telling: list) -> None:
    """At rest MuJoCo's soft friction, Pinocchio's rows of a step and Exudyn's bristles are none of the state alone."""
    moving = arm(upper={"dry_friction": most}, lower={"dry_friction": most})
    still = moving.replace(bodies=tuple(dataclasses.replace(body, velocity=np.zeros(3), angular_velocity=np.zeros(3))
                                        for body in moving.bodies))
    found = inspect(still, count=0)
    assert found.agree
    assert [each.engine for each in found.probes if each.a is not None] == telling
    assert (np.abs(found.truth.a).max() < 1e-12) == (most == 20.0)
    assert inspect(moving, ["lieeuler", "mujoco", "exudyn"]).agree
    less = still.replace(joints=tuple(dataclasses.replace(joint, dry_friction=(DryFriction(most / 2, most / 2),))
                                      for joint in still.joints))
    wrong = deviations(still, reference(still, found.states), probe(get("lieeuler"), less, found.states))
    assert any(each.quantity == "acceleration" and each.relative > 1e-3 for each in wrong) == (most != 20.0)


def test_a_probe_tells_what_it_can_and_why_not_the_rest() -> None:
    for name in ("prismatic_slider", "damped_pendulum"):
        found = inspect(crosscheck.load_scene(name), ENGINES, count=0)
        assert len(found.probes) >= 6
        for one in found.probes:
            _check_notes(found, one)


def _check_notes(found: Inspection, one: Probe) -> None:
    told = {deviation.quantity for deviation in found.of(one.engine, one.form)}
    assert not told & set(one.notes)
    # the applied force has no common meaning in joint coordinates, nor where a body is cut; lieeuler keeps its own
    assert told | set(one.notes) | {"applied force"} == set(QUANTITIES), one.label


@pytest.mark.parametrize(("name", "change", "quantity", "place"), [
    ("double_pendulum", lambda s: _body(s, 1, mass=1.001), "mass", "lower"),
    ("double_pendulum", lambda s: _body(s, 0, inertia=s.inertias[0] + 1e-6 * np.eye(3)), "inertia", "upper"),
    ("double_pendulum", lambda s: s.replace(gravity=-s.gravity), "potential energy", ""),
    ("double_pendulum", lambda s: s.replace(gravity=[0.0, 0.0, -9.80665]), "potential energy", ""),
    ("spring_pendulum", lambda s: _force(s, free_length=0.41), "potential energy", ""),
    ("damped_pendulum", lambda s: _force(s, damping=3.999), "acceleration", "pendulum"),
])
def test_the_first_offender_is_the_cause(name: str, change: object, quantity: str, place: str) -> None:
    found = inspect(crosscheck.load_scene(name), ["mujoco", MisBuilt(change)], form="tree")
    assert not found.agree
    assert {offender.engine for offender in found.offenders} == {"misbuilt"}
    assert (found.offenders[0].quantity, found.offenders[0].place) == (quantity, place)
    assert str(found.offenders[0]).startswith(f"misbuilt tree: {quantity}")


@pytest.mark.parametrize("name", [*SMALL, "parallelogram", "driven_slider_crank"])
def test_random_states_are_admissible(name: str) -> None:
    scene = crosscheck.load_scene(name)
    at, again, other = (admissible.states(scene, 4, seed) for seed in (7, 7, 8))
    constraints = Constraints(scene)
    size = admissible.length(scene) * max(1.0, np.abs(at.w).max()) + np.abs(at.v).max()
    assert np.abs(constraints.position(at.x, at.R)).max() < 1e-13 * max(1.0, admissible.length(scene))
    assert np.abs(constraints.velocity(at.x, at.R, at.v, at.w)).max() < 1e-13 * size  # some hundred roundings
    assert at.x[0].tolist() == scene.x0.tolist()
    assert at.x.tolist() == again.x.tolist()
    for k in range(1, 5):
        assert max(np.abs(at.x[k] - scene.x0).max(), np.abs(at.R[k] - scene.R0).max()) > 1e-3
        assert np.abs(at.R[k] - other.R[k]).max() > 1e-6


def test_bounds_follow_the_conditioning_and_never_hide_a_datum() -> None:
    found = inspect(crosscheck.load_scene("chain_8"), ["mujoco"], form="tree", count=0)
    assert {deviation.bound for deviation in found.deviations} == {1e-10}
    assert LOOSEST < 1e-7  # a datum of six digits


def test_truth_is_independent_of_the_kernel() -> None:
    """The reference must not use the code under test."""
    code = ("import sys, crosscheck.inspection.reference\n"
            "print([name for name in sys.modules if name.split('.')[0] in ('lieeuler', 'mujoco', 'pinocchio')])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_command_line() -> None:
    runner = CliRunner()
    good = runner.invoke(app.app, ["inspect", "four_bar", "--engine", "mujoco", "--states", "1"])
    assert good.exit_code == 0, good.output
    for words in ("four_bar: 3 bodies", "mass matrix", "soft", "mujoco maximal"):
        assert words in good.output
    assert "OFFENDER" not in good.output
    with pytest.raises(crosscheck.ArgumentError, match="--form"):
        runner.invoke(app.app, ["inspect", "four_bar", "--form", "trea"], catch_exceptions=False)
    listed = runner.invoke(app.app, ["list", "--support", "--engine", "exudyn"])
    assert listed.exit_code == 0, listed.output
    assert "point_on_plane" in listed.output
    assert "pivot" in listed.output


def test_command_line_fails_with_1(monkeypatch: pytest.MonkeyPatch) -> None:
    from crosscheck import adapters

    monkeypatch.setattr(adapters, "get", lambda name: MisBuilt(lambda s: _body(s, 0, mass=1.001)))
    done = CliRunner().invoke(app.app, ["inspect", "single_pendulum", "--engine", "misbuilt", "--states", "0"])
    assert done.exit_code == 1, done.output
    assert "first deviation beyond its bound: misbuilt tree: mass of 'pendulum' at t = 0" in done.output
