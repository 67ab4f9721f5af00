"""The judge by solution verification: what it accuses, what it does not, and what a finding prints."""

import ast
import pathlib
import re

import numpy as np
import pytest

import crosscheck
from crosscheck import adapters, load_scene
from crosscheck.adapters.base import Engine, RunSpec, StandIn
from crosscheck.adapters.external.own import completed
from crosscheck.compare.order import cancelling
from crosscheck.compare.sizes import sizes
from crosscheck.document import QUANTITIES, Plan, Record, Way
from crosscheck.document.outcomes import KINDS
from crosscheck.judge.rules import Check, findings, shares
from crosscheck.judge.segments import Segment, marks
from crosscheck.judge.system_flow import SystemFlow
from crosscheck.judge.world import World, begun
from crosscheck.references import truth
from crosscheck.scene.model import Sensor, Site
from crosscheck.scene.starts import restarted
from crosscheck.verification.cell import run_cell
from crosscheck.verification.limits import refined
from crosscheck.verification.solution import judge
from crosscheck.verification.task import Cell
from tests.gate.measure import case
from tests.gate.right import Braked
from tests.gate.wrong import LastStepsAccelerations, LateReversal
from tests.law_mistakes import SCENES
from tests.references.law_scenes import pendulum, servo

STEPS = {"DAE1L_LSE": 1e-4, "rattle2": 1e-3, "rkmk4": 2e-3}


class Altered(StandIn):
    """An engine on a scene with gravity times a factor."""

    def __init__(self, factor=1.0, late=0.0, engine="lieeuler"):
        super().__init__(adapters.get(engine))
        self.factor, self.late = factor, late

    name = "altered"

    def run(self, scene, spec):
        """The run, with gravity times the factor in scenes that last as long as `late`, s."""
        factor = self.factor if scene.duration >= self.late else 1.0
        return self._engine.run(scene.replace(gravity=factor * np.asarray(scene.gravity)), spec)


def judged(engine, method, scene="double_pendulum", duration=0.5):
    plan = Plan({1: STEPS[method]}, samples=41, duration=duration)
    with adapters.lent(engine) as name:
        return run_cell(Cell(scene, Way(name, method), plan))


@pytest.mark.parametrize("method", STEPS)
def test_a_right_engine_passes_over_the_whole_run(method):
    run = judged(Altered(), method)
    assert run.outcome == "pass", run.message
    assert run.share == 1.0


@pytest.mark.parametrize(("method", "error"), [("DAE1L_LSE", 1e-4), ("rattle2", 1e-7), ("rkmk4", 1e-8)])
def test_a_small_error_of_gravity_fails(method, error):
    run = judged(Altered(1.0 + error), method)
    failing = {each.kind for each in run.findings if each.status == "fail"}
    assert run.outcome == "fail"
    assert any(kind.startswith("limit ") for kind in failing), failing


def test_a_run_that_is_not_what_the_engine_answers_elsewhere_fails():
    """It is wrong in the whole run alone, and right wherever it is started again."""
    run = judged(Altered(1.001, late=0.5), "rattle2")
    assert any(each.kind.startswith("gap limit") and each.status == "fail" for each in run.findings)


def test_value_and_uncertainty_follow_by_hand_from_what_a_finding_prints():
    run = judged(Altered(1.0 + 1e-4), "rattle2")
    found = next(each for each in run.findings if each.kind == "limit velocity")
    rows = re.findall(r"h = ([\d.e+-]+): \(([^)]*)\)", found.detail)
    h = np.array([float(step) for step, _ in rows])
    D = np.array([[float(part) for part in vector.split(", ")] for _, vector in rows])
    assert len(h) == 5  # a step was halved once, and a far smaller one asked: neither end of the list is in the value
    limit = cancelling(h[1:4], 2) @ D[1:4]
    assert np.linalg.norm(limit) == pytest.approx(found.value, rel=1e-4)
    parts = re.search(r"U = ([^;]*);", found.detail)[1]
    assert sum(float(part.split()[-1]) for part in parts.split(", ")) == pytest.approx(found.bound, rel=1e-2)


@pytest.mark.parametrize("method", STEPS)
def test_orders_and_errors_at_the_steps_asked_come_with_the_verdict(method):
    scene = load_scene("double_pendulum").replace(duration=0.5, samples=41)
    with adapters.lent(Altered()) as name:
        traj = crosscheck.run(scene, engine=name, method=method, step=STEPS[method])
        order = adapters.get(name).documented_order(scene, RunSpec(method, step=STEPS[method]))
        run = Record(scene=scene.name, engine=name, version="1", method=method, step=STEPS[method],
                     documented_order=order)
        found = judge(run, scene, traj, truth(scene))
    assert found.order.documented == order
    assert order - 0.5 <= found.order.observed <= found.order.median
    coarse, _, fine = found.ladder
    assert coarse.step > 2 * fine.step
    assert set(QUANTITIES) <= set(fine.errors)
    fall = np.log(coarse.errors["velocity"] / fine.errors["velocity"]) / np.log(coarse.step / fine.step)
    assert fall == pytest.approx(order, abs=0.5)
    assert {each.kind.partition(" ")[0] for each in found.findings} <= set(KINDS)


