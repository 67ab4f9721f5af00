"""No wrong engine of `tests.engines.strangers` passes, and the honest one passes over the whole run."""

import dataclasses

import numpy as np
import pytest

from crosscheck import adapters
from crosscheck.adapters.external.own import completed
from crosscheck.document import Plan, Way
from crosscheck.verification.cell import run_cell
from crosscheck.verification.task import Cell
from tests.engines.stepper import HONEST, Honest
from tests.engines.strangers import KINDS, TABLE

STEPS = {"first": 2e-4, "second": 1e-3, "fourth": 2e-3, "RK4": 4e-3, "DP5": 1e-3}
CASES = [(wrong, method, scene) for wrong in TABLE for method in wrong.methods for scene in wrong.scenes]


def judged(engine, method, scene):
    plan = Plan({1: STEPS[method]}, samples=101, duration=4.0)
    with adapters.lent(completed(engine, "stranger", "1")) as name:
        return run_cell(Cell(scene, Way(name, method), plan))


def test_there_are_enough_of_every_kind():
    assert len(TABLE) >= 60
    assert {wrong.kind for wrong in TABLE} == set(KINDS)


@pytest.mark.parametrize(("wrong", "method", "scene"), [
    pytest.param(*case, id=f"{case[0].kind}, {case[0].name}, {case[1]}") for case in CASES])
def test_no_wrong_engine_passes(wrong, method, scene):
    run = judged(wrong.make(), method, scene)
    assert run.outcome == "fail", [(each.kind, each.value, each.bound) for each in run.findings]


@pytest.mark.parametrize("scene", ["single_pendulum", "double_pendulum"])
@pytest.mark.parametrize("method", HONEST)
def test_the_honest_one_passes_over_the_whole_run(method, scene):
    run = judged(Honest(), method, scene)
    assert run.outcome == "pass", [(each.kind, each.value, each.bound, each.status) for each in run.findings]


class Leaning(Honest):
    """MuJoCo in a world whose plumb line leans by 3e-4 rad about x, however the scene is turned."""

    methods = ("implicitfast",)
    stock = adapters.get("mujoco")

    def documented_order(self, scene, spec):
        return self.stock.documented_order(scene, spec)

    def run(self, scene, spec):
        return self.stock.run(scene.replace(gravity=scene.gravity + 3e-4 * np.cross([1.0, 0.0, 0.0], scene.gravity)),
                              spec)


class Wound(Honest):
    """lieeuler in one call: restarted at every output time it would lose the turns of the spring."""

    same = True


class Unwound(Wound):
    """The same with a torsional spring whose angle of rest is off by 1e-3 rad."""

    def run(self, scene, spec):
        return super().run(scene.replace(forces=tuple(dataclasses.replace(force, parameters={
            **force.parameters, "rest_angle": force.parameters["rest_angle"] + 1e-3}) for force in scene.forces)), spec)


@pytest.mark.parametrize(("engine", "outcome"), [(Wound, "pass"), (Honest, "fail"), (Unwound, "fail")])
def test_a_spring_that_is_wound_up(engine, outcome):
    """Its error of 7e-4 N m lies below that of the steps, and stays as they vanish."""
    with adapters.lent(completed(engine(), "stranger", "1")) as name:
        run = run_cell(Cell("torsion_wheel", Way(name, "first"), Plan({1: 3e-4})))
    assert run.outcome == outcome, run.worst


def test_axes_of_the_world_hide_no_force():
    """At order 1 runs in two worlds are as near as its errors, and those from the start of a fast top soon differ."""
    with adapters.lent(completed(Leaning(), "stranger", "1")) as name:
        run = run_cell(Cell("heavy_top", Way(name, "implicitfast"), Plan({1: 1e-5}, duration=0.2)))
    assert any(finding.kind == "limit position" and finding.status == "fail" for finding in run.findings)
