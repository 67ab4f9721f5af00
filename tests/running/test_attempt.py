"""What an engine raises or returns becomes an outcome, and nothing that it states reaches a result unchecked."""

from __future__ import annotations

import ast
import csv
import dataclasses
import json
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import crosscheck
from crosscheck import report as folder_of_report
from crosscheck.adapters.base import Engine, RawRun, RunSpec
from crosscheck.document import Way
from crosscheck.errors import ArgumentError, EngineError, Unsupported
from crosscheck.running.attempt import Failed, Ran, Refused, attempt
from crosscheck.scene.model import Scene
from crosscheck.studies.study import conduct
from crosscheck.studies.work_precision import WorkPrecision, WorkPrecisionAsk
from crosscheck.verification import job
from tests import ROOT
from tests.engines.faults import Resting, Untimed

UNTIMED = "tests/engines/faults.py:Untimed"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return crosscheck.load_scene("single_pendulum").replace(duration=0.2, samples=3)


@dataclasses.dataclass
class Stating(Resting):
    """A resting run whose answer is changed."""

    change: Callable[[RawRun], Any]

    def run(self, scene: Scene, spec: RunSpec) -> Any:
        """The changed answer; a function that returns nothing changed it in place."""
        raw = RawRun(super().run(scene, spec), 0.5, 4, 0.05)
        found = self.change(raw)
        return raw if found is None else found


def stating(**fields: Any) -> Callable[[RawRun], RawRun]:
    return lambda raw: dataclasses.replace(raw, **fields)


def state(**fields: Any) -> Callable[[RawRun], RawRun]:
    return lambda raw: dataclasses.replace(raw, states=dataclasses.replace(raw.states, **fields))


class Hostile:
    """An object that acts when it is looked at."""

    def __reduce__(self) -> Any:
        raise SystemExit("unpickled")

    def __repr__(self) -> str:
        raise SystemExit("printed")


WRONG = {
    "wall_time of 'fast'": stating(wall_time="fast"), "wall_time of None": stating(wall_time=None),
    "wall_time of nan": stating(wall_time=np.float64("nan")), "wall_time of inf": stating(wall_time=np.inf),
    "wall_time of -1": stating(wall_time=-1), "wall_time of True": stating(wall_time=True),
    "wall_time of 1e+300": stating(wall_time=1e300), "wall_time of int": stating(wall_time=10**400),
    "wall_time of ndarray": stating(wall_time=np.array([0.1, 0.2])),
    "wall_time of Hostile": stating(wall_time=Hostile()),
    "wall_time of complex": stating(wall_time=1j),
    "steps of 0,": stating(steps=0), "steps of 2.5": stating(steps=2.5), "steps of True": stating(steps=True),
    "steps of int,": stating(steps=10**300), "steps of None": stating(steps=None),
    "step of nan": stating(step=float("nan")), "step of 0": stating(step=0), "step of inf": stating(step=np.inf),
    "no text: Hostile": stating(status=Hostile()), "no text: 'success', 3": stating(form=3),
    "stats that are no dict of plain values: Expected `object`": stating(stats=[1.0]),
    "plain values: Hostile": stating(stats={"mine": Hostile()}),
    "newton_left": stating(stats={"newton_left": "small"}), "rejected_steps": stating(stats={"rejected_steps": 0.5}),
    "maximum of energy_error of nan": stating(maxima={"energy_error": float("nan")}),
    "maximum of orthogonality of 'big'": stating(maxima={"orthogonality": "big"}),
    "maxima that are not numbers under the keys": stating(maxima={"energy": 1.0}),
    "at other times": state(t=np.array([0.0, 0.1, 0.3])), "t of shape": state(t=np.zeros((3, 1))),
    "2 samples, not 3": state(t=np.array([0.0, 0.2])), "x as list": state(x=[[0.0]]),
    "v of type object": state(v=np.full((3, 1, 3), None)),
    "w of type complex128": state(w=np.zeros((3, 1, 3), complex)),
    "R of shape (3, 1, 9)": state(R=np.zeros((3, 1, 9))),
    "lam of shape (3, 2), not (3, 3)": state(lam=np.zeros((3, 2))),
    "one of a and alpha": state(a=np.zeros((3, 1, 3))),
    "t = 0.1 s": state(x=np.array([0, np.nan, 0])[:, None, None] * np.ones((1, 1, 3))),
}
"""Part of the reason, and what was wrong with the answer."""