def test_what_coarser_answers_say_of_a_row_stands_where_finer_ones_say_less():
    def check(name, value, bound):
        return Check("limit", name, 0, value, {"extrapolation": bound}, 1.0)

    before = [check("position", 1e-4, 1e-3), check("velocity", 1e-4, 0.5), check("energy", 0.3, 0.2)]
    after = [check("position", 0.1, 0.3), check("velocity", 1e-4, 0.1), check("energy", 0.1, 0.3)]
    assert refined(before, after) == [before[0], after[1], after[2]]
    accused = [check("position", 0.4, 0.3), *after[1:]]
    assert refined(before, accused) == accused


def test_an_order_that_has_shown_stays_where_an_iteration_ends():
    """Of Exudyn's answers near the start, which are at 1e-9, finer ones come down to what Newton's iteration leaves."""
    pytest.importorskip("exudyn")
    plan = Plan({1: 2e-3}, samples=126, duration=0.5)
    run = run_cell(Cell("chrono_spherical", Way("exudyn", "TrapezoidalIndex2"), plan))
    assert run.findings
    assert not [each.kind for each in run.findings if each.kind == "order" and each.status == "fail"]


@pytest.mark.parametrize(("gravity", "outcome"), [(1.0, "unresolved"), (1.001, "fail")])
def test_an_oscillation_that_all_steps_damp_away_accuses_nothing(gravity, outcome):
    """MuJoCo's first-order method on a stiff spring, whose 1000 rad/s the run's own error sets off."""
    pytest.importorskip("mujoco")
    with adapters.lent(Altered(gravity, engine="mujoco")) as name:
        run = run_cell(Cell("stiff_spring", Way(name, "discrete"), Plan({1: 2e-4}, samples=11)))
    assert run.outcome == outcome


def test_an_order_fails_only_where_answers_are_near_each_other():
    """Whole runs of a chaotic pendulum are far from the range of an order at steps where its segments show one."""
    run = run_cell(Cell("double_pendulum", Way("lieeuler", "DAE3L_LE"), Plan({1: 2e-4})))
    assert run.off > 0.1
    assert run.order.observed == pytest.approx(1, abs=0.1)
    assert not [each.kind for each in run.findings if each.status == "fail"]


def test_accelerations_that_answers_lack_are_not_asked():
    """Exudyn's explicit methods have them where every step is recorded, which answers are not."""
    pytest.importorskip("exudyn")
    run = run_cell(Cell("heavy_top", Way("exudyn", "RK44", form="tree"), Plan({1: 2e-4}, duration=0.2, samples=21)))
    assert run.outcome == "pass"


def test_a_value_beyond_its_uncertainty_fails_however_large_that_is():
    def status(value, bound):
        return Check("limit", "position", 0, value, {"extrapolation": bound}, 1.0).status

    assert status(0.3, 0.2) == "fail"
    assert status(0.1, 0.2) == "unresolved"
    assert status(1e-3, 1e-2) == "ok"
    assert status(np.nan, 1.0) == "fail"


def test_the_share_counts_time():
    checks = [Check("limit", "position", k, 0.0, {"extrapolation": bound}, 1.0) for k, bound in enumerate([1e-3, 1.0])]
    spans = [(0.0, 3.0), (3.0, 4.0)]
    assert shares(checks, spans, []) == pytest.approx(
        {"": 0.75, "position": 0.75, "attitude": 1.0, "velocity": 1.0, "angular velocity": 1.0})
    assert shares(checks, spans, [0])[""] == pytest.approx(0.0)
    assert findings(checks, spans)[0].status == "unresolved"


def test_segments_cover_the_run_and_events_have_their_own():
    calm, wild = np.zeros(101), np.linspace(0.0, 20.0, 101)
    assert marks(calm, [], "seed")[0] == 0
    assert len(marks(calm, [], "seed")) == 9
    assert len(marks(wild, [], "seed")) == 21
    cut = marks(calm, [40, 41, 77], "seed")
    assert {40, 42, 77, 78} <= set(cut)
    assert 41 not in cut
    assert len(marks(calm, list(range(0, 100, 3)), "seed")) <= 17
    assert marks(np.zeros(4), [], "seed") == [0, 1, 2, 3]
    assert 61 in marks(calm, [], "seed", 61)


