"""A type of joint or force that an adapter was not built for is refused by its name, or stepped as its motion says."""

import dataclasses

import pytest

from crosscheck import adapters
from crosscheck.adapters.base import RunSpec
from crosscheck.adapters.built_in import ENTRIES
from crosscheck.running import support
from crosscheck.scene.file import load_scene
from crosscheck.scene.joints import JOINT_TYPES
from crosscheck.scene.laws import FORCE_TYPES
from crosscheck.scene.model import GROUND, Force


def requests(engine, scene):
    """A request for each form, and for the form that the engine chooses."""
    adapter = adapters.get(engine)
    for form in (None, *adapter.forms):
        yield adapter, dataclasses.replace(support.spec(adapter, adapter.methods[0], form), form=form)


SPRING = {"stiffness": 3.0, "damping": 0.1}


@pytest.mark.parametrize("force", [
    Force("linear_spring", GROUND, 0, None, SPRING | {"parent_point": (0.1, 0.2, 0.3), "child_point": (0.0, 0.1, 0.0),
                                                      "free_length": 0.2}),
    Force("torsional_spring", None, None, "hinge", SPRING | {"rest_angle": 0.2}),
    Force("joint_torque", None, None, "hinge", {"torque": 1.0})],
    ids=["between points", "in a joint", "named like a motor"])
@pytest.mark.parametrize("engine", ENTRIES)
def test_a_strange_force_is_refused_by_its_name_or_acts_as_its_table_says(engine, force, monkeypatch):
    """One that an engine builds from its law acts at once and like the one it repeats."""
    monkeypatch.setitem(FORCE_TYPES, "joint_strange", dataclasses.replace(FORCE_TYPES[force.type], element=None))
    known = load_scene("hinge_pendulum").replace(samples=2, duration=0.01, forces=(force,))
    scene = known.replace(forces=(dataclasses.replace(force, type="joint_strange"),))
    for adapter, spec in requests(engine, scene):
        reason = adapter.unsupported(scene, spec)
        if reason is not None:
            assert "joint_strange" in reason or "form" in reason
        else:
            spec = RunSpec(spec.method, step=0.005, form=spec.form)
            assert abs(adapter.run(scene, spec).states.x - adapter.run(known, spec).states.x).max() < 1e-15


@pytest.mark.parametrize("engine", ENTRIES)
def test_a_strange_joint_is_refused_by_its_name_or_moves_as_its_table_says(engine, monkeypatch):
    """Where an engine builds joints from rows or motions, a new type runs at once and like the one it repeats."""
    monkeypatch.setitem(JOINT_TYPES, "strange", JOINT_TYPES["revolute"])
    known = load_scene("hinge_pendulum").replace(samples=2, duration=0.01)
    scene = known.replace(joints=(dataclasses.replace(known.joints[0], type="strange"),))
    for adapter, spec in requests(engine, scene):
        reason = adapter.unsupported(scene, spec)
        if reason is not None:
            assert "strange" in reason or "form" in reason
        elif not adapters.has_own_environment(engine):  # whose process has not heard of the type
            spec = RunSpec(spec.method, step=0.005, form=spec.form)
            assert abs(adapter.run(scene, spec).states.x - adapter.run(known, spec).states.x).max() < 1e-9