RESTED = Way("resting", "Rest", 0.1)


@pytest.mark.parametrize("words", WRONG)
def test_whatever_is_wrong_with_an_answer_is_one_line_of_a_failure(scene: Scene, words: str) -> None:
    outcome = attempt(scene, RESTED, complete(Stating(WRONG[words])))
    assert isinstance(outcome, Failed)
    assert isinstance(outcome.error, EngineError)
    assert words in outcome.why
    assert "\n" not in outcome.why
    assert outcome.status == "failed"


def complete(engine: Resting) -> Any:
    """The engine with all that an adapter has, so that nothing completes or converts what it returns."""
    kind = type(engine)
    return type(kind.__name__, (kind, Engine), {"__module__": "crosscheck.adapters.seeded"})(engine.change)


def test_a_right_answer_is_a_run_with_plain_numbers(scene: Scene) -> None:
    stats = {"mine": np.float64(2.0), "force_evaluations": 3, "spin_free": ("a",), "words": "\ud800"}
    answer = stating(wall_time=np.float32(0.5), steps=np.int64(4), stats=stats,
                     maxima={"energy_error": np.float64(1.0)})
    outcome = attempt(scene, RESTED, Stating(answer))
    assert isinstance(outcome, Ran)
    assert (type(outcome.raw.wall_time), type(outcome.raw.steps), outcome.trajectory.engine) == (float, int, "resting")
    assert outcome.trajectory.stats == {"mine": 2.0, "force_evaluations": 3, "spin_free": ("a",), "words": "\\ud800",
                                        "stated_time": 0.5, "energy_error": 1.0, "step": 0.05}


class Asking(Resting):
    """Fails when it is asked whether it can model a scene."""

    def unsupported(self, scene: Scene, spec: RunSpec) -> str | None:
        raise KeyError("no such\nscene")


def test_every_engine_error_is_an_outcome_and_every_outcome_an_error_of_ours(scene: Scene) -> None:
    outcome = attempt(scene, RESTED, Asking())
    assert isinstance(outcome, Failed)
    assert outcome.why == r"resting Rest: KeyError: 'no such\nscene'"
    assert isinstance(outcome.error.__cause__, KeyError)
    with pytest.raises(EngineError, match="KeyError"):
        crosscheck.run(scene, Asking(), "Rest", step=0.1)
    assert isinstance(attempt(scene, Way("mujoco", "RK4", 0.1, form="pivot")), Refused)
    wrong = attempt(scene, Way("mujoco", "RK5", 0.1))
    assert isinstance(wrong, Failed)
    assert isinstance(wrong.error, ArgumentError)
    assert wrong.why.startswith("ArgumentError: method of mujoco")
    ended = attempt(scene.replace(duration=1.0), Way("lieeuler", "DAE1H_LSE", 0.5))
    assert isinstance(ended, Failed)
    assert ended.status == ended.error.status.value != "failed"


def test_an_engine_is_given_as_an_object(scene: Scene) -> None:
    from crosscheck import adapters

    named = crosscheck.run(scene, "lieeuler", "DAE1L_LSE", step=0.1)
    given = crosscheck.run(scene, adapters.get("lieeuler"), "DAE1L_LSE", step=0.1)
    assert given.x.tolist() == named.x.tolist()
    assert given.engine == "lieeuler"
    assert crosscheck.run(scene, Resting(), "Rest", step=0.1).x.tolist() == [scene.x0.tolist()] * 3
    with pytest.raises(ArgumentError, match="method of resting"):
        crosscheck.run(scene, Resting(), "Move", step=0.1)
    with pytest.raises(ArgumentError, match="not type"):
        crosscheck.run(scene, Resting, "Rest", step=0.1)
    with pytest.raises(ArgumentError, match="no attribute `name`"):
        crosscheck.run(scene, type("Engine", (Resting,), {"name": 3})(), "Rest", step=0.1)
    with pytest.raises(Unsupported, match="resting Rest"):
        crosscheck.run(scene, Resting(), "Rest", step=0.1, spin_free=True)