def test_segments_are_short_where_errors_grow():
    grown = np.clip(np.arange(101) - 40.0, 0.0, 16.0)  # all of it between the samples 40 and 56
    cut = marks(grown, [], "seed")
    assert np.diff(grown[cut]).max() < 3.0
    assert np.diff(cut).max() <= 2 * 100 / 16 * 1.5


@pytest.mark.parametrize("name", ["double_pendulum", "four_bar", "heavy_top"])
def test_the_flow_started_at_any_of_its_states_is_the_same_motion(name):
    scene = load_scene(name).replace(duration=0.4, samples=21)
    reference = truth(scene)
    flow = SystemFlow(scene, sizes(scene, reference.states), reference)
    start = restarted(scene, reference.states, 5, 0.3, 16)
    found = flow.from_(start, float(reference.t[5]), start.t)
    assert found.linear
    assert found.growth >= 1.0
    assert found.states.x == pytest.approx(reference.states.x[5:], abs=1e-9)
    assert found.states.a == pytest.approx(reference.states.a[5:], abs=1e-6)
    assert found.error < 1e-9


def test_what_static_friction_holds_is_held_where_errors_grow(tmp_path):
    """Moved by anything it would slip at once, long before it is torn loose."""
    scene = SCENES["lifted"](tmp_path)
    reference = truth(scene)
    start = begun(scene, reference.states, 2, 3)
    flowed = SystemFlow(scene, sizes(scene, reference.states), reference).from_(start, float(scene.t[2]), start.t)
    assert len(flowed.jumps) == 1
    assert flowed.growth < 10


def test_growth_is_that_of_the_motion():
    """A double pendulum that is upright grows an error; a slider that falls freely does not in its rates."""
    scene = load_scene("double_pendulum").replace(duration=2.0, samples=41)
    reference = truth(scene)
    flow = SystemFlow(scene, sizes(scene, reference.states), reference)
    short = flow.from_(scene.replace(duration=0.1, samples=3), 0.0, np.linspace(0.0, 0.1, 3))
    long = flow.from_(scene, 0.0, scene.t)
    assert long.growth > short.growth
    assert long.growth < 30 * reference.amplification


def test_what_is_due_at_the_last_output_jumps_there(tmp_path):
    """A sample of a servo has happened there for some engines and not for others: accelerations are two numbers."""
    scene = pendulum(tmp_path, forces=[servo("h", period=0.1)], duration=0.3, samples=4)
    reference = truth(scene)
    flowed = SystemFlow(scene, sizes(scene, reference.states), reference).from_(scene, 0.0, scene.t)
    assert [jump.after for jump in flowed.jumps] == pytest.approx([0.1, 0.2, 0.3])
    assert all(jump.due for jump in flowed.jumps)
    segment = Segment(0, 3, scene, scene, flowed=flowed)
    assert not segment.kept("acceleration", 0.0).any()
    assert segment.kept("velocity", 0.0).all()


@pytest.mark.parametrize(("engine", "late"), [(Braked, False), (LateReversal, True)])
def test_a_documented_order_holds_where_a_motion_is_not_smooth(engine, late):
    """Friction that reverses at the end of a step converges to the truth, but at order one instead of four."""
    scene, step = case("Braked")
    with adapters.lent(completed(engine(), "braked", "1")) as name:
        traj = crosscheck.run(scene, engine=name, method=engine.__name__, step=step)
        run = Record(scene=scene.name, engine=name, version="1", method=engine.__name__, form=traj.form, step=step,
                     documented_order=4)
        found = judge(run, scene, traj, truth(scene)).findings
    assert any(each.status == "fail" and each.kind.startswith("limit ") for each in found) == late


def test_accelerations_of_the_step_before_have_too_low_an_order():
    """They come to those of the states as steps vanish, which no limit can accuse."""
    scene = load_scene("single_pendulum").replace(duration=1.0, samples=21)
    with adapters.lent(completed(LastStepsAccelerations(), "late", "1")) as name:
        traj = crosscheck.run(scene, engine=name, method="LastStepsAccelerations", step=1e-3)
        run = Record(scene=scene.name, engine=name, version="1", method="LastStepsAccelerations", form=traj.form,
                     step=1e-3, documented_order=2)
        found = judge(run, scene, traj, truth(scene)).findings
    accused = {each.kind for each in found if each.status == "fail"}
    assert accused
    assert accused <= {"order acceleration", "order angular acceleration"}


