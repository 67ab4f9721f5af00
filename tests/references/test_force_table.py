"""The table of force laws: its two columns guard each other, and one more law along a measure is one more row."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import crosscheck
from crosscheck.adapters import get
from crosscheck.adapters.base import RunSpec
from crosscheck.compare.errors import errors
from crosscheck.errors import SceneError
from crosscheck.references import TruthError, compute
from crosscheck.running.support import minimal_scenes
from crosscheck.scene import laws, mechanics
from crosscheck.scene.laws import FORCE_TYPES, ForceType
from crosscheck.scene.model import Force
from crosscheck.scene.models.writing import mjcf

GROWN = 1.0 + 1e-4


def minimal(item, kind="force"):
    """A scene of a few bodies with one force, or none."""
    scene = next(each.scene for each in minimal_scenes() if (each.kind, each.item) == (kind, item))
    return scene.replace(name=item.replace(" ", "_"), duration=0.3, samples=4)


def sprung(base, kind, **parameters):
    """With a force of this type alone, between the ends of the scene's last joint or along it."""
    joint = base.joints[-1]
    if FORCE_TYPES[kind].on_joint:
        return base.replace(forces=(Force(kind, None, None, joint.name, parameters),))
    ends = {"parent_point": (0.6, 0.3, -1.2), "child_point": (0.1, 0.0, -0.3)}
    return base.replace(forces=(Force(kind, joint.parent, joint.child, None, parameters | ends),))


SCENES = {
    "linear_spring": lambda: minimal("linear_spring"), "torsional_spring": lambda: minimal("torsional_spring"),
    "slide_spring": lambda: sprung(minimal("prismatic", "joint between bodies"), "slide_spring", stiffness=30.0,
                                   rest_position=0.2, damping=1.5),
    "joint_torque": lambda: minimal("joint_torque"), "joint_force": lambda: minimal("joint_force")}
COLUMNS = [(kind, column) for kind, law in FORCE_TYPES.items() if kind in SCENES
           for column in ("effort", "potential", "dissipation") if column != "dissipation" or law.stores]


def test_every_law_along_a_measure_has_both_columns():
    assert {kind for kind, law in FORCE_TYPES.items() if law.effort and not law.has_modes} == SCENES.keys()


@pytest.mark.parametrize(("kind", "column"), COLUMNS)
def test_a_mistake_in_one_column_is_no_truth(kind, column, monkeypatch):
    scene, law = SCENES[kind](), FORCE_TYPES[kind]
    if column == "effort":
        assert compute(scene).disagreement < 1e-12
    right = getattr(law, column)

    def wrong(*arguments):
        found = right(*arguments)
        return tuple(GROWN * each for each in found) if isinstance(found, tuple) else GROWN * found

    monkeypatch.setitem(FORCE_TYPES, kind, dataclasses.replace(law, **{column: wrong}))
    try:
        found = compute(scene)
    except TruthError:
        return
    assert found.error == found.disagreement > 100 * found.allowed


def stiffening(measure, rest=""):
    """A spring whose stiffness grows with the square of its stretch, with a damper."""
    return ForceType(
        measure, lambda p, u, rate: -(p["stiffness"] * u + p["cubic"] * u**3 + p["damping"] * rate),
        lambda p: (0.0, 0.0, 0.5 * p["stiffness"], 0.0, 0.25 * p["cubic"]),
        lambda p: (0.0, 0.0, 0.5 * p["damping"]), rest, stores=True)


@pytest.mark.parametrize(("measure", "kind"), [("length", "revolute"), ("angle", "revolute"), ("slide", "prismatic"),
                                               ("length at rest", "spherical")])
def test_one_more_law_is_an_entry_of_one_table(measure, kind, monkeypatch):
    """Both formulations, energy and Pinocchio have it at once; other engines and formats say that they have not."""
    monkeypatch.setitem(FORCE_TYPES, "cubic_spring", stiffening(measure.split()[0], "rest"))
    scene = sprung(minimal(kind, "joint between bodies"), "cubic_spring", stiffness=20.0, cubic=40.0, damping=0.5,
                   rest=0.0 if "at rest" in measure else 0.3)
    exact = crosscheck.truth(scene)
    assert exact.disagreement < 1e-11
    missed = errors(scene, crosscheck.run(scene, engine="pinocchio", method="RKMK8", step=1e-3), exact.states)
    assert max(missed["position"].max, missed["attitude"].max) < 1e-9
    for engine, method in (("lieeuler", "rkmk4"), ("mujoco", "RK4"), ("exudyn", "RK44")):
        assert "is a cubic_spring, a type that is not built here" in get(engine).unsupported(scene, RunSpec(method))
    with pytest.raises(SceneError, match=r"cannot hold forces\[0\], a cubic_spring"):
        mjcf(scene)


@pytest.mark.parametrize("measure", ["length", "angle"])
def test_its_energy_is_what_its_damper_leaves(measure, monkeypatch):
    monkeypatch.setitem(FORCE_TYPES, "cubic_spring", stiffening(measure, "rest"))
    scene = sprung(minimal("revolute", "joint between bodies"), "cubic_spring", stiffness=20.0, cubic=40.0,
                   damping=0.0, rest=0.3).replace(samples=31)
    energy = mechanics.energy(scene, crosscheck.truth(scene).states)
    assert np.ptp(energy) < 1e-11 * np.abs(energy).max()


def test_a_power_series_is_the_sum_of_its_powers():
    u = np.linspace(-2.0, 2.0, 5)
    np.testing.assert_allclose(laws.power_series((1.0, -2.0, 0.5), u), 1.0 - 2.0 * u + 0.5 * u**2, rtol=1e-15)