def test_a_wrong_stepping_time_costs_one_verdict_and_no_report(tmp_path: Any) -> None:
    document = job.verify("smoke", ["single_pendulum"], [UNTIMED])
    assert [record.method for record in document.records] == list(Untimed.methods)
    assert all(record.outcome == "fail" and "wall_time of " in record.message for record in document.records)
    folder = folder_of_report.write(document, tmp_path / "report").parent
    records = json.loads((folder / "results.json").read_text("utf-8"), parse_constant=pytest.fail)["records"]
    assert [record.get("wall_time") for record in records] == [None] * len(Untimed.methods)
    cases = ElementTree.parse(folder / "junit.xml").getroot().iter("testcase")
    assert {case.get("time") for case in cases} == {"0.000000"}
    with open(folder / "results.csv", encoding="utf-8", newline="") as file:
        assert {row["wall time [s]"] for row in csv.DictReader(file)} == {""}


def test_a_wrong_stepping_time_is_a_row_of_a_sweep_and_of_a_study(tmp_path: Any) -> None:
    asked = {"scenes": ["single_pendulum"], "engines": {UNTIMED: list(Untimed.methods)}, "steps": [0.1]}
    frame = crosscheck.sweep(asked, workers=1, out=tmp_path / "sweep")
    assert frame["status"].tolist() == ["failed"] * len(Untimed.methods)
    assert frame["wall_time"].isna().all()
    ask = WorkPrecisionAsk(("single_pendulum",), (UNTIMED,), repeats=1, bound=False)
    found, = conduct(WorkPrecision(), ask, tmp_path / "study", lambda *_: None).scenes
    assert {rung.status for rung in found.rungs} == {"failed"}
    assert all("wall_time of " in rung.reason for rung in found.rungs)


ANY = {
    "errors.py": "code of others: engines, readers of their models, modules of the user, libraries of files",
    "jobs/workers/child.py": "whatever a task raises in a worker process goes to its parent",
    "cli/app.py": "the last resort: one line in place of a traceback",
}
"""Files of `crosscheck` that catch any exception without raising it again, each with its reason."""


def sources() -> dict[str, ast.Module]:
    root = ROOT / "crosscheck"
    return {str(path.relative_to(root)): ast.parse(path.read_text("utf-8")) for path in sorted(root.rglob("*.py"))}


def catches_all(tree: ast.Module) -> list[int]:
    """Lines of handlers and `suppress` of all exceptions; a handler that only cleans up and raises again is none."""
    wide = ("Exception", "BaseException")
    handlers = [node for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler)
                and not (len(node.body) and isinstance(node.body[-1], ast.Raise) and node.body[-1].exc is None)]
    kinds = [(node.lineno, [node.type]) for node in handlers]
    kinds += [(node.lineno, node.args) for node in ast.walk(tree)
              if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress")]
    return [line for line, types in kinds for kind in types
            if kind is None or any(isinstance(part, ast.Name) and part.id in wide for part in ast.walk(kind))]


def runs_engines(tree: ast.Module) -> list[int]:
    """Lines that call `run` with a request, as adapters take it: its second argument is a `RunSpec` or named so."""
    return [node.lineno for node in ast.walk(tree)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "run"
            and any("spec" in ast.unparse(each).lower()
                    for each in [*node.args, *(word.value for word in node.keywords)])]


def test_any_exception_is_caught_in_a_few_places_only() -> None:
    assert {name for name, tree in sources().items() if catches_all(tree)} == set(ANY)


def test_engines_are_run_in_one_place() -> None:
    found = {name for name, tree in sources().items() if runs_engines(tree) and not name.startswith("adapters/")}
    assert found == {"running/attempt.py"}


@pytest.mark.parametrize(("code", "catching", "running"), [
    ("try:\n    x()\nexcept Exception:\n    pass", 1, 0), ("try:\n    x()\nexcept:\n    pass", 1, 0),
    ("try:\n    x()\nexcept (ValueError, BaseException) as e:\n    y(e)", 1, 0),
    ("try:\n    x()\nexcept BaseException:\n    y()\n    raise", 0, 0),
    ("with contextlib.suppress(Exception): x()", 1, 0),
    ("try:\n    x()\nexcept ValueError:\n    pass", 0, 0), ("a.run(scene, spec)", 0, 1),
    ("a.run(scene, dataclasses.replace(spec, form=None))", 0, 1), ("a.run(scene, RunSpec('RK4'))", 0, 1),
    ("subprocess.run(words)", 0, 0),
])
def test_seeded_code_is_seen(code: str, catching: int, running: int) -> None:
    tree = ast.parse(code)
    assert (len(catches_all(tree)), len(runs_engines(tree))) == (catching, running)