def test_another_way_from_a_start_that_is_moved_by_a_rounding_is_no_noise(tmp_path):
    """Joints that are open by a rounding are closed first, which changes the error of an answer, not its truth."""
    scene = SCENES["stop"](tmp_path)
    traj = crosscheck.run(scene, engine="lieeuler", method="rkmk4", step=5e-3)
    run = Record(scene=scene.name, engine="lieeuler", version="1", method="rkmk4", form=traj.form, step=5e-3,
                 documented_order=4)
    found = judge(run, scene, traj, truth(scene)).findings
    assert not [each.kind for each in found if each.status == "fail"]


@pytest.mark.parametrize("name", ["double_pendulum", "triple_pendulum", "chain_8"])
def test_no_body_keeps_its_place_in_another_world(name):
    world = World.drawn(load_scene(name), 1.0)
    assert sorted(world.bodies) == list(range(len(world.bodies)))
    assert all(new != old for new, old in enumerate(world.bodies))


def test_states_come_back_from_another_world_with_their_accelerations():
    scene = load_scene("double_pendulum").replace(duration=0.2, samples=5)
    world = World.drawn(scene, 1.0)
    there, here = truth(world.scene(scene)).states, truth(scene).states
    back = world.back(there, world.scene(scene))
    assert back.x == pytest.approx(here.x, abs=1e-10)
    assert back.a == pytest.approx(here.a, abs=1e-8)
    assert back.alpha == pytest.approx(here.alpha, abs=1e-8)


def test_sites_and_sensors_are_those_of_the_same_bodies_in_another_world():
    scene = load_scene("double_pendulum")
    scene = scene.replace(
        sites=(Site("tip", 1, np.array([0.1, 0.2, 0.3]), np.array([1.0, 0.0, 0.0, 0.0])),
               Site("post", -1, np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0]))),
        sensors=(Sensor("rate", "gyro", site="tip", frame="site"), Sensor("bend", "angle", joint=scene.joints[1].name)))
    world = World.drawn(scene, 1.0)
    there = world.scene(scene)
    for old, new in zip(scene.sites, there.sites, strict=True):
        if old.body < 0:
            assert new.position == pytest.approx(world.Q @ old.position + world.shift)
        else:
            assert world.bodies[new.body] == old.body
    joints = {f"j{new}": scene.joints[old].name for new, old in enumerate(world.joints)}
    for old, new in zip(scene.sensors, there.sensors, strict=True):
        assert old.joint == (new.joint and joints[new.joint])


FREE = {"reshape", "eye"}
"""Calls whose numbers are the shape of arrays."""


def decisions(tree):
    """Literals that decide: all but 0, 1, -1, 2, parts of arrays, and shapes."""
    above = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}

    def of_shape(node):
        while node in above:
            node = above[node]
            call = node.func if isinstance(node, ast.Call) else None
            if isinstance(node, ast.Slice) or getattr(call, "attr", "") in FREE or (
                    isinstance(node, ast.Compare) and "shape" in ast.unparse(node)):
                return True
        return False

    return [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, int | float)
            and not isinstance(node.value, bool) and node.value not in (0, 1, 2) and not of_shape(node)]


def test_the_judge_has_at_most_fifteen_constants_each_with_its_source(capsys):
    """Every other number in the rooms that judge is 0, 1, -1, 2 or a shape; what engines declare is printed."""
    root = pathlib.Path(crosscheck.__file__).parent
    files = [*(root / f"compare/{name}.py" for name in ("apart", "ladder", "order", "sizes")),
             *(root / f"verification/{name}.py" for name in (
                     "limits", "probe", "promises", "questions", "restart_defects", "solution", "uncertainty")),
             *(root / "judge" / f"{name}.py" for name in (
                 "known", "overrides", "rounding", "rules", "segments", "system_flow", "verdict", "world"))]
    named = []
    for file in files:
        tree, inside = ast.parse(file.read_text("utf-8")), set()
        for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
            found = decisions(node) if isinstance(node, ast.Assign) else []
            inside |= set(found)
            if found:
                named.append(node.targets[0].id)
                assert isinstance(after, ast.Expr), f"{file.name}: {named[-1]} says no source"
                assert len(after.value.value) > 40, f"{file.name}: {named[-1]} says no source"
        loose = [(node.lineno, node.value) for node in decisions(tree) if node not in inside]
        assert not loose, f"{file.name}: {loose}"
    assert len(named) <= 15, "\n".join(named)
    with capsys.disabled():
        print(f"\n{len(named)} constants: {', '.join(named)}")
        for name in sorted(adapters.names()):
            engine = adapters.get(name)
            print(f"{name}: eps {engine.eps:.2g}, orders {dict(engine.orders)}, rotations kept {engine.on_group}, "
                  f"iteration declared {type(engine).iteration is not Engine.iteration}")
